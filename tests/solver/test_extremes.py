"""Ranges near an optimum: closed forms, Clarabel beside them, patterns that try to leave them."""

from __future__ import annotations

import dataclasses

import clarabel
import helpers
import numpy as np
import pytest
import scipy.sparse as sp
from conic_oracle import SCALE, full_frame, hessian_problem
from helpers import elbow, frame_arrays, random_problem

import scso_nlp as scso
from scso_nlp.exceptions import ProblemError
from scso_nlp.solver import extremes


def least_by_clarabel(problem, k, cost, most, exponent=2.0, matrices=()):
    """Least cost'x with A x = b, G x >= h, bounds and sum w |x|^p <= most, by a conic solver.

    For p other than 2 every power has a bound t of its own: (t, 1, x) in the power cone of 1/p. Pairs (M, K)
    of `matrices` are matrix inequalities K + sum x_i M_i ⪰ 0.
    """
    weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
    n = a.shape[1]
    below, above = np.isfinite(lower), np.isfinite(upper)
    sides = np.vstack([-g, -np.eye(n)[below], np.eye(n)[above]])
    limits = np.concatenate([-h, -lower[below], upper[above]])
    cones = [clarabel.ZeroConeT(len(b)), clarabel.NonnegativeConeT(len(limits))]
    if exponent == 2:
        cone = np.vstack([np.zeros(n), -np.diag(np.sqrt(weights))])
        matrix, ends = np.vstack([a, sides, cone]), [np.sqrt(most), *np.zeros(n)]
        cones.append(clarabel.SecondOrderConeT(n + 1))
    else:
        unit = most ** (1 / exponent)  # powers of x / unit add up to one
        powers = np.zeros((3 * n, 2 * n))
        powers[0::3, n:], powers[2::3, :n] = -np.eye(n), -np.eye(n) / unit
        plain = np.vstack([a, sides])
        budget = np.concatenate([np.zeros(n), weights])
        matrix = np.vstack([np.hstack([plain, np.zeros((len(plain), n))]), budget, powers])
        ends = [1.0, *np.tile([0.0, 1.0, 0.0], n)]
        cones += [clarabel.NonnegativeConeT(1), *[clarabel.PowerConeT(1 / exponent)] * n]
        cost = np.concatenate([cost, np.zeros(n)])
    right = np.concatenate([b, limits, ends])
    for slopes, constant in matrices:
        size = len(constant)
        pairs = [(i, j) for j in range(size) for i in range(j + 1)]
        factor = np.array([1.0 if i == j else np.sqrt(2.0) for i, j in pairs]) / SCALE
        pick = tuple(np.array(pairs).T)
        below = np.zeros((len(pairs), matrix.shape[1]))
        below[:, :n] = -(slopes[(slice(None), *pick)] * factor).T
        matrix, right = np.vstack([matrix, below]), np.concatenate([right, constant[pick] * factor])
        cones.append(clarabel.PSDTriangleConeT(size))
    matrix = sp.csc_matrix(matrix)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    nothing = sp.csc_matrix((cost.size, cost.size))
    found = clarabel.DefaultSolver(nothing, cost, matrix, right, cones, settings).solve()
    assert "Solved" in str(found.status)
    return found.obj_val


@pytest.mark.parametrize("effort", [0.001, 0.05, 1.0])
@pytest.mark.parametrize("reserve", [None, 5.0])
@pytest.mark.parametrize("stability", [False, True])
def test_extremes_are_those_of_a_conic_solver_and_certified(effort, reserve, stability):
    rng = np.random.default_rng([13, int(1000 * effort)])
    problem = random_problem(rng, n_frames=2, n_muscles=8, reserve=reserve, stability=stability)
    solution = scso.solve_trajectory(problem)
    found = scso.ranges(solution, effort=effort)
    assert found.gap < 1e-7
    for k in range(2):
        weights, a, *_ = frame_arrays(problem, k)
        x = np.concatenate([solution.activation[k], solution.control[k]])
        most = (1 + effort) * float(weights @ x**2)
        for m in range(8):
            cost = np.eye(a.shape[1])[m]
            low, high = (sign * least_by_clarabel(problem, k, sign * cost, most) for sign in (1, -1))
            np.testing.assert_allclose([found.least[k, m], found.greatest[k, m]], [low, high], atol=2e-6)
            assert found.certified_least[k, m] <= low + 2e-6
            assert found.certified_greatest[k, m] >= high - 2e-6
        if stability:
            g, h = frame_arrays(problem, k)[3:5]
            level = solution.rows["JointStability"].lower
            least = [least_by_clarabel(problem, k, row, most) - low for row, low in zip(g, h, strict=True)]
            np.testing.assert_allclose(found.least_stability[k], level + least, atol=1e-4)
            most_row = [
                -least_by_clarabel(problem, k, -row, most) - low for row, low in zip(g, h, strict=True)
            ]
            np.testing.assert_allclose(found.greatest_stability[k], level + most_row, atol=1e-4)


