"""Walking and running on a treadmill with 92 muscles and EMG of nine muscles of the right leg."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from problems.fetch import TREADMILL, fetch, motion_cache
from scso_nlp import CoordinateStability, MuscleForceProblem, static_optimization
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import NameMismatchError
from scso_nlp.io.storage import read_storage
from scso_nlp.opensim.engine import load_motion
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
#: Reserve of the pelvis and of every other coordinate at a control of one [N or N·m], as in walking_3d.
RESIDUAL, RESERVE = 1000.0, 1.0
#: Muscle groups and EMG channels.
EMG_MAP = Path(__file__).parent / "emg_map.toml"
_RESERVE = """<CoordinateActuator name="{name}_reserve"><min_control>-Inf</min_control>
<max_control>Inf</max_control><coordinate>{name}</coordinate><optimal_force>{force:g}</optimal_force>
</CoordinateActuator>"""
_LOAD = """<ExternalForce name="{name}"><applied_to_body>{body}</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body>
<point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>{name}_force_v</force_identifier><point_identifier>{name}_force_p</point_identifier>
<torque_identifier>{name}_torque_</torque_identifier></ExternalForce>"""
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
    step_interval : int
        Take every n-th frame of the recording (100 per second).
    prepare_for : sequence of StabilityConstraint
        Extract what these need, too.

    Returns
    -------
    MuscleForceProblem
        Without stability rows: ``make_problem().without_stability()``.

    Raises
    ------
    NameMismatchError
        No such trial.
    DataError
        The data cannot be fetched.
    """
    folder, begins = _data(trial), strides(trial)
    stability = CoordinateStability(q=q, coordinates=COORDINATES, soft=SOFT)
    model = folder / "gait2392.osim"
    names = re.findall(r'<Coordinate name="(.*?)"', model.read_text(encoding="utf-8"))
    reserves = "".join(
        _RESERVE.format(name=name, force=RESIDUAL if name.startswith("pelvis") else RESERVE) for name in names
    )
    forces = "".join(_LOAD.format(name=name, body=body) for name, body in _FEET.items())
    data = (folder / trial / "XLD.mot").resolve()
    with tempfile.TemporaryDirectory() as scratch:
        loads, actuators = Path(scratch) / "loads.xml", Path(scratch) / "reserves.xml"
        loads.write_text(
            _document("ExternalLoads", f"<objects>{forces}</objects><datafile>{data}</datafile>"),
            encoding="utf-8",
        )
        actuators.write_text(_document("ForceSet", f"<objects>{reserves}</objects>"), encoding="utf-8")
        motion = load_motion(
            model=model,
            coordinates=folder / trial / "ik.sto",
            external_loads=loads,
            actuators=(actuators,),
            lowpass_cutoff_frequency=CUTOFF,
            initial_time=float(begins[0]),
            final_time=float(begins[-1]),
            step_interval=step_interval,
            prepare_for=[stability, *prepare_for],
            name=trial,
            cache=motion_cache(),
        )
    plain = static_optimization(motion)
    return replace(plain, constraints=(*plain.constraints, stability))


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
    table = read_storage(_data(trial) / trial / "XLD.mot")
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
    return _data(trial) / trial / "emgFilt.sto"


def _document(kind: str, content: str) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?><OpenSimDocument Version="40600">'
        f'<{kind} name="made">{content}</{kind}></OpenSimDocument>'
    )


def _data(trial: str) -> Path:
    if trial not in TRIALS:
        raise NameMismatchError(f"unknown trial {trial!r}, expected one of {', '.join(TRIALS)}")
    return fetch(TREADMILL)
