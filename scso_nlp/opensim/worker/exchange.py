"""What passes between this package and its worker processes: a job in, arrays and names out.

The one module of the worker that both sides import; it needs NumPy only.
"""

from __future__ import annotations

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
#: Arrays of path points, as many per frame as its longest path has, and what they are filled up with.
POINT_ARRAYS = {
    "skeleton.path_points": 0.0,
    "skeleton.path_point_bodies": -1,
    "skeleton.path_point_moves": False,
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
class Job:
    """One extraction, the same for all of its workers."""

    settings: Mapping[str, Any]  # the fields of MotionInput, paths as text
    motion: Table  # coordinates or states, filtered
    rows: IntArray  # of the motion, to analyze
    unusable: Mapping[str, str]  # columns of the motion that are not finite everywhere, and where not
    speeds: Table | None  # at the times of the motion
    inputs: Mapping[str, str]  # SHA-256 of the files that the workers read, by path


@dataclass(frozen=True, kw_only=True)
class Result:
    """What one worker found.

    Names and constants stand in `header` by the data class and field they become, `arrays` likewise but in
    one word, ``"skeleton.joint_axes"``, frames first. There are none where frames were fewer than workers.
    """

    header: dict[str, dict[str, Any]]
    arrays: dict[str, NDArray[Any]]


def log_file(folder: Path, part: int) -> Path:
    """Return the file of whatever OpenSim prints in one worker."""
    return folder / f"log_{part}.txt"


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


def read_job(folder: Path) -> Job:
    """Read what :func:`write_job` wrote."""
    content = json.loads((folder / JOB).read_text(encoding="utf-8"))
    tables = {
        name: Table(labels=tuple(labels), **_load(folder / f"{name}.npz"))
        for name, labels in content["labels"].items()
    }
    return Job(
        settings=content["settings"],
        motion=tables["motion"],
        rows=np.array(content["rows"], dtype=np.int64),
        unusable=content["unusable"],
        speeds=tables.get("speeds"),
        inputs=content["inputs"],
    )


def write_result(folder: Path, part: int, result: Result) -> None:
    """Write one worker's arrays beside the job."""
    (folder / f"header_{part}.json").write_text(json.dumps(result.header), encoding="utf-8")
    np.savez(folder / f"frames_{part}.npz", allow_pickle=False, **result.arrays)


def read_result(folder: Path, part: int) -> Result:
    """Read what :func:`write_result` wrote."""
    header = json.loads((folder / f"header_{part}.json").read_text(encoding="utf-8"))
    return Result(header=header, arrays=_load(folder / f"frames_{part}.npz"))


def joined(parts: Sequence[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Put the frames of all parts behind each other, path points filled up to the longest path.

    The arrays are taken out of the parts one by one, so that none is in memory more often than needed.
    """
    return {
        name: np.concatenate(_same_length(name, [part.pop(name) for part in parts]))
        for name in list(parts[0])
    }


def _same_length(name: str, arrays: list[NDArray[Any]]) -> list[NDArray[Any]]:
    if name not in POINT_ARRAYS:
        return arrays
    n_points = max(array.shape[2] for array in arrays)
    filled = []
    for array in arrays:
        if array.shape[2] < n_points:
            shape = (*array.shape[:2], n_points, *array.shape[3:])
            longer = np.full(shape, POINT_ARRAYS[name], dtype=array.dtype)
            longer[:, :, : array.shape[2]] = array
            array = longer
        filled.append(array)
    return filled


def _load(path: Path) -> dict[str, NDArray[Any]]:
    with np.load(path, allow_pickle=False) as content:
        return {name: content[name] for name in content.files}
