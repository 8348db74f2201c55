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
from scso_nlp.solver.extreme_cones import extremes_by_cones


def least_by_clarabel(problem, k, cost, most, exponent=2.0, matrices=(), price=None):
    """Least cost'x with A x = b, G x >= h, bounds and sum w |x|^p <= most, by a conic solver.

    For p other than 2 every power has a bound t of its own: (t, 1, x) in the power cone of 1/p. Pairs (M, K)
    of `matrices` are matrix inequalities K + sum x_i M_i ⪰ 0. With a price (and p = 2), x has one unknown
    more, which adds to the effort: what all eigenvalues may be negative by, over SCALE; without matrices one
    for every row, what it may miss.
    """
    weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
    n_missed = 0 if price is None else 1 if matrices else len(h)
    if n_missed:
        weights, lower = (np.pad(each, (0, n_missed)) for each in (weights, lower))
        upper, a = np.append(upper, np.full(n_missed, np.inf)), np.pad(a, ((0, 0), (0, n_missed)))
        cost = np.pad(cost, (0, a.shape[1] - cost.size))
        if matrices:
            g = np.pad(g, ((0, 0), (0, 1)))
            matrices = [(np.concatenate([m, SCALE * np.eye(len(c))[None]]), c) for m, c in matrices]
        else:
            g = np.hstack([g, np.eye(n_missed)])
    n = a.shape[1]
    below, above = np.isfinite(lower), np.isfinite(upper)
    sides = np.vstack([-g, -np.eye(n)[below], np.eye(n)[above]])
    limits = np.concatenate([-h, -lower[below], upper[above]])
    cones = [clarabel.ZeroConeT(len(b)), clarabel.NonnegativeConeT(len(limits))]
    if price is not None:  # u = most - price * missed: (u + 1)^2 >= (u - 1)^2 + 4 x'Wx
        u = np.repeat([0.0, price * (SCALE if matrices else 1.0)], [n - n_missed, n_missed])
        matrix = np.vstack([a, sides, u, u, -2 * np.diag(np.sqrt(weights))])
        ends = [most + 1, most - 1, *np.zeros(n)]
        cones.append(clarabel.SecondOrderConeT(n + 2))
    elif exponent == 2:
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
        own = np.zeros((len(pairs), matrix.shape[1]))
        own[:, :n] = -(slopes[(slice(None), *pick)] * factor).T
        matrix, right = np.vstack([matrix, own]), np.concatenate([right, constant[pick] * factor])
        cones.append(clarabel.PSDTriangleConeT(size))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    nothing = sp.csc_matrix((cost.size, cost.size))
    found = clarabel.DefaultSolver(nothing, cost, sp.csc_matrix(matrix), right, cones, settings).solve()
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


@pytest.mark.parametrize("effort", [0.001, 0.05, 1.0])
@pytest.mark.parametrize("price", [0.0003, 0.01, 0.3])
def test_extremes_where_rows_may_be_missed_are_those_of_a_conic_solver(rng, price, effort):
    """What is missed costs linearly: no curvature holds it, and no gap is left all the same."""
    problem = random_problem(rng, n_frames=2, n_muscles=8, reserve=5.0)
    (stability,) = problem.stability_terms
    level = {row: 100.0 + value for row, value in stability.level.items()}
    stability = dataclasses.replace(stability, level=level, soft=price)
    problem = dataclasses.replace(problem, constraints=(problem.constraints[0], stability))
    solution = scso.solve_trajectory(problem, on_failure="return")
    missed = solution.rows["JointStability"].missed
    assert missed.max() > 1.0
    found = scso.ranges(solution, effort=effort)
    assert found.gap < 1e-7
    for k in range(2):
        x = np.concatenate([solution.activation[k], solution.control[k]])
        most = (1 + effort) * float(x @ x + price * missed[k].sum())

        def least(cost, k=k, most=most):
            return least_by_clarabel(problem, k, cost, most, price=price)

        check_activations(found, problem, k, least, 1e-5)
        for i, row in enumerate(frame_arrays(problem, k)[3]):
            value = solution.rows["JointStability"].value[k, i] - row @ x
            attained = found.least_stability[k, i] - value, found.greatest_stability[k, i] - value
            np.testing.assert_allclose(attained, [least(row), -least(-row)], atol=1e-3)


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


