r"""Extremes of a frame with rows only, along paths.

The least :math:`c^T x` with effort :math:`E(x) \le \beta`, all rows and all bounds is where the path

.. math:: x(s) = \arg\min_x E(x) + s\, c^T x

meets :math:`E = \beta`. With exponent 2 the path is piecewise linear, and a few quadratic programs by the
active-set method DAQP find it, each warm from the last; with other exponents every point of it takes a few
steps of Newton's method, each such a program. Multipliers of the rows, over s, are those of the certificate.
"""

from __future__ import annotations

import daqp
import numpy as np
from scipy.optimize import brentq

from scso_nlp.solver.near_optimum import Extremes, NearOptimum
from scso_nlp.validation import FloatArray

#: Effort is met to this much of it [-], by at most so many quadratic programs for one extreme.
_PRECISION, _MOST_PROGRAMS = 1e-9, 40
#: Sides are kept to this, relative to rows of largest entry one.
_SIDES = 1e-10
#: Curvature of unknowns that cost linearly, over the largest [-], about where they were found last; most
#: times they are sought again, until they move by less than this much of themselves, or of one.
_FLATNESS, _MOST_RETURNS, _ARRIVED = 1e-8, 8, 1e-10
#: Beyond this much of its first guess effort no longer counts: rows and bounds alone decide.
_STEEPEST = 1e8
#: An unknown nearer to a bound than this is at it, where rows and bounds alone decide [-].
_AT_BOUND = 1e-7
#: A piece of the path that a step leaves longer than this much of it is halved [-].
_LEAST_GAIN = 0.5
#: Newton's method has arrived at a point of the path when a step promises less than this of the effort that
#: may be added [-]; most steps, and halvings of each.
_PROMISE, _MOST_STEPS, _MOST_HALVINGS = 1e-10, 40, 20
#: Of a step's promise, what has to be kept [-].
_KEPT_PROMISE = 1e-4
#: Curvature is taken this much nearer to zero with every step, where an unknown is nearer than that: powers
#: other than 2 have none there, or an infinite one [-].
_BESIDE = 0.5
_EQUATION, _INEQUALITY = 5, 0
_SOLVED = (1, 4)


