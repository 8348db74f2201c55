"""The matrix inequality as rows: its words, its errors and what it reports."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem

import scso_nlp as scso
from scso_nlp.constraints import HessianStability
from scso_nlp.stability.hessian import hessian_terms, smallest_eigenvalues


def test_the_reported_hessian_is_the_formula_at_the_reported_forces(rng):
    level = {"q1": 3.0, "q3": -2.0}
    problem = hessian_problem(rng, reserve=20.0, stability=HessianStability(level=level))
    solution = scso.solve_trajectory(problem)
    reported = solution.problem.constraints[1].hessian(solution)
    for k in range(4):
        force = solution.tendon_force[k]
        stiffness = solution.quantities["HessianStability.muscle_stiffness"][k]
        np.testing.assert_allclose(
            stiffness, 5.0 * force / problem.trajectory.muscle_tendon_length[k], rtol=1e-12
        )
        expected = hessian_by_hand(problem, k, force, stiffness) - np.diag([3.0, 0.0, -2.0, 0.0])
        np.testing.assert_allclose(reported[k], expected, atol=1e-9)


def test_rows_are_the_hessian_along_their_turns(rng):
    problem = hessian_problem(rng)
    solution = scso.solve_trajectory(problem)
    stability = solution.problem.constraints[1]
    hessian = stability.hessian(solution)
    along = np.einsum("kdi,kij,kdj->kd", stability.directions, hessian, stability.directions)
    present = (stability.directions != 0).any(axis=2)
    np.testing.assert_allclose(solution.rows["HessianStability"].value[present], along[present], atol=1e-8)
    assert solution.rows["HessianStability"].names[0] == "turn_1"


def test_where_plain_static_optimization_is_stable_the_constraint_has_no_effect(rng):
    problem = hessian_problem(rng, stability=HessianStability(level=-1e4))
    solution, plain = scso.solve_trajectory(problem), scso.solve_trajectory(problem.without_stability())
    np.testing.assert_allclose(solution.activation, plain.activation, atol=1e-5)
    assert solution.report.rounds == 1


def test_before_any_turn_is_known_the_rows_are_the_coordinates_alone(rng):
    problem = hessian_problem(rng)
    stability = HessianStability(coordinates=("q2", "q1"))
    assert stability.row_names(problem) == ("q2", "q1")
    rows = stability.stability_rows(problem)
    np.testing.assert_array_equal(rows.moment_arms, problem.trajectory.moment_arms[:, [1, 0]])


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
    bare = dataclasses.replace(problem, trajectory=dataclasses.replace(problem.trajectory, curvature=None))
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


def test_terms_along_a_turn_are_the_quadratic_forms(rng):
    problem = hessian_problem(rng)
    terms = hessian_terms(problem.trajectory)
    turn = rng.normal(size=(4, 2, 4))
    curvature, arms, constant = terms.along(turn)
    for k in range(4):
        for d in range(2):
            v = turn[k, d]
            for m in range(16):
                assert curvature[k, d, m] == pytest.approx(v @ terms.curvature[k, :, :, m] @ v)
                assert arms[k, d, m] == pytest.approx(terms.moment_arms[k, :, m] @ v)
            assert constant[k, d] == pytest.approx(v @ terms.constant[k] @ v)
