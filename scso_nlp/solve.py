"""The two verbs: solve the frames of a motion together, or frame by frame."""

from __future__ import annotations

import importlib.metadata
import logging
import platform
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.exceptions import CouplingError, ProblemError
from scso_nlp.objectives.objective import FrameObjective
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import Shortfall, Solution, SolveFailed, SolveReport, Status
from scso_nlp.transcription.build import (
    FrameProgram,
    Nlp,
    SplitRows,
    build_nlp,
    describe,
    evaluate,
    split_rows,
)
from scso_nlp.transcription.check import (
    FEASIBILITY_TOLERANCE,
    infeasible_rows,
    out_of_reach,
    row_results,
    scaled_violation,
    violations,
    worst_rows,
)
from scso_nlp.transcription.ipopt import IpoptAnswer, SolverOptions, call_ipopt, compile_ipopt
from scso_nlp.transcription.layout import PROBLEM
from scso_nlp.transcription.local_model import local_model
from scso_nlp.validation import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    import casadi as ca

_LOG = logging.getLogger("scso_nlp")

#: Objectives are weighed at the guess and where all unknowns are this large, whichever gives more [-].
_LEAST_EFFORT = 1e-3

#: Most rounds of adding rows to constraints that cannot write all of them down beforehand.
_MAX_ROUNDS = 100

#: Least tolerance where rows are added: eigenvalues near zero react strongly to small errors.
_TOLERANCE_OF_ADDED_ROWS = 1e-10

#: A frame whose rows are missed by more than this much of their scale is not solved [-].
_LOOSE_VIOLATION = 1e-4


def solve_trajectory(
    problem: MuscleForceProblem,
    *,
    initial_guess: Solution | None = None,
    options: SolverOptions | None = None,
    on_failure: str = "raise",
) -> Solution:
    """Solve all frames together, as one nonlinear program.

    Where no term couples frames, a motion of more than ``options.frames_per_program`` frames is cut into
    several programs; the answer does not depend on the cut.

    Frames that are found infeasible are taken out of the program where no term couples frames, so that
    the others still get their answer.

    Parameters
    ----------
    problem : MuscleForceProblem
    initial_guess : Solution, optional
        Of the same motion; what it lacks starts from the default guess.
    options : SolverOptions, optional
    on_failure : "raise" or "return"
        Whether a failed frame raises or is only marked in ``Solution.frame_status``.

    Returns
    -------
    Solution

    Raises
    ------
    SolveFailed
        Some frame was not solved; the exception carries the solution with its last iterate.
    ProblemError
        Contradictory description or options.
    """
    return _solve(problem, "trajectory", initial_guess, options or SolverOptions(), on_failure)


def solve_framewise(
    problem: MuscleForceProblem,
    *,
    initial_guess: Solution | None = None,
    options: SolverOptions | None = None,
    on_failure: str = "raise",
) -> Solution:
    """Solve frame by frame: the same program built for one frame and fed with each frame's numbers.

    Parameters
    ----------
    problem : MuscleForceProblem
        Without terms that couple frames; see :meth:`MuscleForceProblem.without_coupling`.
    initial_guess : Solution, optional
    options : SolverOptions, optional
    on_failure : "raise" or "return"

    Returns
    -------
    Solution

    Raises
    ------
    CouplingError
        A term couples frames.
    SolveFailed
        Some frame was not solved; the exception carries the solution with its last iterate.
    ProblemError
        Contradictory description or options.
    """
    if problem.coupled_terms:
        raise CouplingError(
            f"{', '.join(problem.coupled_terms)} couples frames, so the problem cannot be solved "
            "frame by frame; use solve_trajectory, or problem.without_coupling()"
        )
    return _solve(problem, "framewise", initial_guess, options or SolverOptions(), on_failure)


