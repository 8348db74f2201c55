"""The Hessian's diagonal as rows: against Potvin and Brown on hinges, and its own words and errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem
from helpers import solve_qp
from hinge_chain import hinge_chain

import scso_nlp as scso
from scso_nlp import CoordinateStability
from scso_nlp.stability import joint_stability, potvin_brown


def diagonal(problem, **options):
    rows = CoordinateStability(**options)
    return dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))


@pytest.mark.parametrize("n_hinges", [1, 2, 4])
def test_on_hinges_with_straight_paths_the_diagonal_is_potvin_and_browns_rule(rng, n_hinges):
    """Both rest on the same geometry: one by printed formulas, one by derivatives of lengths and energy."""
    problem = hinge_chain(rng, n_hinges=n_hinges)
    trajectory = problem.motion.trajectory
    printed = potvin_brown(trajectory, axes="x")
    exact = CoordinateStability().stability_rows(problem.motion)
    for name in ("curvature", "external_work"):
        np.testing.assert_allclose(getattr(printed, name), getattr(exact, name), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(np.abs(printed.moment_arms), np.abs(exact.moment_arms), rtol=1e-8, atol=1e-12)
    force = rng.uniform(0, 500, (trajectory.n_frames, len(trajectory.muscles)))
    by_hand = np.array(
        [
            np.diag(
                hessian_by_hand(problem, k, force[k], 5.0 * force[k] / trajectory.muscle_tendon_length[k])
            )
            for k in range(trajectory.n_frames)
        ]
    )
    np.testing.assert_allclose(joint_stability(printed, force, 5.0), by_hand, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_on_hinges_both_rules_give_the_same_forces(rng, solve):
    problem = hinge_chain(rng, n_muscles=12)
    level = {"q1": 30.0, "q2": 10.0}
    axes = {"joint0_x": 30.0, "joint1_x": 10.0}
    exact = solve(diagonal(problem, level=level))
    printed = scso.JointStability(level=axes, axes="x")
    solution = solve(dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), printed)))
    np.testing.assert_allclose(exact.activation, solution.activation, atol=1e-6)
    assert exact.rows["CoordinateStability"].multiplier.max() > 1e-4


def test_rows_are_the_diagonal_of_the_hessian_and_the_optimum_is_that_of_a_quadratic_program(rng):
    problem = diagonal(hessian_problem(rng, n_frames=3), level=5.0, passive_stiffness={"q2": 4.0})
    solution = scso.solve_trajectory(problem)
    m, strength = 16, problem.motion.muscles.max_isometric_force
    for k in range(3):
        length = problem.motion.trajectory.muscle_tendon_length[k]

        def of(force, k=k, length=length):
            hessian = hessian_by_hand(problem, k, force, 5.0 * force / length)
            return np.diag(hessian) + np.array([0, 4.0, 0, 0])

        np.testing.assert_allclose(
            solution.rows["CoordinateStability"].value[k], of(solution.tendon_force[k]), rtol=1e-9
        )
        nothing = of(np.zeros(m))
        rows = np.array([of(strength[i] * np.eye(m)[i]) - nothing for i in range(m)]).T
        x = solve_qp(
            2 * np.eye(m),
            np.zeros(m),
            problem.motion.trajectory.moment_arms[k] * strength,
            problem.motion.trajectory.generalized_forces[k],
            rows,
            5.0 - nothing,
            np.zeros(m),
            np.ones(m),
        )
        np.testing.assert_allclose(solution.activation[k], x, atol=1e-5)


def test_chosen_coordinates_come_in_the_order_asked_for(rng):
    problem = diagonal(hessian_problem(rng), coordinates=("q3", "q1"))
    assert problem.constraints[1].row_names(problem.motion) == ("q3", "q1")
    rows = problem.constraints[1].stability_rows(problem.motion)
    np.testing.assert_array_equal(rows.moment_arms, problem.motion.trajectory.moment_arms[:, [2, 0]])


def test_the_models_passive_stiffness_counts_unless_told_otherwise(rng):
    problem = hessian_problem(rng)
    with_it, without = (
        CoordinateStability(model_passive=choice).stability_rows(problem.motion).external_work
        for choice in (True, False)
    )
    np.testing.assert_allclose(without - with_it, np.broadcast_to(np.linspace(0.5, 2.0, 4), (4, 4)))


def test_a_motion_without_curvature_is_refused_with_the_remedy(rng):
    problem = hessian_problem(rng)
    bare = dataclasses.replace(problem.motion.trajectory, curvature=None)
    with pytest.raises(scso.ProblemError, match=r"without path curvature.*prepare_for"):
        CoordinateStability().stability_rows(dataclasses.replace(problem.motion, trajectory=bare))


def test_a_coordinate_without_curvature_is_refused_by_name(rng):
    with pytest.raises(scso.NameMismatchError, match=r"unknown coordinate with curvature 'q9'"):
        CoordinateStability(coordinates=("q1", "q9")).stability_rows(hessian_problem(rng).motion)
