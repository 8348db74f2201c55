"""The problem near a point, in numbers: what a constraint needs to choose further rows.

Arrays only, one entry per frame; unknowns are the solver's scaled ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.transcription.build import FrameProgram, Piece, SplitRows, bounds_of_rows, evaluate
from scso_nlp.transcription.layout import Block
from scso_nlp.validation import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class SparseJacobian:
    """Derivatives of a column by the unknowns: entries (row, column) with values (n_frames, n_entries)."""

    row: IntArray
    column: IntArray
    values: FloatArray


@dataclass(frozen=True, kw_only=True)
class LocalModel:
    """Objective, equations and muscle quantities near a point.

    Attributes
    ----------
    program : FrameProgram
    split : SplitRows
    unknowns : ndarray, shape (n_frames, n)
        The point, scaled.
    is_solution : bool
        False at the starting point.
    usable : ndarray of bool, shape (n_frames,)
        Frames that are solved (all of them at the starting point).
    """

    program: FrameProgram
    split: SplitRows
    unknowns: FloatArray
    is_solution: bool
    usable: BoolArray

    @property
    def is_quadratic(self) -> bool:
        """True if objective and quantities are no more than quadratic and affine: the model is exact."""
        curved = []
        for _, piece in self.program.objectives:
            x = ca.vertcat(*piece.unknowns)
            curved += ca.which_depends(ca.gradient(piece.expression, x), x, 2, True)
        for piece in (self.program.tendon_force, *self.program.quantities.values()):
            curved += ca.which_depends(piece.expression, ca.vertcat(*piece.unknowns), 2, True)
        return not any(curved)

    def objective(self) -> tuple[FloatArray, FloatArray]:
        """Hessian (n_frames, n, n) and linear term (n_frames, n) of the objective's quadratic model."""
        n_frames, n = self.unknowns.shape
        hessian, gradient = np.zeros((n_frames, n, n)), np.zeros((n_frames, n))
        for _, piece in self.program.objectives:
            if piece.is_pair:
                continue
            (x,) = piece.unknowns
            second, first = ca.hessian(piece.expression, x)
            row, column, values = self._entries(piece, second)
            hessian[:, row, column] += values
            gradient += evaluate(
                piece, piece.function(ca.densify(first)), self.unknowns, self.program.arrays
            )[0]
        linear = gradient - np.einsum("kij,kj->ki", hessian, self.unknowns)
        return hessian, linear

    def equations(self) -> tuple[FloatArray, FloatArray]:
        """Matrix (n_frames, n_equations, n) and targets of the affine equations of one frame."""
        affine = self.split.affine
        lower, upper = bounds_of_rows(self.program, pair=False)
        equal = affine.rows[(lower == upper)[affine.rows]]
        place = np.full(lower.size, -1)
        place[equal] = np.arange(equal.size)
        keep = place[affine.row] >= 0
        matrix = np.zeros((len(self.unknowns), equal.size, self.unknowns.shape[1]))
        matrix[:, place[affine.row[keep]], affine.column[keep]] = affine.values[:, keep]
        constant = affine.constant[:, np.isin(affine.rows, equal)]
        return matrix, lower[equal] - constant

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the unknowns, shape (n_frames, n)."""
        layout, n = self.program.layout, len(self.unknowns)
        return layout.rows("lower", n) / layout.scale, layout.rows("upper", n) / layout.scale

    def tendon_force(self) -> tuple[FloatArray, SparseJacobian]:
        """Tendon forces [N] and their derivatives."""
        return self._column(self.program.tendon_force)

    def quantity(self, name: str) -> tuple[FloatArray, SparseJacobian]:
        """Give a quantity that a constraint reports, ``"<term>.<name>"``, and its derivatives."""
        return self._column(self.program.quantities[name])

    def block(self, owner: str, name: str) -> Block | None:
        """Find where a term's own unknowns stand, or None."""
        found = [b for b in self.program.layout.blocks if (b.owner, b.spec.name) == (owner, name)]
        return found[0] if found else None

    def _column(self, piece: Piece) -> tuple[FloatArray, SparseJacobian]:
        value = evaluate(piece, piece.function(), self.unknowns, self.program.arrays)[0]
        row, column, values = self._entries(piece, ca.jacobian(piece.expression, piece.unknowns[0]))
        return value, SparseJacobian(row=row, column=column, values=values)

    def _entries(self, piece: Piece, matrix: ca.SX) -> tuple[IntArray, IntArray, FloatArray]:
        row, column = (np.array(v, dtype=np.int64) for v in matrix.sparsity().get_triplet())
        if row.size == 0:
            return row, column, np.zeros((len(self.unknowns), 0))
        function = piece.function(ca.vertcat(*matrix.nonzeros()))
        return row, column, evaluate(piece, function, self.unknowns, self.program.arrays)[0]
