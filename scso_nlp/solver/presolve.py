r"""Exact optima of convex frames with affine rows, one by one, by a sequence of quadratic programs.

Around a point x every frame is modelled as :math:`\min_z\; g^T (z - x) + \tfrac12 (z - x)^T H (z - x)` with
its rows and bounds, solved by an active-set method (Arnström, Bemporad and Axehill 2022, IEEE Trans Autom
Control 67:4362-4369, by its library DAQP), and followed along z - x as far as the objective falls: Newton's
method on a polytope. IPOPT starts at what comes out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import daqp
import numpy as np

from scso_nlp.messages import COUNTS
from scso_nlp.solver.central_path import follow_central_path
from scso_nlp.solver.convex_objective import ConvexObjective
from scso_nlp.solver.optimality import OPTIMALITY_TOLERANCE, optimality_of
from scso_nlp.solver.powers import Powers
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.turns import part_of
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Frames whose derivatives are evaluated together; bounds the memory.
FRAMES_AT_ONCE = 64

#: Most quadratic programs of one frame.
_MOST_STEPS = 60

#: Curvature that a linear objective is given, over its slope and the size of the unknowns [-].
_FLATNESS = 0.3

#: How much nearer to a bound the curvature is taken with every step [-].
_BESIDE = 0.5

#: Most halvings of a step.
_MOST_HALVINGS = 30

#: A frame whose largest unknown is smaller is solved again on its own scale [-].
_LEAST_SIZE = 1e-2

#: Scale of frames whose unknowns vanish [-].
_SMALLEST_SIZE = 1e-12

#: A frame has arrived when two steps promise less than this share of what its free unknowns cost [-]: where
#: reserves cost far more than muscles, these are not there yet at the first; the second squares what is left.
_LEAST_PROMISE = 1e-13
#: Share of an objective by which rounding may raise it [-].
_NOISE = 2.0**-50

#: Least curvature of an unknown over the largest of the frame, and where the method fails with it [-].
_LEAST_CURVATURE = (1e-7, 1e-5, 1e-3)

#: Of the step's promise, what has to be kept [-].
_KEPT_PROMISE = 1e-4

#: Sides of an active-set program are kept to this much of the frame's scale [-].
_SIDES = 1e-10

#: What is nearer to a side than this much of the frame's scale is on it [-].
_TOLERANCE = 1e-8

#: Steps that take back what rounding has missed, and their regularization [-]: what rows that are nearly the
#: same miss apart from each other is rounding, and would move unknowns far.
_SETTLING_STEPS, _RIDGE = 4, 1e-6
#: Share of a frame's largest unknown that is rounding [-].
_ROUNDING = 2.0**-52

#: They end where one leaves more than this of what it found.
_LEAST_GAIN = 0.1

#: Unknowns inside their bounds and larger than this much of the frame's largest are hidden where more than
#: this share of what acts on them is left over [-].
_HIDDEN, _HIDING = 1e-6, 1e-3

_EQUATION, _INEQUALITY = 5, 0
#: Flags of DAQP: optimal, to rounding only, infeasible.
_OPTIMAL, _ROUNDED, _INFEASIBLE = 1, 4, -1


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where IPOPT starts.

    Attributes
    ----------
    unknowns : ndarray, shape (n_frames, n_unknowns)
        Scaled.
    multipliers : ndarray, shape (n_frames, n_rows)
        Of the rows, in the solver's sign and scale, for the objective without weights.
    reduced_cost : ndarray, shape (n_frames, n_unknowns)
        Gradient of the Lagrangian without bounds: what the bounds have to hold.
    worst : ndarray, shape (n_frames,)
        How far each frame is from its optimum, infinite where it was not found.
    is_optimal : ndarray of bool, shape (n_frames,)
        Frames that are at their optimum; the others are where they began, without multipliers.
    is_doubtful : ndarray of bool, shape (n_frames,)
        Frames whose rows the active-set method found contradictory.
    is_confirmed : ndarray of bool, shape (n_frames,)
        Frames in which IPOPT has been at this optimum before.
    """

    unknowns: FloatArray
    multipliers: FloatArray
    reduced_cost: FloatArray
    worst: FloatArray
    is_optimal: BoolArray
    is_doubtful: BoolArray
    is_confirmed: BoolArray

    @classmethod
    def nowhere(cls, program: FrameProgram, start: FloatArray) -> Start:
        """Make one without any frame at its optimum."""
        n = len(start)
        return cls(
            unknowns=start.copy(),
            multipliers=np.zeros((n, len(program.rows))),
            reduced_cost=np.zeros_like(start),
            worst=np.full(n, np.inf),
            is_optimal=np.zeros(n, dtype=bool),
            is_doubtful=np.zeros(n, dtype=bool),
            is_confirmed=np.zeros(n, dtype=bool),
        )


