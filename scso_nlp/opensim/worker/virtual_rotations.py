"""Rigid rotations about joint axes that the model's own coordinates may not allow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import opensim as osim
from numpy.typing import NDArray

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.opensim.worker.bodies import cross_matrices, rotation
from scso_nlp.opensim.worker.coordinates import state_variables
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.paths import PathForces, path_bodies
from scso_nlp.opensim.worker.poses import Pose
from scso_nlp.opensim.worker.skeleton import JointFrames
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Half step of the virtual rotations [rad]: rounding and truncation errors meet near it.
VIRTUAL_STEP = 1e-4


@dataclass(frozen=True, kw_only=True)
class _Crossing:
    """A joint with axes asked for, and the muscles whose paths may change their points."""

    joint: int
    is_distal: BoolArray  # (n_bodies,), the bodies that turn
    rows: dict[int, int]  # of the arrays, by axis: 0, 1, 2 for x, y, z
    crossing: IntArray  # muscles with points on both sides of the joint
    beside: IntArray  # and on one
    wrapping: set[int]  # those that cross and may wrap


class VirtualRotations:
    """Turns everything distal of a joint rigidly about one of its axes, other coordinates held.

    Points of a path stay where they are on their bodies, but for contact points on wrap surfaces: unless one
    is an end of a segment that crosses the joint, moment arms and curvature are known in closed form. Of
    these OpenSim is asked: in a copy of the model a massless body with six free coordinates stands between
    each such joint and the body it hangs on. At zero the model is as before; a finite rotation about any axis
    through any point is a rotation and a translation of that body. Joints that no wrapping muscle has in
    common turn at once.
    """

    def __init__(self, model: Model, axes: list[tuple[str, str]]) -> None:
        joints = model.joints.names
        wanted = _wanted(axes, joints)
        for name, _ in wanted:
            if name not in joints:
                raise NameMismatchError(
                    f"unknown joint {name!r} in stability_axes (joints that can move: {', '.join(joints)})"
                )
        self.names = [f"{joint}_{axis}" for joint, axis in wanted]
        self._original = model
        rows: dict[int, dict[int, int]] = {}
        for row, (name, axis) in enumerate(wanted):
            rows.setdefault(joints.index(name), {})["xyz".index(axis)] = row
        self._crossings = [_crossing(model, joint, own) for joint, own in sorted(rows.items())]
        self._turned = [crossing for crossing in self._crossings if crossing.wrapping]
        chosen = [crossing.joint for crossing in self._turned]
        self._copy = _TurningCopy(model, chosen) if chosen else None
        self._at_once = _apart(self._turned)

    def at(
        self, pose: Pose, joints: JointFrames, path_points: Mapping[str, NDArray[Any]]
    ) -> dict[str, FloatArray]:
        """Return virtual moment arms and curvature in a pose, both of shape (n_rows, n_muscles) [m].

        `path_points` are those of the pose, as `path_arrays` has them.
        """
        shape = (len(self.names), len(self._original.paths))
        arms, curvature = np.full(shape, np.nan), np.full(shape, np.nan)
        sliding = {}
        for crossing in self._crossings:
            for row in crossing.rows.values():
                arms[row, crossing.beside] = curvature[row, crossing.beside] = 0.0
            segments = _segments(crossing, joints.centers[crossing.joint], path_points)
            own_arms, own_curvature = segments.derivatives(joints.axes[crossing.joint])
            for axis, row in crossing.rows.items():
                arms[row, crossing.crossing] = own_arms[:, axis]
                curvature[row, crossing.crossing] = own_curvature[:, axis]
            slides = crossing.crossing[segments.slides].tolist()
            sliding[crossing.joint] = [m for m in slides if m in crossing.wrapping]
        if self._copy is not None and any(sliding.values()):
            self._copy.take(pose, joints)
            for crossing, at_zero in zip(self._turned, self._copy.arms_at_zero(sliding), strict=True):
                for axis, row in crossing.rows.items():
                    arms[row, sliding[crossing.joint]] = at_zero[axis]
            for group in self._at_once:
                self._ask(group, sliding, curvature)
        return {"virtual_moment_arms": arms, "virtual_curvature": curvature}

    def _ask(self, group: list[_Crossing], sliding: dict[int, list[int]], curvature: FloatArray) -> None:
        """Fill in the curvature of sliding muscles by central differences of OpenSim's moment arms."""
        assert self._copy is not None
        for axis in range(3):
            turned = {c.joint: c.rows[axis] for c in group if axis in c.rows and sliding[c.joint]}
            if not turned:
                continue
            before, after = (
                self._copy.arms(turned, axis, angle, sliding) for angle in (-VIRTUAL_STEP, VIRTUAL_STEP)
            )
            for joint, row in turned.items():
                curvature[row, sliding[joint]] = -(after[joint] - before[joint]) / (2.0 * VIRTUAL_STEP)


