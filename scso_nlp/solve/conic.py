"""A small conic solver in NumPy: quadratic programs with one matrix inequality each.

All frames take their interior-point steps together as batched arrays. The answers are used only to choose
rows, see :mod:`scso_nlp.solve.refine`, and to say what is out of reach.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Interior-point iterations; 15 to 25 are usual.
_MAX_ITERATIONS = 100

#: Relative residuals and gap at which a frame is done.
_TOLERANCE = 1e-10

#: The same for a frame that does not get on: good enough to tell the turns.
_LOOSE_TOLERANCE = 1e-6

#: Costs are measured by their gradient, but by no less than this share of the gradient at the start.
_LEAST_COST = 1e-6

#: Steps go this far towards the boundary.
_STEP = 0.98

#: The complementarity products wanted are at least this share of what stationarity lacks.
_SHARE_OF_STATIONARITY = 1e-3

#: A frame whose step is shorter than this does not get on: it is infeasible, or out of digits.
_SHORTEST_STEP = 1e-8

#: Added to the diagonal of the Newton equations, so that dependent equations can be solved.
_REGULARIZATION = 1e-12

#: A starting point keeps this share of the distance of two bounds, or this much of one, from them.
_ROOM = 0.05

#: A multiplier less than this share of the (scaled) matrix it belongs to is what the barrier left.
_LEAST_PRICE = 1e-4

#: Least slack of a bound or row at the starting point.
_LEAST_SLACK = 1e-2


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
    upper_multiplier : ndarray, shape (n_frames, n)
        Fall of the cost per rise of each upper bound; 0 without one. NaN where not solved.
    is_solved : ndarray of bool, shape (n_frames,)
    iterations : int
        Of the frame that took most.
    """

    x: FloatArray
    multiplier: FloatArray
    upper_multiplier: FloatArray
    is_solved: BoolArray
    iterations: int


#: Model of the frames with the given indices near their unknowns (n_frames_given, n).
Remodel = Callable[[FloatArray, IntArray], MatrixProgram]


