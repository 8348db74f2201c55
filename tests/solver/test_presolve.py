"""Where IPOPT starts: the optima of convex frames, found one by one."""

from __future__ import annotations

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from coupled_terms import CappedEffort, RateLimit
from helpers import elbow, random_problem, two_antagonists

import scso_nlp as scso
from scso_nlp.solver.convex_objective import ConvexObjective
from scso_nlp.solver.presolve import Block, presolve
from scso_nlp.solver.programs import starting_point
from scso_nlp.transcription.describe import describe

COLD = scso.SolverOptions(presolve=False, tolerance=1e-12)


def started(problem):
    """What the active-set method finds in all frames."""
    program = describe(problem)
    return presolve(program, starting_point(program, None), np.arange(program.time.size))


@pytest.mark.parametrize("exponent", [1.5, 2.0, 2.5, 3.0, 7.0])
def test_the_closed_form_of_one_joint_is_found_to_rounding(exponent):
    """Crowninshield and Brand (1981): activations are as their moments to the power 1 / (p - 1)."""
    problem = elbow([10.0, 60.0], exponent=exponent)
    moments = np.array([0.1 * 1450, 0.05 * 1200, 0.02 * 1000])
    share = moments ** (1 / (exponent - 1))
    expected = np.outer([10.0, 60.0], share / (moments @ share))
    found = started(problem)
    assert found.is_optimal.all()
    np.testing.assert_allclose(found.unknowns, expected, rtol=1e-6)
    solution = scso.solve_trajectory(problem)
    assert solution.report.iterations == 0
    np.testing.assert_allclose(solution.activation, expected, rtol=1e-6)


@pytest.mark.parametrize("exponent", [1.0, 1.2, 2.0, 3.0, 10.0, math.inf])
@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_the_optimum_is_that_of_a_cold_start_and_not_above(rng, solve, exponent):
    problem = random_problem(rng, n_frames=7, exponent=exponent, reserve=5.0)
    cold, warm = solve(problem, options=COLD, on_failure="return"), solve(problem)
    if exponent >= 2:  # the curvature below it is infinite at zero: some frames go to IPOPT cold
        assert warm.report.iterations < cold.report.iterations
    assert (warm.optimality.worst <= 1e-6).all()
    assert warm.objective <= cold.objective * (1 + 1e-8)
    if exponent in (2.0, 3.0):
        np.testing.assert_allclose(warm.activation, cold.activation, atol=1e-6)
        for name, rows in cold.rows.items():
            size = np.abs(rows.multiplier).max()
            np.testing.assert_allclose(warm.rows[name].multiplier, rows.multiplier, atol=1e-5 * size)


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_the_unit_of_force_and_the_weight_of_the_objective_do_not_matter(rng, factor):
    problem = random_problem(rng, exponent=3.0)
    trajectory, muscles = problem.motion.trajectory, problem.motion.muscles
    scaled = dataclasses.replace(
        problem,
        motion=dataclasses.replace(
            problem.motion,
            trajectory=dataclasses.replace(
                trajectory, generalized_forces=trajectory.generalized_forces * factor
            ),
            muscles=dataclasses.replace(muscles, max_isometric_force=muscles.max_isometric_force * factor),
        ),
        objectives=(scso.ActivationEffort(exponent=3.0, weight=1 / factor),),
        constraints=problem.constraints[:1],
    )
    plain = dataclasses.replace(problem, constraints=problem.constraints[:1])
    found, expected = started(scaled), started(plain)
    assert found.is_optimal.all()
    np.testing.assert_allclose(found.unknowns, expected.unknowns, atol=1e-8)


def test_multipliers_and_what_bounds_hold_make_the_lagrangian_stationary(rng):
    problem = random_problem(rng, n_frames=5, reserve=5.0)
    program, found = describe(problem), started(problem)
    matrix = program.split.affine.dense(program.layout.size)
    push = np.einsum("kri,kr->ki", matrix, found.multipliers[:, program.split.affine.rows])
    np.testing.assert_allclose(2 * found.unknowns + push, found.reduced_cost, atol=1e-9)
    lower, _ = program.bounds()
    inside = found.unknowns > lower + 1e-9
    np.testing.assert_allclose(found.reduced_cost[inside], 0.0, atol=1e-7)
    assert (found.reduced_cost[~inside] >= -1e-9).all()


def test_a_function_of_ones_own_that_is_convex_is_solved_too(rng):
    def cost(frame):
        return ca.sum1(ca.exp(frame.activation)) + ca.sumsqr(frame.activation[0] - frame.activation[1])

    problem = dataclasses.replace(random_problem(rng), objectives=(cost,))
    found, cold = started(problem), scso.solve_framewise(problem, options=COLD)
    assert found.is_optimal.all()
    np.testing.assert_allclose(found.unknowns, cold.activation, atol=1e-6)


def test_what_is_not_convex_or_not_affine_or_coupled_is_left_to_ipopt(rng):
    problem = random_problem(rng)
    bent = dataclasses.replace(problem, objectives=(lambda frame: -ca.sumsqr(frame.activation),))
    curved = dataclasses.replace(problem, constraints=(*problem.constraints, CappedEffort()))
    coupled = dataclasses.replace(problem, constraints=(*problem.constraints, RateLimit()))
    for other in (bent, curved, coupled):
        found = started(other)
        assert not found.is_optimal.any()
        np.testing.assert_array_equal(found.unknowns, starting_point(describe(other), None))
    assert scso.solve_trajectory(bent, on_failure="return").report.iterations > 0


def test_frames_that_are_infeasible_are_told_from_those_that_are_not():
    problem = elbow([10.0, 300.0, 20.0])
    found = started(problem)
    assert found.is_doubtful.tolist() == [False, True, False]
    assert found.is_optimal.tolist() == [True, False, True]
    solution = scso.solve_trajectory(problem, on_failure="return")
    assert [status.name for status in solution.frame_status] == ["SOLVED", "INFEASIBLE", "SOLVED"]
    assert solution.report.iterations == 0


def test_an_active_stability_row_is_kept_to_rounding():
    """Two antagonists that the level makes contract: forces by hand, from the row and the equilibrium."""
    problem = two_antagonists(10.0, q=5.0, external_work=30.0)
    solution = scso.solve_trajectory(problem)
    assert solution.report.iterations == 0
    margin = solution.stability.margin
    assert margin.min() == pytest.approx(0.0, abs=1e-9)
    balance = solution.moment_balance
    np.testing.assert_allclose(balance.muscles + balance.actuators, balance.required, rtol=1e-12)


def test_rows_that_are_nearly_the_same_do_not_move_unknowns_by_what_rounding_makes_of_them(rng):
    """Their difference, 1e-6 of a row, would have to carry 1e-12: a way of 1e-6, where 1e-12 was missed."""
    program = describe(random_problem(rng, n_frames=1))
    every = np.arange(1)
    block = Block(program, ConvexObjective.of(program), every, np.full((1, program.layout.size), 0.3))
    block.solve()
    before = block.unknowns.copy()
    one, other = rng.normal(size=(2, program.layout.size))
    matrix = np.stack([one, one + 1e-6 * other])[None]
    block.add_rows(matrix, (matrix @ before[0]) + [[1e-12, -1e-12]])
    block.multipliers[:, -2:] = -1.0
    block.settle()
    assert 0 < np.abs(block.unknowns - before).max() < 1e-10
