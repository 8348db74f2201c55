"""Chains of hinges with straight muscle paths: everything about them by automatic differentiation."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
from helpers import motion, muscle_parameters

import scso_nlp as scso
from scso_nlp.trajectory import CoordinateCurvature


def rotation(axis, angle):
    """Rotation matrix about a unit axis, after Rodrigues."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + ca.sin(angle) * cross + (1 - ca.cos(angle)) * cross @ cross


def hinge_chain(rng, *, n_hinges=2, n_muscles=8, n_frames=3, level=0.0):
    """A problem with random hinges one on the other, weights, a load at the end and random straight paths.

    Its curvature, moment arms and load stiffness are derivatives of lengths and of potential energy; its
    skeleton holds the points, axes and weights in ground. Rows of hinge j are about ``"joint<j>_x"``.
    """
    q = ca.SX.sym("q", n_hinges)
    axes = rng.normal(size=(n_hinges, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    offsets = rng.normal([0.0, 0.2, 0.0], 0.03, (n_hinges, 3))
    turns, centers = [ca.SX.eye(3)], [ca.SX.zeros(3, 1)]
    joint_axes = []
    for j in range(n_hinges):
        centers.append(centers[-1] + turns[-1] @ offsets[j])
        joint_axes.append(turns[-1] @ axes[j])
        turns.append(turns[-1] @ rotation(axes[j], q[j]))
    bodies = np.sort(np.stack([rng.permutation(n_hinges + 1)[:2] for _ in range(n_muscles)]), axis=1)
    local = rng.normal(0, 0.06, (n_muscles, 2, 3))
    points = [
        [centers[b] + turns[b] @ p for b, p in zip(*row, strict=True)]
        for row in zip(bodies, local, strict=True)
    ]
    lengths = ca.vertcat(*[ca.norm_2(first - second) for first, second in points])
    masses = rng.uniform(2.0, 10.0, n_hinges)
    middles = [centers[j + 1] + turns[j + 1] @ rng.normal([0, 0.1, 0], 0.02) for j in range(n_hinges)]
    grip = centers[-1] + turns[-1] @ rng.normal([0.05, 0.2, 0], 0.02)
    load, gravity = rng.normal([0, -60.0, 0], 20.0), np.array([0.0, -9.81, 0.0])
    energy = -ca.dot(load, grip) - sum(m * ca.dot(gravity, c) for m, c in zip(masses, middles, strict=True))
    values = rng.normal(0, 0.3, (n_frames, n_hinges))

    def at_frames(*expressions):
        function = ca.Function("f", [q], [ca.densify(e) for e in expressions])
        answers = [function(value) for value in values]
        columns = zip(*(a if isinstance(a, tuple) else (a,) for a in answers), strict=True)
        return [np.array([np.asarray(entry) for entry in column]) for column in columns]

    arms, length, load_stiffness = at_frames(-ca.jacobian(lengths, q), lengths, ca.hessian(energy, q)[0])
    curvature = np.stack([at_frames(ca.hessian(lengths[m], q)[0])[0] for m in range(n_muscles)], axis=-1)
    ground_points = at_frames(*[ca.horzcat(*pair).T for pair in points])
    places = at_frames(*[p.T for p in (*centers[1:], *joint_axes, *middles, grip)])
    places = [place[:, 0] for place in places]
    first_axes = places[n_hinges : 2 * n_hinges]
    frames_of_axes = np.stack([_frames_with_x(axis) for axis in first_axes], axis=1)
    skeleton = scso.Skeleton(
        bodies=("ground", *(f"body{j}" for j in range(n_hinges))),
        body_parents=[-1, *range(n_hinges)],
        body_masses=[0.0, *masses],
        body_mass_centers=np.stack([np.zeros((n_frames, 3)), *places[2 * n_hinges : 3 * n_hinges]], axis=1),
        gravity=gravity,
        joints=tuple(f"joint{j}" for j in range(n_hinges)),
        joint_children=np.arange(1, n_hinges + 1),
        joint_centers=np.stack(places[:n_hinges], axis=1),
        joint_axes=frames_of_axes,
        load_names=("load",),
        load_bodies=[n_hinges],
        load_forces=np.broadcast_to(load, (n_frames, 1, 3)),
        load_points=places[-1][:, None],
        load_torques=np.zeros((n_frames, 1, 3)),
        path_points=np.stack(ground_points, axis=1),
        path_point_bodies=np.broadcast_to(bodies, (n_frames, n_muscles, 2)),
        path_point_moves=np.zeros((n_frames, n_muscles, 2), dtype=bool),
    )
    moment_arms = arms.transpose(0, 2, 1)
    strength = rng.uniform(500, 1500, n_muscles)
    inside = strength * rng.uniform(0.1, 0.5, (n_frames, n_muscles))
    trajectory = motion(
        moment_arms,
        np.einsum("kcm,km->kc", moment_arms, inside),
        skeleton=skeleton,
        length=length[:, :, 0],
    )
    trajectory = dataclasses.replace(
        trajectory,
        curvature=CoordinateCurvature(
            coordinates=trajectory.coordinates,
            path_curvature=curvature,
            load_stiffness=load_stiffness,
            passive_stiffness=np.zeros_like(load_stiffness),
            asymmetry=np.zeros((n_frames, n_muscles)),
            is_uncertain=np.zeros((n_frames, n_muscles), dtype=bool),
        ),
    )
    return scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscle_parameters(trajectory.muscles, strength)),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(),),
    )


def _frames_with_x(axis):
    """Right-handed axes (n_frames, 3, 3) whose x is the given one."""
    other = np.cross(axis, [0.3, 0.5, 0.8])
    other /= np.linalg.norm(other, axis=1)[:, None]
    return np.stack([axis, other, np.cross(axis, other)], axis=1)
