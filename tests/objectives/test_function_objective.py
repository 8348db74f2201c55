"""A cost given as a function."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
from helpers import evaluate_terms, random_problem

import scso_nlp as scso


def joint_load(frame):
    """Squared sum of forces, scaled."""
    return (ca.sum1(frame.muscle.tendon_force) / 1000.0) ** 2


def test_the_function_sees_forces_arms_moments_and_controls_of_its_frame(rng):
    def everything(frame):
        torque = frame.moment_arms @ frame.muscle.tendon_force
        torque += frame.actuator_generalized_forces @ frame.control
        return ca.dot(torque, frame.generalized_forces) + ca.dot(
            frame.muscle_tendon_length, frame.activation * frame.muscle_tendon_velocity
        )

    problem = random_problem(rng, reserve=5.0)
    trajectory = dataclasses.replace(
        problem.motion.trajectory, muscle_tendon_velocity=rng.normal(size=(3, 10))
    )
    problem = dataclasses.replace(
        problem, motion=dataclasses.replace(problem.motion, trajectory=trajectory), objectives=(everything,)
    )
    activation, control = rng.uniform(0, 1, (3, 10)), rng.normal(size=(3, 3))
    costs, _, _ = evaluate_terms(problem, activation, control)
    force = activation * problem.motion.muscles.max_isometric_force
    torque = np.einsum("kcm,km->kc", trajectory.moment_arms, force)
    torque += np.einsum("kca,ka->kc", trajectory.actuator_generalized_forces, control)
    expected = np.einsum("kc,kc->k", torque, trajectory.generalized_forces)
    expected += np.einsum(
        "km,km,km->k", trajectory.muscle_tendon_length, activation, trajectory.muscle_tendon_velocity
    )
    np.testing.assert_allclose(costs["everything"], expected, rtol=1e-12)


def test_the_name_is_the_label_or_the_functions_own():
    assert scso.FunctionObjective(function=joint_load).name == "joint_load"
    assert scso.FunctionObjective(function=joint_load, label="load").name == "load"


def test_the_weight_multiplies_the_function(rng):
    problem = random_problem(rng)
    term = scso.FunctionObjective(function=joint_load, weight=0.25)
    problem = dataclasses.replace(problem, objectives=(term,))
    activation = rng.uniform(0, 1, (3, 10))
    force = activation * problem.motion.muscles.max_isometric_force
    found = evaluate_terms(problem, activation)[0]["joint_load"]
    np.testing.assert_allclose(found, 0.25 * (force.sum(axis=1) / 1000.0) ** 2, rtol=1e-12)


def test_effort_as_a_function_gives_the_same_optimum_as_the_term(rng):
    problem = random_problem(rng, reserve=5.0)
    same = dataclasses.replace(
        problem, objectives=(lambda f: ca.sumsqr(f.activation) + ca.sumsqr(f.control),)
    )
    ours, theirs = scso.solve_trajectory(problem), scso.solve_trajectory(same)
    np.testing.assert_allclose(ours.activation, theirs.activation, atol=1e-6)
