"""Work that no signal may cut short, and processes that Ctrl-C is not for."""

from __future__ import annotations

import contextlib
import multiprocessing.resource_tracker
import signal
import threading
from collections.abc import Iterator

#: Signals by which people and schedulers stop a program.
STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Let signals that stop a program wait until the block has ended.

    For cleaning up, and for importing foreign libraries: some are left half made by an exception of a signal
    handler, hand it on as another one, and crash when Python ends.

    Notes
    -----
    Signals that are ignored stay so, and those that end the process at once still do. Python hears signals in
    its main thread only; in others nothing is to be done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[int] = []
    numbers = [getattr(signal, name) for name in STOPPING if hasattr(signal, name)]
    handlers = {number: signal.getsignal(number) for number in numbers}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    try:
        for number in handlers:
            signal.signal(number, lambda number, _: heard.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in heard:
            signal.raise_signal(number)


@contextlib.contextmanager
def deaf_to_ctrl_c() -> Iterator[None]:
    """Let processes that begin in the block, and those that they or its threads start later, not hear Ctrl-C.

    A terminal interrupts all that run in it, and Python prints a traceback at whatever line that meets it, of
    its own start too. They are ended by the process that started them.

    Notes
    -----
    They inherit the mask of the thread that starts them; this process hears Ctrl-C in its other threads.
    Where systems have no masks, nothing is done.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # unmasks Ctrl-C in the thread that starts the first process
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