@pytest.mark.parametrize(
    ("exponent", "reserve", "effort"),
    [(1.3, None, 0.05), (1.5, None, 1.0), (3.0, 5.0, 0.05), (10.0, 5.0, 0.3)],
)
def test_extremes_at_other_exponents_are_those_of_power_cones(exponent, reserve, effort):
    rng = np.random.default_rng([17, int(10 * exponent)])
    problem = random_problem(rng, n_frames=1, n_muscles=7, reserve=reserve, exponent=exponent)
    solution = scso.solve_trajectory(problem)
    found = scso.ranges(solution, effort=effort)
    assert found.gap < 1e-6
    weights, a, *_ = frame_arrays(problem, 0)
    x = np.concatenate([solution.activation[0], solution.control[0]])
    most = (1 + effort) * float(weights @ np.abs(x) ** exponent)
    for m in range(7):
        cost = np.eye(a.shape[1])[m]
        low, high = (sign * least_by_clarabel(problem, 0, sign * cost, most, exponent) for sign in (1, -1))
        np.testing.assert_allclose([found.least[0, m], found.greatest[0, m]], [low, high], atol=1e-5)
        assert found.certified_least[0, m] <= low + 1e-5
        assert found.certified_greatest[0, m] >= high - 1e-5


@pytest.mark.parametrize(
    ("effort", "exponent", "reserve"), [(0.05, 2.0, None), (0.3, 2.0, 5.0), (100.0, 2.0, None), (0.05, 1.5, None), (0.3, 3.0, 5.0)]
)
def test_extremes_with_a_whole_hessian_are_those_of_a_conic_solver(effort, exponent, reserve):
    rng = np.random.default_rng([19, int(10 * effort)])
    problem = hessian_problem(rng, n_frames=2, n_muscles=9, n_coordinates=3, exponent=exponent, reserve=reserve)
    solution = scso.solve_trajectory(problem)
    found = scso.ranges(solution, effort=effort)
    assert found.gap < 1e-6
    assert found.rows == ("q1", "q2", "q3")
    for k in range(2):
        matrices, constant = full_frame(problem, k)[2]
        x = np.concatenate([solution.activation[k], solution.control[k]])
        most = (1 + effort) * float((np.abs(x) ** exponent).sum())

        def least(cost, k=k, most=most, matrix=(matrices, constant)):
            return least_by_clarabel(problem, k, cost, most, exponent, [matrix])

        for m in range(9):
            cost = np.eye(x.size)[m]
            low, high = least(cost), -least(-cost)
            np.testing.assert_allclose([found.least[k, m], found.greatest[k, m]], [low, high], atol=1e-5)
            assert found.certified_least[k, m] <= low + 1e-5
            assert found.certified_greatest[k, m] >= high - 1e-5
        for i in range(3):
            cost, own = matrices[:, i, i], constant[i, i]
            low, high = own + least(cost), own - least(-cost)
            attained = found.least_stability[k, i], found.greatest_stability[k, i]
            np.testing.assert_allclose(attained, [low, high], atol=1e-3)
            certified = found.certified_least_stability[k, i], found.certified_greatest_stability[k, i]
            np.testing.assert_allclose(certified, attained, atol=1e-4)


