"""Derivatives of a program with their known structure: CasADi need not find and colour it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from scso_nlp.transcription.piece import Piece, first_order
from scso_nlp.validation import IntArray


@dataclass(frozen=True, kw_only=True)
class Mapped:
    """A piece at all its frames, or pairs of frames, of a program.

    Attributes
    ----------
    piece : Piece
    inputs : tuple of ca.MX
        What its function takes, a column per frame.
    scale : ca.MX or None, shape (1, n_frames)
        What the unknowns are multiplied by before the piece sees them.
    """

    piece: Piece
    inputs: tuple[ca.MX, ...]
    scale: ca.MX | None

    @property
    def n(self) -> int:
        """How often the piece stands in the program."""
        return int(self.inputs[0].size2())

    @property
    def chain(self) -> ca.MX | float:
        """Derivative of what the piece sees by the unknowns."""
        return 1.0 if self.scale is None else self.scale

    @property
    def values(self) -> ca.MX:
        """Values, a column per frame."""
        return self.outputs(self.piece.function())

    def outputs(self, function: ca.Function, *more: ca.MX) -> ca.MX:
        """Evaluate a function of the piece, a column per frame."""
        return function.map(self.n)(*self.inputs, *more)


@dataclass(frozen=True, kw_only=True)
class Entries:
    """Entries of a sparse matrix that may be symbols; those with the same place add up."""

    row: IntArray
    column: IntArray
    values: ca.MX

    def matrix(self, n_rows: int, n_columns: int) -> ca.MX:
        """Assemble the matrix."""
        if not self.row.size:
            return ca.MX(n_rows, n_columns)
        place, first = np.unique(self.column * n_rows + self.row, return_inverse=True)
        column, row = np.divmod(place, n_rows)
        starts = np.searchsorted(column, np.arange(n_columns + 1))
        sparsity = ca.Sparsity(n_rows, n_columns, starts.tolist(), row.tolist())
        if place.size == first.size:
            order = np.empty(first.size, dtype=np.int64)
            order[first] = np.arange(first.size)
            is_ordered = (order[1:] > order[:-1]).all()
            return ca.MX(sparsity, self.values if is_ordered else self.values[order.tolist()])
        sums = sp.csc_matrix((np.ones(first.size), (first, np.arange(first.size))))
        pattern = ca.Sparsity(*sums.shape, sums.indptr.tolist(), sums.indices.tolist())
        return ca.MX(sparsity, ca.densify(ca.mtimes(ca.DM(pattern, sums.data), self.values)))


def derivative_functions(
    x: ca.MX,
    p: ca.MX,
    *,
    f: ca.MX,
    g: ca.MX,
    size: int,
    costs: Sequence[tuple[Mapped, ca.MX]],
    affine: Sequence[ca.MX],
    nonlinear: Sequence[Mapped],
) -> dict[str, ca.Function]:
    """Make the functions that IPOPT asks for, by their names in CasADi's options.

    Parameters
    ----------
    x, p : ca.MX
        Unknowns, frame after frame, and parameters.
    f, g : ca.MX
        Objective and rows: affine ones, then the nonlinear ones in their order.
    size : int
        Unknowns of a frame.
    costs : sequence of (Mapped, ca.MX)
        Objectives with the weights of their frames, shape (1, n).
    affine : sequence of ca.MX
        Matrices of the affine rows.
    nonlinear : sequence of Mapped

    Returns
    -------
    dict of str to ca.Function
        ``grad_f``, ``jac_g`` and ``hess_lag`` (upper triangle).
    """
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
    slope = ca.MX.zeros(size, x.numel() // size)
    curvature: list[Entries] = []
    for mapped, weights in costs:
        slope += _by_frame(_times(mapped.chain * weights, mapped.outputs(mapped.piece.slope())), size)
        curvature.append(_curvature(mapped, size, lam_f * mapped.chain**2 * weights, ca.MX.ones(1, mapped.n)))
    jacobian: list[Entries] = []
    n_affine = first = sum(matrix.size1() for matrix in affine)
    for mapped in nonlinear:
        n_rows = mapped.piece.expression.numel()
        derivatives = first_order(mapped.piece)
        entries = mapped.outputs(mapped.piece.function(derivatives.entries))
        frame = np.arange(mapped.n)[:, None]
        jacobian.append(
            Entries(
                row=(first - n_affine + frame * n_rows + derivatives.row).ravel(),
                column=(frame * size + derivatives.column).ravel(),
                values=ca.vec(_times(mapped.chain, entries)),
            )
        )
        multipliers = ca.reshape(lam_g[first : first + n_rows * mapped.n], n_rows, mapped.n)
        curvature.append(_curvature(mapped, size, mapped.chain**2, multipliers))
        first += n_rows * mapped.n
    curved_rows = _joined(jacobian).matrix(g.numel() - n_affine, x.numel())
    return {
        "grad_f": ca.Function("nlp_grad_f", [x, p], [f, ca.vec(slope)]),
        "jac_g": ca.Function("nlp_jac_g", [x, p], [g, ca.vertcat(*affine, curved_rows)]),
        "hess_lag": ca.Function(
            "nlp_hess_lag", [x, p, lam_f, lam_g], [_joined(curvature).matrix(x.numel(), x.numel())]
        ),
    }


def _by_frame(columns: ca.MX, size: int) -> ca.MX:
    """Add up what pairs of frames give to each of their frames."""
    if columns.size1() == size:
        return columns
    nothing = ca.MX.zeros(size, 1)
    return ca.horzcat(columns[:size, :], nothing) + ca.horzcat(nothing, columns[size:, :])


def _curvature(mapped: Mapped, size: int, factor: ca.MX | float, multipliers: ca.MX) -> Entries:
    """Upper triangle of the Hessian of what multipliers make of a piece, times a factor by frame."""
    piece = mapped.piece
    weight = ca.SX.sym("multiplier", piece.expression.numel())
    hessian, _ = ca.hessian(ca.dot(weight, piece.expression), piece.all_unknowns)
    upper = ca.triu(hessian)
    row, column = (np.array(v, dtype=np.int64) for v in upper.sparsity().get_triplet())
    if not row.size:
        return Entries(row=row, column=column, values=ca.MX(0, 1))
    entries = mapped.outputs(piece.function(ca.vertcat(*upper.nonzeros()), more=(weight,)), multipliers)
    frame = np.arange(mapped.n)[:, None] * size
    return Entries(
        row=(frame + row).ravel(), column=(frame + column).ravel(), values=ca.vec(_times(factor, entries))
    )


def _times(factor: ca.MX | float, columns: ca.MX) -> ca.MX:
    """Multiply each column by its factor."""
    return columns * (ca.repmat(factor, columns.size1(), 1) if isinstance(factor, ca.MX) else factor)


def _joined(parts: Sequence[Entries]) -> Entries:
    nothing = np.zeros(0, dtype=np.int64)
    return Entries(
        row=np.concatenate([nothing, *(part.row for part in parts)]),
        column=np.concatenate([nothing, *(part.column for part in parts)]),
        values=ca.vertcat(*(part.values for part in parts)),
    )
