"""The cone of a socket: rows against NumPy, and what it asks of a solution."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import evaluate_terms, random_problem, with_joint_reactions

import scso_nlp as scso

AXIS = np.array([0.0, -3.0, 4.0])


def in_the_cone(rng, **arguments):
    problem = with_joint_reactions(random_problem(rng, reserve=5.0, stability=False), rng, ("shoulder",))
    cone = scso.JointReactionCone(axis=AXIS.tolist(), **arguments)
    return dataclasses.replace(problem, constraints=(*problem.constraints, cone))


def shear_and_compression(forces):
    """Of forces on the parent in its frame, shape (n_frames, 1, 3)."""
    compression = forces[:, 0] @ AXIS / 5.0
    return np.sqrt((forces[:, 0] ** 2).sum(axis=1) - compression**2), compression


def test_the_row_is_the_shear_that_may_be_added(rng):
    problem = in_the_cone(rng, slope=0.6)
    activation, control = rng.uniform(0, 1, (3, 10)), rng.normal(size=(3, 3))
    _, rows, tendon_force = evaluate_terms(problem, activation, control)
    reactions = problem.motion.trajectory.joint_reactions
    forces = reactions.at(tendon_force, control, on="parent", frame="parent").forces
    shear, compression = shear_and_compression(forces)
    # rounded off by 1 N
    expected = 0.6 * compression - np.sqrt(shear**2 + 1.0)
    np.testing.assert_allclose(rows["JointReactionCone"][:, 0], expected, rtol=1e-10)


def test_the_force_of_a_solution_lies_in_the_cone_and_on_its_side_where_that_costs(rng):
    problem = in_the_cone(np.random.default_rng(11), slope=0.8)
    free = dataclasses.replace(problem, constraints=problem.constraints[:1])
    shear, compression = shear_and_compression(
        scso.solve_trajectory(free).joint_reactions(on="parent", frame="parent").forces
    )
    assert (shear > 0.8 * compression).any()
    solution = scso.solve_trajectory(problem)
    shear, compression = shear_and_compression(solution.joint_reactions(on="parent", frame="parent").forces)
    assert (compression > 0).all()
    assert (shear <= 0.8 * compression).all()
    costs = solution.rows["JointReactionCone"].multiplier[:, 0] > 1e-8
    assert costs.any()
    np.testing.assert_allclose(np.hypot(shear, 1.0)[costs], 0.8 * compression[costs], atol=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"axis": (0.0, 0.0, 0.0)}, "expected three numbers that are not all zero"),
        ({"axis": (1.0, 0.0)}, "expected three numbers"),
        ({"slope": 0.0}, "slope is 0, expected a positive number"),
        ({"slope": math.inf}, "slope is inf"),
        ({"soft": -1.0}, "soft is -1"),
    ],
)
def test_the_words_of_its_refusals(arguments, message):
    with pytest.raises(scso.ProblemError, match=message):
        scso.JointReactionCone(**arguments)
