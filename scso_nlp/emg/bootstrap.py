"""How sure a metric of two series is: blocks of frames drawn again and again, as long as their memory."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scso_nlp.emg.metrics import is_constant, same_frames
from scso_nlp.exceptions import DataError
from scso_nlp.validation import FloatArray, read_only

#: Autocorrelations below this many standard errors under no memory, times sqrt(log10 N), are negligible [-]:
#: c of Politis and White (2004).
_NEGLIGIBLE = 2.0
#: So many lags in a row must be negligible for the memory to end: K_N there, for less than 10^25 frames.
_QUIET_LAGS = 5


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A number with its bootstrap interval.

    Attributes
    ----------
    value : float
        From all frames.
    low, high : float
        Percentile interval of the resampled numbers.
    block_length : int
        Frames per block.
    n_resamples : int
        Resamples in which the number was defined.
    """

    value: float
    low: float
    high: float
    block_length: int
    n_resamples: int


def bootstrap_interval(
    metric: Callable[[FloatArray, FloatArray], float],
    first: FloatArray,
    second: FloatArray,
    *,
    block_length: int | None = None,
    n_resamples: int = 1000,
    confidence: float = 0.95,
    seed: int = 0,
) -> Interval:
    """Put an interval around a metric of two series by the circular block bootstrap.

    Whole blocks of consecutive frames are drawn with replacement, the same for both series, because
    neighboring frames of a motion are not independent: drawing single frames would give intervals that are
    far too narrow. A block that runs over the end goes on at the first frame, so that the frames at both ends
    are drawn as often as all others.

    Parameters
    ----------
    metric : function of two ndarrays of shape (n_frames,), returns float
        Must not depend on the order of frames (not a lag).
    first, second : ndarray, shape (n_frames,) [-]
    block_length : int, optional
        Frames per block, 1 to half of the frames; by default :func:`optimal_block_length` of the slower of
        both series.
    n_resamples : int
        At least 100.
    confidence : float [-]
        Share of the resamples inside the interval, between 0 and 1.
    seed : int
        The same seed gives the same interval.

    Returns
    -------
    Interval

    Raises
    ------
    DataError
        Fewer than 4 frames, an option out of range, or a metric that is not defined in more than a tenth of
        the resamples.

    Notes
    -----
    The interval speaks of other stretches of the same motion of the same person. It says nothing about other
    trials or other people.

    References
    ----------
    Politis and Romano (1992), A circular block-resampling procedure for stationary data, in LePage and
    Billard (eds), Exploring the Limits of Bootstrap, Wiley, 263-270.
    """
    first, second = same_frames(first, second)
    n_frames = len(first)
    if n_frames < 4:
        raise DataError(f"a bootstrap interval from {n_frames} frames, expected at least 4")
    if block_length is None:
        block_length = max(optimal_block_length(first), optimal_block_length(second))
    if not 1 <= block_length <= n_frames // 2:
        raise DataError(f"block_length is {block_length}, expected 1 to {n_frames // 2} frames")
    if n_resamples < 100:
        raise DataError(f"n_resamples is {n_resamples}, expected at least 100")
    if not 0 < confidence < 1:
        raise DataError(f"confidence is {confidence}, expected a share between 0 and 1")
    value = metric(first, second)
    random = np.random.default_rng(seed)
    n_blocks = -(-n_frames // block_length)
    numbers = []
    for _ in range(n_resamples):
        starts = random.integers(0, n_frames, size=n_blocks)
        frames = (starts[:, None] + np.arange(block_length)).ravel()[:n_frames] % n_frames
        try:
            numbers.append(metric(first[frames], second[frames]))
        except DataError:
            continue
    if len(numbers) < 0.9 * n_resamples:
        raise DataError(
            f"the metric is not defined in {n_resamples - len(numbers)} of {n_resamples} resamples, "
            "its interval would mislead"
        )
    tail = 50 * (1 - confidence)
    low, high = np.percentile(numbers, (tail, 100 - tail))
    return Interval(
        value=value, low=float(low), high=float(high), block_length=block_length, n_resamples=len(numbers)
    )


def optimal_block_length(series: FloatArray) -> int:
    r"""Choose the frames per block for the circular block bootstrap from the autocovariance of a series.

    .. math:: b = \left\lceil \left(\frac{2 G^2}{\tfrac43 g(0)^2} N\right)^{1/3} \right\rceil, \quad
              G = \sum_{|k| \le M} \lambda(k/M)\, |k|\, R(k), \quad
              g(0) = \sum_{|k| \le M} \lambda(k/M)\, R(k)

    with the autocovariance R, the flat-top window :math:`\lambda(t) = \min(1, 2(1 - |t|))`, and M twice the
    lag after which five autocorrelations in a row are negligible. Without memory b is 1; for a first-order
    autoregression of coefficient :math:`\rho` it tends to
    :math:`\left(6 \rho^2 / (1 - \rho^2)^2\, N\right)^{1/3}`.

    Parameters
    ----------
    series : ndarray, shape (n_frames,) [any]

    Returns
    -------
    int [frames]
        1 to the lesser of :math:`3 \sqrt N` and a third of the frames.

    Notes
    -----
    It is the length that estimates the variance of a mean best; for other metrics it is a guide.

    References
    ----------
    Politis and White (2004), Econometric Reviews 23:53-70, with the correction by Patton, Politis and White
    (2009), Econometric Reviews 28:372-375, which concerns the stationary bootstrap and leaves this formula as
    it was. The upper limit is that of Patton's program.
    """
    series = read_only("series", series, (-1,), "n_frames")
    n = len(series)
    if n < 2 or is_constant(series):
        return 1
    longest = math.ceil(min(3 * math.sqrt(n), n / 3))
    most = min(math.ceil(math.sqrt(n)) + _QUIET_LAGS, n - 1)
    centered = series - series.mean()
    covariance = np.array([centered[k:] @ centered[: n - k] for k in range(most + 1)])
    negligible = np.abs(covariance[1:]) < _NEGLIGIBLE * math.sqrt(math.log10(n) / n) * covariance[0]
    ends = [m for m in range(most - _QUIET_LAGS + 1) if negligible[m : m + _QUIET_LAGS].all()]
    lag = np.arange(1, min(2 * ends[0] if ends else most, most) + 1)
    window = np.minimum(1.0, 2 * (1 - lag / lag.size))
    slope = 2 * float(window @ (lag * covariance[lag]))
    spectrum = float(covariance[0] + 2 * window @ covariance[lag])
    if spectrum <= 0:
        return longest
    return max(1, min(longest, math.ceil((1.5 * (slope / spectrum) ** 2 * n) ** (1 / 3))))
