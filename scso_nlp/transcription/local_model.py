"""The problem near a point, in numbers: what a constraint needs to choose further rows.

Arrays only, one entry per frame; unknowns are the solver's scaled ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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
class Derivatives:
    """A piece's value and further derivatives as one function, made once and evaluated at many points."""

    piece: Piece
    function: ca.Function
    row: IntArray
    column: IntArray


@dataclass(frozen=True, kw_only=True)
class LocalModel:
    """Objective, rows and muscle quantities near a point.

    Attributes
    ----------
    program : FrameProgram
    split : SplitRows
    unknowns : ndarray, shape (n_frames, n)
        The point.
    is_solution : bool
        False at the starting point.
    usable : ndarray of bool, shape (n_frames,)
        Frames that are solved (all of them at the starting point).
    is_quadratic : bool
        True if the objective is at most quadratic and rows, tendon forces and quantities are affine: then
        the model is exact everywhere.
    costs : tuple of Derivatives
        One-frame objectives with gradient and Hessian.
    columns : mapping of str to Derivatives
        Tendon forces and quantities with their Jacobians, by name.
    curved_rows : tuple of (Derivatives, ndarray of int)
        Nonlinear one-frame rows with their Jacobians, and their numbers.
    coupling : pair of ndarray, shapes (n_frames, n, n) and (n_frames, n)
        Hessian and linear term that objectives of two frames add to each frame while its neighbours
        stay at the point.
    """

    program: FrameProgram
    split: SplitRows
    unknowns: FloatArray
    is_solution: bool
    usable: BoolArray
    is_quadratic: bool
    costs: tuple[Derivatives, ...]
    columns: dict[str, Derivatives]
    curved_rows: tuple[tuple[Derivatives, IntArray], ...]
    coupling: tuple[FloatArray, FloatArray]

    def frames(self, which: IntArray) -> LocalModel:
        """Keep some frames, without the rows and data of pairs."""
        n_frames = len(self.unknowns)
        arrays = {key: a[which] for key, a in self.program.arrays.items() if len(a) == n_frames}
        affine = self.split.affine
        affine = replace(
            affine,
            values=affine.values[which],
            constant=affine.constant[which],
            is_empty=affine.is_empty[which],
        )
        return replace(
            self,
            program=replace(self.program, arrays=arrays),
            split=replace(self.split, affine=affine),
            unknowns=self.unknowns[which],
            usable=self.usable[which],
            coupling=(self.coupling[0][which], self.coupling[1][which]),
        )

    def at(self, unknowns: FloatArray) -> LocalModel:
        """Look near another point; coupling stays as it is."""
        return replace(self, unknowns=unknowns)

    def objective(self) -> tuple[FloatArray, FloatArray]:
        """Hessian (n_frames, n, n) and linear term (n_frames, n) of the objective's quadratic model."""
        n_frames, n = self.unknowns.shape
        hessian, gradient = np.zeros((n_frames, n, n)), np.zeros((n_frames, n))
        for cost in self.costs:
            first, second = evaluate(cost.piece, cost.function, self.unknowns, self.program.arrays)
            hessian[:, cost.row, cost.column] += second
            gradient += first
        linear = gradient - np.einsum("kij,kj->ki", hessian, self.unknowns)
        return hessian + self.coupling[0], linear + self.coupling[1]

    def rows(self, without: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Matrix (n_frames, n_rows, n), lower and upper bounds (n_frames, n_rows) of one-frame rows.

        Nonlinear rows are linearised. Rows of the term `without` and affine rows that have no unknown in
        any frame are left out.
        """
        affine = self.split.affine
        n_frames, n = self.unknowns.shape
        lower, upper = bounds_of_rows(self.program, pair=False)
        terms = np.array(
            [block.term for block in self.program.row_blocks if not block.is_pair for _ in block.names]
        )
        kept = (terms[affine.rows] != without) & ~affine.is_empty.all(axis=0)
        place = np.full(lower.size, -1)
        place[affine.rows[kept]] = np.arange(kept.sum())
        entries = place[affine.row] >= 0
        matrix = np.zeros((n_frames, int(kept.sum()), n))
        matrix[:, place[affine.row[entries]], affine.column[entries]] = affine.values[:, entries]
        parts, constants, numbers = [matrix], [affine.constant[:, kept]], [affine.rows[kept]]
        for derivatives, rows in self.curved_rows:
            own = terms[rows] != without
            value, slopes = evaluate(
                derivatives.piece, derivatives.function, self.unknowns, self.program.arrays
            )
            slope = np.zeros((n_frames, rows.size, n))
            slope[:, derivatives.row, derivatives.column] = slopes
            parts.append(slope[:, own])
            constants.append((value - np.einsum("krj,kj->kr", slope, self.unknowns))[:, own])
            numbers.append(rows[own])
        number, constant = np.concatenate(numbers), np.concatenate(constants, axis=1)
        return np.concatenate(parts, axis=1), lower[number] - constant, upper[number] - constant

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the unknowns of all frames of the problem, shape (n_frames, n)."""
        layout, n = self.program.layout, self.program.problem.trajectory.n_frames
        return layout.rows("lower", n) / layout.scale, layout.rows("upper", n) / layout.scale

    def tendon_force(self) -> tuple[FloatArray, SparseJacobian]:
        """Tendon forces [N] and their derivatives."""
        return self._column("tendon_force")

    def quantity(self, name: str) -> tuple[FloatArray, SparseJacobian]:
        """Give a quantity that a constraint reports, ``"<term>.<name>"``, and its derivatives."""
        return self._column(name)

    def block(self, owner: str, name: str) -> Block | None:
        """Find where a term's own unknowns stand, or None."""
        found = [b for b in self.program.layout.blocks if (b.owner, b.spec.name) == (owner, name)]
        return found[0] if found else None

    def _column(self, name: str) -> tuple[FloatArray, SparseJacobian]:
        column = self.columns[name]
        value, slopes = evaluate(column.piece, column.function, self.unknowns, self.program.arrays)
        return value, SparseJacobian(row=column.row, column=column.column, values=slopes)


def local_model(
    program: FrameProgram, split: SplitRows, unknowns: FloatArray, *, is_solution: bool, usable: BoolArray
) -> LocalModel:
    """Make the functions of a problem's derivatives, and look near a point.

    Parameters
    ----------
    program : FrameProgram
    split : SplitRows
    unknowns : ndarray, shape (n_frames, n)
        Scaled.
    is_solution : bool
    usable : ndarray of bool, shape (n_frames,)

    Returns
    -------
    LocalModel
    """
    costs = tuple(_second_order(piece) for _, piece in program.objectives if not piece.is_pair)
    columns = {"tendon_force": program.tendon_force, **program.quantities}
    curved = any(
        any(ca.which_depends(expression, ca.vertcat(*piece.unknowns), 2, True))
        for piece, expression in (
            *((cost.piece, ca.gradient(cost.piece.expression, cost.piece.unknowns[0])) for cost in costs),
            *((piece, piece.expression) for piece in columns.values()),
        )
    )
    curved_rows = tuple((_first_order(piece), rows) for piece, rows in split.nonlinear if not piece.is_pair)
    n_frames, n = unknowns.shape
    coupling = np.zeros((n_frames, n, n)), np.zeros((n_frames, n))
    if is_solution:
        pairs = [piece for _, piece in program.objectives if piece.is_pair]
        for piece in pairs:
            for offset, x in enumerate(piece.unknowns):
                derivatives = _second_order(piece, x)
                first, second = evaluate(piece, derivatives.function, unknowns, program.arrays)
                own = slice(offset, offset + n_frames - 1)
                hessian = np.zeros((n_frames - 1, n, n))
                hessian[:, derivatives.row, derivatives.column] = second
                coupling[0][own] += hessian
                coupling[1][own] += first - np.einsum("kij,kj->ki", hessian, unknowns[own])
    return LocalModel(
        program=program,
        split=split,
        unknowns=unknowns,
        is_solution=is_solution,
        usable=usable,
        is_quadratic=not (curved or curved_rows),
        costs=costs,
        columns={name: _first_order(piece) for name, piece in columns.items()},
        curved_rows=curved_rows,
        coupling=coupling,
    )


def _second_order(piece: Piece, x: ca.SX | None = None) -> Derivatives:
    """Gradient, and entries of the Hessian, by the only unknowns of a piece or by those given."""
    second, first = ca.hessian(piece.expression, piece.unknowns[0] if x is None else x)
    row, column = (np.array(v, dtype=np.int64) for v in second.sparsity().get_triplet())
    function = piece.function(ca.densify(first), _entries(second))
    return Derivatives(piece=piece, function=function, row=row, column=column)


def _first_order(piece: Piece) -> Derivatives:
    """Value, and entries of the Jacobian."""
    jacobian = ca.jacobian(piece.expression, piece.unknowns[0])
    row, column = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
    function = piece.function(ca.densify(piece.expression), _entries(jacobian))
    return Derivatives(piece=piece, function=function, row=row, column=column)


def _entries(matrix: ca.SX) -> ca.SX:
    return ca.vertcat(*matrix.nonzeros()) if matrix.nnz() else ca.SX(0, 1)
