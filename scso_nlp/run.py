"""From settings to a solution and its files: what the command line does, for notebooks and scripts too."""

from __future__ import annotations

import functools
import hashlib
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scso_nlp.constraints import CoordinateStability, HessianStability, JointStability
from scso_nlp.io.results import RunRecord, write_solution
from scso_nlp.muscle_models import CompliantTendon, MuscleModel, NoPhysiology, RigidTendon
from scso_nlp.objectives import ActivationEffort
from scso_nlp.opensim.assemble import Motion
from scso_nlp.opensim.engine import input_hashes, load_motion
from scso_nlp.problem import MuscleForceProblem, static_optimization
from scso_nlp.settings import OutputSettings, RunSettings
from scso_nlp.solution import Solution
from scso_nlp.solve import solve_framewise, solve_trajectory


@dataclass(frozen=True, kw_only=True)
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


def run(settings: RunSettings, output: OutputSettings | None = None) -> RunResult:
    """Extract the motion, solve it, and solve it without stability rows for comparison.

    Parameters
    ----------
    settings : RunSettings
    output : OutputSettings, optional
        Only `processes` and `cache` matter here.

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
    motion = _load(settings, output)
    seconds = {"extraction": time.perf_counter() - started}
    problem = describe(settings, motion)
    solve = solve_framewise if settings.solver == "framewise" else solve_trajectory
    baseline = None
    if settings.stability is not None:
        plain = problem.without_stability()
        baseline = solve(plain, options=settings.options, on_failure="return")
        seconds["baseline"] = baseline.report.build_seconds + baseline.report.solve_seconds
    solution = solve(problem, options=settings.options, on_failure="return")
    record = RunRecord(
        inputs={**_hashes(settings.sources), **input_hashes(settings.motion)},
        settings={
            "motion": vars(settings.motion),
            "exponent": settings.exponent,
            "weights": settings.weights,
            "muscle_physiology": settings.muscle_physiology,
            "muscle_model": settings.muscle_model,
            "stability": None if settings.stability is None else vars(settings.stability),
            "solver": settings.solver,
        },
        seconds=seconds,
        notes=_notes(problem, settings),
    )
    return RunResult(settings=settings, solution=solution, baseline=baseline, record=record)


def describe(settings: RunSettings, motion: Motion) -> MuscleForceProblem:
    """Turn settings and an extracted motion into the problem.

    Parameters
    ----------
    settings : RunSettings
    motion : tuple of MotionTrajectory, MuscleParameters, ActuatorParameters

    Returns
    -------
    MuscleForceProblem
    """
    models: dict[str, MuscleModel] = {
        "opensim-rigid": RigidTendon(),
        "physical-rigid": RigidTendon(convention="physical"),
        "compliant": CompliantTendon(),
        "none": NoPhysiology(),
    }
    problem = static_optimization(
        *motion, muscle_model=models[settings.muscle_model], exponent=settings.exponent
    )
    if settings.weights is not None:
        effort = ActivationEffort(exponent=settings.exponent, weights=settings.weights)
        problem = replace(problem, objectives=(effort,))
    if settings.stability is not None:
        problem = replace(problem, constraints=(*problem.constraints, settings.stability))
    return problem


def write_run(result: RunResult, output: OutputSettings | None = None) -> tuple[Path, ...]:
    """Write all files of a run, whole or not at all.

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
    folder = output.folder or Path("scso_results") / result.solution.problem.trajectory.name
    return write_solution(
        result.solution,
        folder,
        analysis_name=result.settings.analysis_name,
        record=result.record,
        keep_failed=output.keep_failed,
        baseline=result.baseline,
        figures=output.figures,
    )


def _load(settings: RunSettings, output: OutputSettings) -> Motion:
    """Extract the motion with the derivatives that the stability rows need."""
    stability, motion = settings.stability, settings.motion
    load = functools.partial(load_motion, motion, processes=output.processes, cache=output.cache)
    if isinstance(stability, CoordinateStability | HessianStability):
        chosen = "all" if stability.coordinates is None else tuple(stability.coordinates)
        return load(curvature_coordinates=chosen)
    if not isinstance(stability, JointStability) or stability.moving_paths == "frozen":
        return load()
    joints = stability.joints
    if joints is None:
        # the names of the joints, from the first and last frame
        skeleton = load(step_interval=sys.maxsize)[0].skeleton
        joints = skeleton.joints if skeleton is not None else ()
    return load(stability_axes=tuple((joint, axis) for joint in joints for axis in stability.axes))


def _hashes(paths: tuple[Path, ...]) -> dict[str, str]:
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def _notes(problem: MuscleForceProblem, settings: RunSettings) -> tuple[str, ...]:
    if settings.stability is None:
        return ()
    one_frame = problem.frames(0, 1)
    notes = settings.stability.stability_rows(one_frame).notes
    curvature = problem.trajectory.curvature
    if curvature is None:
        return notes
    frames = curvature.is_uncertain.any(axis=1)
    if frames.any():
        muscles = np.flatnonzero(curvature.is_uncertain.any(axis=0))
        names = ", ".join(problem.trajectory.muscles[m] for m in muscles)
        notes += (f"path curvature is uncertain in {frames.sum()} frames, where paths change: {names}",)
    return (f"stability over the coordinates {', '.join(curvature.coordinates)}", *notes)
