"""The model in one row of the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import opensim as osim

from scso_nlp.opensim.worker.elimination import Elimination, choose_dependent
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.motion import Kinematics
from scso_nlp.validation import FloatArray

#: Largest constraint error of a pose that needs no assembling [m] or [rad]. OpenSim's own accuracy is 1e-10.
POSE_TOLERANCE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A row of the motion with the constraints satisfied, as far as OpenSim's assembly satisfies them.

    All of it is a value but `state`, OpenSim's own, realized to velocity: the next pose overwrites it.
    """

    state: osim.State
    time: float  # [s]
    values: FloatArray  # (n_u,) [rad or m], after assembling
    speeds: FloatArray  # (n_u,) [rad/s or m/s]
    accelerations: FloatArray  # (n_u,) [rad/s² or m/s²], of the motion, whatever the constraints imply
    constraints: FloatArray  # (n_constraints, n_u), matrix of the velocity constraints
    coupling: FloatArray  # (n_u, n_free), du/du_free
    contradictions: FloatArray  # (n_dependent,) [rad/s or m/s], of speeds and constraints; 0 where locked
    rotations: FloatArray  # (n_bodies, 3, 3) [-], columns are the bodies' axes
    origins: FloatArray  # (n_bodies, 3) [m]


class Poses:
    """Puts rows of a motion into a model; the first one to analyze decides which coordinates are free."""

    def __init__(self, model: Model, kinematics: Kinematics, *, keep_coupled_speeds: bool) -> None:
        self._model, self._kinematics = model, kinematics
        self._keeps_speeds = keep_coupled_speeds
        self._state = osim.State(model.state)
        dependent = np.zeros(model.n_u, dtype=bool)
        if model.is_constrained:
            self._put(int(kinematics.rows[0]))
            constraints = model.constraint_matrix(self._state)
            dependent = choose_dependent(constraints, model.coordinates.is_set_by_model)
        self.elimination = Elimination(dependent)

    def at(self, row: int) -> Pose:
        """Pose the model as in a row; the state of the pose before is gone."""
        model, state = self._model, self._state
        self._put(row)
        contradictions = self._contradictions()
        model.opensim.realizeVelocity(state)
        constraints, time = model.constraint_matrix(state), float(self._kinematics.time[row])
        rotations, origins = model.bodies.poses(state)
        return Pose(
            state=state,
            time=time,
            values=np.array(model.coordinates.values(state)),
            speeds=np.array([coordinate.getSpeedValue(state) for coordinate in model.coordinates.items]),
            accelerations=self._kinematics.accelerations[row],
            constraints=constraints,
            coupling=self.elimination.coupling(constraints, time),
            contradictions=contradictions,
            rotations=rotations,
            origins=origins,
        )

    def _put(self, row: int) -> None:
        """Give the state a row's values and speeds, assemble it, and realize it to velocity."""
        model, state, coordinates = self._model, self._state, self._model.coordinates
        time = float(self._kinematics.time[row])
        state.setTime(time)
        values, speeds = self._kinematics.values[row], self._kinematics.speeds[row]
        is_assembled = self._kinematics.is_assembled
        coordinates.set_values(state, values if is_assembled else self._completed(values, time))
        for coordinate, speed, is_locked in zip(
            coordinates.items, speeds.tolist(), coordinates.is_locked, strict=True
        ):
            if not is_locked:
                coordinate.setSpeedValue(state, speed)
        model.opensim.realizePosition(state)
        # a projection gives prescribed coordinates their speeds too
        is_projected = coordinates.is_prescribed.any() and not model.has_constraint_set
        is_open = model.is_constrained and not is_assembled and largest_error(state) > POSE_TOLERANCE
        if is_projected or is_open:
            model.opensim.assemble(state)
        model.opensim.realizeVelocity(state)

    def _completed(self, values: FloatArray, time: float) -> FloatArray:
        """Return values, shape (n_u,), with what the model itself says of some coordinates."""
        coordinates, values = self._model.coordinates, values.copy()
        for k in np.flatnonzero(coordinates.is_prescribed).tolist():
            values[k] = coordinates.items[k].getPrescribedFunction().calcValue(osim.Vector(1, time))
        for k in np.flatnonzero(coordinates.is_locked).tolist():
            values[k] = coordinates.items[k].getValue(self._state)
        coordinates.follow(values)
        return values

    def _contradictions(self) -> FloatArray:
        """Measure by how much dependent speeds contradict the constraints, and correct them if asked."""
        model, state, gone = self._model, self._state, self.elimination.gone
        contradictions = np.zeros(len(gone))
        if not gone.size:
            return contradictions
        error = np.array(state.getUErr().to_numpy())
        changes = self.elimination.remedy(model.constraint_matrix(state), error)
        for i, (k, du) in enumerate(zip(gone, changes, strict=True)):
            if model.coordinates.is_locked[k]:
                continue
            contradictions[i] = abs(float(du))
            if not self._keeps_speeds:
                coordinate = model.coordinates.items[k]
                coordinate.setSpeedValue(state, float(coordinate.getSpeedValue(state) + du))
        return contradictions


def largest_error(state: osim.State) -> float:
    """Return the largest error of the constraints in a state realized to position [m] or [rad]."""
    return float(np.abs(state.getQErr().to_numpy()).max(initial=0.0))
