"""Sparse equations of all frames: put together, scaled, factorised once, solved many times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from scso_nlp.validation import FloatArray, IntArray

#: What is added to equations that are exactly singular, so that the other frames have their answer.
_RIDGE = 1e-13
#: Products of rows with themselves square how near to dependent these are: beyond this, the first half of the
#: digits is lost [-].
_WELL_POSED = 1e8
#: Below this, no more than the last three of them.
_EXACT = 1e3
#: Rows that share unknowns, directly or through others, are one sparse matrix if they are more than this.
_MOST_ROWS = 100
_TINY = float(np.finfo(float).tiny)

#: Entries of a matrix of all frames, with their rows and columns, each of shape (n, n_entries).
Part = tuple[FloatArray, IntArray, IntArray]


@dataclass(frozen=True, kw_only=True)
class Linear:
    """The conditions near a point: scaled and factorised.

    Attributes
    ----------
    free : ndarray of int
        Places of the free unknowns among all unknowns.
    rows : ndarray of int
        Places of the active rows among all rows.
    frame : ndarray of int
        Frame of every equation.
    left : ndarray
        What the conditions are missed by.
    factors : Factors
    slope : sparse matrix, shape (n_all_rows, n_all_unknowns)
        Derivatives of all rows, those of matrices behind the others.
    """

    free: IntArray
    rows: IntArray
    frame: IntArray
    left: FloatArray
    factors: Factors
    slope: sp.csr_matrix = field(repr=False)

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve with right sides (n_equations, …), refined once unless factors are exact to rounding."""
        factors = self.factors
        scale = factors.scale.reshape(-1, *[1] * (right.ndim - 1))
        right = scale * right
        found = factors.solve(right)
        if not factors.is_exact:
            right -= factors.times(found)
            found += factors.solve(right)
        found *= scale
        return found

    def answer_to_noise(self, n_frames: int) -> FloatArray:
        """Give the largest answer of each frame to random right sides near one, in scaled equations."""
        rng = np.random.default_rng(0)
        noise = rng.choice([-1.0, 1.0], (self.frame.size, 2))
        found = np.maximum(*np.abs(self.factors.solve(noise)).T)
        largest = np.zeros(n_frames)
        np.maximum.at(largest, self.frame, np.nan_to_num(found, nan=np.inf))
        return largest


