"""What a comparison needs to know of one solution, from memory or read back from a result folder."""

from __future__ import annotations

import glob
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.files import absolute, read_text, refused
from scso_nlp.io.storage import Storage, read_storage
from scso_nlp.text import shown
from scso_nlp.validation import BoolArray, FloatArray, read_only, read_only_flags, unique_names
from scso_nlp.verdict import UNUSABLE, USABLE

if TYPE_CHECKING:
    from scso_nlp.solution import Solution

_REPORT = "report.json"


@dataclass(frozen=True, kw_only=True)
@checked
class MotionResult:
    """What a comparison needs to know of one solution.

    Attributes
    ----------
    label : str
        How it is called in tables and figures.
    name : str
        Name of the motion.
    time : ndarray, shape (n_frames,) [s]
    muscles : tuple of str
    activation : ndarray, shape (n_frames, n_muscles) [-]
        NaN allowed in frames that are not solved.
    is_solved : ndarray of bool, shape (n_frames,)
    stability_rows : tuple of str
        ``"<joint>_<axis>"``.
    stability : ndarray, shape (n_frames, n_stability_rows) [N·m/rad]
        NaN likewise.
    without_stability : ndarray, shape (n_frames, n_muscles) [-] or None
        Activations of the static optimization that a run with stability rows began with; NaN likewise.
    report : mapping
        Settings, versions and times as in ``report.json``; may be empty.
    """

    label: str
    name: str
    time: FloatArray
    muscles: tuple[str, ...]
    activation: FloatArray
    is_solved: BoolArray
    stability_rows: tuple[str, ...] = ()
    stability: FloatArray | None = None
    without_stability: FloatArray | None = None
    report: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "muscles", unique_names("muscle", self.muscles))
        set_field(self, "stability_rows", unique_names("stability row", self.stability_rows))
        set_field(self, "report", MappingProxyType(dict(self.report)))
        time = read_only("time", self.time, (-1,), "n_frames")
        set_field(self, "time", time)
        n_frames = len(time)
        solved = read_only_flags("is_solved", self.is_solved, (n_frames,), "n_frames")
        set_field(self, "is_solved", solved)
        if self.stability is None:
            set_field(self, "stability", np.zeros((n_frames, 0)))
        for what, names, axis in (
            ("activation", self.muscles, "n_muscles"),
            ("stability", self.stability_rows, "n_stability_rows"),
        ):
            of_whom = f"{what} of {self.label!r}"
            shape = (n_frames, len(names))
            values = read_only(of_whom, getattr(self, what), shape, f"n_frames, {axis}", finite=False)
            bad = np.argwhere(~np.isfinite(values) & solved[:, None])
            if len(bad):
                k, c = (int(i) for i in bad[0])
                raise DataError(
                    f"{of_whom} is {values[k, c]} for {names[c]} at t = {time[k]:g} s, in a frame that is "
                    "marked as solved, expected a finite number"
                )
            set_field(self, what, values)
        if self.without_stability is not None:
            of_whom = f"activation without stability of {self.label!r}"
            shape = (n_frames, len(self.muscles))
            values = read_only(of_whom, self.without_stability, shape, "n_frames, n_muscles", finite=False)
            set_field(self, "without_stability", values)

    def before_stability(self) -> MotionResult:
        """Give the static optimization that this run began with, as a result of its own.

        Raises
        ------
        DataError
            It was not kept.
        """
        if self.without_stability is None:
            raise DataError(f"{self.label!r} has no static optimization beside it")
        told, problem = self.report.get("without_stability"), self.report.get("problem")
        # the rows are what it is without
        about_rows = ("constraints", "in_short")
        if isinstance(problem, Mapping):
            problem = {key: value for key, value in problem.items() if key not in about_rows}
        return MotionResult(
            label="static optimization",
            name=self.name,
            time=self.time,
            muscles=self.muscles,
            activation=self.without_stability,
            is_solved=np.asarray(np.isfinite(self.without_stability).all(axis=1)),
            report={**(told if isinstance(told, Mapping) else {}), "problem": problem},
        )

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.time)

    @property
    def is_at_rest(self) -> bool:
        """True where the report says that nothing moves in any frame."""
        problem = self.report.get("problem")
        return isinstance(problem, Mapping) and bool(problem.get("at_rest"))


