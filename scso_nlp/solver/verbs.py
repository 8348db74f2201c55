"""The two verbs: solve the frames of a motion together, or frame by frame."""

from __future__ import annotations

import logging
import time
from dataclasses import asdict, replace

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import CouplingError, ProblemError
from scso_nlp.messages import STAGES
from scso_nlp.objectives.objective import FrameObjective
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.progress import stages_shown
from scso_nlp.solution import Solution, SolveFailed, SolveReport, Status
from scso_nlp.solver.advice import next_steps
from scso_nlp.solver.baseline import start_of_baseline
from scso_nlp.solver.described import keep
from scso_nlp.solver.ipopt import SolverOptions
from scso_nlp.solver.judge import Outcome, judge
from scso_nlp.solver.local_model import local_model
from scso_nlp.solver.presolve import can_presolve
from scso_nlp.solver.programs import Effort, solve_rows, starting_point
from scso_nlp.solver.redundant import without_redundant_rows
from scso_nlp.solver.refine import Turns, foreseen_turns, more_turns, still_known
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import FrameProgram, describe
from scso_nlp.transcription.turns import matrix_models, with_turns
from scso_nlp.validation import FloatArray
from scso_nlp.versions import versions

_LOG = logging.getLogger("scso_nlp")

#: Most rounds of adding rows for matrix inequalities.
_MAX_ROUNDS = 100

#: Least tolerance where rows are added: eigenvalues near zero react strongly to small errors.
_TOLERANCE_OF_ADDED_ROWS = 1e-10