def _solve(
    problem: MuscleForceProblem, solver: str, guess: Solution | None, options: SolverOptions, on_failure: str
) -> Solution:
    if on_failure not in ("raise", "return"):
        raise ProblemError(f"on_failure is {on_failure!r}, expected 'raise' or 'return'")
    for term in (problem.muscle_model, *problem.constraints):
        for note in term.notes(problem):
            _LOG.info("%s: %s", problem.trajectory.name, note)
    if _rows_may_be_added(problem):
        options = replace(options, tolerance=min(options.tolerance, _TOLERANCE_OF_ADDED_ROWS))
    solution, run = _solve_rows(_foreseeing(problem, guess), solver, guess, options)
    reports = [solution.report]
    for _ in range(_MAX_ROUNDS):
        tighter = _tightened(solution.problem, run, is_solution=True)
        if tighter is None:
            break
        solution, run = _solve_rows(tighter, solver, solution, options)
        reports.append(solution.report)
    else:
        _LOG.warning("rows were still being added after %d rounds", _MAX_ROUNDS)
        solution = replace(solution, frame_status=(Status.ITERATION_LIMIT,) * len(solution.frame_status))
    report = replace(
        reports[-1],
        iterations=sum(r.iterations for r in reports),
        build_seconds=sum(r.build_seconds for r in reports),
        solve_seconds=sum(r.solve_seconds for r in reports),
        rounds=len(reports),
    )
    solution = replace(solution, report=report)
    _LOG.info(
        "%s (%s): %s; %d rounds, %d iterations, build %.2f s, solve %.2f s",
        problem.trajectory.name,
        solver,
        solution.summary(),
        report.rounds,
        report.iterations,
        report.build_seconds,
        report.solve_seconds,
    )
    if on_failure == "raise" and not solution.is_solved.all():
        raise SolveFailed(solution)
    return solution


def _foreseeing(problem: MuscleForceProblem, guess: Solution | None) -> MuscleForceProblem:
    """Let constraints add the rows that they can foresee at the starting point."""
    if not _rows_may_be_added(problem):
        return problem
    program = describe(problem)
    start = _start(program, guess)
    run = _Run(
        program=program, split=split_rows(program), options=SolverOptions(), start=start["unknowns"], **start
    )
    return _tightened(problem, run, is_solution=False) or problem


def _rows_may_be_added(problem: MuscleForceProblem) -> bool:
    return any(
        type(t).tighten is not FrameConstraint.tighten
        for t in problem.constraints
        if isinstance(t, FrameConstraint)
    )


def _doubtful_frames(problem: MuscleForceProblem) -> set[int]:
    return {
        k
        for term in problem.constraints
        if isinstance(term, FrameConstraint)
        for k in term.doubtful_frames(problem)
    }


def _tightened(problem: MuscleForceProblem, run: _Run, *, is_solution: bool) -> MuscleForceProblem | None:
    """Return the problem with the rows that its constraints add near a point, or None."""
    if not _rows_may_be_added(problem):
        return None
    usable = np.array([s is not None and s.is_solved for s in run.status]) if is_solution else None
    near = local_model(
        run.program,
        run.split,
        run.unknowns,
        is_solution=is_solution,
        usable=np.ones(len(run.status), dtype=bool) if usable is None else usable,
    )
    tighter = [
        t.tighten(problem, near) if isinstance(t, FrameConstraint) else None for t in problem.constraints
    ]
    if not any(tighter):
        return None
    merged = tuple(new or old for new, old in zip(tighter, problem.constraints, strict=True))
    return replace(problem, constraints=merged)


def _solve_rows(
    problem: MuscleForceProblem, solver: str, guess: Solution | None, options: SolverOptions
) -> tuple[Solution, _Run]:
    """Solve with the rows as they are."""
    gentler = _gentler(problem)
    first = None
    if gentler is not None and guess is None:
        guess = first = _solve_rows(gentler, solver, None, options)[0]
    started = time.perf_counter()
    program = describe(problem)
    split = split_rows(program)
    start = _start(program, guess)
    run = _Run(program=program, split=split, options=options, start=start["unknowns"].copy(), **start)
    if first is not None:
        run.iterations += first.report.iterations
        run.build_seconds += first.report.build_seconds
        run.solve_seconds += first.report.solve_seconds
    shortfalls = out_of_reach(program, split.affine)
    reached = {shortfall.frame for shortfall in shortfalls}
    for k in sorted(_doubtful_frames(problem) - reached):
        shortfalls += infeasible_rows(program, split.affine, k)
    for shortfall in shortfalls:
        run.status[shortfall.frame] = Status.INFEASIBLE
    if problem.coupled_terms and shortfalls:
        run.status[:] = [Status.INFEASIBLE] * len(run.status)
    run.weights = _frame_weights(program, run.unknowns)
    run.build_seconds += time.perf_counter() - started
    if run.waiting.size:
        run.together() if solver == "trajectory" else run.one_by_one()
    return _finish(run, shortfalls, solver), run


