"""A study on disk made by the functions of ``scso run``, one trial after the other."""

from pathlib import Path

from scso_nlp.io.bundle import save_bundle
from scso_nlp.run import run, write_run
from scso_nlp.settings import OutputSettings, read_settings
from scso_nlp.studies.record import Outcome, Study, StudyTrial, write_outcome, write_study

#: Conditions by their settings.
CONDITIONS = {
    "off": {"stability": "off"},
    "potvin-brown": {"stability": "potvin-brown"},
    "diagonal": {"stability": "diagonal"},
}


def make_study(folder, recordings, *, conditions=CONDITIONS, events=None, **common):
    """Run recordings by conditions and write them as a study.

    `recordings` has a setup file and settings of its own by subject and trial; `common` are settings of all.
    """
    trials = []
    for (subject, trial), (setup, own) in recordings.items():
        for condition, settings in conditions.items():
            planned = StudyTrial(
                subject=subject,
                trial=trial,
                condition=condition,
                folder=f"{subject}/{trial}/{condition}",
                identity="one",
                settings={**own, **settings},
            )
            trials.append(planned)
            _run(Path(folder), planned, setup, common, events)
    grid = {"stability": [settings["stability"] for settings in conditions.values()]}
    write_study(Path(folder), Study(name="small", source="recordings", grid=grid, trials=tuple(trials)))


def _run(folder, planned, setup, common, events):
    settings, _ = read_settings(setup, {**common, **planned.settings})
    output = OutputSettings(folder=folder / planned.folder, figures=False)
    result = run(settings, output)
    write_run(result, output)
    save_bundle(folder / planned.folder / ".." / "motion.npz", result.solution.problem.motion)
    outcome = Outcome(
        identity=planned.identity,
        subject=planned.subject,
        trial=planned.trial,
        condition=planned.condition,
        settings=planned.settings,
        state="done" if result.is_solved else "failed",
        sentence=result.verdict_lines[0],
        events=events,
    )
    write_outcome(folder / planned.folder, outcome)
