"""How well a point meets the conditions of an optimum, in scaled unknowns and rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from scso_nlp.solution import Optimality
from scso_nlp.transcription.by_data import MULTIPLIERS, weighted
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import Key, evaluate, frame_blocks
from scso_nlp.transcription.rows import AffineRows, RowTable
from scso_nlp.validation import BoolArray, FloatArray

#: A frame that is further from its optimum is solved again, and at most acceptable [-].
OPTIMALITY_TOLERANCE = 1e-6

_TINY = float(np.finfo(float).tiny)
#: An objective of less than this size has lost digits to the end of the doubles.
_LEAST_SIZE = 1e-290


@np.errstate(over="ignore", invalid="ignore")
def optimality_of(
    program: FrameProgram,
    unknowns: FloatArray,
    multipliers: tuple[FloatArray, FloatArray],
    solved: BoolArray,
    unit: FloatArray | None = None,
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
    unit : ndarray, shape (n_frames,), optional
        Multipliers are those of the objective of unknowns divided by this, instead of 1. It differs from 1
        only where the objective has a degree, so that it is the same objective times a number.

    Returns
    -------
    Optimality
    """
    unit = np.ones(len(unknowns)) if unit is None else unit
    one, pair = (np.nan_to_num(m) for m in multipliers)
    every = _Part(
        program=program,
        arrays=program.arrays,
        bounds=program.bounds(),
        affine=(program.split.affine, program.split.affine_pairs),
    )
    if program.is_coupled:
        return _grade(every, unknowns, (one, pair), solved, unit)
    # a few frames at a time, which bounds the memory
    found = [
        _grade(every.frames(block), unknowns[block], (one[block], pair), solved[block], unit[block])
        for block in frame_blocks(len(unknowns))
    ]
    names = [item.name for item in fields(Optimality)]
    return Optimality(**{name: np.concatenate([getattr(part, name) for part in found]) for name in names})


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Frames that are graded together, and their numbers."""

    program: FrameProgram
    arrays: Mapping[Key, FloatArray]
    bounds: tuple[FloatArray, FloatArray]
    affine: tuple[AffineRows, AffineRows]  # of frames, and of pairs

    def frames(self, block: slice) -> _Part:
        """Keep some frames, without their pairs."""
        return replace(
            self,
            arrays={key: array[block] for key, array in self.arrays.items()},
            bounds=(self.bounds[0][block], self.bounds[1][block]),
            affine=(self.affine[0].frames(block), self.affine[1]),
        )


def _grade(
    part: _Part,
    unknowns: FloatArray,
    multipliers: tuple[FloatArray, FloatArray],
    solved: BoolArray,
    unit: FloatArray,
) -> Optimality:
    program = part.program
    gradient = _objective_gradient(part, unknowns, unit)
    lower, upper = part.bounds
    rest = np.clip(0.0, lower, upper)
    at_rest = np.nan_to_num(_objective_gradient(part, rest, unit))
    # what an equation determines is no choice: its size says nothing of those there are
    is_free = ~part.affine[0].determined(program.rows, unknowns.shape[1])
    every = np.maximum(np.abs(gradient), np.abs(gradient - at_rest))
    rise = np.where(is_free, every, 0.0)
    # where there is no choice that costs anything, what is determined is all there is to compare with
    nothing = (rise == 0).all(axis=1)
    nothing &= nothing.all() or not program.is_coupled
    rise[nothing] = every[nothing]
    lagrangian, products = gradient.copy(), np.zeros((len(unknowns), 0))
    missed, acting = np.zeros(len(unknowns)), every.copy()
    for is_pair, table in enumerate((program.rows, program.pair_rows)):
        if len(table):
            push, force, product, violation = _reaction(
                part, unknowns, table, multipliers[is_pair], is_pair=bool(is_pair)
            )
            lagrangian += push
            acting += force
            products = np.hstack([products, product])
            missed = np.maximum(missed, violation)
    outside = np.maximum(np.maximum(lower - unknowns, unknowns - upper), 0.0)
    missed = np.maximum(missed, (outside / np.maximum(np.abs(unknowns), _TINY)).max(axis=1, initial=0.0))
    lagrangian = np.where(is_free, lagrangian, 0.0)
    up, down = np.maximum(lagrangian, 0.0), np.maximum(-lagrangian, 0.0)
    has_lower, has_upper = np.isfinite(lower), np.isfinite(upper)
    left = np.where(has_lower, 0.0, up) + np.where(has_upper, 0.0, down)
    at_lower = up * np.where(has_lower, np.abs(unknowns - lower), 0.0)
    at_upper = down * np.where(has_upper, np.abs(upper - unknowns), 0.0)
    products = np.hstack([products, at_lower, at_upper])
    slope, size = rise.max(axis=1, initial=0.0), (rise * np.abs(unknowns)).sum(axis=1)
    if program.is_coupled:
        slope[:], size[:] = slope.max(initial=0.0), size.mean()
    # What vanishes among the smallest doubles, away from rest, cannot be graded.
    size[(size < _LEAST_SIZE) & ((unknowns != rest) & is_free).any(axis=1) & _has_slope(part)] = np.nan
    gap = np.full(len(unknowns), np.nan) if program.split.nonlinear else products.sum(axis=1)

    def share(values: FloatArray, of: FloatArray) -> FloatArray:
        known = np.where(np.isfinite(of), values / np.maximum(of, _TINY), np.inf)
        return np.where(solved, np.where(np.isnan(values), np.nan, known), np.nan)

    return Optimality(
        feasibility=np.where(solved, missed, np.nan),
        stationarity=share(left.max(axis=1, initial=0.0), slope),
        complementarity=share(products.max(axis=1, initial=0.0), size),
        duality_gap=share(gap, size),
        imbalance=np.where(solved, _imbalance(part, unknowns, lagrangian, acting, unit), np.nan),
    )


def _imbalance(
    part: _Part, unknowns: FloatArray, lagrangian: FloatArray, acting: FloatArray, unit: FloatArray
) -> FloatArray:
    """Largest share of what acts on an unknown that neither balances nor a bound holds, shape (n_frames,)."""
    if part.program.is_coupled or part.program.split.nonlinear:
        return np.full(len(unknowns), np.nan)
    lower, upper = part.bounds
    size = np.abs(unknowns).max(axis=1, initial=0.0, keepdims=True)
    distance = np.where(lagrangian > 0, unknowns - lower, upper - unknowns) / np.maximum(size, _TINY)
    missed = np.minimum(np.abs(lagrangian) / np.maximum(acting, _TINY), distance)
    if (missed > OPTIMALITY_TOLERANCE).any():
        # what balances within the tolerance of the frame's largest unknown, or costs nothing, is no miss
        near = np.clip(unknowns - np.sign(lagrangian) * OPTIMALITY_TOLERANCE * size, lower, upper)
        gradient, there = (_objective_gradient(part, x, unit) for x in (unknowns, near))
        after = lagrangian + there - gradient
        missed = np.where((after * lagrangian <= 0) | ((gradient == 0) & (there == 0)), 0.0, missed)
    return np.asarray(missed.max(axis=1, initial=0.0))


def _has_slope(part: _Part) -> BoolArray:
    """Tell in which frames the objective changes at all, shape (n_frames,)."""
    half = np.clip(0.5, *part.bounds)
    return (np.nan_to_num(_objective_gradient(part, half, np.ones(len(half)))) != 0).any(axis=1)


def _objective_gradient(part: _Part, unknowns: FloatArray, unit: FloatArray) -> FloatArray:
    """Gradient by the scaled unknowns of the objective of unknowns over unit, shape (n_frames, size)."""
    gradient = np.zeros(unknowns.shape)
    for _, piece in part.program.objectives:
        slopes = evaluate(piece, piece.slope(), unknowns / unit[:, None], part.arrays)[0]
        for side, own in enumerate(np.split(slopes, len(piece.unknowns), axis=1)):
            gradient[side : side + len(own)] += own
    return gradient / unit[:, None]


def _reaction(
    part: _Part, unknowns: FloatArray, table: RowTable, lam: FloatArray, *, is_pair: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Give what rows push with and what affine rows add to that in size, shapes (n_frames, size); then ...

    ... products of multipliers and distances, and violations.

    A violation is relative to what the entries of the rows of its term add up to in the frame.
    """
    n_frames, size = unknowns.shape
    value = np.zeros(lam.shape)
    own = np.ones(lam.shape)
    affine = part.affine[is_pair]
    weights = np.where(affine.is_empty, 0.0, lam[:, affine.rows])
    push, force = np.zeros((n_frames, size)), np.zeros((n_frames, size))
    for block in frame_blocks(len(lam)):
        matrix, constant = affine.matrix(affine.values[block], size), affine.constant[block]
        seen = slice(block.start, block.stop + is_pair)
        x = unknowns[seen].ravel()
        value[block, affine.rows] = (matrix @ x).reshape(constant.shape) + constant
        sizes = abs(matrix)
        entries = (sizes @ np.abs(x)).reshape(constant.shape)
        own[block, affine.rows] = entries + np.abs(constant)
        push[seen] += (matrix.T @ weights[block].ravel()).reshape(-1, size)
        force[seen] += (sizes.T @ np.abs(weights[block]).ravel()).reshape(-1, size)
    for _, where in table:
        own[:, where] = own[:, where].max(axis=1, initial=_TINY)[:, None]
    for piece, rows in part.program.split.nonlinear:
        if piece.is_pair != is_pair:
            continue
        value[:, rows] = piece.values(unknowns, part.arrays)
        total = weighted(piece)
        slopes = evaluate(total, total.slope(), unknowns, {**part.arrays, MULTIPLIERS: lam[:, rows]})[0]
        for side, own_slopes in enumerate(np.split(slopes, len(piece.unknowns), axis=1)):
            push[side : side + len(own_slopes)] += own_slopes
    outside = np.maximum(np.maximum(table.lower - value, value - table.upper), 0.0)
    distance = np.where(lam < 0, value - table.lower, table.upper - value)
    product = np.abs(lam) * np.where(np.isfinite(distance), np.abs(distance), 0.0)
    violation = (outside / own).max(axis=1, initial=0.0)
    if is_pair:  # a pair's rows stand at its later frame
        product = np.vstack([np.zeros((1, product.shape[1])), product])
        violation = np.append(0.0, violation)
    return push, force, product, violation
