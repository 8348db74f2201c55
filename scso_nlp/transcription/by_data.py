"""Derivatives of pieces by what is given: data of every frame, and constants that are symbols."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.transcription.piece import Key, Piece, evaluate, jacobian_by_rows
from scso_nlp.validation import FloatArray, IntArray

#: Where the multipliers of a weighted piece stand among the arrays.
MULTIPLIERS: Key = ("sensitivity", "multipliers")


@dataclass(frozen=True, kw_only=True)
class Slopes:
    """Derivatives of a column by one array, in all frames or pairs.

    `row` counts the entries of the column, `entry` those of one frame of the array in its own order; the
    frame is `offset` after that of the piece. `values` has shape (n, n_entries).
    """

    key: Key
    offset: int
    row: IntArray
    entry: IntArray
    values: FloatArray


def weighted(piece: Piece) -> Piece:
    """Sum of the rows of a piece times multipliers, which stand under :data:`MULTIPLIERS`."""
    weight = ca.SX.sym("multiplier", piece.expression.numel())
    return replace(
        piece,
        expression=ca.dot(weight, piece.expression),
        data=(*piece.data, (0, MULTIPLIERS)),
        symbols=(*piece.symbols, weight),
    )


def gradient(piece: Piece) -> Piece:
    """Gradient of a scalar piece by all its unknowns."""
    return replace(piece, expression=ca.densify(ca.gradient(piece.expression, piece.all_unknowns)))


def by_data(
    piece: Piece, used: Mapping[Key, IntArray], unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
) -> list[Slopes]:
    """Differentiate a piece by entries of arrays, those of a frame in their order, at (n_frames, size)."""
    found, columns = [], []
    for (offset, key), symbol in zip(piece.data, piece.symbols, strict=True):
        if key not in used:
            continue
        down, across = np.divmod(used[key], symbol.size2())
        chosen = ca.vec(symbol)[(across * symbol.size1() + down).tolist()]
        is_wide = piece.expression.numel() < chosen.numel()
        jacobian = (jacobian_by_rows if is_wide else ca.jacobian)(piece.expression, chosen)
        row, place = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
        if row.size:
            found.append((key, offset, row, used[key][place]))
            columns.append(jacobian.nz[:])
    if not found:
        return []
    values = evaluate(piece, piece.function(*columns), unknowns, arrays)
    return [
        Slopes(key=key, offset=offset, row=row, entry=entry, values=each)
        for (key, offset, row, entry), each in zip(found, values, strict=True)
    ]


def by_unknowns(
    piece: Piece, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows, columns and entries (n, n_entries) of the derivatives of a piece by its unknowns.

    All rows at once: for columns of which each entry has unknowns of its own, as forces of muscles.
    """
    matrix = ca.jacobian(piece.expression, piece.all_unknowns)
    row, column = (np.array(v, dtype=np.int64) for v in matrix.sparsity().get_triplet())
    return row, column, evaluate(piece, piece.function(matrix.nz[:]), unknowns, arrays)[0]
