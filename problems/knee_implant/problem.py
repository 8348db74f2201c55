"""Walking with an instrumented knee: what the left knee carries, beside what was measured."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from problems.fetch import KNEE_IMPLANT
from problems.motions import folder_of, stable_problem
from problems.opensim_files import with_data
from scso_nlp import CoordinateStability, MuscleForceProblem, Solution
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.validation import FloatArray

#: Trials of the data set that are used.
TRIALS = ("GC5_ss1", "GC5_ss3", "GC5_ss8")
#: The joint that was replaced.
KNEE = "walker_knee_l"
#: Coordinates with stability rows: of the leg whose ground reaction is applied.
COORDINATES = ("knee_angle_l", "ankle_angle_l")
#: Price of missing stability [objective per N·m/rad]; with q = 40 nothing is missed.
SOFT = 1.0
#: Low-pass filter of the coordinates [Hz], that of the data's own scripts.
CUTOFF = 6.0


def make_problem(
    trial: str = "GC5_ss1",
    q: float = 40.0,
    step_interval: int = 1,
    *,
    prepare_for: Sequence[StabilityConstraint] = (),
) -> MuscleForceProblem:
    """Describe one gait cycle of the left leg with soft stability along knee and ankle.

    Parameters
    ----------
    trial : str
        One of `TRIALS`.
    q : float [-]
        Stiffness gain of all muscles.
    step_interval, prepare_for
        As for :func:`problems.walking_3d.problem.make_problem`; 120 per second are recorded.

    Returns
    -------
    MuscleForceProblem
        Without stability rows: ``make_problem().without_stability()``.

    Raises
    ------
    NameMismatchError, DataError
        As for :func:`problems.motions.folder_of`.
    """
    folder = folder_of(trial, TRIALS, KNEE_IMPLANT)
    with tempfile.TemporaryDirectory() as scratch:
        loads = Path(scratch) / "loads.xml"
        # the data's own names a file that is not there
        text = with_data(folder / "ExternalLoads.xml", folder / f"{trial}_kinetics.mot")
        loads.write_text(text, encoding="utf-8")
        return stable_problem(
            CoordinateStability(q=q, coordinates=COORDINATES, soft=SOFT),
            prepare_for=prepare_for,
            model=folder / "Rajagopal2015-scaled.osim",
            coordinates=folder / f"{trial}.mot",
            external_loads=loads,
            actuators=(folder / "ForceSet.xml",),
            lowpass_cutoff_frequency=CUTOFF,
            step_interval=step_interval,
            keep_coupled_speeds=False,  # the motion's patella columns are in degrees, see SOURCE.md
            joint_reactions=(KNEE,),
            name=trial,
        )


def contact_force(solution: Solution) -> FloatArray:
    """Give the length of the force between femur and tibia, at every per cent of the cycle.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    ndarray, shape (101,) [N]
        NaN beside frames that are not solved.
    """
    time = solution.problem.motion.trajectory.time
    force = np.where(solution.is_solved, solution.joint_reactions([KNEE]).resultant[:, 0], np.nan)
    return np.interp(np.linspace(time[0], time[-1], 101), time, force)


def measured_force(trial: str = "GC5_ss1") -> FloatArray:
    """Give the length of the force that the implant measured, at every per cent of the cycle.

    Parameters
    ----------
    trial : str
        One of `TRIALS`.

    Returns
    -------
    ndarray, shape (101,) [N]

    Raises
    ------
    NameMismatchError, DataError
        As for :func:`problems.motions.folder_of`.
    """
    content = loadmat(folder_of(trial, TRIALS, KNEE_IMPLANT) / "eTibia_data.mat", simplify_cells=True)
    recorded = content["eTibia_data"]["GC5"]["ngait_og"]
    columns = [str(name) for name in recorded["colheaders"]]
    names = [str(name) for name in recorded["trial_names"]]
    (position,) = (i for i, name in enumerate(names) if f"_{trial.removeprefix('GC5_')}." in name)
    return np.array(recorded["data"][:, columns.index("F_total_magnitude"), position], dtype=float)
