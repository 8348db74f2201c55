"""Numbers of one solve, against closed forms."""

import helpers
import numpy as np
import pytest

from scso_nlp.figures.series import Series
from scso_nlp.studies.summary import co_contraction_numbers, opposing_moments, series_numbers, verdict_numbers


def tendon_force(values, names=("m1", "m2")):
    values = np.asarray(values, dtype=float)
    time = 0.01 * np.arange(len(values))
    return Series(label="run", time=time, names=names, values=values, units=("N",))


def numbers(found):
    return {(one.quantity, one.name, one.statistic): (one.value, one.unit) for one in found}


def test_co_contraction_of_two_muscles_is_twice_the_smaller_moment_over_both():
    """100 N at 0.04 m against 100 N at 0.02 m: 2 * 2 / (4 + 2); the antagonist's 2 N·m."""
    motion = helpers.motion(np.tile([[[0.04, -0.02]]], (3, 1, 1)), np.zeros((3, 1)))
    found = numbers(co_contraction_numbers(tendon_force(np.full((3, 2), 100.0)), motion))
    assert found["co-contraction", "q1", "index"] == (pytest.approx(2 / 3), "-")
    assert found["co-contraction", "q1", "mean"] == (pytest.approx(2.0), "N·m")


def test_the_antagonist_is_chosen_frame_by_frame_and_frames_without_answer_do_not_count():
    """Moments (4, 2), (1, 3) and none known: 2 (2 + 1) / (6 + 4)."""
    motion = helpers.motion(np.tile([[[0.1, -0.1]]], (3, 1, 1)), np.zeros((3, 1)))
    found = numbers(co_contraction_numbers(tendon_force([[40, 20], [10, 30], [np.nan, np.nan]]), motion))
    assert found["co-contraction", "q1", "index"][0] == pytest.approx(0.6)
    assert found["co-contraction", "q1", "mean"][0] == pytest.approx(1.5)


def test_the_sign_of_a_moment_arm_decides_the_side_also_where_it_changes_during_the_motion():
    motion = helpers.motion([[[0.1, -0.1]], [[0.1, 0.1]]], np.zeros((2, 1)))
    positive, negative = opposing_moments(tendon_force([[10, 10], [10, 10]]), motion)
    assert positive.ravel().tolist() == pytest.approx([1.0, 2.0])
    assert negative.ravel().tolist() == pytest.approx([1.0, 0.0])


def test_muscles_on_one_side_never_oppose_and_a_coordinate_without_muscles_has_no_index():
    motion = helpers.motion(np.tile([[[0.1, 0.1], [0.0, 0.0]]], (2, 1, 1)), np.zeros((2, 2)))
    found = numbers(co_contraction_numbers(tendon_force(np.full((2, 2), 5.0)), motion))
    assert found["co-contraction", "q1", "index"][0] == 0.0
    assert not [key for key in found if key[1] == "q2"]


def test_series_become_means_and_peaks_over_the_solved_frames():
    values = np.array([[0.1, 0.0], [0.3, 0.2], [np.nan, np.nan]])
    time = np.arange(3.0)
    activation = Series(label="run", time=time, names=("a", "b"), values=values, units=("-",))
    moment = Series(label="run", time=time, names=("q",), values=[[3.0], [-4.0], [np.nan]], units=("N·m",))
    found = numbers(series_numbers({"activation": activation, "moment": moment}))
    assert found["activation", "a", "mean"] == (pytest.approx(0.2), "-")
    assert found["activation", "a", "peak"] == (pytest.approx(0.3), "-")
    assert found["activation", "all muscles", "mean"] == (pytest.approx(0.15), "-")
    assert found["moment", "q", "peak"] == (4.0, "N·m")
    assert found["moment", "q", "rms"] == (pytest.approx(np.sqrt(12.5)), "N·m")


def test_a_verdict_becomes_counts_extremes_and_effort_per_usable_frame():
    nothing = dict.fromkeys(
        ("missed", "residual_force", "residual_moment", "motor_force", "motor_moment"), None
    )
    report = {
        "frame_status": ["SOLVED", "SOLVED", "INFEASIBLE"],
        "verdict": {
            "frames_stable": 2,
            "margin": {"amount": 0.5, "unit": "N·m/rad"},
            "reserve": {"amount": 3.0, "unit": "%"},
            "effort": {"muscles": 1.0, "other actuators": 0.5},
            **nothing,
        },
    }
    found = numbers(verdict_numbers(report))
    assert found["frames", "all", "count"][0] == 3
    assert found["frames", "usable", "count"][0] == found["frames", "solved", "count"][0] == 2
    assert found["frames", "infeasible", "count"][0] == 1
    assert found["frames", "stable", "count"][0] == 2
    assert found["margin", "all rows", "least"] == (0.5, "N·m/rad")
    assert found["reserve share", "all coordinates", "peak"] == (3.0, "%")
    assert found["effort", "all", "mean"] == (0.75, "-")
    assert found["effort", "muscles", "mean"] == (0.5, "-")
