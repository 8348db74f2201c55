"""Bounds that rows with the frame before keep by themselves: they have no multipliers of their own."""

from __future__ import annotations

import numpy as np

from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.validation import BoolArray, IntArray

#: What a row keeps may be short of a bound by this much of it, or of one: rounding [-].
_ROUNDING = 1e-12


def bounds_kept_by_rows(program: FrameProgram, is_free: BoolArray) -> IntArray:
    r"""Tell which bounds follow from a row of two frames, in which the earlier frame may move.

    Activations that fall no faster than :math:`a_{k+1} - a_\min \ge c\,(a_k - a_\min)` stay above their least
    because they start there. Where they fall as fast as they may, they come as near to it as numbers can be
    told apart, and bound and row together would have multipliers that are not unique.

    Parameters
    ----------
    program : FrameProgram
    is_free : ndarray of bool, shape (n_frames, size)
        Unknowns that are not at their bounds.

    Returns
    -------
    ndarray of int, shape (2, n_frames, size)
        Number of the row that keeps the lower or upper bound, -1 for none. None in the first frame: what is
        kept follows from what is left. An unknown that has rested at its bound from the first frame on is
        held by its bound.
    """
    affine, size = program.split.affine_pairs, program.layout.size
    if not affine.values.size:
        return np.full((2, *is_free.shape), -1)
    keepers = _keepers(program)
    place, earlier = affine.place[affine.row], np.flatnonzero(affine.column < size)
    kept = keepers >= 0
    is_free = is_free.copy()
    for k in np.flatnonzero(kept.any(axis=(0, 2))):
        moves = (affine.values[k - 1, earlier] != 0) & is_free[k - 1, affine.column[earlier]]
        is_moving = np.zeros(affine.rows.size, dtype=bool)
        is_moving[place[earlier[moves]]] = True
        kept[:, k] &= is_moving[keepers[:, k]]
        is_free[k] |= kept[:, k].any(axis=0)
    return np.where(kept, affine.rows[keepers] if affine.rows.size else -1, -1)


def _keepers(program: FrameProgram) -> IntArray:
    """Place of the row that keeps a lower or upper bound, shape (2, n_frames, size); -1 for none."""
    lower, upper = program.bounds()
    affine, table, size = program.split.affine_pairs, program.pair_rows, program.layout.size
    found = np.full((2, *lower.shape), -1)
    slope, place, is_later = affine.values, affine.place[affine.row], affine.column >= size
    low, high = (np.hstack([bound[:-1], bound[1:]])[:, affine.column] for bound in (lower, upper))
    is_own = (slope != 0) & ~is_later
    with np.errstate(invalid="ignore"):  # no slope times no bound
        ends = np.sort([np.where(is_own, slope * bound, 0.0) for bound in (low, high)], axis=0)
    least, most = (affine.by_row(end) for end in ends)
    is_alone = (slope != 0) & is_later & (affine.by_row((slope != 0) & is_later) == 1)[:, place]
    pair, entry = np.nonzero(is_alone)
    row, own = place[entry], slope[pair, entry]
    number, constant = affine.rows[row], affine.constant[pair, row]
    at_least = (table.lower[number] - constant - most[pair, row]) / own
    at_most = (table.upper[number] - constant - least[pair, row]) / own
    where = (pair + 1, affine.column[entry] - size)
    kept = np.sort([at_least, at_most], axis=0)
    for side, bound in enumerate((lower[where], upper[where])):
        short = _ROUNDING * np.maximum(1.0, np.abs(bound))
        enough = kept[0] >= bound - short if side == 0 else kept[1] <= bound + short
        enough &= np.isfinite(bound) & np.isfinite(kept[side]) & (lower[where] < upper[where])
        found[side, where[0][enough], where[1][enough]] = row[enough]
    return found
