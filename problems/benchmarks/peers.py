"""Solvers of others, called directly, frame by frame: what each question costs without this package.

Each function takes a :class:`Question` and returns activations and controls (n_frames, n), NaN in frames
where the solver says that it has none. Matrices are laid out before the loop and belong to the time.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog, minimize

from problems.benchmarks.questions import Question
from scso_nlp.validation import FloatArray

#: Sides of a quadratic program are kept to this much [-], rows being scaled to entries of at most one.
TOLERANCE = 1e-8
#: Steps of the sequence of quadratic programs, halvings of one, least promise of one, and least curvature,
#: both relative [-].
STEPS, HALVINGS, PROMISE, CURVATURE = 60, 30, 1e-12, 1e-7
#: Convergence criterion and most iterations of SLSQP.
SLSQP = {"ftol": 1e-9, "maxiter": 200}
_EQUATION = 5


@dataclass(frozen=True)
class Peer:
    """One solver.

    Attributes
    ----------
    name : str
    module : str
        What it needs.
    solve : callable
    exponents : callable
        Whether it can have this power.
    takes_matrices : bool
        Whether it can keep a matrix positive semi-definite.
    most_unknowns : int
        Of all frames together; of larger questions it gets frames spread evenly, or none.
    """

    name: str
    module: str
    solve: Callable[[Question], FloatArray]
    exponents: Callable[[float], bool]
    takes_matrices: bool = False
    most_unknowns: int = 10**9

    def can(self, question: Question) -> bool:
        """Whether the question is of a kind that it answers."""
        is_kept = self.takes_matrices or not question.constant.size
        return is_kept and self.exponents(question.exponent) and len(question.lower) <= self.most_unknowns

    @property
    def is_installed(self) -> bool:
        """Whether it can be asked."""
        return importlib.util.find_spec(self.module) is not None


@dataclass(frozen=True)
class _Rows:
    """Equations, then inequalities, of all frames (n_frames, r, n), scaled to entries of at most one."""

    matrix: FloatArray
    lower: FloatArray
    upper: FloatArray
    n_equations: int

    @classmethod
    def of(cls, question: Question) -> _Rows:
        matrix = np.concatenate([question.equations, question.rows], axis=1)
        size = np.abs(matrix).max(axis=2, keepdims=True)
        size[size == 0] = 1.0
        lower = np.concatenate([question.moments, question.levels], axis=1) / size[:, :, 0]
        upper = lower.copy()
        n_equations = question.moments.shape[1]
        upper[:, n_equations:] = np.inf
        return cls(matrix=matrix / size, lower=lower, upper=upper, n_equations=n_equations)

    @property
    def equations(self) -> tuple[FloatArray, FloatArray]:
        return self.matrix[:, : self.n_equations], self.lower[:, : self.n_equations]

    @property
    def inequalities(self) -> tuple[FloatArray, FloatArray]:
        return self.matrix[:, self.n_equations :], self.lower[:, self.n_equations :]

    def with_peak(self, question: Question) -> _Rows:
        """Add one unknown, the last, that is at least the size of all others."""
        k, r, n = self.matrix.shape
        eye = np.eye(n)
        least = question.lower < 0
        peak = np.hstack([np.vstack([-eye, eye[least]]), np.ones((n + least.sum(), 1))])
        padded = np.concatenate([self.matrix, np.zeros((k, r, 1))], axis=2)
        lower = np.concatenate([self.lower, np.zeros((k, len(peak)))], axis=1)
        return _Rows(
            matrix=np.concatenate([padded, np.broadcast_to(peak, (k, *peak.shape))], axis=1),
            lower=lower,
            upper=np.concatenate([self.upper, np.full((k, len(peak)), np.inf)], axis=1),
            n_equations=self.n_equations,
        )


def daqp(question: Question) -> FloatArray:
    """Solve by DAQP's active-set method: at p = 2 one program a frame, else Newton's method on programs."""
    from daqp import solve

    rows, n = _Rows.of(question), len(question.lower)
    nothing = np.zeros(n)
    lower = np.hstack([np.broadcast_to(question.lower, (question.n_frames, n)), rows.lower])
    upper = np.hstack([np.broadcast_to(question.upper, (question.n_frames, n)), rows.upper])
    sense = np.zeros(lower.shape[1], dtype=np.int32)
    sense[n : n + rows.n_equations] = _EQUATION
    found = np.full((question.n_frames, n), np.nan)
    p, identity = question.exponent, np.eye(n)
    for k in range(question.n_frames):
        sides = rows.matrix[k], upper[k], lower[k], sense
        x, _, flag, _ = solve(identity, nothing, *sides, primal_tol=TOLERANCE)
        if flag < 1:
            continue
        for _ in range(STEPS if p != 2 else 0):
            size = np.abs(x)
            gradient = p * size ** (p - 1) * np.sign(x)
            curvature = p * (p - 1) * size ** (p - 2)
            curvature = np.maximum(curvature, CURVATURE * curvature.max())
            unit = curvature.max()
            model = np.diag(curvature / unit), (gradient - curvature * x) / unit
            target, _, flag, _ = solve(*model, *sides, primal_tol=TOLERANCE)
            if flag < 1:
                break
            step, here = target - x, (size**p).sum()
            promise, length = -gradient @ step, 1.0
            for _ in range(HALVINGS):
                if (np.abs(x + length * step) ** p).sum() <= here - 1e-4 * length * promise:
                    break
                length /= 2
            x = x + length * step
            if promise <= PROMISE * here:
                break
        if flag >= 1:
            found[k] = np.clip(x, question.lower, question.upper)
    return found


def piqp(question: Question) -> FloatArray:
    """Solve by PIQP's interior-point method for dense programs; min/max as a linear program."""
    from piqp import PIQP_SOLVED, DenseSolver

    rows, n = _Rows.of(question), len(question.lower)
    lower, upper = question.lower, question.upper
    quadratic, linear = 2 * np.eye(n), np.zeros(n)
    if np.isinf(question.exponent):
        rows = rows.with_peak(question)
        lower, upper = np.append(lower, 0.0), np.append(upper, np.inf)
        quadratic, linear = np.zeros((n + 1, n + 1)), np.append(linear, 1.0)
    (a, b), (g, h) = rows.equations, rows.inequalities
    found = np.full((question.n_frames, n), np.nan)
    solver = DenseSolver()
    solver.settings.eps_abs = TOLERANCE
    solver.settings.eps_rel = TOLERANCE
    none = np.full(h.shape[1], np.inf)
    for k in range(question.n_frames):
        sides = {"A": np.asfortranarray(a[k]), "b": b[k]}
        if h.shape[1]:
            sides |= {"G": np.asfortranarray(g[k]), "h_l": h[k], "h_u": none}
        if k == 0:
            solver.setup(np.asfortranarray(quadratic), linear, **sides, x_l=lower, x_u=upper)
        else:
            solver.update(**sides)
        if solver.solve() == PIQP_SOLVED:
            found[k] = solver.result.x[:n]
    return found


