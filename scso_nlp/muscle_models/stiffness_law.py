"""Stiffness laws: how stiff a muscle is at a given force.

A law is a choice inside a stability constraint. A new law is one class here and one test; the formulas
of short-range and fiber stiffness are in :mod:`scso_nlp.muscle_models.stiffness`.
"""

from __future__ import annotations

import abc
import fnmatch
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from scso_nlp.exceptions import NameMismatchError, ProblemError
from scso_nlp.transcription.frame import Frame
from scso_nlp.validation import FloatArray, positions

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


class StiffnessLaw(abc.ABC):
    """From a muscle's state to its stiffness along the path."""

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Give data per frame that the law needs in ``frame.data``; none by default."""
        return {}

    @abc.abstractmethod
    def stiffness(self, frame: Frame, problem: MuscleForceProblem) -> ca.SX:
        """Stiffness of every muscle, shape (n_muscles, 1) [N/m]."""


@dataclass(frozen=True, kw_only=True)
class ProportionalStiffness(StiffnessLaw):
    r"""Stiffness :math:`k = q F / L`, with the tendon force and the length of the whole path.

    Attributes
    ----------
    q : float, sequence of float or mapping of str to float [-]
        One gain, one per muscle in the trajectory's order, or by name or pattern with ``*`` (every
        muscle must get one; later entries win).

    Raises
    ------
    ProblemError
        q negative or not finite.
    NameMismatchError
        A name that fits no muscle, or a muscle without a gain.

    References
    ----------
    Bergmark (1989), Acta Orthop Scand 60 Suppl 230; Potvin and Brown (2005), J Biomech 38:973-980.
    """

    q: float | Sequence[float] | Mapping[str, float] = 5.0

    def __post_init__(self) -> None:
        values = list(self.q.values()) if isinstance(self.q, Mapping) else np.ravel(np.asarray(self.q, float))
        for value in values:
            if not (math.isfinite(value) and value >= 0):
                raise ProblemError(f"q is {value:g}, expected a finite number of at least 0")

    def gains(self, muscles: tuple[str, ...]) -> FloatArray:
        """Return the gain of each muscle, shape (n_muscles,) [-]."""
        if not isinstance(self.q, Mapping):
            q = np.asarray(self.q, dtype=float)
            if q.ndim and q.shape != (len(muscles),):
                raise ProblemError(
                    f"q has shape {q.shape}, expected a number or ({len(muscles)},) = (n_muscles,)"
                )
            return np.broadcast_to(q, (len(muscles),)).copy()
        gains = np.full(len(muscles), np.nan)
        for pattern, value in self.q.items():
            hits = [i for i, name in enumerate(muscles) if fnmatch.fnmatchcase(name, pattern)]
            if not hits and "*" in pattern:
                raise NameMismatchError(f"q: the pattern {pattern!r} fits no muscle")
            gains[hits or positions("muscle", [pattern], muscles)] = value
        if np.isnan(gains).any():
            left = ", ".join(name for name, value in zip(muscles, gains, strict=True) if np.isnan(value))
            raise NameMismatchError(f"q has no entry for {left}; add them, or a first entry '*' for the others")
        return gains

    def stiffness(self, frame: Frame, problem: MuscleForceProblem) -> ca.SX:
        """Stiffness of every muscle, affine in force."""
        gains = ca.DM(self.gains(problem.trajectory.muscles))
        return gains * frame.muscle.tendon_force / frame.muscle_tendon_length
