"""Frames solved together or one by one, as programs for IPOPT."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from scso_nlp.exceptions import ProblemError
from scso_nlp.messages import COUNTS
from scso_nlp.solution import Solution, Status
from scso_nlp.solver.feasibility import Impossible, contradiction, least_effort, out_of_reach
from scso_nlp.solver.ipopt import IpoptAnswer, SolverOptions, call_ipopt, compile_ipopt
from scso_nlp.solver.judge import Outcome, unknowns_of
from scso_nlp.solver.optimality import OPTIMALITY_TOLERANCE, optimality_of
from scso_nlp.solver.presolve import Start, balanced, presolve, told_by_own
from scso_nlp.solver.relative import QuadraticPrograms, may_be_convex
from scso_nlp.transcription.build import FrameScale, Nlp, build_nlp
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import evaluate
from scso_nlp.validation import BoolArray, FloatArray, IntArray

_LOG = logging.getLogger("scso_nlp")

#: Objectives are weighed at the guess and where all unknowns are this large, whichever gives more [-].
_LEAST_EFFORT = 1e-3

#: Unknowns of a program that confirms: larger ones leave the processor's cache.
_CONFIRMED_UNKNOWNS = 2**12

#: Most iterations to confirm a start, and those of frames that could be confirmed one by one: together all of
#: them take as many as the slowest.
_TO_CONFIRM, _TO_CONFIRM_TOGETHER = 30, 2

#: Share of the tolerance to which a curved objective of a size near one is solved: small activations, which
#: hardly change it, move freely within the whole [-].
_FLATNESS = 1e-5

#: A frame is solved again while that brings it this much nearer to its optimum [-].
_NEARER = 0.5

#: Smallest scale of the unknowns of a frame [-].
_LEAST_SCALE = 1e-12


@dataclass(kw_only=True)
class Effort:
    """What solving has cost so far, and how many frames were at their optimum before."""

    iterations: int = 0
    build_seconds: float = 0.0
    solve_seconds: float = 0.0
    taken_over: int = 0
    kept_frames: int | None = None


def solve_rows(
    program: FrameProgram,
    start: FloatArray,
    *,
    together: bool,
    doubtful: Iterable[int],
    options: SolverOptions,
    effort: Effort,
    known: Start | None = None,
) -> Outcome:
    """Solve a program with the rows that it has.

    Frames that are proven infeasible beforehand are not given to the solver.

    Parameters
    ----------
    program : FrameProgram
    start : ndarray, shape (n_frames, n_unknowns)
        Scaled; every program begins here, so that a frame's answer does not depend on which others failed.
    together : bool
        All frames in few programs, or one by one.
    doubtful : iterable of int
        Frames to be tested for feasibility first.
    options : SolverOptions
    effort : Effort
        Is added to.
    known : Start, optional
        Frames that are at their optimum already.

    Returns
    -------
    Outcome
    """
    started = time.perf_counter()
    n = program.time.size
    impossible = out_of_reach(program)
    for k in sorted(set(doubtful) - set(impossible)):
        found = contradiction(program, np.array([k]))
        if found is not None:
            impossible[k] = found
    lost = set(range(n)) if program.is_coupled and impossible else set(impossible)
    run = _Run(
        program=program,
        options=options,
        effort=effort,
        start=start,
        unknowns=start.copy(),
        multipliers=(
            np.full((n, len(program.rows)), np.nan),
            np.full((max(n - 1, 0), len(program.pair_rows)), np.nan),
        ),
        status=[Status.INFEASIBLE if k in lost else None for k in range(n)],
        scale=FrameScale.of_weights(program, frame_weights(program, start)),
        impossible=impossible,
        unit=np.ones(n),
    )
    effort.build_seconds += time.perf_counter() - started
    if options.presolve:
        run.confirm(options.frames_per_program if together else 1, known)
    if run.waiting.size:
        # where some were confirmed, the others are difficult, and would make all of their program as slow
        run.together() if together and not run.has_confirmed else run.one_by_one()
        if not program.is_coupled:
            run.again()
    run.unknowns[sorted(lost)] = np.nan
    return Outcome(
        program=program,
        unknowns=run.unknowns,
        multipliers=run.multipliers,
        status=tuple(s if s is not None else Status.NUMERICAL_ERROR for s in run.status),
        impossible=tuple(run.impossible.values()),
        unit=run.unit,
    )


@dataclass(kw_only=True)
class _Run:
    """A solve under way: scaled unknowns, row multipliers and a status per frame (None: waiting).

    Multipliers are those of the objective of unknowns over `unit`.
    """

    program: FrameProgram
    options: SolverOptions
    effort: Effort
    start: FloatArray
    unknowns: FloatArray
    multipliers: tuple[FloatArray, FloatArray]
    status: list[Status | None]
    scale: FrameScale
    impossible: dict[int, Impossible]
    unit: FloatArray
    bounds: tuple[FloatArray, FloatArray] = field(init=False)

    def __post_init__(self) -> None:
        self.bounds = self.program.bounds()

    @property
    def has_confirmed(self) -> bool:
        """Whether frames, apart from each other, are at their optimum already."""
        return not self.program.is_coupled and any(s is not None and s.is_solved for s in self.status)

    @property
    def waiting(self) -> IntArray:
        """Frames without a status."""
        return np.array([k for k, status in enumerate(self.status) if status is None], dtype=np.int64)

    def confirm(self, frames_per_program: int, known: Start | None) -> None:
        """Find the optima of convex frames one by one, and let the solver confirm them."""
        if self.program.is_coupled or self.program.split.nonlinear:
            self._approach(frames_per_program)
            return
        started = time.perf_counter()
        exact = presolve(self.program, self.start, self.waiting, known)
        for k in np.flatnonzero(exact.is_doubtful):
            if self._is_impossible(int(k)):
                self.status[k] = Status.INFEASIBLE
        self.effort.solve_seconds += time.perf_counter() - started
        for k in np.flatnonzero(exact.is_confirmed):
            self.unknowns[k], self.multipliers[0][k] = exact.unknowns[k], exact.multipliers[k]
            self.status[k] = Status.SOLVED
        self.effort.taken_over = int(exact.is_confirmed.sum())
        frames = np.flatnonzero(exact.is_optimal & ~exact.is_confirmed)
        if not frames.size:
            return
        start, scale = self.start, self.scale
        self.start = exact.unknowns
        self.scale = FrameScale.of_weights(self.program, 1 / _objective_size(self.program, self.start, ()))
        built: dict[int, tuple[Nlp, ca.Function]] = {}
        most = min(frames_per_program, max(_CONFIRMED_UNKNOWNS // self.program.layout.size, 1))
        frames = frames[np.argsort(exact.worst[frames], kind="stable")]
        blocks = [np.sort(block) for block in _equal_blocks(frames, most)]
        while blocks:
            block = blocks.pop(0)
            if block.size not in built:
                within = _TO_CONFIRM if block.size == 1 else _TO_CONFIRM_TOGETHER
                built[block.size] = self._build(block.size, confirm_within=within)
            multipliers = (
                (-exact.reduced_cost[block] * self.scale.weight[block, None]).ravel(),
                built[block.size][0].row_multipliers(exact.multipliers, block, self.scale),
            )
            if not self._call(*built[block.size], block, multipliers).status.is_solved and block.size > 1:
                blocks += np.array_split(block, block.size)
        self.start, self.scale = start, scale
        worst = self._worst()
        # the barrier needs a push from bounds, and large rows a step: what is confirmed may be nearer
        nearer = exact.is_optimal & (exact.worst <= worst) & np.isfinite(worst)
        self.unknowns[nearer] = exact.unknowns[nearer]
        self.multipliers[0][nearer] = exact.multipliers[nearer]
        self._set(np.flatnonzero(nearer), Status.SOLVED)
        worst = np.where(nearer, exact.worst, worst)
        for k in frames[worst[frames] > OPTIMALITY_TOLERANCE]:
            self.status[k] = None

    def _approach(self, frames_per_program: int) -> None:
        """Let the solver start coupled and curved programs where their affine relatives lead.

        Without coupling, or as quadratic programs where these are enough.
        """
        program, frames = self.program, self.waiting
        alone = program.alone()
        is_straight = program.is_coupled and not alone.split.nonlinear
        if not frames.size or not (is_straight or may_be_convex(program)):
            return
        before = self.start, self.scale
        self.start = self.start.copy()
        if is_straight:
            started = time.perf_counter()
            self.start = program.layout.followed(presolve(alone, self.start, frames).unknowns)
            size = _objective_size(program, self.start, ())
            self.scale = FrameScale.of_weights(program, np.full(size.size, 1 / size.mean()))
            self.effort.solve_seconds += time.perf_counter() - started
        n_programs = 1 if program.is_coupled else -(-frames.size // frames_per_program)
        built: dict[int, QuadraticPrograms] = {}
        for block in np.array_split(frames, n_programs):
            started = time.perf_counter()
            if block.size not in built:
                built[block.size] = QuadraticPrograms(build_nlp(program, block.size))
            relatives, found = built[block.size], None
            self.effort.build_seconds += time.perf_counter() - started
            started = time.perf_counter()
            if relatives.are_enough:
                found = relatives.follow(**self._numbers(relatives.nlp, block))
            self.effort.solve_seconds += time.perf_counter() - started
            if found is not None:
                self.start[block] = found.unknowns.reshape(block.size, -1)
                solver = compile_ipopt(relatives.nlp, self.options, confirm_within=_TO_CONFIRM)
                self._call(relatives.nlp, solver, block, (found.bounds, found.rows))
            elif is_straight and not relatives.are_enough:
                tolerance = self.options.tolerance
                if not relatives.nlp.objective_is_quadratic:
                    tolerance *= _FLATNESS
                solver = compile_ipopt(relatives.nlp, replace(self.options, tolerance=tolerance))
                self._call(relatives.nlp, solver, block)
        self.start, self.scale = before
        worst = self._worst()
        for k in frames:
            # IPOPT calls acceptable what misses the share of the tolerance that was asked for
            if worst[k] <= self.options.tolerance and self.status[k] is Status.ACCEPTABLE:
                self.status[k] = Status.SOLVED
            elif worst[k] > OPTIMALITY_TOLERANCE:
                self.status[k] = None

    def together(self) -> None:
        """Solve the waiting frames as few programs; where they fail, find out which and go on without."""
        frames = self.waiting
        coupled = self.program.is_coupled
        n_programs = 1 if coupled else -(-frames.size // self.options.frames_per_program)
        built: dict[int, tuple[Nlp, ca.Function]] = {}
        lost: list[int] = []
        for block in np.array_split(frames, n_programs):
            if block.size not in built:
                built[block.size] = self._build(block.size)
            answer = self._call(*built[block.size], block)
            if answer.status.is_solved:
                continue
            if coupled:
                self._set(block, answer.status)
                return
            _LOG.info("%d frames were not solved together (%s)", block.size, answer.status.name)
            lost += [int(k) for k in block if self._is_impossible(int(k))]
        self._set(lost, Status.INFEASIBLE)
        if lost and self.waiting.size:
            _LOG.info("%d frames are infeasible; solving the other %d", len(lost), self.waiting.size)
            self.together()
        elif self.waiting.size:
            _LOG.info("solving %d frames one by one", self.waiting.size)
            self.one_by_one()

    def one_by_one(self) -> None:
        """Solve each waiting frame with one compiled program."""
        nlp, solver = self._build(1)
        waiting = self.waiting
        for i, k in enumerate(waiting):
            COUNTS.info("solving one by one, frame %d of %d", i + 1, waiting.size)
            self.status[k] = self._call(nlp, solver, np.array([k])).status

    def again(self) -> None:
        """Solve frames that are not at their optimum again, alone and on their own scale, while it helps."""
        worst = self._worst()
        self._rest(worst)
        failed = np.isinf(worst)
        open_ = worst > OPTIMALITY_TOLERANCE
        for k in np.flatnonzero(failed):
            open_[k] = not self._is_impossible(int(k))
        self._balance(worst, np.flatnonzero(open_ & ~failed))
        open_ &= worst > OPTIMALITY_TOLERANCE
        if not open_.any():
            return
        compiled = self._build(1, is_scaled=True)
        for start, bounds in self._beginnings(np.flatnonzero(open_), failed):
            going = open_ & np.isfinite(start).all(axis=1)
            self.start, self.bounds = np.where(going[:, None], start, 0.0), bounds
            while going.any():
                better = self._nearer(compiled, np.flatnonzero(going), worst)
                open_ &= worst > OPTIMALITY_TOLERANCE
                going &= open_ & better
                self.start = self.unknowns
        self.bounds = self.program.bounds()
        self._balance(worst, np.flatnonzero(open_ & failed & np.isfinite(worst)))

    def _beginnings(
        self, frames: IntArray, failed: BoolArray
    ) -> Iterator[tuple[FloatArray, tuple[FloatArray, FloatArray]]]:
        """Where frames begin again, NaN in those that do not, and the bounds of their unknowns.

        Where they are, unless they failed; at the least effort that keeps their rows; and, with prices that
        hide the effort, with all levels kept: that is the optimum too if none is worth its price.
        """
        yield np.where(failed[:, None], np.nan, self.unknowns), self.bounds
        guess = starting_point(self.program, None)
        lower, upper = self.program.bounds()
        kept = np.where(self.program.is_miss, lower, upper)
        for most in (upper, kept) if self.program.is_miss.any() else (upper,):
            start = np.full_like(guess, np.nan)
            for k in frames:
                point = least_effort(self.program, int(k), (lower[k], most[k]))
                if point is not None:
                    start[k] = point
                elif most is upper:
                    start[k] = guess[k]
            yield start, (lower, most)

    def _nearer(self, compiled: tuple[Nlp, ca.Function], frames: IntArray, worst: FloatArray) -> BoolArray:
        """Solve frames once more; keep what is nearer to the optimum, and tell which are, in all frames."""
        self.scale = own_scale(self.program, self.start)
        state = (self.unknowns, self.multipliers[0], self.unit)
        before, status = [values.copy() for values in state], list(self.status)
        for k in frames:
            self.status[k] = self._call(*compiled, np.array([k])).status
        found = self._worst()
        better = found < _NEARER * worst
        for k in frames[~better[frames]]:
            self.status[k] = status[k]
            for values, earlier in zip(state, before, strict=True):
                values[k] = earlier[k]
        worst[better] = found[better]
        return better

    def _is_impossible(self, frame: int) -> bool:
        """Tell whether rows of a frame contradict each other, and keep the proof."""
        if frame not in self.impossible:
            found = contradiction(self.program, np.array([frame]))
            if found is None:
                return False
            self.impossible[frame] = found
        return True

    def _worst(self) -> FloatArray:
        """How far each frame is from its optimum, shape (n_frames,); infinite where it is not solved."""
        solved = np.array([s is not None and s.is_solved for s in self.status])
        unknowns = np.where(solved[:, None], self.unknowns, self.start)
        found = optimality_of(self.program, unknowns, self.multipliers, solved, self.unit).worst
        return np.where(solved, np.nan_to_num(found, nan=np.inf), np.inf)

    def _rest(self, worst: FloatArray) -> None:
        """Take the point nearest to zero where it is the optimum, which no barrier reaches."""
        rest = np.clip(0.0, *self.bounds)
        multipliers = np.zeros_like(self.multipliers[0]), np.zeros_like(self.multipliers[1])
        found = optimality_of(self.program, rest, multipliers, np.ones(len(rest), dtype=bool)).worst
        for k in np.flatnonzero((found <= OPTIMALITY_TOLERANCE) & (worst > OPTIMALITY_TOLERANCE)):
            self.unknowns[k], self.multipliers[0][k] = rest[k], 0.0
            self.status[k], worst[k] = Status.SOLVED, found[k]

    def _balance(self, worst: FloatArray, frames: IntArray) -> None:
        """Take optima in which every unknown is exact, whatever the others cost, where that is nearer."""
        own = frames[self.unit[frames] == 1]
        self._take_nearer(told_by_own(self.program, own, self.unknowns, self.multipliers[0]), worst)
        self._take_nearer(balanced(self.program, frames[worst[frames] > OPTIMALITY_TOLERANCE]), worst)

    def _take_nearer(self, found: Start, worst: FloatArray) -> None:
        for k in np.flatnonzero(found.is_optimal & (found.worst < worst)):
            self.unknowns[k], self.multipliers[0][k] = found.unknowns[k], found.multipliers[k]
            self.status[k], self.unit[k], worst[k] = Status.SOLVED, 1.0, found.worst[k]

    def _build(
        self, n_frames: int, *, is_scaled: bool = False, confirm_within: int | None = None
    ) -> tuple[Nlp, ca.Function]:
        started = time.perf_counter()
        nlp = build_nlp(self.program, n_frames, is_scaled=is_scaled)
        solver = compile_ipopt(nlp, self.options, confirm_within=confirm_within)
        self.effort.build_seconds += time.perf_counter() - started
        return nlp, solver

    def _numbers(self, nlp: Nlp, frames: IntArray) -> dict[str, Any]:
        """Start, parameters and bounds of a program over some frames."""
        size = self.scale.unknowns[frames, None]
        lower, upper = (bound[frames] / size for bound in self.bounds)
        return {
            "x0": (self.start[frames] / size).ravel(),
            "p": nlp.parameters(frames, self.scale),
            "bounds": (lower.ravel(), upper.ravel()),
            "row_bounds": nlp.row_bounds(frames, self.scale),
        }

    def _call(
        self,
        nlp: Nlp,
        solver: ca.Function,
        frames: IntArray,
        multipliers: tuple[FloatArray, FloatArray] | None = None,
    ) -> IpoptAnswer:
        started = time.perf_counter()
        answer = call_ipopt(solver, **self._numbers(nlp, frames), multipliers=multipliers)
        size = self.scale.unknowns[frames, None]
        self.unknowns[frames] = np.clip(
            answer.x.reshape(frames.size, -1) * size, *(b[frames] for b in self.bounds)
        )
        if nlp.is_scaled and self.program.degree is not None:
            self.unit[frames] = size[:, 0]
        one, pair = nlp.multipliers(answer.lam_g, frames, self.scale)
        self.multipliers[0][frames] = one
        if frames.size > 1 and pair.size:
            self.multipliers[1][:] = pair
        if answer.status.is_solved:
            self._set(frames, answer.status)
        self.effort.iterations += answer.iterations
        self.effort.solve_seconds += time.perf_counter() - started
        return answer

    def _set(self, frames: Iterable[int], status: Status) -> None:
        for k in frames:
            self.status[int(k)] = status


def _equal_blocks(frames: IntArray, most: int) -> list[IntArray]:
    """Cut frames into blocks of one size; the last may begin with frames of the one before."""
    n_blocks = -(-frames.size // most)
    size = -(-frames.size // n_blocks)
    starts = [min(i * size, frames.size - size) for i in range(n_blocks)]
    return [frames[start : start + size] for start in starts]


def starting_point(program: FrameProgram, guess: Solution | None) -> FloatArray:
    """Scaled unknowns to begin with: of a solution, and what it lacks from the terms' own guesses.

    Raises
    ------
    ProblemError
        The solution has another number of frames or muscles.
    """
    if guess is not None:
        expected = (program.time.size, program.problem.motion.muscles.n_muscles)
        if guess.activation.shape != expected:
            raise ProblemError(
                f"initial_guess has activations of shape {guess.activation.shape}, expected "
                f"{expected} = (n_frames, n_muscles)"
            )
    return np.clip(unknowns_of(program, guess), *program.bounds())


def own_scale(program: FrameProgram, unknowns: FloatArray) -> FrameScale:
    """Scale each frame by the size of its objective, unknowns and affine rows at a point.

    Parameters
    ----------
    program : FrameProgram
        Without coupling.
    unknowns : ndarray, shape (n_frames, n_unknowns)
        Scaled and finite.

    Returns
    -------
    FrameScale
        Unknowns keep their scale where rows are not affine, because these have scales of their own.
    """
    affine = program.split.affine
    size = np.ones(len(unknowns))
    if not program.split.nonlinear:
        size = np.clip(np.abs(unknowns).max(axis=1, initial=0.0), _LEAST_SCALE, 1.0)
    own = unknowns if program.degree is None else unknowns / size[:, None]
    rows = np.zeros((len(unknowns), len(program.rows)))
    entries = np.abs(affine.values) * size[:, None]
    for entry, row in enumerate(affine.row):
        rows[:, row] = np.maximum(rows[:, row], entries[:, entry])
    return FrameScale(
        weight=1.0 / _objective_size(program, own, ()),
        unknowns=size,
        rows=np.where(rows > 0, rows, 1.0),
    )


def frame_weights(program: FrameProgram, unknowns: FloatArray) -> FloatArray:
    r"""Weights that bring every frame's objective near 1 at the guess, shape (n_frames,).

    Without coupling a positive weight per frame does not move the optimum, and with coupling one weight
    for all; but without it the powers of small activations, or an objective of small weight, vanish in
    the solver's tolerance. The size of an objective f is :math:`\sum_i |x_i\, \partial f/\partial x_i|`,
    which a constant offset does not change.
    """
    size = _objective_size(program, unknowns, (np.full_like(unknowns, _LEAST_EFFORT),))
    if program.is_coupled:
        size[:] = size.mean()
    return 1.0 / size


@np.errstate(over="ignore", invalid="ignore")
def _objective_size(
    program: FrameProgram, unknowns: FloatArray, others: tuple[FloatArray, ...]
) -> FloatArray:
    """Sum of |x df/dx|, the largest of all points, shape (n_frames,); 1 where it is zero.

    Unknowns that an equation determines do not count where others do: the size is of what there is to choose.
    """
    size, total = np.zeros((2, len(unknowns)))
    is_free = ~program.split.affine.determined(program.rows, program.layout.size)
    for _, piece in program.objectives:
        slope = piece.slope()
        for point in (unknowns, *others):
            slopes = np.abs(evaluate(piece, slope, point, program.arrays)[0])
            for side, part in enumerate(np.split(slopes, len(piece.unknowns), axis=1)):
                frames = slice(side, side + len(part))
                cost = part * np.abs(point[frames])
                for found, each in ((size, np.where(is_free[frames], cost, 0.0)), (total, cost)):
                    value = each.sum(axis=1)
                    found[frames] = np.maximum(found[frames], np.where(np.isfinite(value), value, 0.0))
    size = np.where(size > np.finfo(float).tiny, size, total)
    return np.where(size > np.finfo(float).tiny, size, 1.0)