def result_of(solution: Solution, label: str) -> MotionResult:
    """Take from a solution in memory what a comparison needs.

    Parameters
    ----------
    solution : Solution
    label : str

    Returns
    -------
    MotionResult
    """
    # the solver's side of the package, which tables made from result folders do not need
    trajectory = solution.problem.motion.trajectory
    margin = solution.stability
    report = solution.report
    return MotionResult(
        label=label,
        name=trajectory.name,
        time=trajectory.time,
        muscles=trajectory.muscles,
        activation=solution.activation,
        is_solved=solution.is_solved,
        stability_rows=() if margin is None else margin.rows,
        stability=None if margin is None else margin.stability,
        report={
            "summary": solution.summary(),
            "problem": str(solution.problem),
            "objective_terms": dict(solution.objective_terms),
            "violation": dict(solution.violation),
            "solver": report.solver,
            "iterations": report.iterations,
            "build_seconds": report.build_seconds,
            "solve_seconds": report.solve_seconds,
            "options": dict(report.options),
            "versions": dict(report.versions),
        },
    )


@checked
def read_result(folder: str | os.PathLike[str], label: str | None = None) -> MotionResult:
    """Read a result folder back, as written by :func:`scso_nlp.io.results.write_solution`.

    Parameters
    ----------
    folder : path
        Holds ``report.json``, the activation file and, with stability rows, the stability file.
    label : str, optional
        The folder's name by default.

    Returns
    -------
    MotionResult

    Raises
    ------
    DataError
        No such folder, or a run that was not written completely.
    FileFormatError
        A report or table that cannot be read as such, or that do not belong together.
    """
    folder = absolute(folder)
    report = _read_report(folder)
    name = report["name"]
    statuses = report["frame_status"]
    failed = sum(status not in USABLE for status in statuses)
    if failed and not any(folder.glob(f"{glob.escape(name)}_*_activation.sto")):
        raise DataError(
            f"{folder} has no activations, because {failed} of {len(statuses)} frames failed; run again with "
            "--keep-failed for those of the others; scso report of it alone says what is missing"
        )
    table = only_file(folder, name, "activation.sto")
    if len(statuses) != table.n_frames:
        raise FileFormatError(
            f"{folder}: {_REPORT} has {len(statuses)} frames and {table.source} has {table.n_frames}: "
            "they are not of one run"
        )
    muscles = _muscle_names(folder, report, table)
    rows: tuple[str, ...] = ()
    stability = None
    stability_file = folder / f"{name}_stability.sto"
    written = report.get("files_sha256")
    if stability_file.exists() or (isinstance(written, dict) and stability_file.name in written):
        found = read_storage(stability_file)
        if not np.array_equal(found.time, table.time):
            raise FileFormatError(f"{found.source} and {table.source} have different frames")
        suffix = "_stability"
        columns = [label for label in found.labels if label.endswith(suffix)]
        rows = tuple(column.removesuffix(suffix) for column in columns)
        stability = found.columns(columns)
    before = _without_stability(folder / f"{name}_without_stability.sto", table, muscles)
    try:
        return MotionResult(
            label=Path(os.path.realpath(folder)).name if label is None else label,
            name=name,
            time=table.time,
            muscles=tuple(muscles),
            activation=table.columns(muscles),
            is_solved=np.array([status in USABLE for status in statuses]),
            stability_rows=rows,
            stability=stability,
            without_stability=before,
            report=report,
        )
    except DataError as error:
        raise type(error)(f"{folder}: {error}") from None