def solve_matrix_programs(
    program: MatrixProgram, remodel: Remodel | None = None, start: FloatArray | None = None
) -> MatrixProgramAnswer:
    """Solve all frames by a primal-dual interior-point method.

    Parameters
    ----------
    program : MatrixProgram
    remodel : callable, optional
        For costs that are not quadratic and matrices that are not affine: called before every step, it
        returns the program whose quadratic cost, affine rows and affine matrix have the right values and
        derivatives at the unknowns given. Bounds must stay.
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
    is_solved = np.zeros(n_frames, dtype=bool)
    left = np.arange(n_frames)
    point = _start(frames, start)
    iterations = 0
    # An infeasible frame runs away until its numbers are not finite; that frame alone is then dropped.
    with np.errstate(all="ignore"):
        frames = _scaled(program if remodel is None else remodel(point.x, left), frames)
        frames = replace(frames, least_cost=_LEAST_COST * _largest_gradient(frames, point))
        length = np.ones(n_frames)
        for iterations in range(_MAX_ITERATIONS):
            residual = _residual(frames, point)
            stuck = ~(length > _SHORTEST_STEP) | (iterations == _MAX_ITERATIONS - 1)
            done = _is_small(frames, point, residual, np.where(stuck, _LOOSE_TOLERANCE, _TOLERANCE))
            now = left[done]
            answer[now], is_solved[now] = point.x[done], True
            multiplier[now] = _of_null_space(point.multiplier[done], point.slack[done])
            multiplier[now] /= frames.scale[done, None, None]
            upper_multiplier[now] = point.limit_multiplier[done, n : 2 * n]
            go_on = ~(done | stuck) & np.isfinite(residual.mean_product) & np.isfinite(point.x).all(axis=1)
            if not go_on.any():
                break
            if not go_on.all():
                left, frames = left[go_on], _some(frames, go_on)
                point, residual = _some(point, go_on), _some(residual, go_on)
            step, length = _step(frames, point, residual)
            point = _moved(point, step, length)
            if remodel is not None:
                model = _scaled(remodel(point.x, left), frames)
                frames = replace(model, least_cost=frames.least_cost)
                point = _absorbed(frames, point)
    return MatrixProgramAnswer(
        x=answer,
        multiplier=multiplier,
        upper_multiplier=upper_multiplier,
        is_solved=is_solved,
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


@dataclass(frozen=True, kw_only=True)
class _Frames:
    """The program as the iterations use it.

    The matrix inequality is divided by `scale` and its matrices are flat, (n_frames, n, size * size);
    equations and rows are divided by `row_scale` (n_frames, n_equations + n_rows).
    Bounds and rows are limits of x, -x and C x, (n_frames, 2 n + n_rows), zero where `has_limit` is False.
    """

    quadratic: FloatArray
    linear: FloatArray
    equations: FloatArray
    targets: FloatArray
    rows: FloatArray
    limits: FloatArray
    has_limit: BoolArray
    matrices: FloatArray
    constant: FloatArray
    scale: FloatArray
    row_scale: FloatArray
    least_cost: FloatArray

    def matrix(self, x: FloatArray) -> FloatArray:
        """Sum of x_i G_i, shape (n_frames, size, size)."""
        return (x[:, None, :] @ self.matrices).reshape(self.constant.shape)

    def products(self, matrix: FloatArray) -> FloatArray:
        """Inner products tr(G_i M), shape (n_frames, n)."""
        return (self.matrices @ matrix.reshape(len(matrix), -1, 1))[:, :, 0]

    def limited(self, x: FloatArray) -> FloatArray:
        """Give what has limits: x, -x and C x, shape (n_frames, n_limits)."""
        return np.concatenate([x, -x, (self.rows @ x[:, :, None])[:, :, 0]], axis=1)

    def push(self, multiplier: FloatArray) -> FloatArray:
        """Add up the forces on x of the multipliers of its limits, shape (n_frames, n)."""
        n = self.linear.shape[1]
        of_rows = (multiplier[:, None, 2 * n :] @ self.rows)[:, 0]
        return multiplier[:, :n] - multiplier[:, n : 2 * n] + of_rows


@dataclass(frozen=True, kw_only=True)
class _Point:
    """Unknowns, slacks and multipliers of every frame; also a step from one such point to another.

    `slack` and `multiplier` are those of the matrix inequality, (n_frames, size, size); those of the
    limits are (n_frames, n_limits), one and zero where there is no limit.
    """

    x: FloatArray
    equation_multiplier: FloatArray
    slack: FloatArray
    multiplier: FloatArray
    limit_slack: FloatArray
    limit_multiplier: FloatArray


@dataclass(frozen=True, kw_only=True)
class _Residual:
    """What is missing to an optimum, and the complementarity products: their sum and their mean."""

    stationarity: FloatArray
    equations: FloatArray
    slack: FloatArray
    limits: FloatArray
    gap: FloatArray
    mean_product: FloatArray


def _scaled(program: MatrixProgram, like: _Frames | None = None) -> _Frames:
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
    return _Frames(
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


def _start(frames: _Frames, given: FloatArray | None) -> _Point:
    """Unknowns as given, or in the middle of their bounds or one inside the only one; multipliers of one."""
    n = frames.linear.shape[1]
    low, high = frames.limits[:, :n], -frames.limits[:, n : 2 * n]
    has_low, has_high = frames.has_limit[:, :n], frames.has_limit[:, n : 2 * n]
    one_sided = np.where(has_low, low + 1.0, np.where(has_high, high - 1.0, 0.0))
    x = np.where(has_low & has_high, (low + high) / 2, one_sided)
    if given is not None:
        room = np.where(has_low & has_high, _ROOM * (high - low), _ROOM)
        x = np.where(has_low, np.maximum(given, low + room), given)
        x = np.where(has_high, np.minimum(x, high - room), x)
    one = np.broadcast_to(np.eye(frames.constant.shape[1]), frames.constant.shape)
    inside = frames.limited(x) - frames.limits
    return _Point(
        x=x,
        equation_multiplier=np.zeros(frames.targets.shape),
        slack=one,
        multiplier=one,
        limit_slack=np.where(frames.has_limit, np.maximum(inside, _LEAST_SLACK), 1.0),
        limit_multiplier=frames.has_limit.astype(float),
    )


def _gradient(frames: _Frames, point: _Point) -> FloatArray:
    return (frames.quadratic @ point.x[:, :, None])[:, :, 0] + frames.linear


def _largest_gradient(frames: _Frames, point: _Point) -> FloatArray:
    return np.abs(_gradient(frames, point)).max(axis=1)


def _residual(frames: _Frames, point: _Point) -> _Residual:
    reaction = (point.equation_multiplier[:, None, :] @ frames.equations)[:, 0]
    push = frames.products(point.multiplier) + frames.push(point.limit_multiplier)
    gap = (point.slack * point.multiplier).sum(axis=(1, 2))
    gap = gap + (point.limit_slack * point.limit_multiplier).sum(axis=1)
    count = frames.has_limit.sum(axis=1) + frames.constant.shape[1]
    inside = frames.limited(point.x) - frames.limits
    return _Residual(
        stationarity=reaction + push - _gradient(frames, point),
        equations=frames.targets - (frames.equations @ point.x[:, :, None])[:, :, 0],
        slack=frames.constant + frames.matrix(point.x) - point.slack,
        limits=np.where(frames.has_limit, inside - point.limit_slack, 0.0),
        gap=gap,
        mean_product=gap / count,
    )


def _absorbed(frames: _Frames, point: _Point) -> _Point:
    """Let the multipliers of lower bounds take up what stationarity lacks, where they change little.

    A cost such as x^1.5 has no second derivative at a bound of zero: Newton's steps leave an error in the
    gradient there that falls too slowly, and means nothing.
    """
    n = frames.linear.shape[1]
    of_low = point.limit_multiplier[:, :n]
    missing = _residual(frames, point).stationarity
    little = np.abs(missing) <= 0.5 * of_low
    multiplier = point.limit_multiplier.copy()
    multiplier[:, :n] = of_low - np.where(little, missing, 0.0)
    return replace(point, limit_multiplier=multiplier)


def _is_small(frames: _Frames, point: _Point, residual: _Residual, tolerance: FloatArray) -> BoolArray:
    """Tell which frames are done, shape (n_frames,)."""
    cost = np.maximum(_largest_gradient(frames, point), frames.least_cost)
    target = 1.0 + np.abs(frames.targets).max(axis=1, initial=0.0)
    limit = 1.0 + np.abs(frames.limits).max(axis=1, initial=0.0)
    return (
        (np.abs(residual.stationarity).max(axis=1) <= tolerance * cost)
        & (np.abs(residual.equations).max(axis=1, initial=0.0) <= tolerance * target)
        & (np.abs(residual.slack).max(axis=(1, 2)) <= tolerance)
        & (np.abs(residual.limits).max(axis=1, initial=0.0) <= tolerance * limit)
        & (residual.mean_product <= tolerance * cost)
    )


def _step(frames: _Frames, point: _Point, residual: _Residual) -> tuple[_Point, FloatArray]:
    """Mehrotra's corrected step and its length, shape (n_frames,)."""
    size = frames.constant.shape[1]
    inverse = _each(np.linalg.inv, (size, size), point.slack)
    inverse = (inverse + inverse.transpose(0, 2, 1)) / 2
    newton = _newton_matrix(frames, point, inverse)
    predicted = _direction(
        frames, point, residual, inverse, newton, np.zeros_like(point.slack), np.zeros_like(point.limit_slack)
    )
    primal, dual = (np.minimum(length, 1.0) for length in _to_boundary(point, predicted))
    slack = point.slack + primal[:, None, None] * predicted.slack
    multiplier = point.multiplier + dual[:, None, None] * predicted.multiplier
    limit_slack = point.limit_slack + primal[:, None] * predicted.limit_slack
    limit_multiplier = point.limit_multiplier + dual[:, None] * predicted.limit_multiplier
    after = (slack * multiplier).sum(axis=(1, 2)) + (limit_slack * limit_multiplier).sum(axis=1)
    share = after / np.where(residual.gap > 0, residual.gap, np.inf)
    # Complementarity must not run ahead of stationarity, which curved costs bring down more slowly.
    behind = _SHARE_OF_STATIONARITY * np.abs(residual.stationarity).max(axis=1)
    center = np.clip(share**3, 1e-4, 0.8) * residual.mean_product
    center = np.maximum(center, np.minimum(behind, residual.mean_product))[:, None]
    corrected = _direction(
        frames,
        point,
        residual,
        inverse,
        newton,
        center[:, :, None] * np.eye(size) - predicted.multiplier @ predicted.slack,
        center - predicted.limit_slack * predicted.limit_multiplier,
    )
    primal, dual = (np.minimum(_STEP * length, 1.0) for length in _to_boundary(point, corrected))
    # With a quadratic objective primal and dual residuals share x: one step length keeps both falling.
    length = np.where(np.isfinite(corrected.x).all(axis=1), np.minimum(primal, dual), 0.0)
    return corrected, length


