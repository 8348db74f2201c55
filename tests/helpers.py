"""Small problems made by hand, with known answers."""

from __future__ import annotations

import dataclasses

import clarabel
import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

import scso_nlp as scso
from scso_nlp.transcription.describe import describe
from scso_nlp.transcription.piece import evaluate


def muscle_parameters(names, strength, *, lower=0.0, upper=1.0, optimal_fiber_length=0.1):
    n = len(names)
    return scso.MuscleParameters(
        muscles=tuple(names),
        muscle_class=("Millard2012EquilibriumMuscle",) * n,
        max_isometric_force=np.broadcast_to(strength, n),
        optimal_fiber_length=np.broadcast_to(optimal_fiber_length, n),
        tendon_slack_length=np.full(n, 0.2),
        pennation_angle_at_optimal=np.zeros(n),
        max_contraction_velocity=np.full(n, 10.0),
        min_activation=np.broadcast_to(lower, n),
        max_activation=np.broadcast_to(upper, n),
        activation_time_constant=np.full(n, 0.01),
        deactivation_time_constant=np.full(n, 0.04),
    )


def motion(
    moment_arms, generalized_forces, *, actuator_columns=None, skeleton=None, length=0.2, capacity=None
):
    """A trajectory from moment arms (n_frames, n_coordinates, n_muscles) and moments, 0.01 s apart."""
    moment_arms = np.asarray(moment_arms, dtype=float)
    generalized_forces = np.asarray(generalized_forces, dtype=float)
    n_frames, n_coordinates, n_muscles = moment_arms.shape
    columns = (
        np.zeros((n_coordinates, 0)) if actuator_columns is None else np.asarray(actuator_columns, float)
    )
    return scso.MotionTrajectory(
        name="tiny",
        muscles=tuple(f"m{i + 1}" for i in range(n_muscles)),
        actuators=tuple(f"reserve{i + 1}" for i in range(columns.shape[1])),
        coordinates=tuple(f"q{i + 1}" for i in range(n_coordinates)),
        is_rotational=np.ones(n_coordinates, dtype=bool),
        time=0.01 * np.arange(n_frames),
        coordinate_values=np.zeros((n_frames, n_coordinates)),
        coordinate_speeds=np.zeros((n_frames, n_coordinates)),
        muscle_tendon_length=np.full((n_frames, n_muscles), length),
        muscle_tendon_velocity=np.zeros((n_frames, n_muscles)),
        moment_arms=moment_arms,
        actuator_generalized_forces=np.broadcast_to(columns, (n_frames, *columns.shape)),
        generalized_forces=generalized_forces,
        passive_generalized_forces=np.zeros((n_frames, n_coordinates)),
        active_force_capacity=np.full((n_frames, n_muscles), 1.0) if capacity is None else capacity,
        other_forces=np.zeros((n_frames, 0)),
        skeleton=skeleton,
    )


def elbow(moments, *, exponent=2.0, reserve=None):
    """One joint, three muscles: the closed form of Crowninshield and Brand."""
    moments = np.atleast_1d(np.asarray(moments, dtype=float))
    arms = np.broadcast_to([[0.1, 0.05, 0.02]], (moments.size, 1, 3))
    trajectory = motion(arms, moments[:, None], actuator_columns=None if reserve is None else [[reserve]])
    actuators = scso.ActuatorParameters()
    if reserve is not None:
        actuators = scso.ActuatorParameters(
            actuators=trajectory.actuators,
            optimal_force=[reserve],
            min_control=[-np.inf],
            max_control=[np.inf],
        )
    return scso.MuscleForceProblem(
        motion=scso.Motion(
            trajectory=trajectory,
            muscles=muscle_parameters(trajectory.muscles, [1450.0, 1200.0, 1000.0]),
            actuators=actuators,
        ),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=exponent),),
        constraints=(scso.MomentEquilibrium(),),
    )


