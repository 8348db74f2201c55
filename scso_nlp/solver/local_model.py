"""The problem near a point, in numbers: what is needed to choose rows of a matrix inequality.

Arrays only, one entry per frame; unknowns are the solver's scaled ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.solver.conic import MatrixProgram
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import Derivatives, curved, first_order, second_order
from scso_nlp.transcription.turns import MatrixModel, matrix_models, part_of
from scso_nlp.validation import FloatArray, IntArray

#: Hessian (n_frames, n, n) and linear term (n_frames, n) of a quadratic cost.
Quadratic = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, kw_only=True)
class LocalModel:
    """Functions of objective, rows and matrix inequalities, made once and evaluated near many points.

    Attributes
    ----------
    program : FrameProgram
        As described, without turns.
    costs : tuple of Derivatives
        One-frame objectives with gradient and Hessian.
    pair_costs : tuple of (int, Derivatives)
        Two-frame objectives by the unknowns of the earlier (0) or later (1) frame.
    curved_rows : tuple of (Derivatives, ndarray of int)
        Nonlinear one-frame rows with their Jacobians, and their numbers.
    matrices : tuple of MatrixModel
    is_quadratic : bool
        True if the one-frame objective is at most quadratic and all one-frame rows and matrices are affine:
        then the model is exact everywhere.
    """

    program: FrameProgram
    costs: tuple[Derivatives, ...]
    pair_costs: tuple[tuple[int, Derivatives], ...]
    curved_rows: tuple[tuple[Derivatives, IntArray], ...]
    matrices: tuple[MatrixModel, ...]
    is_quadratic: bool

    def objective(self, unknowns: FloatArray, frames: IntArray) -> Quadratic:
        """Quadratic model of the one-frame objective of the given frames at their unknowns."""
        n_frames, n = unknowns.shape
        hessian, gradient = np.zeros((n_frames, n, n)), np.zeros((n_frames, n))
        arrays = part_of(self.program, frames)
        for cost in self.costs:
            first, second = cost.at(unknowns, arrays)
            hessian[:, cost.row, cost.column] += second
            gradient += first
        return hessian, gradient - np.einsum("kij,kj->ki", hessian, unknowns)

    def coupling(self, unknowns: FloatArray) -> Quadratic:
        """Give what two-frame objectives add to every frame while its neighbours stay where they are."""
        n_frames, n = unknowns.shape
        hessian, linear = np.zeros((n_frames, n, n)), np.zeros((n_frames, n))
        for offset, cost in self.pair_costs:
            first, second = cost.at(unknowns, self.program.arrays)
            own = slice(offset, offset + n_frames - 1)
            part = np.zeros((n_frames - 1, n, n))
            part[:, cost.row, cost.column] = second
            hessian[own] += part
            linear[own] += first - np.einsum("kij,kj->ki", part, unknowns[own])
        return hessian, linear

    def rows(self, unknowns: FloatArray, frames: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Matrix (n_frames, n_rows, n), lower and upper bounds (n_frames, n_rows) of one-frame rows.

        Nonlinear rows are linearised. Affine rows that have no unknown in any frame of the program are left
        out: the same ones whichever frames are asked for.
        """
        n_frames, n = unknowns.shape
        affine, table = self.program.split.affine.frames(frames), self.program.rows
        kept = ~self.program.split.affine.is_empty.all(axis=0)
        matrices, constants = [affine.dense(n)[:, kept]], [affine.constant[:, kept]]
        numbers = [affine.rows[kept]]
        arrays = part_of(self.program, frames)
        for derivatives, rows in self.curved_rows:
            value, slopes = derivatives.at(unknowns, arrays)
            slope = np.zeros((n_frames, rows.size, n))
            slope[:, derivatives.row, derivatives.column] = slopes
            matrices.append(slope)
            constants.append(value - np.einsum("krj,kj->kr", slope, unknowns))
            numbers.append(rows)
        number, constant = np.concatenate(numbers), np.concatenate(constants, axis=1)
        lower, upper = table.lower[number] - constant, table.upper[number] - constant
        return np.concatenate(matrices, axis=1), lower, upper

    def matrix_program(
        self,
        matrix: MatrixModel,
        unknowns: FloatArray,
        frames: IntArray,
        coupling: Quadratic | None = None,
        elsewhere: MatrixProgram | None = None,
    ) -> MatrixProgram:
        """Model the given frames around their unknowns: cost, rows, bounds and one matrix inequality.

        `elsewhere` models the same frames around other unknowns: what is affine is taken from there.
        """
        quadratic, linear = self.objective(unknowns, frames)
        if coupling is not None:
            quadratic, linear = quadratic + coupling[0][frames], linear + coupling[1][frames]
        if elsewhere is not None and matrix.is_affine and not self.curved_rows:
            return replace(elsewhere, quadratic=quadratic, linear=linear)
        rows, least, most = self.rows(unknowns, frames)
        equal = (least == most).all(axis=0)
        lower, upper = self.program.bounds()
        value, matrices = matrix.model(unknowns, part_of(self.program, frames))
        return MatrixProgram(
            quadratic=quadratic,
            linear=linear,
            equations=rows[:, equal],
            targets=least[:, equal],
            rows=np.concatenate([rows[:, ~equal], -rows[:, ~equal]], axis=1),
            least=np.concatenate([least[:, ~equal], -most[:, ~equal]], axis=1),
            lower=lower[frames],
            upper=upper[frames],
            matrices=matrices,
            constant=value - np.einsum("kxij,kx->kij", matrices, unknowns),
        )


def local_model(program: FrameProgram) -> LocalModel:
    """Make the functions of a problem's derivatives.

    Parameters
    ----------
    program : FrameProgram

    Returns
    -------
    LocalModel
    """
    alone = [piece for _, piece in program.objectives if not piece.is_pair]
    pairs = [piece for _, piece in program.objectives if piece.is_pair]
    costs = tuple(piece.curvature for piece in alone)
    curved_rows = tuple(
        (first_order(piece), rows) for piece, rows in program.split.nonlinear if not piece.is_pair
    )
    matrices = matrix_models(program)
    return LocalModel(
        program=program,
        costs=costs,
        pair_costs=tuple(
            (offset, second_order(piece, x)) for piece in pairs for offset, x in enumerate(piece.unknowns)
        ),
        curved_rows=curved_rows,
        matrices=matrices,
        is_quadratic=not curved_rows
        and all(matrix.is_affine for matrix in matrices)
        and not any(any(curved(cost.values, cost.piece.unknowns[0])) for cost in costs),
    )
