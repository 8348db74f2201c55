"""Worker processes: their folder, their start and their end.

A worker takes about as long to import OpenSim as this process takes to import all else, so it may be started
before its job is known, and waits for it. Nothing here needs NumPy: it is at hand before that.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from scso_nlp import exceptions
from scso_nlp.files import lock
from scso_nlp.signals import undisturbed

#: What a worker runs: this copy of the package, whatever else is installed or lies in the current folder.
PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
import scso_nlp
del sys.path[0]
from scso_nlp.opensim.worker.process import main
sys.exit(main(sys.argv[2:]))
"""
#: Names of folders for temporary files start with it.
TEMPORARY = "scso_worker_"
#: How long a worker may take to end after it was asked to [s].
PATIENCE = 5.0
#: Before it is known how many there is work for, no more are started than this.
MOST_WAITING = 4


class Workers:
    """Processes that wait in a folder of their own for a job, do it once, and end.

    Public are the `folder` and the `processes`.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[subprocess.Popen[str]] = []

    def become(self, n_workers: int) -> None:
        """Start processes, or end some, until there are so many."""
        while len(self.processes) < n_workers:
            with undisturbed():
                self.processes.append(_start(self.folder, len(self.processes)))
        with undisturbed():
            _end(self.processes[n_workers:])
            _close(self.processes[n_workers:])
            del self.processes[n_workers:]

    def begin(self) -> None:
        """Tell all that their job is in the folder, and how many they are."""
        for process in self.processes:
            assert process.stdin is not None
            # that one has died is heard where its messages are
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(f"{len(self.processes)}\n")
                process.stdin.flush()

    def end(self) -> None:
        """End all processes."""
        with undisturbed():
            _end(self.processes)


#: Workers that were started early, with what ends them.
_waiting: list[tuple[contextlib.ExitStack, Workers]] = []


@contextlib.contextmanager
def started_early(n_workers: int) -> Iterator[None]:
    """Let workers start while this process does something else; what they are not needed for ends them.

    Parameters
    ----------
    n_workers : int
        Not more than `MOST_WAITING` are started. None are where OpenSim is not installed or the system has
        no room for them: that is said where they are needed.
    """
    stack = contextlib.ExitStack()
    try:
        if importlib.util.find_spec("opensim") is not None:
            with undisturbed(), contextlib.suppress(OSError):
                workers = stack.enter_context(_new_workers())
                workers.become(min(n_workers, MOST_WAITING))
                _waiting.append((stack, workers))
        yield
    finally:
        _waiting.clear()
        stack.close()


@contextlib.contextmanager
def some_workers() -> Iterator[Workers]:
    """Give workers, those that were started early if there are any; afterwards none of them is left."""
    if _waiting:
        stack, workers = _waiting.pop()
        with stack:
            yield workers
    else:
        with _new_workers() as workers:
            yield workers


@contextlib.contextmanager
def _new_workers() -> Iterator[Workers]:
    with _own_folder() as folder:
        workers = Workers(folder)
        try:
            yield workers
        finally:
            workers.end()
            _close(workers.processes)


def number_of_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def _own_folder() -> Iterator[Path]:
    """Make a locked folder for temporary files and remove it in the end; those of killed processes too."""
    _remove_orphans()
    folder, descriptors = None, []
    try:
        # another run may take it for an orphan before it is locked
        while folder is None or not folder.is_dir():
            folder = Path(tempfile.mkdtemp(prefix=TEMPORARY))
            with contextlib.suppress(OSError):
                descriptors.append(lock(folder, wait=True))
        yield folder
    finally:
        with undisturbed():
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
        for descriptor in filter(None, descriptors):
            os.close(descriptor)


def _remove_orphans() -> None:
    for folder in Path(tempfile.gettempdir()).glob(f"{TEMPORARY}*"):
        # that of a run is locked
        with contextlib.suppress(OSError):
            descriptor = lock(folder)
            if descriptor is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(descriptor)


def worker_environment() -> dict[str, str]:
    """Return this process's environment without what would make OpenSim load foreign libraries.

    ``import opensim`` puts its own folder into ``LD_LIBRARY_PATH``, and both OpenSim and CasADi carry a
    library of the same name. Folders that hold one are dropped; all else stays.

    Returns
    -------
    dict of str to str
        A copy; ``os.environ`` is not changed.
    """
    environment = dict(os.environ)
    folders = environment.pop("LD_LIBRARY_PATH", "").split(os.pathsep)
    kept = [folder for folder in folders if folder and not any(Path(folder).glob("libcasadi*"))]
    if kept:
        environment["LD_LIBRARY_PATH"] = os.pathsep.join(kept)
    environment |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"}
    return environment


def _start(folder: Path, part: int) -> subprocess.Popen[str]:
    package = Path(exceptions.__file__).parents[1]
    return subprocess.Popen(
        [sys.executable, "-P", "-c", PROGRAM, str(package), str(folder), str(part)],
        # one line is written to it; it closes when this process ends, however it ends
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=worker_environment(),
        encoding="utf-8",
        errors="replace",
        cwd=folder,
    )


def _end(processes: list[subprocess.Popen[str]]) -> None:
    for process in processes:
        if process.poll() is None:
            process.terminate()
    for process in processes:
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _close(processes: list[subprocess.Popen[str]]) -> None:
    """Close the pipes to processes that have ended."""
    for process in processes:
        for stream in (process.stdin, process.stdout):
            # what could not be written is tried again
            with contextlib.suppress(OSError):
                if stream is not None:
                    stream.close()
