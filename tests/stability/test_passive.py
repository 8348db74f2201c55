"""Published passive stiffness, user's matrices, and what they do to co-contraction."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_problem
from helpers import two_antagonists

import scso_nlp as scso
from scso_nlp import CoordinateStability, HessianStability
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.stability.passive import LumbarJoint, lumbar_passive_stiffness, passive_matrix

JOINT = {"bend": "flexion", "lean": "lateral", "twist": "axial"}


def test_one_level_has_the_published_numbers_in_radians():
    """1.8, 2.3 and 8.4 N·m/deg; a radian is 57.2958 degrees."""
    one = lumbar_passive_stiffness(LumbarJoint(levels=1, rows=JOINT))
    assert one == pytest.approx({"bend": 103.132, "lean": 131.780, "twist": 481.285}, rel=1e-5)


def test_levels_in_series_share_the_turn():
    rows = {"bend": "extension"}
    five = lumbar_passive_stiffness(LumbarJoint(levels=5, rows=rows))
    assert five["bend"] == pytest.approx(2.6 * 57.29578 / 5, rel=1e-6)


def test_joints_are_joined_and_a_row_in_two_of_them_is_refused():
    low, high = LumbarJoint(levels=2, rows={"a": "axial"}), LumbarJoint(levels=3, rows={"b": "axial"})
    both = lumbar_passive_stiffness(low, high)
    assert both["a"] == pytest.approx(1.5 * both["b"])
    with pytest.raises(DataError, match="row 'a' stands in two joints"):
        lumbar_passive_stiffness(low, low)


def test_unknown_directions_and_levels_are_refused():
    with pytest.raises(DataError, match="direction of 'bend' is 'sideways', expected one of axial, flexion"):
        LumbarJoint(levels=1, rows={"bend": "sideways"})
    with pytest.raises(DataError, match="levels is 0, expected at least 1"):
        LumbarJoint(levels=0, rows=JOINT)


def test_a_matrix_is_put_into_the_order_of_the_coordinates_by_name():
    matrix = passive_matrix(("a", "b", "c"), [[3.0, 1.0], [1.0, 2.0]], ("c", "a"))
    np.testing.assert_array_equal(matrix, [[2.0, 0, 1.0], [0, 0, 0], [1.0, 0, 3.0]])
    np.testing.assert_array_equal(passive_matrix(("a",), [[3.0]]), [[3.0]])


@pytest.mark.parametrize(
    ("matrix", "names", "error", "message"),
    [
        ([[1.0, 2.0], [0.0, 1.0]], None, DataError, r"not symmetric: 2 at \(a, b\), 0 at \(b, a\)"),
        ([[1.0, 2.0], [2.0, 1.0]], None, DataError, r"has the eigenvalue -1 N·m/rad"),
        ([[1.0, 2.0]], None, DataError, r"passive_matrix has shape \(1, 2\), expected \(2, 2\)"),
        ([[1.0]], ("hip",), NameMismatchError, "unknown coordinate 'hip'"),
    ],
)
def test_a_matrix_without_meaning_is_refused(matrix, names, error, message):
    with pytest.raises(error, match=message):
        passive_matrix(("a", "b"), matrix, names)


def test_passive_stiffness_takes_the_place_of_co_contraction_one_for_one():
    """Two antagonists that need 600 N in sum for 30 N·m/rad: with a passive 10 N·m/rad they need 400 N."""
    problem = two_antagonists(5.0)
    rows = dataclasses.replace(problem.constraints[1], passive_stiffness={"elbow_z": 10.0})
    passive = dataclasses.replace(problem, constraints=(problem.constraints[0], rows))
    np.testing.assert_allclose(scso.solve_trajectory(problem).tendon_force[0], [350.0, 250.0], rtol=1e-6)
    np.testing.assert_allclose(scso.solve_trajectory(passive).tendon_force[0], [250.0, 150.0], rtol=1e-6)


@pytest.mark.parametrize("rule", [CoordinateStability, HessianStability])
def test_more_passive_stiffness_never_costs_more_and_in_the_end_nothing(rng, rule):
    problem = hessian_problem(rng, n_frames=2)
    plain = scso.solve_trajectory(problem.without_stability())
    costs, activations = [], []
    for stiffness in (0.0, 10.0, 40.0, 160.0, 1e4):
        rows = rule(passive_stiffness=dict.fromkeys(problem.motion.trajectory.coordinates, stiffness))
        solution = scso.solve_trajectory(
            dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
        )
        costs.append(solution.objective)
        activations.append(solution.activation)
    assert (np.diff(costs) <= 1e-6).all()
    assert costs[0] > 1.05 * costs[-1]
    assert costs[-1] == pytest.approx(plain.objective, rel=1e-6)
    np.testing.assert_allclose(activations[-1], plain.activation, atol=1e-4)
