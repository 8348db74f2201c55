"""From a setup or settings to a solution and its files: one call for scripts, notebooks and commands."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint, FramePairConstraint
from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.declared_settings import MUSCLE_MODELS, SOLVERS
from scso_nlp.frame import Frame
from scso_nlp.messages import kept_warnings
from scso_nlp.methods import static_optimization
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.muscle_models.no_physiology import NoPhysiology
from scso_nlp.needs import HasNeeds
from scso_nlp.objectives.objective import FrameObjective, FramePairObjective
from scso_nlp.opensim.engine import load_motion, load_with_hashes
from scso_nlp.opensim.model_names import model_names
from scso_nlp.opensim.setup_xml import AnalyzeSetup, MotionInput, prepared_for, read_analyze_setup
from scso_nlp.problem import MuscleForceProblem, as_objective
from scso_nlp.progress import stages_shown
from scso_nlp.report.record import RunRecord
from scso_nlp.report.results import write_solution
from scso_nlp.settings import OutputSettings, RunSettings, record
from scso_nlp.solution import Solution
from scso_nlp.solver import SolverOptions
from scso_nlp.stability.rows import AXES


@dataclass(frozen=True, kw_only=True)
@checked
class RunResult:
    """A solved motion with all that its report says.

    Attributes
    ----------
    settings : RunSettings
    solution : Solution
        Failed frames carry their status; nothing is raised for them.
    baseline : Solution or None
        The same motion without stability rows; None where the run itself has none.
    record : RunRecord
    """

    settings: RunSettings
    solution: Solution
    baseline: Solution | None
    record: RunRecord

    @property
    def is_solved(self) -> bool:
        """True if every frame may be used."""
        return bool(self.solution.is_solved.all())

    @property
    def verdict_lines(self) -> tuple[str, str]:
        """What the solution is worth, beside the same motion without stability rows."""
        return self.solution.verdict.lines(self.baseline.verdict if self.baseline else None)


@checked
def solve(
    setup: str | os.PathLike[str] | AnalyzeSetup | MotionInput | Motion,
    *,
    stability: StabilityConstraint | None = None,
    muscle_model: MuscleModel | None = None,
    exponent: float | None = None,
    weights: str | Mapping[str, float] | None = None,
    passive_elements: Literal["taken_off", "left_in"] = "taken_off",
    objectives: Iterable[FrameObjective | FramePairObjective | Callable[[Frame], Any]] = (),
    constraints: Iterable[FrameConstraint | FramePairConstraint] = (),
    solver: Literal["trajectory", "framewise"] = "trajectory",
    options: SolverOptions | None = None,
    on_failure: Literal["raise", "return"] = "raise",
    processes: int | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> Solution:
    """Find muscle forces in one call: read the motion with all that the terms need, and solve it.

    Parameters
    ----------
    setup : path, AnalyzeSetup, MotionInput or Motion
        An AnalyzeTool setup file, or a description of model and motion; or a motion that was loaded with
        these terms in ``prepare_for``, see :func:`load_motion`.
    stability : StabilityConstraint, optional
        None: static optimization.
    muscle_model : MuscleModel, optional
        :class:`RigidTendon` by default, :class:`NoPhysiology` where a setup says so.
    exponent : float, optional [-]
        Power of the activations; by default the setup's, or 2.
    weights : None, "volume", "pcsa" or mapping of str to float
        Of the activations, as for :class:`ActivationEffort`.
    passive_elements : "taken_off" or "left_in"
        As for :class:`MomentEquilibrium`.
    objectives : iterable of objectives or functions of a frame
        Besides the effort of the activations.
    constraints : iterable of constraints
        Besides moment equilibrium and `stability`.
    solver : "trajectory" or "framewise"
        :func:`solve_trajectory` or :func:`solve_framewise`.
    options : SolverOptions, optional
    on_failure : "raise" or "return"
        Whether a failed frame raises or is only marked in ``Solution.frame_status``.
    processes, cache, progress
        As for :func:`load_motion`; progress is that of solving, too.

    Returns
    -------
    Solution

    Raises
    ------
    DataError, EngineError
        Input that cannot be used, or OpenSim refused it.
    NameMismatchError
        Unknown joint, axis, muscle or row.
    ProblemError
        Contradictory description or options.
    SolveFailed
        Some frame was not solved; the exception carries the solution with its last iterate.

    Examples
    --------
    >>> rows = scso.JointStability(q=20, joints=["elbow"], axes=["z"])
    >>> stable = scso.solve(example_folder("elbow") / "setup.xml", stability=rows)
    >>> stable.stability.rows
    ('elbow_z',)
    """
    if isinstance(setup, str | os.PathLike):
        setup = read_analyze_setup(setup)
    if isinstance(setup, AnalyzeSetup):
        exponent = setup.activation_exponent if exponent is None else exponent
        if muscle_model is None and not setup.use_muscle_physiology:
            muscle_model = NoPhysiology()
        setup = setup.motion
    further = tuple(map(as_objective, objectives))
    constraints = (*((stability,) if stability else ()), *constraints)
    with stages_shown(progress):
        if isinstance(setup, MotionInput):
            check_names(setup, constraints, weights)
            setup = load_motion(
                setup,
                prepare_for=(*((muscle_model,) if muscle_model else ()), *further, *constraints),
                processes=processes,
                cache=cache,
            )
        plain = static_optimization(
            setup,
            muscle_model=muscle_model,
            exponent=2.0 if exponent is None else exponent,
            weights=weights,
            passive_elements=passive_elements,
        )
        problem = replace(
            plain,
            objectives=(*plain.objectives, *further),
            constraints=(*plain.constraints, *constraints),
        )
        found: Solution = SOLVERS[solver].thing(problem, options=options, on_failure=on_failure)
    return found


@checked
def run(
    settings: RunSettings, output: OutputSettings | None = None, *, prepare_for: Iterable[HasNeeds] = ()
) -> RunResult:
    """Extract the motion, solve it, and solve it without stability rows for comparison.

    Parameters
    ----------
    settings : RunSettings
    output : OutputSettings, optional
        `processes` and `cache` matter here; the rest is for the record.
    prepare_for : terms, optional
        Of other problems about this motion: what they need is extracted too, so that one cache serves all.

    Returns
    -------
    RunResult

    Raises
    ------
    DataError, EngineError
        Input that cannot be used, or OpenSim refused it.
    NameMismatchError
        Unknown joint, axis, muscle or row.
    ProblemError
        Contradictory settings.
    """
    output = output or OutputSettings()
    with kept_warnings() as warnings:
        started = time.perf_counter()
        motion, inputs = _extract(settings, output, prepare_for)
        seconds = {"extraction": time.perf_counter() - started}
        problem = describe(settings, motion)
        solve = functools.partial(
            SOLVERS[settings.solver].thing, options=settings.options, on_failure="return"
        )
        baseline = None
        if settings.stability is not None:
            baseline = solve(problem.without_stability())
            seconds["baseline"] = baseline.report.build_seconds + baseline.report.solve_seconds
        solution = solve(problem, baseline=baseline)
    facts = RunRecord(
        inputs={**settings.sources, **inputs},
        settings=record(settings, output),
        seconds=seconds,
        notes=(*settings.notes, *(settings.stability.notes(motion) if settings.stability else ())),
        warnings=tuple(warnings),
    )
    return RunResult(settings=settings, solution=solution, baseline=baseline, record=facts)


def check_names(
    motion: MotionInput,
    constraints: Iterable[object],
    weights: str | Mapping[str, float] | None = None,
) -> None:
    """Hold the names of muscles, joints and coordinates against the model's files, before OpenSim starts.

    Parameters
    ----------
    motion : MotionInput
    constraints : iterable of terms
        The stability constraints among them have such names.
    weights : None, "volume", "pcsa" or mapping of str to float
        As for :class:`~scso_nlp.ActivationEffort`.

    Raises
    ------
    NameMismatchError
        A name or pattern that fits none; the closest are suggested.
    DataError
        A file that cannot be read.
    """
    names = model_names(motion)
    if isinstance(weights, Mapping):
        names.require("muscle or actuator", weights, names.forces)
    for stability in constraints:
        if not isinstance(stability, StabilityConstraint):
            continue
        if isinstance(stability.q, Mapping):
            names.require("muscle", stability.q, names.muscles)
        if isinstance(stability, JointStability):
            names.require("joint", stability.joints or (), names.joints)
            joints = stability.joints or names.joints
            rows = tuple(f"{joint}_{axis}" for joint in joints for axis in stability.axes or AXES)
        else:
            chosen = getattr(stability, "coordinates", None)
            names.require("coordinate", chosen or (), names.coordinates)
            rows = chosen or names.coordinates
        for values in (stability.level, stability.passive_stiffness):
            names.require("stability row", values if isinstance(values, Mapping) else (), rows)


@checked
def extract(
    settings: RunSettings, output: OutputSettings | None = None, *, prepare_for: Iterable[HasNeeds] = ()
) -> Motion:
    """Extract the motion with the derivatives that the stability rows need.

    Parameters
    ----------
    settings : RunSettings
    output : OutputSettings, optional
        Only `processes` and `cache` matter here.
    prepare_for : terms, optional
        As for :func:`run`.

    Returns
    -------
    Motion
    """
    return _extract(settings, output or OutputSettings(), prepare_for)[0]


def _extract(
    settings: RunSettings, output: OutputSettings, others: Iterable[HasNeeds]
) -> tuple[Motion, dict[str, str]]:
    """Extract the motion; give the hashes of what was read, too."""
    check_names(settings.motion, settings.constraints, settings.weights)
    motion = prepared_for(settings.motion, (*settings.terms, *others))
    return load_with_hashes(motion, processes=output.processes, cache=output.cache)


@checked
def describe(settings: RunSettings, motion: Motion) -> MuscleForceProblem:
    """Turn settings and an extracted motion into the problem.

    Parameters
    ----------
    settings : RunSettings
    motion : Motion

    Returns
    -------
    MuscleForceProblem
    """
    fibers = {} if settings.short_fibers == "refuse" else {"short_fibers": settings.short_fibers}
    plain = static_optimization(
        motion,
        muscle_model=MUSCLE_MODELS[settings.muscle_model].make(**fibers),
        exponent=settings.exponent,
        weights=settings.weights,
        passive_elements=settings.passive_elements,
    )
    return replace(
        plain,
        objectives=(*plain.objectives, *settings.objectives),
        constraints=(*plain.constraints, *settings.constraints),
    )


@checked
def write_run(result: RunResult, output: OutputSettings | None = None) -> tuple[Path, ...]:
    """Write all files of a run, whole or not at all.

    Results of other inputs stay unless ``output.overwrite``: the next free name is taken, ``results_2`` for
    ``results``. The same inputs with other settings replace what is there.

    Parameters
    ----------
    result : RunResult
    output : OutputSettings, optional

    Returns
    -------
    tuple of Path
        The files written, all in one folder.

    Raises
    ------
    DataError
        Files that cannot be written.
    """
    output = output or OutputSettings()
    return write_solution(
        result.solution,
        output.folder_for(result.solution.problem.motion.name),
        analysis_name=result.settings.analysis_name,
        record=result.record,
        keep_failed=output.keep_failed,
        baseline=result.baseline,
        figures=output.figures,
        overwrite=output.overwrite,
    )
