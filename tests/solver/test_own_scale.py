"""An answer does not depend on the size of its numbers, on where the solver began, or on redundant rows."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest
from helpers import random_problem

import scso_nlp as scso
from scso_nlp.solution import Status

EXPONENTS = [1.5, 2.0, 3.0, 7.0, 20.0]


def without_bounds(problem):
    """The same muscles with upper bounds out of reach: activations are proportional to the moments."""
    muscles = problem.motion.muscles
    free = dataclasses.replace(muscles, max_activation=np.full(muscles.n_muscles, 1e3))
    return dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, muscles=free))


def with_forces(problem, moment=1.0, strength=1.0):
    """Moments, and strengths of muscles and actuators, times a number."""
    motion = problem.motion
    trajectory = dataclasses.replace(
        motion.trajectory,
        generalized_forces=motion.trajectory.generalized_forces * moment,
        actuator_generalized_forces=motion.trajectory.actuator_generalized_forces * strength,
    )
    force = motion.muscles.max_isometric_force * strength
    muscles = dataclasses.replace(motion.muscles, max_isometric_force=force)
    actuators = dataclasses.replace(motion.actuators, optimal_force=motion.actuators.optimal_force * strength)
    motion = scso.Motion(trajectory=trajectory, muscles=muscles, actuators=actuators)
    return dataclasses.replace(problem, motion=motion)


def with_row(problem, row):
    """The moments with one more coordinate, `row` times those there are."""
    trajectory = problem.motion.trajectory
    more = lambda array: np.concatenate([array, np.tensordot(array, row, (1, 0))[:, None]], axis=1)  # noqa: E731
    trajectory = dataclasses.replace(
        trajectory,
        coordinates=(*trajectory.coordinates, "sum"),
        is_rotational=np.append(trajectory.is_rotational, True),
        **{
            name: more(getattr(trajectory, name))
            for name in (
                "coordinate_values",
                "coordinate_speeds",
                "generalized_forces",
                "passive_generalized_forces",
                "moment_arms",
                "actuator_generalized_forces",
            )
        },
    )
    return dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=trajectory))


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("factor", [1e-2, 1e-4, 1e-6])
def test_shares_of_small_moments_are_those_of_large_ones(rng, exponent, factor):
    problem = without_bounds(random_problem(rng, exponent=exponent, reserve=5.0, stability=False))
    whole, small = (scso.solve_trajectory(p) for p in (problem, with_forces(problem, moment=factor)))
    assert small.status is Status.SOLVED
    assert small.optimality.worst.max() < 1e-6
    # a flat optimum leaves activations open that cost less than the tolerance: what is judged is the cost
    cost = [
        (s.activation**exponent).sum() + (np.abs(s.control) ** exponent).sum()
        for s in (whole, dataclasses.replace(small, activation=small.activation / factor,
                                             control=small.control / factor))
    ]  # fmt: skip
    assert cost[1] == pytest.approx(cost[0], rel=3e-6)


@pytest.mark.parametrize("exponent", [1.0, *EXPONENTS])
@pytest.mark.parametrize("factor", [1e-9, 1e-6, 1e6])
def test_units_of_force_do_not_matter(rng, exponent, factor):
    problem = random_problem(rng, exponent=exponent, reserve=5.0, stability=False)
    one, other = (
        scso.solve_trajectory(p) for p in (problem, with_forces(problem, moment=factor, strength=factor))
    )
    assert other.status is Status.SOLVED
    np.testing.assert_allclose(other.objective, one.objective, rtol=3e-6)
    assert other.optimality.feasibility.max() < 1e-6


@pytest.mark.parametrize("exponent", [1.0, *EXPONENTS, 200.0, np.inf])
@pytest.mark.parametrize("factor", [1e3, 1e6])
def test_a_guess_outside_the_bounds_changes_nothing(rng, exponent, factor):
    problem = random_problem(rng, exponent=exponent, reserve=5.0)
    solution = scso.solve_trajectory(problem)
    guess = dataclasses.replace(
        solution, activation=solution.activation * factor, control=solution.control * factor
    )
    other = scso.solve_trajectory(problem, initial_guess=guess)
    assert other.status is Status.SOLVED
    assert other.objective == pytest.approx(solution.objective, rel=3e-6)


@pytest.mark.parametrize("exponent", [1.0, 1.05, *EXPONENTS, np.inf])
def test_without_moments_nothing_is_active(rng, exponent):
    problem = random_problem(rng, exponent=exponent, reserve=5.0, stability=False)
    solution = scso.solve_trajectory(with_forces(problem, moment=0.0))
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.activation, 0.0, atol=1e-12)


@pytest.mark.parametrize("exponent", [1.0, *EXPONENTS, np.inf])
@pytest.mark.parametrize("row", [[2.5, 0.0, 0.0], [1.0, -3.0, 0.5]])
def test_a_coordinate_that_follows_from_others_is_named_and_left_out(rng, caplog, exponent, row):
    caplog.set_level("INFO", logger="scso_nlp")
    problem = random_problem(rng, exponent=exponent, reserve=5.0, stability=False)
    redundant = with_row(problem, np.array(row))
    one, other = scso.solve_trajectory(problem), scso.solve_trajectory(redundant)
    assert other.status is Status.SOLVED
    assert other.objective == pytest.approx(one.objective, rel=3e-6)
    assert other.violation["MomentEquilibrium"] < 1e-6
    assert any("follow from the other equations in 3 frames" in message for message in caplog.messages)


def test_coordinates_that_contradict_each_other_are_infeasible(rng):
    redundant = with_row(random_problem(rng, stability=False), np.array([2.5, 0.0, 0.0]))
    trajectory = redundant.motion.trajectory
    moments = trajectory.generalized_forces + np.array([0.0, 0.0, 0.0, 1.0])
    motion = dataclasses.replace(
        redundant.motion, trajectory=dataclasses.replace(trajectory, generalized_forces=moments)
    )
    solution = scso.solve_trajectory(dataclasses.replace(redundant, motion=motion), on_failure="return")
    assert set(solution.frame_status) == {Status.INFEASIBLE}
    assert all(shortfall.proven for shortfall in solution.shortfalls)


@pytest.mark.parametrize("factor", [1e-3, 1e-9])
@pytest.mark.parametrize("exponent", [20.0, 200.0, 1000.0])
def test_powers_that_vanish_among_the_doubles_have_an_optimum_all_the_same(rng, exponent, factor):
    """Activations are proportional to the moments, whatever becomes of their powers."""
    problem = without_bounds(random_problem(rng, exponent=exponent, reserve=5.0, stability=False))
    whole, small = (scso.solve_trajectory(p) for p in (problem, with_forces(problem, moment=factor)))
    assert small.status is Status.SOLVED
    norms = [
        largest * ((np.hstack([s.activation, s.control]) / largest) ** exponent).sum(axis=1, keepdims=True)
        ** (1 / exponent)
        for s in (whole, small)
        for largest in [np.abs(np.hstack([s.activation, s.control])).max(axis=1, keepdims=True)]
    ]  # fmt: skip
    np.testing.assert_allclose(norms[1], factor * norms[0], rtol=1e-6)
    if exponent == 200.0:
        assert (small.rows["MomentEquilibrium"].multiplier == 0).all(), "none is among the doubles"


def test_objectives_that_vanish_among_the_doubles_and_have_no_degree_are_not_called_solved(rng):
    """An own cost cannot be scaled: what it is worth far below the doubles nobody knows."""
    problem = random_problem(rng, reserve=5.0, stability=False)
    own = dataclasses.replace(
        with_forces(problem, moment=1e-3), objectives=(lambda frame: ca.sum1(frame.activation**200),)
    )
    solution = scso.solve_trajectory(own, on_failure="return")
    assert set(solution.frame_status) == {Status.NOT_OPTIMAL}


@pytest.mark.parametrize("exponent", [2.0, 20.0, 200.0])
@pytest.mark.parametrize("price", [1e-6, 1.0])
def test_a_price_that_hides_the_effort_does_not_hide_its_optimum(rng, exponent, price):
    """A level that is kept at its price is kept at the same cost as if it were hard."""
    hard = random_problem(rng, exponent=exponent, reserve=5.0)
    rows = dataclasses.replace(hard.constraints[1], soft=price)
    soft = dataclasses.replace(hard, constraints=(hard.constraints[0], rows))
    one, other = scso.solve_trajectory(hard), scso.solve_trajectory(soft)
    assert one.rows["JointStability"].multiplier.max() < price or exponent == 2.0
    kept = one.rows["JointStability"].multiplier.max(axis=1) < price
    for k in np.flatnonzero(kept):
        assert other.frame_status[k] is Status.SOLVED
        cost = [(np.abs(np.hstack([s.activation[k], s.control[k]])) ** exponent).sum() for s in (one, other)]
        assert cost[1] == pytest.approx(cost[0], rel=1e-6 * exponent)
    assert kept.any() or price < 1.0


@pytest.mark.parametrize("exponent", [500.0, 1000.0])
def test_exponents_at_the_end_of_the_doubles_are_right_or_not_called_solved(rng, exponent):
    """What min/max leaves as the largest is a lower bound, and the optimum is close to it."""
    problem = random_problem(rng, exponent=exponent, reserve=5.0, stability=False)
    largest = dataclasses.replace(problem, objectives=(scso.ActivationEffort(exponent=np.inf),))
    solutions = [scso.solve_trajectory(p, on_failure="return") for p in (problem, largest)]
    found, least = (np.abs(np.hstack([s.activation, s.control])).max(axis=1) for s in solutions)
    is_solved = np.array([status is Status.SOLVED for status in solutions[0].frame_status])
    assert set(solutions[0].frame_status) <= {Status.SOLVED, Status.ACCEPTABLE, Status.NOT_OPTIMAL}
    # the sum of 13 powers is at most 13 times the largest
    assert (found <= least * 13 ** (1 / exponent) * (1 + 1e-6))[is_solved].all()


@pytest.mark.parametrize("exponent", [1001.0, 1e6, 1e30])
def test_exponents_beyond_the_doubles_are_refused_by_name_of_min_max(exponent):
    with pytest.raises(scso.ProblemError, match=r"expected at most 1000: .* infinity is min/max"):
        scso.ActivationEffort(exponent=exponent)
