"""Write a solution in OpenSim's own file formats, with statuses, stability, a report and figures.

The files of one run appear whole or not at all: all of them are written into a folder within the target
first. ``report.json`` leaves first and arrives last, so a folder that holds one is complete. Figures are
drawn afterwards, so that whatever fails in them costs no results.
"""

from __future__ import annotations

import contextlib
import datetime
import functools
import json
import logging
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.contributions import row_contributions
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.files import absolute, check_name, sha256, write_whole
from scso_nlp.io.storage import Storage, write_storage
from scso_nlp.report.folder import (
    COMPLETE,
    FAILED,
    NEW,
    NO_RESULTS,
    OLD,
    REPORT,
    WITH_GAPS,
    claimed,
    names_in,
    read_report,
    remove_empty,
    settle,
    worth,
)
from scso_nlp.signals import undisturbed
from scso_nlp.solution import InfeasibilityProof, MatrixResult, RowResult, Solution, Status
from scso_nlp.validation import FloatArray

_LOG = logging.getLogger("scso_nlp")

#: Numbers that stand for a frame's status in the status file.
STATUS_CODES = {
    Status.SOLVED: 0,
    Status.ACCEPTABLE: 1,
    Status.INFEASIBLE: 2,
    Status.ITERATION_LIMIT: 3,
    Status.NUMERICAL_ERROR: 4,
    Status.NOT_OPTIMAL: 5,
    Status.STABILITY_MISSED: 6,
    Status.LOCALLY_INFEASIBLE: 7,
}
#: Violation of a frame that has no iterate, in the status file: OpenSim's Storage stops reading at NaN.
NO_ITERATE = -1.0
#: Version of the layout of ``report.json``.
REPORT_VERSION = 1

_ACTIVATION_DESCRIPTION = "This file contains static optimization results.\n\n"
_FORCE_DESCRIPTION = (
    "\nThis file contains the forces exerted on a model during a simulation.\n\n"
    "A force is a generalized force, meaning that it can be either a force (N) or a torque (Nm).\n\n"
    "Units are S.I. units (second, meters, Newtons, ...)\n"
    "If the header above contains a line with 'inDegrees', this indicates whether rotational values are in "
    "degrees (yes) or radians (no).\n\n"
)
_STABILITY_DESCRIPTION = (
    "Per row (joint axis or coordinate): stability S, level and margin S - level in N.m/rad; and, where\n"
    "the solver gives one, the multiplier: the cost in the objective per N.m/rad of extra stability; and\n"
    "of levels that may be missed at a price, what is missed in N.m/rad. For a whole Hessian: its smallest\n"
    "eigenvalue, levels taken off, and mode: the turn that belongs to it.\n"
)
_CONTROL_HEAD = """\t\t\t<ControlLinear name={name}>
\t\t\t\t<is_model_control>true</is_model_control>
\t\t\t\t<extrapolate>true</extrapolate>
\t\t\t\t<default_min>0.02</default_min>
\t\t\t\t<default_max>1</default_max>
\t\t\t\t<filter_on>false</filter_on>
\t\t\t\t<use_steps>false</use_steps>
\t\t\t\t<x_nodes>
"""
_CONTROL_NODE = """\t\t\t\t\t<ControlLinearNode>
\t\t\t\t\t\t<t>{time}</t>
\t\t\t\t\t\t<value>{value}</value>
\t\t\t\t\t</ControlLinearNode>
"""
_CONTROL_TAIL = """\t\t\t\t</x_nodes>
\t\t\t\t<min_nodes />
\t\t\t\t<max_nodes />
\t\t\t\t<kp>100</kp>
\t\t\t\t<kv>20</kv>
\t\t\t</ControlLinear>
"""


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """What the report says beyond the solution itself.

    Attributes
    ----------
    inputs : mapping of str to str
        SHA-256 of every input file, by path.
    settings : mapping of str to object
        Settings of the run.
    seconds : mapping of str to float [s]
        Wall times beside those of the solver, e.g. of the extraction.
    notes : tuple of str
        What was assumed or approximated, one sentence each.
    """

    inputs: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@checked
