"""What a command says while it works: warnings, in groups."""

from __future__ import annotations

import logging
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager

from scso_nlp.text import printable


class Console(logging.Handler):
    """Writes messages of the package to standard error.

    Parameters
    ----------
    verbose : bool
        Write what is being done, too.
    """

    def __init__(self, verbose: bool) -> None:
        super().__init__(logging.INFO if verbose else logging.WARNING)
        self.is_verbose = verbose
        self._held: dict[str, None] | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Write a message at once, or hold it back while that is asked for."""
        message = record.getMessage()
        if self._held is not None and record.levelno == logging.WARNING and not self.is_verbose:
            self._held[message] = None
        else:
            self._write(message)

    @contextmanager
    def held_back(self) -> Iterator[None]:
        """Hold warnings back; what ends in an exception writes them then."""
        self._held = {}
        try:
            yield
        except BaseException:
            self.tell(self._held)
            raise
        finally:
            self._held = None

    def tell(self, warnings: Collection[str], known: Collection[object] = ()) -> None:
        """Write warnings, the shortest first.

        Parameters
        ----------
        warnings : collection of str
        known : collection of str
            Those of the run before: if there is nothing else, that is said in one line.
        """
        if warnings and set(warnings) <= set(known):
            what = "the same warning" if len(warnings) == 1 else f"the same {len(warnings)} warnings"
            self._write(f"{what} as in the run before, see report.json")
            return
        for message in sorted(warnings, key=lambda message: (len(message), message)):
            self._write(message)

    def _write(self, message: str) -> None:
        # the terminal may be gone
        try:
            print(printable(f"scso: {message}"), file=sys.stderr)
        except OSError:
            self.setLevel(logging.CRITICAL + 1)
