"""One stride of walking with 80 muscles and EMG of ten of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from problems.fetch import WALKING3D, fetch
from problems.motions import stable_problem
from scso_nlp import JointStability, MuscleForceProblem
from scso_nlp.constraints.stability_constraint import StabilityConstraint

#: Joints with stability rows: the right leg, over which the EMG was recorded.
JOINTS = ("walker_knee_r", "ankle_r")
#: First and last frame [s]: where the ground reaction of all steps is recorded.
INITIAL_TIME, FINAL_TIME = 0.48, 1.61
#: Price of missing stability [objective per N·m/rad]. With hard rows more than half of the frames have no
#: answer at q = 5: at the knee, level 0 is beyond reach at full activation of all muscles.
SOFT = 1.0
#: Muscle groups and EMG channels.
EMG_MAP = Path(__file__).parent / "emg_map.toml"
_RESERVES = Path(__file__).parent / "reserves.xml"


def make_problem(
    q: float = 5.0, step_interval: int = 10, *, prepare_for: Sequence[StabilityConstraint] = ()
) -> MuscleForceProblem:
    """Describe the stride with soft stability rows about all axes of the right knee and ankle.

    Parameters
    ----------
    q : float [-]
        Stiffness gain of all muscles.
    step_interval : int
        Take every n-th frame of the recording (1000 per second).
    prepare_for : sequence of StabilityConstraint
        Extract what these need, too.

    Returns
    -------
    MuscleForceProblem
        Without stability rows: ``make_problem().without_stability()``.

    Raises
    ------
    DataError
        The data cannot be fetched.
    """
    folder = fetch(WALKING3D)
    return stable_problem(
        JointStability(q=q, joints=JOINTS, axes=("x", "y", "z"), soft=SOFT),
        prepare_for=prepare_for,
        model=folder / "subject_walk_scaled.osim",
        coordinates=folder / "coordinates.sto",
        external_loads=folder / "grf_walk.xml",
        actuators=(_RESERVES,),
        initial_time=INITIAL_TIME,
        final_time=FINAL_TIME,
        step_interval=step_interval,
        keep_coupled_speeds=False,  # the motion's patella columns are in degrees, see SOURCE.md
        name="walking_3d",
    )


def emg_file() -> Path:
    """Find the EMG: envelopes, each divided by its own peak, so that only shapes can be compared.

    Returns
    -------
    Path
    """
    return fetch(WALKING3D) / "electromyography.sto"
