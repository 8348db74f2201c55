"""What the page tells before its figures: what was asked, what it is worth, what changed, what is missing.

Reports come from files that anybody may have edited: what is not as this program writes it is left out.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scso_nlp.emg.comparison import Comparison
from scso_nlp.emg.motion_result import MotionResult
from scso_nlp.trajectory import time_text
from scso_nlp.verdict import RESERVE_LIMIT, RESIDUAL_LIMITS, ROUNDING

#: Muscles in the table of the largest changes.
MOST_CHANGES = 12
#: A smaller difference in activation is none [-].
LEAST_CHANGE = 5e-4
#: Metrics whose mean over all groups with EMG stands at the top.
_HEADLINES = ("mean absolute difference", "Pearson r")


@dataclass(frozen=True, kw_only=True)
class Line:
    """One quantity of a verdict.

    Attributes
    ----------
    quantity : str
    value : str
    limit : str
        What OpenSim's documentation advises at most; empty where it says nothing.
    is_beyond : bool
        The value is beyond the limit, or not what was asked for.
    """

    quantity: str
    value: str
    limit: str = ""
    is_beyond: bool = False


@dataclass(frozen=True, kw_only=True)
class Change:
    """How one muscle differs between two results.

    Attributes
    ----------
    muscle : str
    before, after : float [-]
        Mean activation over the frames used.
    largest : float [-]
        Difference where it is largest.
    time : float [s]
        When that is.
    """

    muscle: str
    before: float
    after: float
    largest: float
    time: float


@dataclass(frozen=True, kw_only=True)
class Missing:
    """By how much a row is missed by a failed run.

    Attributes
    ----------
    constraint, row, unit : str
    frames : int
        In which it is missed.
    most : float [unit]
    time : float [s]
        When most is missed.
    """

    constraint: str
    row: str
    unit: str
    frames: int
    most: float
    time: float


def asked(report: Mapping[str, Any]) -> tuple[str, ...]:
    """Say in sentences what a run was asked for.

    Parameters
    ----------
    report : mapping
        As in ``report.json``.

    Returns
    -------
    tuple of str
        Empty without a problem in the report.
    """
    settings = _mapping(report, "settings")
    files = ", ".join(
        os.path.basename(name)
        for key in ("model", "coordinates", "states", "external_loads")
        if isinstance(name := settings.get(key), str) and name
    )
    terms = _mapping(_mapping(report, "problem"), "in_short")
    sentences = (files and f"From {files}.", *(_joined(head, words) for head, words in terms.items()))
    return tuple(sentence for sentence in sentences if sentence)


def model_of(report: Mapping[str, Any]) -> str:
    """Say how large the model is; empty where the report does not."""
    problem = _mapping(report, "problem")
    muscles, actuators, coordinates = (problem.get(key) for key in ("muscles", "actuators", "coordinates"))
    if not isinstance(muscles, int) or not isinstance(actuators, int) or not isinstance(coordinates, list):
        return ""
    return f"{muscles} muscles, {actuators} other actuators, {len(coordinates)} coordinates"


def moved_coordinates(report: Mapping[str, Any], muscles: Sequence[str]) -> dict[str, str]:
    """Name for every muscle the coordinate that it moves most; muscles that the report does not know last."""
    moved = _mapping(_mapping(report, "problem"), "moved_coordinate")
    known = {muscle: name for muscle in muscles if isinstance(name := moved.get(muscle), str)}
    order = dict.fromkeys(known.values())
    found = {muscle: name for joint in order for muscle, name in known.items() if name == joint}
    return found | {muscle: "other muscles" for muscle in muscles if muscle not in known}


def standing(report: Mapping[str, Any]) -> tuple[Line, ...]:
    """Give a verdict line by line, against the limits that OpenSim advises.

    Parameters
    ----------
    report : mapping
        As in ``report.json``.

    Returns
    -------
    tuple of Line
        Empty without a verdict of this program.
    """
    verdict = _mapping(report, "verdict")
    n_frames, stable = verdict.get("n_frames"), verdict.get("frames_stable")
    lines = []
    if isinstance(n_frames, int) and isinstance(stable, int):
        value = f"in {stable} of {n_frames} frames"
        lines.append(Line(quantity="all stability rows kept", value=value, is_beyond=stable < n_frames))
    if margin := _extreme(verdict, "margin"):
        amount, text = margin
        lines.append(Line(quantity="least margin", value=text, is_beyond=amount < -ROUNDING))
    if missed := _extreme(verdict, "missed"):
        value = f"{missed[1]}, some in {verdict.get('frames_missed')} of {n_frames} frames"
        lines.append(Line(quantity="largest miss of a soft level", value=value, is_beyond=True))
    limits = {"reserve": 100 * RESERVE_LIMIT, "residual_force": RESIDUAL_LIMITS["N"]}
    limits["residual_moment"] = RESIDUAL_LIMITS["N·m"]
    for key, words in (
        ("reserve", "most that reserves carry of a peak moment"),
        ("residual_force", "largest residual force"),
        ("residual_moment", "largest residual moment"),
        ("motor_force", "largest force of motors"),
        ("motor_moment", "largest moment of motors"),
    ):
        if found := _extreme(verdict, key):
            amount, text = found
            limit = limits.get(key, math.inf)
            shown = f"{limit:g}" if math.isfinite(limit) else ""
            lines.append(Line(quantity=words, value=text, limit=shown, is_beyond=amount > limit))
    paid = {what: x for what, x in _mapping(verdict, "effort").items() if _is_number(x) and x}
    total = sum(paid.values())
    if paid and total > 0:
        value = ", ".join(f"{100 * x / total:.3g} % {what}" for what, x in paid.items())
        lines.append(Line(quantity=f"effort {total:.4g}", value=value))
    return tuple(lines)


def largest_changes(comparison: Comparison) -> tuple[Change, ...]:
    """Find the muscles that differ most between the first and the last result.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    tuple of Change
        At most :data:`MOST_CHANGES`, by the size of the largest difference; none of a single result.
    """
    if len(comparison.results) < 2 or not comparison.is_used.any():
        return ()
    first, last = comparison.results[0], comparison.results[-1]
    used = comparison.is_used
    before, after, time = first.activation[used], last.activation[used], comparison.time[used]
    difference = after - before
    frame = np.abs(difference).argmax(axis=0)
    largest = difference[frame, np.arange(difference.shape[1])]
    order = np.argsort(-np.abs(largest), kind="stable")[:MOST_CHANGES]
    return tuple(
        Change(
            muscle=first.muscles[m],
            before=float(before[:, m].mean()),
            after=float(after[:, m].mean()),
            largest=float(largest[m]),
            time=float(time[frame[m]]),
        )
        for m in order
        if abs(largest[m]) >= LEAST_CHANGE
    )


def emg_headline(comparison: Comparison) -> tuple[str, ...]:
    """Sum up the agreement with EMG over all groups, one sentence per metric."""
    sentences = []
    for metric in _HEADLINES:
        found: dict[str, list[float]] = {}
        for row in comparison.rows:
            if row.metric == metric and math.isfinite(row.value) and row.group in comparison.group_names:
                found.setdefault(row.result, []).append(row.value)
        if found:
            parts = [f"{np.mean(values):.3f} ({label})" for label, values in found.items()]
            groups = len(next(iter(found.values())))
            of_what = f"mean over {groups} groups" if groups > 1 else "one group"
            sentences.append(f"{metric} from EMG, {of_what}: {', '.join(parts)}.")
    return tuple(sentences)


def missing(report: Mapping[str, Any]) -> tuple[Missing, ...]:
    """List what a failed run misses, row by row, largest first within a unit.

    Parameters
    ----------
    report : mapping
        As in ``report.json``.

    Returns
    -------
    tuple of Missing
    """
    by_row: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    for constraint, row, unit, amount, time in shortfalls(report):
        by_row.setdefault((constraint, row, unit), []).append((amount, time))
    found = [
        Missing(
            constraint=constraint,
            row=row,
            unit=unit,
            frames=len({time for _, time in entries}),
            most=max(entries)[0],
            time=max(entries)[1],
        )
        for (constraint, row, unit), entries in by_row.items()
    ]
    return tuple(sorted(found, key=lambda one: (one.unit, -one.most)))


def shortfalls(report: Mapping[str, Any]) -> Iterator[tuple[str, str, str, float, float]]:
    """Yield constraint, row, unit, amount and time of every shortfall of a report."""
    entries = report.get("shortfalls")
    for entry in entries if isinstance(entries, list) else ():
        if not isinstance(entry, Mapping):
            continue
        words = [entry.get(key) for key in ("constraint", "row", "unit")]
        numbers = [entry.get(key) for key in ("amount", "time")]
        if all(isinstance(word, str) for word in words) and all(map(_is_number, numbers)):
            yield (*words, *map(float, numbers))  # type: ignore[misc, arg-type]


def with_static_optimization(results: Sequence[MotionResult]) -> tuple[MotionResult, ...]:
    """Put before a single result the static optimization that its run began with, if it was kept."""
    if len(results) != 1 or results[0].without_stability is None:
        return tuple(results)
    return (results[0].before_stability(), results[0])


def _mapping(report: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    found = report.get(key)
    return found if isinstance(found, Mapping) else {}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _extreme(verdict: Mapping[str, Any], key: str) -> tuple[float, str] | None:
    """Give amount and words of an entry; None where there is none."""
    entry = _mapping(verdict, key)
    amount, time = entry.get("amount"), entry.get("time")
    if not isinstance(amount, int | float) or not isinstance(time, int | float) or not _is_number(amount):
        return None
    shown = 0.0 if abs(amount) < ROUNDING else amount
    where = f"{entry.get('name', '')} at t = {time_text(float(time))} s"
    return float(amount), f"{shown:.4g} {entry.get('unit', '')} ({where})"


def _joined(head: str, words: object) -> str:
    shown = [word for word in words if isinstance(word, str)] if isinstance(words, list) else []
    return f"{head}: {', '.join(shown)}." if shown else ""
