"""Small problems made by hand, with known answers."""

from __future__ import annotations

import numpy as np

import scso_nlp as scso


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
        trajectory=trajectory,
        muscles=muscle_parameters(trajectory.muscles, [1450.0, 1200.0, 1000.0]),
        actuators=actuators,
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
    """Symmetric pair about one axis: r = ±0.05 m, A·B = 0, l = L = 0.2 m, EW = 30 N·m/rad."""
    # Right-angled triangle from the joint: |A||B| = r l, A·B = 0, |A|² + |B|² = l².
    r, length = 0.05, 0.2
    total = np.sqrt(length**2 + 2 * r * length)  # |A| + |B|
    gap = np.sqrt(length**2 - 2 * r * length)  # |A| - |B|
    a, b = (total + gap) / 2, (total - gap) / 2
    right = [[0.0, a, 0.0], [b, 0.0, 0.0]]
    left = [[0.0, a, 0.0], [-b, 0.0, 0.0]]
    geometry = skeleton(
        [right, left], [[0, 1], [0, 1]], load=(0.0, -100.0, 0.0), load_point=(0.0, external_work / 100.0, 0.0)
    )
    trajectory = motion([[[r, -r]]], [[moment]], skeleton=geometry, length=length)
    return scso.MuscleForceProblem(
        trajectory=trajectory,
        muscles=muscle_parameters(trajectory.muscles, strength),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=exponent),),
        constraints=(
            scso.MomentEquilibrium(),
            scso.JointStability(q=q, level=level, joints=("elbow",), axes=("z",)),
        ),
    )