def write_solution(
    solution: Solution,
    folder: str | os.PathLike[str],
    *,
    analysis_name: str = "StaticOptimization",
    record: RunRecord | None = None,
    keep_failed: bool = False,
    baseline: Solution | None = None,
    figures: bool = True,
) -> tuple[Path, ...]:
    """Write all result files of a solution, whole or not at all.

    With the trajectory's name N and the analysis name A: ``N_A_activation.sto``, ``N_A_force.sto`` and
    ``N_A_controls.xml`` with OpenSim's titles and columns, ``N_stability.sto`` if there are stability rows,
    ``N_status.sto``, ``report.json`` and figures.

    Parameters
    ----------
    solution : Solution
    folder : path
        Made if it is not there. Files of an earlier run of the same name are replaced; other files stay. A
        run with failed frames does not replace results without any: its files go into the sub-folder
        ``failed``, which the next run that may replace them removes.
    analysis_name : str
        OpenSim's name of the analysis.
    record : RunRecord, optional
        Input hashes, settings, times and notes for the report.
    keep_failed : bool
        Write results although some frame is not solved; those frames are NaN in every result file.
        Without it such a run leaves the status file and the report only.
    baseline : Solution, optional
        Of the same motion; drawn in the figures, not written.
    figures : bool
        What fails in a figure costs only that figure, with a warning.

    Returns
    -------
    tuple of Path
        The files written.

    Raises
    ------
    DataError
        A name that cannot be part of a file name, or files that cannot be written.
    NameMismatchError
        A column of the force file that is no muscle, no actuator and no other force.

    Notes
    -----
    OpenSim's ``Storage`` reads a file up to the first NaN, so files with failed frames are for other
    readers.
    """
    return write_where_free(
        solution,
        absolute(folder),
        lambda _: True,
        analysis_name=analysis_name,
        record=record,
        keep_failed=keep_failed,
        baseline=baseline,
        figures=figures,
    )


def write_where_free(
    solution: Solution,
    wanted: Path,
    is_free: Callable[[Path], bool],
    *,
    analysis_name: str,
    record: RunRecord | None,
    keep_failed: bool,
    baseline: Solution | None,
    figures: bool,
) -> tuple[Path, ...]:
    """Write all result files of a solution into the first of `wanted`, `wanted_2`, ... that is free.

    Parameters
    ----------
    solution : Solution
    wanted : Path
        Absolute.
    is_free : callable
        As for :func:`~scso_nlp.report.folder.claimed`.
    analysis_name, record, keep_failed, baseline, figures
        As for :func:`write_solution`.

    Returns
    -------
    tuple of Path
        The files written.

    Raises
    ------
    DataError, NameMismatchError
        As for :func:`write_solution`.
    """
    name, record = solution.problem.motion.trajectory.name, record or RunRecord()
    for part in (name, analysis_name):
        check_name(part)
    is_complete = bool(solution.is_solved.all())
    has_results = keep_failed or is_complete
    report = _report(solution, record, baseline)
    makers = (RESULT_FILES if has_results else {}) | STATUS_FILE
    own = own_files(name, analysis_name)
    try:
        with claimed(wanted, is_free) as folder:
            earlier = folder
            if worth(folder) > (COMPLETE if is_complete else WITH_GAPS if has_results else NO_RESULTS):
                folder /= FAILED
            _put(
                solution,
                report,
                folder,
                own,
                {p.format(name=name, analysis=analysis_name): m for p, m in makers.items()},
            )
            if folder == earlier:
                _remove_failed(folder / FAILED, name, own)
            else:
                _LOG.warning(
                    "this run is in %s, because it failed: earlier results in %s stay", folder, earlier
                )
            if has_results and figures:
                _write_figures(solution, folder, baseline)
                try:
                    _write_report(report, folder, own)
                except DataError as error:
                    _LOG.warning("the report lacks the figures: %s", error)
            return tuple(folder / file for file in (*_found(folder, own), REPORT))
    except OSError as error:
        raise DataError(f"results cannot be written to {wanted}: {error.strerror or error}") from None


def own_files(name: str, analysis_name: str) -> re.Pattern[str]:
    """Match every file that a run of this name may write, but for the report.

    Parameters
    ----------
    name : str
        Of the motion.
    analysis_name : str

    Returns
    -------
    pattern
        Of whole file names.
    """
    own, analysis = re.escape(name), re.escape(analysis_name)
    patterns = [pattern.replace(".", r"\.") for pattern in RESULT_FILES | STATUS_FILE]
    patterns += [f"{{name}}_{figure}\\.(png|pdf)" for figure in FIGURES]
    return re.compile("|".join(pattern.format(name=own, analysis=analysis) for pattern in patterns))