def clarabel(question: Question) -> FloatArray:
    """Solve by Clarabel's conic interior-point method; powers as cones, min/max as a linear program."""
    import clarabel as lib

    p, n_frames, n = question.exponent, question.n_frames, len(question.lower)
    size = np.ones(n_frames)
    if p != 2 and np.isfinite(p):  # powers are near one on the scale of the answer at p = 2
        squares = np.abs(clarabel(replace(question, exponent=2.0))).max(axis=1)
        size = np.where(squares > 0, squares, 1.0)
    rows = _Rows.of(question)
    quadratic, linear = sp.csc_matrix(2 * np.eye(n)), np.zeros(n)
    lower, upper = question.lower, question.upper
    cones: list[object] = []
    extra = 0
    if np.isinf(p):
        rows, extra = rows.with_peak(question), 1
        lower, upper = np.append(lower, 0.0), np.append(upper, np.inf)
    elif p != 2:
        extra = n
    if extra:
        quadratic = sp.csc_matrix((n + extra, n + extra))
        linear = np.concatenate([linear, np.ones(extra)])
    width = n + extra
    (a, b), (g, h) = rows.equations, rows.inequalities
    triangle, constant = _triangle(question)
    low, high = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    eye = np.eye(width)
    pad = np.zeros((n_frames, a.shape[1] + g.shape[1], width - rows.matrix.shape[2]))
    moving = np.concatenate([np.concatenate([a, -g], axis=1), pad], axis=2)
    still = np.vstack([-eye[low], eye[high]])
    sides = np.concatenate([-lower[low], upper[high]]) / size[:, None]
    b, h, constant = b / size[:, None], h / size[:, None], constant / size[:, None]
    cones += [lib.ZeroConeT(a.shape[1]), lib.NonnegativeConeT(g.shape[1] + len(still))]
    ones = np.zeros(0)
    if extra == n:  # t >= |x|^p is (t, 1, x) in the cone of 1/p
        power, ones = np.zeros((3 * n, width)), np.zeros(3 * n)
        each = np.arange(n)
        power[3 * each, n + each] = -1.0
        ones[3 * each + 1] = 1.0
        power[3 * each + 2, each] = -1.0
        still = np.vstack([still, power])
        cones += [lib.PowerConeT(1 / p)] * n
    if constant.shape[1]:
        cones.append(lib.PSDTriangleConeT(question.constant.shape[1]))
    n_moving, k_rows = moving.shape[1], constant.shape[1]
    shape = n_moving + len(still) + k_rows
    filled = np.zeros((shape, width), dtype=bool)
    filled[:n_moving] = True
    filled[n_moving : n_moving + len(still)] = still != 0
    filled[n_moving + len(still) :, :n] = True
    column, row = np.nonzero(filled.T)
    pointer = np.concatenate([[0], np.cumsum(filled.sum(axis=0))])
    settings = lib.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    found = np.full((n_frames, n), np.nan)
    dense = np.zeros((shape, width))
    dense[n_moving : n_moving + len(still)] = still
    for k in range(n_frames):
        dense[:n_moving] = moving[k]
        dense[n_moving + len(still) :, :n] = -triangle[k]
        matrix = sp.csc_matrix((dense[row, column], row, pointer), shape=(shape, width))
        vector = np.concatenate([b[k], -h[k], sides[k], ones, constant[k]])
        answer = lib.DefaultSolver(quadratic, linear, matrix, vector, cones, settings).solve()
        if answer.status == lib.SolverStatus.Solved:
            found[k] = size[k] * np.array(answer.x[:n])
    return found


