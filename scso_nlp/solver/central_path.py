r"""Optima of costs that are one power of every unknown, each unknown exact in its own scale.

For frames apart from each other, :math:`\min\; w^T |x|^p + q^T x` with :math:`A x - s = b`, s = 0 in
equations, and bounds of x and s. With multipliers y of rows and z, v of lower and upper bounds, an unknown
balances where

.. math:: p\, w\, |x|^{p-1} \operatorname{sign} x = -q - A^T y + z - v

Newton's method follows the central path :math:`z (x - x_\min) = v (x_\max - x) = \mu \to 0` with predictor
and corrector (Mehrotra 1992, SIAM J Optim 2:575-601). The curvature of a power is that of the chord from x to
where it would balance, so that high exponents take no more steps to come from afar. Unknowns are eliminated
first, :math:`A D A^T \delta y = \dots` with a diagonal D: however many powers of ten costs are apart, numbers
of one unknown meet those of another only in rows that they share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scso_nlp.solver.powers import Powers
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: A frame has arrived when nothing misses its condition by more than this share of what it is made of [-].
_ARRIVED = 1e-12
#: Most steps, and those without getting nearer by half once a frame is near [-].
_MOST_STEPS, _MOST_IDLE_STEPS, _NEAR = 300, 30, 1e-2
#: Share of the way to the nearest bound that a step takes; least share of products to aim at [-].
_SHARE_OF_WAY, _LEAST_AIM = 0.99, 1e-4
#: An unknown without bounds goes no farther in a step than its size, that at which it would balance, or this
#: much of the frame's largest [-].
_REACH = 1e-3
#: Products of the predictor count at most this often in the corrector's aim [-].
_MOST_CORRECTION = 10.0
#: Where an unknown is nearer to its balance, the chord is the tangent [-].
_APART = 1e-4
#: Smallest size of an unknown over the frame's largest where its curvature is taken [-].
_SMALLEST = 1e-12
#: Added to the diagonal of the scaled normal equations, and the refinements that take it back.
_RIDGE, _REFINEMENTS = 2.0**-50, 3
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, kw_only=True)
class _Frames:
    """Some frames in numbers: rows (k, n_rows, n) with slacks behind the unknowns, bounds and powers (k, n).

    `sides` are the rows that have a slack. Unknowns that an equation determines have no choice to be missed.
    """

    rows: FloatArray
    aim: FloatArray
    lower: FloatArray
    upper: FloatArray
    weight: FloatArray
    slope: FloatArray
    is_determined: BoolArray
    sides: IntArray
    exponent: float

    def only(self, which: IntArray | BoolArray) -> _Frames:
        """Keep some frames."""
        shared = ("sides", "exponent")
        own: dict[str, Any] = {name: array[which] for name, array in vars(self).items() if name not in shared}
        return replace(self, **own)

    @property
    def is_fixed(self) -> BoolArray:
        """Unknowns without choice."""
        return self.lower == self.upper

    @property
    def has_lower(self) -> BoolArray:
        """Unknowns with a lower bound and room above it."""
        return np.isfinite(self.lower) & ~self.is_fixed

    @property
    def has_upper(self) -> BoolArray:
        """Unknowns with an upper bound and room below it."""
        return np.isfinite(self.upper) & ~self.is_fixed


@dataclass(kw_only=True)
class _Point:
    """Unknowns, distances to and multipliers of their bounds (k, n), multipliers of rows (k, n_rows)."""

    x: FloatArray
    above: FloatArray
    below: FloatArray
    of_lower: FloatArray
    of_upper: FloatArray
    of_rows: FloatArray

    def only(self, which: BoolArray) -> _Point:
        """Keep some frames."""
        return _Point(**{name: array[which] for name, array in vars(self).items()})

    def put(self, frames: IntArray | BoolArray, other: _Point, which: BoolArray) -> None:
        """Take some of another's frames, which are these here."""
        for name, array in vars(self).items():
            array[frames] = np.where(which[:, None], getattr(other, name), array[frames])


