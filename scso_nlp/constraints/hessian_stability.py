"""Stability along any combination of coordinates: the Hessian minus levels is positive semi-definite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from scso_nlp.constraints.stability_constraint import STABILITY_SCALE, StabilityConstraint
from scso_nlp.stability.hessian import HessianTerms, hessian_terms, require_curvature, rows_along
from scso_nlp.stability.rows import StabilityRows
from scso_nlp.transcription.frame import Frame, Rows, VariableSpec
from scso_nlp.validation import FloatArray

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem
    from scso_nlp.solution import Solution

#: An eigenvalue below its level by less than this counts as kept [N·m/rad].
EIGENVALUE_TOLERANCE = 1e-6 * STABILITY_SCALE


@dataclass(frozen=True, kw_only=True)
class HessianStability(StabilityConstraint):
    r"""The whole Hessian over the chosen coordinates is positive semi-definite above its levels.

    .. math:: H - \operatorname{diag}(\text{level}) \succeq 0

    A matrix inequality is the set of rows :math:`v^T (H - \operatorname{diag}(\text{level}))\, v \ge 0` for
    all turns v. The constraint holds a few of them per frame; after each solve :meth:`tighten` adds the
    eigenvectors of negative eigenvalues, until there are none.

    Attributes
    ----------
    coordinates : sequence of str or None
        None for all coordinates whose curvature was extracted.
    model_passive : bool
        Count the model's own springs, bushings, limit forces and ligaments.
    passive_matrix : ndarray, shape (n, n), or None [N·m/rad]
        Passive stiffness with coupling between coordinates, besides `passive_stiffness` by coordinate.
    directions : ndarray, shape (n_frames, n_directions, n), or None
        Rows so far; zeros where a frame has fewer. None: each coordinate alone.

    References
    ----------
    Bergmark (1989), Acta Orthop Scand 60 Suppl 230; Cholewicki and McGill (1996), Clin Biomech 11:1-15.
    """

    coordinates: Sequence[str] | None = None
    model_passive: bool = True
    passive_matrix: FloatArray | None = None
    directions: FloatArray | None = None

    def chosen(self, problem: MuscleForceProblem) -> tuple[str, ...]:
        """Names of the chosen coordinates."""
        if self.coordinates is not None:
            return tuple(self.coordinates)
        return require_curvature(problem.trajectory).coordinates

    def terms(self, problem: MuscleForceProblem) -> HessianTerms:
        """Collect what the Hessian minus its levels is made of."""
        names = self.chosen(problem)
        passive = np.diag(self.by_row(self.passive_stiffness or {}, names) - self.by_row(self.level, names))
        if self.passive_matrix is not None:
            passive = passive + np.asarray(self.passive_matrix, dtype=float)
        return hessian_terms(
            problem.trajectory, names, model_passive=self.model_passive, passive_stiffness=passive
        )

    def _directions(self, problem: MuscleForceProblem) -> FloatArray:
        n = len(self.chosen(problem))
        if self.directions is None:
            return np.broadcast_to(np.eye(n), (problem.trajectory.n_frames, n, n))
        return self.directions

    def row_names(self, problem: MuscleForceProblem) -> tuple[str, ...]:
        """Names of the rows: first the coordinates alone, then combined turns."""
        names = self.chosen(problem)
        more = self._directions(problem).shape[1] - len(names)
        return names + tuple(f"combined_turn_{i + 1}" for i in range(more))

    def stability_rows(self, problem: MuscleForceProblem) -> StabilityRows:
        """Curvature, moment arms and loads of the rows."""
        directions, names = self._directions(problem), self.row_names(problem)
        return rows_along(self.terms(problem), directions, names, problem.trajectory.muscles)

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Give the data of the rows; rows without a direction get a load that they keep."""
        rows = self.stability_rows(problem)
        absent = (self._directions(problem) == 0).all(axis=2)
        return {
            "curvature": rows.curvature,
            "squared_moment_arms": rows.moment_arms**2,
            "load": np.where(absent, -STABILITY_SCALE, rows.external_work),
            **self.stiffness_law.data(problem),
        }

    def variables(self, problem: MuscleForceProblem) -> tuple[VariableSpec, ...]:
        """Name the amount by which a soft Hessian misses its levels, one per frame."""
        if self.soft is None:
            return ()
        return (
            VariableSpec(
                name="missed", labels=("missed",), lower=0.0, guess=STABILITY_SCALE, scale=STABILITY_SCALE
            ),
        )

    def rows(self, frame: Frame, problem: MuscleForceProblem) -> Rows:
        """One row per direction: stability above the level, in N·m/rad."""
        value = self.stability(frame, problem)
        if self.soft is not None:
            value += frame.variables["missed"]
        return Rows(
            value=value,
            lower=0.0,
            upper=np.inf,
            names=self.row_names(problem),
            unit="N·m/rad",
            scale=STABILITY_SCALE,
        )

    def hessian(self, solution: Solution) -> FloatArray:
        """Hessian minus levels at a solution, shape (n_frames, n, n) [N·m/rad]."""
        stiffness = solution.quantities[f"{self.name}.muscle_stiffness"]
        return self.terms(solution.problem).hessian(solution.tendon_force, stiffness)

    def tighten(self, solution: Solution) -> HessianStability | None:
        """Add the turns that the solution does not withstand, or None if there are none."""
        hessian = self.hessian(solution)
        usable = solution.is_solved
        missed = solution.variables.get(f"{self.name}.missed", np.zeros((len(usable), 1)))
        hessian = np.where(usable[:, None, None], hessian + missed[:, :, None] * np.eye(hessian.shape[1]), 0.0)
        values, vectors = np.linalg.eigh(hessian)
        negative = (values < -EIGENVALUE_TOLERANCE) & usable[:, None]
        most = int(negative.sum(axis=1).max(initial=0))
        if most == 0:
            return None
        # Eigenvalues rise, so the negative ones come first.
        new = np.where(negative[:, :most, None], vectors.transpose(0, 2, 1)[:, :most], 0.0)
        old = self._directions(solution.problem)
        return replace(self, directions=np.concatenate([old, new], axis=1))

