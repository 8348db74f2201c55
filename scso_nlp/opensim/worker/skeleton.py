"""Joints and external loads of a model, and what they are in one pose, expressed in ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import opensim as osim

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.opensim.worker.bodies import Bodies, frame_offsets, rotation, unique_labels
from scso_nlp.validation import FloatArray

#: Which of a joint's successive axes may be called x, y and z.
ORDERS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


@dataclass(frozen=True, kw_only=True)
class JointFrames:
    """Joints in one pose."""

    centers: FloatArray  # (n_joints, 3) [m]
    axes: FloatArray  # (n_joints, 3, 3) [-]; axes[j, u] is the unit axis called x, y or z


class Joints:
    """The joints that can move, whatever set they stand in.

    Public are `names`, `paths` in the model, and the bodies on either side in the multibody tree: `inboard`
    on the side of ground, `outboard` on the other.
    """

    def __init__(self, model: osim.Model, state: osim.State, bodies: Bodies) -> None:
        joints = [joint for joint in model.getJointList() if joint.numCoordinates() > 0]
        self.names = unique_labels(joints)
        self.paths = [joint.getAbsolutePathString() for joint in joints]
        inner = [bodies.inboard_frame(joint) for joint in joints]
        outer = [bodies.outboard_frame(joint) for joint in joints]
        self.inboard = [bodies.of(frame) for frame in inner]
        self.outboard = [bodies.of(frame) for frame in outer]
        customs = [osim.CustomJoint.safeDownCast(joint) for joint in joints]
        self._turns = [None if custom is None else _rotational_axes(custom) for custom in customs]
        # successive axes in the joint's own parent frame, else those of the frame on the side of ground;
        # and which of them is called x, y, z
        axes = [np.eye(3) if turns is None else _directions(turns) for turns in self._turns]
        self._successive = np.array(axes).reshape(-1, 3, 3)
        named = [_named_axes(own) for own in axes]
        self._orders = np.array([order for order, _ in named], dtype=np.int64).reshape(-1, 3)
        self._signs = np.array([signs for _, signs in named]).reshape(-1, 3)
        first = [
            frame if turns is None else joint.getParentFrame()
            for joint, frame, turns in zip(joints, inner, self._turns, strict=True)
        ]
        self._axis_frames = frame_offsets(first, state, bodies)
        self._outer_frames = frame_offsets(outer, state, bodies)

    def at(self, state: osim.State, rotations: FloatArray, origins: FloatArray) -> JointFrames:
        """Return centers and axes in a pose, given the poses of the bodies."""
        owners, _, centers = self._outer_frames
        return JointFrames(
            centers=np.einsum("jab,jb->ja", rotations[owners], centers) + origins[owners],
            axes=self._axes(state, rotations),
        )

    def _axes(self, state: osim.State, rotations: FloatArray) -> FloatArray:
        owners, offsets, _ = self._axis_frames
        angles = np.zeros((len(self.names), 2))
        for j, turns in enumerate(self._turns):
            if turns is not None:
                angles[j] = [turn.getValue(state) for turn in turns[:2]]
        axes = self._successive
        first = rotation(axes[:, 0], angles[:, 0])
        second = first @ rotation(axes[:, 1], angles[:, 1])
        turned = np.stack(
            [
                axes[:, 0],
                np.einsum("jab,jb->ja", first, axes[:, 1]),
                np.einsum("jab,jb->ja", second, axes[:, 2]),
            ],
            axis=1,
        )
        named = np.take_along_axis(turned, self._orders[:, :, None], axis=1) * self._signs[:, :, None]
        return np.einsum("jab,jub->jua", rotations[owners] @ offsets, named)


@dataclass(frozen=True, kw_only=True)
class LoadVectors:
    """External loads in one pose."""

    forces: FloatArray  # (n_loads, 3) [N]
    points: FloatArray  # (n_loads, 3) [m]
    torques: FloatArray  # (n_loads, 3) [N·m]


class Loads:
    """The external loads: names, and the body that each acts on."""

    def __init__(self, model: osim.Model, loads: list[osim.ExternalForce], bodies: Bodies) -> None:
        self._loads = loads
        self.names = [load.getName() for load in loads]
        self._applied = [_physical_frame(model, load.getAppliedToBodyName()) for load in loads]
        self._expressed = [
            _physical_frame(model, load.getForceExpressedInBodyName() or "ground") for load in loads
        ]
        self._points = [
            _physical_frame(model, load.getPointExpressedInBodyName() or "ground")
            if load.specifiesPoint()
            else None
            for load in loads
        ]
        self.bodies = np.array([bodies.of(frame) for frame in self._applied], dtype=np.int64)

    def at(self, state: osim.State) -> LoadVectors:
        """Return forces, points and torques in a pose."""
        n_loads, time = len(self._loads), state.getTime()
        forces, points, torques = (np.zeros((n_loads, 3)) for _ in range(3))
        for i, load in enumerate(self._loads):
            if load.get_force_identifier().lower() not in ("", "unassigned"):
                force = load.getForceAtTime(time)
                forces[i] = self._expressed[i].expressVectorInGround(state, force).to_numpy()
            if load.appliesTorque():
                torque = load.getTorqueAtTime(time)
                torques[i] = self._expressed[i].expressVectorInGround(state, torque).to_numpy()
            frame = self._points[i]
            if frame is None:
                points[i] = self._applied[i].getPositionInGround(state).to_numpy()
            else:
                point = load.getPointAtTime(time)
                points[i] = frame.findStationLocationInGround(state, point).to_numpy()
        return LoadVectors(forces=forces, points=points, torques=torques)


def _rotational_axes(joint: osim.CustomJoint) -> list[osim.TransformAxis]:
    transform = joint.getSpatialTransform()
    return [transform.getTransformAxis(i) for i in range(3)]


def _directions(turns: list[osim.TransformAxis]) -> FloatArray:
    """Return unit axes, shape (3, 3), one per row."""
    axes = [turn.getAxis().to_numpy() for turn in turns]
    lengths = [float(np.linalg.norm(axis)) for axis in axes]
    return np.array(
        [axis / length if length > 0 else axis for axis, length in zip(axes, lengths, strict=True)]
    )


def _named_axes(axes: FloatArray) -> tuple[tuple[int, ...], FloatArray]:
    """Return which axis is called x, y, z, each by the letter it lies nearest to, and their signs, (3,)."""
    order = max(ORDERS, key=lambda order: sum(abs(axes[order[u], u]) for u in range(3)))
    return order, np.array([-1.0 if axes[order[u], u] < 0 else 1.0 for u in range(3)])


def _physical_frame(model: osim.Model, name: str) -> osim.PhysicalFrame:
    """Return the frame that a load names, by its path in the model or in the BodySet, as OpenSim finds it."""
    for path in (name, f"./bodyset/{name}"):
        frame = (
            osim.PhysicalFrame.safeDownCast(model.getComponent(path)) if model.hasComponent(path) else None
        )
        if frame is not None:
            return frame
    raise NameMismatchError(
        f"an external load names the body {name!r}, which the model does not have, expected ground, the name "
        "of a body in the BodySet or the path of a frame"
    )
