"""What a model holds, told without a motion: in its default pose, and over the ranges of its coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import opensim as osim

from scso_nlp.exceptions import EngineError
from scso_nlp.files import refuse_changed
from scso_nlp.opensim.worker.bodies import MovingBodies
from scso_nlp.opensim.worker.dynamics import Dynamics
from scso_nlp.opensim.worker.elimination import Elimination, choose_dependent
from scso_nlp.opensim.worker.exchange import Request
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.paths import crosses
from scso_nlp.opensim.worker.poses import POSE_TOLERANCE, Pose, largest_error
from scso_nlp.opensim.worker.sliding import TurnedPaths
from scso_nlp.opensim.worker.virtual_rotations import turned_moment_arms
from scso_nlp.validation import FloatArray

#: Poses of each free coordinate, from one end of its range to the other.
SAMPLES = 3
#: Ranges reach at most so far from the default value: some models have none to speak of [rad or m].
FARTHEST = np.pi
#: A joint's axes are as good as in one plane where the smallest singular value of them is less [-].
LEAST_APART = 0.1
#: OpenSim's kinds of motion, by number.
MOTIONS = ("undefined", "rotational", "translational", "coupled")


def describe_model(request: Request) -> dict[str, Any]:
    """Return what :class:`scso_nlp.opensim.description.ModelDescription` is made of, as JSON values."""
    osim.Logger.setLevelString("Info")
    try:
        model = Model(request.settings)
    finally:
        refuse_changed(request.inputs)
    dependent = choose_dependent(model.constraint_matrix(model.state), model.coordinates.is_set_by_model)
    return _Describer(model, Elimination(dependent)).content()


def joint_axes(model: Model, elimination: Elimination) -> dict[str, Any]:
    """Return what every :class:`scso_nlp.opensim.description.JointAxis` is made of, as JSON values."""
    return _Describer(model, elimination).axes()


class _Describer:
    def __init__(self, model: Model, elimination: Elimination) -> None:
        self._model, self._elimination = model, elimination
        self._default = self._moving(model.state)

    def content(self) -> dict[str, Any]:
        model, bodies, joints = self._model, self._model.bodies, self._model.joints
        gravity = model.opensim.getGravity()
        return {
            "name": model.opensim.getName(),
            "gravity": [gravity.get(i) for i in range(3)],
            "bodies": bodies.names,
            "body_parents": bodies.parents.tolist(),
            "body_masses": bodies.masses.tolist(),
            "joints": joints.names,
            "joint_kinds": [model.opensim.getComponent(path).getConcreteClassName() for path in joints.paths],
            "joint_parents": joints.inboard,
            "joint_children": joints.outboard,
            "coordinates": self._coordinates(),
            "base_coordinates": model.base_coordinates(self._elimination.free),
            "axes": self.axes(),
            "muscles": [
                {
                    "name": muscle.getName(),
                    "kind": muscle.getConcreteClassName(),
                    "max_isometric_force": float(muscle.getMaxIsometricForce()),
                    "has_points": path.geometry is not None,
                }
                for muscle, path in zip(model.forces.muscles, model.paths, strict=True)
            ],
            "actuators": [
                {
                    "name": actuator.getName(),
                    "kind": actuator.getConcreteClassName(),
                    "optimal_force": float(actuator.getOptimalForce()),
                    "min_control": float(actuator.getMinControl()),
                    "max_control": float(actuator.getMaxControl()),
                }
                for actuator in model.forces.actuators
            ],
            **self._generalized_forces(),
            "constraints": _named(model.opensim.getConstraintSet()),
            "other_forces": [_kind(force) for force in model.forces.passives],
            "switched_off": model.forces.switched_off,
            "outside": model.forces.outside,
        }

    def axes(self) -> dict[str, Any]:
        """Return what turns and crosses the joints."""
        model, owners = self._model, self._owners()
        return {
            "joints": model.joints.names,
            "muscles": [muscle.getName() for muscle in model.forces.muscles],
            "have_points": all(path.geometry is not None for path in model.paths),
            "free": [model.coordinates.names[k] for k in self._elimination.free],
            "free_owners": [owners[k] for k in self._elimination.free],
            "turn_rates": self._largest_turn_rates().tolist(),
            "crossing": [[bool(flag) for flag in row] for row in self._crossing()],
            "turned_moment_arms": self._turned_moment_arms().tolist(),
        }

    def _owners(self) -> list[str]:
        """Return the joint of every coordinate."""
        model = self._model
        joints = {path: name for path, name in zip(model.joints.paths, model.joints.names, strict=True)}
        return [joints[item.getJoint().getAbsolutePathString()] for item in model.coordinates.items]

    def _coordinates(self) -> list[dict[str, Any]]:
        model, coordinates, owners = self._model, self._model.coordinates, self._owners()
        coupled = {coupler.target for coupler in coordinates.couplers}
        found = []
        for k, coordinate in enumerate(coordinates.items):
            state = "closes a loop" if self._elimination.dependent[k] else "free"
            for is_so, word in (
                (k in coupled, "coupled"),
                (coordinates.is_prescribed[k], "prescribed"),
                (coordinates.is_locked[k], "locked"),
            ):
                state = word if is_so else state
            found.append(
                {
                    "name": coordinates.names[k],
                    "joint": owners[k],
                    "motion": MOTIONS[int(coordinate.getMotionType())],
                    "default": float(coordinate.getDefaultValue()),
                    "range": (float(coordinate.getRangeMin()), float(coordinate.getRangeMax())),
                    "is_clamped": bool(coordinate.getClamped(model.state)),
                    "state": state,
                }
            )
        return found

    def _largest_turn_rates(self) -> FloatArray:
        """Return what speeds of free coordinates turn joints by, shape (n_joints, 3, n_free).

        Components along each joint's own axes, which need not be at right angles; the largest of all poses.
        """
        largest = self._turn_rates(self._default, self._model.state)
        for state in self._poses():
            try:
                rates = self._turn_rates(self._moving(state), state)
            # the constraints are singular there
            except EngineError:
                continue
            largest = np.where(np.abs(rates) > np.abs(largest), rates, largest)
        return largest

    def _turn_rates(self, at: MovingBodies, state: osim.State) -> FloatArray:
        joints = self._model.joints
        axes = joints.at(state, at.rotations, at.origins).axes
        between = at.angular_velocities[joints.outboard] - at.angular_velocities[joints.inboard]
        # columns are axes; in gimbal lock nothing tells one turn from another
        matrices = np.swapaxes(axes, 1, 2)
        is_apart = np.linalg.svd(matrices, compute_uv=False)[:, -1] > LEAST_APART
        rates = np.zeros((len(matrices), 3, between.shape[2]))
        rates[is_apart] = np.linalg.solve(matrices[is_apart], between[is_apart])
        return rates

    def _poses(self) -> Iterator[osim.State]:
        """Yield the model with one free coordinate after the other at places of its range."""
        model, coordinates = self._model, self._model.coordinates
        default = np.array(coordinates.values(model.state))
        for k in self._elimination.free.tolist():
            ends = np.array([coordinates.items[k].getRangeMin(), coordinates.items[k].getRangeMax()])
            lower, upper = np.clip(ends, default[k] - FARTHEST, default[k] + FARTHEST).tolist()
            for value in np.linspace(lower, upper, SAMPLES).tolist():
                state, values = osim.State(model.state), default.copy()
                values[k] = value
                coordinates.follow(values)
                coordinates.set_values(state, values)
                model.opensim.realizePosition(state)
                if model.is_constrained and largest_error(state) > POSE_TOLERANCE:
                    try:
                        model.opensim.assemble(state)
                    # the constraints do not let the model go there
                    except RuntimeError:
                        continue
                model.opensim.realizeVelocity(state)
                yield state

    def _moving(self, state: osim.State) -> MovingBodies:
        bodies, n_bodies = self._model.bodies, len(self._model.bodies.names)
        coupling = self._elimination.coupling(self._model.constraint_matrix(state), state.getTime())
        nowhere = np.tile(np.eye(3), (n_bodies, 1, 1)), np.zeros((n_bodies, 3))
        return bodies.moving(state, range(1, n_bodies), *nowhere, coupling)

    def _crossing(self) -> list[list[bool]]:
        """Tell which muscles may touch bodies on both sides of which joints, (n_joints, n_muscles)."""
        model = self._model
        distal = [model.bodies.distal(outboard) for outboard in model.joints.outboard]
        return [
            [
                path.geometry is not None and crosses(path.geometry, model.bodies, behind)
                for path in model.paths
            ]
            for behind in distal
        ]

    def _turned_moment_arms(self) -> FloatArray:
        """Return moment arms about joint axes in the default pose, shape (n_joints, 3, n_muscles) [m]."""
        model, at = self._model, self._default
        joints = model.joints.at(model.state, at.rotations, at.origins)
        found = model.current_paths.at(model.state, at.rotations, at.origins)
        points, bodies, _, surfaces, acting = (array[None] for array in found.values())
        arms = np.zeros((len(model.joints.names), 3, len(model.paths)))
        for j, outboard in enumerate(model.joints.outboard):
            is_distal = np.zeros(len(model.bodies.names), dtype=bool)
            is_distal[list(model.bodies.distal(outboard))] = True
            paths = TurnedPaths(
                points=points,
                acting=acting,
                bodies=bodies,
                surfaces=surfaces,
                rotations=at.rotations[None],
                origins=at.origins[None],
                centers=joints.centers[None, j],
                is_distal=is_distal,
            )
            arms[j] = turned_moment_arms(paths, joints.axes[None, j])[0]
        return arms

    def _generalized_forces(self) -> dict[str, Any]:
        """Return what muscles and actuators do to free coordinates in the default pose."""
        model, n_u = self._model, self._model.n_u
        constraints = model.constraint_matrix(model.state)
        coupling = self._elimination.coupling(constraints, model.state.getTime())
        columns = model.path_forces.columns(model.state, range(len(model.paths)))
        state = osim.State(model.state)
        model.opensim.realizeVelocity(state)
        pose = Pose(
            state=state,
            time=model.state.getTime(),
            values=np.array(model.coordinates.values(model.state)),
            speeds=np.zeros(n_u),
            accelerations=np.zeros(n_u),
            constraints=constraints,
            coupling=coupling,
            contradictions=np.zeros(len(self._elimination.gone)),
            rotations=self._default.rotations,
            origins=self._default.origins,
        )
        pushed = Dynamics(model, self._elimination).at(pose)["actuator_generalized_forces"]
        return {
            "moment_arms": (coupling.T @ columns).tolist(),
            "actuator_generalized_forces": pushed.tolist(),
        }


def _named(items: osim.Set) -> list[dict[str, str]]:
    return [_kind(items.get(i)) for i in range(items.getSize())]


def _kind(component: osim.Component) -> dict[str, str]:
    return {"name": component.getName(), "kind": component.getConcreteClassName()}
