"""Random patterns: they keep every row, and are spread evenly where that is known in closed form."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, random_problem, two_antagonists

import scso_nlp as scso


def test_patterns_of_two_antagonists_are_spread_evenly_over_a_segment():
    plain = dataclasses.replace(
        two_antagonists(20.0, strength=2000.0), constraints=(scso.MomentEquilibrium(),)
    )
    patterns = scso.random_patterns(scso.solve_trajectory(plain), 0, 4000)
    # a1 = a2 + 0.2 with a2 from 0 to 0.8
    np.testing.assert_allclose(patterns[:, 0], patterns[:, 1] + 0.2, atol=1e-9)
    shares, _ = np.histogram(patterns[:, 1], bins=8, range=(0.0, 0.8))
    np.testing.assert_allclose(shares / 4000, 1 / 8, atol=0.02)


def test_patterns_of_three_agonists_have_the_centre_and_spread_of_their_triangle():
    """Equal moments: a1 + a2 + a3 = 0.5, a triangle with corners at 0.5."""
    problem = elbow([30.0])
    arms = np.broadcast_to([[60.0 / 1450.0, 60.0 / 1200.0, 60.0 / 1000.0]], (1, 1, 3))
    trajectory = dataclasses.replace(problem.motion.trajectory, moment_arms=arms)
    problem = dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=trajectory))
    patterns = scso.random_patterns(scso.solve_trajectory(problem), 0, 6000, seed=3)
    np.testing.assert_allclose(patterns.sum(axis=1), 0.5, atol=1e-9)
    assert (patterns >= 0).all()
    np.testing.assert_allclose(patterns.mean(axis=0), 0.5 / 3, atol=0.006)
    # evenly over a triangle: variance of a coordinate is height² / 18
    np.testing.assert_allclose(patterns.var(axis=0), 0.5**2 / 18, rtol=0.06)


def test_patterns_keep_equilibrium_and_stability_and_none_costs_less_than_the_optimum(rng):
    problem = random_problem(rng, n_frames=2, reserve=5.0)
    solution = scso.solve_trajectory(problem)
    patterns = scso.random_patterns(solution, 1, 300)
    forces = problem.motion.muscles.max_isometric_force * patterns
    moments = forces @ problem.motion.trajectory.moment_arms[1].T
    expected = (solution.activation[1] * problem.motion.muscles.max_isometric_force) @ (
        problem.motion.trajectory.moment_arms[1].T
    )
    np.testing.assert_allclose(moments, np.broadcast_to(expected, moments.shape), atol=1e-6)
    assert (patterns >= 0).all()
    assert (patterns <= 1).all()
    assert ((patterns**2).sum(axis=1) >= (solution.activation[1] ** 2).sum() - 1e-9).all()
    rows = next(term for term in problem.constraints if isinstance(term, scso.JointStability))
    geometry = rows.stability_rows(problem.motion)
    stiffness = rows.stiffness_law.q * forces / problem.motion.trajectory.muscle_tendon_length[1]
    stability = (
        forces @ geometry.curvature[1].T
        + stiffness @ (geometry.moment_arms[1] ** 2).T
        - geometry.external_work[1]
    )
    level = rows.by_row(rows.level, geometry.rows)
    assert (stability >= level - 1e-6).all()
    assert (stability > level + 1.0).any()


def test_a_frame_with_one_pattern_only_is_refused():
    one = elbow([10.0])
    trajectory = dataclasses.replace(
        one.motion.trajectory,
        coordinates=("q1", "q2", "q3"),
        is_rotational=np.ones(3, dtype=bool),
        coordinate_values=np.zeros((1, 3)),
        coordinate_speeds=np.zeros((1, 3)),
        moment_arms=np.diag([0.1, 0.05, 0.02])[None],
        actuator_generalized_forces=np.zeros((1, 3, 0)),
        generalized_forces=[[10.0, 10.0, 10.0]],
        passive_generalized_forces=np.zeros((1, 3)),
    )
    problem = dataclasses.replace(one, motion=dataclasses.replace(one.motion, trajectory=trajectory))
    with pytest.raises(scso.ProblemError, match="one pattern only"):
        scso.random_patterns(scso.solve_trajectory(problem), 0, 5)


def test_soft_rows_and_rows_that_are_curved_are_refused(rng):
    soft = dataclasses.replace(
        two_antagonists(20.0),
        constraints=(scso.MomentEquilibrium(), scso.JointStability(soft=1.0, axes=["z"])),
    )
    with pytest.raises(scso.ProblemError, match="unknowns of their own"):
        scso.random_patterns(scso.solve_trajectory(soft), 0, 5)
    law = scso.FallingStiffness()
    curved = dataclasses.replace(
        two_antagonists(20.0),
        constraints=(scso.MomentEquilibrium(), scso.JointStability(stiffness=law, axes=["z"])),
    )
    with pytest.raises(scso.ProblemError, match="affine"):
        scso.random_patterns(scso.solve_trajectory(curved), 0, 5)
