"""Steps of a primal-dual interior-point method for all frames at once, as batched arrays.

What the frames are, and what their answers mean, is in :mod:`scso_nlp.solver.conic`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from scso_nlp.validation import BoolArray, FloatArray

#: Steps go this far towards the boundary.
_STEP = 0.98

#: The complementarity products wanted are at least this share of what stationarity lacks.
_SHARE_OF_STATIONARITY = 1e-3

#: Added to the diagonal of the Newton equations, so that dependent equations can be solved.
_REGULARIZATION = 1e-12

#: A starting point keeps this share of the distance of two bounds, or this much of one, from them.
_ROOM = 0.05

#: Least slack of a bound or row at the starting point.
_LEAST_SLACK = 1e-2


@dataclass(frozen=True, kw_only=True)
class Frames:
    """The program as the iterations use it.

    Attributes
    ----------
    quadratic, linear : ndarray, shapes (n_frames, n, n) and (n_frames, n)
    equations, targets, rows : ndarray
        Those of the program, divided by `row_scale`.
    limits, has_limit : ndarray, shape (n_frames, 2 n + n_rows)
        Bounds and rows are limits of x, -x and C x; zero where there is none.
    matrices, constant : ndarray, shapes (n_frames, n, size * size) and (n_frames, size, size)
        Those of the matrix inequality, divided by `scale`, the first flat.
    scale, row_scale : ndarray, shapes (n_frames,) and (n_frames, n_equations + n_rows)
    least_cost : ndarray, shape (n_frames,)
        Costs are measured by their gradient, but by no less than this.
    damping : ndarray, shape (n_frames,)
        Curvature of every unknown, over what stationarity lacks, that steps are given besides their own.
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
    damping: FloatArray

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
class Point:
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
class Residual:
    """What is missing to an optimum, and the complementarity products: their sum and their mean."""

    stationarity: FloatArray
    equations: FloatArray
    slack: FloatArray
    limits: FloatArray
    gap: FloatArray
    mean_product: FloatArray


def first_point(frames: Frames, given: FloatArray | None) -> Point:
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
    return Point(
        x=x,
        equation_multiplier=np.zeros(frames.targets.shape),
        slack=one,
        multiplier=one,
        limit_slack=np.where(frames.has_limit, np.maximum(inside, _LEAST_SLACK), 1.0),
        limit_multiplier=frames.has_limit.astype(float),
    )


def _gradient(frames: Frames, point: Point) -> FloatArray:
    return (frames.quadratic @ point.x[:, :, None])[:, :, 0] + frames.linear


def largest_gradient(frames: Frames, point: Point) -> FloatArray:
    """Largest entry of the gradient of the cost, shape (n_frames,)."""
    return np.abs(_gradient(frames, point)).max(axis=1)


def residual_at(frames: Frames, point: Point) -> Residual:
    """Give what is missing to an optimum."""
    reaction = (point.equation_multiplier[:, None, :] @ frames.equations)[:, 0]
    push = frames.products(point.multiplier) + frames.push(point.limit_multiplier)
    gap = (point.slack * point.multiplier).sum(axis=(1, 2))
    gap = gap + (point.limit_slack * point.limit_multiplier).sum(axis=1)
    count = frames.has_limit.sum(axis=1) + frames.constant.shape[1]
    inside = frames.limited(point.x) - frames.limits
    return Residual(
        stationarity=reaction + push - _gradient(frames, point),
        equations=frames.targets - (frames.equations @ point.x[:, :, None])[:, :, 0],
        slack=frames.constant + frames.matrix(point.x) - point.slack,
        limits=np.where(frames.has_limit, inside - point.limit_slack, 0.0),
        gap=gap,
        mean_product=gap / count,
    )


def pushed_rows(frames: Frames, point: Point) -> FloatArray:
    """Multipliers of the rows of the program, without their scale, shape (n_frames, n_rows)."""
    n, n_equations = frames.linear.shape[1], frames.targets.shape[1]
    return point.limit_multiplier[:, 2 * n :] / frames.row_scale[:, n_equations:]


def absorbed(frames: Frames, point: Point) -> Point:
    """Let multipliers of lower bounds and slacks of rows take up what is missing, where they change little.

    A cost such as x^1.5 has no second derivative at a bound of zero: Newton's steps leave an error in the
    gradient there that falls too slowly, and means nothing; nor does what a curved row leaves that is kept.
    """
    n = frames.linear.shape[1]
    of_low, of_rows = point.limit_multiplier[:, :n], point.limit_slack[:, 2 * n :]
    residual = residual_at(frames, point)
    multiplier, slack = point.limit_multiplier.copy(), point.limit_slack.copy()
    missing, left = residual.stationarity, residual.limits[:, 2 * n :]
    multiplier[:, :n] = of_low - np.where(np.abs(missing) <= 0.5 * of_low, missing, 0.0)
    slack[:, 2 * n :] = of_rows + np.where(np.abs(left) <= 0.5 * of_rows, left, 0.0)
    return replace(point, limit_multiplier=multiplier, limit_slack=slack)


