"""Random skeletons and turns of their joints, written without the package's own formulas."""

from types import SimpleNamespace

import numpy as np
import pytest

from scso_nlp.trajectory import MotionTrajectory, Skeleton


def rotation(axis, angle):
    """Rodrigues: the matrix of a turn by `angle` about the unit `axis`."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def random_orthonormal(rng):
    matrix, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return matrix


def path_length(points, bodies):
    """Length of every path; points (n_frames, n_muscles, n_points, 3), padded where body is -1."""
    steps = np.linalg.norm(np.diff(points, axis=2), axis=-1)
    present = (bodies[..., 1:] >= 0) & (bodies[..., :-1] >= 0)
    return np.where(present, steps, 0.0).sum(axis=-1)


def trajectory_of(skeleton):
    """The least trajectory that carries a skeleton."""
    n_frames, n_muscles = skeleton.path_point_bodies.shape[:2]
    return MotionTrajectory(
        name="random",
        muscles=tuple(f"muscle_{m}" for m in range(n_muscles)),
        coordinates=("angle",),
        is_rotational=np.array([True]),
        time=np.arange(n_frames, dtype=float),
        coordinate_values=np.zeros((n_frames, 1)),
        coordinate_speeds=np.zeros((n_frames, 1)),
        muscle_tendon_length=path_length(skeleton.path_points, skeleton.path_point_bodies),
        muscle_tendon_velocity=np.zeros((n_frames, n_muscles)),
        moment_arms=np.zeros((n_frames, 1, n_muscles)),
        actuator_generalized_forces=np.zeros((n_frames, 1, 0)),
        generalized_forces=np.zeros((n_frames, 1)),
        passive_generalized_forces=np.zeros((n_frames, 1)),
        active_force_capacity=np.ones((n_frames, n_muscles)),
        other_forces=np.zeros((n_frames, 0)),
        skeleton=skeleton,
    )


def random_skeleton(rng, n_muscles, n_frames=1, n_points=5, n_loads=4):
    """Six bodies in a branching tree, every joint with its own orthonormal axes.

    Paths have 2 to `n_points` points on bodies drawn at random, so that they cross joints once, several
    times, or not at all. Steps are at least 5 cm: finite differences of shorter ones are too coarse.
    """
    parents = np.array([-1, 0, 1, 2, 2, 4])
    n_bodies, n_joints = len(parents), 5
    points = rng.uniform(-0.4, 0.4, (n_frames, n_muscles, n_points, 3))
    for point in range(1, n_points):
        step = points[:, :, point] - points[:, :, point - 1]
        size = np.linalg.norm(step, axis=-1, keepdims=True)
        points[:, :, point] += np.where(size < 0.05, step / size * 0.05, 0.0)
    bodies = rng.integers(0, n_bodies, (n_muscles, n_points))
    counts = rng.integers(2, n_points + 1, n_muscles)
    bodies[np.arange(n_points) >= counts[:, None]] = -1
    bodies = np.broadcast_to(bodies, (n_frames, n_muscles, n_points))
    return Skeleton(
        bodies=("ground", "pelvis", "lumbar", "thorax", "femur", "tibia"),
        body_parents=parents,
        body_masses=np.r_[0.0, rng.uniform(1, 20, n_bodies - 1)],
        body_mass_centers=rng.uniform(-0.5, 0.5, (n_frames, n_bodies, 3)),
        gravity=rng.normal(scale=6.0, size=3),
        joints=("root", "lower", "upper", "hip", "knee"),
        joint_children=np.arange(1, n_bodies),
        joint_centers=rng.uniform(-0.3, 0.3, (n_frames, n_joints, 3)),
        joint_axes=np.array([[random_orthonormal(rng) for _ in range(n_joints)] for _ in range(n_frames)]),
        load_names=tuple(f"load_{i}" for i in range(n_loads)),
        load_bodies=rng.integers(0, n_bodies, n_loads),
        load_forces=rng.normal(scale=100.0, size=(n_frames, n_loads, 3)),
        load_points=rng.uniform(-0.5, 0.5, (n_frames, n_loads, 3)),
        load_torques=rng.normal(scale=20.0, size=(n_frames, n_loads, 3)),
        path_points=np.where(bodies[..., None] >= 0, points, 0.0),
        path_point_bodies=bodies,
        path_point_moves=np.zeros((n_frames, n_muscles, n_points), dtype=bool),
    )


#: Bodies that turn with each joint of `random_skeleton`, read off its tree by hand.
DISTAL = {
    "root": (1, 2, 3, 4, 5),
    "lower": (2, 3, 4, 5),
    "upper": (3,),
    "hip": (4, 5),
    "knee": (5,),
}


def turned(skeleton, frame, joint, axis, angle):
    """Path points, mass centers and load points of one frame after the distal side has turned."""
    index = skeleton.joints.index(joint)
    center, u = skeleton.joint_centers[frame, index], skeleton.joint_axes[frame, index, axis]
    matrix = rotation(u, angle)

    def turn(points, bodies):
        moved = np.isin(bodies, DISTAL[joint])[..., None]
        return np.where(moved, center + (points - center) @ matrix.T, points)

    return (
        turn(skeleton.path_points[frame], skeleton.path_point_bodies[frame]),
        turn(skeleton.body_mass_centers[frame], np.arange(len(skeleton.bodies))),
        turn(skeleton.load_points[frame], skeleton.load_bodies),
    )


#: Step of finite differences [rad]: truncation and round-off both below 1e-7 for these sizes.
STEP = 1e-3


def first_difference(function):
    """Five-point first derivative at zero."""
    values = [function(k * STEP) for k in (-2, -1, 1, 2)]
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * STEP)


def second_difference(function):
    """Five-point second derivative at zero."""
    values = [function(k * STEP) for k in (-2, -1, 0, 1, 2)]
    weights = (-1.0, 16.0, -30.0, 16.0, -1.0)
    return sum(w * v for w, v in zip(weights, values, strict=True)) / (12 * STEP**2)


@pytest.fixture
def turning():
    """The functions of this file, for tests to call."""
    return SimpleNamespace(
        rotation=rotation,
        path_length=path_length,
        trajectory_of=trajectory_of,
        random_skeleton=random_skeleton,
        turned=turned,
        first_difference=first_difference,
        second_difference=second_difference,
    )


@pytest.fixture
def one_muscle():
    """Build a trajectory with one joint at the origin, ground's axes and one path; body 1 turns."""

    def build(points, bodies=None, moves=None, n_frames=1, **changes):
        points = np.asarray(points, dtype=float)
        bodies = [0] * (len(points) - 1) + [1] if bodies is None else bodies
        moves = [False] * len(points) if moves is None else moves
        values = {
            "bodies": ("ground", "trunk"),
            "body_parents": [-1, 0],
            "body_masses": [0.0, 0.0],
            "body_mass_centers": np.zeros((n_frames, 2, 3)),
            "gravity": [0.0, -9.81, 0.0],
            "joints": ("waist",),
            "joint_children": [1],
            "joint_centers": np.zeros((n_frames, 1, 3)),
            "joint_axes": np.broadcast_to(np.eye(3), (n_frames, 1, 3, 3)),
            "load_names": (),
            "load_bodies": [],
            "load_forces": np.zeros((n_frames, 0, 3)),
            "load_points": np.zeros((n_frames, 0, 3)),
            "load_torques": np.zeros((n_frames, 0, 3)),
            "path_points": np.broadcast_to(points, (n_frames, 1, len(points), 3)),
            "path_point_bodies": np.broadcast_to(bodies, (n_frames, 1, len(points))),
            "path_point_moves": np.broadcast_to(moves, (n_frames, 1, len(points))),
        }
        return trajectory_of(Skeleton(**(values | changes)))

    return build
