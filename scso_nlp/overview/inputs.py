"""What the files of a motion hold beside a model: columns, units, times, loads."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from defusedxml import ElementTree

from scso_nlp.exceptions import ScsoError
from scso_nlp.io.storage import Storage
from scso_nlp.opensim.checks import CheckedInput, check_input
from scso_nlp.opensim.description import ModelDescription
from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.setup_xml import MotionInput
from scso_nlp.validation import FloatArray

logger = logging.getLogger("scso_nlp")

#: Frames that OpenSim is tried with: enough to compare the courses of columns.
TRIED_FRAMES = 20
#: A load acts where its force is more than this share of its peak [-].
ACTS = 0.01


@dataclass(frozen=True, kw_only=True)
class InputFile:
    """A file over time: ``unit`` is that of its angles, with who says so; empty where it has none."""

    role: str
    path: Path
    n_rows: int
    first: float  # [s]
    last: float  # [s]
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class Load:
    """An external load; ``first`` and ``last`` are when it acts in the range analyzed, None if never."""

    name: str
    body: str
    peak_force: float  # [N]
    peak_torque: float  # [N·m]
    first: float | None  # [s]
    last: float | None  # [s]
    point: str  # the frame that its point is given in, empty for the origin of the body


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """What a setup brings beside its model.

    Attributes
    ----------
    files : tuple of InputFile
    n_frames : int
        Frames to analyze.
    initial_time, final_time : float [s]
        The range of them.
    cutoff : float or None [Hz]
        Of the low-pass filter.
    columns : mapping of str to (float, float) [rad or m]
        Least and largest value of every coordinate that has a column, in that range and not filtered.
    missing : tuple of str
        Free coordinates without a column.
    left_out : tuple of str
        Columns of no coordinate.
    outside : tuple of str
        Coordinates whose column leaves the model's range for them.
    loads : tuple of Load
    notes : tuple of str
        What reading the files and trying some frames in OpenSim had to say.
    problem : str
        Why the files cannot be used; empty if they can. Then what comes after the reason is not known.
    """

    files: tuple[InputFile, ...] = ()
    n_frames: int = 0
    initial_time: float = np.nan
    final_time: float = np.nan
    cutoff: float | None = None
    columns: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    loads: tuple[Load, ...] = ()
    notes: tuple[str, ...] = ()
    problem: str = ""


def look_at_inputs(motion: MotionInput, model: ModelDescription) -> Inputs:
    """Read the files of a motion and try some frames of it in OpenSim, which proves or refutes their units.

    Parameters
    ----------
    motion : MotionInput
    model : ModelDescription
        Of its model and actuators.

    Returns
    -------
    Inputs
    """
    with collected_notes() as notes:
        try:
            checked = check_input(motion)
        except ScsoError as error:
            return Inputs(notes=tuple(notes), problem=str(error))
        found = _inputs(checked, model)
        notes.clear()  # the trial says them again
        step = motion.step_interval * max(found.n_frames // TRIED_FRAMES, 1)
        try:
            load_motion(
                replace(motion, step_interval=step, muscle_paths=False, stability_axes=()),
                processes=1,
                curvature_coordinates=(),
            )
        except ScsoError as error:
            return replace(found, notes=tuple(notes), problem=str(error))
    return replace(found, notes=tuple(notes))


@contextlib.contextmanager
def collected_notes() -> Iterator[list[str]]:
    """Keep the warnings of this package in a list instead of showing them."""
    notes: list[str] = []
    collector = logging.Handler(logging.WARNING)
    collector.emit = lambda record: notes.append(record.getMessage())  # type: ignore[method-assign]
    handlers, propagates = logger.handlers, logger.propagate
    logger.handlers, logger.propagate = [collector], False
    try:
        yield notes
    finally:
        logger.handlers, logger.propagate = handlers, propagates


def _inputs(checked: CheckedInput, model: ModelDescription) -> Inputs:
    motion, table = checked.motion, checked.table
    initial = table.time[0] if motion.initial_time is None else motion.initial_time
    final = table.time[-1] if motion.final_time is None else motion.final_time
    is_inside = (table.time >= initial) & (table.time <= final)
    labels = _labels(table, model)
    columns = {}
    for coordinate in model.coordinates:
        if coordinate.name in labels and is_inside.any():
            values = table.values[is_inside, labels[coordinate.name]]
            scale = np.pi / 180.0 if checked.in_degrees and coordinate.motion == "rotational" else 1.0
            columns[coordinate.name] = (float(values.min() * scale), float(values.max() * scale))
    known = set(labels.values())
    ranges = {coordinate.name: coordinate.range for coordinate in model.coordinates}
    files = [_file("motion", table, _unit(table, checked.in_degrees, motion.in_degrees))]
    if checked.speeds is not None:
        told = motion.speeds_in_degrees
        files.append(_file("speeds", checked.speeds, _unit(checked.speeds, checked.speeds_in_degrees, told)))
    if checked.load_data is not None and checked.loads is not None:
        data = replace(checked.load_data, source=str(checked.loads.data))
        files.append(_file("external loads", data, "N, N·m, m"))
    return Inputs(
        files=tuple(files),
        n_frames=checked.n_frames,
        initial_time=float(initial),
        final_time=float(final),
        cutoff=motion.filter_frequency,
        columns=MappingProxyType(columns),
        missing=tuple(each.name for each in model.free if each.name not in labels),
        left_out=tuple(
            label for i, label in enumerate(table.labels) if i not in known and motion.states is None
        ),
        outside=tuple(
            name
            for name, (least, most) in columns.items()
            if least < ranges[name][0] or most > ranges[name][1]
        ),
        loads=_loads(checked, float(initial), float(final)),
    )


def _labels(table: Storage, model: ModelDescription) -> dict[str, int]:
    """Return the column of each coordinate that has one, by its name or by its path of a state."""
    found = {}
    for i, label in enumerate(table.labels):
        parts = label.split("/")
        name = parts[-2] if len(parts) > 2 and parts[-1] == "value" else label
        found[name] = i
    return {each.name: found[each.name] for each in model.coordinates if each.name in found}


def _unit(table: Storage, in_degrees: bool, told: bool | None) -> str:
    unit = "degrees" if in_degrees else "radians"
    if told is not None:
        return f"{unit}, as set"
    return f"{unit}, {'no inDegrees: as OpenSim assumes' if table.in_degrees is None else 'by its header'}"


def _file(role: str, table: Storage, unit: str) -> InputFile:
    return InputFile(
        role=role,
        path=Path(table.source),
        n_rows=table.n_frames,
        first=float(table.time[0]),
        last=float(table.time[-1]),
        unit=unit,
    )


def _loads(checked: CheckedInput, initial: float, final: float) -> tuple[Load, ...]:
    if checked.loads is None or checked.load_data is None:
        return ()
    data = checked.load_data
    is_inside = (data.time >= initial) & (data.time <= final)
    time = data.time[is_inside]
    found = []
    for load in ElementTree.fromstring(checked.loads.text).iter("ExternalForce"):
        force, torque = (
            _length(data, load.findtext(f"{kind}_identifier"))[is_inside] for kind in ("force", "torque")
        )
        most = force if force.max(initial=0.0) > 0 else torque
        acting = time[most > ACTS * most.max(initial=0.0)]
        has_point = _is_named(load.findtext("point_identifier"))
        found.append(
            Load(
                name=load.get("name", ""),
                body=(load.findtext("applied_to_body") or "").strip(),
                peak_force=float(force.max(initial=0.0)),
                peak_torque=float(torque.max(initial=0.0)),
                first=float(acting[0]) if acting.size else None,
                last=float(acting[-1]) if acting.size else None,
                point=(load.findtext("point_expressed_in_body") or "ground").strip() if has_point else "",
            )
        )
    return tuple(found)


def _is_named(identifier: str | None) -> bool:
    return (identifier or "").strip().lower() not in ("", "unassigned")


def _length(data: Storage, identifier: str | None) -> FloatArray:
    """Lengths of the vectors in the columns that start with an identifier, shape (n_rows,)."""
    if not _is_named(identifier):
        return np.zeros(data.n_frames)
    start = (identifier or "").strip()
    own = [i for i, label in enumerate(data.labels) if label.startswith(start)]
    return np.asarray(np.linalg.norm(data.values[:, own], axis=1))
