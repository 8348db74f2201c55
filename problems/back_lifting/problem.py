"""Stoop lifts of 5 and 15 kg with an anatomical lumbar spine: 166 muscles, six levels of three rotations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from problems.fetch import BACK_LIFTING, fetch
from problems.motions import folder_of, stable_problem
from scso_nlp import (
    ActuatorParameters,
    JointStability,
    Motion,
    MotionTrajectory,
    MuscleForceProblem,
)
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import DataError
from scso_nlp.io.storage import read_storage
from scso_nlp.validation import positions

#: Trials of the data set that are used.
TRIALS = ("stoop5kg", "stoop15kg")
#: Intervertebral joints, from the sacrum up.
JOINTS = (
    "L5_S1_IVDjnt",
    "L4_L5_IVDjnt",
    "L3_L4_IVDjnt",
    "L2_L3_IVD_jnt",
    "L1_L2_IVD_jnt",
    "L1_T12_IVD_jnt",
)
#: Their coordinates: what the muscles must balance.
COORDINATES = tuple(
    f"{level}_{rotation}"
    for level in ("L5_S1", "L4_L5", "L3_L4", "L2_L3", "L1_L2", "L1_T12")
    for rotation in ("Flex_Ext", "Lat_Bending", "axial_rotation")
)
#: Moment of each reserve at a control of one [N·m]. Deep in the lift the muscles alone cannot produce the
#: recorded moments (short by up to 17 N·m at single levels). 1 N·m of reserve costs as much as a muscle at
#: full activation.
RESERVE = 1.0
#: Passive rotational stiffness of one lumbar level by rotation [N·m/deg]: Schmidt et al. (1998), with that of
#: flexion, which is less than that of extension (2.6).
PASSIVE_STIFFNESS = {"Flex_Ext": 1.8, "Lat_Bending": 2.3, "axial_rotation": 8.4}
#: Joint axis about which each rotation turns, as rows are called.
AXES = {"Flex_Ext": "z", "Lat_Bending": "x", "axial_rotation": "y"}
#: Muscle groups and EMG channels.
EMG_MAP = Path(__file__).parent / "emg_map.toml"


def make_problem(
    trial: str = "stoop15kg",
    q: float = 5.0,
    step_interval: int = 1,
    *,
    prepare_for: Sequence[StabilityConstraint] = (),
) -> MuscleForceProblem:
    """Describe one lift with stability rows about all axes of the six lumbar joints.

    Parameters
    ----------
    trial : str
        One of `TRIALS`.
    q : float [-]
        Stiffness gain of all muscles.
    step_interval, prepare_for
        As for :func:`problems.walking_3d.problem.make_problem`; 15 per second are recorded.

    Returns
    -------
    MuscleForceProblem
        Without stability rows: ``make_problem().without_stability()``.

    Raises
    ------
    NameMismatchError, DataError
        As for :func:`problems.motions.folder_of`.
    """
    folder = folder_of(trial, TRIALS, BACK_LIFTING)
    moments = read_storage(folder / trial / "id.sto")
    problem = stable_problem(
        JointStability(q=q, joints=JOINTS, axes=("x", "y", "z")),
        prepare_for=prepare_for,
        model=folder / "lumbarModel_scaled.osim",
        coordinates=folder / trial / "ik.sto",
        in_degrees=False,
        final_time=float(moments.time[-1]),
        step_interval=step_interval,
        name=trial,
    )
    trajectory = problem.motion.trajectory
    rows = np.searchsorted(moments.time, trajectory.time - 1e-3)
    if np.abs(moments.time[rows] - trajectory.time).max() > 1e-3:
        raise DataError(f"inverse dynamics of {trial} are not at the times of its inverse kinematics")
    if problem.motion.actuators.actuators:
        raise DataError(f"the model of {trial} has actuators of its own, expected muscles only")
    trajectory = _with_reserves(_keep_coordinates(trajectory, moments.columns(COORDINATES)[rows]))
    n = len(COORDINATES)
    actuators = ActuatorParameters(
        actuators=trajectory.actuators,
        optimal_force=np.full(n, RESERVE),
        min_control=np.full(n, -np.inf),
        max_control=np.full(n, np.inf),
    )
    motion = Motion(trajectory=trajectory, muscles=problem.motion.muscles, actuators=actuators)
    return replace(problem, motion=motion)


def passive_stiffness() -> tuple[dict[str, float], dict[str, float]]:
    """Give the passive stiffness of every level.

    Returns
    -------
    by_row : dict of str to float [N·m/rad]
        For :class:`scso_nlp.JointStability`.
    by_coordinate : dict of str to float [N·m/rad]
        For :class:`scso_nlp.HessianStability`.
    """
    # per degree to per radian
    values = {rotation: float(np.rad2deg(value)) for rotation, value in PASSIVE_STIFFNESS.items()}
    by_row = {f"{joint}_{AXES[r]}": value for joint in JOINTS for r, value in values.items()}
    by_coordinate = {
        coordinate: next(value for r, value in values.items() if coordinate.endswith(r))
        for coordinate in COORDINATES
    }
    return by_row, by_coordinate


def emg_file(trial: str = "stoop15kg") -> Path:
    """Find the EMG of a trial: envelope as a fraction of maximum voluntary contraction.

    Parameters
    ----------
    trial : str
        One of `TRIALS`.

    Returns
    -------
    Path
    """
    return fetch(BACK_LIFTING) / trial / "emgFilt.sto"


def _with_reserves(trajectory: MotionTrajectory) -> MotionTrajectory:
    """Add one reserve per coordinate."""
    names = tuple(f"{coordinate}_reserve" for coordinate in trajectory.coordinates)
    unit = np.eye(len(names)) * RESERVE
    columns = trajectory.force_columns
    return replace(
        trajectory,
        actuators=names,
        actuator_generalized_forces=np.broadcast_to(unit, (trajectory.n_frames, *unit.shape)),
        force_columns=(*columns, *names) if columns else (),
    )


def _keep_coordinates(trajectory: MotionTrajectory, generalized_forces: np.ndarray) -> MotionTrajectory:
    """Keep the lumbar coordinates, with the recorded moments."""
    keep = positions("coordinate", COORDINATES, trajectory.coordinates)
    return replace(
        trajectory,
        coordinates=COORDINATES,
        is_rotational=trajectory.is_rotational[keep],
        coordinate_values=trajectory.coordinate_values[:, keep],
        coordinate_speeds=trajectory.coordinate_speeds[:, keep],
        moment_arms=trajectory.moment_arms[:, keep],
        actuator_generalized_forces=trajectory.actuator_generalized_forces[:, keep],
        generalized_forces=generalized_forces,
        passive_generalized_forces=trajectory.passive_generalized_forces[:, keep],
    )
