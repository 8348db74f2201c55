"""Stability along any combination of coordinates: the Hessian minus levels is positive semi-definite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import STABILITY_SCALE, StabilityConstraint
from scso_nlp.frame import Frame, MatrixRows
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.stability.hessian import HessianTerms, chosen_coordinates, curvature_notes, hessian_terms
from scso_nlp.stability.rows import StabilityRows
from scso_nlp.validation import FloatArray, chosen_names, read_only


@dataclass(frozen=True, kw_only=True)
@checked
class HessianStability(StabilityConstraint):
    r"""The Hessian over the chosen coordinates is positive semi-definite.   depends on: one frame.

    .. math:: H - \operatorname{diag}(\text{level}) \succeq 0, \quad
              H = \sum_m \left(F_m \frac{\partial^2\ell_m}{\partial q\,\partial q} + k_m r_m r_m^T\right)
              + K - \frac{\partial\tau_{ext}}{\partial q}

    Attributes
    ----------
    coordinates : sequence of str or None
        None for all coordinates whose curvature was extracted.
    model_passive : bool
        Count the model's own springs, bushings, limit forces and ligaments.
    passive_matrix : ndarray, shape (n, n), or None [N·m/rad]
        Passive stiffness with coupling between coordinates, besides `passive_stiffness` by coordinate.

    References
    ----------
    Bergmark (1989), Acta Orthop Scand 60 Suppl 230; Cholewicki and McGill (1996), Clin Biomech 11:1-15.

    Examples
    --------
    >>> whole = scso.HessianStability(q=5.0, level=20.0)
    >>> kept = scso.solve_trajectory(replace(problem, constraints=(scso.MomentEquilibrium(), whole)))
    >>> kept.matrices["HessianStability"].smallest_eigenvalue[:3].round(2)
    array([ 25.76,  71.53, 117.29])
    """

    coordinates: Sequence[str] | None = None
    model_passive: bool = True
    passive_matrix: FloatArray | None = None

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

    def terms(self, motion: Motion) -> HessianTerms:
        """Collect what the Hessian is made of."""
        names = self.row_names(motion)
        passive = np.diag(self.passive_by_row(names))
        if self.passive_matrix is not None:
            shape = (len(names), len(names))
            passive = passive + self.passive_factor * read_only(
                "passive_matrix", self.passive_matrix, shape, "n_coordinates, n_coordinates"
            )
        factor = self.passive_factor * self.model_passive
        return hessian_terms(motion.trajectory, names, model_passive=factor, passive_stiffness=passive)

    def passive_and_taken(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Give passive stiffness and what loads take away."""
        terms = self.terms(motion)
        return terms.constant - terms.loads, -terms.loads

    def stability_rows(self, motion: Motion) -> StabilityRows:
        """Each coordinate alone: the diagonal of the Hessian."""
        return self.terms(motion).rows_of_coordinates(motion.trajectory.muscles)

    def notes(self, motion: Motion) -> tuple[str, ...]:
        """Say which coordinates are looked at, and where the curvature of paths is uncertain."""
        return curvature_notes(motion.trajectory)

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give what the stiffness law needs."""
        return self.stiffness_law.data(motion)

    def rows(self, frame: Frame, motion: Motion) -> MatrixRows:
        """Give the Hessian, in N·m/rad; the stiffness of every muscle [N/m] beside it."""
        names = self.row_names(motion)
        stiffness = self.stiffness_law.stiffness(frame, motion)
        matrices, constant = self.terms(motion).triangles()
        return MatrixRows(
            weights=ca.vertcat(frame.muscle.tendon_force, stiffness),
            matrices=matrices,
            constant=constant,
            lower=self.by_row(self.level, names),
            names=names,
            unit="N·m/rad",
            scale=STABILITY_SCALE,
            price=self.soft,
            quantities={"muscle_stiffness": stiffness},
        )