class Paths:
    """The paths of one frame; `prices` are where they ended, for the frame after."""

    def __init__(self, frame: NearOptimum, prices: FloatArray | None) -> None:
        self.frame = frame
        raised = self._curvature(frame.optimum, 1)
        reach = ((frame.costs**2) / raised).sum(axis=1)
        self.first = np.sqrt(2 * frame.rise / np.maximum(reach, 1e-300))
        self.prices = self.first if prices is None else prices
        self.flat = np.where(frame.effort.weight > 0, 0.0, raised)
        self.model = daqp.Model()
        self.model.settings = {"primal_tol": _SIDES}
        low, high = np.concatenate([frame.lower, frame.low]), np.concatenate([frame.upper, frame.high])
        kind = np.where(low == high, _EQUATION, _INEQUALITY).astype(np.int32)
        self.model.setup(np.diag(raised), frame.effort.slope.copy(), frame.rows, high, low, kind)

    def extremes(self) -> Extremes:
        """Follow the paths of all costs."""
        frame = self.frame
        points = np.tile(frame.optimum, (len(frame.costs), 1))
        multipliers, prices = np.zeros((len(points), len(frame.rows))), np.zeros(len(points))
        for i in np.flatnonzero(frame.is_open):
            points[i], multipliers[i], prices[i] = self._extreme(
                frame.costs[i], self.prices[i], self.first[i], frame.floor[i]
            )
        found = prices > 0
        weight = np.where(found, 1 / np.where(found, prices, 1.0), 0.0)
        self.prices = np.where(found, prices, self.first)
        multipliers *= np.where(found, weight, 1.0)[:, None]
        return Extremes(points=points, multipliers=multipliers, weight=weight)

    def _curvature(self, x: FloatArray, n_steps: int) -> FloatArray:
        """Curvature beside a point, positive."""
        beside = np.maximum(np.abs(x), self.frame.alone * _BESIDE**n_steps)
        curvature = self.frame.effort.curvature(beside)
        return np.maximum(curvature, _FLATNESS * curvature.max(initial=1.0))

    def _on_path(self, cost: FloatArray, s: float, x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Least E + s cost'x, sought from a point x on, and multipliers of the rows; None if not found."""
        effort = self.frame.effort
        if effort.exponent == 2:
            return self._on_straight_path(effort.slope + s * cost, x)
        for n_steps in range(_MOST_STEPS):
            gradient, curvature = effort.gradient(x) + s * cost, self._curvature(x, n_steps)
            self.model.update(H=np.diag(curvature), f=gradient - curvature * x)
            solved = self._solved()
            if solved is None:
                return None
            step, multipliers = solved[0] - x, solved[1]
            promise, here = -float(gradient @ step), effort.value(x) + s * cost @ x
            for length in 0.5 ** np.arange(_MOST_HALVINGS):
                there = x + length * step
                if effort.value(there) + s * cost @ there <= here - _KEPT_PROMISE * length * promise:
                    x = there
                    break
            if promise <= _PROMISE * self.frame.rise:
                break
        return x, multipliers

    def _on_straight_path(self, slope: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Least sum of squares with a slope; what costs linearly is sought about where it was found last."""
        solved = None
        for _ in range(_MOST_RETURNS):
            self.model.update(f=slope - self.flat * x)
            solved, before = self._solved(), x
            if solved is None or not self.flat.any():
                break
            x = solved[0]
            moved = np.abs(x - before)[self.flat > 0]
            if (moved <= _ARRIVED * np.maximum(1.0, np.abs(x[self.flat > 0]))).all():
                break
        return solved

    def _solved(self) -> tuple[FloatArray, FloatArray] | None:
        x, _, flag, info = self.model.solve()
        if flag not in _SOLVED:
            return None
        return np.clip(x, self.frame.lower, self.frame.upper), info["lam"][x.size :]

    def _extreme(
        self, cost: FloatArray, s: float, first: float, floor: float
    ) -> tuple[FloatArray, FloatArray, float]:
        x = inside = self.frame.optimum
        s_inside, outside, s_outside = 0.0, None, np.inf
        multiplier, price, before = np.zeros(len(self.frame.rows)), 0.0, np.inf
        for _ in range(_MOST_PROGRAMS):
            found = self._on_path(cost, s, x)
            if found is None:
                break
            (x, multiplier), price = found, s
            effort = float(self.frame.effort.value(x))
            if effort <= self.frame.most:
                inside, s_inside = x, s
            else:
                outside, s_outside = x, s
            if abs(effort - self.frame.most) <= _PRECISION * abs(self.frame.most):
                break
            if outside is None:
                if cost @ x <= floor + _SIDES:
                    break
                if s > _STEEPEST * first:
                    return x, self._without_effort(cost, x, multiplier / s), 0.0
                s *= 8.0
                continue
            # both ends of a piece of the path: effort is quadratic between them
            width = s_outside - s_inside
            stalls = width > _LEAST_GAIN * before  # the path bends between: halve the piece
            before = width
            share = 0.5 if stalls else self._share(inside, outside - inside)
            s = s_inside + share * width
            if not s_inside < s < s_outside:
                break
        if outside is not None:
            step = outside - inside
            inside = inside + self._share(inside, step) * step
        return inside, multiplier, price

    def _without_effort(self, cost: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Multipliers of a linear program: those near y that leave free unknowns without a slope."""
        free = (x > self.frame.lower + _AT_BOUND) & (x < self.frame.upper - _AT_BOUND)
        held = (y != 0) | (self.frame.low == self.frame.high)
        left = cost[free] + self.frame.rows[np.ix_(held, free)].T @ y[held]
        change = np.linalg.lstsq(self.frame.rows[np.ix_(held, free)].T, -left, rcond=None)[0]
        y = y.copy()
        y[held] += change
        return y

    def _share(self, x: FloatArray, step: FloatArray) -> float:
        """Say how much of a step out of the allowed effort is within it."""
        if self.frame.effort.exponent != 2:

            def beyond(share: float) -> float:
                return float(self.frame.effort.value(x + share * step)) - self.frame.most

            return float(brentq(beyond, 0.0, 1.0)) if beyond(0.0) < 0 < beyond(1.0) else 0.0
        a, b = float((self.frame.effort.weight * step) @ step), float(self.frame.effort.gradient(x) @ step)
        c = float(self.frame.effort.value(x)) - self.frame.most
        root = np.sqrt(max(b * b - 4 * a * c, 0.0))
        return float(np.clip(-2 * c / (b + root), 0.0, 1.0)) if b + root > 0 else 0.0
