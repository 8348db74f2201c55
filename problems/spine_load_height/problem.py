"""Simulation 2 of the paper on the reconstructed spine: a load held at five heights."""

from __future__ import annotations

from problems.fetch import motion_cache
from scso_nlp import (
    JointStability,
    MuscleForceProblem,
    NoPhysiology,
    stability_constrained_static_optimization,
)
from scso_nlp.examples import example_folder
from scso_nlp.opensim.engine import load_motion

#: Names of the frames: height of the load above the lower joint, and its mass.
TASKS = tuple(f"{height:g} m, {mass:g} kg" for mass in (4.5, 9.0) for height in (0.0, 0.2, 0.4, 0.6, 0.8))


def make_problem(q: float = 5.0, level: float = 0.0) -> MuscleForceProblem:
    """Describe the tasks with stability rows about all axes of both joints.

    Parameters
    ----------
    q : float [-]
        Stiffness gain of all muscles; the paper uses 5 and 3.
    level : float [N·m/rad]
        Least stability.

    Returns
    -------
    MuscleForceProblem
        Without stability rows: ``make_problem().without_stability()``.
    """
    motion = load_motion(example_folder("spine-load-height") / "setup.xml", cache=motion_cache())
    return stability_constrained_static_optimization(
        motion,
        muscle_model=NoPhysiology(),
        stability=JointStability(q=q, level=level),
    )
