"""Coordinates, speeds and accelerations of every row of a motion, from its columns."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import opensim as osim

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.opensim.worker.coordinates import Coordinates
from scso_nlp.opensim.worker.exchange import Job, Table
from scso_nlp.opensim.worker.model import Model
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Coordinates without a column may rest at zero if they move no more than this share of the total mass [-].
LIGHT_SEGMENT = 0.01
#: A rotation beyond two turns is reported: headers are known to name the wrong unit [rad].
SUSPICIOUS_ROTATION = 4 * np.pi
#: A column that is this many times what it should be, or the inverse, is in the other unit [rad/deg] ...
RADIANS_PER_DEGREE = np.pi / 180.0
#: and likewise millimetres for metres [m/mm] ...
METRES_PER_MILLIMETRE = 1e-3
#: ... by this relative tolerance [-] ...
SAME_RATIO = 0.01
#: ... where what is compared has the same course: least cosine of the angle between all values of both [-].
SAME_COURSE = 0.99
#: Columns of coupled coordinates that are further from what their couplers ask for are reported [rad or m].
DIFFERENT = 1e-3

#: Level and text for the log.
Note = tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class Kinematics:
    """A motion in the model's coordinates, in tree order; its rows include the padding of the filter."""

    time: FloatArray  # (n_rows,) [s]
    values: FloatArray  # (n_rows, n_u) [rad or m]
    speeds: FloatArray  # (n_rows, n_u) [rad/s or m/s]
    accelerations: FloatArray  # (n_rows, n_u) [rad/s² or m/s²], of the spline
    rows: IntArray  # the rows to analyze
    notes: list[Note]  # on missing columns, on units, on what contradicts the model
    is_assembled: bool = False  # values are OpenSim's assembly of the columns, nothing is to be done to them


def read_kinematics(job: Job, model: Model) -> Kinematics:
    """Find the model's coordinates in a job's motion.

    Raises
    ------
    DataError
        A column that is not finite, or a unit that is proven wrong.
    NameMismatchError
        No column for a coordinate that matters.
    """
    settings, motion, rows, coordinates = job.settings, job.motion, job.rows, model.coordinates
    columns, notes = _value_columns(job, model)
    scale = np.where(coordinates.scales_with_degrees & settings["in_degrees"], RADIANS_PER_DEGREE, 1.0)
    values, speeds, accelerations = (
        _taken(table, columns) * scale for table in (motion.values, motion.first, motion.second)
    )
    if settings["states"] is not None:
        # what coordinates files leave out is zero in OpenSim, what states files leave out has its default
        left_out = np.array(columns) < 0
        values[:, left_out] = np.array(coordinates.values(model.state))[left_out]
    notes += _notes_on_units(job, model, values[rows])
    notes += _notes_on_couplers(job, model, motion.time[rows], values[rows], np.array(columns) >= 0)
    if settings["states"] is not None:
        columns = _speed_columns_of_states(settings["states"], model, motion)
        speeds, accelerations = _taken(motion.values, columns), _taken(motion.first, columns)
    elif job.speeds is not None:
        columns = _speed_columns(settings["speeds"], model, job.speeds)
        is_given = np.array(columns) >= 0
        in_degrees = coordinates.scales_with_degrees & settings["speeds_in_degrees"]
        scale = np.where(in_degrees, RADIANS_PER_DEGREE, 1.0)
        given = np.where(is_given, _taken(job.speeds.values, columns) * scale, np.nan)
        notes += _notes_on_speeds(settings, model, given[rows], speeds[rows])
        speeds = np.where(is_given, given, speeds)
        accelerations = np.where(is_given, _taken(job.speeds.first, columns) * scale, accelerations)
    return Kinematics(
        time=motion.time,
        values=values,
        speeds=speeds,
        accelerations=accelerations,
        rows=rows,
        notes=notes,
    )


def _value_columns(job: Job, model: Model) -> tuple[list[int], list[Note]]:
    """Return each coordinate's column in the motion, -1 where it has none and needs none."""
    source, storage = job.settings["states"] or job.settings["coordinates"], _storage(job.motion)
    columns = []
    missing = []
    for coordinate, is_set in zip(model.coordinates.items, model.coordinates.is_set_by_model, strict=True):
        name = coordinate.getName()
        column = _first_column(storage, name, coordinate.getAbsolutePathString() + "/value")
        columns.append(column)
        if column >= 0:
            label = job.motion.labels[column]
            if label in job.unusable:
                raise DataError(
                    f"{source}: column {label!r} is {job.unusable[label]}, expected a finite number "
                    f"(coordinate {name!r})"
                )
        elif not is_set:
            missing.append(coordinate)
    return columns, _notes_on_missing(missing, job.settings, source, model)


