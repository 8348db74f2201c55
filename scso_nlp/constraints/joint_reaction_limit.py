"""Bounds on the forces that joints carry: their length, and components."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows
from scso_nlp.joint_reactions import JointReactionMap, required
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.validation import FloatArray, by_name, chosen_names

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
@checked
class JointReactionLimit(FrameConstraint):
    r"""Forces that joints carry are at most so large.   depends on: one frame.

    .. math:: \text{largest}_j - |f_j| \ge 0, \quad \text{components}_i \mp f_i \ge 0

    with the force f of each joint's reaction; the set of tendon forces and controls that keep these rows is
    convex.

    Attributes
    ----------
    largest : float, mapping of str to float, or None [N]
        Of the length of each joint's force, for all joints or by name or pattern; joints not named have
        none. Multiples of body weight: times ``motion.trajectory.joint_reactions.body_weight``.
    components : mapping of str to float, or None [N]
        Largest magnitude by ``"<joint>_<fx|fy|fz>"`` or pattern.
    joints : sequence of str or None
        Names or patterns; None for all joints that the motion was read with.
    on, frame
        For `components`: body and frame, as for :meth:`Solution.joint_reactions`.
    soft : float or None [objective per N]
        If given, limits may be exceeded at this price; the amounts are in
        ``solution.variables["<name>.missed"]``.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        A limit that is not above 1 N, a price that is not positive; no limit at all; a motion read without
        joint reactions.
    NameMismatchError
        An unknown joint or component.

    Examples
    --------
    >>> limit = scso.JointReactionLimit(largest={"knee_*": 2500.0}, components={"knee_r_fx": 400.0})
    >>> limit.needs.joint_reactions
    ('all',)
    """

    largest: float | Mapping[str, float] | None = None
    components: Mapping[str, float] | None = None
    joints: Sequence[str] | None = None
    on: Literal["child", "parent"] = "child"
    frame: Literal["ground", "child", "parent"] = "child"
    soft: float | None = None
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", chosen_names("joint", self.joints))
        if self.largest is None and not self.components:
            raise ProblemError("no limit is given, expected largest or components")
        largest = self.largest if isinstance(self.largest, Mapping) else {"all joints": self.largest}
        for name, limit in {**largest, **(self.components or {})}.items():
            if limit is not None and not (math.isfinite(limit) and limit > ROUNDED):
                raise ProblemError(f"the limit of {name!r} is {limit:g} N, expected more than {ROUNDED:g} N")
        if self.soft is not None and not (math.isfinite(self.soft) and self.soft > 0):
            raise ProblemError(f"soft is {self.soft:g}, expected a positive price per N, or no price")

    @property
    def needs(self) -> MotionNeeds:
        """Reactions of the joints."""
        return MotionNeeds(joint_reactions=("all",) if self.joints is None else tuple(self.joints))

    def _reactions(self, motion: Motion) -> JointReactionMap:
        return required(motion.trajectory.joint_reactions).of_joints(self.joints)

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give the forces of all joints."""
        return self._reactions(motion).forces(self.on, self.frame)

    def rows(self, frame: Frame, motion: Motion) -> Rows:
        """How much each force is below its limit [N]."""
        joints, data = self._reactions(motion).joints, frame.data
        force = data["per_tendon_force"] @ frame.muscle.tendon_force + data["per_control"] @ frame.control
        force += data["constant"]
        names, values = [], []
        for j, limit in _limits("joint", self.largest, joints):
            names.append(joints[j])
            values.append(limit - length(force[3 * j : 3 * j + 3]))
        parts = tuple(f"{joint}_{part}" for joint in joints for part in ("fx", "fy", "fz"))
        for i, limit in _limits("component of joint reactions", self.components, parts):
            names += [f"{parts[i]} positive", f"{parts[i]} negative"]
            values += [limit - force[i], limit + force[i]]
        return Rows(
            value=ca.vertcat(*values),
            lower=0.0,
            upper=np.inf,
            names=names,
            unit="N",
            scale=FORCE_SCALE,
            price=self.soft,
        )


def _limits(
    kind: str, limits: float | Mapping[str, float] | None, names: Sequence[str]
) -> list[tuple[int, float]]:
    """Return the limits by position; what has none is left out."""
    if not isinstance(limits, Mapping):
        limits = {} if limits is None else {"*": limits}
    found = by_name(kind, limits, names, default=np.inf)
    return [(i, limit) for i, limit in enumerate(found.tolist()) if limit < np.inf]
