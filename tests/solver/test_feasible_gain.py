"""The least gain at which frames have an answer: in closed form, and against bisection by other solvers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_problem
from helpers import random_problem, two_antagonists, with_stability, with_trajectory

import scso_nlp as scso
from scso_nlp import CoordinateStability, HessianStability
from scso_nlp.muscle_models.stiffness_law import ShortRangeStiffness


@pytest.mark.parametrize("moment", [0.0, 5.0, 40.0])
@pytest.mark.parametrize("level", [0.0, 12.0])
def test_the_gain_of_two_antagonists_is_that_of_both_as_strong_as_equilibrium_lets_them(moment, level):
    """GS = (q - 1) r² / L = 0.0125 (q - 1) m; at most 2000 N and 2000 N less M / r pull."""
    force = 4000.0 - moment / 0.05
    problem = two_antagonists(moment, level=level)
    expected = 1.0 + (30.0 + level) / (0.0125 * force)
    np.testing.assert_allclose(scso.feasible_q(problem), [expected], rtol=1e-6)


def highest(problem, q):
    """Most that the least row of every frame can have at a gain, or the smallest eigenvalue."""
    terms = [dataclasses.replace(term, q=q) for term in problem.stability_terms]
    return dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), *terms))


@pytest.mark.parametrize("rule", ["rows", CoordinateStability, HessianStability])
def test_just_above_it_every_frame_has_an_answer_and_just_below_none_has(rng, rule):
    if rule == "rows":
        problem = with_stability(random_problem(rng, n_frames=2, reserve=5.0), 40.0)
    else:
        problem = hessian_problem(rng, n_frames=2, stability=rule(level=60.0))
    least = scso.feasible_q(problem)
    assert (least > 0.1).all()
    assert np.isfinite(least).all()
    for k, q in enumerate(least):
        above, below = (
            scso.solve_framewise(highest(problem, factor * q).frames(k, k + 1), on_failure="return")
            for factor in (1.002, 0.998)
        )
        assert above.is_solved.all()
        assert below.status is scso.Status.INFEASIBLE


def test_it_is_zero_where_nothing_topples_and_infinite_where_muscles_cannot_help():
    assert scso.feasible_q(two_antagonists(5.0, external_work=-200.0)) == 0.0
    without_arms = two_antagonists(0.0)
    across = dataclasses.replace(without_arms.constraints[1], axes=("x",), level=1e5)
    assert np.isinf(scso.feasible_q(dataclasses.replace(without_arms, constraints=(across,)))).all()


def test_frames_without_an_answer_in_the_other_rows_are_not_numbers(rng):
    problem = random_problem(rng, n_frames=2)
    moments = problem.motion.trajectory.generalized_forces.copy()
    moments[1] = 1e4
    found = scso.feasible_q(with_trajectory(problem, generalized_forces=moments))
    assert np.isnan(found).tolist() == [False, True]


def test_the_terms_own_stiffness_and_price_are_not_used():
    hard = two_antagonists(5.0)
    stability = dataclasses.replace(hard.constraints[1], q=None, stiffness=ShortRangeStiffness(), soft=1.0)
    soft = dataclasses.replace(hard, constraints=(hard.constraints[0], stability))
    np.testing.assert_array_equal(scso.feasible_q(soft), scso.feasible_q(hard))


def test_it_is_refused_without_stability_rows(rng):
    plain = random_problem(rng, stability=False)
    with pytest.raises(scso.ProblemError, match="no stability constraint whose least feasible q"):
        scso.feasible_q(plain)
