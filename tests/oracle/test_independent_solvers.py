"""Other programs' optima of the same frames, from plain arrays: Clarabel and HiGHS."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import (
    frame_arrays,
    random_problem,
    solve_lp_frame,
    solve_power_frame,
    solve_qp_frame,
    unknowns,
    with_motion,
)

import scso_nlp as scso

#: Activation and control [-]: what the package promises against an independent solver.
TOLERANCE = 1e-4

both_solvers = pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
any_reserve = pytest.mark.parametrize("reserve", [None, 1.0, 50.0])


def problems(exponent, reserve, n=4):
    for seed in range(n):
        yield random_problem(
            np.random.default_rng(seed),
            exponent=exponent,
            reserve=reserve,
            weights=(None, "volume")[seed % 2],
            muscle_model=(scso.NoPhysiology(), scso.RigidTendon())[seed // 2 % 2],
        )


@both_solvers
@any_reserve
def test_squares_are_minimised_as_by_an_active_set_solver(solve, reserve):
    active = 0
    for problem in problems(2.0, reserve, 8):
        solution = solve(problem)
        assert solution.status is scso.Status.SOLVED
        for k in range(3):
            # Measured over 30 seeds: 1e-5 at the most.
            np.testing.assert_allclose(unknowns(solution, k), solve_qp_frame(problem, k), atol=5e-5)
        active += int((solution.rows["JointStability"].multiplier > 1e-4).sum())
    assert active >= 8, "stability rows are hardly ever active: the test shows nothing"


@pytest.mark.parametrize("reserve", [None, 5.0])
def test_a_tighter_tolerance_brings_the_two_solvers_together(reserve):
    """What is left of the difference is the barrier's: it goes with the tolerance."""
    options = scso.SolverOptions(tolerance=1e-12)
    for problem in problems(2.0, reserve):
        solution = scso.solve_trajectory(problem, options=options)
        for k in range(3):
            np.testing.assert_allclose(unknowns(solution, k), solve_qp_frame(problem, k), atol=2e-6)


@both_solvers
@any_reserve
@pytest.mark.parametrize("exponent", [1.5, 3.0])
def test_other_powers_are_minimised_as_by_a_conic_solver(solve, exponent, reserve):
    for problem in problems(exponent, reserve):
        solution = solve(problem)
        for k in range(3):
            expected = solve_power_frame(problem, k, exponent)
            np.testing.assert_allclose(unknowns(solution, k), expected, atol=TOLERANCE)


@any_reserve
@pytest.mark.parametrize("exponent", [1.1, 2.5, 6.0])
def test_powers_far_from_two_cost_as_little_as_a_conic_solver_finds(exponent, reserve):
    for problem in problems(exponent, reserve, 2):
        solution = scso.solve_trajectory(problem)
        for k in range(3):
            weights, *_ = frame_arrays(problem, k)
            costs = [
                float((weights * np.abs(x) ** exponent).sum())
                for x in (unknowns(solution, k), solve_power_frame(problem, k, exponent))
            ]
            # Clarabel's optimum of a steep power is itself known to about 1e-4.
            assert costs[0] <= costs[1] * (1 + 1e-4)
            assert costs[0] == pytest.approx(costs[1], rel=1e-3)


@both_solvers
@any_reserve
@pytest.mark.parametrize("exponent", [1.0, math.inf])
def test_sums_and_maxima_are_as_small_as_a_linear_program_finds(solve, exponent, reserve):
    for problem in problems(exponent, reserve):
        solution = solve(problem)
        optima = [solve_lp_frame(problem, k, exponent) for k in range(3)]
        assert solution.objective == pytest.approx(sum(cost for _, cost in optima), rel=1e-6)
        if exponent == 1.0:
            for k, (expected, _) in enumerate(optima):
                np.testing.assert_allclose(unknowns(solution, k), expected, atol=TOLERANCE)


@both_solvers
@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
def test_a_muscle_that_is_switched_off_stays_off(solve, exponent, rng):
    problem = random_problem(rng, exponent=exponent, reserve=5.0, stability=False)
    muscles = dataclasses.replace(problem.motion.muscles, max_activation=[0.0, 0.0, *np.ones(8)])
    problem = with_motion(problem, muscles=muscles)
    solution = solve(problem)
    np.testing.assert_array_equal(solution.activation[:, :2], 0.0)
    for k in range(3):
        expected = solve_power_frame(problem, k, exponent)
        np.testing.assert_allclose(unknowns(solution, k), expected, atol=TOLERANCE)
