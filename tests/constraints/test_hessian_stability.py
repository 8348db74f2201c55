"""The matrix inequality as rows: its words, its errors and what it reports."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem
from helpers import with_trajectory

import scso_nlp as scso
from scso_nlp import HessianStability
from scso_nlp.stability.hessian import smallest_eigenvalues


def test_the_reported_hessian_is_the_formula_at_the_reported_forces(rng):
    level = {"q1": 3.0, "q3": -2.0}
    problem = hessian_problem(rng, reserve=20.0, stability=HessianStability(level=level))
    solution = scso.solve_trajectory(problem)
    reported = solution.matrices["HessianStability"]
    assert reported.lower.tolist() == [3, 0, -2, 0]
    for k in range(4):
        force = solution.tendon_force[k]
        stiffness = solution.quantities["HessianStability.muscle_stiffness"][k]
        np.testing.assert_allclose(
            stiffness, 5.0 * force / problem.motion.trajectory.muscle_tendon_length[k], rtol=1e-12
        )
        expected = hessian_by_hand(problem, k, force, stiffness)
        np.testing.assert_allclose(reported.value[k], expected, atol=1e-9)
        least = np.linalg.eigvalsh(expected - np.diag(reported.lower))[0]
        assert reported.smallest_eigenvalue[k] == pytest.approx(least, abs=1e-9)


def test_the_multiplier_is_the_price_of_raising_the_levels(rng):
    """Positive semi-definite, orthogonal to the Hessian minus levels, and a derivative of the objective."""
    problem = hessian_problem(rng, n_frames=2, stability=HessianStability(level=1.0))
    solution = scso.solve_trajectory(problem)
    matrix = solution.matrices["HessianStability"]
    rise = np.diag([0.3, 1.0, 0.0, 0.5])
    for k in range(2):
        assert np.linalg.eigvalsh(matrix.multiplier[k])[0] > -1e-12
        above = matrix.value[k] - np.diag(matrix.lower)
        assert abs(np.sum(matrix.multiplier[k] * above)) < 1e-5 * np.trace(matrix.multiplier[k])
    costs = []
    for step in (1e-3, -1e-3):
        level = {f"q{i + 1}": 1.0 + step * rise[i, i] for i in range(4)}
        moved = HessianStability(level=level)
        costs.append(
            scso.solve_trajectory(
                dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), moved))
            ).objective
        )
    slope = (costs[0] - costs[1]) / 2e-3
    assert slope == pytest.approx(float(np.sum(matrix.multiplier * rise)), rel=1e-3)
    assert slope > 1e-4, "the levels cost nothing: the test shows nothing"


def test_where_plain_static_optimization_is_stable_the_constraint_has_no_effect(rng):
    problem = hessian_problem(rng, stability=HessianStability(level=-1e4))
    solution, plain = scso.solve_trajectory(problem), scso.solve_trajectory(problem.without_stability())
    np.testing.assert_allclose(solution.activation, plain.activation, atol=1e-5)
    assert solution.report.rounds == 1


def test_before_any_turn_is_known_the_rows_are_the_coordinates_alone(rng):
    problem = hessian_problem(rng)
    stability = HessianStability(coordinates=("q2", "q1"))
    assert stability.row_names(problem.motion) == ("q2", "q1")
    rows = stability.stability_rows(problem.motion)
    np.testing.assert_array_equal(rows.moment_arms, problem.motion.trajectory.moment_arms[:, [1, 0]])


def test_more_level_never_costs_less(rng):
    problem = hessian_problem(rng, n_frames=2, reserve=20.0, n_muscles=24)
    costs = [
        scso.solve_trajectory(
            dataclasses.replace(
                problem, constraints=(scso.MomentEquilibrium(), HessianStability(level=level))
            )
        ).objective
        for level in (-20.0, 0.0, 5.0, 10.0)
    ]
    assert (np.diff(costs) > 0).all()


def test_a_level_of_an_unknown_coordinate_is_refused(rng):
    problem = hessian_problem(rng, stability=HessianStability(level={"hip": 1.0}))
    with pytest.raises(scso.NameMismatchError, match="unknown stability row 'hip'"):
        scso.solve_trajectory(problem)


def test_a_motion_without_curvature_is_refused(rng):
    problem = hessian_problem(rng)
    bare = with_trajectory(problem, curvature=None)
    with pytest.raises(scso.ProblemError, match="without path curvature"):
        scso.solve_trajectory(bare)


def test_smallest_eigenvalues_come_with_the_turn_that_has_them(rng):
    matrix = rng.normal(size=(5, 3, 3))
    matrix = matrix + matrix.transpose(0, 2, 1)
    value, mode = smallest_eigenvalues(matrix)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", matrix, mode), value[:, None] * mode, atol=1e-12)
    np.testing.assert_allclose(value, np.linalg.eigvalsh(matrix)[:, 0])
    np.testing.assert_allclose(np.linalg.norm(mode, axis=1), 1.0)
    assert (np.take_along_axis(mode, np.abs(mode).argmax(axis=1)[:, None], axis=1) > 0).all()