def _found(folder: Path, own: re.Pattern[str]) -> list[str]:
    return [name for name in names_in(folder) if own.fullmatch(name)]


def _put(
    solution: Solution,
    report: Mapping[str, Any],
    folder: Path,
    own: re.Pattern[str],
    makers: Mapping[str, Callable[[Solution], Storage | str | None]],
) -> None:
    """Put files and report in place of those in a folder that match `own`, or leave those there."""
    new, old = folder / NEW, folder / OLD
    try:
        new.mkdir(parents=True)
        for file, make in makers.items():
            _write(make(solution), new / file)
        _write_report(report, new, own)
        old.mkdir()
        for file in (REPORT, *_found(folder, own)):
            with contextlib.suppress(FileNotFoundError):
                os.replace(folder / file, old / file)
        for file in (*_found(new, own), REPORT):
            os.replace(new / file, folder / file)
    finally:
        with undisturbed():
            settle(folder)
        if folder.name == FAILED:
            remove_empty(folder)


def _remove_failed(folder: Path, name: str, own: re.Pattern[str]) -> None:
    """Remove what an earlier run of this name left when it failed."""
    if (read_report(folder) or {}).get("name") != name:
        return
    with contextlib.suppress(OSError):
        for file in (REPORT, *_found(folder, own)):
            (folder / file).unlink()
    remove_empty(folder)


def _write(content: Storage | str | None, path: Path) -> None:
    if isinstance(content, Storage):
        write_storage(content, path, allow_nonfinite=True)
    elif content is not None:
        path.write_text(content, encoding="utf-8")


def _activation(solution: Solution) -> Storage:
    """Activations of muscles and controls of actuators."""
    labels, values = _controls(solution)
    return _storage(solution, "Static Optimization", labels, values, _ACTIVATION_DESCRIPTION)


def _controls_file(solution: Solution) -> str:
    """Text of a ControlSet with the same numbers."""
    return _controls_xml(*_controls(solution), solution.problem.motion.trajectory.time)


def _force(solution: Solution) -> Storage:
    """Give forces of muscles, actuators and all else that OpenSim records."""
    trajectory, columns = solution.problem.motion.trajectory, _force_columns(solution)
    others = dict(zip(trajectory.other_force_labels, trajectory.other_forces.T, strict=True))
    forces = {**others, **_by_name(solution, solution.tendon_force, solution.actuator_force)}
    missing = [name for name in columns if name not in forces]
    if missing:
        raise NameMismatchError(
            f"the force file needs {', '.join(missing)}, which are no muscle, actuator or other force"
        )
    values = _table(columns, forces, ~solution.is_solved)
    return _storage(solution, "ModelForces", columns, values, _FORCE_DESCRIPTION)


def _force_columns(solution: Solution) -> tuple[str, ...]:
    trajectory = solution.problem.motion.trajectory
    return trajectory.force_columns or (
        *trajectory.muscles,
        *trajectory.actuators,
        *trajectory.other_force_labels,
    )


def _controls(solution: Solution) -> tuple[tuple[str, ...], FloatArray]:
    """Names and values of activations and controls, in the order of the force file."""
    unknowns = _by_name(solution, solution.activation, solution.control)
    labels = tuple(name for name in _force_columns(solution) if name in unknowns)
    labels += tuple(name for name in unknowns if name not in labels)
    return labels, _table(labels, unknowns, ~solution.is_solved)


def _by_name(solution: Solution, of_muscles: FloatArray, of_actuators: FloatArray) -> dict[str, FloatArray]:
    trajectory = solution.problem.motion.trajectory
    columns = dict(zip(trajectory.muscles, of_muscles.T, strict=True))
    return columns | dict(zip(trajectory.actuators, of_actuators.T, strict=True))


def _table(labels: tuple[str, ...], columns: Mapping[str, FloatArray], failed: np.ndarray) -> FloatArray:
    table = np.empty((failed.size, len(labels)))
    for i, label in enumerate(labels):
        table[:, i] = columns[label]
    table[failed] = np.nan
    return table


def _storage(
    solution: Solution, title: str, labels: tuple[str, ...], values: FloatArray, description: str
) -> Storage:
    return Storage(
        name=title,
        labels=labels,
        time=solution.problem.motion.trajectory.time,
        values=values,
        in_degrees=False,
        description=description,
    )


