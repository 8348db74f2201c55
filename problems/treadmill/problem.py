"""Walking and running on a treadmill with 92 muscles and EMG of nine muscles of the right leg."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from problems.fetch import TREADMILL
from problems.motions import folder_of, stable_problem
from problems.opensim_files import ground_reactions, reserves
from scso_nlp import CoordinateStability, MuscleForceProblem
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.io.storage import read_storage
from scso_nlp.validation import FloatArray

#: Trials of the data set: walking and running.
TRIALS = ("walk36", "run81")
#: Coordinates with stability rows: of the leg over which the EMG was recorded.
COORDINATES = ("knee_angle_r", "ankle_angle_r")
#: Price of missing stability [objective per N·m/rad].
SOFT = 1.0
#: Low-pass filter of the coordinates [Hz].
CUTOFF = 6.0
#: A stride begins where the vertical force under the right foot rises through this [N].
CONTACT = 20.0
#: The strides that are used, of those that begin after a time [s].
N_STRIDES, FIRST_TIME = 5, 10.0
#: Reserves by coordinate at a control of one [N or N·m], as in walking_3d.
RESERVES = {"*": 1.0, "pelvis*": 1000.0}
#: Muscle groups and EMG channels.
EMG_MAP = Path(__file__).parent / "emg_map.toml"
#: Columns of the ground reaction by the body they act on.
_FEET = {"ground": "calcn_r", "l_ground": "calcn_l"}


def make_problem(
    trial: str = "walk36",
    q: float = 40.0,
    step_interval: int = 4,
    *,
    prepare_for: Sequence[StabilityConstraint] = (),
) -> MuscleForceProblem:
    """Describe five strides with soft stability along the right knee and ankle.

    Parameters
    ----------
    trial : str
        One of `TRIALS`.
    q : float [-]
        Stiffness gain of all muscles.
    step_interval, prepare_for
        As for :func:`problems.walking_3d.problem.make_problem`; 100 per second are recorded.

    Returns
    -------
    MuscleForceProblem
        Without stability rows: ``make_problem().without_stability()``.

    Raises
    ------
    NameMismatchError, DataError
        As for :func:`problems.motions.folder_of`.
    """
    folder, begins = folder_of(trial, TRIALS, TREADMILL), strides(trial)
    model = folder / "gait2392.osim"
    with tempfile.TemporaryDirectory() as scratch:
        loads, actuators = Path(scratch) / "loads.xml", Path(scratch) / "reserves.xml"
        loads.write_text(ground_reactions(_FEET, folder / trial / "XLD.mot"), encoding="utf-8")
        actuators.write_text(reserves(model, RESERVES), encoding="utf-8")
        return stable_problem(
            CoordinateStability(q=q, coordinates=COORDINATES, soft=SOFT),
            prepare_for=prepare_for,
            model=model,
            coordinates=folder / trial / "ik.sto",
            external_loads=loads,
            actuators=(actuators,),
            lowpass_cutoff_frequency=CUTOFF,
            initial_time=float(begins[0]),
            final_time=float(begins[-1]),
            step_interval=step_interval,
            name=trial,
        )


def strides(trial: str = "walk36") -> FloatArray:
    """Find where strides of the right foot begin, and where the last of them ends.

    Parameters
    ----------
    trial : str
        One of `TRIALS`.

    Returns
    -------
    ndarray, shape (N_STRIDES + 1,) [s]
    """
    table = read_storage(folder_of(trial, TRIALS, TREADMILL) / trial / "XLD.mot")
    force = table.columns(["ground_force_vy"])[:, 0]
    rises = table.time[1:][(force[:-1] < CONTACT) & (force[1:] >= CONTACT)]
    return np.array(rises[rises >= FIRST_TIME][: N_STRIDES + 1], dtype=float)


def emg_file(trial: str = "walk36") -> Path:
    """Find the EMG: envelopes, of which it is not said what they were normalised by.

    Parameters
    ----------
    trial : str
        One of `TRIALS`.

    Returns
    -------
    Path
    """
    return folder_of(trial, TRIALS, TREADMILL) / trial / "emgFilt.sto"
