"""Intervals and block lengths against what is known of white noise and autoregressions."""

import math

import numpy as np
import pytest
import scipy.signal

from scso_nlp.emg import metrics
from scso_nlp.emg.bootstrap import bootstrap_interval, optimal_block_length
from scso_nlp.exceptions import DataError

EXACT = 1e-12  # sums of a handful of doubles


def autoregression(rng, rho, n):
    """First-order autoregression, without its start."""
    return scipy.signal.lfilter([1.0], [1.0, -rho], rng.standard_normal(n + 1000))[1000:]


def test_bootstrap_is_repeatable_and_holds_its_value(rng):
    a, b = rng.random((2, 100))
    one = bootstrap_interval(metrics.root_mean_square_error, a, b, seed=3)
    again = bootstrap_interval(metrics.root_mean_square_error, a, b, seed=3)
    other = bootstrap_interval(metrics.root_mean_square_error, a, b, seed=4)
    assert one == again
    assert one.low != other.low
    assert one.low < one.value < one.high
    assert one.value == metrics.root_mean_square_error(a, b)


def test_bootstrap_of_a_constant_difference_has_no_width(rng):
    b = rng.random(50)
    interval = bootstrap_interval(metrics.mean_absolute_difference, b + 0.25, b)
    assert interval.low == pytest.approx(0.25, abs=EXACT)
    assert interval.high == pytest.approx(0.25, abs=EXACT)


def test_bootstrap_of_the_mean_has_the_textbook_width_for_independent_frames(rng):
    # mean of n independent |differences|: half width 1.96 s / sqrt(n); 1,000 resamples leave a few per cent
    a = rng.random(400)
    interval = bootstrap_interval(
        metrics.mean_absolute_difference, a, np.zeros(400), block_length=1, n_resamples=2000
    )
    expected = 2 * 1.96 * a.std() / math.sqrt(400)
    assert interval.high - interval.low == pytest.approx(expected, rel=0.1)


def test_blocks_widen_the_interval_of_a_slow_signal_and_its_coverage_is_about_right(rng):
    # first-order autoregression, rho = 0.9: the mean's standard error is sqrt((1 + rho)/(1 - rho)) = 4.4
    # times that of independent frames. Coverage of 95 % intervals from blocks is known to be a little low.
    rho, n, trials = 0.9, 400, 60
    hits = {"blocks": 0, "single frames": 0}
    for _ in range(trials):
        series = autoregression(rng, rho, n) + 50.0  # far from zero, so that |difference| is the series
        for name, block in (("blocks", None), ("single frames", 1)):
            interval = bootstrap_interval(
                metrics.mean_absolute_difference, series, np.zeros(n), block_length=block, n_resamples=200
            )
            hits[name] += interval.low <= 50.0 <= interval.high
    assert hits["blocks"] >= 0.8 * trials
    assert hits["single frames"] <= 0.6 * trials


def frames_drawn(n, block_length, n_resamples=100):
    """Frames of every resample, seen by a metric that keeps what it is given."""
    drawn = []

    def metric(first, second):
        drawn.append(first.astype(int))
        return float(second.mean())

    bootstrap_interval(
        metric, np.arange(float(n)), np.ones(n), block_length=block_length, n_resamples=n_resamples
    )
    assert drawn[0].tolist() == list(range(n))
    return np.array(drawn[1:])


def test_blocks_are_whole_and_go_round():
    frames = frames_drawn(23, 5)
    assert frames.shape == (100, 23)
    steps = np.diff(frames, axis=1) % 23
    inside = np.arange(1, 23) % 5 != 0
    assert (steps[:, inside] == 1).all()
    assert (np.diff(frames, axis=1)[:, inside] < 0).any()


def test_the_frames_at_both_ends_are_drawn_as_often_as_all_others():
    n, block_length, n_resamples = 40, 10, 4000
    counts = np.bincount(frames_drawn(n, block_length, n_resamples).ravel(), minlength=n)
    # 4 blocks of 10 of 40 frames: every frame is hit Binomial(4, 1/4) times in a resample; six standard
    # deviations of the sum. Without going round the first and the last frame would be drawn a third as often.
    assert np.abs(counts - n_resamples).max() < 6 * math.sqrt(4 * 0.25 * 0.75 * n_resamples)


