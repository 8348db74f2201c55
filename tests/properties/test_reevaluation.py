"""A solution is judged from its own arrays: the same sums, written in NumPy with frames first."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from coupled_terms import CappedEffort, RateLimit, Smoothness
from helpers import random_problem, stability_by_hand

import scso_nlp as scso

both_solvers = pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])


@both_solvers
@pytest.mark.parametrize("model", [scso.NoPhysiology(), scso.RigidTendon()])
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0, 10.0, math.inf])
def test_objective_and_rows_are_the_sums_of_the_returned_arrays(rng, solve, model, exponent):
    problem = random_problem(rng, exponent=exponent, reserve=5.0, weights="volume", muscle_model=model)
    solution = solve(problem)
    trajectory, muscles = problem.motion.trajectory, problem.motion.muscles
    strength = (
        trajectory.active_force_capacity
        if isinstance(model, scso.RigidTendon)
        else np.broadcast_to(muscles.max_isometric_force, solution.activation.shape)
    )
    np.testing.assert_allclose(solution.tendon_force, solution.activation * strength, rtol=1e-14)
    np.testing.assert_allclose(solution.actuator_force, 5.0 * solution.control, rtol=1e-14)

    volume = muscles.max_isometric_force * muscles.optimal_fiber_length
    sizes = np.hstack([solution.activation, np.abs(solution.control)])
    weights = np.concatenate([volume / volume.mean(), np.ones(problem.motion.actuators.n_actuators)])
    cost = (weights * sizes).max(axis=1) if math.isinf(exponent) else (weights * sizes**exponent).sum(axis=1)
    # With both signs of controls apart, or the largest as an unknown, the rows tie them to 1e-8.
    tolerance = 1e-12 if 2 <= exponent < math.inf else 1e-6
    assert solution.objective_terms["ActivationEffort"] == pytest.approx(cost.sum(), rel=tolerance)

    produced = np.einsum("kcm,km->kc", trajectory.moment_arms, solution.tendon_force)
    produced += np.einsum("kca,ka->kc", trajectory.actuator_generalized_forces, solution.control)
    equilibrium = solution.rows["MomentEquilibrium"]
    np.testing.assert_allclose(equilibrium.value, produced - trajectory.generalized_forces, atol=1e-10)
    assert equilibrium.names == trajectory.coordinates
    stiffness, work = stability_by_hand(problem)
    expected = np.einsum("kum,km->ku", stiffness, solution.tendon_force) - work
    np.testing.assert_allclose(solution.rows["JointStability"].value, expected, rtol=1e-10, atol=1e-9)
    level = problem.constraints[1].level
    np.testing.assert_array_equal(solution.rows["JointStability"].lower, list(level.values()))


@both_solvers
def test_violations_are_the_largest_misses_of_the_returned_rows(rng, solve):
    solution = solve(random_problem(rng, reserve=5.0))
    rows = solution.rows["JointStability"]
    short = np.maximum(rows.lower - rows.value, 0.0).max()
    assert solution.violation["JointStability"] == pytest.approx(short, abs=1e-15)
    assert set(solution.violation) == {"MomentEquilibrium", "JointStability", "bounds"}
    assert max(solution.violation.values()) < 1e-6


def test_rows_of_pairs_stand_at_the_later_frame(rng):
    problem = random_problem(rng, n_frames=4, reserve=5.0)
    problem = dataclasses.replace(
        problem,
        objectives=(*problem.objectives, Smoothness(weight=1e-4)),
        constraints=(*problem.constraints, RateLimit(fastest=60.0), CappedEffort(most=9.0)),
    )
    solution = scso.solve_trajectory(problem)
    rate = np.diff(solution.activation, axis=0) / np.diff(problem.motion.trajectory.time)[:, None]
    found = solution.rows["RateLimit"].value
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], rate, rtol=1e-9, atol=1e-9)
    smooth = (rate**2).sum(axis=1) * np.diff(problem.motion.trajectory.time)
    assert solution.objective_terms["Smoothness"] == pytest.approx(1e-4 * smooth.sum(), rel=1e-10)
    squares = (solution.activation**2).sum(axis=1)
    np.testing.assert_allclose(solution.rows["CappedEffort"].value[:, 0], squares, rtol=1e-12)
    assert solution.objective == pytest.approx(sum(solution.objective_terms.values()), rel=1e-15)


@pytest.mark.parametrize("weight", [0.25, 4.0])
def test_the_weight_of_an_objective_scales_its_share(rng, weight):
    problem = random_problem(rng)
    heavy = dataclasses.replace(problem, objectives=(scso.ActivationEffort(weight=weight),))
    solution, heavier = scso.solve_trajectory(problem), scso.solve_trajectory(heavy)
    assert heavier.objective == pytest.approx(weight * solution.objective, rel=1e-6)