@dataclass(kw_only=True)
class _Run:
    """A solve under way: scaled unknowns, row multipliers and a status per frame (None: waiting).

    Every program begins at `start`, so that a frame's answer does not depend on which others failed.
    """

    program: FrameProgram
    split: SplitRows
    options: SolverOptions
    start: FloatArray
    unknowns: FloatArray
    multipliers: tuple[FloatArray, FloatArray]
    status: list[Status | None]
    weights: FloatArray
    iterations: int = 0
    build_seconds: float = 0.0
    solve_seconds: float = 0.0

    def __post_init__(self) -> None:
        layout, n = self.program.layout, self.program.problem.trajectory.n_frames
        self._lower, self._upper = (layout.rows(what, n) / layout.scale for what in ("lower", "upper"))

    @property
    def waiting(self) -> IntArray:
        """Frames without a status."""
        return np.array([k for k, status in enumerate(self.status) if status is None], dtype=np.int64)

    def together(self) -> None:
        """Solve the waiting frames as few programs; where they fail, find out which and go on without."""
        frames = self.waiting
        coupled = bool(self.program.problem.coupled_terms)
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
            lost += [int(k) for k in block if infeasible_rows(self.program, self.split.affine, int(k))]
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
        for k in self.waiting:
            self.status[k] = self._call(nlp, solver, np.array([k])).status

    def _build(self, n_frames: int) -> tuple[Nlp, ca.Function]:
        started = time.perf_counter()
        nlp = build_nlp(self.program, self.split, n_frames)
        solver = compile_ipopt(nlp, self.options)
        self.build_seconds += time.perf_counter() - started
        return nlp, solver

    def _call(self, nlp: Nlp, solver: ca.Function, frames: IntArray) -> IpoptAnswer:
        started = time.perf_counter()
        answer = call_ipopt(
            solver,
            x0=self.start[frames].ravel(),
            p=nlp.parameters(frames, self.weights[frames]),
            bounds=(self._lower[frames].ravel(), self._upper[frames].ravel()),
            row_bounds=nlp.row_bounds(frames),
        )
        self.unknowns[frames] = answer.x.reshape(frames.size, -1)
        one, pair = nlp.multipliers(answer.lam_g)
        self.multipliers[0][frames] = one / self.weights[frames, None]
        if frames.size > 1 and pair.size:
            self.multipliers[1][:] = pair / self.weights[0]  # one weight for all where frames are coupled
        if answer.status.is_solved:
            self._set(frames, answer.status)
        self.iterations += answer.iterations
        self.solve_seconds += time.perf_counter() - started
        return answer

    def _set(self, frames: Iterable[int], status: Status) -> None:
        for k in frames:
            self.status[int(k)] = status


def _start(program: FrameProgram, guess: Solution | None) -> dict[str, Any]:
    """Make the starting point, empty multipliers, unit weights and waiting frames."""
    n = program.problem.trajectory.n_frames
    unknowns = program.layout.rows("guess", n)
    if guess is not None:
        if guess.activation.shape != (n, program.problem.muscles.n_muscles):
            raise ProblemError(
                f"initial_guess has activations of shape {guess.activation.shape}, expected "
                f"{(n, program.problem.muscles.n_muscles)} = (n_frames, n_muscles)"
            )
        parts = {(PROBLEM, "activation"): guess.activation, (PROBLEM, "control"): guess.control}
        for name, values in guess.variables.items():
            owner, _, variable = name.rpartition(".")
            parts[owner, variable] = values
        given = program.layout.join(parts, unknowns)
        unknowns = np.where(np.isfinite(given), given, unknowns)
    sizes = [sum(len(b.names) for b in program.row_blocks if b.is_pair == pair) for pair in (False, True)]
    return {
        "unknowns": unknowns / program.layout.scale,
        "multipliers": (np.full((n, sizes[0]), np.nan), np.full((max(n - 1, 0), sizes[1]), np.nan)),
        "status": [None] * n,
        "weights": np.ones(n),
    }


def _gentler(problem: MuscleForceProblem) -> MuscleForceProblem | None:
    """Return the same problem with gentler objectives, or None where no objective asks for it."""
    terms = [term.gentler() if isinstance(term, FrameObjective) else None for term in problem.objectives]
    if not any(terms):
        return None
    changed = tuple(new or old for new, old in zip(terms, problem.objectives, strict=True))
    return replace(problem, objectives=changed)


def _frame_weights(program: FrameProgram, unknowns: FloatArray) -> FloatArray:
    r"""Weights that bring every frame's objective near 1 at the guess, shape (n_frames,).

    Without coupling a positive weight per frame does not move the optimum, and with coupling one weight
    for all; but without it the powers of small activations, or an objective of small weight, vanish in
    the solver's tolerance. The size of an objective f is :math:`\sum_i |x_i\, \partial f/\partial x_i|`,
    which a constant offset does not change.
    """
    size = np.zeros(len(unknowns))
    for _, piece in program.objectives:
        slope = piece.slope()
        for point in (unknowns, np.full_like(unknowns, _LEAST_EFFORT)):
            slopes = np.abs(evaluate(piece, slope, point, program.arrays)[0])
            for side, part in enumerate(np.split(slopes, len(piece.unknowns), axis=1)):
                frames = slice(side, side + len(part))
                value = (part * np.abs(point[frames])).sum(axis=1)
                size[frames] = np.maximum(size[frames], np.where(np.isfinite(value), value, 0.0))
    if program.problem.coupled_terms:
        size[:] = size.mean()
    return 1.0 / np.where(size > np.finfo(float).tiny, size, 1.0)


