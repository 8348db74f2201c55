"""Frames that no term couples do not know of each other, in whatever number or order they are solved."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import random_problem, with_motion, with_trajectory

import scso_nlp as scso

#: Activation [-]. The solver stops at a scaled complementarity of 1e-8; an activation that nearly rests
#: on a bound is then known to about the square root of that.
TOLERANCE = 1e-4

EXPONENTS = (1.5, 2.0, 2.5, 3.0, 10.0)


@pytest.mark.parametrize("reserve", [None, 5.0])
@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_whole_motion_at_once_equals_frame_by_frame(rng, exponent, reserve):
    problem = random_problem(rng, n_frames=5, exponent=exponent, reserve=reserve)
    together, one_by_one = scso.solve_trajectory(problem), scso.solve_framewise(problem)
    np.testing.assert_allclose(together.activation, one_by_one.activation, atol=TOLERANCE)
    np.testing.assert_allclose(together.control, one_by_one.control, atol=TOLERANCE)
    assert together.objective == pytest.approx(one_by_one.objective, rel=1e-6)


@pytest.mark.parametrize("exponent", [1.0, math.inf])
def test_flat_objectives_reach_the_same_value_at_once_and_frame_by_frame(rng, exponent):
    problem = random_problem(rng, n_frames=5, exponent=exponent, reserve=5.0)
    together, one_by_one = scso.solve_trajectory(problem), scso.solve_framewise(problem)
    assert together.objective == pytest.approx(one_by_one.objective, rel=1e-6)


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
@pytest.mark.parametrize("exponent", [2.0, 3.0, 10.0])
def test_every_frame_alone_equals_its_place_in_the_motion(rng, solve, exponent):
    problem = random_problem(rng, n_frames=4, exponent=exponent)
    whole = solve(problem)
    for k in range(4):
        alone = solve(problem.frames(k, k + 1))
        np.testing.assert_allclose(alone.activation[0], whole.activation[k], atol=TOLERANCE)


def test_cutting_the_motion_into_blocks_does_not_move_the_answer(rng):
    problem = random_problem(rng, n_frames=7)
    whole = scso.solve_trajectory(problem)
    blocks = [scso.solve_trajectory(problem.frames(*span)) for span in ((0, 2), (2, 3), (3, 7))]
    np.testing.assert_allclose(
        np.vstack([block.activation for block in blocks]), whole.activation, atol=TOLERANCE
    )
    assert sum(block.objective for block in blocks) == pytest.approx(whole.objective, rel=1e-6)


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_a_motion_told_backwards_gives_the_answer_backwards(rng, solve):
    problem = random_problem(rng, n_frames=4, reserve=5.0)
    backwards = _reordered(problem, [3, 2, 1, 0])
    np.testing.assert_allclose(solve(backwards).activation, solve(problem).activation[::-1], atol=TOLERANCE)


def test_frames_keep_their_own_numbers_when_some_are_infeasible(rng):
    """Frames that the solver takes out must not shift the data of those that stay."""
    problem = random_problem(rng, n_frames=5)
    whole = scso.solve_trajectory(problem)
    moments = problem.motion.trajectory.generalized_forces.copy()
    moments[[0, 3]] *= 1e3
    broken = with_trajectory(problem, generalized_forces=moments)
    for solve in (scso.solve_trajectory, scso.solve_framewise):
        solution = solve(broken, on_failure="return")
        assert solution.is_solved.tolist() == [False, True, True, False, True]
        np.testing.assert_allclose(
            solution.activation[[1, 2, 4]], whole.activation[[1, 2, 4]], atol=TOLERANCE
        )


def test_a_good_initial_guess_gives_the_same_optimum(rng):
    problem = random_problem(rng, n_frames=3, exponent=3.0)
    baseline = scso.solve_framewise(problem)
    guided = scso.solve_trajectory(problem, initial_guess=baseline)
    np.testing.assert_allclose(guided.activation, baseline.activation, atol=TOLERANCE)


def _reordered(problem, order):
    """The problem with its frames' data in another order and its time as it was."""
    trajectory = problem.motion.trajectory
    data = {"name", "muscles", "actuators", "coordinates", "is_rotational", "time", "skeleton"}
    data |= {"force_columns", "other_force_labels"}
    changes = {
        field.name: value[order]
        for field in dataclasses.fields(trajectory)
        if field.name not in data and isinstance(value := getattr(trajectory, field.name), np.ndarray)
    }
    moved = dataclasses.replace(
        trajectory, **changes, skeleton=trajectory.skeleton.frames(np.array(order, dtype=np.int64))
    )
    return with_motion(problem, trajectory=moved)


def test_a_long_motion_is_cut_into_programs_and_the_answer_does_not_depend_on_the_cut(rng):
    problem = random_problem(rng, n_frames=23)
    whole = scso.solve_trajectory(problem, options=scso.SolverOptions(presolve=False))
    cut = scso.solve_trajectory(problem, options=scso.SolverOptions(frames_per_program=5, presolve=False))
    assert cut.report.iterations > whole.report.iterations
    np.testing.assert_allclose(cut.activation, whole.activation, atol=1e-5)
    assert cut.objective == pytest.approx(whole.objective, rel=1e-7)
    for name, rows in whole.rows.items():
        # Prices of rows, which belong to frames, find their frames again.
        scale = max(1e-3, np.abs(rows.multiplier).max())
        np.testing.assert_allclose(cut.rows[name].multiplier, rows.multiplier, atol=1e-3 * scale)
