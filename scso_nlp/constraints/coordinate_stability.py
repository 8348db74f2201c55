"""Stability along single generalized coordinates, for paths of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.stability.hessian import HessianTerms, chosen_coordinates, curvature_notes, hessian_terms
from scso_nlp.stability.rows import StabilityRows
from scso_nlp.validation import FloatArray, chosen_names


@dataclass(frozen=True, kw_only=True)
@checked
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

    Examples
    --------
    >>> along = scso.CoordinateStability(coordinates=["elbow_flexion"], level=20.0)
    >>> kept = scso.solve_trajectory(replace(problem, constraints=(scso.MomentEquilibrium(), along)))
    >>> kept.stability.rows, float(kept.stability.margin[0, 0].round(2))
    (('elbow_flexion',), 25.76)
    """

    coordinates: Sequence[str] | None = None
    model_passive: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "coordinates", chosen_names("coordinate", self.coordinates))

    @property
    def needs(self) -> MotionNeeds:
        """Second derivatives along the coordinates."""
        chosen = ("all",) if self.coordinates is None else tuple(self.coordinates)
        return MotionNeeds(curvature_coordinates=chosen)

    def row_names(self, motion: Motion) -> tuple[str, ...]:
        """Names of the chosen coordinates."""
        return chosen_coordinates(motion.trajectory, self.coordinates)

    def stability_rows(self, motion: Motion) -> StabilityRows:
        """Curvature, moment arms and loads of the rows."""
        names = self.row_names(motion)
        return self._terms(motion, names).rows_of_coordinates(motion.trajectory.muscles)

    def _terms(self, motion: Motion, names: tuple[str, ...]) -> HessianTerms:
        factor = self.passive_factor * self.model_passive
        return hessian_terms(motion.trajectory, names, model_passive=factor)

    def passive_and_taken(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Give passive stiffness and what loads take away, each coordinate alone."""
        names = self.row_names(motion)
        terms = self._terms(motion, names)
        alone = np.eye(len(names))
        passive = terms.constant - terms.loads + np.diag(self.passive_by_row(names))
        return alone * passive, -alone * terms.loads

    def notes(self, motion: Motion) -> tuple[str, ...]:
        """Say which coordinates are looked at, and where the curvature of paths is uncertain."""
        return curvature_notes(motion.trajectory)
