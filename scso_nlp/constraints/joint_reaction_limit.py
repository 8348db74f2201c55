"""Bounds on the forces that joints carry: their length, and components."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.joint_reaction_constraint import ROUNDED, JointReactionConstraint, length
from scso_nlp.exceptions import ProblemError
from scso_nlp.joint_reactions import COMPONENTS
from scso_nlp.text import shown
from scso_nlp.validation import by_name

#: A limit in body weights.
_MULTIPLE = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*BW\s*")


@dataclass(frozen=True, kw_only=True)
@checked
class JointReactionLimit(JointReactionConstraint):
    r"""Forces that joints carry are at most so large.   depends on: one frame.

    .. math:: \text{largest}_j - |f_j| \ge 0, \quad \text{components}_i \mp f_i \ge 0

    with the force f of each joint's reaction; the set of tendon forces and controls that keep these rows is
    convex.

    Attributes
    ----------
    largest : float, text such as "3BW", mapping of str to these, or None [N]
        Of the length of each joint's force, for all joints or by name or pattern; joints not named have
        none. Text is a multiple of the model's weight.
    components : mapping of str to float or text, or None [N]
        Largest magnitude by ``"<joint>_<fx|fy|fz>"`` or pattern, on the body and in the frame that are named.

    Raises
    ------
    ProblemError
        A limit that is not above 1 N or 0 body weights; no limit at all.
    NameMismatchError
        An unknown component.

    Examples
    --------
    >>> limit = scso.JointReactionLimit(largest={"knee_*": "3BW"}, components={"knee_r_fx": 400.0})
    >>> limit.needs.joint_reactions
    ('all',)
    """

    largest: float | str | Mapping[str, float | str] | None = None
    components: Mapping[str, float | str] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.largest is None and not self.components:
            raise ProblemError("no limit is given, expected largest or components")
        largest = self.largest if isinstance(self.largest, Mapping) else {"all joints": self.largest}
        for name, limit in {**largest, **(self.components or {})}.items():
            if limit is not None:
                _in_newtons(name, limit)

    def room(self, forces: Mapping[str, ca.SX], body_weight: float) -> Mapping[str, ca.SX]:
        """How much each force is below its limit [N]."""
        largest = self.largest if isinstance(self.largest, Mapping) else {"*": self.largest}
        parts = {
            f"{joint}_{part}": force[i]
            for joint, force in forces.items()
            for i, part in enumerate(COMPONENTS[:3])
        }
        rows = {
            joint: limit - length(forces[joint])
            for joint, limit in _limits("joint", largest, forces, body_weight)
        }
        kind = "component of joint reactions"
        for part, limit in _limits(kind, self.components or {}, parts, body_weight):
            rows |= {f"{part} positive": limit - parts[part], f"{part} negative": limit + parts[part]}
        return rows


def _limits(
    kind: str, limits: Mapping[str, float | str | None], names: Iterable[str], body_weight: float
) -> list[tuple[str, float]]:
    """Return names with their limits [N]; what has none is left out."""
    given = {name: _in_newtons(name, x, body_weight) for name, x in limits.items() if x is not None}
    found = by_name(kind, given, tuple(names), default=np.inf).tolist()
    return [(name, limit) for name, limit in zip(names, found, strict=True) if limit < np.inf]


def _in_newtons(name: str, limit: float | str, body_weight: float = np.inf) -> float:
    """Read a limit [N]; without the model's weight [N] it is only checked."""
    multiple = _MULTIPLE.fullmatch(str(limit))
    newtons = float(multiple[1]) * body_weight if multiple else limit
    if isinstance(newtons, str) or newtons == limit == np.inf or not newtons > ROUNDED:
        raise ProblemError(
            f"the limit of {name!r} is {shown(limit)}, expected more than {ROUNDED:g} N, or text such as "
            "'3BW' for body weights of a model that has mass"
        )
    return newtons