class _TurningCopy:
    """A copy of the model in which joints have six more coordinates."""

    def __init__(self, model: Model, joints: list[int]) -> None:
        assert model.spare is not None
        self._original = model
        self._model: osim.Model = model.spare
        self._model.finalizeConnections()
        for j in joints:
            _insert_free_body(self._model, model, j)
        self._state = self._model.initSystem()
        self._model.setAllControllersEnabled(False)
        self._coordinates = [
            osim.Coordinate.safeDownCast(self._model.getComponent(coordinate.getAbsolutePathString()))
            for coordinate in model.coordinates.items
        ]
        mobilities = [path.removesuffix("/value") for path in state_variables(self._model)]
        #: per joint: where the six coordinates of the body before it stand in Q, and the first one in U
        self._free: dict[int, tuple[list[int], int]] = {}
        for j in joints:
            joint = self._model.getJointSet().get(f"scso_virtual_joint_{j}")
            free = [joint.get_coordinates(i) for i in range(6)]
            places = [_place(self._state, coordinate) for coordinate in free]
            self._free[j] = places, mobilities.index(free[0].getAbsolutePathString())
        self._model.realizePosition(self._state)
        paths = [
            osim.Muscle.safeDownCast(self._model.getComponent(muscle.getAbsolutePathString())).getPath()
            for muscle in model.forces.muscles
        ]
        # moving points push their coordinate, never the free body
        self._path_forces = PathForces(self._model, self._state, paths, [False] * len(paths))

    def take(self, pose: Pose, joints: JointFrames) -> None:
        """Take a pose of the original."""
        self._state.setTime(pose.time)
        is_locked = self._original.coordinates.is_locked
        for k, coordinate in enumerate(self._coordinates):
            if not is_locked[k]:
                coordinate.setValue(self._state, float(pose.values[k]), False)
        self._q = np.array(self._state.getQ().to_numpy())
        #: per joint: its center and axes in the body it hangs on
        self._frames = {}
        for j in self._free:
            inboard = self._original.joints.inboard[j]
            to_inboard = pose.rotations[inboard].T
            center = to_inboard @ (joints.centers[j] - pose.origins[inboard])
            self._frames[j] = center, joints.axes[j] @ to_inboard.T
            self._q[self._free[j][0]] = 0.0

    def arms_at_zero(self, muscles: Mapping[int, list[int]]) -> list[FloatArray]:
        """Return the moment arms of each joint's muscles about its axes, shapes (3, n_own) [m]."""
        self._put(self._q)
        every = sorted(set().union(*muscles.values()))
        generalized = self._path_forces.columns(self._state, every)
        arms = []
        for j, (_, first) in self._free.items():
            own = generalized[first : first + 6, np.searchsorted(every, muscles[j])]
            center, axes = self._frames[j]
            arms.append(axes @ (own[:3] - cross_matrices(center) @ own[3:]))
        return arms

    def arms(
        self, joints: Iterable[int], axis: int, angle: float, muscles: Mapping[int, list[int]]
    ) -> dict[int, FloatArray]:
        """Turn joints about one axis each by an angle [rad]: moment arms of their muscles, (n_own,) [m]."""
        q, shifts = self._q.copy(), {}
        for j in joints:
            center, axes = self._frames[j]
            turned = rotation(axes[[axis]], np.array([angle]))[0]
            shifts[j] = center - turned @ center
            # body-fixed x, y, z angles, the coordinates of a free joint
            angles = [
                math.atan2(-turned[1, 2], turned[2, 2]),
                math.asin(min(max(turned[0, 2], -1.0), 1.0)),
                math.atan2(-turned[0, 1], turned[0, 0]),
            ]
            q[self._free[j][0]] = [*angles, *shifts[j]]
        self._put(q)
        arms = {}
        for j, shift in shifts.items():
            center, axes = self._frames[j]
            first = self._free[j][1]
            generalized = self._path_forces.columns(self._state, muscles[j])[first : first + 6]
            arms[j] = axes[axis] @ (generalized[:3] + cross_matrices(shift - center) @ generalized[3:])
        return arms

    def _put(self, q: FloatArray) -> None:
        self._state.setQ(osim.Vector.createFromMat(q))
        self._model.realizePosition(self._state)


def _place(state: osim.State, coordinate: osim.Coordinate) -> int:
    """Find where a coordinate stands in Q."""
    before = np.array(state.getQ().to_numpy())
    coordinate.setValue(state, coordinate.getValue(state) + 1.0, False)
    (place,) = np.flatnonzero(state.getQ().to_numpy() != before).tolist()
    return int(place)


