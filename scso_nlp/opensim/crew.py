"""Worker processes: start them, watch them, bring their arrays home, leave none behind.

OpenSim never releases Python's lock, so every core gets a process of its own. One that dies, however it dies,
ends the extraction with a sentence that says which one, how far it was and what OpenSim said last.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from tqdm import tqdm

from scso_nlp import exceptions
from scso_nlp.exceptions import EngineError, ScsoError
from scso_nlp.files import lock
from scso_nlp.io.storage import Storage, write_storage
from scso_nlp.opensim.worker.exchange import (
    LOAD_DATA,
    Job,
    Request,
    Result,
    log_file,
    read_header,
    read_result,
    write_job,
    write_request,
)
from scso_nlp.signals import undisturbed

logger = logging.getLogger("scso_nlp")

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
#: A bar appears only when the extraction lasts longer [s].
PROGRESS_DELAY = 2.0
#: Fewer frames than this per worker are not worth another process.
MIN_FRAMES_PER_WORKER = 4
#: How long a worker may take to end after it was asked to [s].
PATIENCE = 5.0
#: A crew that says nothing for so long is given up [s]. Frames take milliseconds to seconds, large models
#: seconds to load; time in which this process is stopped itself does not count.
SILENCE = 300.0
#: How often silence is counted [s].
TICK = 1.0
#: Lines of OpenSim's log that an error message quotes.
QUOTED_LINES = 3


def number_of_workers(n_frames: int, processes: int | None) -> int:
    """Return how many processes to start: as asked, else one per core this process may use, fewer if idle."""
    if processes is not None:
        return max(min(processes, n_frames), 1)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(min(cores, n_frames // MIN_FRAMES_PER_WORKER), 1)


def extract(
    job: Job, n_workers: int, progress: bool | None, external_loads: tuple[str, Storage] | None
) -> Result:
    """Let workers do a job.

    Parameters
    ----------
    job : Job
    n_workers : int
    progress : bool or None
        Show a bar; None: on a terminal only.
    external_loads : (str, Storage) or None
        XML of the external loads, with `LOAD_DATA` as its data file, and these data.

    Returns
    -------
    Result

    Raises
    ------
    ScsoError
        What a worker refused, by its own class.
    EngineError
        OpenSim refused the input, a worker died, or there is no room for them or their temporary files.
    """
    with _own_folder() as folder:
        xml, data = external_loads or (None, None)
        if data is not None:
            write_storage(data, folder / LOAD_DATA)
        write_job(folder, job, xml)
        _Crew(folder, n_workers).work(sys.stderr.isatty() if progress is None else progress)
        return read_result(folder, n_workers)


def describe(request: Request) -> dict[str, Any]:
    """Let a worker describe a model.

    Raises
    ------
    ScsoError, EngineError
        As for :func:`extract`.
    """
    with _own_folder() as folder:
        write_request(folder, request)
        _Crew(folder, 1).work(progress=False)
        return read_header(folder, 0)


@contextlib.contextmanager
def _own_folder() -> Iterator[Path]:
    """Make a locked folder for temporary files and remove it in the end; those of killed processes too."""
    folder, descriptors = None, []
    try:
        _remove_orphans()
        # another run may take it for an orphan before it is locked
        while folder is None or not folder.is_dir():
            folder = Path(tempfile.mkdtemp(prefix=TEMPORARY))
            with contextlib.suppress(OSError):
                descriptors.append(lock(folder, wait=True))
        yield folder
    except BrokenPipeError:
        # of a progress bar that nobody reads any more
        raise
    except OSError as error:
        raise EngineError(
            f"OpenSim's workers cannot be given their work: {error.strerror or error} (their temporary files "
            "stand where TMPDIR says)"
        ) from None
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


class _Crew:
    """The worker processes of one extraction: started together, ended together."""

    def __init__(self, folder: Path, n_workers: int) -> None:
        self.folder = folder
        self.n_workers = n_workers
        #: frames done and to do, per worker
        self.frames = [0] * n_workers
        self.shares = [0] * n_workers
        self.messages: queue.SimpleQueue[tuple[int, dict[str, Any] | None]] = queue.SimpleQueue()

    def work(self, progress: bool) -> None:
        """Run all workers to their end; whatever goes wrong, none is left behind."""
        crew: list[subprocess.Popen[str]] = []
        readers: list[threading.Thread] = []
        try:
            for part in range(self.n_workers):
                crew.append(_start(self.folder, part, self.n_workers))
                reader = threading.Thread(target=self._listen, args=(part, crew[part].stdout), daemon=True)
                reader.start()
                readers.append(reader)
            self._wait(crew, progress)
        finally:
            with undisturbed():
                _end(crew)
            for reader in readers:
                reader.join(PATIENCE)
            for process in crew:
                for stream in (process.stdin, process.stdout):
                    if stream is not None:
                        stream.close()
            self._pass_log_on()

    def _listen(self, part: int, stream: IO[str] | None) -> None:
        assert stream is not None
        for line in stream:
            try:
                message = json.loads(line)
            except ValueError:
                logger.debug("worker %d: %s", part, line.rstrip())
                continue
            self.messages.put((part, message))
        self.messages.put((part, None))

    def _wait(self, crew: list[subprocess.Popen[str]], progress: bool) -> None:
        running = set(range(len(crew)))
        finished: set[int] = set()
        with tqdm(
            desc="OpenSim", unit="frame", delay=PROGRESS_DELAY, disable=not progress, leave=False
        ) as bar:
            while running:
                part, message = self._next_message(running - finished)
                if message is None:
                    running.discard(part)
                    if part not in finished:
                        raise self._death(part, crew[part])
                elif "error" in message:
                    raise _refusal(message["error"], message["message"])
                elif "total" in message:
                    bar.total, self.shares[part] = message["total"], message["share"]
                elif "frames" in message:
                    bar.update(message["frames"] - self.frames[part])
                    self.frames[part] = message["frames"]
                elif message.get("done"):
                    finished.add(part)

    def _next_message(self, busy: set[int]) -> tuple[int, dict[str, Any] | None]:
        for _ in range(max(round(SILENCE / TICK), 1)):
            with contextlib.suppress(queue.Empty):
                return self.messages.get(timeout=TICK)
        part = min(busy, default=0)
        raise EngineError(
            f"OpenSim worker {part + 1} of {self.n_workers} got no further for {SILENCE:g} s "
            f"{self._place(part)} and was ended; nothing was kept"
        )

    def _place(self, part: int) -> str:
        if not self.shares[part]:
            return "before its first frame"
        return f"after {self.frames[part]} of its {self.shares[part]} frames"

    def _death(self, part: int, process: subprocess.Popen[str]) -> EngineError:
        try:
            code = process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            code = 0
        how = f"ended with code {code}"
        if code < 0:
            how = f"was ended by signal {-code}"
            # a signal may have no name
            with contextlib.suppress(ValueError):
                how = f"was ended by {signal.Signals(-code).name} (signal {-code})"
        last = self._last_lines(part)
        said = f"; its last message: {last}" if last else ""
        return EngineError(
            f"OpenSim worker {part + 1} of {self.n_workers} {how} {self._place(part)}; nothing was kept{said}"
        )

    def _last_lines(self, part: int) -> str:
        lines = [line.strip() for line in self._log(part) if line.strip()]
        useful = [line for line in lines if not line.startswith(("[info]", "[warning] Couldn't find file"))]
        return " / ".join((useful or lines)[-QUOTED_LINES:])

    def _log(self, part: int) -> list[str]:
        try:
            return log_file(self.folder, part).read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return []

    def _pass_log_on(self) -> None:
        if not logger.isEnabledFor(logging.DEBUG):
            return
        lines = (line for part in range(self.n_workers) for line in self._log(part))
        for line in dict.fromkeys(lines):
            if line.startswith(("[warning]", "[error]")):
                logger.debug("OpenSim: %s", line)


def _start(folder: Path, part: int, parts: int) -> subprocess.Popen[str]:
    package = Path(exceptions.__file__).parents[1]
    return subprocess.Popen(
        [sys.executable, "-P", "-c", PROGRAM, str(package), str(folder), str(part), str(parts)],
        # never written to: it closes when this process ends, however it ends
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=worker_environment(),
        encoding="utf-8",
        errors="replace",
        cwd=folder,
    )


def _end(crew: list[subprocess.Popen[str]]) -> None:
    for process in crew:
        if process.poll() is None:
            process.terminate()
    for process in crew:
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _refusal(kind: str, message: str) -> ScsoError:
    """Return the error that a worker raised, by its class."""
    error = getattr(exceptions, kind, EngineError)
    if not (isinstance(error, type) and issubclass(error, ScsoError)):
        error = EngineError
    return error(message)
