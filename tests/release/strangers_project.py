"""A project that uses the package by its types alone: two type checkers read it, nothing runs it."""

from pathlib import Path
from typing import assert_type

import numpy as np

import scso_nlp as scso


def activations(setup: Path) -> dict[str, float]:
    """Greatest activation of every muscle of a motion."""
    motion = scso.load_motion(setup)
    assert_type(motion, scso.Motion)
    problem = scso.MuscleForceProblem(
        motion=motion,
        muscle_model=scso.RigidTendon(),
        objectives=(scso.ActivationEffort(exponent=3.0),),
        constraints=(scso.MomentEquilibrium(), scso.JointStability(q=5.0)),
    )
    solution = scso.solve_trajectory(problem, options=scso.SolverOptions(presolve=False))
    assert_type(solution, scso.Solution)
    greatest = np.max(solution.activation, axis=0)
    return dict(zip(motion.muscles.muscles, greatest.tolist(), strict=True))


def refused(motion: scso.Motion) -> scso.MuscleForceProblem:
    """A misspelled word is an error to a type checker."""
    return scso.MuscleForceProblem(
        motion=motion,
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponnet=3.0),),  # type: ignore[call-arg] # pyright: ignore[reportCallIssue]
        constraints=(scso.MomentEquilibrium(),),
    )
