"""How like two series are, and how much two opposing groups work against each other.

Every function takes plain arrays of one motion and gives one number; :mod:`scso_nlp.emg.bootstrap` puts an
interval around any of them. Which series belong together is decided in :mod:`scso_nlp.emg.comparison`.

The activity ratios of the paper (its equations 5 to 9) are not reproduced by number: their print was not at
hand. What is known are the quantities it reports; the definitions below that are inferred from them say so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.trajectory import time_text
from scso_nlp.validation import FloatArray, read_only

#: A series whose range is below this share of its largest value is constant: it has no correlation [-].
CONSTANT_SERIES = 1e-9
#: Smallest share of the frames that must overlap at the largest lag of a cross-correlation [-].
MIN_OVERLAP = 0.5
#: Steps of time may differ by this share of their median and still count as uniform [-].
UNIFORM_STEP = 0.05


def mean_absolute_difference(predicted: FloatArray, measured: FloatArray) -> float:
    r"""Average the absolute difference: the paper's measure of agreement with EMG.

    .. math:: \frac1N \sum_k |a_k - e_k|

    Parameters
    ----------
    predicted, measured : ndarray, shape (n_frames,) [-]

    Returns
    -------
    float [-]
        In the unit of the series; 0 where they are equal.

    Raises
    ------
    DataError
        Empty, of different length, or not finite.

    References
    ----------
    Akhavanfar et al. (2019), J Biomech, doi 10.1016/j.jbiomech.2019.05.007.
    """
    predicted, measured = same_frames(predicted, measured)
    return float(np.abs(predicted - measured).mean())


def root_mean_square_error(predicted: FloatArray, measured: FloatArray) -> float:
    r"""Root of the mean squared difference.

    .. math:: \sqrt{\tfrac1N \sum_k (a_k - e_k)^2}

    Parameters
    ----------
    predicted, measured : ndarray, shape (n_frames,) [-]

    Returns
    -------
    float [-]
        In the unit of the series.

    Raises
    ------
    DataError
        Empty, of different length, or not finite.
    """
    predicted, measured = same_frames(predicted, measured)
    return float(np.sqrt(np.mean((predicted - measured) ** 2)))


def pearson_correlation(predicted: FloatArray, measured: FloatArray) -> float:
    r"""Pearson's r at no lag.

    .. math:: r = \frac{\sum_k (a_k - \bar a)(e_k - \bar e)}
                       {\sqrt{\sum_k (a_k - \bar a)^2 \sum_k (e_k - \bar e)^2}}

    Parameters
    ----------
    predicted, measured : ndarray, shape (n_frames,) [-]

    Returns
    -------
    float [-]
        -1 to 1.

    Raises
    ------
    DataError
        Empty, of different length, not finite, or one of them constant: a muscle that stays silent has no
        correlation with anything, which is not the same as a correlation of zero.
    """
    predicted, measured = same_frames(predicted, measured)
    for name, series in (("predicted", predicted), ("measured", measured)):
        if is_constant(series):
            raise DataError(
                f"the {name} series is constant at {series[0]:g}, its correlation is not defined; "
                "use a difference instead"
            )
    return _correlation(predicted, measured)


def is_constant(series: FloatArray) -> bool:
    """Tell if a series does not vary, so that its correlation is not defined.

    Parameters
    ----------
    series : ndarray, shape (n_frames,) [any]

    Returns
    -------
    bool
    """
    return bool(np.ptp(series) <= CONSTANT_SERIES * max(1.0, float(np.abs(series).max())))


@dataclass(frozen=True, kw_only=True)
class CrossCorrelation:
    """Best agreement in shape when one series may be shifted.

    Attributes
    ----------
    correlation : float [-]
        Pearson's r at `lag`.
    lag : float [s]
        Positive where the prediction comes later than the measurement. EMG runs ahead of force, so a
        prediction made from joint moments is expected to be late by the electromechanical delay.
    """

    correlation: float
    lag: float


def cross_correlation(
    predicted: FloatArray, measured: FloatArray, time: FloatArray, *, max_lag: float
) -> CrossCorrelation:
    """Find the lag at which two series correlate best.

    At every lag Pearson's r is taken over the frames that overlap, so that a shift is not punished by the
    frames it loses. Of equally good lags the shortest is reported.

    Parameters
    ----------
    predicted, measured : ndarray, shape (n_frames,) [-]
    time : ndarray, shape (n_frames,) [s]
        Uniform within 5 % of its median step.
    max_lag : float [s]
        Longest shift tried in both directions, at most half of the motion.

    Returns
    -------
    CrossCorrelation

    Raises
    ------
    DataError
        Time is not uniform, `max_lag` is negative or too long, or as :func:`pearson_correlation`.
    """
    predicted, measured = same_frames(predicted, measured)
    time = read_only("time", time, (len(predicted),), "n_frames")
    if len(time) < 3:
        raise DataError(f"cross-correlation of {len(time)} frames, expected at least 3")
    steps = np.diff(time)
    step = float(np.median(steps))
    uneven = np.flatnonzero(np.abs(steps - step) > UNIFORM_STEP * step)
    if len(uneven):
        k = int(uneven[0])
        raise DataError(
            f"time is not uniform: {steps[k]:g} s after t = {time_text(time[k])} s where the median step is "
            f"{step:g} s"
            "; resample on a uniform grid before looking for a lag"
        )
    if not max_lag >= 0:
        raise DataError(f"max_lag is {max_lag}, expected 0 s or more")
    most = math.floor(max_lag / step + 1e-9)
    if max_lag > 0 and most == 0:
        raise DataError(f"frames are {step:g} s apart, too coarse to look for a lag of at most {max_lag:g} s")
    if most > (1 - MIN_OVERLAP) * len(time):
        raise DataError(
            f"max_lag is {max_lag:g} s, expected at most half of the motion's {time[-1] - time[0]:g} s"
        )
    zero = pearson_correlation(predicted, measured)
    best = CrossCorrelation(correlation=zero, lag=0.0)
    for shift in sorted(range(-most, most + 1), key=abs):
        late, early = (predicted, measured) if shift >= 0 else (measured, predicted)
        n = abs(shift)
        late, early = late[n:], early[: len(early) - n]
        if is_constant(late) or is_constant(early):
            continue
        r = _correlation(late, early)
        if r > best.correlation + 1e-12:
            best = CrossCorrelation(correlation=r, lag=shift * step)
    return best


def common_activity(first: FloatArray, second: FloatArray) -> float:
    r"""Share of the activity of two opposing groups that is common to both: Falconer and Winter's index.

    .. math:: \mathrm{CCI} = \frac{2 \sum_k \min(a_k, b_k)}{\sum_k (a_k + b_k)}

    Parameters
    ----------
    first, second : ndarray, shape (n_frames,) [-]
        Activity of the two groups, not negative.

    Returns
    -------
    float [-]
        0 where they never work together, 1 where they are equal throughout.

    Raises
    ------
    DataError
        Empty, of different length, not finite, negative, or both silent throughout.

    Notes
    -----
    Frames weigh equally (uniform time). The original takes for the antagonist the group that opposes the net
    moment; as is now common, the less active group of each frame is taken here, so that no moment is needed.

    References
    ----------
    Falconer and Winter (1985), Electromyogr Clin Neurophysiol 25:135-149; compared with the next by
    Li et al. (2020), Front Bioeng Biotechnol 8:588908.
    """
    first, second = _activities(first, second)
    total = float((first + second).sum())
    if total == 0:
        raise DataError("both groups are silent throughout, their common activity is not defined")
    return float(2 * np.minimum(first, second).sum() / total)


def co_contraction(first: FloatArray, second: FloatArray) -> float:
    r"""Mean magnitude of working against each other: Rudolph's index.

    .. math:: \mathrm{CCI} = \frac1N \sum_k \frac{\min(a_k, b_k)}{\max(a_k, b_k)} (a_k + b_k)

    Parameters
    ----------
    first, second : ndarray, shape (n_frames,) [-]
        Activity of the two groups, not negative.

    Returns
    -------
    float [-]
        0 where one of them is always silent, 2 where both are fully active throughout. Unlike
        :func:`common_activity` it grows with the level of activity.

    Raises
    ------
    DataError
        Empty, of different length, not finite, or negative.

    Notes
    -----
    A frame in which both are silent counts as zero, the limit of the formula.

    References
    ----------
    Rudolph, Axe and Snyder-Mackler (2000), Knee Surg Sports Traumatol Arthrosc 8:262-269.
    """
    first, second = _activities(first, second)
    low, high = np.minimum(first, second), np.maximum(first, second)
    balance = np.divide(low, high, out=np.zeros_like(low), where=high > 0)
    return float((balance * (low + high)).mean())


def activity_ratio(numerator: FloatArray, denominator: FloatArray) -> float:
    r"""Mean activity of one group over that of another, e.g. abdominal over back muscles.

    .. math:: \rho = \frac{\sum_k a_k}{\sum_k b_k}

    Parameters
    ----------
    numerator, denominator : ndarray, shape (n_frames,) [-]
        Mean activity of the muscles of each group, not negative.

    Returns
    -------
    float [-]

    Raises
    ------
    DataError
        Empty, of different length, not finite, negative, or the denominator silent throughout.

    Notes
    -----
    Inferred: the paper reports the error of an abdominal/back ratio for each static task; with one frame
    this is the ratio of the two group means. Over a motion the means are taken first, because the mean of
    ratios is ruled by the frames in which the denominator is nearly silent.
    """
    numerator, denominator = _activities(numerator, denominator)
    total = float(denominator.sum())
    if total == 0:
        raise DataError("the denominator of the activity ratio is silent throughout")
    return float(numerator.sum() / total)


def _correlation(first: FloatArray, second: FloatArray) -> float:
    first, second = first - first.mean(), second - second.mean()
    r = float(first @ second) / math.sqrt(float(first @ first) * float(second @ second))
    return min(1.0, max(-1.0, r))


def same_frames(first: object, second: object) -> tuple[FloatArray, FloatArray]:
    """Check that two series have the same frames, at least one; shape (n_frames,) each."""
    one = read_only("first series", first, (-1,), "n_frames")
    other = read_only("second series", second, (-1,), "n_frames")
    if len(one) != len(other):
        raise DataError(f"the series have {len(one)} and {len(other)} frames, expected the same frames")
    if len(one) == 0:
        raise DataError("the series have no frame, expected at least one")
    return one, other


def _activities(first: object, second: object) -> tuple[FloatArray, FloatArray]:
    one, other = same_frames(first, second)
    for name, series in (("first", one), ("second", other)):
        if (series < 0).any():
            k = int(np.argmin(series))
            raise DataError(f"the {name} activity is {series[k]:g} at frame {k}, expected 0 or more")
    return one, other