def test_no_pattern_that_keeps_everything_leaves_the_ranges(rng):
    """Walks in random directions through patterns of at most 5 % more effort, as far as each goes."""
    problem = random_problem(rng, n_frames=1, n_muscles=7, reserve=5.0)
    solution = scso.solve_trajectory(problem)
    found = scso.ranges(solution, effort=0.05)
    weights, a, _, g, h, lower, upper = frame_arrays(problem, 0)
    x = np.concatenate([solution.activation[0], solution.control[0]])
    most = 1.05 * float(weights @ x**2)
    basis = np.linalg.svd(a)[2][len(a) :]
    for _ in range(3000):
        step = rng.normal(size=len(basis)) @ basis
        length = 1.0
        while length > 1e-4:
            there = x + length * step
            kept = (g @ there >= h).all() and (lower <= there).all() and (there <= upper).all()
            if kept and weights @ there**2 <= most:
                x = there
                break
            length /= 2
        assert (x[:7] >= found.certified_least[0] - 1e-12).all()
        assert (x[:7] <= found.certified_greatest[0] + 1e-12).all()


def test_with_any_effort_the_others_at_full_activation_leave_the_rest_to_each_muscle():
    """Moments 145, 60 and 20 N·m at full activation: what the others cannot carry is necessary."""
    solution = scso.solve_trajectory(elbow([100.0, 200.0]))
    found = scso.ranges(solution, effort=1e4)
    np.testing.assert_allclose(found.least[0], [20 / 145, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(found.greatest[0], [100 / 145, 1.0, 1.0], atol=1e-8)
    np.testing.assert_allclose(found.least[1], [120 / 145, 35 / 60, 0.0], atol=1e-8)
    needed = found.necessary(0.01)
    assert {name: frames.tolist() for name, frames in needed.items()} == {
        "m1": [True, True],
        "m2": [False, True],
    }


def test_what_a_residual_costs_is_no_effort_to_choose():
    """500 N·m that no muscle helps with cost 250000: 5 % of that would allow the elbow any pattern."""
    alone = elbow([60.0])
    arms = np.array([[[0.1, 0.05, 0.02], [0.0, 0.0, 0.0]]])
    trajectory = helpers.motion(arms, [[60.0, 500.0]], actuator_columns=[[0.0], [1.0]])
    residual = scso.ActuatorParameters(
        actuators=trajectory.actuators, optimal_force=[1.0], min_control=[-np.inf], max_control=[np.inf]
    )
    both = helpers.with_motion(alone, trajectory=trajectory, actuators=residual)
    expected, found = (scso.ranges(scso.solve_trajectory(each)) for each in (alone, both))
    assert found.solution.control[0, 0] == pytest.approx(500.0)
    for name in ("least", "greatest", "certified_least", "certified_greatest"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-8)
    assert expected.least[0, 0] > 0.2


def test_an_unsolved_frame_has_no_ranges():
    solution = scso.solve_trajectory(elbow([60.0, 500.0]), on_failure="return")
    found = scso.ranges(solution)
    assert np.isnan(found.least[1]).all()
    assert np.isfinite(found.least[0]).all()


def test_what_has_no_ranges_is_refused(rng):
    problem = random_problem(rng)
    solution = scso.solve_trajectory(problem)
    with pytest.raises(ProblemError, match="effort is 0, expected a positive share"):
        scso.ranges(solution, effort=0.0)
    for costs in (
        (scso.ActivationEffort(exponent=3.0), scso.ActivationEffort(exponent=4.0, label="steep")),
        (lambda frame: (frame.activation[0] - 0.1) ** 4,),
    ):
        other = dataclasses.replace(problem, objectives=costs)
        with pytest.raises(ProblemError, match="sum of squares, or of one power"):
            scso.ranges(dataclasses.replace(solution, problem=other))
    bent = hessian_problem(rng, n_frames=1, stability=scso.HessianStability(stiffness=Bent()))
    with pytest.raises(ProblemError, match="affine in the unknowns, but that of HessianStability is not"):
        scso.ranges(dataclasses.replace(scso.solve_trajectory(problem.frames([0])), problem=bent))
    coupled = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationRate()))
    with pytest.raises(ProblemError, match="frames that are apart"):
        scso.ranges(dataclasses.replace(solution, problem=coupled))
