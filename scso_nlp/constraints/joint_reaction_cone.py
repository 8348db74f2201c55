"""The force in a socket points into it: shear is at most so much of compression."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from scso_nlp.arguments import checked
from scso_nlp.constraints.joint_reaction_constraint import JointReactionConstraint, length
from scso_nlp.exceptions import ProblemError


@dataclass(frozen=True, kw_only=True)
@checked
class JointReactionCone(JointReactionConstraint):
    r"""The force of a joint lies in a cone about an axis.   depends on: one frame.

    .. math:: \text{slope}\; f \cdot n - |f - (f \cdot n)\, n| \ge 0

    as for a glenoid, which the head of the humerus leaves where shear exceeds so much of compression. The
    set of tendon forces and controls that keep it is convex.

    Attributes
    ----------
    axis : sequence of float, shape (3,) [-]
        n, of any length, in `frame`, here the parent's by default: where the force on it should point, i.e.
        into the socket.
    slope : float [-]
        Largest shear over compression: the tangent of the cone's half angle.

    Raises
    ------
    ProblemError
        An axis without length, a slope that is not positive.

    References
    ----------
    Belli et al. (2023), PLoS One 18:e0295003: the glenohumeral force, linear in activations, is constrained
    likewise.

    Examples
    --------
    >>> scso.JointReactionCone(joints=["shoulder"], axis=(0, 0, -1), slope=0.5).needs.joint_reactions
    ('shoulder',)
    """

    axis: Sequence[float] = (0.0, 0.0, 1.0)
    slope: float = 0.5
    on: Literal["child", "parent"] = "parent"
    frame: Literal["ground", "child", "parent"] = "parent"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axis", tuple(float(x) for x in self.axis))
        size = math.hypot(*self.axis)
        if len(self.axis) != 3 or not (math.isfinite(size) and size > 0):
            raise ProblemError(f"axis is {self.axis}, expected three numbers that are not all zero")
        if not (math.isfinite(self.slope) and self.slope > 0):
            raise ProblemError(f"slope is {self.slope:g}, expected a positive number")

    def room(self, forces: Mapping[str, ca.SX], body_weight: float) -> Mapping[str, ca.SX]:
        """How much shear each joint may have besides what it has [N]."""
        normal = ca.DM(self.axis) / math.hypot(*self.axis)
        compression = {joint: ca.dot(force, normal) for joint, force in forces.items()}
        return {
            joint: self.slope * pressed - length(forces[joint] - pressed * normal)
            for joint, pressed in compression.items()
        }
