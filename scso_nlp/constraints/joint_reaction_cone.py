"""The force in a socket points into it: shear is at most so much of compression."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.constraints.joint_reaction_limit import FORCE_SCALE, length
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows
from scso_nlp.joint_reactions import JointReactionMap, required
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.validation import FloatArray, chosen_names


@dataclass(frozen=True, kw_only=True)
@checked
class JointReactionCone(FrameConstraint):
    r"""The force of a joint on its parent lies in a cone about its axis.   depends on: one frame.

    .. math:: \text{slope}\; f \cdot n - |f - (f \cdot n)\, n| \ge 0

    as for a glenoid, which the head of the humerus leaves where shear exceeds so much of compression. The
    set of tendon forces and controls that keep it is convex.

    Attributes
    ----------
    joints : sequence of str or None
        Names or patterns; None for all joints that the motion was read with.
    axis : sequence of float, shape (3,) [-]
        n, of any length, in the frame of the joint's parent body: where the force on it should point, i.e.
        into the socket.
    slope : float [-]
        Largest shear over compression: the tangent of the cone's half angle.
    soft : float or None [objective per N]
        If given, shear may exceed it at this price; the amounts are in
        ``solution.variables["<name>.missed"]``.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        An axis without length, a slope or price that is not positive; a motion read without joint reactions.
    NameMismatchError
        An unknown joint.

    References
    ----------
    Lippitt and Matsen (1993), Clin Orthop Relat Res 291:20-28: stability ratios of the glenoid.

    Examples
    --------
    >>> scso.JointReactionCone(joints=["shoulder"], axis=(0, 0, -1), slope=0.5).needs.joint_reactions
    ('shoulder',)
    """

    joints: Sequence[str] | None = None
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    slope: float = 0.5
    soft: float | None = None
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", chosen_names("joint", self.joints))
        object.__setattr__(self, "axis", tuple(float(x) for x in self.axis))
        size = math.hypot(*self.axis)
        if len(self.axis) != 3 or not (math.isfinite(size) and size > 0):
            raise ProblemError(f"axis is {self.axis}, expected three numbers that are not all zero")
        for name, value in (("slope", self.slope), ("soft", self.soft)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ProblemError(f"{name} is {value:g}, expected a positive number")

    @property
    def needs(self) -> MotionNeeds:
        """Reactions of the joints."""
        return MotionNeeds(joint_reactions=("all",) if self.joints is None else tuple(self.joints))

    def _reactions(self, motion: Motion) -> JointReactionMap:
        return required(motion.trajectory.joint_reactions).of_joints(self.joints)

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give the forces of all joints on their parents, in these."""
        return self._reactions(motion).forces("parent", "parent")

    def rows(self, frame: Frame, motion: Motion) -> Rows:
        """How much shear each joint may have besides what it has [N]."""
        joints, data = self._reactions(motion).joints, frame.data
        force = data["per_tendon_force"] @ frame.muscle.tendon_force + data["per_control"] @ frame.control
        force += data["constant"]
        normal = ca.DM(self.axis) / math.hypot(*self.axis)
        values = []
        for j in range(len(joints)):
            own = force[3 * j : 3 * j + 3]
            compression = ca.dot(own, normal)
            values.append(self.slope * compression - length(own - compression * normal))
        return Rows(
            value=ca.vertcat(*values),
            lower=0.0,
            upper=np.inf,
            names=joints,
            unit="N",
            scale=FORCE_SCALE,
            price=self.soft,
        )
