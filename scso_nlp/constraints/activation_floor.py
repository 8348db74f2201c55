"""The least activation that every muscle keeps: a null model of co-contraction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows
from scso_nlp.motion import Motion
from scso_nlp.validation import FloatArray, by_name


@dataclass(frozen=True, kw_only=True)
@checked
class ActivationFloor(FrameConstraint):
    r"""Activations are at least so large.   depends on: one frame.

    .. math:: a_m \ge \text{floor}_m

    Any such tone moves silent antagonists off zero, whatever stability is: a null model for claims about it.

    Attributes
    ----------
    floor : float or mapping of str to float [-]
        For all muscles, or by name or pattern; muscles that are not named have none. Later entries win.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        A floor that is not between 0 and 1.
    NameMismatchError
        An unknown muscle.

    Examples
    --------
    >>> floor = scso.ActivationFloor(floor={"biceps": 0.3})
    >>> held = scso.solve_trajectory(replace(problem, constraints=(*problem.constraints, floor)))
    >>> bool((held["biceps"].activation > 0.3 - 1e-8).all())
    True
    """

    floor: float | Mapping[str, float] = 0.02
    label: str = ""

    def __post_init__(self) -> None:
        floors = list(self.floor.values()) if isinstance(self.floor, Mapping) else [self.floor]
        for floor in floors:
            if not 0 <= floor <= 1:
                raise ProblemError(f"floor is {floor:g}, expected a number from 0 to 1")

    def _floors(self, motion: Motion) -> FloatArray:
        names = motion.trajectory.muscles
        if isinstance(self.floor, Mapping):
            return by_name("muscle", self.floor, names, default=-math.inf)
        return np.full(len(names), float(self.floor))

    def rows(self, frame: Frame, motion: Motion) -> Rows:
        """Activations that have a floor [-]."""
        floors = self._floors(motion)
        held = np.flatnonzero(np.isfinite(floors))
        return Rows(
            value=frame.activation[held.tolist()],
            lower=floors[held],
            upper=np.inf,
            names=[motion.trajectory.muscles[m] for m in held],
            unit="-",
            scale=0.1,
        )