def _notes_on_missing(
    missing: list[osim.Coordinate], settings: Mapping[str, Any], source: str, model: Model
) -> list[Note]:
    notes = []
    refused = []
    where = "zero" if settings["states"] is None else "its default value"
    for coordinate in missing:
        name, share = coordinate.getName(), _moved_mass(coordinate, model)
        if name in settings["held_coordinates"]:
            notes.append(("INFO", f"{source} has no column for {name!r}: held at {where} as asked"))
        elif share <= LIGHT_SEGMENT:
            notes.append(
                (
                    "WARNING",
                    f"{source} has no column for the coordinate {name!r}: held at {where}, as OpenSim does "
                    f"(it moves {100 * share:.2g} % of the model's mass)",
                )
            )
        else:
            refused.append(name)
    if refused:
        raise NameMismatchError(
            f"{source} has no column for {', '.join(refused)}, coordinates of "
            f"{os.path.basename(settings['model'])} (OpenSim would hold each at {where}; if that is "
            "meant, name them in held_coordinates)"
        )
    return notes


def _notes_on_units(job: Job, model: Model, values: FloatArray) -> list[Note]:
    """Name the angles (n_rows, n_u) that turn so far that their unit may be wrong."""
    large = (np.abs(values) > SUSPICIOUS_ROTATION).any(axis=0) & model.coordinates.scales_with_degrees
    if not large.any():
        return []
    names = ", ".join(name for name, far in zip(model.coordinates.names, large, strict=True) if far)
    in_degrees = job.settings["in_degrees"]
    source = job.settings["states"] or job.settings["coordinates"]
    return [
        (
            "WARNING",
            f"{source}: more than two turns in {names} when read in {_unit(in_degrees)}: does the header say "
            f"the right unit? in_degrees = {_other(in_degrees)} reads it the other way",
        )
    ]


def _notes_on_speeds(
    settings: Mapping[str, Any], model: Model, given: FloatArray, derived: FloatArray
) -> list[Note]:
    """Compare a file's speeds with the derivatives of the coordinates, shape (n_rows, n_u).

    Raises
    ------
    DataError
        They are in another unit, and nobody said that they are to be read so.
    """
    is_given = np.isfinite(given).all(axis=0)
    shifts = ~model.coordinates.is_rotational & is_given
    times = _other_unit(given[:, shifts], derived[:, shifts], METRES_PER_MILLIMETRE)
    if times is not None:
        names = ", ".join(name for name, shift in zip(model.coordinates.names, shifts, strict=True) if shift)
        raise DataError(
            f"{settings['speeds']}: the speeds of {names} are {times} the derivative of the coordinates in "
            f"{settings['coordinates']}, so one of them is in millimetres: OpenSim reads metres, divide its "
            "columns by 1000"
        )
    compared = model.coordinates.scales_with_degrees & is_given
    times = _other_unit(given[:, compared], derived[:, compared], RADIANS_PER_DEGREE)
    if times is None:
        return []
    in_degrees = settings["speeds_in_degrees"]
    text = (
        f"{settings['speeds']}: read in {_unit(in_degrees)} per second, its speeds are {times} the "
        f"derivative of the coordinates in {settings['coordinates']}, read in {_unit(settings['in_degrees'])}"
    )
    if "speeds_in_degrees" in settings["told_units"]:
        return [("WARNING", f"{text}: taken so, as asked")]
    raise DataError(
        f"{text}, so one of the units is wrong: speeds_in_degrees = {_other(in_degrees)} reads the speeds "
        f"the other way, in_degrees = {_other(settings['in_degrees'])} the coordinates; "
        f"speeds_in_degrees = {_other(not in_degrees)} takes them as they are"
    )


def _notes_on_couplers(
    job: Job, model: Model, time: FloatArray, values: FloatArray, has_column: BoolArray
) -> list[Note]:
    """Compare columns of coupled coordinates with what their couplers ask for, values (n_rows, n_u).

    Raises
    ------
    DataError
        A translation shows that all angles are in another unit, and nobody said that they are to be read so.
    """
    coordinates, settings = model.coordinates, job.settings
    source = settings["states"] or settings["coordinates"]
    notes: list[Note] = []
    apart = np.zeros_like(values)
    for coupler in coordinates.couplers:
        k = coupler.target
        if not has_column[[k, *coupler.where]].all():
            continue
        asked = np.array([coupler.value(row) for row in values])
        partners = ", ".join(repr(coordinates.names[j]) for j in coupler.where)
        name = coordinates.names[k]
        text = f"{source}: the column of {name!r} is {{}} what its coupler makes of {partners}"
        times = _other_unit(values[:, k], asked, METRES_PER_MILLIMETRE)
        if times is not None:
            text = f"{text.format(times)}: one is in millimetres, OpenSim reads metres"
            if settings["keep_coupled_speeds"]:
                raise DataError(
                    f"{text}; divide by 1000, take the column out, or set keep_coupled_speeds = false"
                )
            notes.append(("WARNING", text))
            continue
        times = _other_unit(values[:, k], asked, RADIANS_PER_DEGREE)
        if times is None:
            apart[:, k] = np.abs(values[:, k] - asked)
            continue
        text = text.format(times)
        if coordinates.is_rotational[k] or not coordinates.scales_with_degrees[coupler.where].all():
            remedy = ", or set keep_coupled_speeds = false" if settings["keep_coupled_speeds"] else ""
            notes.append(("WARNING", f"{text}: its unit is wrong; take the column out{remedy}"))
            continue
        text += f", read in {_unit(settings['in_degrees'])}"
        if "in_degrees" not in settings["told_units"]:
            raise DataError(
                f"{text}, so the unit is wrong: in_degrees = {_other(settings['in_degrees'])} reads the "
                f"angles the other way, in_degrees = {_other(not settings['in_degrees'])} takes them as they "
                "are"
            )
        notes.append(("WARNING", f"{text}: taken so, as asked"))
    if (apart > DIFFERENT).any():
        notes.append(("WARNING", f"{source}: {_largest_difference(coordinates, time, apart)}"))
    return notes


