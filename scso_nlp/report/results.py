"""Write a solution in OpenSim's own file formats, with statuses, stability, a report and figures.

The files of one run appear whole or not at all: all of them are written into a folder within the target
first. ``report.json`` leaves first and arrives last, so a folder that holds one is complete. Figures are
drawn afterwards, so that whatever fails in them costs no results. What is in the files is said in
:mod:`~scso_nlp.report.contents` and :mod:`~scso_nlp.report.record`.
"""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from scso_nlp.arguments import checked
from scso_nlp.contributions import row_contributions
from scso_nlp.exceptions import DataError
from scso_nlp.files import absolute, check_name, sha256, write_whole
from scso_nlp.io.storage import Storage, write_storage
from scso_nlp.messages import COUNTS, STAGES
from scso_nlp.progress import stages_shown
from scso_nlp.report.contents import RESULT_FILES
from scso_nlp.report.folder import (
    COMPLETE,
    FAILED,
    NEW,
    NO_RESULTS,
    OLD,
    REPORT,
    WITH_GAPS,
    claimed,
    holds_nothing_of_others,
    names_in,
    read_report,
    remove_empty,
    settle,
    worth,
)
from scso_nlp.report.record import RunRecord, report_on
from scso_nlp.signals import undisturbed
from scso_nlp.solution import Solution

_LOG = logging.getLogger("scso_nlp")

#: Version of the layout of ``report.json``.
REPORT_VERSION = 1


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
    overwrite: bool = True,
) -> tuple[Path, ...]:
    """Write all result files of a solution, whole or not at all.

    These are :data:`~scso_nlp.report.contents.RESULT_FILES`, ``report.json`` and figures; README has a table
    of them.

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
        Of the same motion without stability rows; drawn in the figures, its activations written.
    figures : bool
        What fails in a figure costs only that figure, with a warning.
    overwrite : bool
        Results of other inputs in that folder are replaced. Otherwise they stay, and the first of
        ``folder_2``, ``folder_3``, ... without such results is taken; the inputs are those of `record`.

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

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     files = scso.write_solution(solution, folder, figures=False)
    >>> files[0].name
    'elbow_StaticOptimization_activation.sto'
    """
    name, record = solution.problem.motion.trajectory.name, record or RunRecord()
    wanted = absolute(folder)
    for part in (name, analysis_name):
        check_name(part)
    is_complete = bool(solution.is_solved.all())
    has_results = keep_failed or is_complete
    report = report_on(solution, record, baseline)
    makers = {
        file.name.format(name=name, analysis=analysis_name): functools.partial(file.content, subject)
        for file in RESULT_FILES
        if has_results or not file.is_result
        if (subject := baseline if file.of_baseline else solution) is not None
    }
    own = _own_files(name, analysis_name)

    def is_free(place: Path) -> bool:
        setup = record.settings.get("setup")
        return overwrite or holds_nothing_of_others(place, own, name, record.inputs, setup)

    try:
        with claimed(wanted, is_free) as kept:
            place = kept
            if worth(kept) > (COMPLETE if is_complete else WITH_GAPS if has_results else NO_RESULTS):
                place = kept / FAILED
            report = _put(report, place, own, makers)
            if place == kept:
                _remove_failed(kept / FAILED, name, own)
            else:
                _LOG.warning("this run is in %s, because it failed: earlier results in %s stay", place, kept)
            if has_results and figures:
                STAGES.info("drawing figures; the results can be read already, in %s", place)
                started = time.perf_counter()
                _write_figures(solution, place, baseline)
                try:
                    _write_report(_with_seconds(report, figures=time.perf_counter() - started), place, own)
                except DataError as error:
                    _LOG.warning("the report lacks the figures: %s", error)
            return tuple(place / file for file in (*_found(place, own), REPORT))
    except OSError as error:
        raise DataError(f"results cannot be written to {wanted}: {error.strerror or error}") from None


def _own_files(name: str, analysis_name: str) -> re.Pattern[str]:
    """Match whole names of files that a run of this name may write, but for the report."""
    own, analysis = re.escape(name), re.escape(analysis_name)
    patterns = [file.name.replace(".", r"\.") for file in RESULT_FILES]
    patterns += [f"{{name}}_{figure}\\.(png|pdf)" for figure in FIGURES]
    return re.compile("|".join(pattern.format(name=own, analysis=analysis) for pattern in patterns))


def _found(folder: Path, own: re.Pattern[str]) -> list[str]:
    return [name for name in names_in(folder) if own.fullmatch(name)]


def _put(
    report: Mapping[str, Any],
    folder: Path,
    own: re.Pattern[str],
    makers: Mapping[str, Callable[[], Storage | Iterable[str] | None]],
) -> dict[str, Any]:
    """Put files and report in place of those in a folder that match `own`, or leave those there.

    Returns the report as it was written, with the time that the other files took.
    """
    new, old = folder / NEW, folder / OLD
    try:
        new.mkdir(parents=True)
        started = time.perf_counter()
        for file, make in makers.items():
            _write(make(), new / file)
        told = _with_seconds(report, writing=time.perf_counter() - started)
        _write_report(told, new, own)
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
    return told


def _remove_failed(folder: Path, name: str, own: re.Pattern[str]) -> None:
    """Remove what an earlier run of this name left when it failed."""
    if (read_report(folder) or {}).get("name") != name:
        return
    with contextlib.suppress(OSError):
        for file in (REPORT, *_found(folder, own)):
            (folder / file).unlink()
    remove_empty(folder)


def _write(content: Storage | Iterable[str] | None, path: Path) -> None:
    if isinstance(content, Storage):
        write_storage(content, path, allow_nonfinite=True)
    elif content is not None:
        with open(path, "w", encoding="utf-8", newline="") as file:
            file.writelines(content)


#: How each figure is drawn by :mod:`scso_nlp.figures`, which is handed in because matplotlib takes half a
#: second to import and only figures need it; None where there is nothing to draw. One entry per figure.
FIGURES: dict[str, Callable[[Any, Solution, Solution | None], Any]] = {
    "activations": lambda draw, solution, baseline: draw.activation_pages(solution, baseline=baseline),
    "moments": lambda draw, solution, _: draw.plot_moments(solution),
    "stability": lambda draw, solution, baseline: (
        draw.plot_stability(solution, baseline=baseline) if _has_rows(solution) else None
    ),
    "contributions": lambda draw, solution, _: (
        draw.plot_contributions(row_contributions(solution))
        if _has_rows(solution) and solution.problem.motion.trajectory.muscles
        else None
    ),
    "joint_reactions": lambda draw, solution, baseline: (
        draw.plot_joint_reactions(solution, baseline=baseline)
        if solution.problem.motion.trajectory.joint_reactions is not None and solution.is_solved.any()
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
    with stages_shown():
        for what, draw in FIGURES.items():
            COUNTS.info("drawing figures, %s; the results can be read already, in %s", what, folder)
            figures.draw_and_save(
                functools.partial(draw, figures, solution, baseline), folder, f"{name}_{what}"
            )


def _with_seconds(report: Mapping[str, Any], **seconds: float) -> dict[str, Any]:
    return {**report, "seconds": {**report["seconds"], **seconds}}


def _write_report(report: Mapping[str, Any], folder: Path, own: re.Pattern[str]) -> None:
    """Write the report about a folder, with the hashes of the files that are there."""
    files = {name: sha256(folder / name) for name in _found(folder, own)}
    text = json.dumps({**report, "files_sha256": files}, indent=1, ensure_ascii=False, allow_nan=False)
    with write_whole(folder / REPORT) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