def skeleton(
    points, bodies, *, n_frames=1, load=(0.0, 0.0, 0.0), load_point=(0.0, 0.0, 0.0), weight_height=0.0
):
    """One joint at the origin between ground and "arm"; each muscle has two points."""
    points = np.asarray(points, dtype=float)
    n_muscles = len(points)
    return scso.Skeleton(
        bodies=("ground", "arm"),
        body_parents=[-1, 0],
        body_masses=[0.0, 0.0],
        body_mass_centers=np.zeros((n_frames, 2, 3)),
        gravity=[0.0, -9.81, 0.0],
        joints=("elbow",),
        joint_children=[1],
        joint_centers=np.zeros((n_frames, 1, 3)),
        joint_axes=np.broadcast_to(np.eye(3), (n_frames, 1, 3, 3)),
        load_names=("load",),
        load_bodies=[1],
        load_forces=np.broadcast_to(np.asarray(load, float), (n_frames, 1, 3)),
        load_points=np.broadcast_to(np.asarray(load_point, float), (n_frames, 1, 3)),
        load_torques=np.zeros((n_frames, 1, 3)),
        path_points=np.broadcast_to(points, (n_frames, *points.shape)),
        path_point_bodies=np.broadcast_to(np.asarray(bodies), (n_frames, n_muscles, points.shape[1])),
        path_point_moves=np.zeros((n_frames, n_muscles, points.shape[1]), dtype=bool),
    )


def two_antagonists(moment, *, exponent=2.0, q=5.0, level=0.0, external_work=30.0, strength=2000.0):
    """Symmetric pair about one axis: r = ±0.05 m, A·B = 0, l = L = 0.2 m, EW = 30 N·m/rad.

    One frame for each moment.
    """
    moments = np.atleast_1d(np.asarray(moment, dtype=float))
    # Right-angled triangle from the joint: |A||B| = r l, A·B = 0, |A|² + |B|² = l².
    r, length = 0.05, 0.2
    total = np.sqrt(length**2 + 2 * r * length)  # |A| + |B|
    gap = np.sqrt(length**2 - 2 * r * length)  # |A| - |B|
    a, b = (total + gap) / 2, (total - gap) / 2
    right = [[0.0, a, 0.0], [b, 0.0, 0.0]]
    left = [[0.0, a, 0.0], [-b, 0.0, 0.0]]
    geometry = skeleton(
        [right, left], [[0, 1], [0, 1]], n_frames=moments.size, load=(0.0, -100.0, 0.0),
        load_point=(0.0, external_work / 100.0, 0.0),
    )  # fmt: skip
    arms = np.broadcast_to([[r, -r]], (moments.size, 1, 2))
    trajectory = motion(arms, moments[:, None], skeleton=geometry, length=length)
    return scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscle_parameters(trajectory.muscles, strength)),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=exponent),),
        constraints=(
            scso.MomentEquilibrium(),
            scso.JointStability(q=q, level=level, joints=("elbow",), axes=("z",)),
        ),
    )


