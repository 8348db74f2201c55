"""Derivatives of pieces by what is given: data of every frame, and constants that are symbols."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.transcription.layout import Given
from scso_nlp.transcription.piece import Key, Piece, Seen, jacobian_by_rows
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


def mixed_by_data(
    piece: Piece,
    used: Mapping[Key, IntArray],
    seen: Seen,
    multipliers: FloatArray | None = None,
) -> tuple[list[Slopes], list[Slopes]]:
    """Differentiate a piece by entries of arrays, and then the sum of its rows by its unknowns.

    In this order expressions stay small: few of them have the entries that are asked for.

    Parameters
    ----------
    piece : Piece
    used : mapping of (owner, name) to ndarray of int
        Entries of a frame, in their order.
    seen : Seen
        What the piece sees.
    multipliers : ndarray, shape (n, n_rows), optional
        By what rows count in the sum; one by default.

    Returns
    -------
    of_rows, of_gradient : list of Slopes
        Of the rows, and of the gradient of their sum by all unknowns.
    """
    rows, first = piece.expression.numel(), _first(piece, used)
    more = None if multipliers is None else ca.SX.sym("multiplier", rows)
    weight = ca.SX.ones(rows) if more is None else more
    second = []
    for part in first:
        of_sum = ca.jacobian(part.entries.T @ weight, piece.all_unknowns)
        place, row = (np.array(v, dtype=np.int64) for v in of_sum.sparsity().get_triplet())
        if row.size:
            second.append(replace(part, entries=of_sum, row=row, entry=used[part.key][place]))
    parts = first + second
    values = seen.evaluate_once([part.entries.nz[:] for part in parts], more, multipliers)
    return _slopes(first, values[: len(first)]), _slopes(second, values[len(first) :])


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Derivatives by one array in symbols, see :class:`Slopes`."""

    key: Key
    offset: int
    row: IntArray
    entry: IntArray
    entries: ca.SX


def _slopes(parts: Sequence[_Part], values: Sequence[FloatArray]) -> list[Slopes]:
    return [
        Slopes(key=part.key, offset=part.offset, row=part.row, entry=part.entry, values=numbers)
        for part, numbers in zip(parts, values, strict=True)
    ]


def _first(piece: Piece, used: Mapping[Key, IntArray]) -> list[_Part]:
    """Differentiate by all arrays in question; those without entries are left out."""
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
        if row.size:
            entry = entries[place]
            part = _Part(key=given.key, offset=given.offset, row=row, entry=entry, entries=jacobian)
            found.append(part)
    return found


def by_data_and_unknowns(
    piece: Piece, used: Mapping[Key, IntArray], seen: Seen
) -> tuple[list[Slopes], tuple[IntArray, IntArray, FloatArray]]:
    """Differentiate a piece by entries of arrays, and by its unknowns.

    By unknowns all rows at once: for columns of which each entry has unknowns of its own, as forces of
    muscles.

    Returns
    -------
    by_data : list of Slopes
    by_unknowns : (row, column, entries)
        With entries of shape (n, n_entries).
    """
    matrix = ca.jacobian(piece.expression, piece.all_unknowns)
    row, column = (np.array(v, dtype=np.int64) for v in matrix.sparsity().get_triplet())
    parts = _first(piece, used)
    entries, *values = seen.evaluate_once([matrix.nz[:], *(part.entries.nz[:] for part in parts)])
    return _slopes(parts, values), (row, column, entries)