def _finish(run: _Run, shortfalls: list[Shortfall], solver: str) -> Solution:
    program, problem = run.program, run.program.problem
    unknowns = run.unknowns * program.layout.scale
    status = [s if s is not None else Status.NUMERICAL_ERROR for s in run.status]
    reached = {shortfall.frame for shortfall in shortfalls}
    if reached:
        # No solver was called for these frames, nor for any frame that they are coupled with.
        unknowns[list(range(len(unknowns))) if problem.coupled_terms else sorted(reached)] = np.nan
    finite = np.nan_to_num(unknowns)
    rows = row_results(program, finite, run.multipliers)
    violation = scaled_violation(program, rows, finite)
    for k, found in enumerate(status):
        if found.is_solved and violation[k] > _LOOSE_VIOLATION:
            status[k] = Status.NUMERICAL_ERROR
        elif found is Status.SOLVED and violation[k] > FEASIBILITY_TOLERANCE:
            status[k] = Status.ACCEPTABLE
    # Affine rows of one frame that the linear program can keep are not infeasible, whatever IPOPT says.
    found_only_by_ipopt = not (run.split.nonlinear or problem.coupled_terms)
    failed = [k for k, s in enumerate(status) if not s.is_solved and k not in reached]
    for k in failed:
        proven = infeasible_rows(program, run.split.affine, k)
        if proven:
            status[k] = Status.INFEASIBLE
        elif found_only_by_ipopt and status[k] is Status.INFEASIBLE:
            status[k] = Status.NUMERICAL_ERROR
        if proven or np.isfinite(unknowns[k]).all():
            shortfalls = shortfalls + (proven or worst_rows(program, rows, [k]))
    scales = {block.term: block.scale for block in program.row_blocks}
    shortfalls = sorted(shortfalls, key=lambda s: -s.amount / scales[s.constraint])
    solved: BoolArray = np.array([s.is_solved for s in status])
    forces = evaluate(program.tendon_force, program.tendon_force.function(), run.unknowns, program.arrays)[0]
    missing: BoolArray = np.asarray(np.isnan(unknowns).any(axis=1))
    forces[missing] = np.nan
    quantities = {
        name: _masked(evaluate(piece, piece.function(), run.unknowns, program.arrays)[0], missing)
        for name, piece in program.quantities.items()
    }
    parts = program.layout.split(unknowns)
    activation = parts.pop((PROBLEM, "activation"))
    control = parts.pop((PROBLEM, "control"))
    for name, row in rows.items():
        rows[name] = replace(row, value=np.where(missing[:, None], np.nan, row.value))
    return Solution(
        problem=problem,
        frame_status=tuple(status),
        activation=activation,
        control=control,
        tendon_force=forces,
        actuator_force=control * problem.actuators.optimal_force,
        variables={f"{owner}.{name}": values for (owner, name), values in parts.items()},
        quantities=quantities,
        rows=rows,
        objective_terms=_objective_terms(program, run.unknowns, solved),
        violation=violations(program, finite, rows, solved),
        shortfalls=tuple(shortfalls),
        report=SolveReport(
            solver=solver,
            iterations=run.iterations,
            build_seconds=run.build_seconds,
            solve_seconds=run.solve_seconds,
            options=asdict(run.options),
            versions=versions(),
        ),
    )


def _masked(values: FloatArray, missing: BoolArray) -> FloatArray:
    values[missing] = np.nan
    return values


def _objective_terms(program: FrameProgram, unknowns: FloatArray, solved: BoolArray) -> dict[str, float]:
    """Weighted value of each objective over the solved frames (both frames of a pair)."""
    result = {}
    for name, piece in program.objectives:
        values = evaluate(piece, piece.function(), unknowns, program.arrays)[0][:, 0]
        keep = solved[:-1] & solved[1:] if piece.is_pair else solved
        result[name] = float(values[keep].sum())
    return result


def versions() -> dict[str, str]:
    """Versions of this package and of what it stands on."""
    names = ("scso_nlp", "casadi", "numpy", "scipy", "opensim")
    found = {"python": platform.python_version()}
    for name in names:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found
