"""What is being done, shown while it lasts: in the last line of a terminal, or below a notebook's cell."""

from __future__ import annotations

import contextlib
import logging
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from scso_nlp.messages import COUNTS, LOGGER, STAGES
from scso_nlp.text import printable

#: Who calls from Python is shown nothing of what takes no longer [s].
DELAY = 1.0
#: Goes to the start of a terminal's line and clears it.
_CLEAR = "\r\x1b[2K"


@contextlib.contextmanager
def stages_shown(progress: bool | None = None, *, delay: float = DELAY) -> Iterator[None]:
    """Show what a block is at, and clear that away when it ends; a block within another adds nothing.

    Parameters
    ----------
    progress : bool, optional
        None: in a terminal and in a notebook only. False: nothing, nor in blocks within.
    delay : float [s]
        Nothing is shown earlier.
    """
    show = None if STAGES.handlers else _screen(progress)
    if show is None:
        yield
        return
    shown, loggers = _Stage(show, delay), (STAGES, COUNTS)
    levels = [logger.level for logger in loggers]
    STAGES.propagate = LOGGER.isEnabledFor(logging.INFO)
    for logger in loggers:
        logger.addHandler(shown)
        logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.removeHandler(shown)
            logger.setLevel(level)
        STAGES.propagate = True
        shown.clear()


class _Stage(logging.Handler):
    def __init__(self, show: Callable[[str], None], delay: float) -> None:
        super().__init__()
        self.show, self.earliest, self.is_used = show, time.monotonic() + delay, False

    def emit(self, record: logging.LogRecord) -> None:
        if time.monotonic() >= self.earliest:
            self.is_used = True
            self.show(f"{record.getMessage()} ...")

    def clear(self) -> None:
        if self.is_used:
            self.show("")


def _screen(progress: bool | None) -> Callable[[str], None] | None:
    """Return what shows a line in the place of the one before; None where nothing is to be shown."""
    if progress is False:
        return _nowhere
    shell: Any = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if getattr(shell, "kernel", None) is not None:
        return _Cell()
    return _to_terminal if progress or sys.stderr.isatty() else None


def _nowhere(text: str) -> None:
    """Show nothing."""


def _to_terminal(text: str) -> None:
    line = printable(text)[: shutil.get_terminal_size().columns - 1]
    # the terminal may be gone
    with contextlib.suppress(OSError):
        sys.stderr.write(f"{_CLEAR}{line}")
        sys.stderr.flush()


class _Cell:
    """An output of a notebook's cell, which changes."""

    def __init__(self) -> None:
        self.output: Any = None

    def __call__(self, text: str) -> None:
        from IPython.display import display

        content = {"text/plain": printable(text)}
        if self.output is None:
            self.output = display(content, raw=True, display_id=True)
        else:
            self.output.update(content, raw=True)
