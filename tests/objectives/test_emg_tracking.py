"""Tracking of EMG: the cost against NumPy, the optimum against its closed form."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, evaluate_terms

import scso_nlp as scso

#: Moment of one unit of activation of the elbow's muscles [N·m].
MOMENTS = np.array([0.1 * 1450.0, 0.05 * 1200.0, 0.02 * 1000.0])


def activity(values, **changes):
    arguments = {"groups": ("two", "one"), "muscles": (("m1", "m3"), ("m2",)), "time": [0.0, 0.01, 0.02]}
    return scso.MuscleActivity(**{**arguments, "values": values, **changes})


def tracked(moments, term, exponent=2.0):
    problem = elbow(moments, exponent=exponent)
    return dataclasses.replace(problem, objectives=(*problem.objectives, term))


def test_a_group_counts_once_however_many_muscles_it_has(rng):
    values = rng.uniform(size=(3, 2))
    term = scso.EmgTracking(activity=activity(values), weights={"one": 3.0})
    activation = rng.uniform(size=(3, 3))
    cost, _, _ = evaluate_terms(tracked([10.0, 20.0, 30.0], term), activation, np.zeros((3, 0)))
    of_two = ((activation[:, [0, 2]] - values[:, :1]) ** 2).mean(axis=1)
    of_one = (activation[:, 1] - values[:, 1]) ** 2
    np.testing.assert_allclose(cost["EmgTracking"], of_two + 3.0 * of_one, rtol=1e-12)


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_the_optimum_beside_squared_activations_is_the_closed_form(solve):
    measured = np.array([[0.3, 0.1], [0.2, 0.4], [0.25, 0.2]])
    moments = np.array([50.0, 60.0, 70.0])
    term = scso.EmgTracking(activity=activity(measured), weight=4.0)
    found = solve(tracked(moments, term)).activation
    # minimise sum a² + w (a - e)² with M a = moment: a = (w e + multiplier M) / (1 + w)
    weight, target = np.array([2.0, 4.0, 2.0]), measured[:, [0, 1, 0]]
    free = weight * target / (1 + weight)
    multiplier = (moments - free @ MOMENTS) / (MOMENTS**2 / (1 + weight)).sum()
    expected = free + multiplier[:, None] * MOMENTS / (1 + weight)
    assert (expected > 0).all()
    assert (expected < 1).all()
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_muscles_without_a_measurement_are_as_they_would_be_with_that_force_given():
    term = scso.EmgTracking(activity=activity([[0.5]] * 3, groups=("one",), muscles=(("m2",),)), weight=1e6)
    found = scso.solve_trajectory(tracked([50.0, 60.0, 70.0], term)).activation
    np.testing.assert_allclose(found[:, 1], 0.5, atol=1e-5)
    # the other two share the rest as without EMG
    np.testing.assert_allclose(found[:, 0] / found[:, 2], MOMENTS[0] / MOMENTS[2], rtol=1e-5)


def test_frames_of_a_motion_get_their_own_activity(rng):
    values = rng.uniform(size=(3, 2))
    problem = tracked([10.0, 20.0, 30.0], scso.EmgTracking(activity=activity(values), weight=5.0))
    whole = scso.solve_trajectory(problem).activation
    part = scso.solve_trajectory(problem.frames(1, 3)).activation
    np.testing.assert_allclose(part, whole[1:], atol=1e-8)


@pytest.mark.parametrize("weight", [-1.0, np.nan, np.inf])
def test_a_weight_that_is_none_is_refused(weight):
    with pytest.raises(scso.ProblemError, match="expected a finite number of at least 0"):
        scso.EmgTracking(activity=activity(np.zeros((3, 2))), weight=weight)
    with pytest.raises(scso.ProblemError, match="weight of 'one'"):
        scso.EmgTracking(activity=activity(np.zeros((3, 2))), weights={"one": weight})


def test_an_unknown_group_is_refused():
    term = scso.EmgTracking(activity=activity(np.zeros((3, 2))), weights={"onne": 2.0})
    with pytest.raises(scso.NameMismatchError, match=r"'onne' \(closest: one"):
        scso.solve_trajectory(tracked([10.0], term))
