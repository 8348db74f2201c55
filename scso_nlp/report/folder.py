"""What a results folder holds already, and where new results may go so that nothing is lost.

While results are written their folder belongs to one process: a lock that ends with the process keeps others
waiting. So whatever a run has left half done in it is of a run that was killed, and the next one settles it.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from scso_nlp.exceptions import DataError
from scso_nlp.files import lock
from scso_nlp.solution import Status

_LOG = logging.getLogger("scso_nlp")

#: File that completes a folder of results.
REPORT = "report.json"
#: Folder within that of the results for a run that failed, while they stay.
FAILED = "failed"
#: Folders within that of the results: of what is not there yet, and of what was.
NEW, OLD = ".scso_new", ".scso_old"
#: Names of files that were being written whole when a run was killed.
_CUT_OFF = re.compile(r"\.[0-9a-f]{32}\.(report\.json|.*\.(png|pdf))")
#: How much the results of a run are worth: none, with gaps, all frames solved.
NO_RESULTS, WITH_GAPS, COMPLETE = range(3)


@contextlib.contextmanager
def claimed(
    wanted: Path, is_free: Callable[[Path], bool], others: str = "results of other inputs"
) -> Iterator[Path]:
    """Keep a folder for oneself: the first of `wanted`, `wanted_2`, ... that is free.

    Parameters
    ----------
    wanted : Path
    is_free : callable
        Tells of a folder whether results may go there; it is asked while the folder is kept.
    others : str
        What folders hold that are not free.

    Yields
    ------
    Path
        Exists within the block. If it was not there before and is empty in the end, it is removed.

    Raises
    ------
    DataError
        `wanted` is a file.
    OSError
        The folder cannot be made.
    """
    for folder in _candidates(wanted):
        if folder.is_file():
            if folder == wanted:
                raise DataError(f"{folder} is a file, expected a folder for the results")
            continue
        with _alone_in(folder):
            if is_free(folder):
                if folder != wanted:
                    _LOG.warning(
                        "%s has %s, which stay; those of this run go to %s",
                        wanted,
                        others,
                        folder,
                    )
                yield folder
                return


def holds_nothing_of_others(
    folder: Path, own: re.Pattern[str], name: str, inputs: Mapping[str, str], setup: object
) -> bool:
    """Tell whether a folder has no files of these names, or those of an earlier run on the same inputs.

    Parameters
    ----------
    folder : Path
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
    bool
    """
    report = read_report(folder)
    if report is None:
        return not any(name == REPORT or own.fullmatch(name) for name in names_in(folder))
    found = _origin(report["name"], report["inputs_sha256"], report["settings"].get("setup"))
    return found == _origin(name, inputs, setup)


def refuse_unwritable(folder: Path) -> None:
    """Raise if results cannot be written to a folder, before hours are spent on them.

    Raises
    ------
    DataError
        It is a file, has an impossible name, or neither it nor what it would be made in may be written to.
    """
    try:
        os.stat(folder)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise DataError(f"results cannot be written to {folder}: {error.strerror or error}") from None
    nearest = next(path for path in (folder, *folder.parents) if os.path.exists(path))
    if not os.path.isdir(nearest):
        raise DataError(f"{nearest} is a file, expected a folder for the results")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise DataError(
            f"results cannot be written to {folder}: {nearest} may not be written to; name another folder "
            "by output"
        )


def settle(folder: Path) -> None:
    """Take back a move of results that did not come to its end, and remove what was left of it.

    A move has begun when `OLD` is there, and ended when the new report has left `NEW`. Each step may be
    interrupted and done again.
    """
    new, old = folder / NEW, folder / OLD
    if old.is_dir() and (new / REPORT).is_file():
        for name in (read_report(new) or {}).get("files_sha256", {}):
            if not (new / name).exists() and (folder / name).exists():
                os.replace(folder / name, new / name)
        for name in sorted(names_in(old), key=REPORT.__eq__):
            os.replace(old / name, folder / name)
    for leftover in (new, old):
        shutil.rmtree(leftover, ignore_errors=True)
    for name in names_in(folder):
        if _CUT_OFF.fullmatch(name):
            (folder / name).unlink(missing_ok=True)


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    is_made = not folder.exists()
    with _locked(folder):
        try:
            for place in (folder, folder / FAILED):
                settle(place)
            yield
        finally:
            if is_made:
                remove_empty(folder)


def remove_empty(folder: Path) -> None:
    """Remove a folder if nothing is in it."""
    with contextlib.suppress(OSError):
        folder.rmdir()


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Make a folder and keep it locked; where the system knows no such locks it is only made."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = lock(folder)
        except BlockingIOError:
            _LOG.warning("%s is being written to by another run; waiting for it", folder)
            descriptor = lock(folder, wait=True)
        if descriptor is None:
            yield
            return
        try:
            # the other run may have removed it
            if folder.is_dir() and os.path.samestat(os.fstat(descriptor), folder.stat()):
                yield
                return
        finally:
            os.close(descriptor)


def _candidates(wanted: Path) -> Iterator[Path]:
    yield wanted
    for number in itertools.count(2):
        yield wanted.with_name(f"{wanted.name}_{number}")


def _origin(name: str, inputs: Mapping[str, str], setup: object) -> frozenset[tuple[str, str]]:
    """Tell runs on other inputs apart: names and hashes of the inputs, of setup files the names alone."""
    setup = "" if setup is None else str(setup)
    files = {
        (Path(path).name, "" if os.path.abspath(path) == setup else digest)
        for path, digest in inputs.items()
        if not path.lower().endswith((".toml", ".csv"))
    }
    return frozenset(files | {("", name)})


def worth(folder: Path) -> int:
    """Say what results a folder holds: NO_RESULTS, WITH_GAPS or COMPLETE, also if their origin is unknown."""
    if not any(name.endswith("_activation.sto") for name in names_in(folder)):
        return NO_RESULTS
    report = read_report(folder)
    unsolved = {status.name for status in Status if not status.is_solved}
    return WITH_GAPS if report and unsolved.intersection(report["frame_status"]) else COMPLETE


def failed_run(folder: Path) -> dict[str, Any] | None:
    """Read the report of a run that left no results: in a folder, or in `FAILED` within it.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict of str to object or None
        None where the folder has results, or no report that can be read.
    """
    if worth(folder) != NO_RESULTS:
        return None
    return read_report(folder) or read_report(folder / FAILED)


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
