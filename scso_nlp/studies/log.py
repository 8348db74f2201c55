"""``study.log``: one line for every run of a trial that ended, for people and for scripts."""

from __future__ import annotations

import datetime
import os
from pathlib import Path

from scso_nlp.files import read_text, refused
from scso_nlp.studies.record import LOG, Outcome, StudyTrial
from scso_nlp.text import printable

#: As much of an identity stands in a line.
SHORT = 12


class StudyLog:
    """Writes lines to the log of a study, at once, each whole.

    Parameters
    ----------
    folder : Path
        Of the study; exists.

    Raises
    ------
    DataError
        The log cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOG
        self._known = read_text(self._path) if self._path.exists() else ""
        if self._known and not self._known.endswith("\n"):
            self._append("\n")  # of a machine that went down

    def has(self, trial: StudyTrial) -> bool:
        """Tell if a run that was done before this one began has its line."""
        return f"\t{trial.folder}\t{trial.identity[:SHORT]}\tdone" in self._known

    def tell(self, trial: StudyTrial, outcome: Outcome) -> None:
        """Write the line of a run that ended: time, folder, identity, state, seconds, sentence."""
        now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        seconds = f"{sum(outcome.seconds.values()):.2f} s"
        sentence = " ".join(printable(outcome.sentence).split())
        parts = (now, trial.folder, outcome.identity[:SHORT], outcome.state, seconds, sentence)
        self._append("\t".join(parts) + "\n")

    def _append(self, text: str) -> None:
        with refused(self._path, "cannot be written"):
            descriptor = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            try:
                os.write(descriptor, text.encode())
            finally:
                os.close(descriptor)
