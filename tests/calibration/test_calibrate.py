"""Calibration against closed forms and differences; what is left out is never seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import central_difference, random_problem, two_antagonists

import scso_nlp as scso
from scso_nlp.calibration.calibrate import _Trial, with_values

#: Moments of the pair of antagonists [N·m], which both pull at any gain that is tried.
MOMENTS = np.array([2.0, 4.0, 5.0, 3.0, 1.0, 4.5])
#: True gain, and that from which searches begin.
TRUE, START = 5.0, 7.0


def activities(moments, q):
    """Closed form of the pair: F1 - F2 = M / r, and (F1 + F2) (q - 1) r²/L = EW; 2000 N each."""
    both = 30.0 / (0.0125 * (q - 1))
    apart = np.asarray(moments) / 0.05
    return np.column_stack([both + apart, both - apart]) / 2 / 2000.0


def gain_for(values):
    """Least squares by hand: moments fix the difference of both, q their sum, 1.2 / (q - 1)."""
    return 1 + 1.2 / np.concatenate(values).sum(axis=1).mean()


def emg(values, compare="levels", groups=("right", "left"), muscles=(("m1",), ("m2",))):
    time = 0.01 * np.arange(len(values))
    activity = scso.MuscleActivity(groups=groups, muscles=muscles, time=time, values=values)
    return scso.MeasuredEmg(activity=activity, compare=compare)


def trial(moments, measured, unit="", **changes):
    problem = two_antagonists(moments, **{"q": START, **changes})
    return scso.MeasuredTrial(problem=problem, measured=measured, unit=unit)


def noisy(rng, n, deviation=0.01):
    """As many times the activity that belongs to the true gain, with noise."""
    return [activities(MOMENTS, TRUE) + rng.normal(0, deviation, (len(MOMENTS), 2)) for _ in range(n)]


def strides(values):
    """One trial of as many units, one after the other."""
    unit = np.repeat([f"stride {i}" for i in range(len(values))], len(MOMENTS)).tolist()
    return {"walk": trial(np.tile(MOMENTS, len(values)), emg(np.concatenate(values)), unit=unit)}


def test_a_known_gain_is_recovered_from_noisy_emg_with_the_bias_and_spread_of_the_closed_form():
    """Noise 0.01 on activities of 0.12 to 0.18, six frames: q = 5 ± 0.08 and a bias below 0.01."""
    rng = np.random.default_rng(3)
    draws = [noisy(rng, 1) for _ in range(4)]
    found = np.array([scso.calibrate(strides(values), same_data=True).value[0] for values in draws])
    np.testing.assert_allclose(found, [gain_for(values) for values in draws], rtol=1e-6)
    # whose bias and spread many draws tell
    many = np.array([gain_for(noisy(rng, 1)) for _ in range(4000)])
    assert abs(many.mean() - TRUE) < 0.01
    assert many.std() == pytest.approx((TRUE - 1) ** 2 / 1.2 * 0.01 / np.sqrt(2 * 6) * 2, rel=0.05)
    assert abs(found.mean() - TRUE) < 3 * many.std() / np.sqrt(4)


def check_left_out(found, values, units):
    """Hold what was found against the closed form; `units` tells the unit of each of the values."""
    np.testing.assert_allclose(found.value, [gain_for(values)], rtol=1e-6)
    for u, q in enumerate(found.value_without[:, 0]):
        others = [v for v, unit in zip(values, units, strict=True) if unit != u]
        assert q == pytest.approx(gain_for(others), rel=1e-6)
        own = [v for v, unit in zip(values, units, strict=True) if unit == u]
        assert found.error[u] == pytest.approx(
            np.mean([((activities(MOMENTS, q) - v) ** 2).mean() for v in own]), rel=1e-5
        )
    n = len(found.units)
    jackknife = np.sqrt((n - 1) / n * ((found.value_without - found.value_without.mean()) ** 2).sum())
    assert found.standard_error[0] == pytest.approx(jackknife)


def test_trials_of_a_person_are_left_out_together():
    values = noisy(np.random.default_rng(4), 3)
    trials = {f"t{i}": trial(MOMENTS, emg(v), unit=f"person {i % 2}") for i, v in enumerate(values)}
    found = scso.calibrate(trials)
    assert found.units == ("person 0", "person 1")
    check_left_out(found, values, [0, 1, 0])


@pytest.fixture(scope="module")
def walk():
    """Activity of three strides, and what is found from them."""
    values = noisy(np.random.default_rng(5), 3)
    return values, scso.calibrate(strides(values))


def test_what_is_found_without_a_stride_does_not_depend_on_it(walk):
    values, before = walk
    check_left_out(before, values, [0, 1, 2])
    other = np.random.default_rng(6).uniform(0.0, 1.0, values[1].shape)
    after = scso.calibrate(strides([values[0], other, values[2]]))
    same = before.value_without == after.value_without
    assert same.ravel().tolist() == [False, True, False]
    assert before.error[1] != after.error[1]
    assert before.value != after.value


def soft_problem(law=None):
    """Random rows, raised by 80 N·m/rad at a price, so that gains and levels change the answer."""
    problem = random_problem(np.random.default_rng(3), n_frames=6, n_muscles=8, reserve=5.0)
    balance, rows = problem.constraints
    changes = {"level": {row: level + 80.0 for row, level in rows.level.items()}, "soft": 0.01}
    changes |= {} if law is None else {"q": None, "stiffness": law}
    return dataclasses.replace(problem, constraints=(balance, dataclasses.replace(rows, **changes)))


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        ("levels", None),
        ("shapes", None),
        ("shapes", scso.FallingStiffness(q=5.0, half_force=0.5)),
        ("stiffness", None),
    ],
)
def test_slopes_are_those_of_differences(kind, law):
    rng = np.random.default_rng(11)
    problem = soft_problem(law)
    names = problem.motion.muscles.muscles
    if kind == "stiffness":
        measured = scso.MeasuredStiffness(stiffness=400.0, arms={"elbow_x": 0.4, "elbow_z": 1.0})
    else:
        groups = (names[:3], names[3:5], names[6:])
        measured = emg(rng.uniform(0.1, 0.6, (6, 3)), kind, ("a", "b", "c"), groups)
    chosen = [scso.Parameter.of_text(p) for p in ("q[m1,m2,m3]", "q[m4,m5,m6,m7,m8]", "level[elbow_z]")]
    each = _Trial("t", scso.MeasuredTrial(problem=problem, measured=measured), chosen, None)
    values = np.array([6.0, 5.0, -102.8])
    assert each.is_regular(values).all()
    slopes = each.slopes(values)
    assert (np.abs(slopes).max(axis=0) > 1e-6).all()
    differences = central_difference(each.residuals, values, 1e-4)
    np.testing.assert_allclose(slopes, differences, atol=2e-6 * np.abs(slopes).max())


def test_the_error_of_shapes_is_one_minus_the_correlation():
    rng = np.random.default_rng(6)
    values = rng.uniform(0.1, 0.3, (len(MOMENTS), 2))
    found = scso.calibrate({"a": trial(MOMENTS, emg(values, "shapes"), q=TRUE)}, same_data=True)
    modeled = activities(MOMENTS, TRUE)
    r = [np.corrcoef(modeled[:, g], values[:, g])[0, 1] for g in range(2)]
    assert found.error_at_start[0] == pytest.approx(1 - np.mean(r), abs=1e-6)


def test_a_frame_in_a_kink_has_no_slope_and_is_counted():
    # at M = r EW / ((q - 1) r²/L) the antagonist begins to pull
    kinked = trial([10.0, 30.0], emg(np.full((2, 2), 0.2)), q=TRUE)
    each = _Trial("t", kinked, [scso.Parameter(quantity="q")], None)
    slopes = each.slopes(np.array([TRUE])).reshape(2, 2)
    assert each.is_regular(np.array([TRUE])).tolist() == [True, False]
    assert (slopes[0] != 0).all()
    assert (slopes[1] == 0).all()
    # M / r = EW L / r² / (q - 1) at the kink of the second
    at = scso.calibrate({"a": trial([30.0], emg(activities([30.0], TRUE)), q=TRUE)}, same_data=True)
    assert (at.n_frames, at.n_without_derivatives) == (1, 1)
    assert "1 of 1 frames have no derivative" in repr(at)


def test_what_the_data_do_not_tell_is_said():
    # without work of loads the rows are kept anyway
    idle = trial(MOMENTS, emg(np.full((6, 2), 0.1)), external_work=0.0)
    found = scso.calibrate({"a": idle}, same_data=True)
    assert found.is_flat.all()
    assert "which the data do not tell" in repr(found)
    assert np.isnan(found.standard_error).all()
    strong = scso.calibrate({"a": trial(MOMENTS, emg(np.zeros((6, 2))))}, same_data=True)
    assert strong.is_at_bound.all()
    assert strong.value[0] == pytest.approx(42.0, rel=1e-3)
    weak = {"a": trial(MOMENTS, emg(np.full((6, 2), 0.5)))}
    assert scso.calibrate(weak, bounds={"q": (3.0, 20.0)}, same_data=True).value[0] == pytest.approx(3.0)


def test_gains_meet_a_stiffness_that_was_measured_at_two_efforts():
    """Stiffness of Gardner-Morse and Stokes (2001) at a point 0.05 m off the axis, without work of loads."""
    measured, moments, arm = np.array([14500.0, 19800.0]), np.array([20.0, 40.0]), 0.05
    trials = {
        f"{moment:g} N·m": trial(
            [moment], scso.MeasuredStiffness(stiffness=k, arms={"elbow_z": arm}), external_work=0.0
        )
        for moment, k in zip(moments, measured, strict=True)
    }
    # S = M / r (q - 1) r²/L of the one muscle that pulls; k = S / arm²
    per_gain = moments / 0.05 * 0.0125 / arm**2 / measured
    expected = 1 + per_gain.sum() / (per_gain**2).sum()
    found = scso.calibrate(trials, same_data=True)
    assert found.value[0] == pytest.approx(expected, rel=1e-5)
    one_by_one = scso.calibrate(trials)
    np.testing.assert_allclose(one_by_one.value_without[:, 0], 1 + 1 / per_gain[::-1], rtol=1e-5)
    assert np.isnan(one_by_one.error_of_plain).all()
    exact = scso.solve_trajectory(one_by_one.applied(trials["20 N·m"].problem))
    assert scso.MeasuredStiffness(stiffness=1.0, arms={"elbow_z": 1.0}).of(exact) == pytest.approx(
        20.0 / 0.05 * 0.0125 * (found.value[0] - 1), rel=1e-5
    )


def test_rows_in_series_are_softer_than_each():
    solution = scso.solve_trajectory(soft_problem())
    arms = {"elbow_y": 0.2, "elbow_x": 0.3}
    values = dict(
        zip(("elbow_x", "elbow_y", "elbow_z"), solution.rows["JointStability"].value.T, strict=True)
    )
    expected = 1 / sum(arm**2 / values[row] for row, arm in arms.items())
    np.testing.assert_allclose(scso.MeasuredStiffness(stiffness=1.0, arms=arms).of(solution), expected)


@pytest.mark.parametrize(
    ("q", "given", "expected"),
    [
        (5.0, "q", 7.0),
        (5.0, "q[m1]", {"*": 5.0, "m1": 7.0}),
        ({"m*": 4.0, "m2": 3.0}, "q[m2]", {"m*": 4.0, "m2": 7.0}),
        ([1.0, 2.0], "q[m?]", {"m1": 1.0, "m2": 2.0, "m?": 7.0}),
    ],
)
def test_numbers_go_to_where_they_belong(q, given, expected):
    problem = with_values(two_antagonists([3.0], q=q), [scso.Parameter.of_text(given)], [7.0])
    assert problem.stability_terms[0].q == expected
    law = scso.FallingStiffness(q=q)
    rows = dataclasses.replace(problem.stability_terms[0], q=None, stiffness=law, level={"elbow_z": 2.0})
    problem = dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
    parameters = [scso.Parameter.of_text(given), scso.Parameter(quantity="level", of="elbow_*")]
    changed = with_values(problem, parameters, [7.0, 3.0]).stability_terms[0]
    assert changed.stiffness == scso.FallingStiffness(q=expected)
    assert changed.level == {"elbow_z": 2.0, "elbow_*": 3.0}


def test_a_calibration_shows_itself_and_makes_a_table(walk):
    pandas = pytest.importorskip("pandas")
    _, found = walk
    lines = repr(found).splitlines()
    assert lines[0] == "Calibration of q"
    assert lines[1].startswith("  q = ")
    assert "each left out once, 3 units" in lines[2]
    table = found.to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns) == ["error", "at_start", "of_plain", "q"]
    np.testing.assert_array_equal(table["q"], found.value_without[:, 0])


STIFF = scso.MeasuredStiffness(stiffness=100.0, arms={"elbow_z": 1.0})
EMG = emg(np.full((6, 2), 0.1))


@pytest.mark.parametrize(
    ("trials", "given", "words"),
    [
        ({}, {}, "there is no trial"),
        ({"a": EMG}, {"parameters": []}, "there is no parameter"),
        ({"a": EMG}, {}, "there is one unit, 'a', expected two at least to leave one out; same_data"),
        ({"a": EMG, "b": STIFF}, {}, "have measured different things"),
        ({"a": EMG}, {"parameters": ["weights"]}, "weights cannot be calibrated, expected a gain"),
        ({"a": EMG}, {"parameters": ["q[m1,m2]", "q[m2]"]}, "m2 stands in two parameters, one is q.m2."),
        ({"a": EMG}, {"parameters": ["q[m9]"]}, "m9"),
        ({"a": EMG}, {"parameters": ["level[knee]"]}, "knee"),
        ({"a": EMG}, {"bounds": {"Q": (1.0, 2.0)}}, "Q"),
        ({"a": EMG}, {"bounds": {"q": (0.0, 2.0)}}, "bounds of q are 0 and 2, expected positive"),
        ({"a": EMG}, {"bounds": {"q": (1.0, 1.1)}, "same_data": True}, "6 of 6 frames have no answer at q ="),
        ({"a": emg(np.full((6, 2), 0.1), "shapes")}, {"same_data": True}, "does not change, it has no shape"),
        ({"a": emg(np.full((2, 2), 0.1))}, {"same_data": True}, "covers 0.0 to 0.01 s"),
        ({"a": scso.MeasuredStiffness(stiffness=1.0, arms={"hip": 1.0})}, {"same_data": True}, "hip"),
    ],
)  # fmt: skip
def test_what_cannot_be_calibrated_is_refused(trials, given, words):
    trials = {name: trial(MOMENTS, measured) for name, measured in trials.items()}
    with pytest.raises(scso.ScsoError, match=words):
        scso.calibrate(trials, **given)


def test_trials_and_measurements_say_what_they_lack():
    with pytest.raises(scso.ProblemError, match="keeps no stability constraint"):
        scso.MeasuredTrial(problem=two_antagonists(1.0).without_stability(), measured=STIFF)
    whole = dataclasses.replace(
        two_antagonists(1.0), constraints=(scso.MomentEquilibrium(), scso.HessianStability(q=5.0))
    )
    with pytest.raises(scso.ProblemError, match="stiffness is about rows, and a whole Hessian has none"):
        scso.MeasuredTrial(problem=whole, measured=STIFF)
    for given, words in (
        ({"stiffness": 0.0, "arms": {"a": 1.0}}, "stiffness is 0, expected a positive"),
        ({"stiffness": 1.0, "arms": {}}, "arms is empty"),
        ({"stiffness": 1.0, "arms": {"a": 0.0}}, "arm of 'a' is 0"),
    ):
        with pytest.raises(scso.ProblemError, match=words):
            scso.MeasuredStiffness(**given)
    rows = scso.JointStability(stiffness=scso.ShortRangeStiffness())
    problem = dataclasses.replace(two_antagonists(MOMENTS), constraints=(scso.MomentEquilibrium(), rows))
    with pytest.raises(scso.DataError, match="unit names 2 frames, expected 6"):
        trial(MOMENTS, EMG, unit=["a", "b"])
    with pytest.raises(scso.ProblemError, match="keeps no stability constraint that has q"):
        scso.calibrate({"a": scso.MeasuredTrial(problem=problem, measured=EMG)}, same_data=True)