def check_activations(found, problem, k, least, atol):
    """Extremes of all activations of a frame are those of an oracle, and certified."""
    n = found.least.shape[1]
    for m in range(n):
        cost = np.eye(n + problem.motion.actuators.n_actuators + 1)[m]
        low, high = least(cost), -least(-cost)
        np.testing.assert_allclose([found.least[k, m], found.greatest[k, m]], [low, high], atol=atol)
        assert found.certified_least[k, m] <= low + atol
        assert found.certified_greatest[k, m] >= high - atol


@pytest.mark.parametrize(
    ("effort", "exponent", "reserve"),
    [(0.05, 2.0, None), (0.3, 2.0, 5.0), (100.0, 2.0, None), (0.05, 1.5, None), (0.3, 3.0, 5.0)],
)
def test_extremes_with_a_whole_hessian_are_those_of_a_conic_solver(effort, exponent, reserve):
    """Clarabel's answers with powers are good to 1e-5; what is attained and certified, to 1e-6."""
    rng = np.random.default_rng([19, int(10 * effort)])
    problem = hessian_problem(
        rng, n_frames=2, n_muscles=9, n_coordinates=3, exponent=exponent, reserve=reserve
    )
    solution = scso.solve_trajectory(problem)
    found = scso.ranges(solution, effort=effort)
    assert found.gap < 1e-6
    assert found.rows == ("q1", "q2", "q3")
    for k in range(2):
        matrices, constant = full_frame(problem, k)[2]
        x = np.concatenate([solution.activation[k], solution.control[k]])
        most = (1 + effort) * float((np.abs(x) ** exponent).sum())

        def least(cost, k=k, most=most, matrix=(matrices, constant), n=x.size):
            return least_by_clarabel(problem, k, cost[:n], most, exponent, [matrix])

        check_activations(found, problem, k, least, 1e-5)
        for i in range(3):
            cost, own = matrices[:, i, i], constant[i, i]
            attained = found.least_stability[k, i], found.greatest_stability[k, i]
            np.testing.assert_allclose(attained, [own + least(cost), own - least(-cost)], atol=1e-3)
            certified = found.certified_least_stability[k, i], found.certified_greatest_stability[k, i]
            np.testing.assert_allclose(certified, attained, atol=1e-4)


def test_extremes_where_a_whole_hessian_may_be_missed_are_those_of_a_conic_solver(rng):
    price, level = 0.001, 40.0
    rule = scso.HessianStability(level=level, soft=price)
    problem = hessian_problem(rng, n_frames=1, n_muscles=9, n_coordinates=3, stability=rule)
    solution = scso.solve_trajectory(problem)
    missed = solution.matrices["HessianStability"].missed[0]
    assert missed > 1.0
    found = scso.ranges(solution, effort=0.1)
    assert found.gap < 1e-6
    matrix = full_frame(problem, 0, level=level)[2]
    most = 1.1 * (float((solution.activation[0] ** 2).sum()) + price * missed)

    def least(cost):
        return least_by_clarabel(problem, 0, cost, most, matrices=[matrix], price=price)

    check_activations(found, problem, 0, least, 1e-5)


def test_extremes_with_two_matrices_and_a_row_are_those_of_a_conic_solver(rng):
    problem = hessian_problem(rng, n_frames=1, n_muscles=9, n_coordinates=4)
    (matrices, constant), names = full_frame(problem, 0)[2], ("q1", "q2", "q3", "q4")
    rules = (
        scso.HessianStability(coordinates=names[:2], label="first"),
        scso.HessianStability(coordinates=names[1:3], label="second"),
        scso.CoordinateStability(coordinates=names[3:]),
    )
    problem = dataclasses.replace(problem, constraints=(problem.constraints[0], *rules))
    solution = scso.solve_trajectory(problem)
    found = scso.ranges(solution, effort=0.1)
    assert found.gap < 1e-6
    assert found.rows == ("q4", "q1", "q2", "q2", "q3")
    blocks = [(matrices[:, s, s], constant[s, s]) for s in (slice(2), slice(1, 3), slice(3, 4))]
    most = 1.1 * float((solution.activation[0] ** 2).sum())

    def least(cost):
        return least_by_clarabel(problem, 0, cost[:9], most, matrices=blocks)

    check_activations(found, problem, 0, least, 1e-5)


