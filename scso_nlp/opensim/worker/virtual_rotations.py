"""Rigid rotations about joint axes that the model's own coordinates may not allow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import opensim as osim

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.opensim.worker.bodies import rotation
from scso_nlp.opensim.worker.coordinates import state_variables
from scso_nlp.opensim.worker.model import Model, load_model
from scso_nlp.opensim.worker.paths import PathForces, path_bodies
from scso_nlp.opensim.worker.poses import Pose
from scso_nlp.opensim.worker.skeleton import JointFrames
from scso_nlp.validation import FloatArray

#: Half step of the virtual rotations [rad]: rounding and truncation errors meet near it.
VIRTUAL_STEP = 1e-4


@dataclass(frozen=True, kw_only=True)
class _Row:
    """One joint axis asked for, and the muscles whose paths may change their points."""

    joint: int
    axis: int  # 0, 1, 2 for x, y, z
    crossing: list[int]  # muscles with points on both sides of the joint
    beside: list[int]  # and on one


class VirtualRotations:
    """Turns everything distal of a joint rigidly about one of its axes and asks OpenSim for the path forces.

    In a second copy of the model a massless body with six free coordinates stands between each joint asked
    for and the body it hangs on. At zero the model is as before; a finite rotation about any axis through any
    point is a rotation and a translation of that body.
    """

    def __init__(self, model: Model, settings: Mapping[str, Any]) -> None:
        joints = model.joints.names
        wanted = _wanted(settings["stability_axes"], joints)
        for name, _ in wanted:
            if name not in joints:
                raise NameMismatchError(
                    f"unknown joint {name!r} in stability_axes (joints that can move: {', '.join(joints)})"
                )
        self.names = [f"{joint}_{axis}" for joint, axis in wanted]
        self._original = model
        self._rows = [_row(model, joints.index(joint), "xyz".index(axis)) for joint, axis in wanted]
        chosen = sorted({row.joint for row in self._rows})
        self._model, self._tool = load_model(settings, external_loads=None)
        self._model.finalizeConnections()
        for j in chosen:
            _insert_free_body(self._model, model, j)
        self._state = self._model.initSystem()
        self._model.setAllControllersEnabled(False)
        self._model.realizePosition(self._state)
        self._coordinates = [
            osim.Coordinate.safeDownCast(self._model.getComponent(coordinate.getAbsolutePathString()))
            for coordinate in model.coordinates.items
        ]
        mobilities = [path.removesuffix("/value") for path in state_variables(self._model)]
        #: per joint: the six coordinates of the body before it, and the first one's mobility
        self._free: dict[int, tuple[list[osim.Coordinate], int]] = {}
        for j in chosen:
            joint = self._model.getJointSet().get(f"scso_virtual_joint_{j}")
            free = [joint.get_coordinates(i) for i in range(6)]
            self._free[j] = free, mobilities.index(free[0].getAbsolutePathString())
        paths = [
            osim.Muscle.safeDownCast(self._model.getComponent(muscle.getAbsolutePathString())).getPath()
            for muscle in model.forces.muscles
        ]
        # moving points push their coordinate, never the free body
        self._path_forces = PathForces(self._model, self._state, paths, [False] * len(paths))

    def at(self, pose: Pose, joints: JointFrames) -> dict[str, FloatArray]:
        """Return virtual moment arms and curvature in a pose, both of shape (n_rows, n_muscles) [m]."""
        shape = (len(self._rows), len(self._original.paths))
        arms, curvature = np.full(shape, np.nan), np.full(shape, np.nan)
        self._take(pose)
        for i, row in enumerate(self._rows):
            arms[i, row.beside] = curvature[i, row.beside] = 0.0
            if not row.crossing:
                continue
            inboard = self._original.joints.inboard[row.joint]
            to_inboard = pose.rotations[inboard].T
            center = to_inboard @ (joints.centers[row.joint] - pose.origins[inboard])
            axis = to_inboard @ joints.axes[row.joint, row.axis]
            before, arms[i, row.crossing], after = (
                self._arms(row, center, axis, angle) for angle in (-VIRTUAL_STEP, 0.0, VIRTUAL_STEP)
            )
            curvature[i, row.crossing] = -(after - before) / (2.0 * VIRTUAL_STEP)
            self._set_free(row.joint, [0.0] * 6)
        return {"virtual_moment_arms": arms, "virtual_curvature": curvature}

    def _take(self, pose: Pose) -> None:
        """Give the second model a pose of the first."""
        self._state.setTime(pose.time)
        is_locked = self._original.coordinates.is_locked
        for k, coordinate in enumerate(self._coordinates):
            if not is_locked[k]:
                coordinate.setValue(self._state, float(pose.values[k]), False)
        for j in self._free:
            self._set_free(j, [0.0] * 6)

    def _set_free(self, joint: int, values: list[float]) -> None:
        for coordinate, value in zip(self._free[joint][0], values, strict=True):
            coordinate.setValue(self._state, value, False)

    def _arms(self, row: _Row, center: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
        """Return moment arms, shape (n_crossing,), about an axis through a center, in the inboard body."""
        turned = rotation(axis[None], np.array([angle]))[0]
        shift = center - turned @ center
        # body-fixed x, y, z angles, the coordinates of a free joint
        angles = [
            float(np.arctan2(-turned[1, 2], turned[2, 2])),
            float(np.arcsin(np.clip(turned[0, 2], -1.0, 1.0))),
            float(np.arctan2(-turned[0, 1], turned[0, 0])),
        ]
        self._set_free(row.joint, [*angles, *shift.tolist()])
        self._model.realizePosition(self._state)
        first = self._free[row.joint][1]
        generalized = self._path_forces.columns(self._state, row.crossing)[first : first + 6].T
        torques = generalized[:, :3] + np.cross(shift - center, generalized[:, 3:])
        return np.array([axis @ torque for torque in torques])


def _wanted(axes: list[tuple[str, str]], joints: list[str]) -> list[tuple[str, str]]:
    """Return joints and axes without "all", each once."""
    each = (joints if name == "all" and name not in joints else [name] for name, _ in axes)
    pairs = ((joint, axis) for names, (_, axis) in zip(each, axes, strict=True) for joint in names)
    return list(dict.fromkeys(pairs))


def _row(model: Model, joint: int, axis: int) -> _Row:
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
    return _Row(joint=joint, axis=axis, crossing=crossing, beside=beside)


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