def random_problem(
    rng,
    *,
    n_frames=3,
    n_coordinates=3,
    n_muscles=10,
    exponent=2.0,
    weights=None,
    reserve=None,
    stability=True,
    muscle_model=None,
    q=5.0,
):
    """A random problem that activations between 0.2 and 0.6 solve, with three stability rows.

    The rows' levels are what these random activations reach, so that co-contraction is asked for.
    """
    strength = rng.uniform(300.0, 1500.0, n_muscles)
    capacity = strength * rng.uniform(0.7, 1.2, (n_frames, n_muscles))
    arms = rng.normal(0, 0.04, (n_coordinates, n_muscles)) + rng.normal(
        0, 0.004, (n_frames, n_coordinates, n_muscles)
    )
    ends = np.array([[0.0, 0.15, 0.0], [0.0, -0.15, 0.0]]) + rng.normal(0, 0.05, (n_muscles, 2, 3))
    points = ends + rng.normal(0, 0.005, (n_frames, n_muscles, 2, 3))
    geometry = dataclasses.replace(
        skeleton(ends, np.broadcast_to([0, 1], (n_muscles, 2)), n_frames=n_frames),
        path_points=points,
        load_forces=rng.normal([-70.0, -100.0, -70.0], 20.0, (n_frames, 1, 3)),
        load_points=rng.normal([0.1, 0.2, 0.1], 0.02, (n_frames, 1, 3)),
    )
    model = muscle_model or scso.NoPhysiology()
    inside = rng.uniform(0.2, 0.6, (n_frames, n_muscles))
    force = inside * (capacity if isinstance(model, scso.RigidTendon) else strength)
    trajectory = motion(
        arms,
        np.einsum("kcm,km->kc", arms, force),
        actuator_columns=None if reserve is None else reserve * np.eye(n_coordinates),
        skeleton=geometry,
        length=np.linalg.norm(points[:, :, 0] - points[:, :, 1], axis=-1),
        capacity=capacity,
    )
    n_actuators = len(trajectory.actuators)
    problem = scso.MuscleForceProblem(
        motion=scso.Motion(
            trajectory=trajectory,
            muscles=muscle_parameters(
                trajectory.muscles, strength, optimal_fiber_length=rng.uniform(0.05, 0.15, n_muscles)
            ),
            actuators=scso.ActuatorParameters(
                actuators=trajectory.actuators,
                optimal_force=np.full(n_actuators, reserve or 0.0),
                min_control=np.full(n_actuators, -np.inf),
                max_control=np.full(n_actuators, np.inf),
            ),
        ),
        muscle_model=model,
        objectives=(scso.ActivationEffort(exponent=exponent, weights=weights),),
    )
    if not stability:
        return problem
    stiffness, work = stability_by_hand(problem, q)
    reached = (np.einsum("kum,km->ku", stiffness, force) - work).min(axis=0)
    level = {f"elbow_{axis}": float(value) for axis, value in zip("xyz", reached, strict=True)}
    return with_stability(problem, level, q=q)


def with_motion(problem, **parts):
    """The problem about a motion with another trajectory, muscles or actuators."""
    return dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, **parts))


def with_trajectory(problem, **changes):
    """The problem about a motion whose trajectory has other values."""
    return with_motion(problem, trajectory=dataclasses.replace(problem.motion.trajectory, **changes))


def with_joint_reactions(problem, rng, joints=("hip", "knee")):
    """The problem about a motion whose joints carry random shares of all forces, 700 N without any."""
    trajectory = problem.motion.trajectory
    n_frames, n, n_muscles = trajectory.n_frames, len(joints), len(trajectory.muscles)
    turns = np.linalg.qr(rng.normal(size=(2, n_frames, n, 3, 3)))[0]
    places = rng.normal(size=(4, n_frames, n, 3))
    reactions = scso.JointReactionMap(
        joints=joints,
        children=tuple(f"{joint}_child" for joint in joints),
        parents=tuple(f"{joint}_parent" for joint in joints),
        body_weight=700.0,
        constant=rng.normal(0, 400, (n_frames, n, 6)),
        per_tendon_force=rng.normal(0, 0.5, (n_frames, n, 6, n_muscles)),
        per_control=rng.normal(0, 0.5, (n_frames, n, 6, len(trajectory.actuators))),
        child_rotations=turns[0],
        parent_rotations=turns[1],
        child_origins=places[0],
        parent_origins=places[1],
        child_centers=places[2],
        parent_centers=places[3],
    )
    return with_trajectory(problem, joint_reactions=reactions)


def with_stability(problem, level, q=5.0):
    """The problem with its stability rows at another level, or with rows if it has none."""
    rows = scso.JointStability(q=q, level=level, joints=("elbow",))
    return dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))


def stability_by_hand(problem, q=5.0):
    """Geometric stability (n_frames, 3, n_muscles) and external work (n_frames, 3) of straight paths.

    Potvin and Brown's printed sums about x, y and z of ground with the joint at the origin:
    S_z = F [(AxBx + AyBy - r²)/l + q r²/L] with r_z = (Bx Ay - By Ax)/l, less -Fy hy - Fx hx of a load.
    """
    points = problem.motion.trajectory.skeleton.path_points
    a, b = points[:, :, 0], points[:, :, 1]
    length = np.sqrt(((a - b) ** 2).sum(axis=-1))
    stiffness = np.zeros((len(points), 3, points.shape[1]))
    work = np.zeros((len(points), 3))
    load, at = (
        problem.motion.trajectory.skeleton.load_forces[:, 0],
        problem.motion.trajectory.skeleton.load_points[:, 0],
    )
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        arm = (b[..., i] * a[..., j] - b[..., j] * a[..., i]) / length
        product = a[..., i] * b[..., i] + a[..., j] * b[..., j]
        stiffness[:, axis] = (product - arm**2) / length + q * arm**2 / length
        # A force F at h: the torque about the axis changes with a turn by -(F_i h_i + F_j h_j).
        work[:, axis] = -(load[:, i] * at[:, i] + load[:, j] * at[:, j])
    return stiffness, work


