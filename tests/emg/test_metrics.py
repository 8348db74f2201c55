"""Metrics against numbers worked out by hand and against SciPy."""

import math

import numpy as np
import pytest
import scipy.stats

from scso_nlp.emg import metrics
from scso_nlp.exceptions import DataError

PAIR_METRICS = [
    metrics.mean_absolute_difference,
    metrics.root_mean_square_error,
    metrics.pearson_correlation,
    metrics.common_activity,
    metrics.co_contraction,
    metrics.activity_ratio,
]
EXACT = 1e-12  # sums of a handful of doubles


def test_differences_of_three_frames_are_those_worked_out_by_hand():
    predicted, measured = np.array([0.0, 0.5, 1.0]), np.array([0.1, 0.3, 1.0])
    assert metrics.mean_absolute_difference(predicted, measured) == pytest.approx(0.1, abs=EXACT)
    assert metrics.root_mean_square_error(predicted, measured) == pytest.approx(
        math.sqrt(0.05 / 3), abs=EXACT
    )


def test_difference_of_a_silent_muscle_is_the_mean_emg_as_the_paper_finds():
    emg = np.array([0.037, 0.02, 0.05])
    assert metrics.mean_absolute_difference(np.zeros(3), emg) == pytest.approx(emg.mean(), abs=EXACT)


def test_pearson_equals_scipy_on_random_series(rng):
    for _ in range(20):
        a, b = rng.random((2, 50))
        assert metrics.pearson_correlation(a, b) == pytest.approx(scipy.stats.pearsonr(a, b)[0], abs=1e-12)


def test_pearson_ignores_gain_and_offset_but_not_sign(rng):
    a = rng.random(30)
    assert metrics.pearson_correlation(a, 3 * a + 2) == pytest.approx(1, abs=EXACT)
    assert metrics.pearson_correlation(a, 2 - a) == pytest.approx(-1, abs=EXACT)


def test_a_constant_series_has_no_correlation_and_says_so():
    with pytest.raises(DataError, match=r"predicted series is constant at 0, its correlation is not defined"):
        metrics.pearson_correlation(np.zeros(5), np.arange(5.0))


@pytest.mark.parametrize("late_frames", [-7, 0, 5])
def test_cross_correlation_recovers_a_known_delay_with_its_sign(late_frames, rng):
    time = np.arange(200) * 0.01
    signal = np.convolve(rng.random(260), np.ones(8) / 8, mode="same")
    measured, predicted = signal[30:230], signal[30 - late_frames : 230 - late_frames]
    found = metrics.cross_correlation(predicted, measured, time, max_lag=0.2)
    assert found.lag == pytest.approx(late_frames * 0.01, abs=1e-9)
    assert found.correlation == pytest.approx(1, abs=1e-9)


def test_cross_correlation_with_no_lag_allowed_is_pearson(rng):
    a, b = rng.random((2, 40))
    found = metrics.cross_correlation(a, b, np.arange(40.0), max_lag=0)
    assert found.correlation == pytest.approx(metrics.pearson_correlation(a, b), abs=EXACT)
    assert found.lag == 0


def test_cross_correlation_refuses_uneven_time_and_a_lag_longer_than_half_of_the_motion(rng):
    a, b = rng.random((2, 10))
    time = np.arange(10.0)
    with pytest.raises(DataError, match="at most half of the motion"):
        metrics.cross_correlation(a, b, time, max_lag=6)
    with pytest.raises(DataError, match="max_lag is -1"):
        metrics.cross_correlation(a, b, time, max_lag=-1)
    with pytest.raises(
        DataError, match=r"frames are 1 s apart, too coarse to look for a lag of at most 0\.2 s"
    ):
        metrics.cross_correlation(a, b, time, max_lag=0.2)
    time[6:] += 0.5
    with pytest.raises(DataError, match=r"not uniform: 1.5 s after t = 5 s"):
        metrics.cross_correlation(a, b, time, max_lag=1)


def test_co_contraction_indices_are_those_worked_out_by_hand():
    first, second = np.array([0.2, 0.4, 0.0]), np.array([0.1, 0.4, 0.3])
    # Falconer and Winter: 2 (.1 + .4 + 0) / (.3 + .8 + .3)
    assert metrics.common_activity(first, second) == pytest.approx(1.0 / 1.4, abs=EXACT)
    # Rudolph: (.5 * .3 + 1 * .8 + 0) / 3
    assert metrics.co_contraction(first, second) == pytest.approx(0.95 / 3, abs=EXACT)


def test_co_contraction_has_its_stated_extremes():
    ones, zeros = np.ones(4), np.zeros(4)
    assert metrics.common_activity(ones, ones) == 1
    assert metrics.common_activity(ones, zeros) == 0
    assert metrics.co_contraction(ones, ones) == 2
    assert metrics.co_contraction(ones, zeros) == 0
    assert metrics.co_contraction(zeros, zeros) == 0
    with pytest.raises(DataError, match="both groups are silent"):
        metrics.common_activity(zeros, zeros)


def test_common_activity_ignores_the_level_and_co_contraction_follows_it(rng):
    a, b = rng.random((2, 30))
    assert metrics.common_activity(a / 2, b / 2) == pytest.approx(metrics.common_activity(a, b), abs=EXACT)
    assert metrics.co_contraction(a / 2, b / 2) == pytest.approx(metrics.co_contraction(a, b) / 2, abs=EXACT)


def test_activity_ratio_is_the_ratio_of_means_not_the_mean_of_ratios():
    assert metrics.activity_ratio(np.array([0.1, 0.1]), np.array([0.001, 0.399])) == pytest.approx(0.5)
    with pytest.raises(DataError, match="silent throughout"):
        metrics.activity_ratio(np.ones(2), np.zeros(2))


@pytest.mark.parametrize("metric", PAIR_METRICS)
@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ([0.1, math.nan], [0.1, 0.2], "first series is nan at index"),
        ([0.1, 0.2], [math.inf, 0.2], "second series is inf at index"),
        ([0.1, 0.2, 0.3], [0.1, 0.2], "3 and 2 frames"),
        ([], [], "no frame"),
        ([[0.1]], [[0.1]], "has shape"),
    ],
)
def test_bad_series_are_refused_by_every_metric(metric, first, second, message):
    with pytest.raises(DataError, match=message):
        metric(np.array(first), np.array(second))


@pytest.mark.parametrize("metric", [metrics.common_activity, metrics.co_contraction, metrics.activity_ratio])
def test_negative_activity_is_refused(metric):
    with pytest.raises(DataError, match=r"second activity is -0.1 at frame 1"):
        metric(np.ones(2), np.array([0.1, -0.1]))
