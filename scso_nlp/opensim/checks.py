"""Everything that can be said about an extraction's input without OpenSim, said before it starts."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.io.storage import Storage, read_storage, with_distinct_times
from scso_nlp.opensim.model_names import ModelNames, model_names
from scso_nlp.opensim.setup_xml import LoadSource, MotionInput, check_document, read_external_loads
from scso_nlp.text import shown
from scso_nlp.validation import shown_names

_STATE_PATH = re.compile(r"(?:.*/)?([^/]+)/(value|speed)")

logger = logging.getLogger("scso_nlp")

#: Fewer frames than this leave the quintic spline, which gives speeds and accelerations, undetermined.
MIN_FRAMES = 6
#: The filter resamples to the smallest step. If that is a smaller share of the median step than this [-] ...
EVEN_STEPS = 0.1
#: A motion shorter than this share of the period of its low-pass filter is hardly one after it [-].
LEAST_PERIODS = 0.1
#: ... at most so many numbers are resampled, which takes OpenSim half a minute.
MOST_RESAMPLED = 3_000_000
#: How the labels of a vector's three columns end. OpenSim takes them by their order alone.
AXES = (["x", "y", "z"], ["1", "2", "3"])


@dataclass(frozen=True, kw_only=True)
class CheckedInput:
    """A motion input whose files were read and found usable."""

    motion: MotionInput  # its time range lies within the motion
    table: Storage  # the motion file, of rows with equal times the last
    in_degrees: bool  # unit of its angles
    unusable: Mapping[str, str]  # columns that are not finite everywhere, refused if a coordinate needs them
    speeds: Storage | None
    speeds_in_degrees: bool  # unit of its angular speeds
    loads: LoadSource | None
    load_data: Storage | None  # the columns that the loads use

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
        A missing file, a value that is not finite, a time range beside the motion, a filter on times too
        uneven for it.
    FileFormatError
        A file that is not what it should be.
    NameMismatchError
        A load whose columns are not there.
    """
    check_document(motion.model, "Model")
    for path in motion.actuators:
        check_document(path, "ForceSet")
    names = model_names(motion)
    names.require("coordinate of held_coordinates", motion.held_coordinates, names.coordinates)
    for what, chosen, known in (
        ("coordinate", motion.curvature_coordinates, names.coordinates),
        ("joint", [joint for joint, _ in motion.stability_axes], names.joints),
        ("joint", motion.joint_reactions, names.joints),
    ):
        names.require(what, [name for name in chosen if name != "all"], known)
    table = with_distinct_times(_with_columns(read_storage(motion.motion)))
    _refuse_repeated(table, names, "value")
    in_degrees = _in_degrees(motion, table)
    motion = _within(motion, table)
    _check_steps(motion, table)
    speeds, speeds_in_degrees = None, False
    if motion.speeds is not None:
        speeds = with_distinct_times(read_storage(motion.speeds).require_finite())
        _refuse_repeated(speeds, names, "speed")
        speeds_in_degrees = _unit(speeds, motion.speeds_in_degrees, "speeds_in_degrees")
    loads = load_data = None
    if motion.external_loads is not None:
        loads = read_external_loads(motion.external_loads)
        load_data = _check_loads(motion, loads, table)
    return CheckedInput(
        motion=motion,
        table=table,
        in_degrees=in_degrees,
        unusable=_unusable_columns(table),
        speeds=speeds,
        speeds_in_degrees=speeds_in_degrees,
        loads=loads,
        load_data=load_data,
    )


def _with_columns(table: Storage) -> Storage:
    if not table.labels:
        raise DataError(f"{table.source} has no columns but time, expected some")
    return table


def _refuse_repeated(table: Storage, names: ModelNames, kind: str) -> None:
    """Raise if a coordinate has two columns: OpenSim would take one of them and leave out the other.

    `kind` is what plain names in this file stand for, ``"value"`` or ``"speed"``.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for label in table.labels:
        path = _STATE_PATH.fullmatch(label)
        coordinate, of = path.groups() if path else (label, kind)
        if coordinate in names.coordinates:
            found.setdefault((coordinate, of), []).append(label)
    for (coordinate, _), labels in found.items():
        # two joints may have coordinates of one name, each with a path of its own
        if len(set(labels)) < len(labels) or (len(labels) > 1 and coordinate in labels):
            raise DataError(
                f"{table.source}: the columns {shown_names(labels)} are all of the coordinate "
                f"{coordinate!r}, expected one; take out the others"
            )


def _in_degrees(motion: MotionInput, table: Storage) -> bool:
    """Find the unit of the motion's angles, and say where the header is missing or overruled."""
    if motion.states is not None:
        if table.in_degrees and motion.in_degrees is None:
            raise DataError(f"{motion.motion} is in degrees, but OpenSim reads states in radians")
        return bool(motion.in_degrees)
    return _unit(table, motion.in_degrees, "in_degrees")


