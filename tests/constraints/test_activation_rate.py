"""Bounds on the rate of activation against the closed form that they let through, and a dense program."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, motion, muscle_parameters, solve_qp, with_motion
from muscle_models.mixed_muscles import MILLARD, mixed_problem

import scso_nlp as scso

OPTIONS = scso.SolverOptions(tolerance=1e-10)
RISE, FALL = 0.01, 0.04


def jump(times, *, up, bounds):
    """One muscle that is asked to jump at 0.05 s; a reserve that costs all there is does the rest."""
    wanted = np.where((times < 0.05) ^ up, 1.0, 0.0)
    n = len(times)
    trajectory = dataclasses.replace(
        motion(np.full((n, 1, 1), 0.05), 50.0 * wanted[:, None], actuator_columns=[[50.0]]), time=times
    )
    return scso.MuscleForceProblem(
        motion=scso.Motion(
            trajectory=trajectory,
            muscles=muscle_parameters(trajectory.muscles, 1000.0),
            actuators=scso.ActuatorParameters(
                actuators=trajectory.actuators,
                optimal_force=[50.0],
                min_control=[-np.inf],
                max_control=[np.inf],
            ),
        ),
        muscle_model=scso.NoPhysiology(),
        objectives=(lambda frame: frame.control[0] ** 2,),
        constraints=(scso.MomentEquilibrium(), scso.ActivationRate(bounds=bounds)),
    )


@pytest.mark.parametrize("up", [True, False])
def test_a_jump_becomes_the_exponential_of_the_time_constant(up):
    """While it rises, a = 1 - (1 - a0) exp(-t/rise); while it falls, a = a0 exp(-t/fall)."""
    times = np.linspace(0.0, 0.2, 401)
    solution = scso.solve_trajectory(jump(times, up=up, bounds="first_order"), options=OPTIONS)
    a = solution.activation[:, 0]
    missing = 1 - a if up else a
    ratio = missing[1:] / missing[:-1]
    bound = (solution.rows["ActivationRate"].multiplier[1:, 0 if up else 1] > 1e-6) & (missing[:-1] > 1e-3)
    assert bound.sum() > 20, "the bound hardly ever binds"
    # The trapezoidal rule's own factor, exactly; it differs from the exponential by (dt/tau)^3 / 12.
    half = 0.5 * (times[1] - times[0]) / (RISE if up else FALL)
    np.testing.assert_allclose(ratio[bound], (1 - half) / (1 + half), rtol=1e-5)
    np.testing.assert_allclose(ratio[bound], np.exp(-2 * half), rtol=1e-4)


@pytest.mark.parametrize(("up", "most"), [(True, 1 / RISE), (False, 1 / FALL)])
def test_constant_bounds_let_a_jump_become_a_straight_line(up, most):
    times = np.linspace(0.0, 0.2, 401)
    solution = scso.solve_trajectory(jump(times, up=up, bounds="constant"), options=OPTIONS)
    rate = np.diff(solution.activation[:, 0]) / np.diff(times) * (1 if up else -1)
    assert rate.max() == pytest.approx(most, rel=1e-6)
    inside = (solution.activation[:-1, 0] > 0.05) & (solution.activation[1:, 0] < 0.95)
    line = inside & (solution.activation[1:, 0] > 0.05) & (solution.activation[:-1, 0] < 0.95)
    assert line.sum() > 10
    np.testing.assert_allclose(rate[line], most, rtol=1e-5)


@pytest.mark.parametrize("bounds", ["first_order", "constant"])
def test_rows_and_their_bounds_are_what_numpy_says(rng, bounds):
    problem = mixed_problem(
        rng,
        scso.NoPhysiology(),
        classes=(MILLARD,) * 3,
        shapes=({},) * 3,
        max_activation=np.array([1.0, 0.8, 1.5]),
    )
    time = np.array([0.0, 0.01, 0.04, 0.05])
    problem = dataclasses.replace(
        problem,
        motion=dataclasses.replace(
            problem.motion, trajectory=dataclasses.replace(problem.motion.trajectory, time=time)
        ),
        constraints=(scso.ActivationRate(bounds=bounds),),
    )
    a, muscles = rng.uniform(0.05, 0.7, (4, 3)), problem.motion.muscles
    found = evaluate_terms(problem, a)[1]["ActivationRate"]
    rate, mean = np.diff(a, axis=0) / np.diff(time)[:, None], 0.5 * (a[1:] + a[:-1])
    if bounds == "constant":
        np.testing.assert_allclose(found, rate, rtol=1e-12)
        return
    over = rate - (muscles.max_activation - mean) / muscles.activation_time_constant
    under = rate - (muscles.min_activation - mean) / muscles.deactivation_time_constant
    np.testing.assert_allclose(found, np.hstack([over, under]), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("bounds", ["first_order", "constant"])
def test_the_optimum_is_that_of_one_dense_quadratic_program(rng, bounds):
    n_frames, n = 4, 5
    problem = mixed_problem(
        rng, scso.NoPhysiology(), classes=(MILLARD,) * n, shapes=({},) * n, n_frames=n_frames, reserve=5.0
    )
    time = np.array([0.0, 0.002, 0.01, 0.012])
    trajectory = dataclasses.replace(problem.motion.trajectory, time=time)
    problem = with_motion(problem, trajectory=trajectory)
    coupled = dataclasses.replace(
        problem, constraints=(*problem.constraints, scso.ActivationRate(bounds=bounds))
    )
    solution = scso.solve_trajectory(coupled, options=scso.SolverOptions(tolerance=1e-11))
    muscles, size = problem.motion.muscles, n + 2
    a = np.zeros((2 * n_frames, size * n_frames))
    g, h = [], []
    for k in range(n_frames):
        columns = slice(k * size, (k + 1) * size)
        a[2 * k : 2 * k + 2, columns] = np.hstack(
            [
                trajectory.moment_arms[k] * muscles.max_isometric_force,
                trajectory.actuator_generalized_forces[k],
            ]
        )
        if k == 0:
            continue
        for m in range(n):
            span = muscles.max_activation[m] - muscles.min_activation[m]
            for sign, tau, end in (
                (-1, muscles.activation_time_constant[m], muscles.max_activation[m]),
                (1, muscles.deactivation_time_constant[m], muscles.min_activation[m]),
            ):
                row, dt = np.zeros(size * n_frames), time[k] - time[k - 1]
                row[k * size + m], row[(k - 1) * size + m] = sign / dt, -sign / dt
                least = -span / tau
                if bounds == "first_order":  # sign * (rate - (end - mean) / tau) >= 0
                    row[k * size + m] += sign * 0.5 / tau
                    row[(k - 1) * size + m] += sign * 0.5 / tau
                    least = sign * end / tau
                g.append(row)
                h.append(least)
    tile = lambda low, high: np.tile(np.concatenate([low, high]), n_frames)  # noqa: E731
    expected = solve_qp(
        2 * np.eye(size * n_frames),
        np.zeros(size * n_frames),
        a,
        trajectory.generalized_forces.ravel(),
        np.array(g),
        np.array(h),
        tile(muscles.min_activation, [-np.inf] * 2),
        tile(muscles.max_activation, [np.inf] * 2),
    ).reshape(n_frames, size)
    np.testing.assert_allclose(solution.activation, expected[:, :n], atol=1e-5)
    free = scso.solve_trajectory(problem)
    assert solution.objective > free.objective * (1 + 1e-4), "the bounds do not bind"


def test_first_order_bounds_let_no_more_through_than_constant_ones(rng):
    problem = mixed_problem(rng, scso.NoPhysiology(), classes=(MILLARD,) * 6, shapes=({},) * 6, n_frames=8)
    costs = [scso.solve_trajectory(problem).objective]
    for bounds in ("constant", "first_order"):
        rows = scso.ActivationRate(bounds=bounds)
        coupled = dataclasses.replace(problem, constraints=(*problem.constraints, rows))
        costs.append(scso.solve_trajectory(coupled).objective)
    assert costs[0] * (1 - 1e-7) <= costs[1] <= costs[2] * (1 + 1e-7)
    assert costs[2] > costs[0] * (1 + 1e-3)


def test_an_unknown_kind_of_bounds_is_refused():
    with pytest.raises(scso.ProblemError, match="bounds is 'none', expected 'first_order' or 'constant'"):
        scso.ActivationRate(bounds="none")
