"""What a failed solve tells one to try: values in closed form, and what follows them has an answer."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, random_problem, two_antagonists, with_stability

import scso_nlp as scso
from scso_nlp.muscle_models.stiffness_law import ShortRangeStiffness
from scso_nlp.solver.advice import next_steps, rounded_up


def with_rows(problem, **changes):
    rows = dataclasses.replace(problem.constraints[1], **changes)
    return dataclasses.replace(problem, constraints=(problem.constraints[0], rows))


def steps(problem):
    return {step.setting: step for step in next_steps(scso.solve_trajectory(problem, on_failure="return"))}


def test_a_frame_that_is_solved_needs_nothing():
    assert steps(two_antagonists(5.0)) == {}


def test_the_gain_that_would_do_is_named_and_does():
    """Both muscles together pull 3900 N at most: q = 1 + 30 / (0.0125 × 3900) = 1.615."""
    problem = two_antagonists(5.0, q=1.5)
    with pytest.raises(scso.SolveFailed) as failure:
        scso.solve_trajectory(problem)
    lines = str(failure.value).splitlines()
    assert lines[1] == "  try q = 1.7: at q = 1.615 and above the failed frames have an answer"
    assert lines[2].startswith("  try soft = 1: ")
    assert scso.solve_trajectory(with_rows(problem, q=1.7)).is_solved.all()
    assert scso.solve_trajectory(with_rows(problem, soft=1.0)).is_solved.all()


def test_a_gain_beyond_the_published_ones_is_said_to_be_so():
    """q = 1 + 3000 / 48.75 = 62.54."""
    found = steps(two_antagonists(5.0, level=2970.0))
    assert found["q"].value == "63"
    assert found["q"].effect.endswith(
        "at q = 62.54 and above the failed frames have an answer; published gains are 0.5 to 42"
    )


def test_axes_that_nothing_turns_are_named_first_and_gains_are_those_without_them():
    """About z the gain is that of above; about x no gain would do, as no muscle pulls there."""
    problem = two_antagonists(5.0, q=1.5)
    trajectory = problem.motion.trajectory
    unturned = "no free coordinate turns it"
    skeleton = dataclasses.replace(trajectory.skeleton, joint_obstacles=(unturned, unturned, ""))
    motion = dataclasses.replace(
        problem.motion, trajectory=dataclasses.replace(trajectory, skeleton=skeleton)
    )
    named = with_rows(dataclasses.replace(problem, motion=motion), axes=("x", "z"))
    found = steps(named)
    assert [*found] == ["axes", "q", "soft"]
    assert found["axes"].value == "z"
    assert found["q"].effect == "with these axes, at q = 1.615 and above the failed frames have an answer"
    assert scso.solve_trajectory(with_rows(named, axes=("z",), q=1.7)).is_solved.all()


def test_level_zero_is_named_where_it_would_do():
    problem = two_antagonists(5.0, level=175.0)
    assert steps(problem)["level"].effect == "at level 0 they have an answer"
    assert scso.solve_trajectory(with_rows(problem, level=0.0)).is_solved.all()
    assert "level" not in steps(two_antagonists(5.0, level=175.0, q=1.5))


def test_moments_that_nothing_can_make_ask_for_reserves_there():
    (step,) = next_steps(scso.solve_trajectory(elbow([60.0, 300.0, 60.0]), on_failure="return"))
    assert step.setting == "actuators"
    assert "cannot make the moments of q1 in 1 frame, stable or not" in step.effect


def test_of_rows_that_no_gain_keeps_and_of_other_stiffness_only_the_price_is_named():
    problem = two_antagonists(0.0)
    assert [*steps(with_rows(problem, axes=("x",), level=1e5))] == ["soft"]
    stiff = with_rows(problem, q=None, stiffness=ShortRangeStiffness(), level=1e7)
    assert [*steps(stiff)] == ["soft"]


def test_a_motion_with_more_failed_frames_than_are_asked_says_so(rng, monkeypatch):
    monkeypatch.setattr("scso_nlp.solver.advice.MOST_FRAMES", 2)
    problem = with_stability(random_problem(rng, reserve=5.0), 40.0, q=0.0)
    assert "the 2 worst of 3 failed frames have an answer" in steps(problem)["q"].effect


@pytest.mark.parametrize(
    ("gain", "expected"),
    [(0.0, 0.0), (22.0099, 23.0), (6.004, 6.1), (3005.0, 3100.0), (0.5, 0.5), (99.5, 100)],
)
def test_gains_are_rounded_up_to_two_digits(gain, expected):
    assert rounded_up(gain) == pytest.approx(expected, rel=1e-12)
    assert rounded_up(gain) >= gain or np.isclose(rounded_up(gain), gain)
