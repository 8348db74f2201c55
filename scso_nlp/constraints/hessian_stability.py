"""Stability along any combination of coordinates: the Hessian minus levels is positive semi-definite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from scso_nlp.constraints.stability_constraint import STABILITY_SCALE, StabilityConstraint
from scso_nlp.stability.critical_turns import (
    MatrixProgram,
    critical_turns,
    highest_eigenvalues,
    solve_matrix_programs,
)
from scso_nlp.stability.hessian import (
    HessianTerms,
    describe_turn,
    hessian_terms,
    require_curvature,
    rows_along,
)
from scso_nlp.stability.rows import StabilityRows
from scso_nlp.transcription.frame import Frame, Rows, VariableSpec
from scso_nlp.validation import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem
    from scso_nlp.solution import Solution
    from scso_nlp.transcription.local_model import LocalModel

#: An eigenvalue below its level by less than this counts as kept [N·m/rad].
EIGENVALUE_TOLERANCE = 1e-6 * STABILITY_SCALE

#: Frames whose deciding turns are sought together; bounds the memory.
FRAMES_PER_BATCH = 64


@dataclass(frozen=True, kw_only=True)
class HessianStability(StabilityConstraint):
    r"""The Hessian over the chosen coordinates is positive semi-definite.   depends on: one frame.

    .. math:: H - \operatorname{diag}(\text{level}) \succeq 0

    A matrix inequality is the set of rows :math:`v^T (H - \operatorname{diag}(\text{level}))\, v \ge 0` for
    all turns v. The constraint holds a few of them per frame: those in the null space of the Hessian at
    the optimum of the problem's quadratic model, with which the rows alone have the same optimum as the
    matrix inequality, and eigenvectors of negative eigenvalues, added until there are none.

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
    doubtful : tuple of int
        Frames in which no Hessian above its levels was found; the solver tests them first.

    References
    ----------
    Bergmark (1989), Acta Orthop Scand 60 Suppl 230; Cholewicki and McGill (1996), Clin Biomech 11:1-15.
    """

    coordinates: Sequence[str] | None = None
    model_passive: bool = True
    passive_matrix: FloatArray | None = None
    directions: FloatArray | None = field(default=None, repr=False)
    doubtful: tuple[int, ...] = field(default=(), repr=False)

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
        """Names of the rows: the coordinates alone, or numbered turns that differ from frame to frame."""
        if self.directions is None:
            return self.chosen(problem)
        return tuple(f"turn_{i + 1}" for i in range(self.directions.shape[1]))

    def doubtful_frames(self, problem: MuscleForceProblem) -> tuple[int, ...]:
        """Name the frames in which no Hessian above its levels was found."""
        return self.doubtful

    def row_label(self, problem: MuscleForceProblem, frame: int, row: int) -> str | None:
        """Describe the turn of a row by coordinate."""
        return describe_turn(self.chosen(problem), self._directions(problem)[frame, row])

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

    def tighten(self, problem: MuscleForceProblem, near: LocalModel) -> HessianStability | None:
        """Add the turns that decide near a point, and those that a solution does not withstand."""
        terms = self.terms(problem)
        old = self._directions(problem)
        if not near.is_solution:
            turns, found, doubtful = self._deciding_turns(terms, near, np.arange(len(near.usable)))
            width = max(turns.shape[1], 0 if found.all() else old.shape[1])
            directions = np.zeros((len(found), width, old.shape[2]))
            directions[:, : turns.shape[1]] = turns
            if not found.all():
                directions[~found, : old.shape[1]] = old[~found]
            return replace(self, directions=directions, doubtful=tuple(int(k) for k in doubtful))
        force, _ = near.tendon_force()
        stiffness, _ = near.quantity(f"{self.name}.muscle_stiffness")
        missed = self._missed(near)
        hessian = terms.hessian(force, stiffness) + missed[:, None, None] * np.eye(len(terms.coordinates))
        values, vectors = np.linalg.eigh(np.where(near.usable[:, None, None], hessian, 0.0))
        negative = values < -EIGENVALUE_TOLERANCE
        if not negative.any():
            return None
        # Eigenvalues rise, so the negative ones come first.
        most = int(negative.sum(axis=1).max())
        unstable = np.where(negative[:, :most, None], vectors.transpose(0, 2, 1)[:, :most], 0.0)
        turns, _, _ = self._deciding_turns(terms, near, np.flatnonzero(negative.any(axis=1)))
        return replace(self, directions=np.concatenate([old, unstable, turns], axis=1))

    def _missed(self, near: LocalModel) -> FloatArray:
        block = near.block(self.name, "missed")
        if block is None:
            return np.zeros(len(near.unknowns))
        return near.unknowns[:, block.start] * STABILITY_SCALE

    def _deciding_turns(
        self, terms: HessianTerms, near: LocalModel, frames: IntArray
    ) -> tuple[FloatArray, BoolArray, IntArray]:
        """Find the null space of the Hessian at the optimum, by a model of the problem without coupling.

        Where there is no optimum, the turns are those that are left unstable at the highest eigenvalue.

        Returns
        -------
        turns : ndarray, shape (n_frames, n_turns, n)
            Unit vectors of the null space and their sums and differences; zeros where there are fewer.
        found : ndarray of bool, shape (n_frames,)
        doubtful : ndarray of int
            Frames whose highest eigenvalue is negative.
        """
        size = len(terms.coordinates)
        found = np.zeros(len(near.usable), dtype=bool)
        multiplier = np.zeros((found.size, size, size))
        doubtful = [np.zeros(0, dtype=np.int64)]
        lower, upper = near.bounds()
        for part in np.array_split(frames, max(1, -(-frames.size // FRAMES_PER_BATCH))):
            model, part_terms = near.frames(part), terms.frames(part)
            bounds = lower[part], upper[part]

            def program(
                unknowns: FloatArray,
                which: IntArray,
                model: LocalModel = model,
                terms: HessianTerms = part_terms,
                bounds: tuple[FloatArray, FloatArray] = bounds,
            ) -> MatrixProgram:
                here = model.frames(which).at(unknowns)
                return self.matrix_program(terms.frames(which), here, (bounds[0][which], bounds[1][which]))

            first = program(model.unknowns, np.arange(part.size))
            if near.is_quadratic:
                answer = solve_matrix_programs(first)
            else:
                answer = solve_matrix_programs(first, program, model.unknowns)
            multiplier[part] = np.where(answer.is_solved[:, None, None], answer.multiplier, 0.0)
            found[part] = answer.is_solved
            lost = np.flatnonzero(~answer.is_solved)
            if lost.size and near.is_quadratic:
                raised = program(model.unknowns[lost], lost)
                best = highest_eigenvalues(raised)
                hessian = raised.constant + np.einsum("kxij,kx->kij", raised.matrices, best.x)
                short = np.zeros(lost.size, dtype=bool)
                least = np.linalg.eigvalsh(hessian[best.is_solved])[:, 0]
                short[best.is_solved] = least < -EIGENVALUE_TOLERANCE
                beyond = part[lost[short]]
                multiplier[beyond], found[beyond] = best.multiplier[short], True
                doubtful.append(beyond)
        return critical_turns(multiplier), found, np.concatenate(doubtful)

    def matrix_program(
        self, terms: HessianTerms, near: LocalModel, bounds: tuple[FloatArray, FloatArray]
    ) -> MatrixProgram:
        """Model the problem around a point: its cost, rows and bounds, and the Hessian minus levels.

        Parameters
        ----------
        terms : HessianTerms
        near : LocalModel
            Of the same frames, with this constraint among its terms.
        bounds : pair of ndarray, shape (n_frames, n_unknowns)
            Of the scaled unknowns.

        Returns
        -------
        MatrixProgram
        """
        n_frames, n = near.unknowns.shape
        eye = np.eye(len(terms.coordinates))
        force, force_slope = near.tendon_force()
        stiffness, stiffness_slope = near.quantity(f"{self.name}.muscle_stiffness")
        quadratic, linear = near.objective()
        rows, least, most = near.rows(without=self.name)
        equal = (least == most).all(axis=0)
        matrices = np.zeros((n_frames, n, *eye.shape))
        for m, j, value in zip(force_slope.row, force_slope.column, force_slope.values.T, strict=True):
            matrices[:, j] += value[:, None, None] * terms.curvature[:, :, :, m]
        for m, j, value in zip(
            stiffness_slope.row, stiffness_slope.column, stiffness_slope.values.T, strict=True
        ):
            arm = terms.moment_arms[:, :, m]
            matrices[:, j] += value[:, None, None] * arm[:, :, None] * arm[:, None, :]
        missed = near.block(self.name, "missed")
        if missed is not None:
            matrices[:, missed.start] += STABILITY_SCALE * eye
        now = terms.hessian(force, stiffness) + self._missed(near)[:, None, None] * eye
        return MatrixProgram(
            quadratic=quadratic,
            linear=linear,
            equations=rows[:, equal],
            targets=least[:, equal],
            rows=np.concatenate([rows[:, ~equal], -rows[:, ~equal]], axis=1),
            least=np.concatenate([least[:, ~equal], -most[:, ~equal]], axis=1),
            lower=bounds[0],
            upper=bounds[1],
            matrices=matrices,
            constant=now - np.einsum("kxij,kx->kij", matrices, near.unknowns),
        )
