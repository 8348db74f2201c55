"""One frame near its optimum: what rows, bounds, a matrix and a little more effort allow, and certificates.

How far it goes is sought in :mod:`scso_nlp.solver.extreme_paths`, and with a matrix inequality in
:mod:`scso_nlp.solver.extreme_cones`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.solver.powers import Powers
from scso_nlp.validation import BoolArray, FloatArray

#: Rows of which no more than this is left without what they determine are of nothing else [-].
_EMPTY = 1e-11


@dataclass(frozen=True, kw_only=True)
class Matrix:
    r"""A matrix :math:`K + \sum_i x_i G_i` that is to stay positive semi-definite.

    Attributes
    ----------
    constant : ndarray, shape (size, size)
    slopes : ndarray, shape (n_unknowns, size, size)
    """

    constant: FloatArray
    slopes: FloatArray

    def among(self, free: BoolArray, fixed: FloatArray) -> Matrix:
        """Take the other unknowns as the numbers they have."""
        constant = self.constant + np.einsum("i,iab->ab", fixed, self.slopes)
        return Matrix(constant=constant, slopes=self.slopes[free])


@dataclass(frozen=True, kw_only=True)
class Extremes:
    """Points with the least value of each cost, and multipliers there that certify it.

    Attributes
    ----------
    points : ndarray, shape (n_costs, n_unknowns)
    multipliers : ndarray, shape (n_costs, n_rows)
        y of :mod:`scso_nlp.solver.extremes`.
    weight : ndarray, shape (n_costs,)
        Of effort, 1/s.
    of_matrix : ndarray, shape (n_costs, size, size), or None
        Lambda, of the matrix inequality.
    """

    points: FloatArray
    multipliers: FloatArray
    weight: FloatArray
    of_matrix: FloatArray | None = None


class NearOptimum:
    """A frame; unknowns that an equation determines by itself are numbers.

    Attributes
    ----------
    costs : ndarray, shape (2 n_costs, n)
        Of which the least is sought: what was asked for, then its opposite.
    rows : ndarray, shape (n_rows, n)
        Of largest entry one.
    low, high : ndarray, shape (n_rows,)
    lower, upper : ndarray, shape (n,)
    optimum : ndarray, shape (n,)
    effort : Powers
        Over its value at the optimum.
    most, rise : float
        Effort that is allowed, and how much of it is beyond the optimum.
    reachable : (ndarray, ndarray), shape (n,)
        Bounds, or what each unknown alone may cost.
    floor : ndarray, shape (2 n_costs,)
        Least costs within these.
    is_open : ndarray of bool, shape (2 n_costs,)
        Costs that may be lower than at the optimum.
    """

    def __init__(
        self,
        *,
        optimum: FloatArray,
        free: BoolArray,
        bounds: tuple[FloatArray, FloatArray],
        rows: tuple[FloatArray, FloatArray, FloatArray],
        matrix: Matrix | None,
        powers: Powers,
        share: float,
        costs: FloatArray,
    ) -> None:
        # what an equation determines by itself is no choice: it stays where it is, and costs nothing here
        fixed = np.where(free, 0.0, optimum)
        of_all, low, high = rows
        left, held = of_all[:, free], of_all @ fixed
        length = np.abs(left).max(axis=1, initial=0.0)
        used = length > _EMPTY * np.abs(of_all).max(axis=1, initial=0.0)
        length = length[used]
        self.rows = left[used] / length[:, None]
        self.low, self.high = ((side - held)[used] / length for side in (low, high))
        self.matrix = None if matrix is None else matrix.among(free, fixed)
        self.lower, self.upper = (bound[free] for bound in bounds)
        self.optimum = optimum[free]
        self.effort = powers.over(abs(float(powers.value(self.optimum))) or 1.0)
        least = float(self.effort.value(self.optimum))
        self.rise = share * abs(least)
        self.most = least + self.rise
        self.alone = self._alone()
        self.settled, costs = costs @ fixed, costs[:, free]
        self.costs = np.concatenate([costs, -costs])
        self.is_open = (np.abs(self.costs).max(axis=1, initial=0.0) > 0) & (self.rise > 0)
        self.reachable = self._reachable()
        lower, upper = self.reachable
        with np.errstate(invalid="ignore"):
            nearest = np.where(self.costs > 0, self.costs * lower, self.costs * upper)
        self.floor = np.where(self.costs == 0, 0.0, nearest).sum(axis=1)

    def attained_and_certified(self, found: Extremes) -> tuple[FloatArray, FloatArray]:
        """Give what was asked for at the points, and its bounds; (2, n_costs) each, least before greatest."""
        n = len(self.settled)
        value = (self.costs * found.points).sum(axis=1)
        bound = np.minimum(np.maximum(self.bounds(found), self.floor), value)
        bound = np.where(self.is_open, bound, value)
        attained, certified = (np.stack([each[:n], -each[n:]]) + self.settled for each in (value, bound))
        return attained, certified

    def bounds(self, found: Extremes) -> FloatArray:
        """Lower bounds of the costs from duality, whatever the multipliers are, shape (2 n_costs,).

        Of the multiplier of the matrix, what is positive semi-definite counts.
        """
        y = found.multipliers
        y = np.where(np.isfinite(np.where(y > 0, self.high, self.low)), y, 0.0)
        held = (y * np.where(y == 0, 0.0, np.where(y > 0, self.high, self.low))).sum(axis=1)
        slope = self.costs + y @ self.rows
        if found.of_matrix is not None and self.matrix is not None:
            values, vectors = np.linalg.eigh(found.of_matrix)
            push = (vectors * np.maximum(values, 0.0)[:, None]) @ vectors.transpose(0, 2, 1)
            slope = slope - np.einsum("cab,iab->ci", push, self.matrix.slopes)
            held = held + np.einsum("cab,ab->c", push, self.matrix.constant)
        weight = found.weight
        return np.asarray(self.effort.least(weight, slope, *self.reachable) - self.most * weight - held)

    def _alone(self) -> FloatArray:
        """Size at which each unknown alone costs all there may be, where others cost no less than nothing."""
        effort = self.effort
        with np.errstate(divide="ignore"):
            return np.where(
                effort.weight > 0,
                (self.most / effort.weight) ** (1 / effort.exponent),
                self.most / effort.slope,
            )

    def _reachable(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of the unknowns, and what each alone may cost where none costs less than nothing."""
        lower, upper = self.lower.copy(), self.upper.copy()
        slope, is_power = self.effort.slope, self.effort.weight > 0
        never_less = np.where(is_power, slope == 0, (slope == 0) | (slope > 0) & (lower >= 0))
        if never_less.all() and self.effort.constant >= 0:
            costs = is_power | (slope > 0)
            upper[costs] = np.minimum(upper, self.alone)[costs]
            lower[is_power] = np.maximum(lower, -self.alone)[is_power]
        return lower, upper
