"""What joints carry: affine in tendon forces and controls, and at a solution.

Defined as by OpenSim's JointReaction: the force and moment that act on one of the two bodies of a joint, at
the origin of the joint's frame on it. What coordinate actuators and springs do at a joint is part of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ProblemError
from scso_nlp.validation import FloatArray, IntArray, chosen_names, matches, read_only, unique_names

#: The body that reactions act on, and the frames that they can be expressed in.
SIDES, FRAMES = ("child", "parent"), ("ground", "child", "parent")
#: Force and moment along x, y and z, as in OpenSim's files.
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True, kw_only=True)
@checked
class JointReactions:
    """Reactions of joints at given forces.

    Attributes
    ----------
    joints : tuple of str
    bodies : tuple of str
        The body that each acts on.
    frames : tuple of str
        Ground, or the body whose frame each is expressed in.
    forces : ndarray, shape (n_frames, n_joints, 3) [N]
    moments : ndarray, shape (n_frames, n_joints, 3) [N·m]
    points : ndarray, shape (n_frames, n_joints, 3) [m]
        Where they act: the origin of the joint's frame on the body, seen from the frame it is expressed in.
    body_weight : float [N]
    """

    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    frames: tuple[str, ...]
    forces: FloatArray
    moments: FloatArray
    points: FloatArray
    body_weight: float

    @property
    def resultant(self) -> FloatArray:
        """Length of each force, shape (n_frames, n_joints) [N]."""
        return np.asarray(np.linalg.norm(self.forces, axis=2))

    @property
    def labels(self) -> tuple[str, ...]:
        """Columns of OpenSim's file, nine per joint, e.g. ``"knee_r_on_tibia_r_in_ground_fx"``."""
        places = zip(self.joints, self.bodies, self.frames, strict=True)
        parts = (*COMPONENTS, "px", "py", "pz")
        return tuple(
            f"{joint}_on_{body}_in_{frame}_{part}" for joint, body, frame in places for part in parts
        )

    @property
    def columns(self) -> FloatArray:
        """Values under `labels`, shape (n_frames, 9 n_joints)."""
        columns = np.concatenate([self.forces, self.moments, self.points], axis=2)
        return columns.reshape(len(columns), -1)