def largest_residual(frames: Frames, point: Point, residual: Residual) -> FloatArray:
    """Give the largest relative residual or gap of each frame.

    Parameters
    ----------
    frames : Frames
    point : Point
    residual : Residual
        At the point.

    Returns
    -------
    ndarray, shape (n_frames,) [-]
    """
    cost = np.maximum(largest_gradient(frames, point), frames.least_cost)
    target = 1.0 + np.abs(frames.targets).max(axis=1, initial=0.0)
    limit = 1.0 + np.abs(frames.limits).max(axis=1, initial=0.0)
    parts = (
        np.abs(residual.stationarity).max(axis=1) / cost,
        np.abs(residual.equations).max(axis=1, initial=0.0) / target,
        np.abs(residual.slack).max(axis=(1, 2)),
        np.abs(residual.limits).max(axis=1, initial=0.0) / limit,
        residual.mean_product / cost,
    )
    return np.asarray(np.max(parts, axis=0))


def step_from(frames: Frames, point: Point, residual: Residual) -> tuple[Point, FloatArray]:
    """Mehrotra's corrected step and its length, shape (n_frames,)."""
    size = frames.constant.shape[1]
    inverse = _each(np.linalg.inv, (size, size), point.slack)
    inverse = (inverse + inverse.transpose(0, 2, 1)) / 2
    damping = frames.damping * np.abs(residual.stationarity).max(axis=1)
    newton = _newton_matrix(frames, point, inverse, damping)
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


def _newton_matrix(frames: Frames, point: Point, inverse: FloatArray, damping: FloatArray) -> FloatArray:
    r"""Equations for the step of x and of the multipliers of the equations, with some curvature more.

    .. math:: \begin{pmatrix} Q + M + D & -A^T \\ A & 0 \end{pmatrix}, \quad
              M_{ij} = \operatorname{tr}(G_i Z G_j S^{-1})
    """
    n_frames, n, _ = frames.matrices.shape
    n_equations = frames.targets.shape[1]
    total = n + n_equations
    size = frames.constant.shape[1]
    below = frames.matrices.reshape(n_frames, n * size, size)  # all G_i, one below the other
    held = (below @ point.multiplier).reshape(n_frames, n, -1)
    turned = (below @ inverse).reshape(n_frames, n, size, size).transpose(0, 1, 3, 2)
    schur = held @ turned.reshape(n_frames, n, -1).transpose(0, 2, 1)
    newton = np.zeros((n_frames, total, total))
    newton[:, :n, :n] = frames.quadratic + (schur + schur.transpose(0, 2, 1)) / 2
    ratio = point.limit_multiplier / point.limit_slack
    newton[:, np.arange(n), np.arange(n)] += ratio[:, :n] + ratio[:, n : 2 * n] + damping[:, None]
    if frames.rows.shape[1]:
        newton[:, :n, :n] += (frames.rows.transpose(0, 2, 1) * ratio[:, None, 2 * n :]) @ frames.rows
    newton[:, :n, n:] = -frames.equations.transpose(0, 2, 1)
    newton[:, n:, :n] = frames.equations
    newton[:, np.arange(total), np.arange(total)] += _REGULARIZATION
    return newton


def _direction(
    frames: Frames,
    point: Point,
    residual: Residual,
    inverse: FloatArray,
    newton: FloatArray,
    wanted: FloatArray,
    wanted_of_limits: FloatArray,
) -> Point:
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
    return Point(
        x=dx,
        equation_multiplier=step[:, n:],
        slack=d_matrix + residual.slack,
        multiplier=fixed - _symmetric(point.multiplier @ d_matrix @ inverse),
        limit_slack=d_limit_slack,
        limit_multiplier=np.where(has, (wanted_of_limits - z * d_limit_slack) / s - z, 0.0),
    )


def _symmetric(matrix: FloatArray) -> FloatArray:
    return (matrix + matrix.transpose(0, 2, 1)) / 2


def _to_boundary(point: Point, step: Point) -> tuple[FloatArray, FloatArray]:
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


_Data = TypeVar("_Data", Frames, Point, Residual)


def some(data: _Data, keep: BoolArray) -> _Data:
    """Keep some frames."""
    return type(data)(**{item.name: getattr(data, item.name)[keep] for item in fields(data)})


def moved(point: Point, step: Point, length: FloatArray) -> Point:
    """Go along a step, by the length of each frame."""
    values = {}
    for item in fields(point):
        here, by = getattr(point, item.name), getattr(step, item.name)
        values[item.name] = here + length.reshape(-1, *(1,) * (here.ndim - 1)) * by
    return Point(**values)
