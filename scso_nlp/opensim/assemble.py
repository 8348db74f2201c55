"""The arrays of all workers, put together to a motion, with the words that belong to it."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from scso_nlp.joint_reactions import JointReactionMap
from scso_nlp.motion import Motion
from scso_nlp.muscles import ActuatorParameters, MuscleParameters
from scso_nlp.opensim.description import joint_axes
from scso_nlp.opensim.plausible import notes_on_units
from scso_nlp.opensim.setup_xml import MotionInput
from scso_nlp.opensim.worker.exchange import Result
from scso_nlp.trajectory import CoordinateCurvature, MotionTrajectory, Skeleton

logger = logging.getLogger("scso_nlp")

#: Speeds of coupled coordinates that contradict the constraints by more are reported [rad/s or m/s].
CONTRADICTION = 0.05
#: At most this many muscles are named in one message.
NAMED_MUSCLES = 8


def assemble(motion: MotionInput, result: Result) -> Motion:
    """Turn what the workers found into frozen data, and log what they noted.

    Parameters
    ----------
    motion : MotionInput
    result : Result

    Returns
    -------
    Motion
    """
    header = result.headers[0]
    for level, note in header["log"]["notes"]:
        logger.log(logging.getLevelNamesMapping()[level], "%s", note)
    for part, own in enumerate(entry["log"] for entry in result.headers):
        logger.debug(
            "worker %d: startup %.2f s, %d frames in %.2f s, peak memory %.0f MB",
            part,
            own["startup_seconds"],
            own["frames"],
            own["frame_seconds"],
            own["peak_memory"] / 1e6,
        )
    fields: dict[str, dict[str, Any]] = {"curvature": {}, "joint_reactions": {}, **header}
    for name, array in result.arrays.items():
        group, field = name.split(".")
        fields[group][field] = array
    _report_contradictions(motion, fields["log"])
    curvature = CoordinateCurvature(**fields["curvature"]) if fields["curvature"] else None
    reactions = JointReactionMap(**fields["joint_reactions"]) if fields["joint_reactions"] else None
    muscles, actuators = MuscleParameters(**fields["muscles"]), ActuatorParameters(**fields["actuators"])
    if curvature is not None:
        _report_uncertainty(motion, muscles, curvature)
    skeleton = Skeleton(**fields["skeleton"], joint_obstacles=_obstacles(fields.get("axes")))
    trajectory = MotionTrajectory(
        name=motion.name,
        skeleton=skeleton,
        curvature=curvature,
        joint_reactions=reactions,
        **fields["trajectory"],
    )
    for note in notes_on_units(motion, trajectory, fields["log"]["size"]):
        logger.warning("%s", note)
    return Motion(trajectory=trajectory, muscles=muscles, actuators=actuators)


def _obstacles(axes: dict[str, Any] | None) -> tuple[str, ...]:
    """Say of every joint axis why muscles cannot make it stable; nothing where that is not known of all."""
    if axes is None or not axes["have_points"]:
        return ()
    return tuple(axis.obstacle for joint in joint_axes(axes) for axis in joint)


def _report_contradictions(motion: MotionInput, log: dict[str, Any]) -> None:
    worst = log["contradictions"].max(axis=0)
    large = [
        (name, change)
        for name, change in zip(log["eliminated"], worst, strict=True)
        if change > CONTRADICTION
    ]
    if not large:
        return
    taken = "OpenSim uses them and so do we; set keep_coupled_speeds=false to take them from the constraints"
    if not motion.keep_coupled_speeds:
        taken = "as asked, they were taken from the constraints, which OpenSim does not do"
    logger.warning(
        "%s: the speeds of coupled coordinates contradict the model's constraints (%s rad/s or m/s): %s",
        motion.motion,
        ", ".join(f"{name} by up to {change:.3g}" for name, change in large),
        taken,
    )


def _report_uncertainty(
    motion: MotionInput, muscles: MuscleParameters, curvature: CoordinateCurvature
) -> None:
    frames = curvature.is_uncertain.sum(axis=0)
    order = [m for m in np.argsort(-frames, kind="stable") if frames[m]]
    if not order:
        return
    named = ", ".join(f"{muscles.muscles[m]} in {frames[m]}" for m in order[:NAMED_MUSCLES])
    more = f", and {len(order) - NAMED_MUSCLES} more muscles" if len(order) > NAMED_MUSCLES else ""
    logger.warning(
        "%s: the curvature of paths is uncertain in frames where they change their points or have kinks "
        "(%s%s); these are marked in trajectory.curvature.is_uncertain",
        motion.motion,
        named,
        more,
    )
