"""Rigid rotations about joint axes that the model's own coordinates may not allow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import opensim as osim

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.opensim.worker.bodies import cross_matrices, rotation
from scso_nlp.opensim.worker.coordinates import state_variables
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.paths import PathForces, crosses
from scso_nlp.opensim.worker.sliding import TurnedPaths, sliding_curvature
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

    def turned(self, frames: PosedPaths) -> TurnedPaths:
        """Return the paths that cross."""
        return TurnedPaths(
            points=frames.points[:, self.crossing],
            acting=frames.acting[:, self.crossing],
            bodies=frames.bodies[:, self.crossing],
            surfaces=frames.surfaces[:, self.crossing],
            rotations=frames.rotations,
            origins=frames.origins,
            centers=frames.centers[:, self.joint],
            is_distal=self.is_distal,
        )


@dataclass(frozen=True, kw_only=True)
class PosedPaths:
    """Paths, joints and bodies in some frames: what virtual rotations are computed from."""

    time: FloatArray  # (n_frames,) [s]
    values: FloatArray  # (n_frames, n_u) [rad or m], of the coordinates
    rotations: FloatArray  # (n_frames, n_bodies, 3, 3) [-], columns are the bodies' axes
    origins: FloatArray  # (n_frames, n_bodies, 3) [m]
    centers: FloatArray  # (n_frames, n_joints, 3) [m]
    axes: FloatArray  # (n_frames, n_joints, 3, 3) [-], unit axes x, y, z
    points: FloatArray  # (n_frames, n_muscles, n_points, 3) [m], in ground
    acting: FloatArray  # (n_frames, n_muscles, n_points, 3) [m], in ground, where OpenSim's forces act
    bodies: IntArray  # (n_frames, n_muscles, n_points), which each is fixed to or lies on, -1 for none
    surfaces: IntArray  # (n_frames, n_muscles, n_points), which contact points lie on, else -1


class VirtualRotations:
    """Turns everything distal of a joint rigidly about one of its axes, other coordinates held.

    Points of a path stay where they are on their bodies, but for contact points on wrap surfaces. Moment arms
    follow from the points alone: OpenSim's forces act along the segments. So does curvature where no contact
    point is an end of a segment that crosses the joint, and on cylinders, where OpenSim's rule for contact
    points is differentiated (:mod:`scso_nlp.opensim.worker.wrapping`) if it gives the points that OpenSim
    has. For other surfaces, and where the rule went another way, OpenSim's moment arms are asked on both
    sides: in a copy of the model a massless body with six free coordinates stands between each such joint and
    the body it hangs on. At zero the model is as before; a finite rotation about any axis through any point
    is a rotation and a translation of that body. Joints that no wrapping muscle has in common turn at once.
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
        self._at_once = _apart(self._turned)
        #: made when it is asked for the first time
        self._copy: _TurningCopy | None = None

    def at(self, frames: PosedPaths) -> dict[str, FloatArray]:
        """Return virtual moment arms and curvature, both of shape (n_frames, n_rows, n_muscles) [m]."""
        surfaces = self._original.current_paths.surfaces
        shape = (len(frames.time), len(self.names), len(self._original.paths))
        arms, curvature = np.full(shape, np.nan), np.full(shape, np.nan)
        unknown = np.zeros((len(self._crossings), shape[0], shape[2]), dtype=bool)
        for c, crossing in enumerate(self._crossings):
            own = list(crossing.rows.values())
            for row in own:
                arms[:, row, crossing.beside] = curvature[:, row, crossing.beside] = 0.0
            directions = frames.axes[:, crossing.joint, list(crossing.rows)]
            paths = crossing.turned(frames)
            sliding, is_known = sliding_curvature(paths, surfaces, directions)
            unknown[c][:, crossing.crossing] = ~is_known
            place = slice(None), np.array(own)[:, None], crossing.crossing
            arms[place] = turned_moment_arms(paths, directions)
            curvature[place] = _staying_curvature(paths, directions) + sliding
        joints = [crossing.joint for crossing in self._crossings]
        for f in np.flatnonzero(unknown.any(axis=(0, 2))).tolist():
            asked = {joint: np.flatnonzero(unknown[c, f]).tolist() for c, joint in enumerate(joints)}
            self._ask(frames, f, asked, curvature[f])
        return {"virtual_moment_arms": arms, "virtual_curvature": curvature}

    def _ask(self, frames: PosedPaths, f: int, muscles: dict[int, list[int]], curvature: FloatArray) -> None:
        """Fill in the curvature of muscles in a frame by central differences of OpenSim's moment arms."""
        if self._copy is None:
            self._copy = _TurningCopy(self._original, [crossing.joint for crossing in self._turned])
        self._copy.take(frames, f)
        for group in self._at_once:
            for axis in range(3):
                turned = {c.joint: c.rows[axis] for c in group if axis in c.rows and muscles[c.joint]}
                if not turned:
                    continue
                before, after = (
                    self._copy.arms(turned, axis, angle, muscles) for angle in (-VIRTUAL_STEP, VIRTUAL_STEP)
                )
                for joint, row in turned.items():
                    change = after[joint] - before[joint]
                    curvature[row, muscles[joint]] = -change / (2.0 * VIRTUAL_STEP)


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

    def take(self, frames: PosedPaths, f: int) -> None:
        """Take the pose of a frame."""
        self._state.setTime(float(frames.time[f]))
        is_locked = self._original.coordinates.is_locked
        for k, coordinate in enumerate(self._coordinates):
            if not is_locked[k]:
                coordinate.setValue(self._state, float(frames.values[f, k]), False)
        self._q = np.array(self._state.getQ().to_numpy())
        #: per joint: its center and axes in the body it hangs on
        self._frames = {}
        for j in self._free:
            inboard = self._original.joints.inboard[j]
            to_inboard = frames.rotations[f, inboard].T
            center = to_inboard @ (frames.centers[f, j] - frames.origins[f, inboard])
            self._frames[j] = center, frames.axes[f, j] @ to_inboard.T
            self._q[self._free[j][0]] = 0.0

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


