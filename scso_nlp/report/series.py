"""What figures draw, read back from result folders."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from scso_nlp.emg.motion_result import MotionResult, only_file, read_results
from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import FEW_FRAMES
from scso_nlp.figures.moments import folded
from scso_nlp.figures.series import Series, most_telling
from scso_nlp.figures.sides import Sided
from scso_nlp.figures.style import MARK, REQUIRED, RESULT, SeriesStyle, series_style
from scso_nlp.io.storage import Storage, read_storage
from scso_nlp.report.contents import MOMENT_PARTS
from scso_nlp.report.folder import REPORT, names_in
from scso_nlp.report.story import with_static_optimization
from scso_nlp.validation import FloatArray

#: What is in which file, beside the activations.
_FILES = {
    "stability": ("stability.sto", "it was solved without stability rows; run again with --stability"),
    "moment": ("moments.sto", "it was written by an earlier version; run again"),
    "reaction": ("JointReaction_ReactionLoads.sto", "run again with --joint-reactions all"),
}
_LOAD = re.compile(r"_[fm][xyz]$")


def result_folders(paths: Sequence[str | os.PathLike[str]]) -> list[Path]:
    """Take the folders within those that hold several results, such as what ``scso example`` writes.

    Parameters
    ----------
    paths : sequence of path

    Returns
    -------
    list of Path
        Those that are results, or hold none, as they are.
    """
    found = []
    for path in map(Path, paths):
        within = [path / name for name in names_in(path) if REPORT in names_in(path / name)]
        found += [path] if REPORT in names_in(path) or not within else within
    return found


def read_series(
    paths: Sequence[str | os.PathLike[str]], quantity: str, labels: Sequence[str] = ()
) -> tuple[Series, ...]:
    """Read a quantity of several results.

    Parameters
    ----------
    paths : sequence of path
        Result folders, or folders that hold some.
    quantity : str
        ``"activation"``, ``"force"``, ``"stability"``, ``"reaction"`` or ``"moment"``.
    labels : sequence of str, optional
        One per result; otherwise the shortest ends of their paths that differ.

    Returns
    -------
    tuple of Series
        One per result; a single one of a run with stability rows comes after the activations of the static
        optimization that it began with. Of moments the required ones of the first result, those of each
        one's muscles, and those of its reserves where it is the only result.

    Raises
    ------
    DataError
        An unknown quantity, or one that a result lacks: the message says what brings it.
    FileFormatError
        Files that cannot be read, or that do not belong together.
    """
    read = {"force": _force, "stability": _stability, "reaction": _reaction}
    known = ("activation", *read, "moment")
    if quantity not in known:
        raise DataError(f"the quantity is {quantity!r}, expected one of {', '.join(known)}")
    folders = result_folders(paths)
    results = read_results(folders, labels)
    if quantity == "activation":
        return tuple(map(_activation, with_static_optimization(results)))
    pairs = list(zip(folders, results, strict=True))
    if quantity == "moment":
        return _moments(pairs)
    return tuple(read[quantity](folder, result) for folder, result in pairs)


def every_series(folder: Path, result: MotionResult) -> dict[str, Series]:
    """Read all that the files of one result hold over time.

    Parameters
    ----------
    folder : Path
    result : MotionResult
        Read from there.

    Returns
    -------
    dict of str to Series
        "activation", "force", the required "moment" and the "reserve moment"; where there are such rows
        "stability"; where there are joint reactions "reaction", the resultant force of every joint.

    Raises
    ------
    DataError
        A file that every run writes is not there.
    FileFormatError
        Files that cannot be read, or that do not belong together.
    """
    required, _, reserves = MOMENT_PARTS
    found = {
        "activation": _activation(result),
        "force": _force(folder, result),
        "moment": _moment(folder, result, required),
        "reserve moment": _moment(folder, result, reserves),
    }
    if result.stability_rows:
        found["stability"] = _stability(folder, result)
    if (folder / f"{result.name}_{_FILES['reaction'][0]}").is_file():
        found["reaction"] = _resultants(_reaction(folder, result))
    return found


def telling_panels(quantity: str, series: Sequence[Series]) -> tuple[tuple[Sided, ...], tuple[str, ...]]:
    """Choose what is drawn where no names are chosen.

    Parameters
    ----------
    quantity : str
    series : sequence of Series
        As :func:`read_series` gives them.

    Returns
    -------
    panels : tuple of Sided
        At most twelve; of moments those where muscles and reserves matter both, of reactions resultant
        forces.
    notes : tuple of str
        What is to be said of the others.
    """
    if quantity == "moment":
        # of one result the last are its reserves
        return folded(series[0], *(series[1:2] if series[-1].label == "reserves" else series[1:]))
    if quantity == "reaction":
        series = [_resultants(each) for each in series]
    return most_telling(series), ()


def _activation(result: MotionResult) -> Series:
    highest = result.report["problem"].get("max_activation")
    return _series(
        result, result.muscles, result.activation, "-", highest=None if highest is None else np.array(highest)
    )


def _force(folder: Path, result: MotionResult) -> Series:
    table = only_file(folder, result.name, "force.sto")
    return _series(result, result.muscles, table.columns(result.muscles), "N")


def _stability(folder: Path, result: MotionResult) -> Series:
    table = _table(folder, result, "stability")
    rows = result.stability_rows
    level = table.columns([f"{row}_level" for row in rows])[result.is_solved]
    first = level[0] if len(level) else np.full(len(rows), np.nan)
    return _series(result, rows, table.columns([f"{row}_stability" for row in rows]), "N·m/rad", level=first)


def _reaction(folder: Path, result: MotionResult) -> Series:
    """Take forces and moments, and the resultant force of each joint under the start of their names.

    Forces are in body weights, or in newtons where the model has no weight or the report does not say it.
    """
    table = _table(folder, result, "reaction")
    loads = [label for label in table.labels if _LOAD.search(label)]
    joints = dict.fromkeys(label[:-3] for label in loads)
    resultant = [np.linalg.norm(table.columns([f"{j}_f{x}" for x in "xyz"]), axis=1) for j in joints]
    found = _series(result, (*joints, *loads), np.column_stack((*resultant, table.columns(loads))), "N")
    weight = result.report["problem"].get("body_weight")
    is_moment = np.array([label[-3:-1] == "_m" for label in found.names])
    units = np.where(is_moment, "N·m", "BW" if weight else "N")
    values = found.values / np.where(is_moment, 1.0, weight or 1.0)
    return replace(found, units=tuple(units.tolist()), values=values)


def _resultants(reactions: Series) -> Series:
    """Keep the resultant forces of joints, without components."""
    return reactions.only([name for name in reactions.names if not _LOAD.search(name)])


def _moments(pairs: Sequence[tuple[Path, MotionResult]]) -> tuple[Series, ...]:
    parts = [{part: _moment(folder, result, part) for part in MOMENT_PARTS} for folder, result in pairs]
    required, muscles, reserves = MOMENT_PARTS
    first = _looking(parts[0][required], required, REQUIRED)
    if len(parts) == 1:
        return (
            first,
            _looking(parts[0][muscles], muscles, RESULT),
            _looking(parts[0][reserves], reserves, MARK),
        )
    return (
        first,
        *(
            _looking(part[muscles], f"muscles, {part[muscles].label}", series_style(i))
            for i, part in enumerate(parts)
        ),
    )


def _looking(series: Series, label: str, look: SeriesStyle) -> Series:
    return replace(series, label=label, look=look)


def _moment(folder: Path, result: MotionResult, part: str) -> Series:
    table, ending = _table(folder, result, "moment"), MOMENT_PARTS[part]
    units = {"_moment": "N·m", "_force": "N"}
    found = {
        label.removesuffix(ending).removesuffix(kind): (label, unit)
        for label in table.labels
        for kind, unit in units.items()
        if label.endswith(f"{kind}{ending}")
    }
    columns = table.columns([label for label, _ in found.values()])
    return replace(_series(result, tuple(found), columns, "N·m"), units=tuple(u for _, u in found.values()))


def _table(folder: Path, result: MotionResult, quantity: str) -> Storage:
    """Read a file that not every run writes."""
    ending, remedy = _FILES[quantity]
    path = folder / f"{result.name}_{ending}"
    if not path.is_file():
        raise DataError(f"{folder} has no {quantity}, expected {path.name}: {remedy}")
    return read_storage(path)


def _series(
    result: MotionResult,
    names: Sequence[str],
    values: FloatArray,
    unit: str,
    *,
    level: FloatArray | None = None,
    highest: FloatArray | None = None,
) -> Series:
    """Make a series of a table, shape (n_frames, n_names); frames that are not solved are blank."""
    if len(values) != len(result.time):
        raise DataError(
            f"the files of {result.label!r} have {len(values)} and {len(result.time)} frames: they are not "
            "of one run"
        )
    return Series(
        label=result.label,
        time=result.time,
        names=tuple(names),
        values=np.where(result.is_solved[:, np.newaxis], values, np.nan),
        units=(unit,),
        level=level,
        highest=highest,
        are_tasks=result.is_at_rest and len(result.time) <= FEW_FRAMES,
    )