@checked
def read_results(
    folders: Sequence[str | os.PathLike[str]], labels: Sequence[str] = ()
) -> tuple[MotionResult, ...]:
    """Read several result folders, each under a label of its own.

    Parameters
    ----------
    folders : sequence of path
    labels : sequence of str, optional
        One per folder; otherwise the shortest ends of their paths that differ.

    Returns
    -------
    tuple of MotionResult

    Raises
    ------
    DataError
        Not one label per folder, a folder given twice, or as :func:`read_result`.
    """
    paths = [absolute(os.path.realpath(absolute(folder))) for folder in folders]
    if len(set(paths)) < len(paths):
        raise DataError("a result folder is given twice, expected different ones")
    if not labels:
        depth = 1
        while len({path.parts[-depth:] for path in paths}) < len(paths):
            depth += 1
        labels = ["/".join(path.parts[-depth:]) for path in paths]
    if len(labels) != len(paths):
        raise DataError(f"{len(labels)} labels for {len(paths)} results, expected one each")
    return tuple(read_result(path, label) for path, label in zip(paths, labels, strict=True))


def _read_report(folder: Path) -> dict[str, Any]:
    """Read ``report.json`` and check what is used of it."""
    path = folder / _REPORT
    with refused(folder, "cannot be read"):
        try:
            names = os.listdir(folder)
        except (FileNotFoundError, NotADirectoryError):
            raise DataError(f"{folder} is not a folder, expected one that 'scso run' has written") from None
    if _REPORT not in names:
        raise DataError(
            f"{folder} has no {_REPORT}: it holds no results, or a run that was interrupted; run it again"
        )
    try:
        report = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path} is not JSON: {error}") from None
    expected = {"name": (str, "text"), "frame_status": (list, "a list"), "problem": (dict, "a table")}
    if not isinstance(report, dict) or report.get("program") != "scso_nlp":
        raise FileFormatError(f"{path} is not a report of scso_nlp")
    for key, (kind, words) in expected.items():
        if not isinstance(report.get(key), kind):
            raise FileFormatError(f"{path}: {key!r} is missing or not {words}")
    for status in report["frame_status"]:
        if status not in (*USABLE, *UNUSABLE):
            raise FileFormatError(
                f"{path}: {shown(status)} is no status of a frame, expected one such as {USABLE[0]}"
            )
    if not report["name"] or any(character in report["name"] for character in "/\\\0"):
        raise FileFormatError(f"{path}: the name {shown(report['name'])} cannot be the start of file names")
    return report


def _without_stability(path: Path, table: Storage, muscles: tuple[str, ...]) -> FloatArray | None:
    """Read the activations of the static optimization of a run; None where there is no such file."""
    if not path.exists():
        return None
    found = read_storage(path)
    if not np.array_equal(found.time, table.time):
        raise FileFormatError(f"{found.source} and {table.source} have different frames")
    return found.columns(muscles)


def _muscle_names(folder: Path, report: dict[str, Any], table: Storage) -> tuple[str, ...]:
    """Tell the columns of muscles from those of reserves and residuals."""
    problem = report["problem"]
    names = problem.get("muscle_names")
    if names is None and problem.get("actuators") == 0 and problem.get("muscles") == table.n_columns:
        return table.labels
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise FileFormatError(
            f"{folder / _REPORT} does not say which of the {table.n_columns} columns of the activation file "
            "are muscles, expected problem.muscle_names"
        )
    return tuple(names)


def only_file(folder: Path, name: str, ending: str) -> Storage:
    """Read the one file of a motion with this ending, whatever its analysis is called.

    Raises
    ------
    DataError
        None, or several.
    """
    found = sorted(folder.glob(f"{glob.escape(name)}_*_{ending}"))
    if len(found) != 1:
        raise DataError(
            f"{folder} has {len(found)} files {name}_*_{ending}, expected one"
            + (f": {', '.join(path.name for path in found[:4])}" if found else "")
        )
    return read_storage(found[0])
