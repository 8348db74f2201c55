"""Stability along single generalized coordinates, for paths of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.stability.hessian import hessian_terms, require_curvature, rows_along
from scso_nlp.stability.rows import StabilityRows

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


@dataclass(frozen=True, kw_only=True)
class CoordinateStability(StabilityConstraint):
    r"""Stability along each chosen coordinate is at least `level`.   depends on: one frame.

    .. math:: H_{ii} \ge \text{level}_i

    Exact for wrapping, moving and conditional path points. Rows are called by their coordinate.

    Attributes
    ----------
    coordinates : sequence of str or None
        None for all coordinates whose curvature was extracted.
    model_passive : bool
        Count the model's own springs, bushings, limit forces and ligaments.

    References
    ----------
    Bergmark (1989), Acta Orthop Scand 60 Suppl 230; Cholewicki and McGill (1996), Clin Biomech 11:1-15.
    """

    coordinates: Sequence[str] | None = None
    model_passive: bool = True

    def stability_rows(self, problem: MuscleForceProblem) -> StabilityRows:
        """Curvature, moment arms and loads of the rows."""
        names = self.row_names(problem)
        terms = hessian_terms(problem.trajectory, names, model_passive=self.model_passive)
        unit = np.broadcast_to(np.eye(len(names)), (problem.trajectory.n_frames, len(names), len(names)))
        return rows_along(terms, unit, names, problem.trajectory.muscles)

    def row_names(self, problem: MuscleForceProblem) -> tuple[str, ...]:
        """Names of the chosen coordinates."""
        if self.coordinates is not None:
            return tuple(self.coordinates)
        return require_curvature(problem.trajectory).coordinates
