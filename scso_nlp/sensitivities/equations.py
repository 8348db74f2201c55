"""Sparse equations of all frames: put together, scaled, factorised once, solved many times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from scso_nlp.validation import FloatArray, IntArray

#: What is added to equations that are exactly singular, so that the other frames have their answer.
_RIDGE = 1e-13
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
    scale : ndarray
        Of equations and of their unknowns.
    matrix, factors
        The scaled equations, and their factorisation.
    slope : sparse matrix, shape (n_all_rows, n_all_unknowns)
        Derivatives of all rows, those of matrices behind the others.
    """

    free: IntArray
    rows: IntArray
    frame: IntArray
    left: FloatArray
    scale: FloatArray
    matrix: sp.csc_matrix
    factors: object
    slope: sp.csr_matrix = field(repr=False)

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve with right sides (n_equations, …), refined once."""
        scale = self.scale.reshape(-1, *[1] * (right.ndim - 1))
        right = scale * right
        found = self.factors.solve(right)  # type: ignore[attr-defined]
        found += self.factors.solve(right - self.matrix @ found)  # type: ignore[attr-defined]
        return np.asarray(scale * found)

    def answer_to_noise(self, n_frames: int) -> FloatArray:
        """Give the largest answer of each frame to random right sides near one, in scaled equations."""
        rng = np.random.default_rng(0)
        noise = rng.choice([-1.0, 1.0], (self.frame.size, 2))
        found = np.abs(self.factors.solve(noise)).max(axis=1, initial=0.0)  # type: ignore[attr-defined]
        largest = np.zeros(n_frames)
        np.maximum.at(largest, self.frame, np.nan_to_num(found, nan=np.inf))
        return largest


def factorised(matrix: sp.csr_matrix, curvature: FloatArray) -> tuple[FloatArray, sp.csc_matrix, object]:
    """Scale and factorise symmetric equations, the first of which are those of the unknowns.

    Parameters
    ----------
    matrix : sparse matrix
    curvature : ndarray, shape (n_free,)
        Of costs, by each unknown.

    Returns
    -------
    scale : ndarray, shape (n_equations,)
    matrix : sparse matrix
        Scaled from both sides.
    factors : object with solve
        Where the equations are exactly singular, of those next to them.
    """
    scale = _equilibrated(matrix, curvature)
    scaled = (sp.diags(scale) @ matrix @ sp.diags(scale)).tocsc()
    try:
        return scale, scaled, splu(scaled)
    except RuntimeError:  # exactly singular
        ridge = np.where(np.arange(scale.size) < curvature.size, _RIDGE, -_RIDGE)
        return scale, scaled, splu((scaled + sp.diags(ridge)).tocsc())


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
