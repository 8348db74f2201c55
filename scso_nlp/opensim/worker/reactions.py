"""Joint reactions of one pose, affine in the tensions of muscles and the controls of actuators.

What a joint carries is what the bodies on its distal side need to move as they do, less what else acts on
them: the Newton-Euler equations, summed over these bodies. What springs, contact, loads and weights do is not
summed up force by force: OpenSim's own forward dynamics, with muscles and actuators off, says what the joints
carry at its accelerations, and the equations lead from there to those of the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import opensim as osim

from scso_nlp.exceptions import DataError
from scso_nlp.opensim.worker.bodies import Bodies, cross_matrices, frame_offsets, unique_labels
from scso_nlp.opensim.worker.dynamics import Dynamics
from scso_nlp.opensim.worker.elimination import RANK_TOLERANCE
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.paths import path_bodies
from scso_nlp.opensim.worker.poses import Pose
from scso_nlp.validation import FloatArray, IntArray, matches

#: Gravity by which a mass becomes a body weight [m/s²].
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, kw_only=True)
class _DistalSides:
    """What acts on or in the distal sides of all joints in one pose, as force and moment about the joints."""

    per_acceleration: FloatArray  # (n_joints, 6, n_u), what they need to accelerate
    per_multiplier: FloatArray  # (n_joints, 6, n_constraints), what constraints take off them
    centers: FloatArray  # (n_joints, 3) [m], where the joints carry them


class Reactions:
    """Force and moment that act on the child of each chosen joint, at the origin of its child frame.

    They are expressed in ground, force first, as by OpenSim's JointReaction. Mobility forces (of coordinate
    actuators and springs, fitted paths, couplers) act on no body: the joint itself carries what they do.
    """

    def __init__(self, model: Model, dynamics: Dynamics, chosen: Sequence[str]) -> None:
        self._model, self._dynamics = model, dynamics
        bodies, state = model.bodies, model.state
        self._names, joints = _chosen_joints(model, chosen)
        outer = [bodies.outboard_frame(joint) for joint in joints]
        self._outer = _Frames(outer, state, bodies)
        self._children = _Frames([joint.getChildFrame() for joint in joints], state, bodies)
        self._parents = _Frames([joint.getParentFrame() for joint in joints], state, bodies)
        is_child = [
            frame.this == joint.getChildFrame().this for frame, joint in zip(outer, joints, strict=True)
        ]
        self._signs = np.where(is_child, 1.0, -1.0)[:, None, None]
        self._is_distal = np.zeros((len(joints), len(bodies.names)))
        for j, body in enumerate(self._outer.bodies.tolist()):
            self._is_distal[j, sorted(bodies.distal(body))] = 1.0
        every = np.arange(len(bodies.names))
        self._touched: list[IntArray] = [
            every if path.geometry is None else np.array(sorted(path_bodies(path.geometry, bodies)))
            for path in model.paths
        ]
        self._matter = model.opensim.getMatterSubsystem()

    def header(self) -> dict[str, Any]:
        """Return names and constants."""
        names = self._model.bodies.names
        return {
            "joints": self._names,
            "children": [names[b] for b in self._children.bodies],
            "parents": [names[b] for b in self._parents.bodies],
            "body_weight": STANDARD_GRAVITY * float(self._model.bodies.masses.sum()),
        }

    def at(self, pose: Pose, columns: FloatArray) -> dict[str, FloatArray]:
        """Return reactions and frames in a pose, given the muscles' generalized forces, (n_u, n_muscles).

        Its state is then realized to acceleration.
        """
        sides = self._distal_sides(pose)
        of_paths = self._of_paths(pose, sides)
        # overriding an actuation takes the state back before its positions: what needs these comes first
        full = self._dynamics.on_mobilities(pose)
        applied = self._applied(pose, sides)
        of_actuators = np.zeros((len(self._names), 6, full.columns.shape[1]))
        for j, actuator in enumerate(self._model.forces.actuators):
            if j not in self._dynamics.plain_actuators:
                actuator.setOverrideActuation(pose.state, float(actuator.getOptimalForce()))
                of_actuators[..., j] = self._applied(pose, sides) - applied
                actuator.setOverrideActuation(pose.state, 0.0)
        # of multipliers that satisfy transposed G multipliers = what acts on the mobilities - net, the least
        per_force = sides.per_multiplier @ np.linalg.pinv(pose.constraints.T, rcond=RANK_TOLERANCE)
        constant = sides.per_acceleration @ full.accelerations - applied - per_force @ full.net
        children = self._children.at(pose)
        arms = children[1] - sides.centers
        return {
            "constant": self._on_children(constant[..., None], arms)[..., 0],
            "per_tendon_force": self._on_children(per_force @ columns - of_paths, arms),
            "per_control": self._on_children(per_force @ full.columns - of_actuators, arms),
            **dict(zip(("child_rotations", "child_centers", "child_origins"), children, strict=True)),
            **dict(
                zip(
                    ("parent_rotations", "parent_centers", "parent_origins"),
                    self._parents.at(pose),
                    strict=True,
                )
            ),
        }

    def _on_children(self, reactions: FloatArray, arms: FloatArray) -> FloatArray:
        """Move reactions on distal sides, (n_joints, 6, n), to child frames at arms, (n_joints, 3) [m]."""
        return self._signs * _moved(reactions, arms)

    def _distal_sides(self, pose: Pose) -> _DistalSides:
        bodies, centers = self._model.bodies, self._outer.at(pose)[1]
        matrix = osim.Matrix()
        self._matter.calcSystemJacobian(pose.state, matrix)
        # of angular velocity and that of the origin
        jacobian = np.array(matrix.to_numpy()).reshape(-1, 6, self._model.n_u)[bodies.mobilized]
        arms = np.einsum("bij,bj->bi", pose.rotations, bodies.mass_centers)
        of_centers = jacobian[:, 3:] - cross_matrices(arms) @ jacobian[:, :3]
        forces = bodies.masses[:, None, None] * of_centers
        inertias = pose.rotations @ bodies.inertias @ pose.rotations.transpose(0, 2, 1)
        moments = inertias @ jacobian[:, :3] + cross_matrices(arms) @ forces
        needed = np.concatenate([forces, moments], axis=1)
        return _DistalSides(
            per_acceleration=self._sums(needed, pose, centers),
            per_multiplier=self._sums(self._of_constraints(pose), pose, centers),
            centers=centers,
        )

    def _sums(self, on_bodies: FloatArray, pose: Pose, centers: FloatArray) -> FloatArray:
        """Sum up forces and moments at the origins of bodies, (n_bodies, 6, n), over distal sides."""
        about_ground = _moved(on_bodies, -pose.origins)
        return _moved(np.tensordot(self._is_distal, about_ground, axes=1), centers)

    def _of_constraints(self, pose: Pose) -> FloatArray:
        """Return what constraints take off bodies per multiplier, shape (n_bodies, 6, n_constraints)."""
        n_constraints, bodies = len(pose.constraints), self._model.bodies.mobilized
        taken = np.zeros((len(bodies), 6, n_constraints))
        on_bodies, unused = osim.VectorOfSpatialVec(), osim.Vector()
        for k, row in enumerate(np.eye(n_constraints)):
            one = osim.Vector.createFromMat(row)
            self._matter.calcConstraintForcesFromMultipliers(pose.state, one, on_bodies, unused)
            taken[..., k] = _read(on_bodies, bodies)
        return taken

    def _of_paths(self, pose: Pose, sides: _DistalSides) -> FloatArray:
        """Return what paths at 1 N tension do to distal sides, shape (n_joints, 6, n_muscles)."""
        on_bodies = np.zeros((len(self._model.bodies.names), 6, len(self._touched)))
        for m, touched in enumerate(self._touched):
            forces = self._model.path_forces.on_bodies(pose.state, m)
            on_bodies[touched, :, m] = _read(forces, self._model.bodies.mobilized[touched])
        return self._sums(on_bodies, pose, sides.centers)

    def _applied(self, pose: Pose, sides: _DistalSides) -> FloatArray:
        """Return what the forces that are on do to distal sides, less what velocities need, (n_joints, 6)."""
        state = pose.state
        self._model.opensim.realizeAcceleration(state)
        accelerations = np.array(state.getUDot().to_numpy())
        if not np.isfinite(accelerations).all():
            raise DataError(
                "joint reactions need OpenSim's forward dynamics, which has no answer at "
                f"t = {pose.time:.9g} s: give every body that moves by itself a mass"
            )
        carried = osim.VectorOfSpatialVec()
        self._matter.calcMobilizerReactionForces(state, carried)
        reactions = _read(carried, self._model.bodies.mobilized[self._outer.bodies])
        multipliers = np.array(state.getMultipliers().to_numpy()).reshape(-1)
        return sides.per_acceleration @ accelerations + sides.per_multiplier @ multipliers - reactions


class _Frames:
    """Frames of joints; public are the indices of their `bodies`."""

    def __init__(self, frames: list[osim.PhysicalFrame], state: osim.State, bodies: Bodies) -> None:
        self.bodies, _, self._offsets = frame_offsets(frames, state, bodies)

    def at(self, pose: Pose) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return rotations of the bodies, (n, 3, 3), origins of frames and of bodies, (n, 3) [m]."""
        rotations, origins = pose.rotations[self.bodies], pose.origins[self.bodies]
        return rotations, np.einsum("jab,jb->ja", rotations, self._offsets) + origins, origins