def turned_moment_arms(paths: TurnedPaths, axes: FloatArray) -> FloatArray:
    """Return moment arms of paths about unit axes, (n_frames, n, 3): shape (n_frames, n, n_paths) [m].

    With e from one point to the next, on another body, and x from the joint's center to where forces act:
    r = Σ u · e x (x_b - x_a), each x only if its body turns.
    """
    turns = paths.is_distal[paths.bodies] & (paths.bodies >= 0)
    acting = np.where(turns[..., None], paths.acting - paths.centers[:, None, None], 0.0)
    segments = np.diff(paths.points, axis=2)
    is_between = (paths.bodies[..., 1:] != paths.bodies[..., :-1]) & (paths.bodies[..., 1:] >= 0)
    length = np.sqrt((segments**2).sum(axis=-1))
    # as in OpenSim, a segment without length has no direction
    with np.errstate(invalid="ignore", divide="ignore"):
        torques = np.cross(segments, np.diff(acting, axis=2)) / length[..., None]
    sums = np.where(is_between[..., None], torques, 0.0).sum(axis=2)
    return axes @ np.swapaxes(sums, 1, 2)


def _staying_curvature(paths: TurnedPaths, axes: FloatArray) -> FloatArray:
    """Return what segments without contact points add to curvature, (n_frames, n, n_paths) [m].

    With A on the proximal and B on the distal side, in a segment of length l: r = u · (B x A) / l and
    l'' = (A · B - (A · u) (B · u) - r²) / l.
    """
    turns, touches = paths.is_distal[paths.bodies], paths.surfaces >= 0
    counts = (turns[..., 1:] != turns[..., :-1]) & (paths.bodies[..., 1:] >= 0)
    counts &= ~(touches[..., 1:] | touches[..., :-1])
    f, m, p = np.nonzero(counts)
    a, b = paths.points[f, m, p] - paths.centers[f], paths.points[f, m, p + 1] - paths.centers[f]
    length, u = np.sqrt(((b - a) ** 2).sum(axis=1))[:, None], axes[f]
    r, along = (u @ np.cross(b, a)[..., None])[..., 0], (u @ a[..., None] * (u @ b[..., None]))[..., 0]
    curvature = np.zeros((len(axes), paths.points.shape[1], axes.shape[1]))
    with np.errstate(invalid="ignore", divide="ignore"):
        np.add.at(curvature, (f, m), ((a * b).sum(axis=1)[:, None] - along - (r / length) ** 2) / length)
    return np.swapaxes(curvature, 1, 2)


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
        (crossing if crosses(path.geometry, model.bodies, distal) else beside).append(m)
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
