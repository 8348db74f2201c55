"""A model and a motion, ready for any row: the worker's pieces put together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import opensim as osim
from numpy.typing import NDArray

from scso_nlp.exceptions import DataError
from scso_nlp.files import refuse_changed
from scso_nlp.opensim.worker.assembly import assembled
from scso_nlp.opensim.worker.coordinate_derivatives import CoordinateDerivatives
from scso_nlp.opensim.worker.description import joint_axes
from scso_nlp.opensim.worker.dynamics import Dynamics
from scso_nlp.opensim.worker.exchange import Job, joined
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.motion import Note, read_kinematics
from scso_nlp.opensim.worker.muscles import (
    active_force_capacities,
    actuator_parameters,
    muscle_parameters,
    notes_on_muscles,
)
from scso_nlp.opensim.worker.poses import Pose, Poses
from scso_nlp.opensim.worker.reactions import Reactions
from scso_nlp.opensim.worker.skeleton import JointFrames, LoadVectors
from scso_nlp.opensim.worker.virtual_rotations import PosedPaths, VirtualRotations
from scso_nlp.validation import FloatArray, IntArray

#: Moment arms below this share of the frame's largest are zero [-].
_ROUNDING = 1e-13


class Extraction:
    """Turns rows of a motion into the arrays of a trajectory.

    Attributes
    ----------
    rows : ndarray of int
        The rows to analyze.
    """

    def __init__(self, job: Job) -> None:
        osim.Logger.setLevelString("Info")
        settings = job.settings
        try:
            self._model = Model(settings)
        finally:
            # OpenSim has read all files by now; what it says of one that was half written is beside the point
            refuse_changed(job.inputs)
        if not self._model.forces.muscles and not self._model.forces.actuators:
            raise DataError("the model has no muscle or actuator that applies force, expected at least one")
        self._kinematics = assembled(job, self._model, read_kinematics(job, self._model))
        self._poses = Poses(
            self._model, self._kinematics, keep_coupled_speeds=settings["keep_coupled_speeds"]
        )
        self._dynamics = Dynamics(self._model, self._poses.elimination)
        self._has_paths = settings["muscle_paths"]
        axes = settings["stability_axes"]
        self._virtual = VirtualRotations(self._model, axes) if axes else None
        chosen = settings["curvature_coordinates"]
        self._derivatives = (
            CoordinateDerivatives(self._model, self._poses.elimination, self._dynamics, chosen)
            if chosen
            else None
        )
        joints = settings["joint_reactions"]
        self._reactions = Reactions(self._model, self._dynamics, joints) if joints else None
        self.rows: IntArray = self._kinematics.rows

    def frame(self, row: int) -> dict[str, NDArray[Any]]:
        """Return everything that belongs to a row, by data class and field, each with a first axis of one.

        What stands under "virtual" is for :meth:`finished`.
        """
        model = self._model
        pose = self._poses.at(row)
        joints = model.joints.at(pose.state, pose.rotations, pose.origins)
        loads = model.loads.at(pose.state)
        columns = model.path_forces.columns(pose.state, range(len(model.paths)))
        moment_arms = _without_rounding(pose.coupling.T @ columns)
        paths = model.current_paths
        points = paths.at(pose.state, pose.rotations, pose.origins) if self._has_paths else paths.nothing
        contacts = {name: points.pop(name) for name in ("path_point_surfaces", "path_points_acting")}
        found: dict[str, dict[str, Any]] = {
            "trajectory": {
                **self._motion(pose),
                **self._muscles(pose),
                "moment_arms": moment_arms,
                **self._dynamics.at(pose),
                "other_forces": self._dynamics.recorded_forces(pose),
            },
            "skeleton": {**self._skeleton(pose, joints, loads), **points},
            "log": {"contradictions": pose.contradictions},
        }
        if self._virtual is not None:
            found["virtual"] = {
                "values": pose.values,
                "body_rotations": pose.rotations,
                "body_origins": pose.origins,
                **contacts,
            }
        if self._derivatives is not None:
            found["curvature"] = dict(self._derivatives.at(pose, loads, moment_arms))
        if self._reactions is not None:
            found["joint_reactions"] = dict(self._reactions.at(pose, columns))
        return {
            f"{group}.{name}": np.asarray(array)[None]
            for group, arrays in found.items()
            for name, array in arrays.items()
        }

    def finished(self, frames: Sequence[dict[str, NDArray[Any]]]) -> Sequence[dict[str, NDArray[Any]]]:
        """Add to frames what is computed for many of them at once: virtual rotations."""
        if self._virtual is None:
            return frames
        arrays = joined(frames)
        found = self._virtual.at(
            PosedPaths(
                time=arrays["trajectory.time"],
                values=arrays["virtual.values"],
                rotations=arrays["virtual.body_rotations"],
                origins=arrays["virtual.body_origins"],
                centers=arrays["skeleton.joint_centers"],
                axes=arrays["skeleton.joint_axes"],
                points=arrays["skeleton.path_points"],
                acting=arrays["virtual.path_points_acting"],
                bodies=arrays["skeleton.path_point_bodies"],
                surfaces=arrays["virtual.path_point_surfaces"],
            )
        )
        kept = {name: array for name, array in arrays.items() if not name.startswith("virtual.")}
        return [kept | {f"skeleton.{name}": array for name, array in found.items()}]

    def _motion(self, pose: Pose) -> dict[str, Any]:
        free = self._poses.elimination.free
        return {
            "time": pose.time,
            "coordinate_values": pose.values[free],
            "coordinate_speeds": pose.speeds[free],
        }

    def _muscles(self, pose: Pose) -> dict[str, Any]:
        state, muscles = pose.state, self._model.forces.muscles
        paths = [path.opensim for path in self._model.paths]
        return {
            "muscle_tendon_length": np.array([path.getLength(state) for path in paths]),
            "muscle_tendon_velocity": np.array([path.getLengtheningSpeed(state) for path in paths]),
            "active_force_capacity": active_force_capacities(muscles, state),
        }

    def _skeleton(self, pose: Pose, joints: JointFrames, loads: LoadVectors) -> dict[str, Any]:
        bodies = self._model.bodies
        centers = np.einsum("bij,bj->bi", pose.rotations, bodies.mass_centers) + pose.origins
        return {
            "body_mass_centers": centers,
            "joint_centers": joints.centers,
            "joint_axes": joints.axes,
            "load_forces": loads.forces,
            "load_points": loads.points,
            "load_torques": loads.torques,
        }

    def header(self, *, with_axes: bool) -> dict[str, Any]:
        """Return names and constants by data class and field, the same in every worker.

        What turns and crosses the joints takes a while to find out: one worker will do.
        """
        model, elimination = self._model, self._poses.elimination
        forces, bodies, coordinates = model.forces, model.bodies, model.coordinates
        muscles, actuators = muscle_parameters(forces.muscles), actuator_parameters(forces.actuators)
        gravity = model.opensim.getGravity()
        header: dict[str, Any] = {
            "muscles": muscles,
            "actuators": actuators,
            "trajectory": {
                "muscles": muscles["muscles"],
                "actuators": actuators["actuators"],
                "coordinates": [coordinates.names[k] for k in elimination.free],
                "base_coordinates": model.base_coordinates(elimination.free),
                "is_rotational": coordinates.is_rotational[elimination.free].tolist(),
                "force_columns": forces.columns,
                "other_force_labels": forces.record_labels,
            },
            "skeleton": {
                "bodies": bodies.names,
                "body_parents": bodies.parents.tolist(),
                "body_masses": bodies.masses.tolist(),
                "gravity": [gravity.get(i) for i in range(3)],
                "joints": model.joints.names,
                "joint_children": model.joints.outboard,
                "load_names": model.loads.names,
                "load_bodies": model.loads.bodies.tolist(),
            },
            "log": {
                "notes": self._notes(),
                "size": model.size(),
                "eliminated": [coordinates.names[k] for k in elimination.gone],
            },
        }
        if self._virtual is not None:
            header["skeleton"]["virtual_rows"] = self._virtual.names
        if with_axes and self._has_paths:
            header["axes"] = joint_axes(model, elimination)
        if self._derivatives is not None:
            header["curvature"] = {"coordinates": self._derivatives.names}
        if self._reactions is not None:
            header["joint_reactions"] = self._reactions.header()
        return header

    def _notes(self) -> list[Note]:
        """Return what the user should know about columns, forces and coordinates that are left out."""
        notes = [*self._kinematics.notes, *notes_on_muscles(self._model.forces.muscles)]
        if self._model.forces.switched_off:
            names = ", ".join(self._model.forces.switched_off)
            notes.append(("INFO", f"switched off in the model and left out: {names}"))
        if self._model.forces.outside:
            names = ", ".join(self._model.forces.outside)
            notes.append(
                (
                    "WARNING",
                    "muscles and actuators outside the model's ForceSet act in their default state and are "
                    f"not optimized, as in OpenSim (name them in outside_force_set to use them): {names}",
                )
            )
        coordinates, gone = self._model.coordinates, self._poses.elimination.gone
        if gone.size:
            names = ", ".join(coordinates.names[k] for k in gone)
            notes.append(("INFO", f"coordinates eliminated by the model's constraints: {names}"))
        loops = [coordinates.names[k] for k in gone if not coordinates.is_set_by_model[k]]
        if loops:
            notes.append(("INFO", f"of these, chosen to close loops: {', '.join(loops)}"))
        return notes


def _without_rounding(moment_arms: FloatArray) -> FloatArray:
    """Make moment arms zero that are rounding: of muscles that do not cross what their coordinate turns.

    Muscles from pelvis to thigh have such about all coordinates of the pelvis. Solvers would carry them as
    entries of their matrices, often more of them than of all others.
    """
    size = np.abs(moment_arms)
    return np.where(size > _ROUNDING * size.max(initial=0.0), moment_arms, 0.0)
