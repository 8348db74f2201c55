"""The two tasks of a study, as a worker runs them: extract a motion; solve it by one condition.

They take and give plain data, and all files by absolute paths: a worker may be another process or another
machine with the same file system. Nothing is raised for a trial that cannot be run: it is an outcome.
"""

from __future__ import annotations

import functools
import gc
import logging
import threading
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from scso_nlp.exceptions import DataError, ProblemError, ScsoError
from scso_nlp.messages import LOGGER
from scso_nlp.needs import MotionNeeds
from scso_nlp.run import RunResult, extract, run, write_run
from scso_nlp.settings import OutputSettings, RunSettings, settings_of
from scso_nlp.studies.identity import identity
from scso_nlp.studies.record import Outcome, State, StudyTrial, read_outcome, write_outcome

#: IPOPT's linear solver and what keeps warnings are for one thread at a time.
_ALONE = threading.Lock()
#: Progress bars of one process keep to one another by this.
_BARS = threading.RLock()


@dataclass(frozen=True, kw_only=True)
class Task:
    """One trial by one condition, as it travels to a worker.

    Attributes
    ----------
    study : str
        Absolute path of the study.
    trial : StudyTrial
    given : mapping of str to object
        Settings, as a file would hold them.
    needs : MotionNeeds
        Of all conditions of the trial.
    events : tuple of float or None [s]
    """

    study: str
    trial: StudyTrial
    given: Mapping[str, Any]
    needs: MotionNeeds = field(default_factory=MotionNeeds)
    events: tuple[float, ...] | None = None

    @property
    def folder(self) -> Path:
        """Of the results."""
        return Path(self.study) / self.trial.folder

    def settings(self) -> tuple[RunSettings, OutputSettings]:
        """Make the objects of the settings; the motion is kept beside the results of all conditions."""
        settings, output = settings_of({"figures": False, **self.given}, self.trial.folder)
        return settings, replace(
            output, folder=self.folder, overwrite=True, processes=1, cache=self.folder.parent
        )

    def ended(
        self,
        state: State,
        sentence: str,
        identity: str | None = None,
        seconds: Mapping[str, float] | None = None,
    ) -> Outcome:
        """Write what became of it; without the identity of what was read, with the planned one."""
        trial = self.trial
        outcome = Outcome(
            identity=trial.identity if identity is None else identity,
            subject=trial.subject,
            trial=trial.trial,
            condition=trial.condition,
            settings=trial.settings,
            state=state,
            sentence=sentence,
            events=self.events,
            seconds=seconds or {},
        )
        write_outcome(self.folder, outcome)
        return outcome


def done_before(task: Task) -> Outcome | None:
    """Read what became of a trial if it was done with the same inputs, settings and version."""
    before = read_outcome(task.folder)
    is_same = before is not None and before.state == "done" and before.identity == task.trial.identity
    return before if is_same else None


def extract_motion(task: Task) -> None:
    """Let OpenSim extract the motion for all conditions of a trial; what fails is said by each of them."""
    with _ready():
        try:
            extract(*task.settings(), prepare_for=(task.needs,))
        except Exception:
            LOGGER.debug("%s: no motion\n%s", task.trial.folder, traceback.format_exc())


def solve_trial(task: Task, extracted: None = None) -> Outcome:
    """Solve a trial by one condition and write its results, then what became of it.

    Parameters
    ----------
    task : Task
    extracted : None
        Stands for :func:`extract_motion`, which is to end first.

    Returns
    -------
    Outcome
        One that another worker has reached meanwhile is taken over.

    Raises
    ------
    DataError
        The outcome cannot be written.
    """
    with _ready():
        if (before := done_before(task)) is not None:
            return before
        started = time.perf_counter()
        result: RunResult | None = None
        seconds: dict[str, float] = {}
        state: State = "failed"
        try:
            settings, output = task.settings()
            result = run(settings, output, prepare_for=(task.needs,))
            write_run(result, output)
            state, sentence = _worth(result)
            report = result.solution.report
            seconds = {**result.record.seconds, "build": report.build_seconds, "solve": report.solve_seconds}
        except Exception as error:
            state, sentence = _failure(error)
        seconds["other"] = time.perf_counter() - started - sum(seconds.values())
        return task.ended(state, sentence, None if result is None else _identity(result), seconds)


@contextmanager
def _ready() -> Iterator[None]:
    """Do one thing at a time, and leave messages of the package to the outcome."""
    silent = logging.NullHandler()
    # tqdm's own is a semaphore between processes, which would outlive a worker that is killed
    tqdm.set_lock(_BARS)
    with _ALONE:
        LOGGER.addHandler(silent)
        try:
            yield
        finally:
            LOGGER.removeHandler(silent)
            # few objects of Python own much memory of CasADi: Python would wait long to look for cycles
            gc.collect()
            _leave_imports_out()


@functools.cache
def _leave_imports_out() -> None:
    """Leave all that is there, once, out of searches for cycles, which took longer than small trials do."""
    gc.freeze()


def _identity(result: RunResult) -> str:
    """Hash what was read and set indeed, which a file that changed meanwhile makes another."""
    return identity(result.record.inputs, result.record.settings)


def _worth(result: RunResult) -> tuple[State, str]:
    solution = result.solution
    if result.is_solved:
        return "done", result.verdict_lines[0]
    reasons = map(str, (*solution.contradictions[:1], *solution.other_rows()[:1]))
    return "failed", "; ".join((solution.summary(), *reasons))


def _failure(error: Exception) -> tuple[State, str]:
    """Say why there are no results; what is not the input's fault is no bad input."""
    if isinstance(error, DataError | ProblemError):
        return "bad input", str(error)
    if isinstance(error, ScsoError):
        return "failed", str(error)
    if isinstance(error, MemoryError):
        return "failed", "there is not enough memory for this trial: give workers more, or let fewer run"
    LOGGER.debug("%s", traceback.format_exc())
    place = traceback.extract_tb(error.__traceback__)[-1]
    return (
        "failed",
        f"a bug in scso, please report it: {error!r} in {Path(place.filename).name}:{place.lineno}",
    )
