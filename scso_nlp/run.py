"""From settings to a solution and its files: what the command line does, for notebooks and scripts too."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from scso_nlp.arguments import checked
from scso_nlp.constraints.coordinate_stability import CoordinateStability
from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.declared_settings import MUSCLE_MODELS, SOLVERS
from scso_nlp.methods import static_optimization
from scso_nlp.motion import Motion
from scso_nlp.objectives.activation_effort import ActivationEffort
from scso_nlp.opensim.engine import load_with_hashes
from scso_nlp.opensim.model_names import model_names
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.report.record import RunRecord
from scso_nlp.report.results import write_solution
from scso_nlp.settings import OutputSettings, RunSettings, record
from scso_nlp.solution import Solution


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
def run(settings: RunSettings, output: OutputSettings | None = None) -> RunResult:
    """Extract the motion, solve it, and solve it without stability rows for comparison.

    Parameters
    ----------
    settings : RunSettings
    output : OutputSettings, optional
        `processes` and `cache` matter here; the rest is for the record.

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
    started = time.perf_counter()
    motion, inputs = _extract(settings, output)
    seconds = {"extraction": time.perf_counter() - started}
    problem = describe(settings, motion)
    solve = functools.partial(SOLVERS[settings.solver].thing, options=settings.options, on_failure="return")
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
    )
    return RunResult(settings=settings, solution=solution, baseline=baseline, record=facts)


def check_names(settings: RunSettings) -> None:
    """Hold the names of muscles, joints and coordinates against the model's files, before OpenSim starts.

    Parameters
    ----------
    settings : RunSettings

    Raises
    ------
    NameMismatchError
        A name or pattern that fits none; the closest are suggested.
    DataError
        A file that cannot be read.
    """
    names = model_names(settings.motion)
    if isinstance(settings.weights, Mapping):
        names.require("muscle or actuator", settings.weights, names.forces)
    stability = settings.stability
    if stability is None:
        return
    if isinstance(stability.q, Mapping):
        names.require("muscle", stability.q, names.muscles)
    if isinstance(stability, JointStability):
        names.require("joint", stability.joints or (), names.joints)
        joints = stability.joints or names.joints
        rows = tuple(f"{joint}_{axis}" for joint in joints for axis in stability.axes)
    else:
        chosen = getattr(stability, "coordinates", None)
        names.require("coordinate", chosen or (), names.coordinates)
        rows = chosen or names.coordinates
    for values in (stability.level, stability.passive_stiffness):
        names.require("stability row", values if isinstance(values, Mapping) else (), rows)


@checked
def extract(settings: RunSettings, output: OutputSettings | None = None) -> Motion:
    """Extract the motion with the derivatives that the stability rows need.

    Parameters
    ----------
    settings : RunSettings
    output : OutputSettings, optional
        Only `processes` and `cache` matter here.

    Returns
    -------
    Motion
    """
    return _extract(settings, output or OutputSettings())[0]


def _extract(settings: RunSettings, output: OutputSettings) -> tuple[Motion, dict[str, str]]:
    """Extract the motion; give the hashes of what was read, too."""
    check_names(settings)
    stability, motion = settings.stability, settings.motion
    if isinstance(stability, CoordinateStability | HessianStability):
        chosen = ("all",) if stability.coordinates is None else tuple(stability.coordinates)
        motion = replace(motion, curvature_coordinates=chosen)
    if not isinstance(stability, JointStability):
        motion = replace(motion, muscle_paths=False)
    elif stability.moving_paths != "frozen":
        joints = ("all",) if stability.joints is None else stability.joints
        axes = tuple((joint, axis) for joint in joints for axis in stability.axes)
        motion = replace(motion, stability_axes=axes)
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
    model = MUSCLE_MODELS[settings.muscle_model].make()
    problem = static_optimization(motion, muscle_model=model, exponent=settings.exponent)
    if settings.weights is not None:
        effort = ActivationEffort(exponent=settings.exponent, weights=settings.weights)
        problem = replace(problem, objectives=(effort,))
    if settings.stability is not None:
        problem = replace(problem, constraints=(*problem.constraints, settings.stability))
    return problem


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