def _unit(table: Storage, told: bool | None, setting: str) -> bool:
    """Tell if a file's angles are in degrees: as told by a setting, or as OpenSim takes them."""
    in_degrees = table.assumed_in_degrees if told is None else told
    unit = "degrees" if in_degrees else "radians"
    if told is None and table.in_degrees is None:
        logger.info(
            "%s: inDegrees is missing, %s as OpenSim does (%s overrides)", table.source, unit, setting
        )
    elif told is None and table.in_degrees is False and table.is_old_mot:
        logger.warning(
            "%s: radians, as its inDegrees=no says, but OpenSim reads .mot files without a version line in "
            "degrees",
            table.source,
        )
    elif table.in_degrees is not None and table.in_degrees != in_degrees:
        logger.warning("%s: read in %s, although its header says otherwise", table.source, unit)
    return in_degrees


def _unusable_columns(table: Storage) -> dict[str, str]:
    unusable = {}
    finite = np.isfinite(table.values)
    for column in np.flatnonzero(~finite.all(axis=0)):
        row = int(np.flatnonzero(~finite[:, column])[0])
        unusable[table.labels[column]] = f"{table.values[row, column]} at t = {table.time[row]:.9g} s"
    return unusable


def _within(motion: MotionInput, table: Storage) -> MotionInput:
    """Cut the time range to the motion, and say so."""
    first, last = float(table.time[0]), float(table.time[-1])
    # OpenSim takes the frame before; half a step of slack lets rounded ends of setup files pass
    slack = 0.5 * (last - first) / max(table.n_frames - 1, 1)
    initial = first if motion.initial_time is None else motion.initial_time
    final = last if motion.final_time is None else motion.final_time
    if initial > last + slack or final < first - slack:
        raise DataError(
            f"the time range {initial:.9g} to {final:.9g} s is outside {motion.motion}, which covers "
            f"{first:.9g} to {last:.9g} s; give initial_time and final_time within it"
        )
    starts_before, ends_after = initial < first - slack, final > last + slack
    if starts_before or ends_after:
        logger.warning(
            "%s covers %.9g to %.9g s: of the time range asked for, %.9g to %.9g s, %.9g to %.9g s is taken",
            motion.motion,
            first,
            last,
            initial,
            final,
            first if starts_before else initial,
            last if ends_after else final,
        )
    return replace(
        motion,
        initial_time=None if starts_before else motion.initial_time,
        final_time=None if ends_after else motion.final_time,
    )


def _check_steps(motion: MotionInput, table: Storage) -> None:
    """Refuse motions with too few rows for the spline, or with rows too close for the filter."""
    if table.n_frames < MIN_FRAMES:
        raise DataError(
            f"{motion.motion} has {table.n_frames} frames, expected at least {MIN_FRAMES} for the quintic "
            "spline that gives speeds and accelerations"
        )
    cutoff = motion.filter_frequency
    if cutoff is None:
        return
    length = float(table.time[-1] - table.time[0])
    if cutoff * length < LEAST_PERIODS:
        logger.warning(
            "%s: the low-pass filter at %g Hz leaves next to nothing of the motion: its period is %.3g s, "
            "the motion is %.3g s long",
            motion.motion,
            cutoff,
            1 / cutoff,
            length,
        )
    steps = np.diff(table.time)
    row, typical = int(steps.argmin()), float(np.median(steps))
    smallest = float(steps[row])
    # the filter doubles the motion by what it mirrors at the ends
    n_resampled = 2 * (table.time[-1] - table.time[0]) / smallest
    if smallest < EVEN_STEPS * typical and n_resampled * table.n_columns > MOST_RESAMPLED:
        raise DataError(
            f"{motion.motion}: the rows at t = {table.time[row]:.9g} s are {smallest:.3g} s apart, expected "
            f"about the typical step of {typical:.3g} s, because the low-pass filter resamples to the "
            f"smallest step ({n_resampled:.2g} rows); take out one of them or switch the filter off"
        )


def _check_loads(motion: MotionInput, loads: LoadSource, table: Storage) -> Storage:
    """Check the data of the loads; return the columns that the loads use."""
    data = _with_columns(read_storage(loads.data))
    used: set[int] = set()
    for load, identifier in loads.identifiers:
        columns = [i for i, label in enumerate(data.labels) if label.startswith(identifier)]
        labels = tuple(data.labels[i] for i in columns)
        has_blank = any(len(label.split()) != 1 for label in labels)
        if len(columns) != 3 or len(set(labels)) != 3 or has_blank:
            why = "; OpenSim splits labels at blanks, rename the columns" if has_blank else ""
            raise NameMismatchError(
                f"{loads.data}: the load {shown(load)} needs three columns that start with "
                f"{shown(identifier)}, found {shown(labels)[1:-1] or 'none'}{why}"
            )
        ends = [label.removeprefix(identifier).lstrip("_").lower() for label in labels]
        if sorted(ends) in AXES and ends != sorted(ends):
            raise NameMismatchError(
                f"{loads.data}: OpenSim takes the columns {', '.join(labels)} of the load {shown(load)} as "
                "x, y and z in this order, expected them to be in the order of their names"
            )
        used |= set(columns)
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
    chosen = sorted(used)
    labels = tuple(data.labels[i] for i in chosen)
    return Storage(name="loads", labels=labels, time=data.time, values=data.values[:, chosen])