class Factors(Protocol):
    """Equations of unknowns and rows, scaled from both sides by `scale` (n_equations,), and factorised.

    `is_exact` tells that answers are so to rounding: they need not be refined.
    """

    scale: FloatArray
    is_exact: bool

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve the scaled equations."""

    def times(self, found: FloatArray) -> FloatArray:
        """Multiply by the scaled equations."""


def factorised(hessian: sp.csr_matrix, slopes: sp.csr_matrix, curvature: FloatArray) -> Factors:
    """Scale and factorise the equations with a Hessian and the slopes of rows.

    Parameters
    ----------
    hessian : sparse matrix, shape (n_free, n_free)
    slopes : sparse matrix, shape (n_rows, n_free)
    curvature : ndarray, shape (n_free,)
        Of costs, by each unknown.
    """
    diagonal = hessian.diagonal()
    if slopes.shape[0] and hessian.count_nonzero() == diagonal.size and (diagonal > _TINY).all():
        apart = _Apart(diagonal, slopes)
        if apart.is_well_posed:
            return apart
    return _Together(hessian, slopes, curvature)


class _Together:
    """Factors of the equations of all frames as one sparse matrix; next to them where it is singular."""

    is_exact = False

    def __init__(self, hessian: sp.csr_matrix, slopes: sp.csr_matrix, curvature: FloatArray) -> None:
        both = [[hessian, slopes.T], [slopes, None]]
        matrix = sp.bmat(both, format="csr") if slopes.shape[0] else hessian
        self.scale = _equilibrated(matrix, curvature)
        self.matrix = (sp.diags(self.scale) @ matrix @ sp.diags(self.scale)).tocsc()
        try:
            self.factors = splu(self.matrix)
        except RuntimeError:  # exactly singular
            ridge = np.where(np.arange(self.scale.size) < curvature.size, _RIDGE, -_RIDGE)
            self.factors = splu((self.matrix + sp.diags(ridge)).tocsc())

    def solve(self, right: FloatArray) -> FloatArray:
        return np.asarray(self.factors.solve(right))

    def times(self, found: FloatArray) -> FloatArray:
        return np.asarray(self.matrix @ found)


class _Apart:
    """Factors of equations with a diagonal Hessian: of small matrices, of rows that share unknowns.

    With curvatures scaled to one, and rows to a length of one, unknowns are x = y - B'm, where the
    multipliers m solve B B' m = B y - z. Rows of different frames share no unknown, nor do those of the two
    legs: B B' falls apart into groups of rows, which are inverted together where they are of one size.
    """

    def __init__(self, curvature: FloatArray, slopes: sp.csr_matrix) -> None:
        by_column = 1 / np.sqrt(curvature)
        entries = slopes.data * by_column[slopes.indices]
        row = np.repeat(np.arange(slopes.shape[0]), np.diff(slopes.indptr))
        length = np.sqrt(np.bincount(row, entries**2, minlength=slopes.shape[0]))
        by_row = 1 / np.where(length > 0, length, 1.0)
        self.scale = np.concatenate([by_column, by_row])
        self.rows = sp.csr_matrix((entries * by_row[row], slopes.indices, slopes.indptr), slopes.shape)
        self.columns = self.rows.T.tocsr()
        self.groups = _inverted(self.rows @ self.columns)
        largest = np.max([np.abs(inverse).max() for _, inverse in self.groups], initial=0.0)
        #: Groups are small, and rows far enough from dependent.
        self.is_well_posed = bool(self.groups) and bool(largest < _WELL_POSED)
        self.is_exact = bool(largest < _EXACT)

    def solve(self, right: FloatArray) -> FloatArray:
        y, z = np.split(right, [self.rows.shape[1]])
        pushed = self.rows @ y - z
        multipliers = np.empty_like(pushed)
        for members, inverse in self.groups:
            own = pushed[members]
            multipliers[members] = (inverse @ own.reshape(*members.shape, -1)).reshape(own.shape)
        return np.concatenate([y - self.columns @ multipliers, multipliers])

    def times(self, found: FloatArray) -> FloatArray:
        x, multipliers = np.split(found, [self.rows.shape[1]])
        return np.concatenate([x + self.columns @ multipliers, self.rows @ x])


def _inverted(products: sp.csr_matrix) -> list[tuple[IntArray, FloatArray]]:
    """Invert a matrix that falls apart into small ones; none where a group is large.

    Returns
    -------
    list of (members, inverse)
        Rows (n_groups, size) of all groups of one size, and their inverses (n_groups, size, size).
    """
    _, group = connected_components(products, directed=False)
    count = np.bincount(group)
    if count.max() > _MOST_ROWS:
        return []
    order = np.lexsort((group, count[group]))
    size = count[group][order]
    is_first = np.append(True, np.diff(group[order]) != 0)
    within, begin = np.empty_like(order), np.empty_like(order)  # place in its group; of a row in all matrices
    within[order] = np.arange(order.size) - np.flatnonzero(is_first)[np.cumsum(is_first) - 1]
    begin[order] = np.cumsum(size) - size
    products = products.tocoo()
    entries = np.zeros(size.sum())
    entries[begin[products.row] + within[products.col]] = products.data
    entries[begin + within] += _RIDGE
    found = []
    for n, first, length in zip(*np.unique(size, return_index=True, return_counts=True), strict=True):
        start = begin[order[first]]
        matrix = entries[start : start + length * n].reshape(-1, n, n)
        found.append((order[first : first + length].reshape(-1, n), np.linalg.inv(matrix)))
    return found


def sparse(parts: Sequence[Part], shape: tuple[int, int]) -> sp.csr_matrix:
    """Add up entries with their rows and columns."""
    return sp.csr_matrix(_joined(parts), shape=shape)


def sparse_square(parts: Sequence[Part], size: int, kept: IntArray) -> sp.csr_matrix:
    """Add up entries of a square matrix, and keep some of its rows and the same columns."""
    place = np.full(size, -1)
    place[kept] = np.arange(kept.size)
    values, (row, column) = _joined(parts)
    row, column = place[row], place[column]
    own = (row >= 0) & (column >= 0)
    return sp.csr_matrix((values[own], (row[own], column[own])), shape=(kept.size, kept.size))


def _joined(parts: Sequence[Part]) -> tuple[FloatArray, tuple[IntArray, IntArray]]:
    if not parts:
        return np.zeros(0), (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    values, row, column = (np.concatenate([np.ravel(part[i]) for part in parts]) for i in range(3))
    return values, (row, column)


def diagonal(parts: Sequence[Part], size: int) -> FloatArray:
    """Add up the entries on the diagonal of a square matrix."""
    found = np.zeros(size)
    for entries, row, column in parts:
        own = row == column
        found += np.bincount(row[own], entries[own], minlength=size)
    return found


def stacked(matrices: Sequence[sp.csr_matrix]) -> sp.csr_matrix:
    """Put matrices below each other."""
    filled = [matrix for matrix in matrices if matrix.shape[0]] or matrices[:1]
    return filled[0] if len(filled) == 1 else sp.vstack(filled, format="csr")


def largest_of_rows(matrix: sp.csr_matrix) -> FloatArray:
    """Give the largest entry of every row, none of which is negative; zero where there is none."""
    filled = np.diff(matrix.indptr) > 0
    largest = np.zeros(filled.size)
    if filled.any():
        largest[filled] = np.maximum.reduceat(matrix.data, matrix.indptr[:-1][filled])
    return largest


def dense_rows(rows: FloatArray) -> sp.csr_matrix:
    """Rows (n_frames, n_rows, size) of each frame's own unknowns as one sparse matrix."""
    n, m, size = rows.shape
    row = np.repeat(np.arange(n * m), size)
    column = (np.arange(n)[:, None, None] * size + np.broadcast_to(np.arange(size), (n, m, size))).ravel()
    return sp.csr_matrix((rows.ravel(), (row, column)), shape=(n * m, n * size))


def _equilibrated(matrix: sp.csr_matrix, curvature: FloatArray) -> FloatArray:
    """Scale of rows and columns with which the largest entry of each is near one (Ruiz 2001).

    Curvatures of costs become one first. Those of high powers, a^(p - 2), span more than doubles tell apart,
    but each is as exact as its unknown: a small one is no sign that equations are singular.
    """
    length = np.diff(matrix.indptr)
    start, row = matrix.indptr[:-1][length > 0], np.repeat(np.arange(length.size), length)
    is_curved = np.zeros(length.size, dtype=bool)
    is_curved[: curvature.size] = curvature > _TINY
    scale = np.ones(length.size)
    scale[is_curved] = 1 / np.sqrt(curvature[is_curved[: curvature.size]])
    entries = np.abs(matrix.data) * scale[row] * scale[matrix.indices]
    for turn in range(6):
        largest = np.zeros(length.size)
        if start.size:
            largest[length > 0] = np.maximum.reduceat(entries, start)
        factor = 1 / np.sqrt(np.where(largest > 0, largest, 1.0))
        if turn == 0:
            factor = np.where(is_curved, 1.0, factor**2)
        scale *= factor
        entries *= factor[row] * factor[matrix.indices]
    return scale
