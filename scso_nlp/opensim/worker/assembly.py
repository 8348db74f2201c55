"""Where clamped coordinates leave their ranges: the values that OpenSim's own assembly takes.

AnalyzeTool assembles every row of a motion: coupled coordinates follow the others, clamped ones stay in their
ranges. Where none leaves its range the answer is known without it: the columns as they are, with couplers
evaluated. Where one does, OpenSim's optimizer mostly holds it at the bound, but not always: it begins at the
row before, it may give up, and then what the columns say is kept if it satisfies the constraints. It enlarges
rounding errors of its goals up to the error that it leaves open. So the same calls are made in the same order
on the same numbers, the filter included, which gives the same numbers to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import opensim as osim

from scso_nlp.opensim.worker.coordinates import Coordinates
from scso_nlp.opensim.worker.exchange import Job
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.motion import Kinematics, read_kinematics
from scso_nlp.validation import BoolArray, FloatArray

#: Clamped coordinates this little beyond their range, and changes this small, do not count [rad] or [m].
NEGLIGIBLE = 1e-6


def assembled(job: Job, model: Model, kinematics: Kinematics) -> Kinematics:
    """Give a motion the values of OpenSim's assembly if a row to analyze needs it; speeds stay.

    It must be asked before anything else assembles the model: the optimizer starts from its last pose.
    """
    rows = kinematics.rows
    if not model.has_constraint_set:
        return kinematics
    is_outside = _leaves_range(model.coordinates, kinematics.values[rows])
    if not is_outside.any():
        return kinematics
    values, state = _goals(job, model, kinematics).copy(), osim.State(model.state)
    if job.settings["states"] is None:
        # AnalyzeTool completes the whole motion first, all at the time of the state it starts from
        for row in range(len(values)):
            values[row] = _assemble(model, state, values[row])
        state = osim.State(model.state)
    for row in range(rows[0], rows[-1] + 1):
        state.setTime(float(kinematics.time[row]))
        values[row] = _assemble(model, state, values[row])
    note = _note(job.settings, model, kinematics, is_outside, values)
    return replace(kinematics, values=values, is_assembled=True, notes=[*kinematics.notes, ("WARNING", note)])


def _goals(job: Job, model: Model, kinematics: Kinematics) -> FloatArray:
    """Return what OpenSim assembles, shape (n_rows, n_u), to the last bit: filtered by its own filter."""
    if job.recorded is None:
        return kinematics.values
    table = osim.Storage()
    for time, *row in job.recorded.tolist():
        table.append(time, osim.Vector.createFromMat(np.array(row)))
    table.pad(table.getSize() // 2)
    table.lowpassIIR(job.settings["lowpass_cutoff_frequency"])
    columns, column = np.empty_like(job.motion.values), osim.ArrayDouble()
    for k in range(columns.shape[1]):
        table.getDataColumn(k, column)
        columns[:, k] = column.getAsVector().to_numpy()
    return read_kinematics(replace(job, motion=replace(job.motion, values=columns)), model).values


def _leaves_range(coordinates: Coordinates, values: FloatArray) -> BoolArray:
    """Tell which clamped coordinates are outside their ranges, shape (n_rows, n_u); coupled ones follow."""
    if any(np.isfinite(coordinates.ranges[coupler.target]).any() for coupler in coordinates.couplers):
        for row in values:
            coordinates.follow(row)
    lower, upper = coordinates.ranges.T
    outside: BoolArray = (values < lower - NEGLIGIBLE) | (values > upper + NEGLIGIBLE)
    return outside


def _assemble(model: Model, state: osim.State, values: FloatArray) -> list[float]:
    """Let OpenSim assemble one row, beginning at the pose of the row before."""
    model.coordinates.set_values(state, values)
    model.opensim.assemble(state)
    return model.coordinates.values(state)


def _note(
    settings: Mapping[str, Any], model: Model, before: Kinematics, is_outside: BoolArray, after: FloatArray
) -> str:
    """Say which coordinates left their ranges, and what changed in those that the model does not set."""
    coordinates, rows = model.coordinates, before.rows
    changes = np.abs(after - before.values)[rows]
    changes[:, coordinates.is_set_by_model] = 0.0
    row, k = np.unravel_index(int(changes.argmax()), changes.shape)
    left = ", ".join(coordinates.names[j] for j in np.flatnonzero(is_outside.any(axis=0)))
    n_left, n_changed = is_outside.any(axis=1).sum(), (changes > NEGLIGIBLE).any(axis=1).sum()
    unit = "rad" if coordinates.is_rotational[k] else "m"
    return (
        f"{settings['states'] or settings['coordinates']}: in {n_left} of {len(rows)} rows coordinates leave "
        f"the ranges to which the model clamps them ({left}); the values of OpenSim's assembly are taken, "
        f"which changes them in {n_changed}, most {coordinates.names[k]!r} by {changes[row, k]:.3g} {unit} "
        f"at t = {before.time[rows[row]]:.9g} s; speeds stay those of the motion"
    )