@dataclass(frozen=True, kw_only=True)
class _Segments:
    """The segments of some muscles' paths, and which of them cross a joint."""

    crosses: BoolArray  # (n_muscles, n_points - 1)
    proximal: FloatArray  # (n_muscles, n_points - 1, 3) [m], ends, from the joint's center
    distal: FloatArray  # (n_muscles, n_points - 1, 3) [m]
    slides: BoolArray  # (n_muscles,), an end is a contact point or a moving point

    def derivatives(self, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return moment arms and curvature about unit axes, shape (n, 3), both (n_muscles, n) [m].

        With A on the proximal and B on the distal side, in a segment of length l: r = u · (B x A) / l and
        l'' = (A · B - (A · u) (B · u) - r²) / l.
        """
        a, b = self.proximal, self.distal
        length = np.linalg.norm(b - a, axis=-1)[..., None]
        # as in OpenSim, a segment without length has no direction
        with np.errstate(invalid="ignore", divide="ignore"):
            r = np.cross(b, a) @ axes.T / length
            along = (a @ axes.T) * (b @ axes.T)
            curvature = ((a * b).sum(axis=-1, keepdims=True) - along - r**2) / length
        crosses = self.crosses[..., None]
        return np.where(crosses, r, 0.0).sum(axis=1), np.where(crosses, curvature, 0.0).sum(axis=1)


def _segments(crossing: _Crossing, center: FloatArray, path_points: Mapping[str, NDArray[Any]]) -> _Segments:
    chosen = crossing.crossing
    bodies, moves = path_points["path_point_bodies"][chosen], path_points["path_point_moves"][chosen]
    points = path_points["path_points"][chosen] - center
    turns, is_there = crossing.is_distal[bodies], bodies >= 0
    crosses = (turns[:, 1:] != turns[:, :-1]) & is_there[:, 1:]
    first_turns = turns[:, :-1, None]
    return _Segments(
        crosses=crosses,
        proximal=np.where(first_turns, points[:, 1:], points[:, :-1]),
        distal=np.where(first_turns, points[:, :-1], points[:, 1:]),
        slides=(crosses & (moves[:, 1:] | moves[:, :-1])).any(axis=1),
    )


def _wanted(axes: list[tuple[str, str]], joints: list[str]) -> list[tuple[str, str]]:
    """Return joints and axes without "all", each once."""
    each = (joints if name == "all" and name not in joints else [name] for name, _ in axes)
    pairs = ((joint, axis) for names, (_, axis) in zip(each, axes, strict=True) for joint in names)
    return list(dict.fromkeys(pairs))


def _crossing(model: Model, joint: int, rows: dict[int, int]) -> _Crossing:
    """Sort the muscles whose path may change by whether they have points on both sides of a joint.

    Fitted paths (FunctionBasedPath) have no points: for them nothing is known about a virtual rotation.
    """
    distal = model.bodies.distal(model.joints.outboard[joint])
    crossing: list[int] = []
    beside: list[int] = []
    for m, path in enumerate(model.paths):
        if path.geometry is None or not path.moves:
            continue
        sides = {body in distal for body in path_bodies(path.geometry, model.bodies)}
        (crossing if len(sides) == 2 else beside).append(m)
    return _Crossing(
        joint=joint,
        is_distal=np.isin(np.arange(len(model.bodies.names)), list(distal)),
        rows=rows,
        crossing=np.array(crossing, dtype=np.int64),
        beside=np.array(beside, dtype=np.int64),
        wrapping={m for m in crossing if model.paths[m].wraps},
    )


def _apart(crossings: list[_Crossing]) -> list[list[_Crossing]]:
    """Group joints so that no muscle that may wrap crosses two of a group."""
    groups: list[list[_Crossing]] = []
    for crossing in crossings:
        for group in groups:
            if not any(crossing.wrapping & other.wrapping for other in group):
                group.append(crossing)
                break
        else:
            groups.append([crossing])
    return groups


def _insert_free_body(copy: osim.Model, model: Model, j: int) -> None:
    """Put a massless body with six coordinates between joint j and its inboard body, in a model's copy."""
    joint = osim.Joint.safeDownCast(copy.getComponent(model.joints.paths[j]))
    frame = model.bodies.inboard_frame(joint)
    is_parent = frame.getAbsolutePathString() == joint.getParentFrame().getAbsolutePathString()
    base = osim.PhysicalFrame.safeDownCast(frame.findBaseFrame())
    offset = frame.findTransformInBaseFrame()
    body = osim.Body(f"scso_virtual_body_{j}", 0.0, osim.Vec3(0), osim.Inertia(0, 0, 0, 0, 0, 0))
    copy.addBody(body)
    copy.addJoint(osim.FreeJoint(f"scso_virtual_joint_{j}", base, body))
    inner = osim.PhysicalOffsetFrame(f"scso_virtual_frame_{j}", body, offset)
    copy.addComponent(inner)
    if is_parent:
        joint.connectSocket_parent_frame(inner)
    else:
        joint.connectSocket_child_frame(inner)
