"""Objectives that are one power of every unknown, in numbers, with their least values in closed form."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.solver.convex_objective import ConvexObjective
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.validation import BoolArray, FloatArray

#: What an objective is taken for gives its value to this [-].
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Powers:
    r"""Effort of all frames, or of one: :math:`E(x) = w^T |x|^p + g^T x + e`.

    Attributes
    ----------
    exponent : float
        :math:`p`.
    weight, slope : ndarray, shape (n_frames, n_unknowns) or (n_unknowns,)
        Of the scaled unknowns.
    constant : ndarray, shape (n_frames,) or ()
    """

    exponent: float
    weight: FloatArray
    slope: FloatArray
    constant: FloatArray

    @classmethod
    def of(cls, program: FrameProgram, objective: ConvexObjective) -> Powers | None:
        """Read off what an objective is; None if it is something else."""
        degrees = {getattr(term, "degree", None) for term in program.problem.objectives}
        exponent = 2.0 if objective.is_quadratic else degrees.pop() if len(degrees) == 1 else None
        if not objective.is_separable or exponent is None:
            return None
        zero, one = (np.full((program.time.size, program.layout.size), size) for size in (0.0, 1.0))
        powers = cls(
            exponent=exponent,
            weight=objective.near(one, program.arrays)[1] / (exponent * (exponent - 1)),
            slope=objective.near(zero, program.arrays)[0],
            constant=objective.values(zero, program.arrays),
        )
        expected = objective.values(0.5 * one, program.arrays)
        return powers if np.allclose(powers.value(0.5 * one), expected, rtol=_ROUNDING, atol=0.0) else None

    def at(self, k: int, free: BoolArray) -> Powers:
        """Of some unknowns of one frame."""
        return replace(
            self, weight=self.weight[k, free], slope=self.slope[k, free], constant=self.constant[k]
        )

    def over(self, size: float) -> Powers:
        """Divide by a number."""
        return replace(
            self, weight=self.weight / size, slope=self.slope / size, constant=self.constant / size
        )

    def value(self, x: FloatArray) -> FloatArray:
        """Effort at a point, or at many."""
        power = x * x if self.exponent == 2 else np.abs(x) ** self.exponent
        return np.asarray((self.weight * power + self.slope * x).sum(axis=-1) + self.constant)

    def gradient(self, x: FloatArray) -> FloatArray:
        """Differentiate at a point."""
        p = self.exponent
        return self.slope + p * self.weight * (x if p == 2 else np.sign(x) * np.abs(x) ** (p - 1))

    def curvature(self, x: FloatArray) -> FloatArray:
        """Second derivatives at a point that has no zeros unless p is 2."""
        p = self.exponent
        return p * (p - 1) * self.weight * (1.0 if p == 2 else np.abs(x) ** (p - 2))

    def least(
        self, share: FloatArray, linear: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> FloatArray:
        """Least values of share * E(x) + linear'x between bounds, by (n,) shares and (n, size) slopes."""
        p, weight = self.exponent, share[:, None] * self.weight
        total = linear + share[:, None] * self.slope
        with np.errstate(divide="ignore", invalid="ignore"):
            size = (np.abs(total) / (p * weight)) ** (1 / (p - 1))
            best = np.where(weight > 0, -np.sign(total) * size, np.where(total > 0, lower, upper))
        best = np.clip(best, lower, upper)
        each = weight * np.abs(best) ** p + total * best
        return np.asarray(each.sum(axis=1) + share * self.constant)
