"""Sparse equations of all frames: put together, scaled, factorised once, solved many times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from scso_nlp.validation import FloatArray, IntArray

#: What is added to equations that are exactly singular, so that the other frames have their answer.
_RIDGE = 1e-13
#: Products of rows with themselves square how near to dependent these are: beyond this, the first half of the
#: digits is lost [-].
_WELL_POSED = 1e8
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
        """Solve with right sides (n_equations, …), refined once."""
        factors = self.factors
        scale = factors.scale.reshape(-1, *[1] * (right.ndim - 1))
        right = scale * right
        found = factors.solve(right)
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
    """Equations of unknowns and rows, scaled from both sides by `scale` (n_equations,), and factorised."""

    scale: FloatArray

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve the scaled equations."""

    def times(self, found: FloatArray) -> FloatArray:
        """Multiply by the scaled equations."""


def factorised(
    hessian: sp.csr_matrix, slopes: sp.csr_matrix, curvature: FloatArray, frame: IntArray | None
) -> Factors:
    """Scale and factorise the equations with a Hessian and the slopes of rows.

    Parameters
    ----------
    hessian : sparse matrix, shape (n_free, n_free)
    slopes : sparse matrix, shape (n_rows, n_free)
    curvature : ndarray, shape (n_free,)
        Of costs, by each unknown.
    frame : ndarray of int, shape (n_rows,), or None
        Of every row, where frames stand apart from each other.
    """
    diagonal = hessian.diagonal()
    if (
        frame is not None
        and frame.size
        and hessian.count_nonzero() == diagonal.size
        and (diagonal > _TINY).all()
    ):
        apart = _Apart(diagonal, slopes, frame)
        if np.abs(apart.inverse).max(initial=0.0) < _WELL_POSED:
            return apart
    return _Together(hessian, slopes, curvature)


class _Together:
    """Factors of the equations of all frames as one sparse matrix; next to them where it is singular."""

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
    """Factors of frames apart from each other with a diagonal Hessian: of a small matrix of each one's rows.

    With curvatures scaled to one, and rows to a length of one, unknowns are x = y - B'm, where the
    multipliers m solve B B' m = B y - z.
    """

    def __init__(self, curvature: FloatArray, slopes: sp.csr_matrix, frame: IntArray) -> None:
        by_column = 1 / np.sqrt(curvature)
        entries = slopes.data * by_column[slopes.indices]
        row = np.repeat(np.arange(frame.size), np.diff(slopes.indptr))
        length = np.sqrt(np.bincount(row, entries**2, minlength=frame.size))
        by_row = 1 / np.where(length > 0, length, 1.0)
        self.scale = np.concatenate([by_column, by_row])
        self.rows = sp.csr_matrix((entries * by_row[row], slopes.indices, slopes.indptr), slopes.shape)
        self.columns = self.rows.T.tocsr()
        _, which, n_rows = np.unique(frame, return_inverse=True, return_counts=True)
        order, within = np.argsort(which, kind="stable"), np.empty(frame.size, dtype=np.int64)
        within[order] = np.arange(frame.size) - np.repeat(np.cumsum(n_rows) - n_rows, n_rows)
        self.place = (which, within)
        self.shape = (n_rows.size, n_rows.max(initial=0))
        products = (self.rows @ self.columns).tocoo()
        matrix = np.tile(np.eye(self.shape[1]), (n_rows.size, 1, 1))
        matrix[which[products.row], self.place[1][products.row], self.place[1][products.col]] = products.data
        diagonal = np.arange(self.shape[1])
        matrix[:, diagonal, diagonal] += _RIDGE
        self.inverse = np.linalg.inv(matrix)

    def solve(self, right: FloatArray) -> FloatArray:
        y, z = np.split(right, [right.shape[0] - self.place[0].size])
        pushed = np.zeros((*self.shape, *right.shape[1:]))
        pushed[self.place] = self.rows @ y - z
        multipliers = (self.inverse @ pushed.reshape(*self.shape, -1)).reshape(pushed.shape)[self.place]
        return np.concatenate([y - self.columns @ multipliers, multipliers])

    def times(self, found: FloatArray) -> FloatArray:
        x, multipliers = np.split(found, [found.shape[0] - self.place[0].size])
        return np.concatenate([x + self.columns @ multipliers, self.rows @ x])


def sparse(parts: Sequence[Part], shape: tuple[int, int]) -> sp.csr_matrix:
    """Add up entries with their rows and columns."""
    if not parts:
        return sp.csr_matrix(shape)
    values, row, column = (np.concatenate([np.ravel(part[i]) for part in parts]) for i in range(3))
    return sp.csr_matrix((values, (row, column)), shape=shape)


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
