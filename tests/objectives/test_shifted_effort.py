"""Effort counted from a shift: the closed form of one joint, and what antagonists do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, evaluate_terms, two_antagonists

import scso_nlp as scso

#: Moment of one unit of activation of the elbow's muscles [N·m].
MOMENTS = np.array([0.1 * 1450.0, 0.05 * 1200.0, 0.02 * 1000.0])


def shifted(problem, **arguments):
    return dataclasses.replace(problem, objectives=(scso.ShiftedEffort(**arguments),))


def test_the_optimum_of_squares_is_the_shift_and_a_share_of_the_rest():
    moments = np.array([40.0, 60.0])
    found = scso.solve_trajectory(shifted(elbow(moments), shift={"*": 0.1, "m3": 0.3})).activation
    shift = np.array([0.1, 0.1, 0.3])
    expected = shift + (moments - shift @ MOMENTS)[:, None] * MOMENTS / (MOMENTS**2).sum()
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("exponent", [2.0, 3.0, 4.5])
def test_the_cost_is_the_sum_of_powers_of_distances(rng, exponent):
    problem = shifted(elbow([1.0, 2.0], reserve=10.0), shift=0.2, exponent=exponent)
    activation, control = rng.uniform(size=(2, 3)), rng.normal(size=(2, 1))
    cost, _, _ = evaluate_terms(problem, activation, control)
    expected = (np.abs(activation - 0.2) ** exponent).sum(axis=1) + np.abs(control[:, 0]) ** exponent
    np.testing.assert_allclose(cost["ShiftedEffort"], expected, rtol=1e-10)


def test_antagonists_without_a_moment_are_both_at_the_shift():
    free = two_antagonists(0.0)
    problem = dataclasses.replace(shifted(free, shift=0.07), constraints=(scso.MomentEquilibrium(),))
    np.testing.assert_allclose(scso.solve_trajectory(problem).activation, 0.07, atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"shift": -0.1}, "shift is -0.1"),
        ({"shift": {"m1": np.nan}}, "shift is nan"),
        ({"exponent": 1.5}, "exponent is 1.5, expected a number from 2"),
        ({"weight": -1.0}, "weight is -1"),
    ],
)
def test_contradictory_arguments_are_refused(arguments, message):
    with pytest.raises(scso.ProblemError, match=message):
        scso.ShiftedEffort(**arguments)
