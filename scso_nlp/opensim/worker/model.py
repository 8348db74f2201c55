"""An OpenSim model and everything that is known about it before a motion is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import opensim as osim

from scso_nlp.opensim.worker.bodies import Bodies
from scso_nlp.opensim.worker.coordinates import read_coordinates
from scso_nlp.opensim.worker.forces import read_forces, take_off_actuators
from scso_nlp.opensim.worker.paths import CurrentPaths, PathForces, read_path
from scso_nlp.opensim.worker.skeleton import Joints, Loads
from scso_nlp.validation import FloatArray, IntArray


class Model:
    """A model with the setup's actuators and loads, in its default pose, muscles and actuators off.

    `state` stays as it is, realized to velocity: who poses the model copies it. There are `n_u` mobilities,
    as many as coordinates, and one of `paths` per muscle. With constraints in its ConstraintSet, enforced or
    not, OpenSim assembles it by optimization, else by projection if any coordinate is locked or prescribed.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.opensim, self._tool = _load_model(settings)
        #: a copy without loads, to be changed by who needs it
        self.spare: osim.Model | None = self.opensim.clone() if settings["stability_axes"] else None
        if settings["external_loads"] is not None:
            loads = osim.ExternalLoads(settings["external_loads"], True)
            self.opensim.addModelComponent(loads)
            # the model has taken ownership
            loads.this.disown()
        self.state = self.opensim.initSystem()
        self.opensim.setAllControllersEnabled(False)
        self.opensim.realizeVelocity(self.state)
        self._matter = self.opensim.getMatterSubsystem()
        self.n_u = int(self.state.getNU())
        self.is_constrained = len(self.state.getUErr().to_numpy()) > 0
        self.has_constraint_set = self.opensim.getConstraintSet().getSize() > 0
        self.coordinates = read_coordinates(self.opensim, self.state)
        self.forces = read_forces(self.opensim, self.state, settings["outside_force_set"])
        take_off_actuators(self.forces, self.state)
        self.opensim.realizeVelocity(self.state)
        self.bodies = Bodies(self.opensim)
        self.joints = Joints(self.opensim, self.state, self.bodies)
        self.loads = Loads(self.opensim, self.forces.loads, self.bodies)
        self.paths = [read_path(muscle, self.state, self.bodies) for muscle in self.forces.muscles]
        self.current_paths = CurrentPaths(self.paths, self.state, self.bodies)
        self.path_forces = PathForces(
            self.opensim,
            self.state,
            [path.opensim for path in self.paths],
            [path.drives_mobilities for path in self.paths],
        )

    def size(self) -> float:
        """Return the largest distance between centers of bodies and joints in the default pose [m]."""
        rotations, origins = self.bodies.poses(self.state)
        centers = np.einsum("bij,bj->bi", rotations, self.bodies.mass_centers) + origins
        joints = self.joints.at(self.state, rotations, origins).centers
        points = np.concatenate([centers[1:], joints])
        return float(np.linalg.norm(points[:, None] - points, axis=2).max(initial=0.0))

    def base_coordinates(self, free: IntArray) -> list[str]:
        """Name those of the free coordinates that let joints both turn and shift against ground."""
        coordinates = self.coordinates
        owners = [coordinates.items[k].getJoint().getAbsolutePathString() for k in free]
        is_angle = coordinates.is_rotational[free]
        floating = {
            path
            for path, inboard in zip(self.joints.paths, self.joints.inboard, strict=True)
            if self.bodies.is_fixed(inboard)
            and {bool(angle) for owner, angle in zip(owners, is_angle, strict=True) if owner == path}
            == {False, True}
        }
        return [coordinates.names[k] for k, owner in zip(free, owners, strict=True) if owner in floating]

    def constraint_matrix(self, state: osim.State) -> FloatArray:
        """Return the matrix of the velocity constraints, shape (n_constraints, n_u)."""
        if not self.is_constrained:
            return np.zeros((0, self.n_u))
        matrix = osim.Matrix()
        self._matter.calcG(state, matrix)
        return np.array(matrix.to_numpy()).reshape(-1, self.n_u)

    def acceleration_bias(self, state: osim.State) -> FloatArray:
        """Return the constraints' second derivatives where nothing accelerates, shape (n_constraints,)."""
        bias = osim.Vector()
        self._matter.calcBiasForAccelerationConstraints(state, bias)
        return np.array(bias.to_numpy())


def _load_model(settings: Mapping[str, Any]) -> tuple[osim.Model, osim.AnalyzeTool]:
    """Load a model with the actuators that the setup adds.

    The tool owns the forces that it adds: keep it as long as the model.
    """
    model = osim.Model(settings["model"])
    tool = osim.AnalyzeTool()
    files = osim.ArrayStr()
    for path in settings["actuators"]:
        files.append(path)
    tool.setForceSetFiles(files)
    tool.setReplaceForceSet(bool(settings["replace_force_set"]))
    tool.updateModelForces(model, "")
    return model, tool
