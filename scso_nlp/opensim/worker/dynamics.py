"""Generalized forces of one pose, by OpenSim's inverse dynamics with muscles and actuators off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import opensim as osim

from scso_nlp.exceptions import EngineError
from scso_nlp.opensim.worker.elimination import Elimination
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.poses import Pose
from scso_nlp.validation import FloatArray


@dataclass(frozen=True, kw_only=True)
class FullDynamics:
    """Dynamics of one pose on all mobilities, dependent ones too."""

    accelerations: FloatArray  # (n_u,) [rad/s² or m/s²], those of dependent coordinates by the constraints
    net: FloatArray  # (n_u,) [N·m or N], what must act besides the forces that are on
    columns: FloatArray  # (n_u, n_actuators) [N·m or N], of actuators at a control of one


class Dynamics:
    """What must act on a model, and what its actuators and passive elements can do.

    Public are the `plain_actuators`: coordinate and optimal force of actuators that push one coordinate.
    """

    def __init__(self, model: Model, elimination: Elimination) -> None:
        self._model, self._elimination = model, elimination
        self._solver = osim.InverseDynamicsSolver(model.opensim)
        self._without_passives = osim.State(model.state)
        for force in model.forces.passives:
            force.setAppliesForce(self._without_passives, False)
        names = model.coordinates.names
        # plain coordinate actuators push their coordinate by their optimal force, whatever the pose
        self.plain_actuators = {
            j: (names.index(plain.getCoordinate().getName()), float(plain.getOptimalForce()))
            for j, actuator in enumerate(model.forces.actuators)
            if (plain := osim.CoordinateActuator.safeDownCast(actuator)) is not None
            and plain.getConcreteClassName() == "CoordinateActuator"
        }

    def at(self, pose: Pose) -> dict[str, FloatArray]:
        """Return generalized forces on the free coordinates, shapes (n_free,) or (n_free, n_actuators)."""
        full, to_free = self.on_mobilities(pose), pose.coupling.T
        passive = self._passive_share(pose, full.accelerations, full.net)
        return {
            "generalized_forces": to_free @ full.net,
            "passive_generalized_forces": to_free @ passive,
            "actuator_generalized_forces": to_free @ full.columns,
        }

    def on_mobilities(self, pose: Pose) -> FullDynamics:
        """Return what acts, and what actuators can do, before dependent coordinates are eliminated."""
        accelerations = self._complete_accelerations(pose)
        net = self.inverse_dynamics(pose.state, accelerations)
        columns = self._actuator_columns(pose, accelerations, net)
        return FullDynamics(accelerations=accelerations, net=net, columns=columns)

    def inverse_dynamics(self, state: osim.State, accelerations: FloatArray) -> FloatArray:
        """Return what must act on each mobility besides the forces that are on in a state, shape (n_u,)."""
        vector = osim.Vector.createFromMat(np.ascontiguousarray(accelerations))
        return np.array(self._solver.solve(state, vector).to_numpy())

    def recorded_forces(self, pose: Pose) -> FloatArray:
        """Return the values that loads and passive elements record, shape (n_record_labels,)."""
        values: list[float] = []
        if self._model.forces.recorded:
            self._model.opensim.realizeDynamics(pose.state)
        for force, n_labels in self._model.forces.recorded:
            record = force.getRecordValues(pose.state)
            if record.getSize() != n_labels:
                raise EngineError(
                    f"the force {force.getName()!r} records {record.getSize()} values under {n_labels} labels"
                )
            values += [record.get(i) for i in range(n_labels)]
        return np.array(values, dtype=float)

    def _complete_accelerations(self, pose: Pose) -> FloatArray:
        """Replace the dependent coordinates' accelerations by those that the constraints imply, (n_u,)."""
        dependent = self._elimination.dependent
        accelerations = np.where(dependent, 0.0, pose.accelerations)
        if dependent.any():
            error = pose.constraints @ accelerations + self._model.acceleration_bias(pose.state)
            accelerations[dependent] = self._elimination.remedy(pose.constraints, error)
        return accelerations

    def _passive_share(self, pose: Pose, accelerations: FloatArray, net: FloatArray) -> FloatArray:
        if not self._model.forces.passives:
            return np.zeros(self._model.n_u)
        other = self._without_passives
        other.setTime(pose.time)
        other.setQ(pose.state.getQ())
        other.setU(pose.state.getU())
        return self.inverse_dynamics(other, accelerations) - net

    def _actuator_columns(self, pose: Pose, accelerations: FloatArray, net: FloatArray) -> FloatArray:
        actuators = self._model.forces.actuators
        columns = np.zeros((self._model.n_u, len(actuators)))
        for j, actuator in enumerate(actuators):
            if j in self.plain_actuators:
                coordinate, optimal_force = self.plain_actuators[j]
                columns[coordinate, j] = optimal_force
                continue
            actuator.setOverrideActuation(pose.state, float(actuator.getOptimalForce()))
            columns[:, j] = net - self.inverse_dynamics(pose.state, accelerations)
            actuator.setOverrideActuation(pose.state, 0.0)
        return columns
