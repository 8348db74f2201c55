"""What a solution is worth: two lines, made of what the user receives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import random_problem, with_motion, with_stability

import scso_nlp as scso
from scso_nlp.solution import ACTIVE_MARGIN, Status
from scso_nlp.verdict import RESERVE_LIMIT, UNUSABLE, USABLE


def soft(problem, miss, price=1e-6):
    """The problem with levels `miss` above what its activations reach [N·m/rad], at a price."""
    rows = problem.constraints[1]
    level = {name: value + miss for name, value in rows.level.items()}
    rows = dataclasses.replace(rows, level=level, soft=price)
    return dataclasses.replace(problem, constraints=(problem.constraints[0], rows))


def test_hard_levels_that_are_kept_leave_a_clean_verdict(rng):
    solution = scso.solve_trajectory(random_problem(rng))
    verdict = solution.verdict
    assert verdict.is_clean
    assert verdict.counts == {"SOLVED": 3}
    assert verdict.missed is None
    assert verdict.margin.amount == pytest.approx(solution.stability.margin.min(), abs=1e-12)
    assert verdict.lines()[0].startswith("3 of 3 frames solved; stable in 3; least margin ")
    just_kept = dataclasses.replace(verdict, margin=dataclasses.replace(verdict.margin, amount=-1e-13))
    assert f"least margin 0 N·m/rad ({verdict.margin.name} at" in just_kept.lines()[0]


def test_frames_count_as_stable_where_every_row_keeps_its_level(rng):
    """By hand, for rows that are only observed: some frames keep them, others do not."""
    problem = random_problem(rng, n_frames=8)
    free = scso.solve_trajectory(problem.without_stability())
    middle = {
        name: float(np.median(free.stability.stability[:, i])) for i, name in enumerate(free.stability.rows)
    }
    free = scso.solve_trajectory(with_stability(problem, middle).without_stability())
    kept = (free.stability.margin >= -ACTIVE_MARGIN).all(axis=1)
    assert 0 < kept.sum() < 8
    assert free.verdict.frames_stable == kept.sum()
    assert f"; stable in {kept.sum()}; least margin" in free.verdict.lines()[0]
    assert scso.solve_trajectory(random_problem(rng, stability=False)).verdict.frames_stable is None


def test_missed_soft_levels_are_said_with_row_time_and_amount(rng):
    solution = scso.solve_trajectory(soft(random_problem(rng), 500.0))
    verdict, missed = solution.verdict, solution.rows["JointStability"].missed
    assert set(solution.frame_status) == {Status.STABILITY_MISSED}
    assert solution.is_solved.all()
    assert not verdict.is_clean
    assert verdict.frames_missed == 3
    k, i = np.unravel_index(missed.argmax(), missed.shape)
    assert verdict.missed.amount == missed[k, i]
    assert verdict.missed.name == solution.rows["JointStability"].names[i]
    assert verdict.missed.time == solution.problem.motion.trajectory.time[k]
    assert f"levels missed in 3 frames, most by {missed[k, i]:.4g} N·m/rad" in verdict.lines()[0]
    assert solution.summary().startswith("all 3 frames solved, of these 3 stability missed")


def test_a_level_that_only_acceptable_frames_miss_is_said_too(rng):
    solution = scso.solve_trajectory(soft(random_problem(rng), 500.0))
    loose = dataclasses.replace(solution, frame_status=(Status.ACCEPTABLE,) * 3).verdict
    assert loose.frames_missed == 3
    assert loose.missed == solution.verdict.missed
    assert loose.missed.unit == "N·m/rad"


def test_a_soft_level_that_is_kept_is_not_missed(rng):
    solution = scso.solve_trajectory(soft(random_problem(rng), -100.0))
    assert solution.verdict.is_clean
    assert solution.verdict.missed is None


def test_reserves_are_a_share_of_the_peak_moment(rng):
    """Their moment by hand; the limit is a tenth."""
    problem = random_problem(rng, reserve=50.0, stability=False)
    solution = scso.solve_trajectory(problem)
    moments = problem.motion.trajectory.generalized_forces
    share = np.abs(50.0 * solution.control) / np.abs(moments).max(axis=0)
    assert solution.verdict.reserve.amount == pytest.approx(100 * share.max(), rel=1e-12)
    assert (share.max() > RESERVE_LIMIT) == bool(solution.verdict.beyond_limits)
    assert solution.verdict.residual_force is None


def test_stability_that_reserves_pay_for_is_said():
    """Levels that muscles reach only with moments that reserves must carry."""
    problem = random_problem(np.random.default_rng(20260101), reserve=50.0)
    level = {name: value + 50.0 for name, value in problem.constraints[1].level.items()}
    stable = scso.solve_trajectory(with_stability(problem, level)).verdict
    baseline = scso.solve_trajectory(problem.without_stability()).verdict
    assert stable.reserve.amount > baseline.reserve.amount + 10, "reserves hardly grow: nothing is shown"
    assert stable.lines(baseline)[1].endswith("stability is bought from reserves")
    assert "bought" not in stable.lines(stable)[1]


def test_coordinates_that_no_muscle_moves_have_residuals(rng):
    problem = random_problem(rng, reserve=50.0, stability=False)
    trajectory = problem.motion.trajectory
    arms = trajectory.moment_arms * np.array([0.0, 1.0, 0.0])[:, None]
    trajectory = dataclasses.replace(
        trajectory,
        moment_arms=arms,
        is_rotational=np.array([True, True, False]),
        generalized_forces=np.array([[80.0, 1.0, 5.0], [10.0, 1.0, -30.0], [0.0, 1.0, 0.0]]),
    )
    problem = with_motion(problem, trajectory=trajectory)
    verdict = scso.solve_trajectory(problem).verdict
    names = trajectory.coordinates
    assert str(verdict.residual_moment) == f"80 N·m ({names[0]} at t = {trajectory.time[0]:.6g} s)"
    assert str(verdict.residual_force) == f"30 N ({names[2]} at t = {trajectory.time[1]:.6g} s)"
    assert verdict.reserve.name == names[1]
    assert verdict.beyond_limits[-2:] == ("a residual force above 20 N", "a residual moment above 75 N·m")


def test_every_status_is_usable_or_not():
    assert sorted((*USABLE, *UNUSABLE)) == sorted(Status.__members__)


def test_motors_are_told_from_residuals_by_the_joint(rng):
    """The same moments at a floating base and at a joint that only motors turn."""
    problem = random_problem(rng, reserve=50.0, stability=False)
    trajectory = problem.motion.trajectory
    moments = np.array([[80.0, 1.0, 90.0], [10.0, 1.0, -30.0], [0.0, 1.0, 0.0]])
    trajectory = dataclasses.replace(
        trajectory,
        moment_arms=trajectory.moment_arms * np.array([0.0, 1.0, 0.0])[:, None],
        generalized_forces=moments,
        base_coordinates=trajectory.coordinates[:1],
    )
    problem = with_motion(problem, trajectory=trajectory)
    verdict = scso.solve_trajectory(problem).verdict
    names, start = trajectory.coordinates, f"at t = {trajectory.time[0]:.6g} s)"
    assert str(verdict.residual_moment) == f"80 N·m ({names[0]} {start}"
    assert str(verdict.motor_moment) == f"90 N·m ({names[2]} {start}"
    line = verdict.lines()[1]
    assert f"; residuals at most {verdict.residual_moment}; motors at most {verdict.motor_moment}" in line
    assert verdict.beyond_limits[-1] == "a residual moment above 75 N·m"
    driven = dataclasses.replace(trajectory, base_coordinates=())
    problem = with_motion(problem, trajectory=driven)
    verdict = scso.solve_trajectory(problem).verdict
    assert (verdict.residual_moment, verdict.motor_moment.amount) == (None, pytest.approx(90))
    assert "residual" not in verdict.lines()[1]


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0, np.inf])
def test_effort_is_told_apart_by_what_it_is_paid_for(rng, exponent):
    """Muscles, other actuators, misses at their price, other terms; together they are the objective."""

    def largest_first(frame):
        return 0.25 + 0 * frame.activation[0]

    effort = scso.ActivationEffort(exponent=exponent, weights={"*": 2.0}, weight=3.0)
    problem = soft(random_problem(rng, reserve=50.0), 500.0)
    problem = dataclasses.replace(problem, objectives=(effort, largest_first))
    solution = scso.solve_trajectory(problem)
    found = solution.verdict.effort
    parts = [2 * np.abs(x) for x in (solution.activation, solution.control)]
    if np.isinf(exponent):
        expected = [3 * x.max(axis=1).sum() for x in parts]
        total = 3 * np.hstack(parts).max(axis=1).sum()
    else:
        expected = [3 * (2 * np.abs(x) ** exponent).sum() for x in (solution.activation, solution.control)]
        total = sum(expected)
    assert [found["muscles"], found["other actuators"]] == pytest.approx(expected, rel=1e-12)
    assert found["misses"] == pytest.approx(1e-6 * solution.rows["JointStability"].missed.sum())
    assert found["other terms"] == pytest.approx(0.75)
    assert total + found["misses"] + found["other terms"] == pytest.approx(solution.objective, rel=1e-6)
    assert f"; effort {found['muscles']:.4g} of muscles, " in solution.verdict.lines()[0]


def test_failed_frames_have_no_part_in_it(rng):
    problem = with_stability(random_problem(rng, stability=False), {"elbow_x": 1e9})
    verdict = scso.solve_trajectory(problem, on_failure="return").verdict
    assert verdict.counts == {"INFEASIBLE": 3}
    assert not verdict.is_clean
    assert verdict.margin is None
    assert verdict.lines()[0] == "0 of 3 frames solved (3 infeasible)"
