"""Squared joint forces against their sum in NumPy, and their optimum against Clarabel's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, frame_arrays, random_problem, solve_qp, with_joint_reactions

import scso_nlp as scso


def with_effort(rng, *objectives, **changes):
    problem = with_joint_reactions(random_problem(rng, reserve=5.0, **changes), rng)
    return dataclasses.replace(problem, objectives=(*problem.objectives, *objectives))


def joint_forces(problem, tendon_force, control):
    """Forces on children in ground, shape (n_frames, n_joints, 3)."""
    reactions = problem.motion.trajectory.joint_reactions
    forces = np.einsum("kjcm,km->kjc", reactions.per_tendon_force, tendon_force)
    forces += np.einsum("kjca,ka->kjc", reactions.per_control, control)
    return (forces + reactions.constant)[:, :, :3]


@pytest.mark.parametrize(
    ("term", "weights"),
    [
        (scso.JointReactionEffort(), [0.5, 0.5]),
        (scso.JointReactionEffort(joints=["knee"]), [0.0, 1.0]),
        (scso.JointReactionEffort(weights={"*": 3.0, "knee": 0.2}), [1.5, 0.1]),
    ],
)
@pytest.mark.parametrize("model", [scso.NoPhysiology(), scso.RigidTendon()])
def test_the_cost_is_the_weighted_mean_of_squares_in_body_weights(rng, term, weights, model):
    problem = with_effort(rng, term, muscle_model=model)
    activation, control = rng.uniform(0, 1, (3, 10)), rng.normal(size=(3, 3))
    costs, _, tendon_force = evaluate_terms(problem, activation, control)
    squares = (joint_forces(problem, tendon_force, control) ** 2).sum(axis=2) / 700.0**2
    np.testing.assert_allclose(costs["JointReactionEffort"], squares @ weights, rtol=1e-12)


def test_the_optimum_is_that_of_the_quadratic_program(rng):
    problem = with_effort(rng, scso.JointReactionEffort(weight=0.7), stability=False)
    solution = scso.solve_trajectory(problem)
    reactions, strength = (
        problem.motion.trajectory.joint_reactions,
        problem.motion.muscles.max_isometric_force,
    )
    for k in range(3):
        weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
        per_force, per_control = reactions.per_tendon_force[k, :, :3], reactions.per_control[k, :, :3]
        share = np.sqrt(0.7 / 2) / 700.0
        matrix = share * np.concatenate([per_force * strength, per_control], axis=2).reshape(6, -1)
        constant = share * reactions.constant[k, :, :3].ravel()
        hessian = np.diag(2 * weights) + 2 * matrix.T @ matrix
        x = solve_qp(hessian, 2 * matrix.T @ constant, a, b, g, h, lower, upper)
        found = np.concatenate([solution.activation[k], solution.control[k]])
        np.testing.assert_allclose(found, x, atol=1e-6)


def test_joint_forces_fall_as_their_weight_rises(rng):
    def carried(weight):
        own = np.random.default_rng(3)
        problem = with_effort(own, scso.JointReactionEffort(weight=weight), stability=False)
        return (scso.solve_trajectory(problem).joint_reactions().resultant ** 2).sum()

    at = [carried(weight) for weight in (0.0, 1.0, 100.0)]
    assert at[0] > 1.01 * at[1] > 1.01 * at[2]


def test_the_words_of_its_refusals(rng):
    with pytest.raises(scso.ProblemError, match="weight of 'knee' is -1, expected a finite number"):
        scso.JointReactionEffort(weights={"knee": -1.0})
    with pytest.raises(scso.NameMismatchError, match="kne"):
        scso.solve_trajectory(with_effort(rng, scso.JointReactionEffort(joints=["kne"])))
    problem = random_problem(rng)
    without = dataclasses.replace(problem, objectives=(scso.JointReactionEffort(),))
    with pytest.raises(
        scso.ProblemError, match="without joint reactions; read it again with joint_reactions="
    ):
        scso.solve_trajectory(without)
