"""Muscle forces with mechanically stable joints, from OpenSim models and motions.

Public names are imported when first used, so that ``import scso_nlp`` is fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scso_nlp.constraints import (
        ActivationDynamics,
        ActivationRate,
        CoordinateStability,
        FrameConstraint,
        FramePairConstraint,
        HessianStability,
        JointStability,
        MomentEquilibrium,
    )
    from scso_nlp.exceptions import (
        CouplingError,
        DataError,
        EngineError,
        FileFormatError,
        NameMismatchError,
        ProblemError,
        ScsoError,
    )
    from scso_nlp.frame import Frame, MatrixRows, MuscleState, Rows, VariableSpec
    from scso_nlp.io.bundle import load_bundle, save_bundle
    from scso_nlp.methods import stability_constrained_static_optimization, static_optimization
    from scso_nlp.motion import Motion
    from scso_nlp.muscle_models import CompliantTendon, MuscleModel, NoPhysiology, RigidTendon
    from scso_nlp.muscle_models.stiffness_law import (
        FiberStiffness,
        ProportionalStiffness,
        ShortRangeStiffness,
        StiffnessLaw,
    )
    from scso_nlp.muscles import ActuatorParameters, MuscleParameters
    from scso_nlp.objectives import ActivationEffort, FrameObjective, FramePairObjective, FunctionObjective
    from scso_nlp.opensim.engine import load_motion
    from scso_nlp.problem import MuscleForceProblem
    from scso_nlp.report.results import write_solution
    from scso_nlp.solution import (
        MatrixResult,
        MomentBalance,
        Optimality,
        RowResult,
        Shortfall,
        Solution,
        SolveFailed,
        SolveReport,
        StabilityMargin,
        Status,
    )
    from scso_nlp.solve import SolverOptions, observe, solve_framewise, solve_trajectory
    from scso_nlp.stability.passive import LumbarJoint, lumbar_passive_stiffness
    from scso_nlp.trajectory import CoordinateCurvature, MotionTrajectory, Skeleton
    from scso_nlp.transcription.build import Program, build_program

#: Where each public name is defined.
_HOME = {
    "MatrixRows": "frame",
    "MatrixResult": "solution",
    "MomentBalance": "solution",
    "Motion": "motion",
    "Optimality": "solution",
    "Program": "transcription.build",
    "StabilityMargin": "solution",
    "build_program": "transcription.build",
    "observe": "solve",
    "ActivationDynamics": "constraints",
    "ActivationEffort": "objectives",
    "ActivationRate": "constraints",
    "ActuatorParameters": "muscles",
    "CompliantTendon": "muscle_models",
    "CoordinateCurvature": "trajectory",
    "CoordinateStability": "constraints",
    "CouplingError": "exceptions",
    "DataError": "exceptions",
    "EngineError": "exceptions",
    "FiberStiffness": "muscle_models.stiffness_law",
    "FileFormatError": "exceptions",
    "Frame": "frame",
    "FrameConstraint": "constraints",
    "FrameObjective": "objectives",
    "FramePairConstraint": "constraints",
    "FramePairObjective": "objectives",
    "FunctionObjective": "objectives",
    "HessianStability": "constraints",
    "JointStability": "constraints",
    "LumbarJoint": "stability.passive",
    "MomentEquilibrium": "constraints",
    "MotionTrajectory": "trajectory",
    "MuscleForceProblem": "problem",
    "MuscleModel": "muscle_models",
    "MuscleParameters": "muscles",
    "MuscleState": "frame",
    "NameMismatchError": "exceptions",
    "NoPhysiology": "muscle_models",
    "ProblemError": "exceptions",
    "ProportionalStiffness": "muscle_models.stiffness_law",
    "RigidTendon": "muscle_models",
    "RowResult": "solution",
    "Rows": "frame",
    "ScsoError": "exceptions",
    "ShortRangeStiffness": "muscle_models.stiffness_law",
    "Shortfall": "solution",
    "Skeleton": "trajectory",
    "Solution": "solution",
    "SolveFailed": "solution",
    "SolveReport": "solution",
    "SolverOptions": "solve",
    "Status": "solution",
    "StiffnessLaw": "muscle_models.stiffness_law",
    "VariableSpec": "frame",
    "load_bundle": "io.bundle",
    "load_motion": "opensim.engine",
    "lumbar_passive_stiffness": "stability.passive",
    "save_bundle": "io.bundle",
    "solve_framewise": "solve",
    "solve_trajectory": "solve",
    "stability_constrained_static_optimization": "methods",
    "static_optimization": "methods",
    "write_solution": "report.results",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return [*globals(), *_HOME]
