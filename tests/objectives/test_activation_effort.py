"""Muscle effort against its sum in NumPy; optima are in tests/analytic and tests/oracle."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import evaluate_terms, random_problem

import scso_nlp as scso


def effort(problem, activation, control, **variables):
    own = {("ActivationEffort", name): value for name, value in variables.items()}
    return evaluate_terms(problem, activation, control, own)


@pytest.fixture
def point(rng):
    return rng.uniform(0.0, 1.0, (3, 10)), rng.normal(size=(3, 3))


@pytest.mark.parametrize("exponent", [2.0, 2.5, 3.0, 7.3, 100.0])
def test_effort_is_the_weighted_sum_of_powers_of_muscles_and_actuators(rng, point, exponent):
    problem = random_problem(
        rng, exponent=exponent, reserve=5.0, weights={"*": 2.0, "m3": 0.5, "reserve*": 3.0}
    )
    weights = np.full(10, 2.0)
    weights[2] = 0.5
    activation, control = point
    expected = np.einsum("m,km->k", weights, activation**exponent)
    expected += 3.0 * (np.abs(control) ** exponent).sum(axis=1)
    found = effort(problem, activation, control)[0]["ActivationEffort"]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_below_two_both_signs_of_a_control_stand_apart(rng, point, exponent):
    problem = random_problem(rng, exponent=exponent, reserve=5.0)
    activation, control = point
    pull, push = np.maximum(control, 0.0), np.maximum(-control, 0.0)
    costs, rows, _ = effort(problem, activation, control, pull=pull, push=push)
    expected = (activation**exponent).sum(axis=1) + (np.abs(control) ** exponent).sum(axis=1)
    np.testing.assert_allclose(costs["ActivationEffort"], expected, rtol=1e-12)
    np.testing.assert_allclose(rows["ActivationEffort"], 0.0, atol=1e-15)


def test_min_max_bounds_every_weighted_size_from_above(rng, point):
    problem = random_problem(rng, exponent=math.inf, reserve=5.0, weights={"m2": 3.0, "reserve1": 0.1})
    activation, control = point
    largest = rng.uniform(2.0, 3.0, (3, 1))
    costs, rows, _ = effort(problem, activation, control, largest=largest)
    np.testing.assert_array_equal(costs["ActivationEffort"], largest[:, 0])
    weights = np.ones(13)
    weights[[1, 10]] = 3.0, 0.1
    sizes = weights * np.hstack([activation, control])
    expected = np.hstack([largest - sizes, largest + sizes[:, 10:]])
    np.testing.assert_allclose(rows["ActivationEffort"], expected, rtol=1e-12)


@pytest.mark.parametrize("weights", ["volume", "pcsa"])
def test_weights_by_size_have_a_mean_of_one(rng, point, weights):
    problem = random_problem(rng, reserve=5.0, weights=weights)
    size = problem.motion.muscles.max_isometric_force.copy()
    if weights == "volume":
        size *= problem.motion.muscles.optimal_fiber_length
    activation, control = point
    expected = np.einsum("m,km->k", size / size.mean(), activation**2) + (control**2).sum(axis=1)
    np.testing.assert_allclose(
        effort(problem, activation, control)[0]["ActivationEffort"], expected, rtol=1e-12
    )


def test_later_patterns_win(rng):
    problem = random_problem(rng, weights={"m1*": 2.0, "*": 3.0, "m10": 4.0}, stability=False)
    activation = np.eye(10)[:3]
    costs = effort(problem, activation, None)[0]["ActivationEffort"]
    np.testing.assert_array_equal(costs, 3.0)
    last = effort(problem, np.eye(10)[[9, 9, 9]], None)[0]["ActivationEffort"]
    np.testing.assert_array_equal(last, 4.0)


def test_the_exponent_of_a_gentler_start_goes_down_to_at_least_two():
    term = scso.ActivationEffort(exponent=100.0, weights="pcsa", weight=2.0)
    chain = []
    while (gentler := term.gentler()) is not None:
        assert (gentler.weights, gentler.weight) == ("pcsa", 2.0)
        chain.append(gentler.exponent)
        term = gentler
    assert chain == [50.0, 25.0, 12.5, 6.25, 3.125]
    assert scso.ActivationEffort(exponent=math.inf).gentler() is None


def test_steep_powers_report_the_work_of_their_gentler_starts_too(rng):
    problem = random_problem(rng, exponent=10.0)
    alone = dataclasses.replace(problem, objectives=(scso.ActivationEffort(exponent=2.5),))
    options = scso.SolverOptions(presolve=False)
    first = scso.solve_trajectory(alone, options=options).report.iterations
    assert scso.solve_trajectory(problem, options=options).report.iterations > first
