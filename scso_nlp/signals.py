"""Work that no signal may cut short: it is heard when the work is done."""

from __future__ import annotations

import contextlib
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