def can_presolve(program: FrameProgram) -> bool:
    """Tell whether frames are apart and their rows affine."""
    return not (program.is_coupled or program.split.nonlinear)


def presolve(program: FrameProgram, start: FloatArray, frames: IntArray, known: Start | None = None) -> Start:
    """Solve frames one by one, where rows are affine and the objective is convex.

    Parameters
    ----------
    program : FrameProgram
    start : ndarray, shape (n_frames, n_unknowns)
        Scaled unknowns to begin with.
    frames : ndarray of int
        Which to solve; none are where frames are coupled or rows are not affine.
    known : Start, optional
        Frames that it says are optimal are taken over if they are.

    Returns
    -------
    Start
    """
    found = Start.nowhere(program, start)
    if not can_presolve(program):
        return found
    unknowns, multipliers, reduced = found.unknowns, found.multipliers, found.reduced_cost
    solved, doubtful = np.zeros(len(start), dtype=bool), found.is_doubtful
    confirmed = found.is_confirmed
    if known is not None:
        solved = known.is_optimal & (_graded(program, known) <= OPTIMALITY_TOLERANCE)
        for mine, other in ((unknowns, known.unknowns), (multipliers, known.multipliers)):
            mine[solved] = other[solved]
        reduced[solved] = known.reduced_cost[solved]
        confirmed = known.is_confirmed & solved
        frames = frames[~solved[frames]]
    objective = ConvexObjective.of(program)
    n_parts = -(-frames.size // FRAMES_AT_ONCE)
    for i, part in enumerate(np.array_split(frames, n_parts) if n_parts else ()):
        COUNTS.info("solving, part %d of %d of %d frames", i + 1, n_parts, frames.size)
        block = Block(program, objective, part, start[part])
        with one_thread():
            block.solve()
            block.settle()
        unknowns[part] = block.unknowns
        multipliers[np.ix_(part, program.split.affine.rows)] = block.multipliers
        solved[part], doubtful[part] = ~block.is_contradicted, block.is_contradicted
        reduced[part] = block.reduced_cost()
    worst = _graded(program, replace(found, is_optimal=solved))
    missed = solved & (worst > OPTIMALITY_TOLERANCE)
    if missed.any():
        exact = balanced(program, np.flatnonzero(missed), objective)
        nearer = exact.worst < worst
        unknowns[nearer], multipliers[nearer] = exact.unknowns[nearer], exact.multipliers[nearer]
        reduced[nearer], worst[nearer] = exact.reduced_cost[nearer], exact.worst[nearer]
    optimal = solved & (worst <= OPTIMALITY_TOLERANCE)
    return Start(
        unknowns=np.where(optimal[:, None], unknowns, start),
        multipliers=np.where(optimal[:, None], multipliers, 0.0),
        reduced_cost=reduced,
        worst=worst,
        is_optimal=optimal,
        is_doubtful=doubtful,
        is_confirmed=confirmed & optimal,
    )


def balanced(program: FrameProgram, frames: IntArray, objective: ConvexObjective | None = None) -> Start:
    """Find optima in which small unknowns are as exact as large ones, where each costs a power of itself.

    Parameters
    ----------
    program : FrameProgram
    frames : ndarray of int
    objective : ConvexObjective, optional
        Of the program, if it is known.

    Returns
    -------
    Start
        Optimal nowhere if frames are coupled, rows are not affine or costs are something else.
    """
    found = Start.nowhere(program, np.zeros((program.time.size, program.layout.size)))
    powers = None
    if can_presolve(program) and frames.size:
        objective = ConvexObjective.of(program) if objective is None else objective
        powers = Powers.of(program, objective)
    is_convex = powers is not None and (powers.weight >= 0).all() and powers.weight.any()
    if objective is None or powers is None or not is_convex:
        return found
    affine = program.split.affine
    for part in np.array_split(frames, -(-frames.size // FRAMES_AT_ONCE)):
        with one_thread():
            unknowns, multipliers = follow_central_path(program, powers, part)
        known = np.isfinite(unknowns).all(axis=1)
        here, unknowns, multipliers = part[known], unknowns[known], multipliers[known]
        gradient, _ = objective.near(unknowns, part_of(program, here))
        push = np.einsum("kri,kr->ki", affine.frames(here).dense(program.layout.size), multipliers)
        found.unknowns[here], found.multipliers[np.ix_(here, affine.rows)] = unknowns, multipliers
        found.reduced_cost[here], found.is_optimal[here] = gradient + push, True
    worst = _graded(program, found)
    return replace(found, worst=worst, is_optimal=worst <= OPTIMALITY_TOLERANCE)


def told_by_own(
    program: FrameProgram, frames: IntArray, unknowns: FloatArray, multipliers: FloatArray
) -> Start:
    """Take the multipliers of rows that have an unknown of their own, as a reserve is, from its slope.

    At high exponents slopes of one row are a hundred powers of ten below those of another, and no other way
    finds a digit of its multiplier.

    Parameters
    ----------
    program : FrameProgram
    frames : ndarray of int
    unknowns : ndarray, shape (n_frames, n_unknowns)
        Scaled.
    multipliers : ndarray, shape (n_frames, n_rows)
        Of the rows, in the solver's sign and scale.

    Returns
    -------
    Start
        At the same unknowns; optimal nowhere if frames are coupled or rows are not affine.
    """
    found = Start.nowhere(program, unknowns)
    if not (can_presolve(program) and frames.size):
        return found
    affine, here = program.split.affine, unknowns[frames]
    rows = affine.frames(frames).dense(program.layout.size)
    gradient, _ = ConvexObjective.of(program).near(here, part_of(program, frames))
    lower, upper = (bound[frames] for bound in program.bounds())
    is_alone = (rows != 0) & ((rows != 0).sum(axis=1, keepdims=True) == 1)
    is_alone &= ((here > lower) & (here < upper))[:, None]
    frame, row = np.nonzero(is_alone.any(axis=2))
    own = is_alone[frame, row].argmax(axis=1)
    told = multipliers[np.ix_(frames, affine.rows)]
    told[frame, row] = -gradient[frame, own] / rows[frame, row, own]
    found.multipliers[np.ix_(frames, affine.rows)], found.is_optimal[frames] = told, True
    worst = _graded(program, found)
    return replace(found, worst=worst, is_optimal=worst <= OPTIMALITY_TOLERANCE)


def _graded(program: FrameProgram, start: Start) -> FloatArray:
    """How far each frame is from its optimum, infinite where it is not called one."""
    of_pairs = np.zeros((max(len(start.unknowns) - 1, 0), 0))
    found = optimality_of(program, start.unknowns, (start.multipliers, of_pairs), start.is_optimal)
    return np.nan_to_num(found.worst, nan=np.inf)


class Block:
    """Some frames on their way to their optima."""

    def __init__(
        self,
        program: FrameProgram,
        objective: ConvexObjective,
        frames: IntArray,
        start: FloatArray,
        tolerance: float = _SIDES,
    ) -> None:
        self.tolerance = tolerance
        affine, table = program.split.affine.frames(frames), program.rows
        self.objective, self.arrays = objective, part_of(program, frames)
        self.lower, self.upper = (bound[frames] for bound in program.bounds())
        self.used = ~affine.is_empty
        self.matrix = affine.dense(program.layout.size)
        length = np.abs(self.matrix).max(axis=2, initial=0.0)
        self.length = np.where(length > 0, length, 1.0)
        self.matrix /= self.length[:, :, None]
        self.least, self.most = (
            (bound[affine.rows] - affine.constant) / self.length for bound in (table.lower, table.upper)
        )
        self.unknowns, self.multipliers = start.copy(), np.zeros(self.used.shape)
        self.is_contradicted = np.zeros(frames.size, dtype=bool)
        self.is_near = np.zeros(frames.size, dtype=bool)
        self.is_free = ~affine.determined(table, start.shape[1])
        self.diagonal = np.zeros((start.shape[1], start.shape[1]))
        self._collect_sides()
        self.is_feasible = self._missed() <= _TOLERANCE

    def solve(self) -> None:
        """Take steps in all frames together until each has arrived or is given up."""
        going = np.ones(len(self.unknowns), dtype=bool)
        if not self.objective.is_quadratic:
            self._make_feasible()
            going = self.is_feasible.copy()
        for n_steps in range(_MOST_STEPS):
            if not going.any():
                return
            going, _ = self.advance(going, n_steps)

    def advance(
        self, going: BoolArray, n_steps: int, bent: Mapping[int, FloatArray] | None = None
    ) -> tuple[BoolArray, BoolArray]:
        """Take one step in some frames; tell which of them want another, and which found no way.

        Parameters
        ----------
        going : ndarray of bool, shape (n_frames,)
        n_steps : int
            How many came before.
        bent : mapping of int to ndarray, shape (n_unknowns, n_unknowns), optional
            Curvature of the constraints of some frames, besides that of the objective.
        """
        going, asked = going.copy(), going
        gradient, hessian = self.objective.near(self.unknowns, self.arrays)
        if not np.isfinite(hessian).all():
            # powers below 2 have no curvature at zero: that of a point beside it, nearer with every step
            size = np.abs(self.unknowns).max(axis=1, initial=0.0, keepdims=True)
            beside = np.maximum(self.unknowns, np.minimum(size * _BESIDE**n_steps, self.upper))
            _, hessian = self.objective.near(beside, self.arrays)
        step, is_exact = np.zeros_like(self.unknowns), np.zeros(going.size, dtype=bool)
        for k in np.flatnonzero(going):
            curvature = hessian[k]
            if bent is not None and int(k) in bent:
                curvature = bent[int(k)] + (np.diag(curvature) if curvature.ndim == 1 else curvature)
            target, is_exact[k] = self._target(int(k), gradient[k], curvature)
            going[k] = target is not None
            if target is not None:
                step[k] = target - self.unknowns[k]
        lost = asked & ~going
        self._follow(step, gradient, going)
        return going & ~is_exact, lost

    def add_rows(self, matrix: FloatArray, least: FloatArray) -> None:
        """Add rows of at least `least` (n_frames, n_new); rows of zeros (n_frames, n_new, size) are none."""
        length = np.abs(matrix).max(axis=2, initial=0.0)
        used = length > 0
        length = np.where(used, length, 1.0)
        self.used = np.hstack([self.used, used])
        self.length = np.hstack([self.length, length])
        self.matrix = np.concatenate([self.matrix, matrix / length[:, :, None]], axis=1)
        self.least = np.hstack([self.least, least / length])
        self.most = np.hstack([self.most, np.full(least.shape, np.inf)])
        self.multipliers = np.hstack([self.multipliers, np.zeros(least.shape)])
        self.is_feasible = self.is_feasible & ~used.any(axis=1)
        self._collect_sides()

    def _collect_sides(self) -> None:
        """Put bounds and rows behind each other, as the active-set method takes them."""
        self.low, self.high = np.hstack([self.lower, self.least]), np.hstack([self.upper, self.most])
        self.kind = np.where(self.low == self.high, _EQUATION, _INEQUALITY).astype(np.int32)
        bounds = np.ones(self.lower.shape, dtype=bool)
        self.is_side = np.hstack([bounds, self.used])

    def _make_feasible(self) -> None:
        """Move frames that do not keep their rows to the point nearest to zero that does."""
        nothing, identity = np.zeros(self.unknowns.shape[1]), np.ones(self.unknowns.shape[1])
        for k in np.flatnonzero(~self.is_feasible):
            here, self.unknowns[k] = self.unknowns[k].copy(), 0.0
            target, _ = self._target(int(k), nothing, identity)
            self.unknowns[k] = here if target is None else target
            self.is_feasible[k] = target is not None

    def _follow(self, step: FloatArray, gradient: FloatArray, going: BoolArray) -> None:
        """Follow the steps as far as the objective falls; frames whose step promises nothing have arrived."""
        here = self.objective.values(self.unknowns, self.arrays)
        promise = -(gradient * step).sum(axis=1)
        free = np.abs(np.where(self.is_free, gradient * self.unknowns, 0.0)).sum(axis=1)
        least = _LEAST_PROMISE * np.where(free > 0, free, np.abs(here))
        noise = _NOISE * np.abs(here)
        length = np.where(going, 1.0, 0.0)
        for _ in range(_MOST_HALVINGS):
            there = self.objective.values(self.unknowns + length[:, None] * step, self.arrays)
            enough = there <= here - _KEPT_PROMISE * length * promise + noise
            short = going & self.is_feasible & ~enough & (promise > least)
            if not short.any():
                break
            length[short] /= 2
        self.unknowns += length[:, None] * step
        is_near = self.is_feasible & (promise <= least)
        going &= ~(is_near & self.is_near)
        self.is_near = is_near
        self.is_feasible |= length == 1

    def _target(self, k: int, gradient: FloatArray, hessian: FloatArray) -> tuple[FloatArray | None, bool]:
        """Solve the quadratic model of one frame; None where it has no optimum, and whether it is exact."""
        here, used, sides = self.unknowns[k], self.used[k], self.is_side[k]
        rows, low, high, kind = self.matrix[k], self.low[k], self.high[k], self.kind[k]
        if not used.all():
            rows, low, high, kind = rows[used], low[sides], high[sides], kind[sides]
        size = max(float(np.abs(here).max(initial=0.0)) or 1.0, _SMALLEST_SIZE)
        is_diagonal = hessian.ndim == 1
        curvature = hessian if is_diagonal else np.diagonal(hessian)
        most = curvature.max(initial=0.0)
        is_finite = np.isfinite(gradient).all() and np.isfinite(hessian).all()
        if not (is_finite and curvature.min(initial=0.0) >= 0):
            return None, False
        if most == 0:
            most = _FLATNESS * np.abs(gradient).max(initial=0.0) / size or 1.0
        is_exact = self.objective.is_quadratic and size > _LEAST_SIZE and is_diagonal
        for share in _LEAST_CURVATURE:
            if is_diagonal:
                raised = np.maximum(curvature, share * most)
                matrix, linear = self.diagonal, gradient - raised * here
                np.fill_diagonal(matrix, raised / most)
                is_exact = is_exact and bool((raised == curvature).all())
            else:
                raised = hessian + share * most * np.eye(curvature.size)
                matrix, linear = raised / most, gradient - raised @ here
            found, _, flag, info = daqp.solve(
                matrix,
                linear / (most * size),
                rows,
                high / size,
                low / size,
                kind,
                primal_start=here / size,
                primal_tol=self.tolerance,
            )
            if flag in (_OPTIMAL, _ROUNDED):
                held, pushed = np.split(info["lam"], [here.size])
                self.multipliers[k] = 0.0
                self.multipliers[k, used] = most * size * pushed / self.length[k, used]
                # bounds that hold are met by the method's tolerance only
                target = np.where(held < 0, self.lower[k], np.where(held > 0, self.upper[k], size * found))
                return np.clip(target, self.lower[k], self.upper[k]), is_exact
        self.is_contradicted[k] = flag == _INFEASIBLE
        return None, False

    def settle(self) -> None:
        """Take back what active rows miss by rounding, by the shortest way of the unknowns between bounds.

        The solver of the whole program would take a Newton step for it, and a flat objective makes that long.
        """
        self._approach_sides()
        # what is left of unknowns that are zero is rounding of the largest
        small = np.abs(self.unknowns) <= _ROUNDING * np.abs(self.unknowns).max(
            axis=1, initial=0.0, keepdims=True
        )
        self.unknowns = np.where(small, np.clip(0.0, self.lower, self.upper), self.unknowns)

    def _approach_sides(self) -> None:
        before = np.inf
        for _ in range(_SETTLING_STEPS):
            x = self.unknowns
            value = (self.matrix @ x[:, :, None])[:, :, 0]
            aim = np.clip(value, self.least, self.most)
            pushed = self.multipliers != 0
            aim = np.where(pushed & (self.multipliers < 0), self.least, aim)
            aim = np.where(pushed & (self.multipliers > 0), self.most, aim)
            is_tight = self.used & (pushed | (aim != value))
            left = np.where(is_tight & np.isfinite(aim), aim - value, 0.0)
            missed = np.abs(left).max(initial=0.0)
            if not 0 < missed < _LEAST_GAIN * before:
                return
            before = missed
            # tight rows first, the others left out
            first = np.argsort(~is_tight, axis=1, kind="stable")[:, : is_tight.sum(axis=1).max(initial=0)]
            left, is_tight = (np.take_along_axis(each, first, axis=1) for each in (left, is_tight))
            near = _TOLERANCE * np.abs(x).max(axis=1, initial=0.0, keepdims=True)
            free = (x > self.lower + near) & (x < self.upper - near)
            tight = np.take_along_axis(self.matrix, first[:, :, None], axis=1)
            tight *= is_tight[:, :, None] * free[:, None, :]
            gram = tight @ tight.transpose(0, 2, 1)
            size = np.einsum("krr->kr", gram)
            ridge = np.where(size > 0, _RIDGE * size, 1.0)
            weight = np.linalg.solve(gram + ridge[:, :, None] * np.eye(size.shape[1]), left[:, :, None])
            shift = (weight.transpose(0, 2, 1) @ tight)[:, 0]
            self.unknowns = np.clip(x + shift, self.lower, self.upper)

    def reduced_cost(self) -> FloatArray:
        """Gradient of the objective and what the rows push with, shape (n_frames, n_unknowns)."""
        gradient, _ = self.objective.near(self.unknowns, self.arrays)
        return gradient + np.einsum("kri,kr->ki", self.matrix, self.multipliers * self.length)

    def hides(self) -> BoolArray:
        """Tell in which frames costs of large unknowns hide others that do not balance, shape (n_frames,)."""
        gradient, _ = self.objective.near(self.unknowns, self.arrays)
        pushed = self.multipliers * self.length
        acting = np.abs(gradient) + np.einsum("kri,kr->ki", np.abs(self.matrix), np.abs(pushed))
        left = np.abs(gradient + np.einsum("kri,kr->ki", self.matrix, pushed))
        size = np.abs(self.unknowns).max(axis=1, initial=0.0, keepdims=True)
        inside = (self.unknowns - self.lower > _HIDDEN * size) & (self.upper - self.unknowns > _HIDDEN * size)
        costs = self.is_free & (gradient != 0) & (np.abs(self.unknowns) > _HIDDEN * size)
        off = inside & costs & (left > _HIDING * acting)
        return np.asarray(off.any(axis=1))

    def _missed(self) -> FloatArray:
        """Largest amount by which a row or bound is missed, over the size of the row, shape (n_frames,)."""
        x = self.unknowns
        value = np.einsum("kri,ki->kr", self.matrix, x)
        rows = np.where(self.used, np.maximum(self.least - value, value - self.most), 0.0)
        bounds = np.maximum(self.lower - x, x - self.upper)
        size = np.abs(x).max(axis=1, initial=0.0)
        missed = np.maximum(rows.max(axis=1, initial=0.0), bounds.max(axis=1, initial=0.0))
        return np.divide(missed, size, out=np.where(missed > 0, np.inf, 0.0), where=size > 0)