def _controls_xml(labels: tuple[str, ...], values: FloatArray, time: FloatArray) -> str:
    """Text of a ControlSet with one linear control per actuator, as OpenSim 4.6 writes it."""
    pieces = [
        '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40600">\n'
        '\t<ControlSet name="Control Set">\n\t\t<objects>\n'
    ]
    times = [f"{t:.17g}" for t in time]
    for i, label in enumerate(labels):
        pieces.append(_CONTROL_HEAD.format(name=quoteattr(label)))
        pieces += [
            _CONTROL_NODE.format(time=t, value="NaN" if math.isnan(value) else f"{value:.17g}")
            for t, value in zip(times, values[:, i].tolist(), strict=True)
        ]
        pieces.append(_CONTROL_TAIL)
    pieces.append("\t\t</objects>\n\t\t<groups />\n\t</ControlSet>\n</OpenSimDocument>\n")
    return "".join(pieces)


def _stability(solution: Solution) -> Storage | None:
    """Stability rows, if there are any."""
    margin = solution.stability
    if margin is None:
        return None
    n_frames = len(margin.stability)
    labels: list[str] = []
    columns: list[FloatArray] = []
    for r, row in enumerate(margin.rows):
        labels += [f"{row}_stability", f"{row}_level", f"{row}_margin"]
        columns += [margin.stability[:, r], np.full(n_frames, margin.level[r]), margin.margin[:, r]]
        solved = np.isfinite(margin.stability[:, r])
        if np.isfinite(margin.multiplier[solved, r]).all():
            labels.append(f"{row}_multiplier")
            columns.append(margin.multiplier[:, r])
    for term in solution.problem.stability_terms:
        if term.soft is not None and term.name in solution.kept:
            missed = solution.kept[term.name].missed_by_row
            labels += [f"{row}_missed" for row in missed]
            columns += list(missed.values())
    labels += [f"mode_{name}" for name in margin.mode_coordinates]
    columns += list(margin.mode.T)
    values = np.column_stack(columns)
    values[np.isnan(margin.stability).all(axis=1)] = np.nan
    return _storage(solution, "Joint Stability", tuple(labels), values, _STABILITY_DESCRIPTION)


def _status(solution: Solution) -> Storage:
    """Status of every frame, and what it misses."""
    codes = [f"{code} {status.name}: {status.value}\n" for status, code in STATUS_CODES.items()]
    description = (
        "One status per frame:\n" + "".join(codes) + "Violations in each constraint's own unit "
        f"(N.m, N or N.m/rad), {NO_ITERATE:g} where there is no iterate.\n"
    )
    columns = {"status": np.array([float(STATUS_CODES[status]) for status in solution.frame_status])}
    columns |= {f"violation_{name}": _violation(rows) for name, rows in solution.kept.items()}
    values = np.column_stack(list(columns.values()))
    return _storage(solution, "Solver Status", tuple(columns), values, description)


def _violation(rows: RowResult | MatrixResult) -> FloatArray:
    """Largest violation of each frame, shape (n_frames,) [the row's unit]."""
    excess = rows.violation.reshape(len(rows.violation), -1)
    return np.where(np.isfinite(excess), excess, NO_ITERATE).max(axis=1, initial=NO_ITERATE)


#: What each result file holds, by its name; a file whose content is None is not written. One line per file.
RESULT_FILES: dict[str, Callable[[Solution], Storage | str | None]] = {
    "{name}_{analysis}_activation.sto": _activation,
    "{name}_{analysis}_force.sto": _force,
    "{name}_{analysis}_controls.xml": _controls_file,
    "{name}_stability.sto": _stability,
}
#: Also written where frames failed and there are no results.
STATUS_FILE: dict[str, Callable[[Solution], Storage | str | None]] = {"{name}_status.sto": _status}


#: How each figure is drawn by :mod:`scso_nlp.figures`, which is handed in because matplotlib takes half a
#: second to import and only figures need it; None where there is nothing to draw. One entry per figure.
FIGURES: dict[str, Callable[[Any, Solution, Solution | None], Any]] = {
    "activations": lambda draw, solution, baseline: draw.plot_activations(solution, baseline=baseline),
    "moments": lambda draw, solution, _: draw.plot_moments(solution),
    "stability": lambda draw, solution, baseline: (
        draw.plot_stability(solution, baseline=baseline) if _has_rows(solution) else None
    ),
    "contributions": lambda draw, solution, _: (
        draw.plot_contributions(row_contributions(solution))
        if _has_rows(solution) and solution.problem.motion.trajectory.muscles
        else None
    ),
}