def _newton_matrix(frames: _Frames, point: _Point, inverse: FloatArray) -> FloatArray:
    r"""Equations for the step of x and of the multipliers of the equations.

    .. math:: \begin{pmatrix} Q + M + D & -A^T \\ A & 0 \end{pmatrix}, \quad
              M_{ij} = \operatorname{tr}(G_i Z G_j S^{-1})
    """
    n_frames, n, _ = frames.matrices.shape
    n_equations = frames.targets.shape[1]
    total = n + n_equations
    cube = frames.matrices.reshape(n_frames, n, *frames.constant.shape[1:])
    product = point.multiplier[:, None] @ cube @ inverse[:, None]
    schur = frames.matrices @ product.transpose(0, 1, 3, 2).reshape(n_frames, n, -1).transpose(0, 2, 1)
    newton = np.zeros((n_frames, total, total))
    newton[:, :n, :n] = frames.quadratic + (schur + schur.transpose(0, 2, 1)) / 2
    ratio = point.limit_multiplier / point.limit_slack
    newton[:, np.arange(n), np.arange(n)] += ratio[:, :n] + ratio[:, n : 2 * n]
    if frames.rows.shape[1]:
        newton[:, :n, :n] += (frames.rows.transpose(0, 2, 1) * ratio[:, None, 2 * n :]) @ frames.rows
    newton[:, :n, n:] = -frames.equations.transpose(0, 2, 1)
    newton[:, n:, :n] = frames.equations
    newton[:, np.arange(total), np.arange(total)] += _REGULARIZATION
    return newton


