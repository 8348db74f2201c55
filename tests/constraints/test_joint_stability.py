"""Stability rows against Potvin and Brown's printed sums; the geometry itself is in tests/stability."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, random_problem, stability_by_hand, two_antagonists

import scso_nlp as scso


def with_rows(problem, **changes):
    rows = dataclasses.replace(problem.constraints[1], **changes)
    return dataclasses.replace(problem, constraints=(problem.constraints[0], rows))


@pytest.mark.parametrize("model", [scso.NoPhysiology(), scso.RigidTendon()])
@pytest.mark.parametrize("q", [0.0, 5.0, 12.5])
def test_stability_is_force_times_geometry_less_external_work(rng, model, q):
    problem = with_rows(random_problem(rng, muscle_model=model), q=q)
    activation = rng.uniform(0, 1, (3, 10))
    _, rows, force = evaluate_terms(problem, activation)
    stiffness, work = stability_by_hand(problem, q)
    expected = np.einsum("kum,km->ku", stiffness, force) - work
    np.testing.assert_allclose(rows["JointStability"], expected, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize(
    "q",
    [
        np.linspace(1, 10, 10),
        {f"m{i + 1}": i + 1.0 for i in range(10)},
        {"*": 99.0} | {f"m{i + 1}": i + 1.0 for i in range(10)},
    ],
)
def test_every_muscle_may_have_its_own_gain(rng, q):
    problem = with_rows(random_problem(rng), q=q)
    activation = rng.uniform(0, 1, (3, 10))
    _, rows, force = evaluate_terms(problem, activation)
    stiffness, work = stability_by_hand(problem, np.linspace(1, 10, 10))
    expected = np.einsum("kum,km->ku", stiffness, force) - work
    np.testing.assert_allclose(rows["JointStability"], expected, rtol=1e-10, atol=1e-9)


def test_axes_are_chosen_and_ordered_by_name(rng):
    problem = random_problem(rng)
    chosen = with_rows(problem, axes=("z", "x"), level={"elbow_x": 1.0})
    activation = rng.uniform(0, 1, (3, 10))
    every = evaluate_terms(problem, activation)[1]["JointStability"]
    np.testing.assert_array_equal(evaluate_terms(chosen, activation)[1]["JointStability"], every[:, [2, 0]])
    rows = scso.solve_framewise(chosen, on_failure="return").rows["JointStability"]
    assert rows.names == ("elbow_z", "elbow_x")
    assert rows.unit == ("N·m/rad",) * 2
    np.testing.assert_array_equal(rows.lower, [0.0, 1.0])  # rows without a level of their own get 0
    assert np.isinf(rows.upper).all()


def test_no_joints_named_means_all_joints(rng):
    problem = random_problem(rng)
    activation = rng.uniform(0, 1, (3, 10))
    np.testing.assert_array_equal(
        evaluate_terms(with_rows(problem, joints=None), activation)[1]["JointStability"],
        evaluate_terms(problem, activation)[1]["JointStability"],
    )


def test_one_bare_name_is_one_joint_not_its_letters(rng):
    problem = random_problem(rng)
    bare = with_rows(problem, joints="elbow", axes="z", level=0.0)
    solution = scso.solve_framewise(bare, on_failure="return")
    assert solution.rows["JointStability"].names == ("elbow_z",)


def test_two_stability_constraints_of_one_problem_are_told_apart_by_their_labels():
    problem = two_antagonists(5.0)
    stiffer = scso.JointStability(level=10.0, joints=("elbow",), axes=("z",), label="stiffer")
    problem = dataclasses.replace(problem, constraints=(*problem.constraints, stiffer))
    rows = scso.solve_trajectory(problem).rows
    assert rows["stiffer"].value[0, 0] == pytest.approx(10.0, abs=1e-5)
    assert rows["JointStability"].value[0, 0] == pytest.approx(10.0, abs=1e-5)
