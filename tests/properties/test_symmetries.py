"""Answers that must not depend on how the same muscles are written down."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest
from helpers import motion, muscle_parameters, random_problem, with_motion, with_stability, with_trajectory

import scso_nlp as scso

#: Activation [-]: see tests/properties/test_solvers_agree.py.
TOLERANCE = 1e-4


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
def test_the_order_of_muscles_does_not_matter(rng, exponent):
    problem = random_problem(rng, exponent=exponent)
    order = rng.permutation(10)
    moved = scso.solve_trajectory(_with_muscles(problem, order))
    np.testing.assert_allclose(
        moved.activation, scso.solve_trajectory(problem).activation[:, order], atol=TOLERANCE
    )
    assert moved.problem.motion.muscles.muscles == tuple(problem.motion.muscles.muscles[i] for i in order)


def test_the_order_of_coordinates_does_not_matter(rng):
    problem = random_problem(rng)
    order = [2, 0, 1]
    trajectory = problem.motion.trajectory
    changes = {
        name: getattr(trajectory, name)[:, order]
        for name in (
            "moment_arms",
            "generalized_forces",
            "actuator_generalized_forces",
            "passive_generalized_forces",
        )
    }
    moved = with_trajectory(problem, coordinates=("q3", "q1", "q2"), **changes)
    answers = scso.solve_trajectory(problem), scso.solve_trajectory(moved)
    np.testing.assert_allclose(answers[0].activation, answers[1].activation, atol=TOLERANCE)
    rows = [answer.rows["MomentEquilibrium"] for answer in answers]
    assert rows[1].names == ("q3", "q1", "q2")
    np.testing.assert_allclose(rows[0].multiplier[:, order], rows[1].multiplier, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("stability", [False, True])
def test_a_muscle_in_two_halves_pulls_as_hard_under_volume_weights(rng, exponent, stability):
    problem = random_problem(rng, exponent=exponent, weights="volume", stability=stability)
    whole = scso.solve_trajectory(problem).tendon_force
    halves = _with_muscles(problem, [*range(10), 0], halved=(0, 10))
    force = scso.solve_trajectory(halves).tendon_force
    # A newton is 1e-3 of a weak muscle.
    tolerance = TOLERANCE * problem.motion.muscles.max_isometric_force.max()
    np.testing.assert_allclose(force[:, 1:10], whole[:, 1:], atol=tolerance)
    np.testing.assert_allclose(force[:, 0] + force[:, 10], whole[:, 0], atol=tolerance)
    np.testing.assert_allclose(force[:, 0], force[:, 10], atol=tolerance)


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
@pytest.mark.parametrize("weight", [1e-12, 1e-4, 1e6])
def test_the_unit_of_the_objective_does_not_matter(rng, solve, weight):
    problem = random_problem(rng, reserve=5.0)
    weighed = dataclasses.replace(problem, objectives=(scso.ActivationEffort(weight=weight),))
    plain, other = solve(problem), solve(weighed)
    np.testing.assert_allclose(other.activation, plain.activation, atol=1e-7)
    for name, row in plain.rows.items():
        np.testing.assert_allclose(other.rows[name].multiplier / weight, row.multiplier, rtol=1e-4, atol=1e-9)


def test_a_constant_in_the_objective_does_not_matter(rng):
    """An offset of the objective must not drown what is to be minimised."""
    problem = random_problem(rng, reserve=5.0)
    offset = dataclasses.replace(problem, objectives=(*problem.objectives, lambda frame: ca.SX(1e6)))
    plain, other = scso.solve_trajectory(problem), scso.solve_trajectory(offset)
    np.testing.assert_allclose(other.activation, plain.activation, atol=1e-5)
    assert other.objective == pytest.approx(3e6 + plain.objective, rel=1e-12)


@pytest.mark.parametrize("factor", [1e-2, 10.0])
def test_stronger_muscles_for_a_larger_task_are_as_active(rng, factor):
    """All forces times one factor: strength, moments, loads and levels."""
    problem = random_problem(rng)
    trajectory, skeleton = problem.motion.trajectory, problem.motion.trajectory.skeleton
    larger = with_motion(
        problem,
        muscles=dataclasses.replace(
            problem.motion.muscles,
            max_isometric_force=factor * problem.motion.muscles.max_isometric_force,
        ),
        trajectory=dataclasses.replace(
            trajectory,
            generalized_forces=factor * trajectory.generalized_forces,
            skeleton=dataclasses.replace(skeleton, load_forces=factor * skeleton.load_forces),
        ),
    )
    level = {name: factor * value for name, value in problem.constraints[1].level.items()}
    answer = scso.solve_trajectory(with_stability(larger, level))
    np.testing.assert_allclose(answer.activation, scso.solve_trajectory(problem).activation, atol=TOLERANCE)


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_larger_body_for_a_larger_task_is_as_active(rng, factor):
    """All lengths times one factor: arms, points and, with them, moments and levels."""
    problem = random_problem(rng)
    trajectory, skeleton = problem.motion.trajectory, problem.motion.trajectory.skeleton
    larger = with_trajectory(
        problem,
        moment_arms=factor * trajectory.moment_arms,
        generalized_forces=factor * trajectory.generalized_forces,
        muscle_tendon_length=factor * trajectory.muscle_tendon_length,
        skeleton=dataclasses.replace(
            skeleton,
            path_points=factor * skeleton.path_points,
            load_points=factor * skeleton.load_points,
        ),
    )
    level = {name: factor * value for name, value in problem.constraints[1].level.items()}
    answer = scso.solve_trajectory(with_stability(larger, level))
    np.testing.assert_allclose(answer.activation, scso.solve_trajectory(problem).activation, atol=TOLERANCE)


@pytest.mark.parametrize("optimal_force", [1.0, 20.0, 500.0])
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0])
def test_a_reserve_of_another_size_with_its_weight_is_the_same_reserve(exponent, optimal_force):
    """c^p of a reserve with optimal force f costs as much as (f c)^p at weight f^-p."""
    moments = np.array([[20.0], [-15.0]])
    solutions = []
    for force, weight in ((optimal_force, 1.0), (1.0, optimal_force**-exponent)):
        trajectory = motion(np.broadcast_to([[0.1, 0.05]], (2, 1, 2)), moments, actuator_columns=[[force]])
        problem = scso.MuscleForceProblem(
            motion=scso.Motion(
                trajectory=trajectory,
                muscles=muscle_parameters(trajectory.muscles, [300.0, 500.0]),
                actuators=scso.ActuatorParameters(
                    actuators=trajectory.actuators,
                    optimal_force=[force],
                    min_control=[-np.inf],
                    max_control=[np.inf],
                ),
            ),
            muscle_model=scso.NoPhysiology(),
            objectives=(scso.ActivationEffort(exponent=exponent, weights={"reserve1": weight}),),
        )
        solutions.append(scso.solve_trajectory(problem))
    np.testing.assert_allclose(solutions[0].activation, solutions[1].activation, atol=TOLERANCE)
    # The largest moment is 20 N·m.
    np.testing.assert_allclose(solutions[0].actuator_force, solutions[1].actuator_force, atol=20 * TOLERANCE)


def _with_muscles(problem, chosen, halved=()):
    """The problem with its muscles in another order, some twice (at half the strength)."""
    chosen = np.asarray(chosen)
    trajectory, muscles, skeleton = (
        problem.motion.trajectory,
        problem.motion.muscles,
        problem.motion.trajectory.skeleton,
    )
    names = [muscles.muscles[i] for i in chosen]
    names = tuple(f"{name}_copy" if name in names[:at] else name for at, name in enumerate(names))
    strength = muscles.max_isometric_force[chosen]
    strength[list(halved)] /= 2
    return with_motion(
        problem,
        muscles=muscle_parameters(names, strength, optimal_fiber_length=muscles.optimal_fiber_length[chosen]),
        trajectory=dataclasses.replace(
            trajectory,
            muscles=names,
            muscle_tendon_length=trajectory.muscle_tendon_length[:, chosen],
            muscle_tendon_velocity=trajectory.muscle_tendon_velocity[:, chosen],
            moment_arms=trajectory.moment_arms[:, :, chosen],
            active_force_capacity=trajectory.active_force_capacity[:, chosen],
            skeleton=dataclasses.replace(
                skeleton,
                path_points=skeleton.path_points[:, chosen],
                path_point_bodies=skeleton.path_point_bodies[:, chosen],
                path_point_moves=skeleton.path_point_moves[:, chosen],
                virtual_moment_arms=np.zeros((0, 0, 0)),
                virtual_curvature=np.zeros((0, 0, 0)),
            ),
        ),
    )
