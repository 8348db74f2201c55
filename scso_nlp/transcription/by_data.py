"""Derivatives of pieces by what is given: data of every frame, and constants that are symbols."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.transcription.layout import Given
from scso_nlp.transcription.piece import Key, Piece, evaluate_once, jacobian_by_rows
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
        given=(*piece.given, Given(key=MULTIPLIERS, symbol=weight)),
    )


def by_data(
    piece: Piece, used: Mapping[Key, IntArray], unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
) -> list[Slopes]:
    """Differentiate a piece by entries of arrays, those of a frame in their order, at (n_frames, size)."""
    return _evaluated(piece, [_first(piece, used)], unknowns, arrays)[0]


def mixed_by_data(
    piece: Piece,
    used: Mapping[Key, IntArray],
    unknowns: FloatArray,
    arrays: Mapping[Key, FloatArray],
    multipliers: FloatArray | None = None,
) -> tuple[list[Slopes], list[Slopes]]:
    """Differentiate a piece by entries of arrays, and then the sum of its rows by its unknowns.

    In this order expressions stay small: few of them have the entries that are asked for.

    Parameters
    ----------
    piece : Piece
    used : mapping of (owner, name) to ndarray of int
        Entries of a frame, in their order.
    unknowns : ndarray, shape (n_frames, size)
    arrays : mapping of (owner, name) to ndarray
    multipliers : ndarray, shape (n, n_rows), optional
        By what rows count in the sum; one by default.

    Returns
    -------
    of_rows, of_gradient : list of Slopes
        Of the rows, and of the gradient of their sum by all unknowns.
    """
    rows, first = piece.expression.numel(), _first(piece, used)
    weight = ca.SX.ones(rows)
    if multipliers is not None:
        weight = ca.SX.sym("multiplier", rows)
        piece = replace(piece, given=(*piece.given, Given(key=MULTIPLIERS, symbol=weight)))
        arrays = {**arrays, MULTIPLIERS: multipliers}
    second = []
    for part in first:
        of_sum = ca.jacobian(part.entries.T @ weight, piece.all_unknowns)
        place, row = (np.array(v, dtype=np.int64) for v in of_sum.sparsity().get_triplet())
        second.append(replace(part, entries=of_sum, row=row, entry=used[part.key][place]))
    of_rows, of_gradient = _evaluated(piece, [first, second], unknowns, arrays)
    return of_rows, of_gradient


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Derivatives by one array in symbols, see :class:`Slopes`."""

    key: Key
    offset: int
    row: IntArray
    entry: IntArray
    entries: ca.SX


def _first(piece: Piece, used: Mapping[Key, IntArray]) -> list[_Part]:
    found = []
    for given in piece.given:
        if given.key not in used:
            continue
        entries = place = used[given.key]
        if given.entries is not None:
            assert np.isin(entries, given.entries).all(), given.key
            place = np.searchsorted(given.entries, entries)
        chosen = given.symbol[place.tolist()]
        is_wide = piece.expression.numel() < chosen.numel()
        jacobian = (jacobian_by_rows if is_wide else ca.jacobian)(piece.expression, chosen)
        row, place = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
        part = _Part(key=given.key, offset=given.offset, row=row, entry=entries[place], entries=jacobian)
        found.append(part)
    return found


def _evaluated(
    piece: Piece, lists: Sequence[Sequence[_Part]], unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
) -> list[list[Slopes]]:
    """Evaluate several lists of derivatives together; those without entries are left out."""
    lists = [[part for part in parts if part.row.size] for parts in lists]
    columns = [part.entries.nz[:] for parts in lists for part in parts]
    values = iter(evaluate_once(piece, columns, unknowns, arrays) if columns else ())
    return [
        [Slopes(key=p.key, offset=p.offset, row=p.row, entry=p.entry, values=next(values)) for p in parts]
        for parts in lists
    ]


def by_unknowns(
    piece: Piece, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows, columns and entries (n, n_entries) of the derivatives of a piece by its unknowns.

    All rows at once: for columns of which each entry has unknowns of its own, as forces of muscles.
    """
    matrix = ca.jacobian(piece.expression, piece.all_unknowns)
    row, column = (np.array(v, dtype=np.int64) for v in matrix.sparsity().get_triplet())
    return row, column, evaluate_once(piece, [matrix.nz[:]], unknowns, arrays)[0]
