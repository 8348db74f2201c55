"""Problems with a matrix inequality, and their optima by the conic solver Clarabel, from plain arrays."""

from __future__ import annotations

import dataclasses

import clarabel
import numpy as np
import scipy.sparse as sp

import scso_nlp as scso
from problems.random_hessian import problem as random_hessian
from scso_nlp import HessianStability

#: Clarabel sees matrices divided by this [N·m/rad]; it stops at residuals of 1e-10 of what it sees.
SCALE = 100.0


def hessian_problem(
    rng, *, n_coordinates=4, n_muscles=16, n_frames=4, exponent=2.0, reserve=None, stability=None
):
    """A random motion whose loads topple it in every direction, with an exponent and a rule of one's own."""
    problem = random_hessian.make_problem(n_coordinates, n_muscles, n_frames, seed=rng, reserve=reserve)
    return dataclasses.replace(
        problem,
        objectives=(scso.ActivationEffort(exponent=exponent),),
        constraints=(scso.MomentEquilibrium(), stability or HessianStability()),
    )


def with_forces(problem, factor):
    """All forces, moments and stiffnesses times a number: another unit."""
    motion = problem.motion
    trajectory, curvature = motion.trajectory, motion.trajectory.curvature
    trajectory = dataclasses.replace(
        trajectory,
        generalized_forces=trajectory.generalized_forces * factor,
        actuator_generalized_forces=trajectory.actuator_generalized_forces * factor,
        curvature=dataclasses.replace(
            curvature,
            load_stiffness=curvature.load_stiffness * factor,
            passive_stiffness=curvature.passive_stiffness * factor,
        ),
    )
    muscles, actuators = motion.muscles, motion.actuators
    muscles = dataclasses.replace(muscles, max_isometric_force=muscles.max_isometric_force * factor)
    actuators = dataclasses.replace(actuators, optimal_force=actuators.optimal_force * factor)
    changed = scso.Motion(trajectory=trajectory, muscles=muscles, actuators=actuators)
    return dataclasses.replace(problem, motion=changed)


def hessian_by_hand(problem, k, tendon_force, stiffness, *, passive=0.0):
    """H of one frame as the formula says it, muscle by muscle."""
    trajectory, curvature = problem.motion.trajectory, problem.motion.trajectory.curvature
    total = curvature.load_stiffness[k] + curvature.passive_stiffness[k] + passive
    for m in range(len(trajectory.muscles)):
        arm = trajectory.moment_arms[k, :, m]
        total = total + tendon_force[m] * curvature.path_curvature[k, :, :, m]
        total = total + stiffness[m] * np.outer(arm, arm)
    return total


def smallest_eigenvalue(problem, k, tendon_force, q=5.0, level=0.0, passive=0.0):
    """Of H minus its levels in one frame, with stiffness proportional to force."""
    stiffness = q * tendon_force / problem.motion.trajectory.muscle_tendon_length[k]
    hessian = hessian_by_hand(problem, k, tendon_force, stiffness, passive=passive)
    n = len(hessian)
    return np.linalg.eigvalsh(hessian - np.broadcast_to(level, n) * np.eye(n))[0]


def full_frame(problem, k, *, q=5.0, level=0.0, passive=0.0):
    """One frame in plain arrays over x = (activations, controls), with k = q F / L.

    Returns (A, b), (lower, upper) and (G, K) of: A x = b, bounds, K + sum x_i G_i ⪰ 0.
    """
    trajectory, muscles, actuators = (
        problem.motion.trajectory,
        problem.motion.muscles,
        problem.motion.actuators,
    )
    strength, m, n_controls = muscles.max_isometric_force, muscles.n_muscles, actuators.n_actuators
    size = len(trajectory.coordinates)
    zero = np.zeros(m)
    matrices = np.zeros((m + n_controls, size, size))
    for i in range(m):
        unit = zero.copy()
        unit[i] = strength[i]
        one = hessian_by_hand(problem, k, unit, q * unit / trajectory.muscle_tendon_length[k])
        matrices[i] = one - hessian_by_hand(problem, k, zero, zero)
    constant = hessian_by_hand(problem, k, zero, zero, passive=passive)
    constant = constant - np.broadcast_to(level, size) * np.eye(size)
    equations = np.hstack([trajectory.moment_arms[k] * strength, trajectory.actuator_generalized_forces[k]])
    lower = np.concatenate([muscles.min_activation, actuators.min_control])
    upper = np.concatenate([muscles.max_activation, actuators.max_control])
    return (equations, trajectory.generalized_forces[k]), (lower, upper), (matrices, constant)


