"""Objectives of frames apart from each other, with first and second derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import Derivatives, Key, curved
from scso_nlp.validation import FloatArray


@dataclass(frozen=True, kw_only=True)
class ConvexObjective:
    """Objectives of one frame with their derivatives."""

    costs: tuple[Derivatives, ...]
    is_quadratic: bool
    is_separable: bool

    @classmethod
    def of(cls, program: FrameProgram) -> ConvexObjective:
        """Make the functions of a program's one-frame objectives."""
        costs = tuple(piece.curvature for _, piece in program.objectives)
        bent = (any(curved(cost.values, cost.piece.unknowns[0])) for cost in costs)
        separable = all((cost.row == cost.column).all() for cost in costs)
        return cls(costs=costs, is_quadratic=not any(bent), is_separable=separable)

    def values(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> FloatArray:
        """Value in each frame, shape (n_frames,)."""
        parts = [cost.piece.values(unknowns, arrays)[:, 0] for cost in self.costs]
        return np.sum(parts, axis=0) if parts else np.zeros(len(unknowns))

    def near(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Gradient (n_frames, n) and Hessian at a point: (n_frames, n, n), or (n_frames, n) if separable."""
        n_frames, n = unknowns.shape
        gradient = np.zeros((n_frames, n))
        hessian = np.zeros((n_frames, n) if self.is_separable else (n_frames, n, n))
        for cost in self.costs:
            first, second = cost.at(unknowns, arrays)
            gradient += first
            where = (cost.row,) if self.is_separable else (cost.row, cost.column)
            hessian[:, *where] += second
        return gradient, hessian
