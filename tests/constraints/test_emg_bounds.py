"""Bounds from EMG: rows against NumPy, and what they do to a solution."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import elbow, evaluate_terms

import scso_nlp as scso


def activity(values):
    return scso.MuscleActivity(
        groups=("two", "one"), muscles=(("m1", "m3"), ("m2",)), time=[0.0, 0.01, 0.02], values=values
    )


def bounded(moments, **arguments):
    problem = elbow(moments)
    return dataclasses.replace(problem, constraints=(*problem.constraints, scso.EmgBounds(**arguments)))


def test_rows_are_the_distances_from_the_edges_of_the_band(rng):
    measured, activation = rng.uniform(size=(3, 2)), rng.uniform(size=(3, 3))
    problem = bounded([10.0, 20.0, 30.0], activity=activity(measured), below=0.2, above=0.3)
    _, rows, _ = evaluate_terms(problem, activation, np.zeros((3, 0)))
    target = measured[:, [0, 1, 0]]
    expected = np.hstack([activation - target + 0.2, target + 0.3 - activation])
    np.testing.assert_allclose(rows["EmgBounds"], expected, atol=1e-12)
    solution = scso.solve_trajectory(problem, on_failure="return")
    assert solution.rows["EmgBounds"].names == ("m1 low", "m2 low", "m3 low", "m1 high", "m2 high", "m3 high")


def test_an_antagonist_is_as_active_as_the_lower_bound_asks():
    problem = bounded([80.0] * 3, activity=activity([[0.3, 0.6]] * 3), below=0.1, above=math.inf)
    found = scso.solve_trajectory(problem)
    np.testing.assert_allclose(found.activation[:, 1], 0.5, atol=1e-8)
    assert (found.rows["EmgBounds"].multiplier[:, 1] > 0).all()


def test_a_measurement_above_what_a_muscle_can_do_asks_for_all_it_can():
    problem = bounded([90.0] * 3, activity=activity([[0.3, 1.4]] * 3), below=0.0, above=math.inf, soft=100.0)
    found = scso.solve_trajectory(problem)
    np.testing.assert_allclose(found.activation[:, 1], 1.0, atol=1e-6)
    np.testing.assert_allclose(found.variables["EmgBounds.missed"][:, 1], 0.0, atol=1e-6)


def test_a_band_that_equilibrium_does_not_reach_is_missed_at_a_price():
    measured = activity([[0.0, 0.0]] * 3)
    hard = bounded([100.0] * 3, activity=measured, below=0.05, above=0.05)
    with pytest.raises(scso.SolveFailed, match="EmgBounds"):
        scso.solve_trajectory(hard)
    soft = bounded([100.0] * 3, activity=measured, below=0.05, above=0.05, soft=10.0)
    missed = scso.solve_trajectory(soft).variables["EmgBounds.missed"]
    assert missed.max() > 0.1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"below": -0.1}, "below is -0.1, expected a number of at least 0"),
        ({"above": math.nan}, "above is nan"),
        ({"below": math.inf, "above": math.inf}, "both infinite"),
        ({"soft": 0.0}, "soft is 0, expected a positive price"),
    ],
)
def test_contradictory_arguments_are_refused(arguments, message):
    with pytest.raises(scso.ProblemError, match=message):
        scso.EmgBounds(activity=activity(np.zeros((3, 2))), **arguments)
