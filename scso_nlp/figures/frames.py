"""Frames along the horizontal axis: their values and label, and the shade over those that failed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from scso_nlp.exceptions import DataError
from scso_nlp.trajectory import LONG_AGO, time_text
from scso_nlp.validation import BoolArray, FloatArray, read_only

#: Up to this many frames are separate tasks rather than a movement, and get markers.
FEW_FRAMES = 15


@dataclass(frozen=True, kw_only=True)
class HorizontalAxis:
    """What stands on the horizontal axis of every panel.

    Attributes
    ----------
    values : array_like, shape (n_frames,) [unit of the label]
        Increasing, e.g. :func:`percent_of_motion`.
    label : str
        With its unit, e.g. ``"Gait cycle [%]"``.

    Raises
    ------
    DataError
        Values that are not finite or do not increase.
    """

    values: FloatArray
    label: str

    def __post_init__(self) -> None:
        values = read_only("horizontal values", self.values, (-1,), "n_frames")
        if (np.diff(values) <= 0).any():
            raise DataError(f"the horizontal values of {self.label!r} must increase from frame to frame")
        object.__setattr__(self, "values", values)


def horizontal_axis(time: FloatArray, chosen: HorizontalAxis | None) -> HorizontalAxis:
    """Give the axis chosen if it has one value per frame, or time; a clock from long ago starts at zero."""
    if chosen is not None:
        if len(chosen.values) != len(time):
            raise DataError(
                f"horizontal values have shape {chosen.values.shape}, expected ({len(time)},) = (n_frames)"
            )
        return chosen
    if abs(time[0]) < LONG_AGO:
        return HorizontalAxis(values=time, label="Time [s]")
    return HorizontalAxis(values=time - time[0], label=f"Time since t = {time_text(time[0])} s [s]")


def percent_of_motion(time: FloatArray, start: float | None = None, stop: float | None = None) -> FloatArray:
    """Turn time into per cent of a motion or of a gait cycle.

    Parameters
    ----------
    time : ndarray, shape (n_frames,) [s]
    start, stop : float [s], optional
        0 and 100 %; first and last frame by default.

    Returns
    -------
    ndarray, shape (n_frames,) [%]

    Raises
    ------
    DataError
        `stop` is not after `start`.
    """
    start = float(time[0]) if start is None else start
    stop = float(time[-1]) if stop is None else stop
    if not stop > start:
        raise DataError(f"the cycle ends at {stop} s, expected after its start at {start} s")
    return 100 * (np.asarray(time, dtype=float) - start) / (stop - start)


def frame_edges(x: FloatArray) -> FloatArray:
    """Find the limits half-way between neighboring frames, shape (n_frames + 1,) [as x]."""
    if len(x) == 1:
        return np.array([x[0] - 0.5, x[0] + 0.5])
    middles = (x[1:] + x[:-1]) / 2
    return np.concatenate(([2 * x[0] - middles[0]], middles, [2 * x[-1] - middles[-1]]))


def spans(x: FloatArray, are_in: BoolArray) -> FloatArray:
    """Find the runs of frames that are in, half a frame more at both ends, shape (n_spans, 2) [as x]."""
    edges = frame_edges(x)
    padded = np.concatenate(([False], are_in, [False]))
    starts, stops = np.flatnonzero(padded[1:] & ~padded[:-1]), np.flatnonzero(padded[:-1] & ~padded[1:])
    return np.column_stack((edges[starts], edges[stops]))


def shade_failed(panel: Axes, x: FloatArray, is_solved: BoolArray) -> None:
    """Shade the frames that are not solved, one span for each run of them."""
    found = spans(x, ~is_solved)
    if found.size:
        panel.broken_barh(
            [(start, stop - start) for start, stop in found], (0, 1), zorder=0,
            transform=panel.get_xaxis_transform(), color="0.8", linewidth=0, label="not solved",
        )  # fmt: skip
