"""OpenSim's convention: force is activation times the capacity of the frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, random_problem

import scso_nlp as scso


def test_opensim_force_is_activation_times_the_capacity_of_the_frame(rng):
    problem = random_problem(rng, muscle_model=scso.RigidTendon(convention="opensim"))
    activation = rng.uniform(0, 1, (3, 10))
    force = evaluate_terms(problem, activation)[2]
    np.testing.assert_allclose(force, activation * problem.trajectory.active_force_capacity, rtol=1e-15)


def test_a_muscle_without_capacity_in_a_frame_gives_no_force_there(rng):
    problem = random_problem(rng, muscle_model=scso.RigidTendon(), reserve=5.0, stability=False)
    capacity = problem.trajectory.active_force_capacity.copy()
    capacity[1] = 0.0
    problem = dataclasses.replace(
        problem, trajectory=dataclasses.replace(problem.trajectory, active_force_capacity=capacity)
    )
    for solve in (scso.solve_trajectory, scso.solve_framewise):
        solution = solve(problem)
        np.testing.assert_array_equal(solution.tendon_force[1], 0.0)
        np.testing.assert_allclose(
            solution.actuator_force[1], problem.trajectory.generalized_forces[1], rtol=1e-9
        )


def test_an_unknown_convention_is_refused():
    with pytest.raises(scso.ProblemError, match="convention is 'hill', expected 'opensim'"):
        scso.RigidTendon(convention="hill")
