r"""Starts for coupled and curved programs: a sequence of quadratic programs over all their frames.

Around a point x a program is replaced by its affine relative,
:math:`\min_d\; \nabla f^T d + \tfrac12 d^T H d` with :math:`l \le g + J d \le u` and bounds on x + d, H being
the Hessian of the Lagrangian. An interior-point method (Schwan, Jiang, Kuhn and Jones 2023, PIQP: a proximal
interior-point quadratic programming solver, IEEE CDC 1088-1093) solves it, and the step is followed as far as
objective and missed rows fall. IPOPT starts at the point and multipliers that come out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix

from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.build import Nlp
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.validation import FloatArray

#: Most quadratic programs.
_MOST_STEPS = 20

#: Tolerances of quadratic programs far from the optimum, and near it: the next where one is not reached [-].
_COARSE, _FINE = (1e-4,), (1e-12, 1e-10)

#: Largest step that is near the optimum, and largest that has arrived [-].
_NEAR, _ARRIVED = 1e-2, 1e-5

#: Steps near the optimum that are no shorter than this share of the one before are left to IPOPT [-].
_SHRUNK = 0.5

#: Of the fall that a step promises, what has to be kept [-]; shortest step; rounding of what is to fall [-].
_KEPT_PROMISE, _SHORTEST, _ROUNDING = 1e-4, 1e-3, 1e-10

#: A missed row costs this much more than its largest multiplier [-].
_PENALTY = 1.1

#: Points at which rows are held against their tangents.
_PROBES = 32

#: What rows bend by over their size, and negative curvature over the largest, that is taken for rounding [-].
_BENT = 1e-7


@dataclass(frozen=True, kw_only=True)
class Approach:
    """Where quadratic programs have led, in the solver's order, sign and scale.

    Attributes
    ----------
    unknowns, bounds : ndarray, shape (n_unknowns,)
        Unknowns and multipliers of their bounds.
    rows : ndarray, shape (n_rows,)
        Multipliers of the rows.
    """

    unknowns: FloatArray
    bounds: FloatArray
    rows: FloatArray


def may_be_convex(program: FrameProgram) -> bool:
    """Tell whether no curved row is an equation: what these allow is not convex."""
    for piece, rows in program.split.nonlinear:
        table = program.pair_rows if piece.is_pair else program.rows
        if (table.lower[rows] == table.upper[rows]).any():
            return False
    return True


class QuadraticPrograms:
    """Affine relatives of one program, made once and solved with many numbers."""

    def __init__(self, nlp: Nlp) -> None:
        self.nlp = nlp
        self.hessian = nlp.derivatives["hess_lag"].sparsity_out(0)
        self.jacobian = nlp.derivatives["jac_g"].sparsity_out(1)
        self._solvers: dict[float, ca.Function] = {}

    @property
    def are_enough(self) -> bool:
        """False where costs or equations are curved, so that IPOPT is faster, and without PIQP in CasADi."""
        if self.nlp.rows_are_affine:
            return self.nlp.objective_is_quadratic and ca.has_conic("piqp")
        return may_be_convex(self.nlp.program) and ca.has_conic("piqp")

    def follow(
        self,
        *,
        x0: FloatArray,
        p: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
        row_bounds: tuple[FloatArray, FloatArray],
    ) -> Approach | None:
        """Take steps until they are small.

        Parameters
        ----------
        x0, p : ndarray, shapes (n_unknowns,) and (n_parameters,)
            Where to begin, between the bounds, and the numbers of the program.
        bounds, row_bounds : pair of ndarray, shapes (n_unknowns,) and (n_rows,)

        Returns
        -------
        Approach or None
            None where a quadratic program has no answer, or where the program turns out not to be convex: it
            may have other optima, and the start would decide which of them is found.
        """
        derivatives, is_affine = self.nlp.derivatives, self.nlp.rows_are_affine
        is_quadratic = is_affine and self.nlp.objective_is_quadratic
        x, rows, price, near, last = x0, np.zeros(row_bounds[0].size), 0.0, is_quadratic, np.inf
        cost, slope = _numbers(derivatives["grad_f"], x, p)
        value, entries = _numbers(derivatives["jac_g"], x, p)
        for _ in range(_MOST_STEPS):
            hessian = self._hessian(x, p, rows)
            jacobian = ca.DM(self.jacobian, entries)
            found = None
            if hessian is not None:
                found = self._step(
                    _FINE if near else _COARSE,
                    h=hessian,
                    g=slope,
                    a=jacobian,
                    lba=row_bounds[0] - value,
                    uba=row_bounds[1] - value,
                    lbx=bounds[0] - x,
                    ubx=bounds[1] - x,
                )
            if found is None:
                return None
            step, of_bounds, new_rows = found
            price = max(price, _PENALTY * float(np.abs(new_rows).max(initial=0.0)))
            missed = price * _missed(value, row_bounds)
            promise = max(missed - float(slope @ step), 0.0)
            most = float(cost[0]) + missed + _ROUNDING * abs(float(cost[0]) + missed)
            before, length = (x, value), 1.0
            while True:
                x = np.clip(before[0] + length * step, *bounds)
                cost, slope = _numbers(derivatives["grad_f"], x, p)
                value, entries = _numbers(derivatives["jac_g"], x, p)
                total = float(cost[0]) + price * _missed(value, row_bounds)
                if total <= most - _KEPT_PROMISE * length * promise:
                    break
                length /= 2
                if length < _SHORTEST:
                    return None
            if not is_affine and _bends(before[1], jacobian, x - before[0], value, row_bounds):
                return None
            rows = rows + length * (new_rows - rows)
            longest = float(np.abs(step).max(initial=0.0))
            if is_quadratic or (near and (longest <= _ARRIVED or longest > _SHRUNK * last)):
                break
            near, last = longest <= _NEAR, longest
        if not is_affine and self._bends_elsewhere(x, p, bounds, row_bounds):
            return None
        return Approach(unknowns=x, bounds=of_bounds, rows=rows)

    def _bends_elsewhere(
        self,
        x: FloatArray,
        p: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
        row_bounds: tuple[FloatArray, FloatArray],
    ) -> bool:
        """Tell whether rows allow more than their tangents at x say, at points all over the bounds."""
        value, entries = _numbers(self.nlp.derivatives["jac_g"], x, p)
        jacobian = ca.DM(self.jacobian, entries)
        is_bounded = np.isfinite(bounds[0]) & np.isfinite(bounds[1])
        lower, span = np.where(is_bounded, bounds[0], x), np.where(is_bounded, bounds[1] - bounds[0], 0.0)
        rng = np.random.default_rng(0)
        for _ in range(_PROBES):
            # few muscles far away and many of them are both looked at
            share = rng.uniform(size=x.size) ** rng.uniform(0.3, 3.0)
            moved = is_bounded & (rng.uniform(size=x.size) < rng.uniform(0.1, 1.0))
            step = np.where(moved, lower + share * span - x, 0.0)
            there, _ = _numbers(self.nlp.derivatives["jac_g"], x + step, p)
            if _bends(value, jacobian, step, there, row_bounds):
                return True
        return False

    def _hessian(self, x: FloatArray, p: FloatArray, rows: FloatArray) -> ca.DM | None:
        """Hessian of the Lagrangian, or None where it is not convex."""
        (values,) = _numbers(self.nlp.derivatives["hess_lag"], x, p, np.ones(1), rows)
        largest = float(np.abs(values).max(initial=0.0))
        if not np.isfinite(largest):
            return None
        hessian = ca.triu2symm(ca.DM(self.hessian, values))
        raised = hessian + (_BENT * largest or 1.0) * ca.DM.eye(x.size)
        pivots, _, _ = ca.ldl(raised)
        return hessian if (np.asarray(pivots) > 0).all() else None

    def _step(
        self, tolerances: tuple[float, ...], **numbers: Any
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Solve one quadratic program: step, multipliers of bounds and of rows."""
        for tolerance in tolerances:
            if tolerance not in self._solvers:
                structure = {"h": numbers["h"].sparsity(), "a": self.jacobian}
                options = {"error_on_fail": False, "piqp": {"eps_abs": tolerance, "eps_rel": tolerance}}
                self._solvers[tolerance] = ca.conic("relative", "piqp", structure, options)
            solver = self._solvers[tolerance]
            with one_thread(of_ipopt=True):
                answer = solver(**numbers)
            step, of_bounds, rows = (np.asarray(answer[name]).ravel() for name in ("x", "lam_x", "lam_a"))
            if solver.stats()["success"] and np.isfinite(step).all() and np.isfinite(rows).all():
                return step, of_bounds, rows
        return None


