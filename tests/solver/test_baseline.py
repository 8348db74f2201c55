"""A baseline that keeps all rows is the optimum; nothing of it is believed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_problem
from helpers import elbow, random_problem, two_antagonists

import scso_nlp as scso


def with_level(problem, level):
    return dataclasses.replace(
        problem, constraints=(problem.constraints[0], scso.HessianStability(level=level))
    )


@pytest.mark.parametrize("exponent", [2.0, 3.0])
@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_frames_that_keep_all_rows_are_done_and_the_answers_are_the_same(rng, solve, exponent):
    problem = hessian_problem(rng, n_frames=8, exponent=exponent, reserve=2.0)
    baseline = solve(problem.without_stability())
    least = np.linalg.eigvalsh(baseline.matrices["HessianStability"].value)[:, 0]
    level = float(np.sort(least)[3:5].mean())
    problem = with_level(problem, level)
    alone, after = solve(problem), solve(problem, baseline=baseline)
    assert alone.report.kept_frames is None
    assert after.report.kept_frames == (least > level).sum() == 4
    kept = least > level
    assert np.array_equal(after.activation[kept], baseline.activation[kept])
    np.testing.assert_allclose(after.activation, alone.activation, atol=1e-6)
    assert after.objective == pytest.approx(alone.objective, rel=1e-9)
    assert (after.optimality.worst <= 1e-6).all()


def test_rows_of_a_joint_that_are_kept_are_not_solved_again():

    problem = two_antagonists(5.0)
    baseline = scso.solve_trajectory(problem.without_stability())
    term = problem.constraints[-1]
    rows = baseline.rows[term.name]
    low = dataclasses.replace(term, level=float(np.nanmin(rows.value)) - 1.0)
    easy = dataclasses.replace(problem, constraints=(*problem.constraints[:-1], low))
    after = scso.solve_trajectory(easy, baseline=baseline)
    assert after.report.kept_frames == easy.motion.n_frames
    assert after.report.iterations == 0
    assert np.array_equal(after.activation, baseline.activation)
    again = scso.solve_trajectory(problem, baseline=baseline)
    assert again.report.kept_frames == 0
    np.testing.assert_allclose(again.activation, scso.solve_trajectory(problem).activation, atol=1e-8)


def test_of_frames_that_are_coupled_nobody_says_how_many_are_kept():
    problem = two_antagonists(30.0, q=6.0)
    coupled = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationRate()))
    baseline = scso.solve_trajectory(problem.without_stability())
    assert scso.solve_trajectory(problem, baseline=baseline).report.kept(1).endswith("in 1 of 1 frames")
    assert scso.solve_trajectory(coupled, baseline=baseline).report.kept(1) == ""


def test_a_baseline_of_another_objective_or_motion_is_not_believed(rng):
    problem = with_level(hessian_problem(rng, n_frames=4, reserve=2.0), -1e6)
    weights = {"*": 1.0, "m[1-4]": 1.5}
    other = dataclasses.replace(problem, objectives=(scso.ActivationEffort(weights=weights),))
    solution = scso.solve_trajectory(problem, baseline=scso.solve_trajectory(other.without_stability()))
    assert solution.report.kept_frames == 0
    np.testing.assert_allclose(solution.activation, scso.solve_trajectory(problem).activation, atol=1e-8)
    with pytest.raises(scso.ProblemError, match="has activations of shape"):
        scso.solve_trajectory(problem, baseline=scso.solve_trajectory(elbow([10.0])))


def test_failed_frames_of_a_baseline_start_anew(rng):
    problem = random_problem(rng, n_frames=3, reserve=5.0)
    baseline = scso.solve_trajectory(problem)
    broken = baseline.activation.copy()
    broken[1] = np.nan
    status = (scso.Status.SOLVED, scso.Status.NUMERICAL_ERROR, scso.Status.SOLVED)
    lost = dataclasses.replace(baseline, activation=broken, frame_status=status)
    again = scso.solve_trajectory(problem, baseline=lost)
    assert again.report.kept_frames == 2
    np.testing.assert_allclose(again.activation, baseline.activation, atol=1e-8)
