"""What a long call is doing, and what it warns of, for whoever wants to show or keep it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

#: Warnings and all else of the package.
LOGGER = logging.getLogger("scso_nlp")
#: One message of level INFO at the start of every stage of a run, e.g. "solving 73 frames".
STAGES = logging.getLogger("scso_nlp.stages")
#: How far a stage is, e.g. "solving, 128 of 1131 frames": many messages, for what shows them as they come.
COUNTS = logging.getLogger("scso_nlp.stages.counts")
COUNTS.propagate = False


class _Kept(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: dict[str, None] = {}

    def emit(self, record: logging.LogRecord) -> None:
        self.messages[record.getMessage()] = None


@contextmanager
def kept_warnings() -> Iterator[dict[str, None]]:
    """Keep the warnings of a block, each once, in the order in which they came.

    Yields
    ------
    dict of str to None
        Grows while the block runs.
    """
    kept = _Kept()
    LOGGER.addHandler(kept)
    try:
        yield kept.messages
    finally:
        LOGGER.removeHandler(kept)