def solve_full_frame(problem, k, *, q=5.0, level=0.0, passive=0.0, soft=None, scale=SCALE):
    """Optimum of one frame under H - diag(level) ⪰ 0 with k = q F / L.

    Returns (x, objective, missed) with x = (activations, controls), or None where there is no solution.
    """
    (a, b), (lower, upper), (matrices, constant) = full_frame(problem, k, q=q, level=level, passive=passive)
    n, linear = len(lower), np.zeros(len(lower))
    if soft is not None:
        matrices = np.concatenate([matrices, scale * np.eye(len(constant))[None]])
        a = np.hstack([a, np.zeros((len(a), 1))])
        lower, upper = np.append(lower, 0.0), np.append(upper, np.inf)
        linear = np.append(linear, soft * scale)
    x, objective = solve_conic(
        problem.objectives[0].exponent,
        n,
        linear,
        (a, b),
        (lower, upper),
        (matrices / scale, constant / scale),
    )
    if x is None:
        return None
    return x[:n], objective, (x[n] * scale if soft is not None else 0.0)


def highest_eigenvalue(problem, k, *, q=5.0, scale=SCALE):
    """Greatest smallest eigenvalue of H that equilibrium and bounds leave, by Clarabel."""
    (a, b), (lower, upper), (matrices, constant) = full_frame(problem, k, q=q)
    matrices = np.concatenate([matrices, -scale * np.eye(len(constant))[None]])
    x, _ = solve_conic(
        2.0,
        0,
        np.append(np.zeros(len(lower)), -1.0),
        (np.hstack([a, np.zeros((len(a), 1))]), b),
        (np.append(lower, -np.inf), np.append(upper, np.inf)),
        (matrices / scale, constant / scale),
    )
    return scale * x[-1]


def solve_conic(exponent, n_powers, linear, equations, bounds, inequality):
    """min sum |x_i|^p over the first unknowns (at infinity the largest) + c'x, A x = b, bounds,
    K + sum x_i G_i ⪰ 0.

    Returns (x, objective), or (None, None) where there is no solution.
    """
    n = linear.size
    matrices, constant = inequality
    size = len(constant)
    upper_triangle = [(i, j) for j in range(size) for i in range(j + 1)]
    weight = np.array([1.0 if i == j else np.sqrt(2.0) for i, j in upper_triangle])
    pick = tuple(np.array(upper_triangle).T)
    low, high = np.isfinite(bounds[0]), np.isfinite(bounds[1])
    eye = np.eye(n)
    blocks = [equations[0], -eye[low], eye[high], -np.array([weight * g[pick] for g in matrices]).T]
    right = [equations[1], -bounds[0][low], bounds[1][high], weight * constant[pick]]
    cones = [
        clarabel.ZeroConeT(len(equations[1])),
        clarabel.NonnegativeConeT(int(low.sum() + high.sum())),
        clarabel.PSDTriangleConeT(size),
    ]
    quadratic = np.zeros((n, n))
    matrix, cost = np.vstack(blocks), linear
    if exponent == 2:
        quadratic[:n_powers, :n_powers] = 2 * np.eye(n_powers)
    elif exponent in (1, np.inf):
        # t >= x and t >= -x, with one t for each or for all
        first = np.eye(n)[:n_powers]
        last = np.eye(n_powers) if exponent == 1 else np.ones((n_powers, 1))
        matrix = np.hstack([matrix, np.zeros((len(matrix), last.shape[1]))])
        matrix = np.vstack([matrix, np.hstack([first, -last]), np.hstack([-first, -last])])
        right.append(np.zeros(2 * n_powers))
        cones.append(clarabel.NonnegativeConeT(2 * n_powers))
        quadratic = np.zeros((n + last.shape[1],) * 2)
        cost = np.concatenate([linear, np.ones(last.shape[1])])
    else:
        # t >= |x|^p as the power cone t^(1/p) 1^(1 - 1/p) >= |x|
        powers = np.zeros((3 * n_powers, n + n_powers))
        offsets = np.zeros(3 * n_powers)
        for i in range(n_powers):
            powers[3 * i, n + i] = powers[3 * i + 2, i] = -1.0
            offsets[3 * i + 1] = 1.0
        matrix = np.vstack([np.hstack([matrix, np.zeros((len(matrix), n_powers))]), powers])
        right.append(offsets)
        cones += [clarabel.PowerConeT(1 / exponent) for _ in range(n_powers)]
        quadratic = np.zeros((n + n_powers,) * 2)
        cost = np.concatenate([linear, np.ones(n_powers)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    answer = clarabel.DefaultSolver(
        sp.csc_matrix(quadratic), cost, sp.csc_matrix(matrix), np.concatenate(right), cones, settings
    ).solve()
    if "Infeasible" in str(answer.status):
        return None, None
    assert str(answer.status) in ("Solved", "AlmostSolved"), str(answer.status)
    return np.asarray(answer.x)[:n], float(answer.obj_val)