@np.errstate(all="ignore")
def follow_central_path(
    program: FrameProgram, powers: Powers, frames: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Find the optima of some frames.

    Parameters
    ----------
    program : FrameProgram
        Without coupling, its rows affine.
    powers : Powers
        Its objective.
    frames : ndarray of int

    Returns
    -------
    unknowns : ndarray, shape (n, n_unknowns)
        Scaled; NaN where nothing was found. Nothing of this is graded.
    multipliers : ndarray, shape (n, n_rows)
        Of the affine rows, in the solver's sign and scale.
    """
    given, length = _numbers(program, powers, frames)
    point = _start(given)
    nearest, missed = _follow(given, point, is_exact=False)
    left = (missed > _ARRIVED) & (missed <= _NEAR)
    if left.any():
        other, again = _follow(given.only(left), nearest.only(left), is_exact=True)
        nearest.put(left, other, again < missed[left])
        missed[left] = np.fmin(missed[left], again)
    unknowns = nearest.x[:, : program.layout.size]
    return np.where(np.isfinite(missed)[:, None], unknowns, np.nan), nearest.of_rows / length


def _follow(given: _Frames, point: _Point, *, is_exact: bool) -> tuple[_Point, FloatArray]:
    """Take steps until frames have arrived or get no nearer; give the nearest points and what they miss."""
    nearest, going = point.only(np.ones(len(point.x), dtype=bool)), np.arange(len(point.x))
    least, idle = np.full(going.size, np.inf), np.zeros(going.size, dtype=np.int64)
    for _ in range(_MOST_STEPS):
        missed = _missed(given, point)
        idle[going] = np.where(missed < least[going] / 2, 0, idle[going] + 1)
        is_nearer = missed < least[going]
        nearest.put(going, point, is_nearer)
        least[going] = np.fmin(least[going], missed)
        is_idle = (idle[going] > _MOST_IDLE_STEPS) & (least[going] <= _NEAR)
        open_ = (missed > _ARRIVED) & np.isfinite(missed) & ~is_idle
        if not open_.all():
            given, point, going = given.only(open_), point.only(open_), going[open_]
            if not going.size:
                break
        _step(given, point, is_exact=is_exact)
    return nearest, least


def _numbers(program: FrameProgram, powers: Powers, frames: IntArray) -> tuple[_Frames, FloatArray]:
    """Numbers of some frames, rows divided by their lengths (k, n_rows)."""
    affine, table = program.split.affine.frames(frames), program.rows
    used = ~affine.is_empty & (np.isfinite(table.lower) | np.isfinite(table.upper))[affine.rows]
    rows = affine.dense(program.layout.size) * used[:, :, None]
    length = np.abs(rows).max(axis=2, initial=0.0)
    length = np.where(length > 0, length, 1.0)
    least, most = (
        np.where(used, (bound[affine.rows] - affine.constant) / length, 0.0)
        for bound in (table.lower, table.upper)
    )
    side = np.flatnonzero((table.lower != table.upper)[affine.rows])
    slacks = np.zeros((frames.size, affine.rows.size, side.size))
    slacks[:, side, np.arange(side.size)] = -1.0
    aim = least.copy()
    aim[:, side] = 0.0
    none = np.zeros((frames.size, side.size))
    lower, upper = (bound[frames] for bound in program.bounds())
    return _Frames(
        rows=np.concatenate([rows / length[:, :, None], slacks], axis=2),
        aim=aim,
        lower=np.hstack([lower, least[:, side]]),
        upper=np.hstack([upper, most[:, side]]),
        weight=np.hstack([powers.weight[frames], none]),
        slope=np.hstack([powers.slope[frames], none]),
        is_determined=np.hstack([affine.determined(table, program.layout.size), none > 0]),
        sides=side,
        exponent=powers.exponent,
    ), length


def _start(given: _Frames) -> _Point:
    """Begin in the middle between bounds, at what unknowns without bounds must be then to keep the rows."""
    lower, upper = given.lower, given.upper
    low, high = (np.where(np.isfinite(bound), bound, 0.0) for bound in (lower, upper))
    has_lower, has_upper = given.has_lower, given.has_upper
    middle = np.where(has_lower & has_upper, (low + high) / 2, np.where(has_lower, low + 1.0, high - 1.0))
    is_open = ~(np.isfinite(lower) | np.isfinite(upper))
    x: FloatArray = np.where(given.is_fixed, low, np.where(is_open, 0.0, middle))
    open_rows = given.rows * is_open[:, None, :]
    gram = open_rows @ open_rows.transpose(0, 2, 1) + _SMALLEST * np.eye(given.aim.shape[1])
    inverse = np.asarray(np.linalg.inv(gram), dtype=np.float64)
    x = x + _times(open_rows.transpose(0, 2, 1), _times(inverse, given.aim - _times(given.rows, x)))
    slopes = np.abs(_slope(given, x) + given.slope)
    size = np.maximum(slopes, given.weight).max(axis=1, initial=_TINY, keepdims=True)
    return _Point(
        x=x,
        above=np.where(has_lower, x - low, 1.0),
        below=np.where(has_upper, high - x, 1.0),
        of_lower=np.where(has_lower, size, 0.0),
        of_upper=np.where(has_upper, size, 0.0),
        of_rows=np.zeros(given.aim.shape),
    )


def _slope(given: _Frames, x: FloatArray) -> FloatArray:
    """Slopes of the powers."""
    p = given.exponent
    return np.asarray(p * given.weight * np.sign(x) * np.abs(x) ** (p - 1))


def _asked(given: _Frames, point: _Point) -> FloatArray:
    """Slopes that the powers would have in balance with everything else."""
    push = _times(given.rows.transpose(0, 2, 1), point.of_rows)
    return np.asarray(-push + point.of_lower - point.of_upper - given.slope)


def _missed(given: _Frames, point: _Point) -> FloatArray:
    """Largest share by which a balance, row or bound is missed, shape (k,); infinite where numbers end."""
    x, rows = point.x, np.abs(given.rows)
    slope = _slope(given, x)
    own = np.abs(slope) + np.abs(given.slope) + _times(rows.transpose(0, 2, 1), np.abs(point.of_rows))
    every = own + point.of_lower + point.of_upper
    if given.sides.size:  # what holds a slack is compared with what else acts on the unknowns of its row
        n = x.shape[1] - given.sides.size
        shares = rows[:, given.sides, :n] / np.maximum(own[:, None, :n], _TINY)
        own[:, n:] = 1 / shares.max(axis=2, initial=_TINY)
    has_choice = ~(given.is_fixed | given.is_determined)
    balance = np.where(has_choice, np.abs(slope - _asked(given, point)) / np.maximum(every, _TINY), 0.0)
    entries = _times(rows, np.abs(x)) + np.abs(given.aim)
    kept = np.abs(given.aim - _times(given.rows, x)) / np.maximum(entries, _TINY)
    size, missed = np.maximum(np.abs(x).max(axis=1, keepdims=True), _TINY), [balance, kept]
    for multiplier, distance in ((point.of_lower, point.above), (point.of_upper, point.below)):
        share = np.minimum(multiplier / np.maximum(own, _TINY), distance / size)
        missed.append(np.where(has_choice, share, 0.0))
    worst = np.max([part.max(axis=1, initial=0.0) for part in missed], axis=0)
    return np.where(np.isfinite(worst), worst, np.inf)


def _step(given: _Frames, point: _Point, *, is_exact: bool) -> None:
    """Take one step, in place."""
    has_lower, has_upper = given.has_lower, given.has_upper
    curvature, left, reach = _linearized(given, point)
    total = curvature + point.of_lower / point.above + point.of_upper / point.below
    direction = _Direction(given, point, left, np.where(given.is_fixed, 0.0, 1 / total), is_exact=is_exact)
    nothing = np.zeros_like(point.x)
    first, of_lower, of_upper, _ = direction.towards(nothing, nothing)
    way = _way(given, point, first, of_lower, of_upper)
    products = point.of_lower * point.above * has_lower + point.of_upper * point.below * has_upper
    n_bounds = np.maximum(has_lower.sum(axis=1) + has_upper.sum(axis=1), 1)
    mean = products.sum(axis=1, keepdims=True) / n_bounds[:, None]
    aim = np.maximum((1 - way) ** 3, _LEAST_AIM) * mean
    most = _MOST_CORRECTION * aim
    x, of_lower, of_upper, of_rows = direction.towards(
        np.where(has_lower, aim - np.clip(first * of_lower, -most, most), 0.0),
        np.where(has_upper, aim + np.clip(first * of_upper, -most, most), 0.0),
    )
    way = _way(given, point, x, of_lower, of_upper)
    way = np.where(way < 1, _SHARE_OF_WAY * way, 1.0)
    way = np.minimum(way, (reach / np.abs(x)).min(axis=1, keepdims=True))
    # the distance to the nearer bound is exact, however near
    point.above = np.where(has_lower, point.above + way * x, point.above)
    point.below = np.where(has_upper, point.below - way * x, point.below)
    by_lower = has_lower & (~has_upper | (point.above <= point.below))
    moved = np.where(
        by_lower, given.lower + point.above, np.where(has_upper, given.upper - point.below, point.x + way * x)
    )
    point.x = np.where(given.is_fixed, point.x, moved)
    point.of_lower = point.of_lower + way * of_lower
    point.of_upper = point.of_upper + way * of_upper
    point.of_rows = point.of_rows + way * of_rows


def _linearized(given: _Frames, point: _Point) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvatures of the powers, what their slopes lack, and how far their unknowns may go, shapes (k, n).

    The curvature is that of the chord from where an unknown is to where it would balance.
    """
    p, weight, x = given.exponent, given.weight, point.x
    slope, asked = _slope(given, x), _asked(given, point)
    balanced = np.sign(asked) * np.where(weight > 0, (np.abs(asked) / (p * weight)) ** (1 / (p - 1)), 0.0)
    largest = np.abs(x).max(axis=1, keepdims=True)
    near = np.maximum(np.maximum(np.abs(x), np.abs(balanced)), _SMALLEST * largest)
    is_apart = np.abs(x - balanced) > _APART * near
    tangent = p * (p - 1) * weight * near ** (p - 2)
    curvature = np.where(is_apart, (slope - asked) / (x - balanced), tangent)
    is_open = (weight > 0) & ~(given.has_lower | given.has_upper)
    reach = np.where(is_open, np.maximum(near, _REACH * largest), np.inf)
    return np.where(weight > 0, curvature, 0.0), asked - slope, reach


class _Direction:
    """Newton's equations at a point, factorised.

    By normal equations of the rows; or exactly, by an orthogonal basis of weighted unknowns sorted by their
    size (Cox and Higham 1998, in Numerical Analysis 1997, 57-73), three times as dear: this tells rows apart
    that one unknown of little curvature makes nearly the same.
    """

    def __init__(
        self, given: _Frames, point: _Point, left: FloatArray, inverse: FloatArray, *, is_exact: bool
    ) -> None:
        self.given, self.point, self.left, self.inverse = given, point, left, inverse
        self.lacking = given.aim - _times(given.rows, point.x)
        self.root, n_rows = np.sqrt(inverse), given.aim.shape[1]
        self.basis: FloatArray | None = None
        self.scale = np.ones(given.aim.shape)
        if is_exact:
            weighted = given.rows.transpose(0, 2, 1) * self.root[:, :, None]
            order = np.argsort(-np.abs(weighted).max(axis=2, initial=0.0), axis=1)[:, :, None]
            basis, factor = np.linalg.qr(np.nan_to_num(np.take_along_axis(weighted, order, axis=1)))
            self.basis = np.empty_like(basis)
            np.put_along_axis(self.basis, order, basis, axis=1)
            diagonal = np.einsum("kii->ki", factor)
            self.solved = np.linalg.inv(factor + (diagonal == 0)[:, :, None] * np.eye(n_rows))
            return
        normal = (given.rows * inverse[:, None, :]) @ given.rows.transpose(0, 2, 1)
        diagonal = np.einsum("kii->ki", normal)
        self.scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        normal = normal * self.scale[:, :, None] * self.scale[:, None, :]
        normal += (_RIDGE + (diagonal == 0))[:, :, None] * np.eye(n_rows)
        is_number = np.isfinite(normal).all(axis=(1, 2), keepdims=True)
        self.solved = np.linalg.inv(np.where(is_number, normal, np.eye(n_rows)))

    def towards(
        self, lower: FloatArray, upper: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Give steps of unknowns, of multipliers of bounds and of rows, to these products at the bounds."""
        given, point = self.given, self.point
        has_lower, has_upper = given.has_lower, given.has_upper
        right = self.left + np.where(has_lower, lower / point.above - point.of_lower, 0.0)
        right -= np.where(has_upper, upper / point.below - point.of_upper, 0.0)
        if self.basis is None:
            x, of_rows = self.inverse * right, np.zeros_like(given.aim)
        else:
            inside = _times(self.basis.transpose(0, 2, 1), self.root * right)
            x = self.root * (self.root * right - _times(self.basis, inside))
            of_rows = _times(self.solved, inside)
        for _ in range(_REFINEMENTS):
            missing = self.lacking - _times(given.rows, x)
            if self.basis is None:
                change = self.scale * _times(self.solved, self.scale * missing)
                x = x + self.inverse * _times(given.rows.transpose(0, 2, 1), change)
            else:
                inside = _times(self.solved.transpose(0, 2, 1), missing)
                x = x + self.root * _times(self.basis, inside)
                change = _times(self.solved, inside)
            of_rows = of_rows - change
        of_lower = np.where(has_lower, (lower - point.of_lower * x) / point.above - point.of_lower, 0.0)
        of_upper = np.where(has_upper, (upper + point.of_upper * x) / point.below - point.of_upper, 0.0)
        return x, of_lower, of_upper, of_rows


def _way(
    given: _Frames, point: _Point, x: FloatArray, of_lower: FloatArray, of_upper: FloatArray
) -> FloatArray:
    """Share of a step, at most 1, at which a distance or a multiplier of a bound vanishes, shape (k, 1)."""
    way = np.ones((len(x), 1))
    for has, here, step in (
        (given.has_lower, point.above, x),
        (given.has_upper, point.below, -x),
        (given.has_lower, point.of_lower, of_lower),
        (given.has_upper, point.of_upper, of_upper),
    ):
        share = np.where(has & (step < 0), -here / step, np.inf)
        way = np.minimum(way, share.min(axis=1, keepdims=True))
    return way


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Products of matrices (k, m, n) and vectors (k, n), shape (k, m)."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])
