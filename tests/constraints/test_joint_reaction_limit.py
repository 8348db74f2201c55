"""Limits of joint forces: rows against NumPy, optima against another solver."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, frame_arrays, random_problem, with_joint_reactions, with_trajectory
from scipy.optimize import minimize

import scso_nlp as scso


def limited(rng, term, **changes):
    problem = with_joint_reactions(random_problem(rng, reserve=5.0, stability=False, **changes), rng)
    return dataclasses.replace(problem, constraints=(*problem.constraints, term))


def test_rows_are_what_is_left_to_the_limits(rng):
    term = scso.JointReactionLimit(
        largest={"knee": 900.0}, components={"hip_f[xz]": 500.0}, on="parent", frame="child"
    )
    problem = limited(rng, term)
    activation, control = rng.uniform(0, 1, (3, 10)), rng.normal(size=(3, 3))
    _, rows, tendon_force = evaluate_terms(problem, activation, control)
    reactions = problem.motion.trajectory.joint_reactions
    values = np.einsum("kjcm,km->kjc", reactions.per_tendon_force, tendon_force)
    values = (values + np.einsum("kjca,ka->kjc", reactions.per_control, control) + reactions.constant)[
        :, :, :3
    ]
    hip, knee = -np.einsum("kjba,kjb->kja", reactions.child_rotations, values).transpose(1, 0, 2)
    # the length of a force is rounded off by 1 N
    expected = [900.0 - np.sqrt((knee**2).sum(axis=1) + 1.0)]
    expected += [500.0 - sign * hip[:, i] for i in (0, 2) for sign in (1, -1)]
    np.testing.assert_allclose(rows["JointReactionLimit"], np.stack(expected, axis=1), rtol=1e-10)


def test_limits_in_body_weights_are_those_in_newtons(rng):
    """The model weighs 700 N."""
    same = (
        {"largest": "1.5BW", "components": {"hip_f?": " .5 BW "}},
        {"largest": 1050.0, "components": {"hip_f?": 350.0}},
    )
    point = rng.uniform(0, 1, (3, 10)), rng.normal(size=(3, 3))
    in_weights, in_newtons = (
        evaluate_terms(limited(np.random.default_rng(2), scso.JointReactionLimit(**limits)), *point)[1]
        for limits in same
    )
    np.testing.assert_array_equal(in_weights["JointReactionLimit"], in_newtons["JointReactionLimit"])


def test_a_limit_in_body_weights_needs_a_model_that_has_some(rng):
    problem = limited(rng, scso.JointReactionLimit(largest="3BW"))
    reactions = dataclasses.replace(problem.motion.trajectory.joint_reactions, body_weight=0.0)
    with pytest.raises(scso.ProblemError, match=r"is '3BW', .* of a model that has mass"):
        scso.solve_trajectory(with_trajectory(problem, joint_reactions=reactions))


def test_a_limit_is_kept_at_the_least_cost(rng):
    """The same optimum as SciPy's sequential quadratic programming, which knows the length as it is."""
    free = limited(np.random.default_rng(5), scso.JointReactionLimit(largest=1e6))
    usual = scso.solve_trajectory(free).joint_reactions().resultant
    largest = {name: float(0.9 * peak) for name, peak in zip(("hip", "knee"), usual.max(axis=0), strict=True)}
    problem = limited(np.random.default_rng(5), scso.JointReactionLimit(largest=largest))
    solution = scso.solve_trajectory(problem)
    found, limits = solution.joint_reactions().resultant, np.array(list(largest.values()))
    assert (found <= limits).all()
    assert (solution.rows["JointReactionLimit"].multiplier > 1e-8).any(axis=0).all()
    reactions, strength = (
        problem.motion.trajectory.joint_reactions,
        problem.motion.muscles.max_isometric_force,
    )
    k = int((usual / limits).max(axis=1).argmax())
    weights, a, b, _, _, lower, upper = frame_arrays(problem, k)
    matrix = np.concatenate([reactions.per_tendon_force[k] * strength, reactions.per_control[k]], axis=2)

    def room(x):
        return (limits - np.linalg.norm((matrix @ x + reactions.constant[k])[:, :3], axis=1)) / 100

    ours = np.concatenate([solution.activation[k], solution.control[k]])
    answer = minimize(
        lambda x: (weights * x**2).sum(),
        ours + 0.05,
        jac=lambda x: 2 * weights * x,
        bounds=list(zip(lower, upper, strict=True)),
        constraints=[{"type": "eq", "fun": lambda x: a @ x - b}, {"type": "ineq", "fun": room}],
        options={"ftol": 1e-13, "maxiter": 300},
    )
    assert answer.success
    np.testing.assert_allclose(ours, answer.x, atol=2e-4)


def test_a_limit_may_be_exceeded_at_a_price(rng):
    hard = limited(np.random.default_rng(5), scso.JointReactionLimit(largest=50.0))
    assert not scso.solve_trajectory(hard, on_failure="return").is_solved.all()
    soft = limited(np.random.default_rng(5), scso.JointReactionLimit(largest=50.0, soft=1e-3))
    solution = scso.solve_trajectory(soft)
    missed = solution.variables["JointReactionLimit.missed"]
    excess = np.maximum(solution.joint_reactions().resultant - 50.0, 0.0)
    assert excess.max() > 10.0
    # lengths are rounded off by 1 N
    np.testing.assert_allclose(missed, excess, atol=0.05)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "no limit is given"),
        (
            {"largest": -5.0},
            "the limit of 'all joints' is -5.0, expected more than 1 N, or text such as '3BW'",
        ),
        ({"largest": float("inf")}, "the limit of 'all joints' is inf"),
        ({"largest": {"knee": "0BW"}}, "the limit of 'knee' is '0BW'"),
        ({"largest": "300"}, "the limit of 'all joints' is '300'"),
        ({"components": {"knee_fx": 0.0}}, "the limit of 'knee_fx' is 0.0"),
        ({"largest": 100.0, "soft": 0.0}, "soft is 0, expected a positive price per N"),
    ],
)
def test_the_words_of_its_refusals(arguments, message):
    with pytest.raises(scso.ProblemError, match=message):
        scso.JointReactionLimit(**arguments)


def test_unknown_components_are_named(rng):
    problem = limited(rng, scso.JointReactionLimit(components={"knee_y": 100.0}))
    with pytest.raises(scso.NameMismatchError, match="knee_y"):
        scso.solve_trajectory(problem)
