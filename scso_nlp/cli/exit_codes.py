"""Exit codes of every command, and what is printed when something goes wrong."""

from __future__ import annotations

import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

import typer

from scso_nlp.cli.console import Console
from scso_nlp.exceptions import ScsoError, loading_fault
from scso_nlp.messages import LOGGER
from scso_nlp.text import printable

#: Some frame was not solved.
FRAME_FAILED = 1
#: Input that cannot be used; also the code of a misspelled option.
BAD_INPUT = 2
#: Not the user's fault.
BUG = 3
#: Stopped by the user, as shells have it.
INTERRUPTED = 130
#: Signals by which schedulers and closed terminals stop a program; the exit code is 128 and their number.
STOP_SIGNALS = ("SIGTERM", "SIGHUP")
#: Nobody reads the output any more, e.g. after ``| head``, as shells have it.
CLOSED_PIPE = 141


@contextmanager
def exit_codes(verbose: bool) -> Iterator[Console]:
    """Turn exceptions into exit codes: one sentence for bad input, a traceback for a bug.

    Signals that would end the process at once raise as Ctrl-C does, so that temporary folders and worker
    processes go with it.

    Yields
    ------
    Console
        Where messages go meanwhile.
    """
    console, level = Console(verbose), LOGGER.level
    LOGGER.addHandler(console)
    LOGGER.setLevel(console.level)
    try:
        with _stop_signals():
            yield console
    except ScsoError as error:
        typer.echo(printable(f"error: {error}"), err=True)
        raise typer.Exit(BAD_INPUT) from None
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        _silence_output()
        raise typer.Exit(CLOSED_PIPE) from None
    except _Stopped as stopped:
        # the terminal may be gone
        with suppress(OSError):
            typer.echo(f"stopped by {stopped.signal.name}", err=True)
        raise typer.Exit(128 + stopped.signal) from None
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        if sentence := _outside(error):
            typer.echo(printable(f"error: {sentence}"), err=True)
            raise typer.Exit(BAD_INPUT) from None
        traceback.print_exc()
        typer.echo("error: this is a bug in scso, please report it with the lines above", err=True)
        raise typer.Exit(BUG) from None
    finally:
        LOGGER.removeHandler(console)
        LOGGER.setLevel(level)


def _outside(error: Exception) -> str:
    """Say what the system refused; empty where an error is the program's own."""
    if isinstance(error, MemoryError):
        return f"there is not enough memory{': ' if str(error) else ''}{error}"
    if isinstance(error, ImportError):
        return loading_fault(error)
    if not isinstance(error, OSError) or error.strerror is None:
        return ""
    if error.filename is None:
        _silence_output()
        return f"the output cannot be written: {error.strerror}"
    return f"{error.filename}: {error.strerror}"


def _silence_output() -> None:
    """Write nothing more: what is still buffered would fail again when Python ends."""
    with open(os.devnull, "w") as nowhere, suppress(OSError, ValueError):
        os.dup2(nowhere.fileno(), sys.stdout.fileno())


class _Stopped(BaseException):
    """A signal asked the program to end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.signal = signal.Signals(number)


@contextmanager
def _stop_signals() -> Iterator[None]:
    """Raise where a signal would end the process; leave alone what is ignored, as under nohup, or handled."""

    def stop(number: int, _: FrameType | None) -> None:
        # once is enough, cleaning up must not be cut short
        signal.signal(number, signal.SIG_IGN)
        raise _Stopped(number)

    numbers = [getattr(signal, name) for name in STOP_SIGNALS if hasattr(signal, name)]
    numbers = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        numbers = []  # only the main thread may set handlers
    try:
        for number in numbers:
            signal.signal(number, stop)
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)
