"""What stability can be reached at all, against linear programs and Clarabel written by hand."""

from __future__ import annotations

import dataclasses

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp
from conic_oracle import SCALE, hessian_by_hand, hessian_problem
from helpers import (
    frame_arrays,
    random_problem,
    stability_by_hand,
    two_antagonists,
    with_motion,
    with_stability,
    with_trajectory,
)
from scipy.optimize import linprog

import scso_nlp as scso
from scso_nlp import CoordinateStability, HessianStability
from scso_nlp.muscle_models.stiffness_law import ShortRangeStiffness
from scso_nlp.solver.reach import reachable_stability
from scso_nlp.stability.hessian import describe_turn


def highest_by_hand(problem, k, q=5.0):
    """Most stability about x, y and z alone, with equilibrium and bounds; by HiGHS from plain arrays."""
    _, a, b, _, _, lower, upper = frame_arrays(problem, k)
    stiffness, work = stability_by_hand(problem, q)
    gains = np.zeros((3, a.shape[1]))
    gains[:, : problem.motion.muscles.n_muscles] = stiffness[k] * problem.motion.muscles.max_isometric_force
    answers = [
        linprog(-gain, A_eq=a, b_eq=b, bounds=np.column_stack([lower, upper]), method="highs")
        for gain in gains
    ]
    return np.array([-answer.fun for answer in answers]) - work[k]


@pytest.mark.parametrize("reserve", [None, 5.0])
def test_the_highest_stability_of_every_row_and_frame_is_that_of_a_linear_program(rng, reserve):
    problem = random_problem(rng, n_frames=4, reserve=reserve)
    (reach,) = reachable_stability(problem)
    assert reach.rows == ("elbow_x", "elbow_y", "elbow_z")
    for k in range(4):
        np.testing.assert_allclose(reach.highest[k], highest_by_hand(problem, k), rtol=1e-7, atol=1e-6)
    assert reach.is_reachable.all()
    assert reach.messages() == ()


def test_the_shortfall_is_the_level_less_the_highest_and_the_message_names_all(rng):
    problem = random_problem(rng, n_frames=3, q=40.0)
    highest = np.array([highest_by_hand(problem, k, 40.0) for k in range(3)])
    level = {"elbow_x": float(highest[:, 0].max() + 7.0), "elbow_y": -1e4, "elbow_z": -1e4}
    (reach,) = reachable_stability(with_stability(problem, level, q=40.0))
    np.testing.assert_allclose(reach.shortfall[:, 0], level["elbow_x"] - highest[:, 0], rtol=1e-6)
    assert (reach.shortfall[:, 1:] == 0).all()
    assert not reach.is_reachable.any()
    messages = reach.messages()
    worst = int(np.argmin(highest[:, 0]))
    assert len(messages) == 3
    assert f"JointStability[elbow_x] reaches at most {highest[worst, 0]:.4g}" in messages[0]
    assert f"at frame {worst} (t = {0.01 * worst:g} s)" in messages[0]
    assert "would help" in messages[0]


def test_helpers_are_the_muscles_whose_strength_raises_the_highest_most(rng):
    """The effect named is the derivative by the upper bound of activation, by central differences."""
    problem = random_problem(rng, n_frames=1, q=40.0)
    (reach,) = reachable_stability(problem)
    step = 1e-5
    effect = np.zeros(10)
    for m in range(10):
        highest = []
        for change in (step, -step):
            upper = problem.motion.muscles.max_activation.copy()
            upper[m] += change
            muscles = dataclasses.replace(problem.motion.muscles, max_activation=upper)
            highest.append(
                highest_by_hand(
                    with_motion(problem, muscles=muscles),
                    0,
                    40.0,
                )[0]
            )
        effect[m] = (highest[0] - highest[1]) / (2 * step)
    np.testing.assert_allclose(reach.help[0, 0], effect, rtol=1e-5, atol=1e-4)
    best = problem.motion.muscles.muscles[int(effect.argmax())]
    assert reach.helpers(0, 0)[0] == best


def test_two_antagonists_reach_what_their_strength_allows():
    """GS = 0.05 m per newton; at 5 N·m the weaker pulls 100 N less than 2000 N: 195 - 30 N·m/rad."""
    (reach,) = reachable_stability(two_antagonists(5.0))
    np.testing.assert_allclose(reach.highest, [[0.05 * (2000.0 + 1900.0) - 30.0]])


def test_frames_whose_moments_are_out_of_reach_are_named_as_such(rng):
    problem = random_problem(rng, n_frames=2)
    moments = problem.motion.trajectory.generalized_forces.copy()
    moments[1] = 1e4
    problem = with_trajectory(problem, generalized_forces=moments)
    (reach,) = reachable_stability(problem)
    assert np.isfinite(reach.highest[0]).all()
    assert np.isnan(reach.highest[1]).all()
    assert reach.is_reachable.tolist() == [True, False]
    assert "the other rows alone are out of reach at frame 1 (t = 0.01 s)" in reach.messages()[-1]


