"""Moment equilibrium against its sum in NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, random_problem

import scso_nlp as scso


@pytest.mark.parametrize("model", [scso.NoPhysiology(), scso.RigidTendon()])
@pytest.mark.parametrize("reserve", [None, 5.0])
def test_rows_are_produced_less_required_forces(rng, model, reserve):
    problem = random_problem(rng, reserve=reserve, muscle_model=model, n_coordinates=4)
    n_actuators = problem.actuators.n_actuators
    # Actuators need not act on one coordinate each, nor alike in every frame.
    trajectory = dataclasses.replace(
        problem.trajectory, actuator_generalized_forces=rng.normal(size=(3, 4, n_actuators))
    )
    problem = dataclasses.replace(problem, trajectory=trajectory)
    activation, control = rng.uniform(0, 1, (3, 10)), rng.normal(size=(3, n_actuators))
    _, rows, force = evaluate_terms(problem, activation, control)
    expected = np.einsum("kcm,km->kc", trajectory.moment_arms, force)
    expected += np.einsum("kca,ka->kc", trajectory.actuator_generalized_forces, control)
    expected -= trajectory.generalized_forces
    np.testing.assert_allclose(rows["MomentEquilibrium"], expected, rtol=1e-10, atol=1e-10)


def test_rows_are_equations_named_by_coordinate_in_its_own_unit(rng):
    problem = random_problem(rng)
    trajectory = dataclasses.replace(problem.trajectory, is_rotational=[True, False, True])
    solution = scso.solve_framewise(dataclasses.replace(problem, trajectory=trajectory))
    rows = solution.rows["MomentEquilibrium"]
    assert rows.names == ("q1", "q2", "q3")
    assert rows.unit == ("N·m", "N", "N·m")
    np.testing.assert_array_equal(rows.lower, 0.0)
    np.testing.assert_array_equal(rows.upper, 0.0)