def test_blocks_are_as_long_as_the_slower_of_both_series_asks_for(rng):
    slow, fast = autoregression(rng, 0.9, 400), autoregression(rng, 0.0, 400)
    lengths = {
        bootstrap_interval(metrics.mean_absolute_difference, first, second, n_resamples=100).block_length
        for first, second in ((slow, fast), (fast, slow))
    }
    assert lengths == {optimal_block_length(slow)}
    assert optimal_block_length(slow) > 10


def test_frames_without_memory_are_blocks_of_their_own(rng):
    # at 1000 frames each of five autocorrelations passes 3.5 standard errors once in 2000 series
    lengths = [optimal_block_length(rng.standard_normal(1000)) for _ in range(40)]
    assert lengths.count(1) >= 38


@pytest.mark.parametrize(
    ("rho", "n"), [(0.5, 20000), (-0.5, 20000), (0.8, 20000), (0.9, 40000), (0.8, 160000)]
)
def test_the_block_length_of_an_autoregression_is_its_closed_form(rho, n, rng):
    # R(k) = rho^|k|: G = 2 rho / (1 - rho)^2 and g(0) = (1 + rho) / (1 - rho)
    expected = (6 * rho**2 / (1 - rho**2) ** 2 * n) ** (1 / 3)
    found = np.median([optimal_block_length(autoregression(rng, rho, n)) for _ in range(7)])
    # the truncated sum and the estimated autocovariance cost some per cent at this many frames
    assert found == pytest.approx(expected, rel=0.12)


def test_the_block_length_follows_the_formula_as_printed(rng):
    series = autoregression(rng, 0.6, 300)
    n, mean = len(series), series.mean()

    def covariance(k):
        return sum((series[i] - mean) * (series[i + abs(k)] - mean) for i in range(n - abs(k))) / n

    band = 2 * math.sqrt(math.log10(n) / n)
    m = next(m for m in range(n) if all(abs(covariance(m + k) / covariance(0)) < band for k in range(1, 6)))

    def window(t):
        return 1 if abs(t) <= 0.5 else 2 * (1 - abs(t))

    lags = range(-2 * m, 2 * m + 1)
    slope = sum(window(k / (2 * m)) * abs(k) * covariance(k) for k in lags)
    spectrum = sum(window(k / (2 * m)) * covariance(k) for k in lags)
    expected = (2 * slope**2 / (4 / 3 * spectrum**2) * n) ** (1 / 3)
    assert 1 < m < 12
    assert optimal_block_length(series) == math.ceil(expected)


@pytest.mark.parametrize(("n", "period", "longest"), [(30, 10, 10), (114, 20, 33), (400, 20, 60)])
def test_the_block_length_has_its_limits(n, period, longest):
    # a lasting oscillation has a memory without end
    assert optimal_block_length(np.sin(2 * np.pi * np.arange(n) / period)) == longest
    assert longest == math.ceil(min(3 * math.sqrt(n), n / 3)) <= n // 2
    assert optimal_block_length(np.full(n, 0.3)) == 1
    assert optimal_block_length(np.full(1, 0.3)) == 1
    assert 1 <= optimal_block_length(np.array([0.0, 1.0, 0.5, 0.2])) <= 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"block_length": 0}, "block_length is 0, expected 1 to 10"),
        ({"block_length": 11}, "block_length is 11"),
        ({"n_resamples": 10}, "n_resamples is 10"),
        ({"confidence": 1.0}, "confidence is 1.0"),
    ],
)
def test_bootstrap_refuses_options_out_of_range(options, message, rng):
    a, b = rng.random((2, 20))
    with pytest.raises(DataError, match=message):
        bootstrap_interval(metrics.mean_absolute_difference, a, b, **options)


def test_bootstrap_refuses_a_metric_that_is_mostly_undefined():
    blip = np.zeros(40)
    blip[7] = 1.0
    with pytest.raises(DataError, match="not defined in"):
        bootstrap_interval(metrics.pearson_correlation, blip, np.arange(40.0), block_length=10)