def highest_eigenvalue_by_hand(problem, k, level=0.0):
    """max t with H - level - t ⪰ 0, equilibrium and bounds, by Clarabel."""
    m, size = problem.motion.muscles.n_muscles, 4
    strength = problem.motion.muscles.max_isometric_force
    length = problem.motion.trajectory.muscle_tendon_length[k]

    def hessian(force):
        return (hessian_by_hand(problem, k, force, 5.0 * force / length) - level * np.eye(size)) / SCALE

    nothing = hessian(np.zeros(m))
    matrices = [hessian(strength[i] * np.eye(m)[i]) - nothing for i in range(m)] + [-np.eye(size)]
    pick = [(i, j) for j in range(size) for i in range(j + 1)]
    weight = np.array([1.0 if i == j else np.sqrt(2) for i, j in pick])
    rows, columns = np.array(pick).T
    vectors = np.array([weight * g[rows, columns] for g in matrices]).T
    arms = np.hstack([problem.motion.trajectory.moment_arms[k] * strength, np.zeros((size, 1))])
    box = np.hstack([np.eye(m), np.zeros((m, 1))])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    answer = clarabel.DefaultSolver(
        sp.csc_matrix((m + 1, m + 1)),
        np.append(np.zeros(m), -1.0),
        sp.csc_matrix(np.vstack([arms, -box, box, -vectors])),
        np.concatenate(
            [
                problem.motion.trajectory.generalized_forces[k],
                np.zeros(m),
                np.ones(m),
                weight * nothing[rows, columns],
            ]
        ),
        [clarabel.ZeroConeT(size), clarabel.NonnegativeConeT(2 * m), clarabel.PSDTriangleConeT(size)],
        settings,
    ).solve()
    assert str(answer.status) in ("Solved", "AlmostSolved")
    return -answer.obj_val * SCALE


@pytest.mark.parametrize("level", [0.0, 300.0])
def test_the_largest_smallest_eigenvalue_is_that_of_clarabel(rng, level):
    problem = hessian_problem(rng, n_frames=3, stability=HessianStability(level=level))
    (reach,) = reachable_stability(problem)
    assert reach.rows == ("smallest eigenvalue",)
    for k in range(3):
        assert reach.highest[k, 0] == pytest.approx(highest_eigenvalue_by_hand(problem, k, level), abs=1e-3)
    assert (reach.is_reachable == (level == 0.0)).all()


def test_the_full_hessians_message_names_the_turn_by_coordinate_and_the_best_muscles(rng):
    problem = hessian_problem(rng, n_frames=2, stability=HessianStability(level=300.0))
    (reach,) = reachable_stability(problem)
    message = reach.messages()[0]
    assert message.startswith("HessianStability[smallest eigenvalue] (turn ")
    assert any(name in message for name in problem.motion.trajectory.coordinates)
    assert reach.helpers(0, 0)[0] in problem.motion.muscles.muscles


@pytest.mark.parametrize("rule", [CoordinateStability, HessianStability])
@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_soft_levels_solve_every_frame_that_is_out_of_reach(rng, rule, solve):
    problem = hessian_problem(rng, n_frames=3, stability=rule(level=500.0, soft=0.1))
    (reach,) = reachable_stability(problem)
    assert not reach.is_reachable.any()
    solution = solve(problem)
    assert solution.is_solved.all()
    missed = solution.variables[f"{rule.__name__}.missed"]
    assert (missed >= reach.shortfall - 1e-3).all()
    assert missed.max() > 10.0


def test_a_soft_level_at_a_high_price_is_missed_by_no_more_than_it_must_be(rng):
    problem = hessian_problem(rng, n_frames=2, stability=HessianStability(level=300.0, soft=100.0))
    (reach,) = reachable_stability(problem)
    missed = scso.solve_trajectory(problem).variables["HessianStability.missed"]
    np.testing.assert_allclose(missed, reach.shortfall, rtol=1e-3)


def test_every_stability_constraint_has_a_reach_of_its_own(rng):
    problem = hessian_problem(rng, n_frames=2)
    both = dataclasses.replace(problem, constraints=(*problem.constraints, CoordinateStability(level=5.0)))
    full, diagonal = reachable_stability(both)
    assert full.constraint == "HessianStability"
    assert diagonal.rows == ("q1", "q2", "q3", "q4")
    # no diagonal entry can be below the smallest eigenvalue
    assert (diagonal.highest >= full.highest - 1e-6).all()


def test_rows_that_are_not_affine_are_refused_with_the_remedy(rng):
    law = ShortRangeStiffness()
    problem = hessian_problem(rng, stability=CoordinateStability(stiffness=law))
    with pytest.raises(scso.ProblemError, match=r"not affine in activation.*soft="):
        reachable_stability(problem)


def test_turns_are_told_with_signs_and_without_what_is_small():
    names = ("bend", "lean", "twist")
    assert describe_turn(names, np.array([0.6, -0.79, 0.1])) == "-0.79 lean + 0.60 bend"
    assert describe_turn(names, np.array([1.0, 0.0, 0.0])) == "1.00 bend"
