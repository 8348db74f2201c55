r"""Extremes of a frame with a matrix inequality, by an interior-point method.

.. math:: \min_x c^T x \;\text{s.t.}\; E(x) \le \beta,\; G(x) \succeq 0,\; \text{rows and bounds}

All costs of a frame take their steps together, see :mod:`scso_nlp.solver.conic`; effort is a row, whose
curvature counts as that of the cost.
"""

from __future__ import annotations

import numpy as np

from scso_nlp.solver.conic import MatrixProgram, solve_matrix_programs
from scso_nlp.solver.near_optimum import Extremes, Matrix, NearOptimum
from scso_nlp.validation import FloatArray, IntArray

#: Costs that take their steps together; bounds the memory.
_COSTS_AT_ONCE = 64
#: A cost nearer than this to what bounds alone allow is at its least.
_SIDES = 1e-10
#: A point that misses something by more is not attained [-].
_KEPT = 1e-8
#: Powers below 2 have an infinite curvature at zero: it is taken no nearer to it [-].
_BESIDE = 1e-30


def extremes_by_cones(frame: NearOptimum, matrix: Matrix) -> Extremes:
    """Find the extremes of a frame; where none is found that keeps everything, the optimum is attained.

    Parameters
    ----------
    frame : NearOptimum
    matrix : Matrix

    Returns
    -------
    Extremes
    """
    n_costs, size = len(frame.costs), len(matrix.constant)
    points = np.tile(frame.optimum, (n_costs, 1))
    multipliers, weight = np.zeros((n_costs, len(frame.rows))), np.zeros(n_costs)
    of_matrix = np.zeros((n_costs, size, size))
    lowest = frame.costs @ frame.optimum <= frame.floor + _SIDES
    wanted = np.flatnonzero(frame.is_open & ~lowest)
    for part in np.array_split(wanted, -(-wanted.size // _COSTS_AT_ONCE)) if wanted.size else ():
        program = _Program(frame, matrix, frame.costs[part])
        start = np.tile(frame.optimum / program.unit, (part.size, 1))
        nothing = np.zeros((part.size, program.n_rows))
        answer = solve_matrix_programs(program(start, np.arange(part.size), nothing), program, start)
        good = answer.is_solved
        found = part[good]
        x = np.clip(program.unit * answer.x[good], frame.lower, frame.upper)
        kept = _missed(frame, matrix, x) <= _KEPT
        points[found[kept]] = x[kept]
        size = program.size[good, None]
        multipliers[found], weight[found] = program.multipliers(size * answer.row_multiplier[good])
        of_matrix[found] = size[:, :, None] * answer.multiplier[good]
    return Extremes(points=points, multipliers=multipliers, weight=weight, of_matrix=of_matrix)


def _missed(frame: NearOptimum, matrix: Matrix, x: FloatArray) -> FloatArray:
    """Largest amount by which points miss rows, effort or the matrix inequality, over their sizes."""
    value = x @ frame.rows.T
    sides = np.abs(np.clip(value, frame.low, frame.high))
    rows = np.abs(value - np.clip(value, frame.low, frame.high)) / (1 + sides)
    size = max(np.abs(matrix.constant).max(), np.abs(matrix.slopes).max(initial=0.0)) or 1.0
    least = np.linalg.eigvalsh(matrix.constant + np.tensordot(x, matrix.slopes, 1))[:, 0]
    effort = frame.effort.value(x) / frame.most - 1
    return np.asarray(np.max([rows.max(axis=1, initial=0.0), effort, -least / size], axis=0))


class _Program:
    """Some costs of a frame, near points: the model that the interior-point method asks for.

    Unknowns are bounded, and measured, by what each may reach. Rows are those with a least value, those with
    a greatest one, and effort.
    """

    def __init__(self, frame: NearOptimum, matrix: Matrix, costs: FloatArray) -> None:
        self.frame, self.constant = frame, matrix.constant
        reach = frame.reachable[1] - frame.reachable[0]
        self.unit = np.where(np.isfinite(reach) & (reach > 0), reach, 1.0)
        costs = costs * self.unit
        self.size = np.abs(costs).max(axis=1)
        self.costs, self.matrices = costs / self.size[:, None], matrix.slopes * self.unit[:, None, None]
        equal = frame.low == frame.high
        self.equations = np.flatnonzero(equal)
        self.at_least = np.flatnonzero(~equal & np.isfinite(frame.low))
        self.at_most = np.flatnonzero(~equal & np.isfinite(frame.high))
        rows = frame.rows * self.unit
        self.equal = rows[self.equations]
        self.rows = np.vstack([rows[self.at_least], -rows[self.at_most]])
        self.least = np.concatenate([frame.low[self.at_least], -frame.high[self.at_most]])
        self.n_rows = len(self.rows) + 1

    def __call__(self, point: FloatArray, which: IntArray, push: FloatArray) -> MatrixProgram:
        frame, unit, count, n = self.frame, self.unit, *point.shape
        x = unit * point
        effort, gradient = frame.effort.value(x), unit * frame.effort.gradient(x)
        bent = push[:, -1:] * unit**2 * frame.effort.curvature(np.maximum(np.abs(x), _BESIDE))
        quadratic = np.zeros((count, n, n))
        quadratic[:, np.arange(n), np.arange(n)] = bent

        def each(one: FloatArray) -> FloatArray:
            return np.broadcast_to(one, (count, *one.shape))

        left = effort - (gradient * point).sum(axis=1) - frame.most
        return MatrixProgram(
            quadratic=quadratic,
            linear=self.costs[which] - bent * point,
            equations=each(self.equal),
            targets=each(frame.low[self.equations]),
            rows=np.concatenate([each(self.rows), -gradient[:, None]], axis=1),
            least=np.concatenate([each(self.least), left[:, None]], axis=1),
            lower=each(frame.reachable[0] / unit),
            upper=each(frame.reachable[1] / unit),
            matrices=each(self.matrices),
            constant=each(self.constant),
        )

    def multipliers(self, push: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the rows of the frame, and of effort, by what the rows of the program push with."""
        n_equations, n_least = self.equations.size, self.at_least.size
        of_equations, of_least, of_most, of_effort = np.split(
            push, np.cumsum([n_equations, n_least, self.at_most.size]), axis=1
        )
        y = np.zeros((len(push), len(self.frame.rows)))
        y[:, self.equations] = -of_equations
        y[:, self.at_least] -= of_least
        y[:, self.at_most] += of_most
        return y, of_effort[:, 0]
