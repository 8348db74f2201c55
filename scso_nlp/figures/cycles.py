"""Series along the horizontal axis: over time, over per cent of a cycle, cycle by cycle, or task by task."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import HorizontalAxis, horizontal_axis, percent_of_motion
from scso_nlp.figures.series import Series
from scso_nlp.validation import FloatArray, read_only

#: Per cent of a cycle at which cycles are drawn and averaged.
PERCENT = np.linspace(0.0, 100.0, 101)


@dataclass(frozen=True, kw_only=True)
class Course:
    """One series as it is drawn.

    Attributes
    ----------
    series : Series
    x : ndarray, shape (n_points,) [unit of the horizontal axis]
    cycles : ndarray, shape (n_cycles, n_points, n_names) [unit of the series]
        The values once, or those of each cycle.
    """

    series: Series
    x: FloatArray
    cycles: FloatArray

    def of(self, name: str) -> FloatArray:
        """Values of a name, shape (n_cycles, n_points); NaN where it is not there."""
        if name not in self.series.names:
            return np.full(self.cycles.shape[:2], np.nan)
        return self.cycles[:, :, self.series.names.index(name)]


def over_time(series: Sequence[Series], horizontal: HorizontalAxis | None) -> tuple[list[Course], str]:
    """Put series over time, or over values of one's own; give the label of the axis, too.

    Raises
    ------
    DataError
        The horizontal values are not one per frame.
    """
    first = horizontal_axis(series[0].time, horizontal)
    if horizontal is not None:
        return [_once(each, horizontal_axis(each.time, horizontal).values) for each in series], first.label
    start = series[0].time[0] - first.values[0]
    return [_once(each, each.time - start) for each in series], first.label


def over_cycle(series: Sequence[Series], events: Sequence[float]) -> tuple[list[Course], str]:
    """Put series over per cent: of all frames, or of the cycles from each event to the next.

    Parameters
    ----------
    series : sequence of Series
    events : sequence of float [s]
        None, or at least two that increase within the motion.

    Returns
    -------
    courses : list of Course
        Between frames and at the events values are interpolated in straight lines.
    label : str

    Raises
    ------
    DataError
        One event alone, events that do not increase, or outside the motion.
    """
    if not events:
        return [_once(each, percent_of_motion(each.time)) for each in series], "Cycle [%]"
    times = read_only("events", events, (-1,), "n_events")
    if len(times) < 2 or (np.diff(times) <= 0).any():
        shown = ", ".join(f"{time:g}" for time in times)
        raise DataError(
            f"the events are {shown} s, expected two or more that increase: 0 % and 100 % of cycles"
        )
    for each in series:
        first, last = each.time[0], each.time[-1]
        step = (last - first) / max(len(each.time) - 1, 1)
        if times[0] < first - 0.5 * step or times[-1] > last + 0.5 * step:
            raise DataError(
                f"the events reach from {times[0]:g} to {times[-1]:g} s, expected times within the motion of "
                f"{each.label!r}, {first:g} to {last:g} s"
            )
    return [_cut(each, times) for each in series], "Cycle [%]"


def task_by_task(series: Sequence[Series]) -> list[Course]:
    """Put series over the numbers of their tasks, from one.

    Raises
    ------
    DataError
        Not the same number of tasks.
    """
    counts = {each.label: len(each.time) for each in series}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{n} of {label!r}" for label, n in counts.items())
        raise DataError(f"the results have different tasks: {told}; expected one number")
    return [_once(each, np.arange(1.0, len(each.time) + 1)) for each in series]


def _once(series: Series, x: FloatArray) -> Course:
    return Course(series=series, x=x, cycles=series.values[np.newaxis])


def _cut(series: Series, events: FloatArray) -> Course:
    cycles = np.empty((len(events) - 1, len(PERCENT), len(series.names)))
    for c, (start, stop) in enumerate(itertools.pairwise(events)):
        at = start + PERCENT / 100 * (stop - start)
        for i, values in enumerate(series.values.T):
            cycles[c, :, i] = np.interp(at, series.time, values)
    return Course(series=series, x=PERCENT, cycles=cycles)
