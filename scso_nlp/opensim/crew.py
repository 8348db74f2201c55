"""What workers do: give them a job, watch them, bring their arrays home, leave none behind.

OpenSim never releases Python's lock, so every core gets a process of its own. One that dies, however it dies,
ends the extraction with a sentence that says which one, how far it was and what OpenSim said last.
"""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from typing import IO, Any

from scso_nlp import exceptions
from scso_nlp.exceptions import EngineError, ScsoError
from scso_nlp.io.storage import Storage, write_storage
from scso_nlp.messages import COUNTS
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
from scso_nlp.opensim.workers import PATIENCE, Workers, number_of_cores, some_workers

logger = logging.getLogger("scso_nlp")

#: Fewer frames than this per worker are not worth another process.
MIN_FRAMES_PER_WORKER = 4
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
    return max(min(number_of_cores(), n_frames // MIN_FRAMES_PER_WORKER), 1)


def extract(job: Job, n_workers: int, external_loads: tuple[str, Storage] | None) -> Result:
    """Let workers do a job.

    Parameters
    ----------
    job : Job
    n_workers : int
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
    with _workers_with_room() as workers:
        workers.become(n_workers)
        xml, data = external_loads or (None, None)
        if data is not None:
            write_storage(data, workers.folder / LOAD_DATA)
        write_job(workers.folder, job, xml)
        _Crew(workers).work()
        return read_result(workers.folder, n_workers)


def describe(request: Request) -> dict[str, Any]:
    """Let a worker describe a model.

    Raises
    ------
    ScsoError, EngineError
        As for :func:`extract`.
    """
    with _workers_with_room() as workers:
        workers.become(1)
        write_request(workers.folder, request)
        _Crew(workers).work()
        return read_header(workers.folder, 0)


@contextlib.contextmanager
def _workers_with_room() -> Iterator[Workers]:
    """Give workers and their folder for a while; what the system refuses is an error of this package."""
    try:
        with some_workers() as workers:
            yield workers
    except OSError as error:
        raise EngineError(
            f"OpenSim's workers cannot be given their work: {error.strerror or error} (their temporary files "
            "stand where TMPDIR says)"
        ) from None


class _Crew:
    """The workers of one extraction, listened to until all are done."""

    def __init__(self, workers: Workers) -> None:
        self.workers = workers
        self.folder = workers.folder
        self.n_workers = len(workers.processes)
        #: frames done and to do, per worker
        self.frames = [0] * self.n_workers
        self.shares = [0] * self.n_workers
        self.messages: queue.SimpleQueue[tuple[int, dict[str, Any] | None]] = queue.SimpleQueue()

    def work(self) -> None:
        """Let all workers do what they are asked for; whatever goes wrong, none is left behind."""
        crew = self.workers.processes
        readers: list[threading.Thread] = []
        try:
            for part, process in enumerate(crew):
                reader = threading.Thread(target=self._listen, args=(part, process.stdout), daemon=True)
                reader.start()
                readers.append(reader)
            self.workers.begin()
            self._wait(crew)
        finally:
            self.workers.end()
            for reader in readers:
                reader.join(PATIENCE)
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

    def _wait(self, crew: list[subprocess.Popen[str]]) -> None:
        running = set(range(len(crew)))
        finished: set[int] = set()
        total, started = 0, time.monotonic()
        while running:
            part, message = self._next_message(running - finished)
            if message is None:
                running.discard(part)
                if part not in finished:
                    raise self._death(part, crew[part])
            elif "error" in message:
                raise _refusal(message["error"], message["message"])
            elif "total" in message:
                total, self.shares[part] = message["total"], message["share"]
                started = time.monotonic()
            elif "frames" in message:
                self.frames[part] = message["frames"]
                done, passed = sum(self.frames), time.monotonic() - started
                left = f", {passed * (total - done) / done:.0f} s left" if done else ""
                COUNTS.info("OpenSim, %d of %d frames%s", done, total, left)
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


def _refusal(kind: str, message: str) -> ScsoError:
    """Return the error that a worker raised, by its class."""
    error = getattr(exceptions, kind, EngineError)
    if not (isinstance(error, type) and issubclass(error, ScsoError)):
        error = EngineError
    return error(message)
