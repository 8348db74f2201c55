"""Columns of a motion and of its loads as OpenSim's AnalyzeTool prepares them: filtered, through splines.

All of it acts on every column alike, whatever it means: it is done once, before the workers know the model.

The recipe is that of OpenSim 4.6 (``Storage.pad``, ``Storage.lowpassIIR``, ``Signal.LowpassIIR``,
``GCVSplineSet`` without smoothing, ``ExternalForce``), which takes long for long files: each evaluation of
its splines goes through all rows.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.io.storage import Storage
from scso_nlp.opensim.setup_xml import MotionInput
from scso_nlp.opensim.worker.exchange import Table
from scso_nlp.validation import FloatArray, IntArray

logger = logging.getLogger("scso_nlp")

#: Degree of the splines that give speeds and accelerations, and of those between the rows of loads ...
DEGREE, LOAD_DEGREE = 5, 3
#: ... where there are at least so many; fewer are joined by straight lines.
LEAST_LOAD_ROWS = 4
#: Steps that differ by no more than this are even [s]; otherwise the filter resamples to the smallest ...
EVEN = float(np.finfo(float).eps)
#: ... or to so many steps.
MOST_STEPS = 100_000
#: Cutoff frequencies from half the sampling frequency on are taken as this share of it [-].
HIGHEST_CUTOFF = 0.49
#: Speeds belong to a row of coordinates if their times differ by no more than this [s].
SAME_TIME = 1e-6


def prepare_motion(motion: MotionInput, table: Storage) -> tuple[Table, IntArray]:
    """Filter a motion and differentiate it twice.

    Parameters
    ----------
    motion : MotionInput
    table : Storage
        The motion file.

    Returns
    -------
    Table
        With the rows that padding for the filter adds; columns that are not finite are NaN.
    ndarray of int
        The rows to analyze, chosen as AnalyzeTool does: from the last row at or before the first time to that
        at or before the last one, no interpolation.
    """
    time, values = table.time, table.values
    if motion.filter_frequency is not None:
        time, values = _filtered(time, values, motion.filter_frequency)
    ends = (
        table.time[0] if motion.initial_time is None else motion.initial_time,
        table.time[-1] if motion.final_time is None else motion.final_time,
    )
    first, last = (max(int(np.searchsorted(time, end, side="right")) - 1, 0) for end in ends)
    every = np.arange(first, last + 1)
    chosen = (every % motion.step_interval == 0) | (every == first) | (every == last)
    return _with_derivatives(table.labels, time, values), every[chosen]


def prepare_speeds(speeds: Storage, motion: Table, rows: IntArray) -> Table:
    """Take from a file of speeds the rows nearest to those of a motion, and differentiate them.

    Parameters
    ----------
    speeds : Storage
        The file of speeds.
    motion : Table
    rows : ndarray of int
        The rows of the motion to analyze.

    Returns
    -------
    Table
        At the times of the motion.

    Raises
    ------
    DataError
        A row to analyze has none within a microsecond.
    """
    after = np.searchsorted(speeds.time, motion.time).clip(1, speeds.n_frames - 1)
    is_before = motion.time - speeds.time[after - 1] <= speeds.time[after] - motion.time
    closest = np.where(is_before, after - 1, after)
    apart = np.abs(speeds.time[closest] - motion.time)[rows]
    if (apart > SAME_TIME).any():
        time = motion.time[rows[int(apart.argmax())]]
        raise DataError(
            f"{speeds.source} has no row at t = {time:.9g} s, expected the times of the coordinates"
        )
    return _with_derivatives(speeds.labels, motion.time, speeds.values[closest])


def _with_derivatives(labels: tuple[str, ...], time: FloatArray, values: FloatArray) -> Table:
    first = spline(time, values, time, 1)
    return Table(labels=labels, time=time, values=values, first=first, second=spline(time, first, time, 1))


def loads_at(data: Storage, time: FloatArray) -> Storage:
    """Evaluate the columns of external loads as OpenSim does, so that it need not.

    A spline through the result, evaluated at the same times, gives it back.

    Parameters
    ----------
    data : Storage
        Finite columns.
    time : ndarray, shape (n,) [s]

    Returns
    -------
    Storage
    """
    inside = time.clip(data.time[0], data.time[-1])
    if data.n_frames >= LEAST_LOAD_ROWS:
        values = spline(data.time, data.values, inside, degree=LOAD_DEGREE)
        # natural splines go on as straight lines
        slopes = spline(data.time, data.values, inside, 1, degree=LOAD_DEGREE)
        values += slopes * (time - inside)[:, None]
    elif data.n_frames > 1:
        row = np.searchsorted(data.time, time).clip(1, data.n_frames - 1)
        slopes = np.diff(data.values, axis=0) / np.diff(data.time)[:, None]
        values = data.values[row] + slopes[row - 1] * (time - data.time[row])[:, None]
    else:
        values = np.repeat(data.values, len(time), axis=0)
    return replace(data, time=time, values=values)


def spline(
    time: FloatArray, values: FloatArray, at: FloatArray, order: int = 0, degree: int = DEGREE
) -> FloatArray:
    """Evaluate natural splines through values, or a derivative of them.

    Parameters
    ----------
    time : ndarray, shape (n_rows,)
    values : ndarray, shape (n_rows, n_columns)
    at : ndarray, shape (n,)
        Within `time`.
    order : int
        Of the derivative.
    degree : int
        Odd.

    Returns
    -------
    ndarray, shape (n, n_columns)
        NaN in columns that are not finite.
    """
    # what needs no motion from OpenSim need not wait for this import
    from scipy.interpolate import make_interp_spline

    evaluated = np.full((len(at), values.shape[1]), np.nan)
    finite = np.isfinite(values).all(axis=0)
    # a constant has no part in derivatives but in their rounding errors
    center = values[:, finite].mean(axis=0)
    ends = [(k, np.zeros(len(center))) for k in range((degree + 1) // 2, degree)]
    curves = make_interp_spline(time, values[:, finite] - center, k=degree, bc_type=(ends, ends))
    evaluated[:, finite] = curves(at, nu=order) + (0.0 if order else center)
    return evaluated


def _filtered(time: FloatArray, values: FloatArray, cutoff: float) -> tuple[FloatArray, FloatArray]:
    """Pad a motion by half its length on both sides and run the low-pass filter forward and backward."""
    n = len(time) // 2
    time, values = _padded(time, n), _padded(values, n)
    step = float(np.diff(time).min())
    if (time[-1] - time[0]) / (len(time) - 1) - step > EVEN:
        step = max(step, (time[-1] - time[0]) / MOST_STEPS)
        # summed up one by one, as OpenSim does
        n_most = int((time[-1] - time[0]) / step) + 2
        even = np.add.accumulate(np.r_[time[0], np.full(n_most, step)])
        even = even[even <= time[-1]]
        time, values = even, spline(time, values, even)
    if cutoff >= 0.5 / step:
        logger.warning(
            "the cutoff frequency of %g Hz is not below half the sampling frequency of %g Hz: %g Hz is "
            "taken, as OpenSim does",
            cutoff,
            1 / step,
            HIGHEST_CUTOFF / step,
        )
        cutoff = HIGHEST_CUTOFF / step
    for _ in range(2):
        values = _lowpass(values, step, cutoff)[::-1]
    return time, values


def _padded(values: FloatArray, n: int) -> FloatArray:
    """Continue columns by n rows on either side, turned about the first and the last value."""
    before, after = 2 * values[0] - values[n:0:-1], 2 * values[-1] - values[-2 : -2 - n : -1]
    return np.concatenate((before, values, after))


def _lowpass(values: FloatArray, step: float, cutoff: float) -> FloatArray:
    """Run a third-order Butterworth low-pass filter once; the first three rows stay as they are."""
    from scipy.linalg.lapack import dtbtrs

    w = np.tan(np.pi * cutoff * step)
    scale = (w + 1) * (w**2 + w + 1)
    numerator = w**3 / scale * np.array([1.0, 3.0, 3.0, 1.0])
    denominator = np.array(
        [
            1.0,
            (3 * w**3 + 2 * w**2 - 2 * w - 3) / scale,
            (3 * w**3 - 2 * w**2 - 2 * w + 3) / scale,
            (w - 1) * (w**2 - w + 1) / scale,
        ]
    )
    driven = values.copy()
    driven[3:] = sum(c * values[3 - lag : len(values) - lag] for lag, c in enumerate(numerator))
    # the recursion is forward substitution in a triangular matrix of four bands
    bands = np.repeat(denominator[:, None], len(values), axis=1)
    for lag in range(1, 4):
        bands[lag, : 3 - lag] = 0.0
    filtered, _ = dtbtrs(bands, driven, uplo="L")
    return np.asarray(filtered)