def frame_arrays(problem, k):
    """One frame as plain arrays over x = (activations, controls): weights, equations, rows, bounds.

    Returns (weights, A, b, G, h, lower, upper) of: min sum w |x|^p, A x = b, G x >= h.
    """
    trajectory, muscles, actuators = (
        problem.motion.trajectory,
        problem.motion.muscles,
        problem.motion.actuators,
    )
    rigid = isinstance(problem.muscle_model, scso.RigidTendon)
    capacity = trajectory.active_force_capacity[k] if rigid else muscles.max_isometric_force
    a = np.hstack([trajectory.moment_arms[k] * capacity, trajectory.actuator_generalized_forces[k]])
    stability = [term for term in problem.constraints if isinstance(term, scso.JointStability)]
    g, h = np.zeros((0, a.shape[1])), np.zeros(0)
    for term in stability:
        stiffness, work = stability_by_hand(problem, term.stiffness_law.q)
        keep = ["xyz".index(axis) for axis in term.axes or "xyz"]
        g = np.zeros((len(keep), a.shape[1]))
        g[:, : muscles.n_muscles] = stiffness[k, keep] * capacity
        level = term.level
        wanted = [level[f"elbow_{u}"] if isinstance(level, dict) else level for u in term.axes or "xyz"]
        h = work[k, keep] + wanted
    lower = np.concatenate([muscles.min_activation, actuators.min_control])
    upper = np.concatenate([muscles.max_activation, actuators.max_control])
    weights = np.ones(a.shape[1])
    effort = problem.objectives[0]
    if effort.weights == "volume":
        size = muscles.max_isometric_force * muscles.optimal_fiber_length
        weights[: muscles.n_muscles] = size / size.mean()
    return weights, a, trajectory.generalized_forces[k], g, h, lower, upper


def solve_qp_frame(problem, k):
    """Optimum of one frame at exponent 2 by Clarabel, from plain arrays.

    Returns x = (activations, controls).
    """
    weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
    return solve_qp(np.diag(2 * weights), np.zeros(weights.size), a, b, g, h, lower, upper)


def solve_qp(hessian, gradient, a, b, g, h, lower, upper):
    """min x'Hx/2 + f'x with A x = b, G x >= h and bounds, by Clarabel on rows of unit length."""
    size, rows = np.linalg.norm(a, axis=1), np.linalg.norm(g, axis=1)
    low, high = np.isfinite(lower), np.isfinite(upper)
    eye = np.eye(len(lower))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    answer = clarabel.DefaultSolver(
        sp.csc_matrix(np.triu(hessian)),
        np.asarray(gradient, dtype=float),
        sp.csc_matrix(np.vstack([a / size[:, None], -g / rows[:, None], -eye[low], eye[high]])),
        np.concatenate([b / size, -h / rows, -lower[low], upper[high]]),
        [clarabel.ZeroConeT(len(b)), clarabel.NonnegativeConeT(len(h) + int(low.sum()) + int(high.sum()))],
        settings,
    ).solve()
    assert str(answer.status) in ("Solved", "AlmostSolved"), str(answer.status)
    return np.asarray(answer.x)