def _largest_difference(coordinates: Coordinates, time: FloatArray, apart: FloatArray) -> str:
    """Say how far columns are from what couplers ask for, shape (n_rows, n_u)."""
    far = apart > DIFFERENT
    row, k = np.unravel_index(int(apart.argmax()), apart.shape)
    names = ", ".join(coordinates.names[j] for j in np.flatnonzero(far.any(axis=0)))
    unit = "rad" if coordinates.is_rotational[k] else "m"
    return (
        f"in {far.any(axis=1).sum()} of {len(time)} rows the columns of {names} are not what their couplers "
        f"ask for, most {coordinates.names[k]!r} by {apart[row, k]:.3g} {unit} at t = {time[row]:.9g} s: the "
        "couplers' values are taken, as in OpenSim"
    )


def _other_unit(found: FloatArray, expected: FloatArray, unit: float) -> str | None:
    """Tell how many times larger values are than expected, if that shows another unit; else None."""
    own, other = float((found**2).sum()), float((expected**2).sum())
    product = float((found * expected).sum())
    if not own * other > 0 or product < SAME_COURSE * math.sqrt(own * other):
        return None
    ratio = math.sqrt(own / other)
    if abs(ratio * unit - 1) <= SAME_RATIO:
        return f"{ratio:.4g} times"
    if abs(ratio / unit - 1) <= SAME_RATIO:
        return f"1/{1 / ratio:.4g} of"
    return None


def _unit(in_degrees: bool) -> str:
    return "degrees" if in_degrees else "radians"


def _other(flag: bool) -> str:
    """Return the opposite as settings files have it."""
    return "false" if flag else "true"


def _moved_mass(coordinate: osim.Coordinate, model: Model) -> float:
    """Share of the total mass on the distal side of a coordinate's joint; 1 if a load acts there."""
    distal = model.bodies.moved_by(coordinate)
    if distal & set(model.loads.bodies.tolist()):
        return 1.0
    masses = model.bodies.masses
    return float(masses[sorted(distal)].sum() / max(masses.sum(), 1e-300))


def _speed_columns_of_states(source: str, model: Model, states: Table) -> list[int]:
    storage, columns = _storage(states), []
    for k, coordinate in enumerate(model.coordinates.items):
        path = coordinate.getAbsolutePathString() + "/speed"
        columns.append(_first_column(storage, path, coordinate.getName() + "_u"))
        if columns[k] < 0 and not model.coordinates.is_set_by_model[k]:
            raise NameMismatchError(
                f"{source} has no column for the speed of {coordinate.getName()!r}, expected {path}"
            )
    return columns


def _speed_columns(source: str, model: Model, speeds: Table) -> list[int]:
    storage, columns = _storage(speeds), []
    for k, coordinate in enumerate(model.coordinates.items):
        name = coordinate.getName()
        path = coordinate.getAbsolutePathString() + "/speed"
        columns.append(_first_column(storage, path, name + "_u", name))
        if columns[k] < 0 and not model.coordinates.is_set_by_model[k]:
            raise NameMismatchError(f"{source} has no column for {name!r}")
    return columns


def _taken(table: FloatArray, columns: list[int]) -> FloatArray:
    """Return chosen columns, zeros for those that are not there (-1)."""
    is_there = np.array(columns) >= 0
    taken = np.zeros((len(table), len(columns)))
    taken[:, is_there] = table[:, np.array(columns)[is_there]]
    return taken


def _storage(table: Table) -> osim.Storage:
    """Return an OpenSim table without rows: it knows how columns are to be found."""
    storage = osim.Storage()
    names = osim.ArrayStr()
    for label in ("time", *table.labels):
        names.append(label)
    storage.setColumnLabels(names)
    return storage


def _first_column(storage: osim.Storage, *labels: str) -> int:
    """Return the first of some columns that is there, as OpenSim finds them, or -1."""
    found = (int(storage.getStateIndex(label)) for label in labels)
    return next((column for column in found if column >= 0), -1)