def seen_extremes(problem, effort, monkeypatch):
    """Frames near the optimum, and the points and multipliers found there."""
    seen = []

    def watched(frame, matrix):
        found = extremes_by_cones(frame, matrix)
        seen.append((frame, found))
        return found

    monkeypatch.setattr(extremes, "extremes_by_cones", watched)
    return seen, scso.ranges(scso.solve_trajectory(problem), effort=effort)


def test_certificates_of_a_whole_hessian_are_products(rng, monkeypatch):
    """Multiplied out from plain arrays, the least over every activation by itself taken from a fine grid."""
    problem = hessian_problem(rng, n_frames=1, n_muscles=9, n_coordinates=3)
    ((_, seen),), found = seen_extremes(problem, 0.05, monkeypatch)
    (a, b), _, (matrices, constant) = full_frame(problem, 0)
    length = np.abs(a).max(axis=1)
    x = found.solution.activation[0]
    grid = np.linspace(0.0, 1.0, 20001)
    for m in range(9):
        y, weight, push = seen.multipliers[m], seen.weight[m] / float(x @ x), seen.of_matrix[m]
        assert np.linalg.eigvalsh(push)[0] >= -1e-12 * np.abs(push).max()
        slope = np.eye(9)[m] + y @ (a / length[:, None]) - np.einsum("ab,iab->i", push, matrices)
        each = (weight * grid**2 + slope[:, None] * grid).min(axis=1)
        held = y @ (b / length) + np.sum(push * constant) + 1.05 * weight * float(x @ x)
        bound = max(each.sum() - held, 0.0)
        assert found.certified_least[0, m] == pytest.approx(bound, abs=1e-7)


def test_what_is_attained_with_a_whole_hessian_keeps_everything(rng, monkeypatch):
    problem = hessian_problem(rng, n_frames=1, n_muscles=9, n_coordinates=3)
    ((_, seen),), found = seen_extremes(problem, 0.05, monkeypatch)
    (a, b), _, (matrices, constant) = full_frame(problem, 0)
    x = seen.points[:9]
    np.testing.assert_allclose(np.diag(x), found.least[0], atol=1e-12)
    np.testing.assert_allclose(x @ a.T, np.broadcast_to(b, (9, 3)), atol=1e-6)
    assert np.linalg.eigvalsh(constant + np.tensordot(x, matrices, 1))[:, 0].min() > -1e-5
    assert (x**2).sum(axis=1).max() <= (1 + 1e-8) * 1.05 * (found.solution.activation[0] ** 2).sum()


def test_certificates_hold_whatever_the_multipliers_are(rng, monkeypatch):
    """Multipliers of rows and of the matrix at random, indefinite ones among them: true, if useless."""
    problem = hessian_problem(rng, n_frames=1, n_muscles=9, n_coordinates=3)
    ((frame, seen),), found = seen_extremes(problem, 0.05, monkeypatch)
    for size in np.repeat([1e-8, 1e-4, 1e-2, 1.0], 5):
        noise = rng.normal(size=seen.of_matrix.shape)
        other = dataclasses.replace(
            seen,
            multipliers=seen.multipliers + size * rng.normal(size=seen.multipliers.shape),
            weight=seen.weight * np.exp(size * rng.normal(size=seen.weight.shape)),
            of_matrix=seen.of_matrix + size * (noise + noise.transpose(0, 2, 1)),
            points=np.full_like(seen.points, np.nan),
        )
        bounds = frame.bounds(other)[:9]
        assert (bounds <= found.least[0] + 1e-9).all()


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
    bent = hessian_problem(
        rng, n_frames=1, stability=scso.HessianStability(stiffness=scso.FallingStiffness())
    )
    with pytest.raises(ProblemError, match="affine in the unknowns, but that of HessianStability is not"):
        scso.ranges(dataclasses.replace(scso.solve_trajectory(problem.frames([0])), problem=bent))
    coupled = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationRate()))
    with pytest.raises(ProblemError, match="frames that are apart"):
        scso.ranges(dataclasses.replace(solution, problem=coupled))
