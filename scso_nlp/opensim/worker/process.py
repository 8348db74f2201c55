"""What a worker process runs: its share of a job, words to its parent, OpenSim's words to a file."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import sys
import textwrap
import threading
import time
from pathlib import Path
from typing import Any, NoReturn, TextIO

import numpy as np
from numpy.typing import NDArray

from scso_nlp.exceptions import EngineError, ScsoError
from scso_nlp.opensim.worker.exchange import (
    Job,
    Request,
    log_file,
    read_request,
    write_frames,
    write_header,
)

#: So much of what OpenSim says when it refuses something is passed on.
MOST_CHARACTERS = 200
#: Seconds between two progress messages.
PROGRESS_INTERVAL = 0.1
#: Frames that a worker holds before it writes them.
BLOCK = 128
#: Exit code of a worker whose parent was killed; nobody reads it.
PARENT_GONE = 4


def main(arguments: list[str]) -> int:
    """Wait for the job in a folder and do one share of it: the arguments are the folder and which share."""
    folder, part = Path(arguments[0]), int(arguments[1])
    parent = _talk_to_parent_only(log_file(folder, part))
    # OpenSim prints when it is imported: only now does that go to the log
    importlib.import_module("scso_nlp.opensim.worker.extraction")
    parts = _wait_for_job(folder)
    _end_with_parent(folder)
    try:
        request = read_request(folder)
        if isinstance(request, Job):
            work(request, folder, part, parts, parent)
        else:
            describe(request, folder, part)
        tell(parent, done=True)
    except ScsoError as error:
        tell(parent, error=type(error).__name__, message=_with_file(str(error), request))
        return 2
    # what OpenSim throws
    except RuntimeError as error:
        tell(parent, error=EngineError.__name__, message=_plain(str(error), request))
        return 3
    except BrokenPipeError:
        # the thread that watches the parent ends this process
        threading.Event().wait()
    finally:
        sys.stdout.flush()
        parent.flush()
    return 0


def work(job: Job, folder: Path, part: int, parts: int, parent: TextIO) -> None:
    """Compute and write every array of one share of the frames and tell the parent how far it is."""
    started = time.perf_counter()
    from scso_nlp.opensim.worker.extraction import Extraction

    extraction = Extraction(job)
    rows = np.array_split(extraction.rows, parts)[part]
    tell(parent, total=len(extraction.rows), share=len(rows))
    ready = told = time.perf_counter()
    frames: list[dict[str, NDArray[Any]]] = []
    for count, row in enumerate(rows, start=1):
        frames.append(extraction.frame(int(row)))
        if len(frames) == BLOCK or count == len(rows):
            write_frames(folder, part, (count - 1) // BLOCK, extraction.finished(frames))
            frames = []
        if time.perf_counter() - told > PROGRESS_INTERVAL or count == len(rows):
            told = time.perf_counter()
            tell(parent, frames=count)
    header = extraction.header(with_axes=part == 0)
    header["log"] |= {
        "frames": len(rows),
        "startup_seconds": ready - started,
        "frame_seconds": time.perf_counter() - ready,
        "peak_memory": _peak_memory(),
    }
    write_header(folder, part, header)


def describe(request: Request, folder: Path, part: int) -> None:
    """Write what a model holds."""
    from scso_nlp.opensim.worker.description import describe_model

    write_header(folder, part, describe_model(request))


def tell(parent: TextIO, **message: object) -> None:
    """Send one message: a JSON object on a line."""
    parent.write(json.dumps(message) + "\n")
    parent.flush()


def _talk_to_parent_only(log: Path) -> TextIO:
    """Keep the pipe to the parent for messages; whatever else is printed goes to the log file."""
    parent = os.fdopen(os.dup(1), "w", encoding="utf-8")
    sys.stdout.flush()
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    for standard in (1, 2):
        os.dup2(descriptor, standard)
    os.close(descriptor)
    return parent


def _with_file(message: str, request: Request) -> str:
    """Begin a message with the model's file, unless it names a file already."""
    settings = [value for value in request.settings.values() if isinstance(value, str)]
    files = [os.path.basename(path) for path in (*settings, *request.inputs)]
    model = os.path.basename(request.settings["model"])
    return message if any(file and file in message for file in files) else f"{model}: {message}"


def _wait_for_job(folder: Path) -> int:
    """Return how many shares the job has, once the parent says that it is in the folder."""
    line = b""
    while not line.endswith(b"\n"):
        line += os.read(0, 1) or _leave(folder)
    return int(line)


def _end_with_parent(folder: Path) -> None:
    """End when the parent is killed: its end of the standard input closes then."""

    def watch() -> None:
        while os.read(0, 1):
            pass
        _leave(folder)

    threading.Thread(target=watch, daemon=True).start()


def _leave(folder: Path) -> NoReturn:
    """Clear the folder of a parent that is gone away, and end."""
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(PARENT_GONE)


def _plain(message: str, request: Request) -> str:
    """Turn an exception text of OpenSim into one sentence."""
    text = re.sub(r"^std::exception in '.*?': ", "", message.strip(), flags=re.DOTALL)
    text = re.sub(r"\s*Thrown at [^\n]*", "", text)
    text = re.sub(
        r"^SimTK Exception thrown at .*?:\d+:\s*(Error detected by Simbody method .*?\(\): )?", "", text
    )
    text = re.sub(r"\(details: (.*?)\)\.?", r"(\1)", text, flags=re.DOTALL)
    text = re.sub(r"\.?\s*\n\s*In (Component|Object) ", r", in \1 ", text)
    text = " ".join(text.split()).rstrip(".")
    text = re.sub(r"\.\)", ")", text)
    text = re.sub(r"\.\s*\(", " (", text)
    text = re.sub(r"\. (?=[A-Z])", "; ", text)
    text = textwrap.shorten(text, MOST_CHARACTERS, placeholder=" ...")
    name = os.path.basename(request.settings["model"])
    return f"OpenSim refused {name}: {text or 'no reason given'}"


def _peak_memory() -> int:
    """Return the largest resident memory so far [bytes], 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
