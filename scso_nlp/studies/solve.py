"""One trial by one condition, read from its files: its row, its numbers, its curves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scso_nlp.emg.motion_result import read_result
from scso_nlp.exceptions import DataError, ScsoError
from scso_nlp.figures.series import Series
from scso_nlp.io.bundle import load_bundle
from scso_nlp.motion import Motion
from scso_nlp.report.folder import FAILED, failed_run, read_report
from scso_nlp.report.series import every_series
from scso_nlp.studies.cycles import Curve, cut_curves
from scso_nlp.studies.events import NO_CYCLE, find_events
from scso_nlp.studies.record import Outcome, StudyTrial
from scso_nlp.studies.summary import Number, co_contraction_numbers, series_numbers, verdict_numbers

#: States beside those of an outcome: nothing is there of this plan; files that cannot be read.
NOT_RUN, UNREADABLE = "not run", "unreadable"


class Solve(NamedTuple):
    """What the files of one trial by one condition hold.

    Attributes
    ----------
    row : dict of str to object
        State, sentence, formulation, rule of the events, number of cycles and the numbers of the verdict.
    numbers : list of Number
    curves : list of Curve
    """

    row: dict[str, Any]
    numbers: list[Number]
    curves: list[Curve]


def read_solve(
    folder: Path, planned: StudyTrial, outcome: Outcome | None, motions: Callable[[Path], Sequence[Motion]]
) -> Solve:
    """Read one trial by one condition.

    Parameters
    ----------
    folder : Path
        Of the study.
    planned : StudyTrial
    outcome : Outcome or None
    motions : callable
        Gives the extracted motions in a folder, as :func:`load_motions`.

    Returns
    -------
    Solve
        What cannot be read has the state "unreadable" and says why; nothing is raised for it.
    """
    place = folder / planned.folder
    state, sentence = (outcome.state, outcome.sentence) if outcome else (NOT_RUN, "")
    row: dict[str, Any] = {"state": state, "sentence": sentence}
    report: Mapping[str, Any] | None = None
    numbers: list[Number] = []
    curves: list[Curve] = []
    try:
        if outcome and outcome.state == "done":
            result = read_result(place, planned.condition)
            report, series = result.report, every_series(place, result)
            motion = matching(motions(place.parent), series["force"])
            skeleton = motion.trajectory.skeleton if motion else None
            series |= _derived(series, tuple(report["joint_reaction_peaks"]))
            events = find_events(result.time, outcome.events, skeleton)
            for quantity, each in series.items():
                curves += cut_curves(quantity, each, events)
            numbers += series_numbers(series)
            numbers += (
                Number("reaction force", joint, "peak", peak["force"], "N")
                for joint, peak in report["joint_reaction_peaks"].items()
            )
            if motion:
                numbers += co_contraction_numbers(series["force"], motion.trajectory)
            row |= {
                "events": events.rule if curves else NO_CYCLE,
                "cycles": max((curve.cycle for curve in curves), default=0),
            }
        elif outcome and outcome.state == "failed":
            report = read_report(place / FAILED) or failed_run(place)
        verdict = list(verdict_numbers(report)) if report else []
    except ScsoError as error:
        return Solve(row | {"state": UNREADABLE, "sentence": str(error)}, [], [])
    except (KeyError, TypeError, AttributeError):
        told = f"{place / 'report.json'} is damaged: it is not as this program writes it; run it again"
        return Solve(row | {"state": UNREADABLE, "sentence": told}, [], [])
    settings = report["settings"] if report else planned.settings
    row["formulation"] = str(settings.get("stability", "off"))
    row |= {f"{number.quantity}_{number.name}".replace(" ", "_"): number.value for number in verdict}
    return Solve(row, verdict + numbers, curves)


def load_motions(folder: Path) -> tuple[Motion, ...]:
    """Load the extracted motions of a trial's folder."""
    return tuple(load_bundle(path) for path in sorted(folder.glob("*.npz")))


def matching(motions: Sequence[Motion], force: Series) -> Motion | None:
    """Find the motion of these frames and muscles.

    Returns
    -------
    Motion or None
        None where there are no motions at all.

    Raises
    ------
    DataError
        There are some, but of other frames or muscles.
    """
    for motion in motions:
        trajectory = motion.trajectory
        if (
            trajectory.muscles == force.names
            and trajectory.time.shape == force.time.shape
            and np.allclose(trajectory.time, force.time, rtol=0, atol=1e-6)
        ):
            return motion
    if motions:
        raise DataError(
            f"the extracted motion beside {force.label!r} has other frames or muscles than its results, "
            "expected the same; run the trial again"
        )
    return None


def _derived(series: Mapping[str, Series], joints: tuple[str, ...]) -> dict[str, Series]:
    """Make margins of stability rows, and call joint reactions by their joints."""
    found = {}
    if "stability" in series:
        rows = series["stability"]
        level = np.zeros(len(rows.names)) if rows.level is None else rows.level
        found["margin"] = replace(rows, values=rows.values - level, level=np.zeros(len(rows.names)))
    if "reaction" in series:
        found["reaction"] = replace(series["reaction"], names=joints)
    return found
