"""What a results folder holds already, and where new results may go so that nothing is lost."""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from scso_nlp.solution import Status

#: File that completes a folder of results.
REPORT = "report.json"
#: Folder within that of the results for a run that failed, while they stay.
FAILED = "failed"
#: How much the results of a run are worth: none, with gaps, all frames solved.
NO_RESULTS, WITH_GAPS, COMPLETE = range(3)


def free_folder(
    wanted: Path, own: re.Pattern[str], name: str, inputs: Mapping[str, str], setup: object
) -> Path:
    """Find the first of `wanted`, `wanted_2`, ... that holds nothing of other inputs.

    Parameters
    ----------
    wanted : Path
    own : pattern
        Matches the names of the files to be written.
    name : str
        Of the motion.
    inputs : mapping of str to str
        SHA-256 of every input file, by path.
    setup : path or None
        The one of them that is the setup file. Like a settings file it may change from run to run.

    Returns
    -------
    Path
        Not there, without files of these names, or with those of an earlier run on the same inputs.
    """
    ours = _origin(name, inputs, setup)
    # `wanted` that is a file is refused where it is written to
    return next(
        folder
        for folder in _candidates(wanted)
        if (folder == wanted or not os.path.isfile(folder)) and _is_free(folder, own, ours)
    )


def _candidates(wanted: Path) -> Iterator[Path]:
    yield wanted
    for number in itertools.count(2):
        yield wanted.with_name(f"{wanted.name}_{number}")


def _is_free(folder: Path, own: re.Pattern[str], ours: frozenset[tuple[str, str]]) -> bool:
    report = read_report(folder)
    if report is None:
        return not any(name == REPORT or own.fullmatch(name) for name in names_in(folder))
    return _origin(report["name"], report["inputs_sha256"], report["settings"].get("setup")) == ours


def _origin(name: str, inputs: Mapping[str, str], setup: object) -> frozenset[tuple[str, str]]:
    """Tell runs on other inputs apart: names and hashes of the inputs, of setup files the names alone."""
    setup = "" if setup is None else str(setup)
    files = {
        (Path(path).name, "" if os.path.abspath(path) == setup else digest)
        for path, digest in inputs.items()
        if not path.lower().endswith(".toml")
    }
    return frozenset(files | {("", name)})


def worth(folder: Path) -> int:
    """Say what results a folder holds: NO_RESULTS, WITH_GAPS or COMPLETE, also if their origin is unknown."""
    if not any(name.endswith("_activation.sto") for name in names_in(folder)):
        return NO_RESULTS
    report = read_report(folder)
    unsolved = {status.name for status in Status if not status.is_solved}
    return WITH_GAPS if report and unsolved.intersection(report["frame_status"]) else COMPLETE


def names_in(folder: Path) -> list[str]:
    """Names in a folder, in order; none where it cannot be read, which is said when it is written to."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []


def read_report(folder: Path) -> dict[str, Any] | None:
    """Read the report of a folder; None without one of this program that can be read."""
    try:
        report = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    kinds = {"name": str, "settings": dict, "inputs_sha256": dict, "frame_status": list}
    is_ours = isinstance(report, dict) and all(isinstance(report.get(k), kinds[k]) for k in kinds)
    return report if is_ours else None