def _has_rows(solution: Solution) -> bool:
    """Tell whether there are stability rows, and a solved frame to show them in."""
    return solution.stability is not None and bool(solution.stability.rows) and bool(solution.is_solved.any())


def _write_figures(solution: Solution, folder: Path, baseline: Solution | None) -> None:
    with undisturbed():
        from scso_nlp import figures

    name = solution.problem.motion.name
    for what, draw in FIGURES.items():
        figures.draw_and_save(functools.partial(draw, figures, solution, baseline), folder, f"{name}_{what}")


def _write_report(report: Mapping[str, Any], folder: Path, own: re.Pattern[str]) -> None:
    """Write the report about a folder, with the hashes of the files that are there."""
    files = {name: sha256(folder / name) for name in _found(folder, own)}
    text = json.dumps({**report, "files_sha256": files}, indent=1, ensure_ascii=False, allow_nan=False)
    with write_whole(folder / REPORT) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _report(solution: Solution, record: RunRecord, baseline: Solution | None) -> dict[str, Any]:
    problem = solution.problem
    trajectory = problem.motion.trajectory
    balance = solution.moment_balance
    statuses = solution.frame_status
    counts = {status.name: statuses.count(status) for status in Status if status in statuses}
    report = {
        "program": "scso_nlp",
        "report_version": REPORT_VERSION,
        "written": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "name": trajectory.name,
        "summary": solution.summary(),
        "status": solution.status.name,
        "problem": {
            "frames": trajectory.n_frames,
            "initial_time": trajectory.time[0],
            "final_time": trajectory.time[-1],
            "muscles": len(trajectory.muscles),
            "muscle_names": list(trajectory.muscles),
            "actuators": len(trajectory.actuators),
            "coordinates": list(trajectory.coordinates),
            "muscle_model": repr(problem.muscle_model),
            "objectives": [repr(term) for term in problem.objectives],
            "constraints": [repr(term) for term in problem.constraints],
        },
        "settings": dict(record.settings),
        "inputs_sha256": dict(record.inputs),
        "files_sha256": {},
        "versions": dict(solution.report.versions),
        "solver": {
            "name": solution.report.solver,
            "options": dict(solution.report.options),
            "iterations": solution.report.iterations,
            "frames_kept_by_static_optimization": solution.report.kept_frames if baseline else None,
        },
        "seconds": {
            **record.seconds,
            "build": solution.report.build_seconds,
            "solve": solution.report.solve_seconds,
        },
        "objective": {"total": solution.objective, "terms": dict(solution.objective_terms)},
        "largest_violation": dict(solution.violation),
        "actuator_share": dict(zip(balance.coordinates, balance.actuator_share.tolist(), strict=True)),
        "status_counts": counts,
        "frame_status": [status.name for status in statuses],
        "verdict": {
            **asdict(solution.verdict),
            "lines": solution.verdict.lines(baseline.verdict if baseline else None),
        },
        "shortfalls": [{**asdict(item), "text": str(item)} for item in solution.shortfalls],
        "infeasibility": [_proof(proof) for proof in solution.infeasibility],
        "notes": list(record.notes),
    }
    plain: dict[str, Any] = _plain(report)
    return plain


def _proof(proof: InfeasibilityProof) -> dict[str, object]:
    """Which rows exclude each other, with what multipliers; their entries follow from the inputs."""
    rows = zip(
        proof.constraints, proof.rows, proof.frames, proof.multipliers, proof.units, proof.turns, strict=True
    )
    return {
        "frame": proof.frame,
        "time": proof.time,
        "margin": proof.margin,
        "text": str(proof),
        "rows": [
            {"constraint": name, "row": row, "frame": k, "multiplier": y, "unit": f"1/({unit})", "turn": turn}
            for name, row, k, y, unit, turn in rows
        ],
    }


def _plain(value: Any) -> Any:
    """Turn NumPy numbers, tuples and paths into what JSON has; NaN becomes null, infinity text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)
