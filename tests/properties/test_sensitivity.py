"""Multipliers are what they say: the price of a row, checked by solving again with the row moved."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import random_problem, with_stability, with_trajectory

import scso_nlp as scso

#: Tight enough that differences of optima are exact to about 1e-6.
OPTIONS = scso.SolverOptions(tolerance=1e-11)

#: Step of a row [N·m, N·m/rad]: the optimum is smooth in it, except where the active set changes.
STEP = 1e-3

#: Of the price itself and of the largest price: differences of optima at this tolerance and step.
RELATIVE = 2e-3


def price(problem_at):
    """Slope of the optimal objective over a step of a row."""
    up, down = (scso.solve_trajectory(problem_at(step), options=OPTIONS).objective for step in (STEP, -STEP))
    return (up - down) / (2 * STEP)


CASES = [(exponent, reserve) for exponent in (1.5, 2.0, 3.0, 10.0) for reserve in (None, 1.0, 50.0)]


@pytest.mark.parametrize(("exponent", "reserve"), CASES)
def test_the_multiplier_of_a_stability_row_is_the_price_of_its_level(exponent, reserve):
    rng = np.random.default_rng(11)
    problem = random_problem(rng, n_frames=2, exponent=exponent, reserve=reserve, weights="volume")
    level = dict(problem.constraints[1].level)
    if reserve is not None:
        # Reserves take the moments over, so that the muscles are free to do without stability.
        level = {name: value + 5.0 for name, value in level.items()}
    multiplier = (
        scso.solve_trajectory(with_stability(problem, level), options=OPTIONS)
        .rows["JointStability"]
        .multiplier
    )
    assert multiplier.max() > 0, "no row is active: the test shows nothing"
    for r, name in enumerate(level):
        expected = price(lambda step, name=name: _with_level(problem, level, name, step))
        assert multiplier[:, r].sum() == pytest.approx(
            expected, rel=RELATIVE, abs=RELATIVE * np.abs(multiplier).max()
        )


@pytest.mark.parametrize(("exponent", "reserve"), CASES)
def test_the_multiplier_of_equilibrium_is_the_price_of_the_moment(exponent, reserve):
    problem = random_problem(np.random.default_rng(5), n_frames=2, exponent=exponent, reserve=reserve)
    multiplier = scso.solve_trajectory(problem, options=OPTIONS).rows["MomentEquilibrium"].multiplier
    for k, c in ((0, 0), (0, 2), (1, 1)):
        expected = price(lambda step, k=k, c=c: _with_moment(problem, k, c, step))
        assert multiplier[k, c] == pytest.approx(
            expected, rel=RELATIVE, abs=RELATIVE * np.abs(multiplier).max()
        )


@pytest.mark.parametrize("exponent", [1.0, math.inf])
@pytest.mark.parametrize("reserve", [None, 5.0])
def test_prices_of_linear_programs_are_their_multipliers(exponent, reserve):
    problem = random_problem(np.random.default_rng(8), n_frames=2, exponent=exponent, reserve=reserve)
    level = dict(problem.constraints[1].level)
    solution = scso.solve_trajectory(problem, options=OPTIONS)
    largest = max(np.abs(row.multiplier).max() for row in solution.rows.values())
    for k, c in ((0, 1), (1, 0)):
        expected = price(lambda step, k=k, c=c: _with_moment(problem, k, c, step))
        found = solution.rows["MomentEquilibrium"].multiplier[k, c]
        assert found == pytest.approx(expected, rel=RELATIVE, abs=RELATIVE * largest)
    for r, name in enumerate(level):
        expected = price(lambda step, name=name: _with_level(problem, level, name, step))
        found = solution.rows["JointStability"].multiplier[:, r].sum()
        assert found == pytest.approx(expected, rel=RELATIVE, abs=RELATIVE * largest)


def test_multipliers_do_not_depend_on_the_solver(rng):
    problem = random_problem(rng, n_frames=3, exponent=3.0, reserve=5.0)
    together = scso.solve_trajectory(problem, options=OPTIONS)
    one_by_one = scso.solve_framewise(problem, options=OPTIONS)
    for name, row in together.rows.items():
        np.testing.assert_allclose(
            row.multiplier,
            one_by_one.rows[name].multiplier,
            rtol=RELATIVE,
            atol=RELATIVE * row.multiplier.max(),
        )


def _with_level(problem, level, name, step):
    return with_stability(problem, level | {name: level[name] + step})


def _with_moment(problem, k, c, step):
    moments = problem.motion.trajectory.generalized_forces.copy()
    moments[k, c] += step
    return with_trajectory(problem, generalized_forces=moments)
