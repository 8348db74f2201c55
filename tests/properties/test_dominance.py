"""What is asked for more costs no less."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import random_problem, with_motion, with_stability

import scso_nlp as scso

#: Relative slack of the objective: the solver's own tolerance is 1e-8.
SLACK = 1e-6


def level_of(problem):
    return dict(problem.constraints[1].level)


def never_fall(costs):
    assert (np.diff(costs) >= -SLACK * costs[1:]).all()
    assert costs[-1] > costs[0] * (1 + 1e-3), "the rows are never active: the test shows nothing"


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("seed", range(4))
def test_more_stability_never_costs_less_effort(seed, exponent):
    problem = random_problem(np.random.default_rng(seed), exponent=exponent)
    level = level_of(problem)
    costs = []
    # The level that some co-contraction reached, and levels below it.
    for less in (60.0, 30.0, 15.0, 7.0, 0.0):
        asked = {name: value - less for name, value in level.items()}
        costs.append(scso.solve_trajectory(with_stability(problem, asked)).objective)
    never_fall(np.array(costs))


@pytest.mark.parametrize("seed", range(4))
def test_a_load_held_higher_never_costs_less_effort(seed):
    problem = random_problem(np.random.default_rng(seed))
    trajectory = problem.motion.trajectory
    costs = []
    for lower in (0.6, 0.3, 0.1, 0.0):
        force = trajectory.skeleton.load_forces
        down = force / np.linalg.norm(force, axis=-1, keepdims=True)
        points = trajectory.skeleton.load_points + lower * down
        skeleton = dataclasses.replace(trajectory.skeleton, load_points=points)
        moved = dataclasses.replace(trajectory, skeleton=skeleton)
        costs.append(scso.solve_trajectory(with_motion(problem, trajectory=moved)).objective)
    never_fall(np.array(costs))


@pytest.mark.parametrize("seed", range(4))
def test_static_optimization_is_the_answer_where_muscles_are_stiff_enough(seed):
    problem = random_problem(np.random.default_rng(seed))
    plain = scso.solve_trajectory(problem.without_stability())
    stiff = scso.solve_trajectory(with_stability(problem, 0.0, q=1e4))
    np.testing.assert_allclose(stiff.activation, plain.activation, atol=1e-4)
    np.testing.assert_allclose(stiff.rows["JointStability"].multiplier, 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_stability_never_costs_less_than_static_optimization(seed):
    problem = random_problem(np.random.default_rng(seed), exponent=3.0)
    plain = scso.solve_trajectory(problem.without_stability()).objective
    assert scso.solve_trajectory(problem).objective >= plain * (1 - SLACK)


@pytest.mark.parametrize("seed", range(4))
def test_a_stiffer_muscle_never_costs_more_effort(seed):
    problem = random_problem(np.random.default_rng(seed), q=3.0)
    level = level_of(problem)
    costs = np.array([scso.solve_trajectory(with_stability(problem, level, q)).objective for q in (3, 5, 9)])
    assert (np.diff(costs) <= SLACK * costs[1:]).all()