def _bends(
    before: FloatArray,
    jacobian: ca.DM,
    step: FloatArray,
    after: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> bool:
    """Tell whether rows allow more than their tangents before a step say: no convex set does."""
    matrix = csc_matrix((np.array(jacobian.nonzeros()), jacobian.row(), jacobian.colind()), jacobian.shape)
    more = after - before - matrix @ step
    size = _BENT * (np.abs(before) + np.abs(after) + abs(matrix) @ np.abs(step))
    return bool(
        ((more > size) & np.isfinite(bounds[0])).any() or ((more < -size) & np.isfinite(bounds[1])).any()
    )


def _missed(value: FloatArray, bounds: tuple[FloatArray, FloatArray]) -> float:
    return float(np.maximum(np.maximum(bounds[0] - value, value - bounds[1]), 0.0).sum())


def _numbers(function: ca.Function, *inputs: FloatArray) -> list[FloatArray]:
    """Evaluate a function; the non-zeros of what it returns."""
    buffer, call = function.buffer()
    given = [np.ascontiguousarray(array, dtype=float) for array in inputs]
    outputs = [np.empty(function.nnz_out(i)) for i in range(function.n_out())]
    for i, array in enumerate(given):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(outputs):
        buffer.set_res(i, array.data)
    call()
    return outputs
