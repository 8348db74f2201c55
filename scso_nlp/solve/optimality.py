"""How well a point meets the conditions of an optimum, in scaled unknowns and rows."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from scso_nlp.solution import Optimality
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import evaluate
from scso_nlp.transcription.rows import RowTable
from scso_nlp.validation import BoolArray, FloatArray


def optimality_of(
    program: FrameProgram,
    unknowns: FloatArray,
    multipliers: tuple[FloatArray, FloatArray],
    solved: BoolArray,
) -> Optimality:
    """Recompute the conditions of an optimum.

    Parameters
    ----------
    program : FrameProgram
        With the rows that were chosen for its matrix inequalities.
    unknowns : ndarray, shape (n_frames, n_unknowns)
        Scaled and finite.
    multipliers : pair of ndarray, shapes (n_frames, n_rows) and (n_frames - 1, n_pair_rows)
        In the solver's sign and scale; NaN counts as zero.
    solved : ndarray of bool, shape (n_frames,)
        Other frames get NaN.

    Returns
    -------
    Optimality
    """
    gradient = _objective_gradient(program, unknowns)
    lam = tuple(np.nan_to_num(m) for m in multipliers)
    lagrangian, products = gradient.copy(), np.zeros((len(unknowns), 0))
    for is_pair, table in enumerate((program.rows, program.pair_rows)):
        if len(table):
            push, product = _reaction(program, unknowns, table, lam[is_pair], is_pair=bool(is_pair))
            lagrangian += push
            products = np.hstack([products, product])
    lower, upper = program.bounds()
    up, down = np.maximum(lagrangian, 0.0), np.maximum(-lagrangian, 0.0)
    has_lower, has_upper = np.isfinite(lower), np.isfinite(upper)
    left = np.where(has_lower, 0.0, up) + np.where(has_upper, 0.0, down)
    at_lower = up * np.where(has_lower, np.abs(unknowns - lower), 0.0)
    at_upper = down * np.where(has_upper, np.abs(upper - unknowns), 0.0)
    products = np.hstack([products, at_lower, at_upper])
    slope = np.abs(gradient).max(axis=1, initial=0.0)
    size = np.abs(gradient * unknowns).sum(axis=1)
    tiny = np.finfo(float).tiny
    gap = np.full(len(unknowns), np.nan) if program.split.nonlinear else products.sum(axis=1)

    def where_solved(values: FloatArray) -> FloatArray:
        return np.where(solved, values, np.nan)

    with np.errstate(over="ignore", invalid="ignore"):
        return Optimality(
            stationarity=where_solved(left.max(axis=1, initial=0.0) / np.maximum(slope, tiny)),
            complementarity=where_solved(products.max(axis=1, initial=0.0) / np.maximum(size, tiny)),
            duality_gap=where_solved(gap / np.maximum(size, tiny)),
        )


def _objective_gradient(program: FrameProgram, unknowns: FloatArray) -> FloatArray:
    """Gradient of the unweighted objective by the scaled unknowns, shape (n_frames, size)."""
    gradient = np.zeros(unknowns.shape)
    for _, piece in program.objectives:
        slopes = evaluate(piece, piece.slope(), unknowns, program.arrays)[0]
        for side, part in enumerate(np.split(slopes, len(piece.unknowns), axis=1)):
            gradient[side : side + len(part)] += part
    return gradient


def _reaction(
    program: FrameProgram, unknowns: FloatArray, table: RowTable, lam: FloatArray, *, is_pair: bool
) -> tuple[FloatArray, FloatArray]:
    """Give what rows push with, shape (n_frames, size), and products of multipliers and distances."""
    n_frames, size = unknowns.shape
    value = np.zeros(lam.shape)
    affine = program.split.affine_pairs if is_pair else program.split.affine
    matrix = affine.matrix(affine.values, size)
    value[:, affine.rows] = (matrix @ unknowns.ravel()).reshape(affine.constant.shape) + affine.constant
    weights = np.where(affine.is_empty, 0.0, lam[:, affine.rows])
    push = (matrix.T @ weights.ravel()).reshape(n_frames, size)
    for piece, rows in program.split.nonlinear:
        if piece.is_pair != is_pair:
            continue
        value[:, rows] = piece.values(unknowns, program.arrays)
        weight = ca.SX.sym("multiplier", rows.size)
        weighted = replace(
            piece,
            expression=ca.dot(weight, piece.expression),
            data=(*piece.data, (0, ("judge", "multiplier"))),
            symbols=(*piece.symbols, weight),
        )
        arrays = {**program.arrays, ("judge", "multiplier"): lam[:, rows]}
        slopes = evaluate(weighted, weighted.slope(), unknowns, arrays)[0]
        for side, part in enumerate(np.split(slopes, len(piece.unknowns), axis=1)):
            push[side : side + len(part)] += part
    distance = np.where(lam < 0, value - table.lower, table.upper - value)
    product = np.abs(lam) * np.where(
        np.isfinite(distance) & (table.lower < table.upper), np.abs(distance), 0.0
    )
    if is_pair:  # a pair's rows stand at its later frame
        product = np.vstack([np.zeros((1, product.shape[1])), product])
    return push, product
