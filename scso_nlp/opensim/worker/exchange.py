"""What passes between this package and its worker processes: a job in, arrays and names out.

The one module of the worker that both sides import; it needs NumPy only.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scso_nlp.validation import FloatArray, IntArray

#: The file that makes a folder one of a job.
JOB = "job.json"
#: The data file of the external loads, beside their XML.
LOAD_DATA = "external_loads.sto"
#: Times and columns of a motion before its filter.
RECORDED = "recorded.npy"
#: Arrays of path points, as many per frame as its longest path has, and what they are filled up with.
POINT_ARRAYS = {
    "skeleton.path_points": 0.0,
    "skeleton.path_point_bodies": -1,
    "skeleton.path_point_moves": False,
    "virtual.path_point_surfaces": -1,
    "virtual.path_points_acting": 0.0,
}


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns over time, with their derivatives."""

    labels: tuple[str, ...]
    time: FloatArray  # (n_rows,) [s]
    values: FloatArray  # (n_rows, n_columns)
    first: FloatArray  # (n_rows, n_columns), derivatives of the splines through `values`
    second: FloatArray  # (n_rows, n_columns), derivatives of the splines through `first`


@dataclass(frozen=True, kw_only=True)
class Request:
    """A model to be described; with a motion it is a :class:`Job`."""

    settings: Mapping[str, Any]  # the fields of MotionInput, paths as text
    inputs: Mapping[str, str]  # SHA-256 of the files that the workers read, by path


@dataclass(frozen=True, kw_only=True)
class Job(Request):
    """One extraction, the same for all of its workers."""

    motion: Table  # coordinates or states, filtered
    recorded: FloatArray | None  # (n_recorded, 1 + n_columns), times and columns before the filter, if any
    rows: IntArray  # of the motion, to analyze
    unusable: Mapping[str, str]  # columns of the motion that are not finite everywhere, and where not
    speeds: Table | None  # at the times of the motion


@dataclass(frozen=True, kw_only=True)
class Result:
    """What all workers found, frames in their order.

    Names and constants stand in each worker's header by the data class and field they become, `arrays`
    likewise but in one word, ``"skeleton.joint_axes"``, frames first, read-only. Workers without frames have
    no header.
    """

    headers: list[dict[str, dict[str, Any]]]
    arrays: dict[str, NDArray[Any]]


def log_file(folder: Path, part: int) -> Path:
    """Return the file of whatever OpenSim prints in one worker."""
    return folder / f"log_{part}.txt"


def write_request(folder: Path, request: Request) -> None:
    """Write a request for a description into an empty folder."""
    content = {"settings": dict(request.settings), "inputs": dict(request.inputs)}
    (folder / JOB).write_text(json.dumps(content), encoding="utf-8")


def read_request(folder: Path) -> Request:
    """Read what :func:`write_request` or :func:`write_job` wrote."""
    content = json.loads((folder / JOB).read_text(encoding="utf-8"))
    return read_job(folder) if "rows" in content else Request(**content)


def write_job(folder: Path, job: Job, external_loads: str | None) -> None:
    """Write a job into an empty folder, with the XML of its external loads where some apply."""
    settings = {**job.settings, "external_loads": None}
    if external_loads is not None:
        loads = folder / "external_loads.xml"
        loads.write_text(external_loads, encoding="utf-8")
        settings["external_loads"] = str(loads)
    tables = {"motion": job.motion} if job.speeds is None else {"motion": job.motion, "speeds": job.speeds}
    content = {
        "settings": settings,
        "unusable": dict(job.unusable),
        "inputs": dict(job.inputs),
        "labels": {name: list(table.labels) for name, table in tables.items()},
        "rows": job.rows.tolist(),
    }
    (folder / JOB).write_text(json.dumps(content), encoding="utf-8")
    for name, table in tables.items():
        arrays = {field: getattr(table, field) for field in ("time", "values", "first", "second")}
        np.savez(folder / f"{name}.npz", allow_pickle=False, **arrays)
    if job.recorded is not None:
        np.save(folder / RECORDED, job.recorded, allow_pickle=False)


def read_job(folder: Path) -> Job:
    """Read what :func:`write_job` wrote."""
    content = json.loads((folder / JOB).read_text(encoding="utf-8"))
    tables = {
        name: Table(labels=tuple(labels), **_load(folder / f"{name}.npz"))
        for name, labels in content["labels"].items()
    }
    recorded = folder / RECORDED
    return Job(
        settings=content["settings"],
        motion=tables["motion"],
        recorded=np.load(recorded, allow_pickle=False) if recorded.is_file() else None,
        rows=np.array(content["rows"], dtype=np.int64),
        unusable=content["unusable"],
        speeds=tables.get("speeds"),
        inputs=content["inputs"],
    )


def write_frames(folder: Path, part: int, block: int, frames: Sequence[dict[str, NDArray[Any]]]) -> None:
    """Write some consecutive frames of one worker beside the job; blocks are numbered from 0."""
    np.savez(folder / f"frames_{part}_{block}.npz", allow_pickle=False, **joined(frames))


def joined(frames: Sequence[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Put the arrays of consecutive frames behind each other."""
    return {name: _joined(name, [frame[name] for frame in frames]) for name in frames[0]}


def write_header(folder: Path, part: int, header: dict[str, Any]) -> None:
    """Write the names and constants that one worker found, after its frames."""
    (folder / f"header_{part}.json").write_text(json.dumps(header), encoding="utf-8")


def read_header(folder: Path, part: int) -> dict[str, Any]:
    """Read what :func:`write_header` wrote."""
    header: dict[str, Any] = json.loads((folder / f"header_{part}.json").read_text(encoding="utf-8"))
    return header


def read_result(folder: Path, parts: int) -> Result:
    """Read what all workers wrote, one array after the other: none is in memory twice but the last."""
    headers = []
    with contextlib.ExitStack() as stack:
        blocks = []
        for part in range(parts):
            own = len(list(folder.glob(f"frames_{part}_*.npz")))
            paths = [folder / f"frames_{part}_{block}.npz" for block in range(own)]
            blocks += [stack.enter_context(np.load(path, allow_pickle=False)) for path in paths]
            if own:
                headers.append(read_header(folder, part))
        arrays = {name: _joined(name, [block[name] for block in blocks]) for name in blocks[0].files}
    for array in arrays.values():
        array.flags.writeable = False
    return Result(headers=headers, arrays=arrays)


def _joined(name: str, arrays: list[NDArray[Any]]) -> NDArray[Any]:
    """Put frames behind each other, path points filled up to the longest path."""
    if name not in POINT_ARRAYS:
        return np.concatenate(arrays)
    n_points = max(array.shape[2] for array in arrays)
    filled = []
    for array in arrays:
        if array.shape[2] < n_points:
            shape = (*array.shape[:2], n_points, *array.shape[3:])
            longer = np.full(shape, POINT_ARRAYS[name], dtype=array.dtype)
            longer[:, :, : array.shape[2]] = array
            array = longer
        filled.append(array)
    return np.concatenate(filled)


def _load(path: Path) -> dict[str, NDArray[Any]]:
    with np.load(path, allow_pickle=False) as content:
        return {name: content[name] for name in content.files}