def solve_power_frame(problem, k, exponent):
    """Optimum of one frame at an exponent above 1 by Clarabel's power cones, from plain arrays.

    min sum w t with t >= |x/s|^p, the cone t^(1/p) 1^(1 - 1/p) >= |x/s|, where s is the min/max optimum:
    without it the powers of small activations vanish in Clarabel's tolerance.
    Returns x = (activations, controls).
    """
    weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
    size = np.abs(solve_lp_frame(problem, k, np.inf)[0]).max()
    n = weights.size
    eye, none = np.eye(n), np.zeros((n, n))
    low, high = np.isfinite(lower), np.isfinite(upper)
    cones_of_powers = np.zeros((3 * n, 2 * n))
    offsets = np.zeros(3 * n)
    for i in range(n):
        cones_of_powers[3 * i, n + i] = -1.0
        offsets[3 * i + 1] = 1.0
        cones_of_powers[3 * i + 2, i] = -1.0 / size
    matrix = np.vstack(
        [
            np.hstack([a, np.zeros((len(b), n))]),
            np.hstack([-g, np.zeros((len(h), n))]),
            np.hstack([-eye, none])[low],
            np.hstack([eye, none])[high],
            cones_of_powers,
        ]
    )
    right = np.concatenate([b, -h, -lower[low], upper[high], offsets])
    cones = [
        clarabel.ZeroConeT(len(b)),
        clarabel.NonnegativeConeT(len(h) + int(low.sum()) + int(high.sum())),
        *[clarabel.PowerConeT(1 / exponent) for _ in range(n)],
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    solver = clarabel.DefaultSolver(
        sp.csc_matrix((2 * n, 2 * n)),
        np.concatenate([np.zeros(n), weights]),
        sp.csc_matrix(matrix),
        right,
        cones,
        settings,
    )
    answer = solver.solve()
    assert str(answer.status) in ("Solved", "AlmostSolved"), str(answer.status)
    return np.asarray(answer.x)[:n]


def solve_lp_frame(problem, k, exponent):
    """Optimum of one frame at exponent 1 or infinity by HiGHS, |x| and the largest in epigraph form.

    Returns (x, objective); the objective is unique, x need not be.
    """
    weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
    n = weights.size
    extra = n if exponent == 1 else 1
    size = np.diag(weights)
    above = -np.eye(n) if exponent == 1 else -np.ones((n, 1))
    result = linprog(
        np.concatenate([np.zeros(n), np.ones(extra)]),
        A_ub=np.vstack(
            [np.hstack([size, above]), np.hstack([-size, above]), np.hstack([-g, np.zeros((len(h), extra))])]
        ),
        b_ub=np.concatenate([np.zeros(2 * n), -h]),
        A_eq=np.hstack([a, np.zeros((len(b), extra))]),
        b_eq=b,
        bounds=[*zip(lower, upper, strict=True), *[(0.0, None)] * extra],
        method="highs",
    )
    assert result.success, result.message
    return result.x[:n], float(result.fun)


def unknowns(solution, k):
    """x = (activations, controls) of one frame."""
    return np.concatenate([solution.activation[k], solution.control[k]])


def central_difference(function, x, step):
    """Derivative of a function of an array by central differences, one column per entry of x."""
    columns = []
    for i in range(x.size):
        ahead, back = x.copy(), x.copy()
        ahead[i] += step
        back[i] -= step
        columns.append((np.asarray(function(ahead)) - np.asarray(function(back))) / (2 * step))
    return np.stack(columns, axis=-1)


def evaluate_terms(problem, activation, control=None, variables=None):
    """Values of all terms at given activations and controls, frames first, without solving.

    Returns (objective values per frame by name, row values by name, tendon forces).
    """
    program = describe(problem)
    n_frames = problem.motion.trajectory.n_frames
    parts = {("problem", "activation"): np.asarray(activation, dtype=float)}
    if control is not None:
        parts["problem", "control"] = np.asarray(control, dtype=float)
    parts |= variables or {}
    x = program.layout.join(parts, program.layout.rows("guess", n_frames)) / program.layout.scale

    def of(piece):
        return evaluate(piece, piece.function(), x, program.arrays)[0]

    costs = {name: of(piece)[:, 0] for name, piece in program.objectives}
    rows = {block.term: of(block.piece) for block in (*program.rows.blocks, *program.pair_rows.blocks)}
    return costs, rows, of(program.tendon_force)
