"""Passive buckling: closed forms of hinges and chains, and of constraints that hold them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import two_antagonists
from hinge_chain import hinge_chain
from scipy.linalg import eigh

import scso_nlp as scso
from scso_nlp.stability import buckling_factor


def test_one_hinge_buckles_where_the_load_takes_all_its_stiffness():
    passive = np.array([[[30.0]], [[30.0]], [[0.0]], [[30.0]]])
    taken = np.array([[[60.0]], [[10.0]], [[10.0]], [[-5.0]]])
    np.testing.assert_allclose(buckling_factor(passive, taken), [0.5, 3.0, 0.0, np.inf], rtol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_chain_of_links_buckles_under_the_weight_of_its_closed_form(n):
    """Links of length l, stiffness k at every joint, P at the top: E = P l (n - max(i, j)), from 0 on."""
    i = np.arange(n)
    taken = 0.036 * 100.0 * (n - np.maximum.outer(i, i))
    factor = buckling_factor(103.0 * np.eye(n)[None], taken[None])
    expected = 2 * (1 - np.cos(np.pi / (2 * n + 1))) * 103.0 / 0.036 / 100.0
    np.testing.assert_allclose(factor, expected, rtol=1e-9)


def test_any_matrices_buckle_at_their_largest_generalized_eigenvalue(rng):
    roots = rng.normal(size=(6, 4, 4))
    passive, taken = roots @ roots.transpose(0, 2, 1), rng.normal(size=(6, 4, 4))
    taken = taken + taken.transpose(0, 2, 1)
    largest = [eigh(e, k, eigvals_only=True)[-1] for e, k in zip(taken, passive, strict=True)]
    np.testing.assert_allclose(buckling_factor(passive, taken), 1 / np.array(largest), rtol=1e-6)


def test_loads_on_what_has_no_stiffness_buckle_at_once_and_loads_beside_it_do_not():
    passive = np.diag([50.0, 0.0])[None]
    assert buckling_factor(passive, np.diag([10.0, 5.0])[None])[0] == 0
    np.testing.assert_allclose(buckling_factor(passive, np.diag([10.0, 0.0])[None]), 5.0, rtol=1e-9)


def test_a_row_about_an_axis_needs_muscles_below_a_factor_of_one():
    rows = scso.JointStability(joints=["elbow"], axes=["z"], passive_stiffness={"elbow_z": 12.0})
    motion = two_antagonists(0.0, external_work=30.0).motion
    np.testing.assert_allclose(rows.passive_buckling(motion), 0.4, rtol=1e-9)
    half = dataclasses.replace(rows, passive_factor=0.5)
    np.testing.assert_allclose(half.passive_buckling(motion), 0.2, rtol=1e-9)


@pytest.mark.parametrize("matrix", [np.diag([200.0, 100.0]), np.array([[200.0, 50.0], [50.0, 100.0]])])
def test_the_whole_hessian_buckles_where_it_is_singular_without_muscles(rng, matrix):
    problem = hinge_chain(rng)
    motion = problem.motion
    rows = scso.HessianStability(passive_matrix=matrix, passive_factor=0.5)
    factor = rows.passive_buckling(motion)
    loads = motion.trajectory.curvature.load_stiffness
    own = 0.5 * (matrix + motion.trajectory.curvature.passive_stiffness)
    assert np.isfinite(factor).any()
    for k in np.flatnonzero(np.isfinite(factor)):
        least = np.linalg.eigvalsh(own[k] + factor[k] * loads[k])[0]
        assert abs(least) < 1e-6 * np.abs(own[k]).max()
    single = scso.CoordinateStability(passive_factor=0.5, passive_stiffness={"*": 0.0})
    each = np.diagonal(0.5 * motion.trajectory.curvature.passive_stiffness, axis1=1, axis2=2)
    taken = -np.diagonal(loads, axis1=1, axis2=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.where(taken > 0, each / taken, np.inf).min(axis=1)
    np.testing.assert_allclose(single.passive_buckling(motion), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rows", [scso.CoordinateStability, scso.HessianStability])
def test_half_of_the_passive_stiffness_gives_half_of_it_to_the_rows(rng, rows):
    problem = hinge_chain(rng)
    given = {"passive_stiffness": {"*": 40.0}}
    whole = rows(**given).passive_and_taken(problem.motion)
    half = rows(**given, passive_factor=0.5).passive_and_taken(problem.motion)
    np.testing.assert_allclose(half[0], 0.5 * whole[0])
    np.testing.assert_array_equal(half[1], whole[1])
    plain = scso.solve_trajectory(problem.without_stability(), on_failure="return")
    seen = [
        scso.observe(plain, rows(**given, passive_factor=factor, label="seen")).stability.stability
        for factor in (1.0, 0.5, 0.0)
    ]
    gained = 0.5 * np.diagonal(whole[0], axis1=1, axis2=2)
    if rows is scso.CoordinateStability:
        np.testing.assert_allclose(seen[0] - seen[1], gained, rtol=1e-9)
        np.testing.assert_allclose(seen[1] - seen[2], gained, rtol=1e-9)
    else:
        assert (seen[0][:, -1] > seen[1][:, -1]).all()
        assert (seen[1][:, -1] > seen[2][:, -1]).all()


@pytest.mark.parametrize("factor", [-1.0, np.nan, np.inf])
def test_a_factor_that_is_none_is_refused(factor):
    with pytest.raises(scso.ProblemError, match="passive_factor is"):
        scso.JointStability(passive_factor=factor)
