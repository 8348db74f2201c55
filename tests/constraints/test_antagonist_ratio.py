"""Antagonists at a share of agonists: closed form of one joint, rows against NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, evaluate_terms, random_problem, two_antagonists

import scso_nlp as scso


def with_ratio(problem, **arguments):
    return dataclasses.replace(
        problem, constraints=(scso.MomentEquilibrium(), scso.AntagonistRatio(**arguments))
    )


@pytest.mark.parametrize("moment", [20.0, -20.0])
def test_the_antagonist_pulls_its_share_whichever_it_is(moment):
    """100 N·m per unit of activation on either side: agonist 0.2 / (1 - ratio)."""
    found = scso.solve_trajectory(with_ratio(two_antagonists(moment, strength=2000.0), ratio=0.25))
    agonist = 0.2 / 0.75
    expected = [agonist, 0.25 * agonist]
    np.testing.assert_allclose(found.activation[0], expected if moment > 0 else expected[::-1], atol=1e-8)


def test_rows_are_sums_of_moments_on_both_sides(rng):
    problem = with_ratio(random_problem(rng, n_frames=3, reserve=5.0, stability=False), ratio=0.3)
    trajectory = problem.motion.trajectory
    activation, control = rng.uniform(size=(3, 10)), rng.normal(size=(3, 3))
    _, rows, force = evaluate_terms(problem, activation, control)
    moments = np.sign(trajectory.generalized_forces)[:, :, None] * trajectory.moment_arms * force[:, None]
    expected = np.maximum(-moments, 0).sum(axis=2) - 0.3 * np.maximum(moments, 0).sum(axis=2)
    np.testing.assert_allclose(rows["AntagonistRatio"], expected, atol=1e-9)


def test_coordinates_with_muscles_on_one_side_are_left_out_and_if_all_are_said_so():
    with pytest.raises(scso.ProblemError, match="no coordinate has muscles on both sides"):
        scso.solve_trajectory(with_ratio(elbow([10.0])))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"ratio": 1.0}, "ratio is 1"), ({"ratio": -0.1}, "ratio"), ({"soft": 0.0}, "soft")],
)
def test_contradictory_arguments_are_refused(arguments, message):
    with pytest.raises(scso.ProblemError, match=message):
        scso.AntagonistRatio(**arguments)
