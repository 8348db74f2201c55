r"""How far activations and stability may be from the optimum at a little more effort, frame by frame.

The least :math:`c^T x` with effort :math:`E(x) \le \beta`, all rows and all bounds is where the path

.. math:: x(s) = \arg\min_x E(x) + s\, c^T x

meets :math:`E = \beta`. With exponent 2 the path is piecewise linear, and a few quadratic programs by the
active-set method DAQP find it, each warm from the last; with other exponents every point of it takes a few
steps of Newton's method, each such a program. Multipliers y of the rows, over s, are a certificate:

.. math:: c^T x \ge \min_{l \le z \le u} \left( c^T z + \tfrac1s (E(z) - \beta) + y^T (A z - b) \right)

holds whatever y and s > 0 are, with b the side of each row that the sign of y means. It is evaluated by
multiplication, because E is a sum over unknowns, of which each has its minimum written down.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np
from scipy.optimize import brentq

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.display import without_arrays
from scso_nlp.exceptions import ProblemError
from scso_nlp.solution import Solution
from scso_nlp.solver.judge import unknowns_of
from scso_nlp.solver.powers import Powers
from scso_nlp.solver.presolve import ConvexObjective, can_presolve
from scso_nlp.solver.redundant import without_redundant_rows
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import FrameProgram, describe
from scso_nlp.validation import BoolArray, FloatArray

#: Effort is met to this much of it [-], by at most so many quadratic programs for one extreme.
_PRECISION, _MOST_PROGRAMS = 1e-9, 40
#: Sides are kept to this, relative to rows of largest entry one.
_SIDES = 1e-10
#: Rows of which no more than this is left without what they determine are of nothing else [-].
_EMPTY = 1e-11
#: Curvature of unknowns that cost linearly, over the largest [-]; the certificate does without it.
_FLATNESS = 1e-8
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


@dataclass(frozen=True, kw_only=True)
@checked
class Ranges:
    """Least and greatest values that rows, bounds and a little more effort allow; NaN in unsolved frames.

    Attributes
    ----------
    solution : Solution
        The optimum.
    effort : float [-]
        Share by which the objective of a frame may exceed its optimum, without what rows determine.
    least, greatest : ndarray, shape (n_frames, n_muscles) [-]
        Activations, each attained by some pattern that keeps everything.
    certified_least, certified_greatest : ndarray, shape (n_frames, n_muscles) [-]
        No pattern goes beyond these: lower and upper bounds from duality.
    rows : tuple of str
        Stability rows.
    least_stability, greatest_stability : ndarray, shape (n_frames, n_rows) [N·m/rad]
        Attained.
    certified_least_stability, certified_greatest_stability : ndarray, shape (n_frames, n_rows) [N·m/rad]
        Bounds from duality.
    """

    solution: Solution
    effort: float
    least: FloatArray
    greatest: FloatArray
    certified_least: FloatArray
    certified_greatest: FloatArray
    rows: tuple[str, ...]
    least_stability: FloatArray
    greatest_stability: FloatArray
    certified_least_stability: FloatArray
    certified_greatest_stability: FloatArray

    __repr__ = without_arrays

    @property
    def gap(self) -> float:
        """Largest distance between what is attained and what is certified, of activations [-]."""
        below, above = self.least - self.certified_least, self.certified_greatest - self.greatest
        return float(np.nanmax(np.maximum(below, above), initial=0.0))

    def necessary(self, threshold: float = 0.01) -> dict[str, BoolArray]:
        """Name muscles without which it does not work: in some frame no pattern leaves them at rest.

        Parameters
        ----------
        threshold : float [-]
            By how much the certified least activation is above the muscle's lower bound.

        Returns
        -------
        dict of str to ndarray of bool, shape (n_frames,)
            In which frames.
        """
        muscles = self.solution.problem.motion.muscles
        needed = self.certified_least > muscles.min_activation + threshold
        return {muscles.muscles[m]: needed[:, m] for m in np.flatnonzero(needed.any(axis=0))}


@checked
def ranges(solution: Solution, *, effort: float = 0.05) -> Ranges:
    """Find the least and greatest activation of every muscle, and stability of every row, near an optimum.

    Parameters
    ----------
    solution : Solution
        Of a problem whose frames are apart and whose rows are affine, with an effort of any finite exponent.
    effort : float [-]
        Share by which the objective of each frame may exceed its optimum, positive. What an equation
        determines by itself, as a residual that no muscle helps, is no choice: its cost does not count.

    Returns
    -------
    Ranges

    Notes
    -----
    Where levels may be missed at a price, effort buys misses, and least stability is what it buys; the flat
    cost of misses may leave a gap between what is attained and what is certified (``gap``).

    Raises
    ------
    ProblemError
        Frames that are coupled, rows that are not affine, a matrix inequality, an objective that is no sum of
        squares or of one power (as with actuators below exponent 2), or a share that is not positive.

    Examples
    --------
    >>> found = scso.ranges(solution, effort=0.05)
    >>> found.least[1].round(3), found.greatest[1].round(3)
    (array([0.314, 0.065, 0.   ]), array([0.382, 0.222, 0.132]))
    >>> sorted(found.necessary(0.1))
    ['biceps', 'brachioradialis']
    """
    if not (np.isfinite(effort) and effort > 0):
        raise ProblemError(
            f"effort is {effort:g}, expected a positive share by which effort may rise, e.g. 0.05"
        )
    program = without_redundant_rows(describe(solution.problem))
    objective = ConvexObjective.of(program)
    if program.matrices:
        raise ProblemError(
            f"ranges need affine rows, but {program.matrices[0].term} keeps a whole matrix: take "
            "CoordinateStability (diagonal) over its coordinates instead"
        )
    if not can_presolve(program):
        raise ProblemError(
            "ranges need frames that are apart and affine rows: leave out terms that couple frames, and "
            "muscle models with elastic tendons"
        )
    powers = Powers.of(program, objective)
    if powers is None:
        raise ProblemError(
            "ranges need an objective that is a sum of squares, or of one power of every unknown, as "
            "ActivationEffort(exponent=p) is: with p finite, and without actuators where p is below 2"
        )
    with one_thread():
        return _Search(program, solution, powers, effort).found()


class _Search:
    """Extremes of all frames; unknowns are scaled."""

    def __init__(self, program: FrameProgram, solution: Solution, powers: Powers, effort: float) -> None:
        self.program, self.solution, self.powers, self.effort = program, solution, powers, effort
        self.unknowns = np.clip(unknowns_of(program, solution), *program.bounds())
        self.lower, self.upper = program.bounds()
        affine = program.split.affine
        self.rows = affine.dense(program.layout.size)
        self.low, self.high = (
            bound[affine.rows] - affine.constant for bound in (program.rows.lower, program.rows.upper)
        )
        self.is_free = ~affine.determined(program.rows, program.layout.size)
        self.n_muscles = solution.activation.shape[1]
        self._collect_wanted()

    def _collect_wanted(self) -> None:
        """Stability rows: their names, coefficients (n_frames, n_rows, size) and constants, unscaled."""
        stability = {t.name for t in self.program.problem.constraints if isinstance(t, StabilityConstraint)}
        affine = self.program.split.affine
        names: list[str] = []
        places: list[int] = []
        scales: list[float] = []
        missed: list[int | None] = []
        for block, where in self.program.rows:
            if block.term in stability:
                names += block.names
                places += [int(affine.place[r]) for r in range(where.start, where.stop)]
                scales += [block.scale] * len(block.names)
                start = block.missed
                missed += [None if start is None else start + i for i in range(len(block.names))]
        self.names = tuple(names)
        self.wanted = self.rows[:, places] * np.array(scales)[:, None]
        self.offset = affine.constant[:, places] * np.array(scales)
        for i, own in enumerate(missed):
            if own is not None:  # what is missed is no stability
                self.wanted[:, i, own] = 0.0

    def found(self) -> Ranges:
        """Go through the frames."""
        n_frames, n = len(self.unknowns), self.n_muscles
        attained, certified = (np.full((n_frames, 2, n + len(self.names)), np.nan) for _ in range(2))
        price: FloatArray | None = None
        for k in np.flatnonzero(self.solution.is_solved):
            costs = np.vstack([np.eye(n, self.unknowns.shape[1]), self.wanted[k]])
            frame = _Frame(self, int(k), costs, price)
            attained[k], certified[k], price = frame.attained, frame.certified, frame.price
        attained[:, :, n:] += self.offset[:, None]
        certified[:, :, n:] += self.offset[:, None]
        return Ranges(
            solution=self.solution,
            effort=self.effort,
            least=attained[:, 0, :n],
            greatest=attained[:, 1, :n],
            certified_least=certified[:, 0, :n],
            certified_greatest=certified[:, 1, :n],
            rows=self.names,
            least_stability=attained[:, 0, n:],
            greatest_stability=attained[:, 1, n:],
            certified_least_stability=certified[:, 0, n:],
            certified_greatest_stability=certified[:, 1, n:],
        )


class _Frame:
    """Extremes of one frame: `attained` and `certified`, (2, n_costs), least before greatest."""

    def __init__(self, search: _Search, k: int, costs: FloatArray, price: FloatArray | None) -> None:
        # what an equation determines by itself is no choice: it stays where it is, and costs nothing here
        free, fixed = search.is_free[k], np.where(search.is_free[k], 0.0, search.unknowns[k])
        rows, held = search.rows[k][:, free], search.rows[k] @ fixed
        length = np.abs(rows).max(axis=1, initial=0.0)
        used = length > _EMPTY * np.abs(search.rows[k]).max(axis=1, initial=0.0)
        length = length[used]
        self.rows = rows[used] / length[:, None]
        self.low, self.high = ((side[k] - held)[used] / length for side in (search.low, search.high))
        self.lower, self.upper = search.lower[k, free], search.upper[k, free]
        self.optimum = search.unknowns[k, free]
        effort = search.powers.at(k, free)
        self.effort = effort.over(abs(float(effort.value(self.optimum))) or 1.0)
        least = float(self.effort.value(self.optimum))
        self.rise = search.effort * abs(least)
        self.most = least + self.rise
        self.is_power = self.effort.weight > 0
        self.alone = self._alone()
        settled, costs = costs @ fixed, costs[:, free]
        self.costs = np.concatenate([costs, -costs])
        raised = self._curvature(self.optimum, 1)
        size = np.abs(self.costs).max(axis=1, initial=0.0)
        reach = ((self.costs**2) / raised).sum(axis=1)
        first = np.sqrt(2 * self.rise / np.maximum(reach, 1e-300))
        self.price = first if price is None else price
        self.is_open = (size > 0) & (self.rise > 0)
        self.reachable = self._reachable()
        lower, upper = self.reachable
        with np.errstate(invalid="ignore"):
            nearest = np.where(self.costs > 0, self.costs * lower, self.costs * upper)
        self.floor = np.where(self.costs == 0, 0.0, nearest).sum(axis=1)
        self.model = daqp.Model()
        self.model.settings = {"primal_tol": _SIDES}
        low, high = np.concatenate([self.lower, self.low]), np.concatenate([self.upper, self.high])
        kind = np.where(low == high, _EQUATION, _INEQUALITY).astype(np.int32)
        self.model.setup(np.diag(raised), self.effort.slope.copy(), self.rows, high, low, kind)
        points, multipliers, prices = self._extremes(first)
        self.price = np.where(prices > 0, prices, first)
        n = len(costs)
        value = (self.costs * points).sum(axis=1)
        bound = self._certificates(multipliers, prices)
        bound = np.where(self.is_open, np.minimum(np.maximum(bound, self.floor), value), value)
        self.attained = np.stack([value[:n], -value[n:]]) + settled
        self.certified = np.stack([bound[:n], -bound[n:]]) + settled

    def _curvature(self, x: FloatArray, n_steps: int) -> FloatArray:
        """Curvature beside a point, positive."""
        beside = np.maximum(np.abs(x), self.alone * _BESIDE**n_steps)
        curvature = self.effort.curvature(beside)
        return np.maximum(curvature, _FLATNESS * curvature.max(initial=1.0))

    def _on_path(self, cost: FloatArray, s: float, x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Least E + s cost'x, sought from a point x on, and multipliers of the rows; None if not found."""
        if self.effort.exponent == 2:
            self.model.update(f=self.effort.slope + s * cost)
            return self._solved()
        for n_steps in range(_MOST_STEPS):
            gradient, curvature = self.effort.gradient(x) + s * cost, self._curvature(x, n_steps)
            self.model.update(H=np.diag(curvature), f=gradient - curvature * x)
            solved = self._solved()
            if solved is None:
                return None
            step, multipliers = solved[0] - x, solved[1]
            promise, here = -float(gradient @ step), self.effort.value(x) + s * cost @ x
            for length in 0.5 ** np.arange(_MOST_HALVINGS):
                there = x + length * step
                if self.effort.value(there) + s * cost @ there <= here - _KEPT_PROMISE * length * promise:
                    x = there
                    break
            if promise <= _PROMISE * self.rise:
                break
        return x, multipliers

    def _solved(self) -> tuple[FloatArray, FloatArray] | None:
        x, _, flag, info = self.model.solve()
        return (np.clip(x, self.lower, self.upper), info["lam"][x.size :]) if flag in _SOLVED else None

    def _extremes(self, first: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Points with the least value of each cost, multipliers of the rows there, and the last prices."""
        points = np.tile(self.optimum, (len(self.costs), 1))
        multipliers, prices = np.zeros((len(self.costs), len(self.rows))), np.zeros(len(self.costs))
        for i in np.flatnonzero(self.is_open):
            points[i], multipliers[i], prices[i] = self._extreme(
                self.costs[i], self.price[i], first[i], self.floor[i]
            )
        return points, multipliers, prices

    def _extreme(
        self, cost: FloatArray, s: float, first: float, floor: float
    ) -> tuple[FloatArray, FloatArray, float]:
        x = inside = self.optimum
        s_inside, outside, s_outside = 0.0, None, np.inf
        multiplier, price, before = np.zeros(len(self.rows)), 0.0, np.inf
        for _ in range(_MOST_PROGRAMS):
            found = self._on_path(cost, s, x)
            if found is None:
                break
            (x, multiplier), price = found, s
            effort = float(self.effort.value(x))
            if effort <= self.most:
                inside, s_inside = x, s
            else:
                outside, s_outside = x, s
            if abs(effort - self.most) <= _PRECISION * abs(self.most):
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
        free = (x > self.lower + _AT_BOUND) & (x < self.upper - _AT_BOUND)
        held = (y != 0) | (self.low == self.high)
        left = cost[free] + self.rows[np.ix_(held, free)].T @ y[held]
        change = np.linalg.lstsq(self.rows[np.ix_(held, free)].T, -left, rcond=None)[0]
        y = y.copy()
        y[held] += change
        return y

    def _share(self, x: FloatArray, step: FloatArray) -> float:
        """Say how much of a step out of the allowed effort is within it."""
        if self.effort.exponent != 2:

            def beyond(share: float) -> float:
                return float(self.effort.value(x + share * step)) - self.most

            return float(brentq(beyond, 0.0, 1.0)) if beyond(0.0) < 0 < beyond(1.0) else 0.0
        a, b = float((self.effort.weight * step) @ step), float(self.effort.gradient(x) @ step)
        c = float(self.effort.value(x)) - self.most
        root = np.sqrt(max(b * b - 4 * a * c, 0.0))
        return float(np.clip(-2 * c / (b + root), 0.0, 1.0)) if b + root > 0 else 0.0

    def _certificates(self, multipliers: FloatArray, prices: FloatArray) -> FloatArray:
        """Lower bounds of the costs from duality, whatever the multipliers are, shape (n_costs,)."""
        weight = np.where(prices > 0, 1 / np.where(prices > 0, prices, 1.0), 0.0)
        y = multipliers * np.where(prices > 0, weight, 1.0)[:, None]
        y = np.where(np.isfinite(np.where(y > 0, self.high, self.low)), y, 0.0)
        held = (y * np.where(y == 0, 0.0, np.where(y > 0, self.high, self.low))).sum(axis=1)
        least = self.effort.least(weight, self.costs + y @ self.rows, *self.reachable)
        return np.asarray(least - self.most * weight - held)

    def _alone(self) -> FloatArray:
        """Size at which each unknown alone costs all there may be, where others cost no less than nothing."""
        effort = self.effort
        with np.errstate(divide="ignore"):
            return np.where(
                self.is_power, (self.most / effort.weight) ** (1 / effort.exponent), self.most / effort.slope
            )

    def _reachable(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of the unknowns, and what each alone may cost where none costs less than nothing."""
        lower, upper = self.lower.copy(), self.upper.copy()
        slope, is_power = self.effort.slope, self.is_power
        never_less = np.where(is_power, slope == 0, (slope == 0) | (slope > 0) & (lower >= 0))
        if never_less.all() and self.effort.constant >= 0:
            costs = is_power | (slope > 0)
            upper[costs] = np.minimum(upper, self.alone)[costs]
            lower[is_power] = np.maximum(lower, -self.alone)[is_power]
        return lower, upper