@checked
def solve_trajectory(
    problem: MuscleForceProblem,
    *,
    initial_guess: Solution | None = None,
    baseline: Solution | None = None,
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
    baseline : Solution, optional
        Of the same motion with fewer constraints: frames in which its optimum keeps all rows are not solved
        again, the others start there. It counts where no term couples frames and all rows are affine.
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

    Examples
    --------
    >>> scso.solve_trajectory(problem).activation[1].round(6)
    array([0.347652, 0.143856, 0.047952])
    """
    return _solve(problem, "trajectory", (initial_guess, baseline), options or SolverOptions(), on_failure)


@checked
def solve_framewise(
    problem: MuscleForceProblem,
    *,
    initial_guess: Solution | None = None,
    baseline: Solution | None = None,
    options: SolverOptions | None = None,
    on_failure: str = "raise",
) -> Solution:
    """Solve frame by frame: the same program built for one frame and fed with each frame's numbers.

    Parameters
    ----------
    problem : MuscleForceProblem
        Without terms that couple frames; see :meth:`MuscleForceProblem.without_coupling`.
    initial_guess, baseline, options, on_failure
        As for :func:`solve_trajectory`.

    Returns
    -------
    Solution

    Raises
    ------
    CouplingError
        A term couples frames.
    SolveFailed, ProblemError
        As for :func:`solve_trajectory`.

    Examples
    --------
    >>> scso.solve_framewise(problem).activation[1].round(6)
    array([0.347652, 0.143856, 0.047952])
    """
    if problem.coupled_terms:
        raise CouplingError(
            f"{', '.join(problem.coupled_terms)} couples frames, so the problem cannot be solved "
            "frame by frame; use solve_trajectory, or problem.without_coupling()"
        )
    return _solve(problem, "framewise", (initial_guess, baseline), options or SolverOptions(), on_failure)


def _solve(
    problem: MuscleForceProblem,
    solver: str,
    given: tuple[Solution | None, Solution | None],
    options: SolverOptions,
    on_failure: str,
) -> Solution:
    if on_failure not in ("raise", "return"):
        raise ProblemError(f"on_failure is {on_failure!r}, expected 'raise' or 'return'")
    for term in (problem.muscle_model, *problem.constraints):
        for note in term.notes(problem.motion):
            _LOG.info("%s: %s", problem.motion.name, note)
    rows = "with" if problem.stability_terms else "without"
    STAGES.info("solving %d frames %s stability rows", problem.motion.n_frames, rows)
    started = time.perf_counter()
    program = without_redundant_rows(describe(problem))
    if program.matrices:
        options = replace(options, tolerance=min(options.tolerance, _TOLERANCE_OF_ADDED_ROWS))
    effort = Effort(build_seconds=time.perf_counter() - started)
    with one_thread(), stages_shown():
        outcome, rounds = _solve_rounds(program, solver == "trajectory", given, options, effort)
    report = SolveReport(
        solver=solver,
        iterations=effort.iterations,
        build_seconds=effort.build_seconds,
        solve_seconds=effort.solve_seconds,
        options=asdict(options),
        versions=versions(),
        rounds=rounds,
        kept_frames=effort.kept_frames,
    )
    with one_thread():
        solution = judge(outcome, report)
    keep(solution, program)
    _LOG.info(
        "%s (%s): %s; %d rounds, %d iterations, build %.2f s, solve %.2f s",
        problem.motion.name,
        solver,
        solution.summary(),
        report.rounds,
        report.iterations,
        report.build_seconds,
        report.solve_seconds,
    )
    if kept := report.kept(problem.motion.n_frames):
        _LOG.info("%s: %s", problem.motion.name, kept)
    if on_failure == "raise" and not solution.is_solved.all():
        raise SolveFailed(solution, [f"try {step}" for step in next_steps(solution)])
    return solution


def _solve_rounds(
    program: FrameProgram,
    together: bool,
    given: tuple[Solution | None, Solution | None],
    options: SolverOptions,
    effort: Effort,
) -> tuple[Outcome, int]:
    """Solve, and solve again while matrix inequalities need more rows."""
    started = time.perf_counter()
    guess, baseline = given
    start = starting_point(program, guess)
    model, turns, known = None, Turns(), None
    is_begun = baseline is not None and can_presolve(program)
    if baseline is not None and is_begun:
        starting_point(program, baseline)  # refuses that of another motion
        known, is_solved = start_of_baseline(program, baseline)
        start = np.where(is_solved[:, None], known.unknowns, start)
    if program.matrices:
        model = local_model(program)
        turns, known = foreseen_turns(model, start, known)
    effort.build_seconds += time.perf_counter() - started
    is_open = known is None or not known.is_optimal.all()
    if guess is None and not is_begun and is_open:
        problem = program.problem
        start = _gentle_start(problem, start, turns, together=together, options=options, effort=effort)
    for rounds in range(1, _MAX_ROUNDS + 1):
        started = time.perf_counter()
        rows = program if model is None else with_turns(program, model.matrices, turns.turns)
        effort.build_seconds += time.perf_counter() - started
        outcome = solve_rows(
            rows,
            start,
            together=together,
            doubtful=turns.doubtful,
            options=options,
            effort=effort,
            known=known,
        )
        if is_begun and rounds == 1:
            effort.kept_frames = effort.taken_over
        if model is None:
            return outcome, rounds
        started = time.perf_counter()
        usable = np.array([status.is_solved for status in outcome.status])
        start = np.where(np.isfinite(outcome.unknowns), outcome.unknowns, starting_point(program, None))
        tighter = more_turns(model, turns, start, usable)
        effort.build_seconds += time.perf_counter() - started
        if tighter is None:
            return outcome, rounds
        known, turns = still_known(turns, tighter, rows, outcome), tighter
    _LOG.warning("rows were still being added after %d rounds", _MAX_ROUNDS)
    return replace(outcome, status=(Status.ITERATION_LIMIT,) * len(outcome.status)), rounds


def _gentle_start(
    problem: MuscleForceProblem,
    start: FloatArray,
    turns: Turns,
    *,
    together: bool,
    options: SolverOptions,
    effort: Effort,
) -> FloatArray:
    """Give the answer with gentler objectives as a start, if an objective asks for it."""
    gentler = _gentler(problem)
    if gentler is None:
        return start
    start = _gentle_start(gentler, start, turns, together=together, options=options, effort=effort)
    started = time.perf_counter()
    program = without_redundant_rows(describe(gentler))
    rows = with_turns(program, matrix_models(program), turns.turns) if turns.turns else program
    effort.build_seconds += time.perf_counter() - started
    outcome = solve_rows(
        rows, start, together=together, doubtful=turns.doubtful, options=options, effort=effort
    )
    return np.where(np.isfinite(outcome.unknowns), outcome.unknowns, start)


def _gentler(problem: MuscleForceProblem) -> MuscleForceProblem | None:
    """Return the same problem with gentler objectives, or None where no objective asks for it."""
    terms = [term.gentler() if isinstance(term, FrameObjective) else None for term in problem.objectives]
    if not any(terms):
        return None
    changed = tuple(new or old for new, old in zip(terms, problem.objectives, strict=True))
    return replace(problem, objectives=changed)
