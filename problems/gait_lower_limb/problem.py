"""Walking with 18 muscles: the smallest realistic gait problem."""

from __future__ import annotations

from problems.fetch import GAIT10DOF18MUSC, fetch
from problems.motions import stable_problem
from scso_nlp import JointStability, MuscleForceProblem

#: Joints with stability rows, about the flexion axis: what muscles of a planar model can act on.
JOINTS = ("knee_r", "ankle_r", "knee_l", "ankle_l")
#: Price of missing stability [objective per N·m/rad].
SOFT = 1.0
#: Low-pass filter of the coordinates [Hz].
CUTOFF = 6.0


def make_problem(q: float = 5.0, step_interval: int = 1) -> MuscleForceProblem:
    """Describe the walk with soft stability rows about the flexion axes of knees and ankles.

    Parameters
    ----------
    q : float [-]
        Stiffness gain of all muscles.
    step_interval : int
        Take every n-th frame of the recording.

    Returns
    -------
    MuscleForceProblem
        Without stability rows: ``make_problem().without_stability()``.

    Raises
    ------
    DataError
        The data cannot be fetched.
    """
    folder = fetch(GAIT10DOF18MUSC)
    return stable_problem(
        JointStability(q=q, joints=JOINTS, axes=("z",), soft=SOFT),
        model=folder / "gait10dof18musc_simbody.osim",
        coordinates=folder / "subject01_walk_IK.mot",
        external_loads=folder / "subject01_walk_grf.xml",
        actuators=(folder / "gait10dof18musc_Strong_actuators.xml",),
        lowpass_cutoff_frequency=CUTOFF,
        step_interval=step_interval,
        name="gait_lower_limb",
    )
