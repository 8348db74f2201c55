"""Simulation 1 of the paper on the reconstructed spine: eight postures, straight and twisted."""

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

#: Names of the frames: flexion, and S for straight or L for ten degrees of twist to the left.
TASKS = ("0° S", "15° S", "30° S", "45° S", "0° L", "15° L", "30° L", "45° L")


def make_problem(q: float = 5.0, level: float = 0.0) -> MuscleForceProblem:
    """Describe the postures with stability rows about all axes of both joints.

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
    motion = load_motion(example_folder("spine-postures") / "setup.xml", cache=motion_cache())
    return stability_constrained_static_optimization(
        motion,
        muscle_model=NoPhysiology(),
        stability=JointStability(q=q, level=level),
    )
