"""Matrix inequalities of an optimum in the basis of their eigenvectors: rows, curvature and multipliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scso_nlp.transcription.piece import Key
from scso_nlp.transcription.turns import MatrixModel
from scso_nlp.validation import BoolArray, FloatArray, IntArray

_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, kw_only=True)
class Turned:
    """A matrix of every frame in the basis of its eigenvectors, those of its multiplier turned to its own.

    Attributes
    ----------
    model : MatrixModel
    basis : ndarray, shape (n_frames, d, d)
        Vectors as columns, the active ones first.
    psi, value : ndarray, shape (n_frames, d)
        Multiplier and eigenvalue of each.
    active : ndarray of bool, shape (n_frames, d)
        Which carry a multiplier.
    pairs : pair of ndarray of int, shape (n_pairs,)
        Of vectors; each pair of active ones is a row.
    rows : ndarray, shape (n_frames, n_pairs, n_entries)
        By what entries of the lower triangle count in q_a'G q_b, scaled; zero for other pairs.
    bend : ndarray, shape (n_frames, d², n_entries)
        The root of the curvature C.
    margin : ndarray, shape (n_frames, d)
        Multiplier or eigenvalue as share of what it is made of.
    slopes : ndarray, shape (n_frames, n_entries, size)
        Derivatives of the lower triangle by the unknowns.
    """

    model: MatrixModel
    basis: FloatArray
    psi: FloatArray
    value: FloatArray
    active: BoolArray
    pairs: tuple[IntArray, IntArray]
    rows: FloatArray
    bend: FloatArray
    margin: FloatArray
    slopes: FloatArray

    @property
    def multiplier(self) -> FloatArray:
        """Lambda, shape (n_frames, d, d)."""
        return np.asarray(np.einsum("kia,ka,kja->kij", self.basis, self.psi, self.basis))

    @property
    def weights(self) -> FloatArray:
        """By what the entries of a lower triangle count in <Lambda, G>, shape (n_frames, n_entries)."""
        row, column = self.model.block.triangle
        return np.where(row == column, 1.0, 2.0) * self.multiplier[:, row, column]

    def by_weights(self, arrays: Mapping[Key, FloatArray]) -> FloatArray:
        """By what the weights of the matrix count in <Lambda, G>, shape (n_frames, n_weights)."""
        matrices = arrays[self.model.block.matrices]
        return np.asarray(np.einsum("ke,kew->kw", self.weights, matrices))

    def multiplier_change(self, rows: FloatArray, entries: FloatArray) -> FloatArray:
        """Change of the multiplier (n_frames, d, d).

        `rows` are the changes of the multipliers of its rows, `entries` (n_frames, n_entries) of the matrix.
        """
        basis, active = self.basis, self.active[:, None]
        first, second = self.pairs
        psi = np.zeros_like(basis)
        share = np.where(first == second, -1.0, -0.5) / self.model.block.scale
        psi[:, first, second] = psi[:, second, first] = share * rows.reshape(len(basis), -1)
        inside = basis.transpose(0, 2, 1) @ self.model.block.filled(entries) @ basis
        is_other = ~self.active[:, :, None] & active
        turn = np.where(is_other, -inside / np.where(is_other, self.value[:, :, None], 1.0), 0.0)
        half = (basis @ turn) * self.psi[:, None]
        half = half @ basis.transpose(0, 2, 1)
        return basis @ psi @ basis.transpose(0, 2, 1) + half + half.transpose(0, 2, 1)


def turned_at(
    model: MatrixModel,
    x: FloatArray,
    arrays: Mapping[Key, FloatArray],
    *,
    multiplier: FloatArray,
    active: BoolArray | None,
    largest: FloatArray,
) -> Turned:
    """Turn the matrices of all frames at unknowns into the basis of their eigenvectors.

    Parameters
    ----------
    model : MatrixModel
    x : ndarray, shape (n_frames, size)
    arrays : mapping of (owner, name) to ndarray
    multiplier : ndarray, shape (n_frames, d, d)
    active : ndarray of bool, shape (n_frames, d), or None
        How many vectors carry a multiplier; None: those whose multiplier outweighs their eigenvalue.
    largest : ndarray, shape (n_frames,)
        What multipliers are compared with.

    Returns
    -------
    Turned
    """
    entries, slopes = model.triangle(x, arrays)
    filled = model.block.filled(entries)
    value, basis = np.linalg.eigh(filled)
    psi = np.einsum("kia,kij,kja->ka", basis, multiplier, basis)
    d = value.shape[1]
    made_of = (np.abs(slopes) * np.abs(x[:, None])).sum(axis=2)
    own = np.abs(entries).max(axis=1) + made_of.max(axis=1)
    pushed = np.abs(slopes).max(axis=(1, 2), initial=0.0) * np.abs(psi).T / largest
    margin = np.abs(value).T / np.maximum(own, _TINY)
    active = (pushed > margin).T if active is None else active
    active = np.arange(d) < active.sum(axis=1)[:, None]  # they turn, but stay the smallest
    # a basis of the active ones in which their multiplier is diagonal
    both = active[:, :, None] & active[:, None, :]
    inner = np.where(both, np.einsum("kia,kij,kjb->kab", basis, multiplier, basis), 0.0)
    spread = np.where(active, 0.0, 1.0 + d * np.abs(inner).max(axis=(1, 2), initial=0.0)[:, None])
    psi, turn = np.linalg.eigh(inner + spread[:, :, None] * np.eye(d))
    basis = np.where(active[:, None], basis @ turn, basis)
    psi = np.where(active, psi, 0.0)
    first, second = np.triu_indices(d)
    rows = model.products(basis[:, :, first].transpose(0, 2, 1), basis[:, :, second].transpose(0, 2, 1))
    rows = np.where((active[:, first] & active[:, second])[:, :, None], rows, 0.0) / model.block.scale
    a, i = (v.ravel() for v in np.indices((d, d)))
    bend = model.products(basis[:, :, a].transpose(0, 2, 1), basis[:, :, i].transpose(0, 2, 1))
    is_bend = active[:, a] & ~active[:, i]
    share = np.where(is_bend, 2 * np.maximum(psi[:, a], 0.0) / np.where(is_bend, value[:, i], 1.0), 0.0)
    pushed = np.abs(slopes).max(axis=(1, 2), initial=0.0) * np.abs(psi).T / largest
    strength = np.where(active, pushed.T, margin.T)
    return Turned(
        model=model,
        basis=basis,
        psi=psi,
        value=value,
        active=active,
        pairs=(first, second),
        rows=rows,
        bend=np.sqrt(np.abs(share))[:, :, None] * bend,
        margin=np.where(active & (psi < 0), 0.0, np.where(active | (value > 0), strength, 0.0)),
        slopes=slopes,
    )
