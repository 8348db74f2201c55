"""Everything that can be said about an extraction's input without OpenSim, said before it starts."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.io.storage import Storage, read_storage
from scso_nlp.opensim.setup_xml import LoadSource, MotionInput, check_document, read_external_loads

logger = logging.getLogger("scso_nlp")

#: Fewer frames than this leave the quintic spline, which gives speeds and accelerations, undetermined.
MIN_FRAMES = 6


@dataclass(frozen=True, kw_only=True)
class CheckedInput:
    """A motion input whose files were read and found usable."""

    motion: MotionInput
    table: Storage  # the motion file
    in_degrees: bool  # unit of its angles
    unusable: Mapping[str, str]  # columns that are not finite everywhere, refused if a coordinate needs them
    speeds: Storage | None
    loads: LoadSource | None

    @property
    def n_frames(self) -> int:
        """Number of frames to analyze, give or take the ends."""
        time, motion = self.table.time, self.motion
        inside = np.ones(len(time), dtype=bool)
        if motion.initial_time is not None:
            inside &= time >= motion.initial_time
        if motion.final_time is not None:
            inside &= time <= motion.final_time
        return int(inside.sum()) // motion.step_interval


def check_input(motion: MotionInput) -> CheckedInput:
    """Read the files of a motion input and check them.

    Parameters
    ----------
    motion : MotionInput

    Returns
    -------
    CheckedInput

    Raises
    ------
    DataError
        A missing file, a value that is not finite, a time range outside the motion.
    FileFormatError
        A file that is not what it should be.
    NameMismatchError
        A load whose columns are not there.
    """
    for path in motion.files():
        if not path.is_file():
            raise DataError(f"{path} does not exist" if not path.exists() else f"{path} is not a file")
    check_document(motion.model, "Model")
    for path in motion.actuators:
        check_document(path, "ForceSet")
    table = read_storage(motion.motion)
    in_degrees = _in_degrees(motion, table)
    _check_range(motion, table)
    speeds = None
    if motion.speeds is not None:
        speeds = read_storage(motion.speeds).require_finite()
    loads = None
    if motion.external_loads is not None:
        loads = read_external_loads(motion.external_loads)
        _check_loads(motion, loads, table)
    return CheckedInput(
        motion=motion,
        table=table,
        in_degrees=in_degrees,
        unusable=_unusable_columns(table),
        speeds=speeds,
        loads=loads,
    )


def _in_degrees(motion: MotionInput, table: Storage) -> bool:
    """Find the unit of the motion's angles, and say where the header is missing or overruled."""
    if motion.states is not None:
        if table.in_degrees and motion.in_degrees is None:
            raise DataError(f"{motion.motion} is in degrees, but OpenSim reads states in radians")
        return bool(motion.in_degrees)
    in_degrees = table.assumed_in_degrees if motion.in_degrees is None else motion.in_degrees
    unit = "degrees" if in_degrees else "radians"
    if motion.in_degrees is None and table.in_degrees is None:
        logger.info(
            "%s: inDegrees is missing, %s as OpenSim does (in_degrees overrides)", motion.motion, unit
        )
    elif motion.in_degrees is None and table.in_degrees is False and table.is_old_mot:
        logger.warning(
            "%s: radians, as its inDegrees=no says, but OpenSim reads .mot files without a version line in "
            "degrees",
            motion.motion,
        )
    elif table.in_degrees is not None and table.in_degrees != in_degrees:
        logger.warning("%s: read in %s, although its header says otherwise", motion.motion, unit)
    return in_degrees


def _unusable_columns(table: Storage) -> dict[str, str]:
    unusable = {}
    finite = np.isfinite(table.values)
    for column in np.flatnonzero(~finite.all(axis=0)):
        row = int(np.flatnonzero(~finite[:, column])[0])
        unusable[table.labels[column]] = f"{table.values[row, column]} at t = {table.time[row]:.9g} s"
    return unusable


def _check_range(motion: MotionInput, table: Storage) -> None:
    first, last = float(table.time[0]), float(table.time[-1])
    # OpenSim takes the frame before; half a step of slack lets rounded ends of setup files pass
    slack = 0.5 * (last - first) / max(table.n_frames - 1, 1)
    initial = first if motion.initial_time is None else motion.initial_time
    final = last if motion.final_time is None else motion.final_time
    if initial < first - slack or final > last + slack:
        raise DataError(
            f"the time range {initial:.9g} to {final:.9g} s is outside {motion.motion}, which covers "
            f"{first:.9g} to {last:.9g} s"
        )
    if table.n_frames < MIN_FRAMES:
        raise DataError(
            f"{motion.motion} has {table.n_frames} frames, expected at least {MIN_FRAMES} for the quintic "
            "spline that gives speeds and accelerations"
        )


def _check_loads(motion: MotionInput, loads: LoadSource, table: Storage) -> None:
    data = read_storage(loads.data)
    for load, identifier in loads.identifiers:
        columns = [i for i, label in enumerate(data.labels) if label.startswith(identifier)]
        if len(columns) != 3:
            found = ", ".join(data.labels[i] for i in columns) or "none"
            raise NameMismatchError(
                f"{loads.data}: the load {load!r} needs three columns that start with {identifier!r}, "
                f"found {found}"
            )
        values = data.values[:, columns]
        if not np.isfinite(values).all():
            row, which = (int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise DataError(
                f"{loads.data}: column {data.labels[columns[which]]!r} is {values[row, which]} at "
                f"t = {data.time[row]:.9g} s, expected a finite number (load {load!r})"
            )
    first = max(float(table.time[0]), motion.initial_time if motion.initial_time is not None else -np.inf)
    last = min(float(table.time[-1]), motion.final_time if motion.final_time is not None else np.inf)
    slack = float(np.diff(table.time).max())
    if loads.identifiers and (data.time[0] > first + slack or data.time[-1] < last - slack):
        raise DataError(
            f"{loads.data} covers {data.time[0]:.9g} to {data.time[-1]:.9g} s, expected the analyzed range "
            f"{first:.9g} to {last:.9g} s"
        )
