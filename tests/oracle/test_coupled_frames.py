"""Terms that couple frames: one dense quadratic program over the whole motion is the judge."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from coupled_terms import CappedEffort, RateLimit, Smoothness
from helpers import frame_arrays, random_problem, solve_qp, unknowns, with_trajectory
from scipy.optimize import minimize

import scso_nlp as scso

#: Frames are not evenly spaced, so that a wrong neighbour's interval shows.
TIME = np.array([0.0, 0.01, 0.03, 0.04])


def uneven(rng, **options):
    problem = random_problem(rng, n_frames=4, n_muscles=6, n_coordinates=2, **options)
    return with_trajectory(problem, time=TIME)


def with_terms(problem, objectives=(), constraints=()):
    return dataclasses.replace(
        problem,
        objectives=(*problem.objectives, *objectives),
        constraints=(*problem.constraints, *constraints),
    )


def dense(problem, smoothness=0.0, fastest=None):
    """The whole motion as one quadratic program over all frames, solved by Clarabel."""
    frames = [frame_arrays(problem, k) for k in range(4)]
    n, m = frames[0][0].size, problem.motion.muscles.n_muscles
    hessian = np.diag(np.concatenate([2 * frame[0] for frame in frames]))
    difference = np.zeros((3 * m, 4 * n))
    for k in range(3):
        difference[k * m : (k + 1) * m, k * n : k * n + m] = -np.eye(m)
        difference[k * m : (k + 1) * m, (k + 1) * n : (k + 1) * n + m] = np.eye(m)
    dt = np.repeat(np.diff(TIME), m)
    hessian += 2 * smoothness * difference.T @ np.diag(1 / dt) @ difference
    rows, least = [_block([frame[3] for frame in frames])], [np.concatenate([frame[4] for frame in frames])]
    if fastest is not None:
        rows += [difference, -difference]
        least += [-fastest * dt, -fastest * dt]
    x = solve_qp(
        hessian,
        np.zeros(4 * n),
        _block([frame[1] for frame in frames]),
        np.concatenate([frame[2] for frame in frames]),
        np.vstack(rows),
        np.concatenate(least),
        np.concatenate([frame[5] for frame in frames]),
        np.concatenate([frame[6] for frame in frames]),
    )
    return x.reshape(4, n)


def _block(blocks):
    height, width = blocks[0].shape
    matrix = np.zeros((height * len(blocks), width * len(blocks)))
    for k, block in enumerate(blocks):
        matrix[k * height : (k + 1) * height, k * width : (k + 1) * width] = block
    return matrix


def whole(solution):
    return np.stack([unknowns(solution, k) for k in range(4)])


#: Activation and control [-]: as for the frame-wise oracle, at a tolerance of 1e-10.
TOLERANCE = 1e-5
OPTIONS = scso.SolverOptions(tolerance=1e-11)


@pytest.mark.parametrize("reserve", [None, 5.0])
@pytest.mark.parametrize("weight", [1e-3, 1e-2, 1.0])
def test_a_smooth_motion_is_the_optimum_of_the_dense_program(rng, weight, reserve):
    problem = uneven(rng, reserve=reserve)
    solution = scso.solve_trajectory(with_terms(problem, [Smoothness(weight=weight)]), options=OPTIONS)
    expected = dense(problem, smoothness=weight)
    np.testing.assert_allclose(whole(solution), expected, atol=TOLERANCE)
    plain = scso.solve_trajectory(problem)
    assert np.abs(solution.activation - plain.activation).max() > 1e-3, "the coupling does nothing"


def test_a_limited_rate_is_kept_as_in_the_dense_program(rng):
    problem = uneven(rng, reserve=5.0)
    solution = scso.solve_trajectory(with_terms(problem, (), [RateLimit(fastest=10.0)]), options=OPTIONS)
    np.testing.assert_allclose(whole(solution), dense(problem, fastest=10.0), atol=TOLERANCE)
    assert (solution.rows["RateLimit"].multiplier[1:] > 1e-3).any(), "the limit is never reached"


def test_smoothness_and_a_limited_rate_together_match_the_dense_program(rng):
    problem = uneven(rng, reserve=5.0)
    coupled = with_terms(problem, [Smoothness(weight=1e-3)], [RateLimit(fastest=10.0)])
    solution = scso.solve_trajectory(coupled, options=OPTIONS)
    np.testing.assert_allclose(whole(solution), dense(problem, smoothness=1e-3, fastest=10.0), atol=TOLERANCE)


def test_the_multiplier_of_a_rate_limit_is_its_price(rng):
    problem = uneven(rng, reserve=5.0)

    def solve(fastest):
        return scso.solve_trajectory(with_terms(problem, (), [RateLimit(fastest=fastest)]), options=OPTIONS)

    price = (solve(9.99).objective - solve(10.01).objective) / 0.02
    found = np.nansum(solve(10.0).rows["RateLimit"].multiplier)
    assert found == pytest.approx(price, rel=2e-3)


@pytest.mark.parametrize("exponent", [2.0, 3.0, 5.0, 10.0])
def test_coupling_of_no_weight_leaves_the_frames_alone(rng, exponent):
    problem = uneven(rng, exponent=exponent, reserve=5.0)
    coupled = with_terms(problem, [Smoothness(weight=0.0)])
    np.testing.assert_allclose(
        scso.solve_trajectory(coupled).activation, scso.solve_framewise(problem).activation, atol=1e-4
    )


def test_a_single_frame_of_a_coupled_problem_is_that_frame(rng):
    problem = uneven(rng)
    coupled = with_terms(problem, [Smoothness()], [RateLimit()]).frames(2, 3)
    solution = scso.solve_trajectory(coupled)
    np.testing.assert_allclose(
        solution.activation, scso.solve_trajectory(problem.frames(2, 3)).activation, atol=1e-4
    )
    assert solution.objective_terms["Smoothness"] == 0.0


def test_frame_by_frame_refuses_coupled_terms_by_name(rng):
    problem = with_terms(uneven(rng), [Smoothness()], [RateLimit()])
    assert problem.coupled_terms == ("Smoothness", "RateLimit")
    with pytest.raises(
        scso.CouplingError,
        match=r"Smoothness, RateLimit couples frames, .* use solve_trajectory, or .*without_coupling\(\)",
    ):
        scso.solve_framewise(problem)
    dropped = problem.without_coupling()
    assert dropped.coupled_terms == ()
    scso.solve_framewise(dropped)


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_a_curved_row_is_kept_as_by_sequential_quadratic_programming(rng, solve):
    problem = random_problem(rng, n_frames=3, n_muscles=6, n_coordinates=2, exponent=3.0, reserve=5.0)
    free = solve(problem)
    most = 0.9 * (free.activation**2).sum(axis=1).min()
    solution = solve(with_terms(problem, (), [CappedEffort(most=most)]), options=OPTIONS)
    for k in range(3):
        weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
        expected = minimize(
            lambda x: float((np.abs(x) ** 3).sum()),
            unknowns(free, k),
            jac=lambda x: 3 * x * np.abs(x),
            bounds=[*zip(lower, upper, strict=True)],
            constraints=[
                {"type": "eq", "fun": lambda x, a=a, b=b: a @ x - b, "jac": lambda x, a=a: a},
                {"type": "ineq", "fun": lambda x, g=g, h=h: g @ x - h, "jac": lambda x, g=g: g},
                {"type": "ineq", "fun": lambda x: most - (x[:6] ** 2).sum()},
            ],
            method="SLSQP",
            options={"ftol": 1e-13, "maxiter": 1000},
        )
        assert weights.min() == weights.max() == 1.0
        found = float((np.abs(unknowns(solution, k)) ** 3).sum())
        assert found == pytest.approx(expected.fun, rel=1e-5)
