"""What all constraints on joint reactions have in common: the forces that joints carry, and room for them."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from scso_nlp.constraints.constraint import FrameConstraint, require_price
from scso_nlp.frame import Frame, Rows
from scso_nlp.joint_reactions import required
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.validation import FloatArray, chosen_names

#: A meaningful difference of joint forces [N].
FORCE_SCALE = 10.0
#: The length of a force is rounded off within so much of zero, so that it has derivatives there [N].
ROUNDED = 1.0


def length(force: ca.SX) -> ca.SX:
    r"""Length of a force, :math:`\sqrt{|f|^2 + \epsilon^2}` with :math:`\epsilon` of 1 N: convex and smooth.

    Parameters
    ----------
    force : ca.SX, shape (n, 1) [N]

    Returns
    -------
    ca.SX [N]
        Never less than the length; more by 0.5 N at 1 N and by 0.0005 N at 1000 N.
    """
    return ca.sqrt(ca.sumsqr(force) + ROUNDED**2)


@dataclass(frozen=True, kw_only=True)
class JointReactionConstraint(FrameConstraint):
    """Forces that joints carry have room.   depends on: one frame.

    Attributes
    ----------
    joints : sequence of str or None
        Names or patterns; None for all joints that the motion was read with.
    on, frame : str
        The body that forces act on, and the frame they are seen in, as for
        :meth:`Solution.joint_reactions`.
    soft : float or None [objective per N]
        If given, room may be missed at this price; the amounts are in
        ``solution.variables["<name>.missed"]``.
    label : str
        Name in reports, needed where a problem has two of a kind.

    Raises
    ------
    ProblemError
        A price that is not positive; a motion read without joint reactions.
    NameMismatchError
        An unknown joint.
    """

    joints: Sequence[str] | None = None
    on: Literal["child", "parent"] = "child"
    frame: Literal["ground", "child", "parent"] = "child"
    soft: float | None = None
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", chosen_names("joint", self.joints))
        require_price(self.soft, "N")

    @abc.abstractmethod
    def room(self, forces: Mapping[str, ca.SX], body_weight: float) -> Mapping[str, ca.SX]:
        """Say by row how much room is left [N], concave in `forces` by joint, each (3, 1) [N]."""

    @property
    def needs(self) -> MotionNeeds:
        """Reactions of the joints."""
        return MotionNeeds(joint_reactions=tuple(self.joints or ("all",)))

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give the forces of all joints."""
        return required(motion.trajectory.joint_reactions, self.joints).forces(self.on, self.frame)

    def rows(self, frame: Frame, motion: Motion) -> Rows:
        """How much room is left [N]."""
        reactions, data = required(motion.trajectory.joint_reactions, self.joints), frame.data
        force = data["per_tendon_force"] @ frame.muscle.tendon_force + data["per_control"] @ frame.control
        by_joint = ca.vertsplit(force + data["constant"], 3)
        room = self.room(dict(zip(reactions.joints, by_joint, strict=True)), reactions.body_weight)
        return Rows(
            value=ca.vertcat(*room.values()),
            lower=0.0,
            upper=np.inf,
            names=tuple(room),
            unit="N",
            scale=FORCE_SCALE,
            price=self.soft,
        )