def _triangle(question: Question) -> tuple[FloatArray, FloatArray]:
    """Upper triangles by column, off-diagonal times root two: (n_frames, r, n) and (n_frames, r)."""
    size = question.constant.shape[1]
    column, row = np.tril_indices(size)
    weight = np.where(row == column, 1.0, math.sqrt(2.0))
    scale = np.abs(question.matrices).max(axis=(1, 2, 3), initial=0.0)
    scale = np.where(scale > 0, scale, 1.0)
    matrices = question.matrices[:, row, column] * weight[:, None] / scale[:, None, None]
    return matrices, question.constant[:, row, column] * weight / scale[:, None]


def slsqp(question: Question) -> FloatArray:
    """Solve by SciPy's SLSQP, from rest, with exact gradients."""
    rows, p = _Rows.of(question), question.exponent
    (a, b), (g, h) = rows.equations, rows.inequalities
    bounds = list(zip(question.lower, question.upper, strict=True))
    start = np.clip(0.0, question.lower, question.upper)
    found = np.full((question.n_frames, len(start)), np.nan)
    for k in range(question.n_frames):
        sides = [{"type": "eq", "fun": lambda x, k=k: a[k] @ x - b[k], "jac": lambda x, k=k: a[k]}]
        if h.shape[1]:
            sides.append({"type": "ineq", "fun": lambda x, k=k: g[k] @ x - h[k], "jac": lambda x, k=k: g[k]})
        answer = minimize(
            lambda x: (np.abs(x) ** p).sum(),
            start,
            jac=lambda x: p * np.abs(x) ** (p - 1) * np.sign(x),
            method="SLSQP",
            bounds=bounds,
            constraints=sides,
            options=SLSQP,
        )
        if answer.success:
            found[k] = answer.x
    return found


def highs(question: Question) -> FloatArray:
    """Solve min/max as a linear program by HiGHS, through SciPy."""
    rows, n = _Rows.of(question).with_peak(question), len(question.lower)
    (a, b), (g, h) = rows.equations, rows.inequalities
    bounds = [*zip(question.lower, question.upper, strict=True), (0.0, np.inf)]
    cost = np.append(np.zeros(n), 1.0)
    found = np.full((question.n_frames, n), np.nan)
    for k in range(question.n_frames):
        answer = linprog(cost, A_ub=-g[k], b_ub=-h[k], A_eq=a[k], b_eq=b[k], bounds=bounds)
        if answer.status == 0:
            found[k] = answer.x[:n]
    return found


PEERS = (
    Peer("DAQP", "daqp", daqp, math.isfinite),
    Peer("PIQP", "piqp", piqp, lambda p: p == 2 or math.isinf(p)),
    Peer("Clarabel", "clarabel", clarabel, lambda p: p > 1, takes_matrices=True, most_unknowns=40_000),
    Peer("SciPy SLSQP", "scipy", slsqp, lambda p: 2 <= p <= 3, most_unknowns=500),
    Peer("HiGHS", "scipy", highs, math.isinf, most_unknowns=15_000),
)
