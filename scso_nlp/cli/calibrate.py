"""``scso calibrate``: which gains and levels measurements ask for, each trial left out in turn."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scso_nlp.cli.exit_codes import exit_codes
from scso_nlp.cli.options import Verbose, with_settings
from scso_nlp.progress import stages_shown
from scso_nlp.signals import undisturbed

if TYPE_CHECKING:
    from scso_nlp.calibration import Calibration, MeasuredTrial
    from scso_nlp.problem import MuscleForceProblem
    from scso_nlp.settings import RunSettings

#: Settings that say where results of a run go, and how.
NOT_FOR_CALIBRATIONS = ("output", "overwrite", "keep_failed", "figures")
#: File of what was found, beside one of settings for each trial.
FILE = "calibration.json"


@with_settings(without=NOT_FOR_CALIBRATIONS)
def calibrate(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SETUP.xml|SETTINGS.toml...", help="Trials, each with what was measured in it."
        ),
    ],
    *,
    output: Annotated[
        Path | None,
        typer.Option(help="Folder of the results; the next free name. [default: scso_results/calibration]"),
    ] = None,
    verbose: Verbose = False,
    **changes: Any,
) -> None:
    """Find gains q and levels that measurements ask for, and test them on trials that are left out in turn.

    Options are settings of all trials; what differs, as EMG or a measured stiffness, stands in their files.
    Writes calibration.json, and for each trial settings with what was found, which scso run takes. Exit code
    0: found; 2: input that cannot be used.
    """
    with exit_codes(verbose) as console:
        with undisturbed():
            from scso_nlp.calibration import calibrate as search
            from scso_nlp.exceptions import ProblemError
            from scso_nlp.files import write_whole
            from scso_nlp.report.folder import claimed, names_in, refuse_unwritable
            from scso_nlp.settings import RESULTS, given_settings, read_settings

        folder = (output or Path(RESULTS) / "calibration").absolute()
        refuse_unwritable(folder)
        trials: dict[str, MeasuredTrial] = {}
        given, about = {}, []
        sha256: dict[str, str] = {}
        with stages_shown(delay=0.0), console.held_back():
            for source in sources:
                settings, where = read_settings(source, changes)
                name = settings.motion.name
                if name in trials:
                    raise ProblemError(f"two trials are called {name!r}, give each a name of its own")
                trials[name] = _trial(source, settings, where)
                said = given_settings(source.absolute(), changes)
                given[name] = {key: v for key, v in said.items() if key not in NOT_FOR_CALIBRATIONS}
                about.append(settings.calibration)
                sha256 |= settings.sources
            asked = [(each.parameters, each.bounds, each.same_data) for each in about]
            if any(each != asked[0] for each in asked):
                raise ProblemError(
                    "trials say different things of calibrated, calibration_bounds or same_data, expected one"
                )
            parameters, limits, same_data = asked[0]
            bounds = {of: (least, most) for of, (least, most) in (limits or {}).items()}
            found = search(trials, parameters, bounds=bounds, same_data=same_data)
        typer.echo(repr(found))
        asked_for = {"settings": as_plain(given), "inputs_sha256": sha256}

        def is_free(place: Path) -> bool:
            return not names_in(place) or asked_for.items() <= read_record(place).items()

        with claimed(folder, is_free, "results of another calibration") as place:
            texts = {
                f"{n}.toml": settings_text(given[n], found.applied(t.problem)) for n, t in trials.items()
            }
            texts[FILE] = json.dumps(as_record(found) | asked_for, ensure_ascii=False, indent=1) + "\n"
            for file, text in texts.items():
                with write_whole(place / file) as temporary:
                    temporary.write_text(text, encoding="utf-8")
        typer.echo(f"  {FILE} and settings for scso run in {place}")


def _trial(source: Path, settings: RunSettings, where: Any) -> MeasuredTrial:
    """Read a trial and what was measured in it."""
    from scso_nlp.calibration import MeasuredEmg, MeasuredStiffness, MeasuredTrial
    from scso_nlp.exceptions import ProblemError
    from scso_nlp.run import describe, extract

    emg, about = settings.emg, settings.calibration
    if settings.stability is None:
        raise ProblemError(f"{source}: stability is off, choose with stability what is to be calibrated")
    if emg.tracking is not None or emg.bounds is not None:
        raise ProblemError(f"{source}: activations are held to EMG, expected no emg_tracking or emg_bounds")
    if (emg.compare is None) == (about.stiffness is None):
        raise ProblemError(f"{source}: expected emg with emg_compare, or measured_stiffness, one of the two")
    measured: MeasuredEmg | MeasuredStiffness
    if emg.compare is not None:
        measured = MeasuredEmg(activity=emg.activity, compare=emg.compare)
    elif about.stiffness is not None:
        measured = MeasuredStiffness(stiffness=about.stiffness, arms=about.arms or {})
    return MeasuredTrial(
        problem=describe(settings, extract(settings, where)), measured=measured, unit=about.unit
    )


def settings_text(given: Mapping[str, Any], problem: MuscleForceProblem) -> str:
    """Write settings with the gains and levels of a problem, as a file that ``scso run`` takes.

    Parameters
    ----------
    given : mapping of str to object
        What the trial's file and the options said.
    problem : MuscleForceProblem

    Returns
    -------
    str
    """
    from scso_nlp.declared_settings import template

    (rows, *_) = problem.stability_terms
    found = {"q": getattr(rows.stiffness_law, "q", None), "level": rows.level}
    values = {**given, **{name: value for name, value in found.items() if value is not None}}
    return template({name: _toml(value) for name, value in values.items()})


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        inside = ", ".join(
            f"{json.dumps(name, ensure_ascii=False)} = {_toml(v)}" for name, v in value.items()
        )
        return f"{{ {inside} }}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value if isinstance(value, int) else str(value), ensure_ascii=False)


def read_record(folder: Path) -> dict[str, Any]:
    """Read what an earlier calibration wrote into a folder, empty where that cannot be read."""
    try:
        record = json.loads((folder / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def as_plain(values: Any) -> Any:
    """Turn values into what JSON holds; null for what is not finite, text for paths."""
    if isinstance(values, Mapping):
        return {name: as_plain(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return [as_plain(value) for value in values]
    if isinstance(values, float) and not math.isfinite(values):
        return None
    return values if values is None or isinstance(values, bool | int | float) else str(values)


def as_record(found: Calibration) -> dict[str, Any]:
    """Lay out what was found for a file.

    Parameters
    ----------
    found : Calibration

    Returns
    -------
    dict of str to object
    """
    from scso_nlp.versions import versions

    arrays = {
        "value": found.value,
        "standard_error": found.standard_error,
        "is_flat": found.is_flat,
        "is_at_bound": found.is_at_bound,
        "value_without": found.value_without,
        "error": found.error,
        "error_at_start": found.error_at_start,
        "error_of_plain": found.error_of_plain,
    }
    return {
        "parameters": found.names,
        "units": found.units,
        "meaning": found.meaning,
        "is_same_data": found.is_same_data,
        "n_frames": found.n_frames,
        "n_without_derivatives": found.n_without_derivatives,
        **{name: as_plain(values.tolist()) for name, values in arrays.items()},
        "versions": versions(),
    }