def _direction(
    frames: _Frames,
    point: _Point,
    residual: _Residual,
    inverse: FloatArray,
    newton: FloatArray,
    wanted: FloatArray,
    wanted_of_limits: FloatArray,
) -> _Point:
    r"""Solve for the step that gives the complementarity products wanted.

    .. math:: \Delta Z = C S^{-1} - Z - \operatorname{sym}(Z \Delta S S^{-1}), \quad
              \Delta S = \sum_i \Delta x_i G_i + R_S
    """
    n = frames.linear.shape[1]
    has, s, z = frames.has_limit, point.limit_slack, point.limit_multiplier
    fixed = _symmetric(wanted @ inverse - point.multiplier - point.multiplier @ residual.slack @ inverse)
    of_limits = np.where(has, (wanted_of_limits - z * residual.limits) / s - z, 0.0)
    right = residual.stationarity + frames.products(fixed) + frames.push(of_limits)
    right = np.concatenate([right, residual.equations], axis=1)
    step = _each(np.linalg.solve, (right.shape[1], 1), newton, right[:, :, None])[:, :, 0]
    dx = step[:, :n]
    d_matrix = frames.matrix(dx)
    d_limit_slack = np.where(has, frames.limited(dx) + residual.limits, 0.0)
    return _Point(
        x=dx,
        equation_multiplier=step[:, n:],
        slack=d_matrix + residual.slack,
        multiplier=fixed - _symmetric(point.multiplier @ d_matrix @ inverse),
        limit_slack=d_limit_slack,
        limit_multiplier=np.where(has, (wanted_of_limits - z * d_limit_slack) / s - z, 0.0),
    )


def _symmetric(matrix: FloatArray) -> FloatArray:
    return (matrix + matrix.transpose(0, 2, 1)) / 2


def _to_boundary(point: _Point, step: _Point) -> tuple[FloatArray, FloatArray]:
    """Longest steps that keep slacks, and multipliers, positive; two arrays of shape (n_frames,)."""
    return (
        np.minimum(
            _definite_boundary(point.slack, step.slack),
            _linear_boundary(point.limit_slack, step.limit_slack),
        ),
        np.minimum(
            _definite_boundary(point.multiplier, step.multiplier),
            _linear_boundary(point.limit_multiplier, step.limit_multiplier),
        ),
    )


def _definite_boundary(matrix: FloatArray, step: FloatArray) -> FloatArray:
    """Longest step that keeps positive definite matrices so, shape (n_frames,); 0 where they are not."""
    shape = matrix.shape[1:]
    factor = _each(np.linalg.inv, shape, _each(np.linalg.cholesky, shape, matrix))
    least = _each(np.linalg.eigvalsh, shape[:1], factor @ step @ factor.transpose(0, 2, 1))[:, 0]
    return np.where(np.isnan(least), 0.0, np.where(least < 0, -1.0 / np.minimum(least, -1e-300), np.inf))


def _linear_boundary(values: FloatArray, steps: FloatArray) -> FloatArray:
    """Longest step that keeps positive numbers so, shape (n_frames,)."""
    ratio = np.where(steps < 0, values / np.maximum(-steps, 1e-300), np.inf)
    return ratio.min(axis=1, initial=np.inf)


def _each(function: Callable[..., FloatArray], shape: tuple[int, ...], *stacks: FloatArray) -> FloatArray:
    """Apply a function of linear algebra to stacks of matrices; NaN for those on which it fails.

    `shape` is that of one result.
    """
    try:
        return function(*stacks)
    except np.linalg.LinAlgError:
        pass
    results = np.full((len(stacks[0]), *shape), np.nan)
    for k, matrices in enumerate(zip(*stacks, strict=True)):
        with contextlib.suppress(np.linalg.LinAlgError):
            results[k] = function(*matrices)
    return results


_Data = TypeVar("_Data", _Frames, _Point, _Residual)


def _some(data: _Data, keep: BoolArray) -> _Data:
    """Keep some frames."""
    return type(data)(**{item.name: getattr(data, item.name)[keep] for item in fields(data)})


def _moved(point: _Point, step: _Point, length: FloatArray) -> _Point:
    """Go along a step, by the length of each frame."""
    moved = {}
    for item in fields(point):
        here, by = getattr(point, item.name), getattr(step, item.name)
        moved[item.name] = here + length.reshape(-1, *(1,) * (here.ndim - 1)) * by
    return _Point(**moved)