def _moved(forces: FloatArray, arms: FloatArray) -> FloatArray:
    """Return forces and moments, (n, 6, n_columns), about points at some arm from where they act, (n, 3)."""
    force, moment = forces[:, :3], forces[:, 3:]
    return np.concatenate([force, moment - cross_matrices(arms) @ force], axis=1)


def _read(vector: osim.VectorOfSpatialVec, chosen: IntArray) -> FloatArray:
    """Return forces and moments of chosen bodies, which Simbody keeps the other way round, (n_chosen, 6)."""
    found = np.zeros((len(chosen), 6))
    for i, b in enumerate(chosen.tolist()):
        both = vector.get(b)
        found[i, :3], found[i, 3:] = both.get(1).to_numpy(), both.get(0).to_numpy()
    return found


def _chosen_joints(model: Model, chosen: Sequence[str]) -> tuple[list[str], list[osim.Joint]]:
    """Find joints by name or pattern, or all of them by "all", in the model's order."""
    joints = list(model.opensim.getJointList())
    names = unique_labels(joints)
    wanted = set(range(len(names))) if "all" in chosen else set()
    for name in chosen:
        if name != "all":
            wanted |= set(matches("joint", name, names).tolist())
    for name, joint in zip(names, joints, strict=True):
        if not model.bodies.is_in_tree(joint):
            raise DataError(
                f"the joint {name!r} closes a loop, where what joints carry is not known: close it by a "
                "constraint for joint reactions"
            )
    return [names[j] for j in sorted(wanted)], [joints[j] for j in sorted(wanted)]
