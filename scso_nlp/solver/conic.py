"""A small conic solver in NumPy: quadratic programs with one matrix inequality each.

All frames take their interior-point steps together, see :mod:`scso_nlp.solver.interior_point`. The answers
are used only to choose rows, see :mod:`scso_nlp.solver.refine`, to say what is out of reach, and as
certificates that are checked by multiplication, see :mod:`scso_nlp.solver.extreme_cones`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from scso_nlp.solver.interior_point import (
    Frames,
    absorbed,
    first_point,
    largest_gradient,
    largest_residual,
    moved,
    pushed_rows,
    residual_at,
    some,
    step_from,
)
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Interior-point iterations; 15 to 25 are usual.
_MAX_ITERATIONS = 100

#: Relative residuals and gap at which a frame is done.
_TOLERANCE = 1e-10

#: The same for a frame that does not get on, or not any further: good enough to tell the turns.
_LOOSE_TOLERANCE, _MOST_IN_VAIN = 1e-6, 5

#: Costs are measured by their gradient, but by no less than this share of the gradient at the start.
_LEAST_COST = 1e-6

#: Where costs or rows are curved, steps are damped by this much of what stationarity lacks (Li, Fukushima, Qi
#: and Yamashita 2004, Comput Optim Appl 28:131-147): high powers have no curvature of their own near zero.
_DAMPING = 0.1

#: A frame whose step is shorter than this does not get on: it is infeasible, or out of digits.
_SHORTEST_STEP = 1e-8

#: A multiplier less than this share of the (scaled) matrix it belongs to is what the barrier left.
_LEAST_PRICE = 1e-4


@dataclass(frozen=True, kw_only=True)
class MatrixProgram:
    r"""Quadratic programs with one matrix inequality each, one per frame.

    .. math:: \min \tfrac12 x^T Q x + g^T x \;\text{s.t.}\; A x = b,\; C x \ge d,\; l \le x \le u,\;
              K + \sum_i x_i G_i \succeq 0

    Attributes
    ----------
    quadratic : ndarray, shape (n_frames, n, n)
    linear : ndarray, shape (n_frames, n)
    equations : ndarray, shape (n_frames, n_equations, n)
    targets : ndarray, shape (n_frames, n_equations)
    rows : ndarray, shape (n_frames, n_rows, n)
    least : ndarray, shape (n_frames, n_rows)
        d; minus infinity where a frame does not have the row.
    lower, upper : ndarray, shape (n_frames, n)
        Infinite where there is no bound; unknowns with equal bounds are taken as numbers.
    matrices : ndarray, shape (n_frames, n, size, size)
        Symmetric.
    constant : ndarray, shape (n_frames, size, size)
        Symmetric.
    """

    quadratic: FloatArray
    linear: FloatArray
    equations: FloatArray
    targets: FloatArray
    rows: FloatArray
    least: FloatArray
    lower: FloatArray
    upper: FloatArray
    matrices: FloatArray
    constant: FloatArray

    def frames(self, which: IntArray) -> MatrixProgram:
        """Keep some frames."""
        if which.size == len(self.linear) and (np.diff(which) == 1).all():
            return self  # without copies
        return replace(self, **{item.name: getattr(self, item.name)[which] for item in fields(self)})

    def at(self, x: FloatArray) -> FloatArray:
        """Give the matrices at unknowns (n_frames, n), shape (n_frames, size, size)."""
        return self.constant + np.einsum("kxij,kx->kij", self.matrices, x)


@dataclass(frozen=True, kw_only=True)
class MatrixProgramAnswer:
    """Optimum of each frame.

    Attributes
    ----------
    x : ndarray, shape (n_frames, n)
        NaN where not solved.
    multiplier : ndarray, shape (n_frames, size, size)
        Of the matrix inequality; its range is the null space of the matrix at the optimum. NaN where not
        solved.
    row_multiplier : ndarray, shape (n_frames, n_equations + n_rows)
        Rise of the cost per rise of each target, then of each least value of a row. NaN where not solved.
    upper_multiplier : ndarray, shape (n_frames, n)
        Fall of the cost per rise of each upper bound; 0 without one. NaN where not solved.
    is_solved : ndarray of bool, shape (n_frames,)
    iterations : int
        Of the frame that took most.
    """

    x: FloatArray
    multiplier: FloatArray
    row_multiplier: FloatArray
    upper_multiplier: FloatArray
    is_solved: BoolArray
    iterations: int


#: Model of the frames with the given indices near their unknowns (n_frames_given, n), where their rows push
#: with (n_frames_given, n_rows).
Remodel = Callable[[FloatArray, IntArray, FloatArray], MatrixProgram]


def solve_matrix_programs(
    program: MatrixProgram, remodel: Remodel | None = None, start: FloatArray | None = None
) -> MatrixProgramAnswer:
    """Solve all frames by a primal-dual interior-point method.

    Parameters
    ----------
    program : MatrixProgram
    remodel : callable, optional
        For costs that are not quadratic, rows and matrices that are not affine: called before every step, it
        returns the program whose quadratic cost, affine rows and affine matrix have the right values and
        derivatives at the unknowns given; the curvature of rows, times what they push with, may be part of
        that of the cost. Bounds must stay.
    start : ndarray, shape (n_frames, n), optional
        Unknowns to begin with; those close to a bound are moved inside.

    Returns
    -------
    MatrixProgramAnswer
        Frames without a solution are marked.

    Notes
    -----
    Search direction of Helmberg, Rendl, Vanderbei and Wolkowicz with Mehrotra's predictor and corrector.

    References
    ----------
    Helmberg et al. (1996), SIAM J Optim 6:342-361; Mehrotra (1992), SIAM J Optim 2:575-601.
    """
    frames = _scaled(program)
    n_frames, n = program.linear.shape
    answer = np.full((n_frames, n), np.nan)
    multiplier = np.full(program.constant.shape, np.nan)
    upper_multiplier = np.full((n_frames, n), np.nan)
    row_multiplier = np.full((n_frames, frames.row_scale.shape[1]), np.nan)
    least, best = np.full(n_frames, np.inf), np.full(n_frames, _MAX_ITERATIONS)
    left = np.arange(n_frames)
    point = first_point(frames, start)
    iterations = 0
    # An infeasible frame runs away until its numbers are not finite; that frame alone is then dropped.
    with np.errstate(all="ignore"):
        if remodel is not None:
            frames = _scaled(remodel(point.x, left, pushed_rows(frames, point)), frames)
        damping = np.full(n_frames, 0.0 if remodel is None else _DAMPING)
        least_cost = _LEAST_COST * largest_gradient(frames, point)
        frames = replace(frames, least_cost=least_cost, damping=damping)
        length = np.ones(n_frames)
        for iterations in range(_MAX_ITERATIONS):
            residual = residual_at(frames, point)
            worst = largest_residual(frames, point, residual)
            better = (worst <= _LOOSE_TOLERANCE) & (worst < least[left])
            now = left[better]
            least[now], best[now] = worst[better], iterations
            answer[now] = point.x[better]
            multiplier[now] = _of_null_space(point.multiplier[better], point.slack[better])
            multiplier[now] /= frames.scale[better, None, None]
            row_multiplier[now] = np.hstack(
                [
                    point.equation_multiplier[better] / frames.row_scale[better, : frames.targets.shape[1]],
                    pushed_rows(frames, point)[better],
                ]
            )
            upper_multiplier[now] = point.limit_multiplier[better, n : 2 * n]
            done = least[left] <= _TOLERANCE
            stuck = ~(length > _SHORTEST_STEP) | (iterations - best[left] > _MOST_IN_VAIN)
            go_on = ~(done | stuck) & np.isfinite(residual.mean_product) & np.isfinite(point.x).all(axis=1)
            if not go_on.any():
                break
            if not go_on.all():
                left, frames = left[go_on], some(frames, go_on)
                point, residual = some(point, go_on), some(residual, go_on)
            step, length = step_from(frames, point, residual)
            point = moved(point, step, length)
            if remodel is not None:
                model = _scaled(remodel(point.x, left, pushed_rows(frames, point)), frames)
                frames = replace(model, least_cost=frames.least_cost, damping=frames.damping)
                point = absorbed(frames, point)
    return MatrixProgramAnswer(
        x=answer,
        multiplier=multiplier,
        row_multiplier=row_multiplier,
        upper_multiplier=upper_multiplier,
        is_solved=np.isfinite(least),
        iterations=iterations,
    )


def highest_eigenvalues(program: MatrixProgram) -> MatrixProgramAnswer:
    r"""Raise the smallest eigenvalue of every frame's matrix as far as rows and bounds allow.

    .. math:: \max t \;\text{s.t.}\; K + \sum_i x_i G_i - t\,1 \succeq 0

    Parameters
    ----------
    program : MatrixProgram
        Its cost is not used.

    Returns
    -------
    MatrixProgramAnswer
        `x` without t; multipliers per unit of eigenvalue, that of the matrix has trace one.
    """
    n_frames, n = program.linear.shape
    size = program.constant.shape[1]
    scale = np.abs(program.matrices).max(axis=(1, 2, 3), initial=0.0)
    scale = np.where(scale > 0, scale, 1.0)
    eye = np.broadcast_to(np.eye(size), (n_frames, size, size))
    free = np.full((n_frames, 1), np.inf)

    def with_column(values: FloatArray) -> FloatArray:
        return np.concatenate([values, np.zeros((*values.shape[:-1], 1))], axis=-1)

    answer = solve_matrix_programs(
        MatrixProgram(
            quadratic=np.zeros((n_frames, n + 1, n + 1)),
            linear=np.concatenate([np.zeros((n_frames, n)), -np.ones((n_frames, 1))], axis=1),
            equations=with_column(program.equations),
            targets=program.targets,
            rows=with_column(program.rows),
            least=program.least,
            lower=np.concatenate([program.lower, -free], axis=1),
            upper=np.concatenate([program.upper, free], axis=1),
            matrices=np.concatenate([program.matrices, -(scale[:, None, None] * eye)[:, None]], axis=1),
            constant=program.constant,
        )
    )
    return MatrixProgramAnswer(
        x=answer.x[:, :n],
        multiplier=answer.multiplier * scale[:, None, None],
        row_multiplier=answer.row_multiplier * scale[:, None],
        upper_multiplier=answer.upper_multiplier[:, :n] * scale[:, None],
        is_solved=answer.is_solved,
        iterations=answer.iterations,
    )


def _of_null_space(multiplier: FloatArray, slack: FloatArray) -> FloatArray:
    """Drop what the barrier left of multipliers (n_frames, size, size) where the matrix is not singular."""
    values, vectors = np.linalg.eigh(multiplier)
    stiffness = np.einsum("kji,kjl,kli->ki", vectors, slack, vectors)
    kept = np.where(values > _LEAST_PRICE * stiffness, values, 0.0)
    return (vectors * kept[:, None, :]) @ vectors.transpose(0, 2, 1)


def _scaled(program: MatrixProgram, like: Frames | None = None) -> Frames:
    """Scale the matrix inequality so that its slack and multiplier may start at one, and rows likewise.

    Models of the same frames are scaled alike.
    """
    n_frames, n = program.linear.shape
    size = program.constant.shape[1]
    program = _with_numbers_for_fixed(program)
    matrices = program.matrices.reshape(n_frames, n, size * size)
    if like is None:
        scale = np.maximum(
            np.abs(program.constant).max(axis=(1, 2)), np.abs(matrices).max(axis=(1, 2), initial=0.0)
        )
        scale = np.where(scale > 0, scale, 1.0)
        both = np.concatenate([program.equations, program.rows], axis=1)
        row_scale = np.abs(both).max(axis=2, initial=0.0)
        row_scale = np.where(row_scale > 0, row_scale, 1.0)
    else:
        scale, row_scale = like.scale, like.row_scale
    of_equations, of_rows = np.split(row_scale, [program.targets.shape[1]], axis=1)
    limits = np.concatenate([program.lower, -program.upper, program.least / of_rows], axis=1)
    has_limit = np.isfinite(limits)
    return Frames(
        quadratic=program.quadratic,
        linear=program.linear,
        equations=program.equations / of_equations[:, :, None],
        targets=program.targets / of_equations,
        rows=program.rows / of_rows[:, :, None],
        limits=np.where(has_limit, limits, 0.0),
        has_limit=has_limit,
        matrices=matrices / scale[:, None, None],
        constant=program.constant / scale[:, None, None],
        scale=scale,
        row_scale=row_scale,
        least_cost=np.zeros(n_frames),
        damping=np.zeros(n_frames),
    )


def _with_numbers_for_fixed(program: MatrixProgram) -> MatrixProgram:
    """Put the numbers of unknowns with equal bounds into the program, and leave a cost that finds them."""
    fixed = program.lower == program.upper
    if not fixed.any():
        return program
    n = fixed.shape[1]
    value = np.where(fixed, program.lower, 0.0)
    free = ~fixed
    quadratic = program.quadratic * free[:, :, None] * free[:, None, :]
    quadratic[:, np.arange(n), np.arange(n)] += fixed
    linear = program.linear + (program.quadratic @ value[:, :, None])[:, :, 0]
    return MatrixProgram(
        quadratic=quadratic,
        linear=np.where(fixed, -value, linear),
        equations=program.equations * free[:, None, :],
        targets=program.targets - (program.equations @ value[:, :, None])[:, :, 0],
        rows=program.rows * free[:, None, :],
        least=program.least - (program.rows @ value[:, :, None])[:, :, 0],
        lower=np.where(fixed, -np.inf, program.lower),
        upper=np.where(fixed, np.inf, program.upper),
        matrices=program.matrices * free[:, :, None, None],
        constant=program.constant + np.einsum("kiab,ki->kab", program.matrices, value),
    )
