"""What the files of a setup hold, as tables."""

from __future__ import annotations

import math

from scso_nlp.opensim.description import ModelDescription
from scso_nlp.overview.inputs import Inputs, Load
from scso_nlp.overview.table import Table
from scso_nlp.trajectory import time_text
from scso_nlp.validation import shown_names


def input_tables(inputs: Inputs, model: ModelDescription) -> tuple[Table, ...]:
    """Sort what the files hold into tables.

    Parameters
    ----------
    inputs : Inputs
    model : ModelDescription

    Returns
    -------
    tuple of Table
    """
    tables = [_files(inputs), *_loads(inputs, model)]
    return (*tables, _findings(inputs))


def _files(inputs: Inputs) -> Table:
    notes = []
    if inputs.n_frames:
        notes.append(
            f"about {inputs.n_frames} frames to analyze, {time_text(inputs.initial_time)} to "
            f"{time_text(inputs.final_time)} s"
            + (f", low-pass filter at {inputs.cutoff:g} Hz" if inputs.cutoff else ", no filter")
        )
    return Table(
        title="Files",
        head=("role", "file", "rows", "time [s]", "unit"),
        rows=tuple(
            (
                each.role,
                each.path.name,
                f"{each.n_rows}",
                f"{time_text(each.first)} to {time_text(each.last)}",
                each.unit,
            )
            for each in inputs.files
        ),
        notes=tuple(notes),
    )


def _loads(inputs: Inputs, model: ModelDescription) -> tuple[Table, ...]:
    weight = model.mass * math.hypot(*model.gravity)
    table = Table(
        title="External loads",
        head=("load", "on", "peak force", "peak torque", "acts [s]", "its point"),
        rows=tuple(
            (
                load.name,
                load.body,
                _force(load.peak_force, weight),
                f"{load.peak_torque:.4g} N·m" if load.peak_torque else "–",
                _span(load),
                f"in {load.point}" if load.point else f"origin of {load.body}",
            )
            for load in inputs.loads
        ),
    )
    return (table,) if inputs.loads else ()


def _force(peak: float, weight: float) -> str:
    if not peak:
        return "–"
    return f"{peak:.4g} N" + (f", {peak / weight:.2f} of the weight" if weight else "")


def _span(load: Load) -> str:
    if load.first is None or load.last is None:
        return "never"
    return f"{time_text(load.first)} to {time_text(load.last)}"


def _findings(inputs: Inputs) -> Table:
    notes = []
    if inputs.problem:
        notes.append(f"cannot be used: {inputs.problem}")
    elif not inputs.notes:
        notes.append("OpenSim took some frames of it, and no unit is found wrong")
    if inputs.missing:
        notes.append(f"free coordinates without a column: {shown_names(inputs.missing)}")
    if inputs.left_out:
        notes.append(f"columns of no coordinate, left out: {shown_names(inputs.left_out)}")
    sentences = [_with_names(note, inputs) for note in (*notes, *inputs.notes)]
    return Table(title="What the files say together", notes=tuple(sentences))


def _with_names(sentence: str, inputs: Inputs) -> str:
    """Leave the folders of files out, which stand in the table of files."""
    for each in inputs.files:
        sentence = sentence.replace(str(each.path), each.path.name)
    return sentence