@dataclass(frozen=True, kw_only=True)
@checked
class JointReactionMap:
    """Reactions on the children of joints, in ground: constant + per force × force + per control × control.

    Attributes
    ----------
    joints : tuple of str
    children, parents : tuple of str
        Bodies that the joint's child and parent frames are fixed to.
    body_weight : float [N]
        Mass of the model times 9.80665 m/s².
    constant : ndarray, shape (n_frames, n_joints, 6) [N], [N·m]
        Force and moment by the motion, its loads, weights, springs and contact.
    per_tendon_force : ndarray, shape (n_frames, n_joints, 6, n_muscles) [-], [m]
    per_control : ndarray, shape (n_frames, n_joints, 6, n_actuators) [N], [N·m]
    child_rotations, parent_rotations : ndarray, shape (n_frames, n_joints, 3, 3) [-]
        Columns are the axes of the bodies.
    child_origins, parent_origins : ndarray, shape (n_frames, n_joints, 3) [m]
        Origins of the bodies in ground.
    child_centers, parent_centers : ndarray, shape (n_frames, n_joints, 3) [m]
        Origins of the joint's own frames in ground.
    """

    joints: tuple[str, ...]
    children: tuple[str, ...]
    parents: tuple[str, ...]
    body_weight: float
    constant: FloatArray
    per_tendon_force: FloatArray
    per_control: FloatArray
    child_rotations: FloatArray
    parent_rotations: FloatArray
    child_origins: FloatArray
    parent_origins: FloatArray
    child_centers: FloatArray
    parent_centers: FloatArray

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "joints", unique_names("joint", self.joints))
        for name in ("children", "parents"):
            set_field(self, name, tuple(getattr(self, name)))
        n = len(self.joints)
        n_frames = read_only("constant", self.constant, (-1, n, 6), "n_frames, n_joints, 6").shape[0]
        shapes = {
            "constant": ((n_frames, n, 6), "n_frames, n_joints, 6"),
            "per_tendon_force": ((n_frames, n, 6, -1), "n_frames, n_joints, 6, n_muscles"),
            "per_control": ((n_frames, n, 6, -1), "n_frames, n_joints, 6, n_actuators"),
        }
        for side in SIDES:
            shapes[f"{side}_rotations"] = ((n_frames, n, 3, 3), "n_frames, n_joints, 3, 3")
            for what in ("origins", "centers"):
                shapes[f"{side}_{what}"] = ((n_frames, n, 3), "n_frames, n_joints, 3")
        for name, (shape, axes) in shapes.items():
            set_field(self, name, read_only(name, getattr(self, name), shape, axes))

    def frames(self, selection: slice | IntArray) -> JointReactionMap:
        """Keep some frames; all else stays."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        return replace(self, **{name: array[selection] for name, array in arrays.items()})  # type: ignore[arg-type]

    def of_joints(self, joints: Sequence[str] | None) -> JointReactionMap:
        """Keep some joints, by name or pattern, in the model's order; None keeps all.

        Raises
        ------
        NameMismatchError
            A name or pattern that fits none.
        """
        chosen = chosen_names("joint", joints)
        if chosen is None:
            return self
        kept = sorted({int(j) for name in chosen for j in matches("joint", name, self.joints)})
        changes: dict[str, object] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, tuple):
                changes[item.name] = tuple(value[j] for j in kept)
            elif isinstance(value, np.ndarray):
                changes[item.name] = value[:, kept]
        return replace(self, **changes)  # type: ignore[arg-type]

    def seen(
        self, on: Literal["child", "parent"], frame: Literal["ground", "child", "parent"]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Express reactions on either body in another frame.

        Parameters
        ----------
        on : "child" or "parent"
            The body that they act on, at the origin of the joint's frame on it.
        frame : "ground", "child" or "parent"
            Ground, or the body whose frame they are expressed in.

        Returns
        -------
        constant : ndarray, shape (n_frames, n_joints, 6) [N], [N·m]
        per_tendon_force : ndarray, shape (n_frames, n_joints, 6, n_muscles) [-], [m]
        per_control : ndarray, shape (n_frames, n_joints, 6, n_actuators) [N], [N·m]

        Raises
        ------
        ProblemError
            Another body or frame.
        """
        turn = self._turn(on, frame)
        parts = (self.constant[..., None], self.per_tendon_force, self.per_control)
        constant, per_tendon_force, per_control = (turn @ part for part in parts)
        return constant[..., 0], per_tendon_force, per_control

    def forces(
        self, on: Literal["child", "parent"], frame: Literal["ground", "child", "parent"]
    ) -> dict[str, FloatArray]:
        """Give the forces of all joints one below the other, for terms.

        Parameters
        ----------
        on, frame
            As for :meth:`seen`.

        Returns
        -------
        dict of str to ndarray
            "constant", shape (n_frames, 3 n_joints) [N]; "per_tendon_force" and "per_control", with another
            axis for muscles and actuators.
        """
        names = ("constant", "per_tendon_force", "per_control")
        parts = (part[:, :, :3] for part in self.seen(on, frame))
        return {
            name: part.reshape(len(part), 3 * len(self.joints), *part.shape[3:])
            for name, part in zip(names, parts, strict=True)
        }

    def _turn(self, on: str, frame: str) -> FloatArray:
        """Matrices, (n_frames, n_joints, 6, 6), that take reactions on children in ground elsewhere."""
        for name, value, known in (("on", on, SIDES), ("frame", frame, FRAMES)):
            if value not in known:
                raise ProblemError(f"{name} is {value!r}, expected one of {', '.join(map(repr, known))}")
        n_frames, n_joints = self.constant.shape[:2]
        turn = np.zeros((n_frames, n_joints, 6, 6))
        axes = np.eye(3) if frame == "ground" else getattr(self, f"{frame}_rotations").swapaxes(2, 3)
        turn[..., :3, :3] = turn[..., 3:, 3:] = axes
        if on == "parent":
            x, y, z = np.moveaxis(self.child_centers - self.parent_centers, 2, 0)
            zero = np.zeros_like(x)
            cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=2)
            turn[..., 3:, :3] = axes @ cross.reshape(n_frames, n_joints, 3, 3)
            turn = -turn
        return turn

    def at(
        self,
        tendon_force: FloatArray,
        control: FloatArray,
        *,
        on: Literal["child", "parent"] = "child",
        frame: Literal["ground", "child", "parent"] = "ground",
    ) -> JointReactions:
        """Evaluate reactions.

        Parameters
        ----------
        tendon_force : ndarray, shape (n_frames, n_muscles) [N]
        control : ndarray, shape (n_frames, n_actuators) [-]
        on, frame
            As for :meth:`seen`.

        Returns
        -------
        JointReactions

        Raises
        ------
        ProblemError
            Another body or frame.
        """
        constant, per_tendon_force, per_control = self.seen(on, frame)
        values = constant + np.einsum("kjcm,km->kjc", per_tendon_force, tendon_force)
        values += np.einsum("kjca,ka->kjc", per_control, control)
        points = getattr(self, f"{on}_centers")
        if frame != "ground":
            arms = points - getattr(self, f"{frame}_origins")
            points = np.einsum("kjba,kjb->kja", getattr(self, f"{frame}_rotations"), arms)
        bodies = {"child": self.children, "parent": self.parents, "ground": ("ground",) * len(self.joints)}
        return JointReactions(
            joints=self.joints,
            bodies=bodies[on],
            frames=bodies[frame],
            forces=values[..., :3],
            moments=values[..., 3:],
            points=points,
            body_weight=self.body_weight,
        )


def required(found: JointReactionMap | None, joints: Sequence[str] | None = None) -> JointReactionMap:
    """Return the reactions of a motion that must have them, of some joints by name or pattern.

    Raises
    ------
    ProblemError
        It has none.
    NameMismatchError
        A name or pattern that fits none.
    """
    if found is None:
        raise ProblemError(
            "the motion was read without joint reactions; read it again with joint_reactions='all' or the "
            "names of joints (on the command line --joint-reactions)"
        )
    return found.of_joints(joints)
