"""Running a plan on a cluster: what is done stays, what ends is recorded at once, whatever ends the rest."""

from __future__ import annotations

import contextlib
import os
import uuid
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm.auto import tqdm

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, EngineError
from scso_nlp.files import absolute, lock, make_folder
from scso_nlp.messages import STAGES
from scso_nlp.needs import MotionNeeds, needs_of
from scso_nlp.opensim.setup_xml import MotionInput
from scso_nlp.report.folder import refuse_unwritable
from scso_nlp.report.record import plain
from scso_nlp.settings import RESULTS
from scso_nlp.studies.cluster import client_of
from scso_nlp.studies.identity import planned_identity
from scso_nlp.studies.log import StudyLog
from scso_nlp.studies.planning import Plan, PlannedTrial
from scso_nlp.studies.record import (
    STUDY,
    TRIAL,
    Outcome,
    Study,
    StudyTrial,
    write_study,
)
from scso_nlp.studies.work import Task, done_before, extract_motion, solve_trial

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client, Future


@dataclass(frozen=True, kw_only=True)
@checked
class StudyResult:
    """What became of a study.

    Attributes
    ----------
    folder : Path
        Of the study.
    outcomes : tuple of Outcome
        Of all its runs, in the order of the plan.
    n_new : int
        How many of them this call has run; the others were done before.
    """

    folder: Path
    outcomes: tuple[Outcome, ...]
    n_new: int

    @property
    def is_done(self) -> bool:
        """True if every run has results of all its frames."""
        return all(outcome.state == "done" for outcome in self.outcomes)

    def __repr__(self) -> str:
        counts = Counter(outcome.state for outcome in self.outcomes)
        states = ", ".join(f"{n} {state}" for state, n in counts.items())
        return f"{states or 'nothing to do'} ({self.n_new} run now), in {self.folder}"

    def table(self) -> pd.DataFrame:
        """Say of every run what became of it.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        ImportError
            Without pandas.
        """
        import pandas as pd

        names = ("subject", "trial", "condition", "state", "sentence")
        rows = [{name: getattr(outcome, name) for name in names} for outcome in self.outcomes]
        return pd.DataFrame(rows, columns=list(names))


@checked
def run(
    plan: Plan,
    *,
    output: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    force: bool = False,
    progress: bool | None = None,
) -> StudyResult:
    """Run every trial of a plan by every condition, except what is done already.

    Parameters
    ----------
    plan : Plan
        As :func:`plan` makes it.
    output : path, optional
        Folder of the study; by default ``scso_results`` and the plan's name in the working folder.
    scheduler : str, optional
        Address of a Dask scheduler; by default a cluster on this machine.
    workers : int, optional
        Of the cluster on this machine; by default one per core, fewer where memory is short.
    force : bool
        Run what is done, too.
    progress : bool, optional
        Show a bar with what is done and failed, and the time left; by default only on a terminal.

    Returns
    -------
    StudyResult
        Trials that failed are in it; nothing is raised for them.

    Raises
    ------
    DataError
        The folder is no study's, cannot be written, or another call works on it.
    EngineError
        Dask is not installed, no scheduler answers, or it ended; what was done stays.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> plan = scso.studies.plan(example_folder("elbow"), final_time=1.0)
    >>> with TemporaryDirectory() as folder:
    ...     result = scso.studies.run(plan, output=folder, workers=1)
    >>> result.is_done
    True
    """
    folder = absolute(output if output is not None else Path(RESULTS) / plan.name)
    refuse_unwritable(folder)
    make_folder(folder)
    with _alone_in(folder):
        if not (folder / STUDY).exists() and any(folder.iterdir()):
            raise DataError(f"{folder} holds other files and no study: name another folder by output")
        jobs = _jobs(plan, folder)
        trials = tuple(job.task.trial for job in jobs)
        write_study(folder, Study(name=plan.name, source=plan.source, grid=plain(plan.grid), trials=trials))
        log = StudyLog(folder)
        ended: dict[str, Outcome] = {}
        pending = []
        for job in jobs:
            trial = job.task.trial
            if job.problem:
                ended[trial.folder] = job.task.ended("bad input", job.problem)
                log.tell(trial, ended[trial.folder])
            elif not force and (done := done_before(job.task)) is not None:
                ended[trial.folder] = done
                if not log.has(trial):
                    log.tell(trial, done)
            else:
                if force:
                    (job.task.folder / TRIAL).unlink(missing_ok=True)
                pending.append(job)
        bar = tqdm(
            desc=plan.name,
            total=len(jobs),
            initial=len(ended),
            unit="run",
            disable=None if progress is None else not progress,
        )
        with bar:
            for task, outcome in _ends(pending, scheduler, workers):
                ended[task.trial.folder] = outcome
                log.tell(task.trial, outcome)
                failed = Counter(each.state for each in ended.values())
                bar.set_postfix_str(", ".join(f"{n} {state}" for state, n in failed.items()), refresh=False)
                bar.update()
    return StudyResult(
        folder=folder, outcomes=tuple(ended[trial.folder] for trial in trials), n_new=len(pending)
    )


@dataclass(frozen=True, kw_only=True)
class _Job:
    """A task, the motion that it needs, and why it cannot be done, if so."""

    task: Task
    motion: MotionInput | None
    problem: str


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep a study's folder from other calls; the lock ends with the process, however it ends."""
    try:
        descriptor = lock(folder)
    except BlockingIOError:
        raise DataError(
            f"another scso batch works on {folder}: wait for it, or name another folder by output"
        ) from None
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _jobs(plan: Plan, folder: Path) -> list[_Job]:
    """Make the tasks of a plan: identities, and for each motion what all its conditions need."""
    STAGES.info("hashing the input files of %d runs", len(plan.trials))
    needs: dict[tuple[str, str, MotionInput], MotionNeeds] = {}
    for planned in plan.trials:
        if planned.settings is not None:
            key = (planned.subject, planned.trial, planned.settings.motion)
            needs[key] = needs.get(key, MotionNeeds()) | needs_of(planned.settings.terms)
    known: dict[str, str] = {}
    return [_job(planned, folder, needs, known) for planned in plan.trials]


def _job(
    planned: PlannedTrial,
    folder: Path,
    needs: dict[tuple[str, str, MotionInput], MotionNeeds],
    known: dict[str, str],
) -> _Job:
    key, problem, motion, of_all = "", planned.problem, None, MotionNeeds()
    if planned.settings is not None and planned.output is not None:
        motion = planned.settings.motion
        of_all = needs[planned.subject, planned.trial, motion]
        try:
            key = planned_identity(planned.settings, planned.output, known)
        except DataError as error:
            problem = str(error)
    trial = StudyTrial(
        subject=planned.subject,
        trial=planned.trial,
        condition=planned.condition,
        folder=planned.folder,
        identity=key,
        settings=plain(planned.given),
    )
    task = Task(study=str(folder), trial=trial, given=planned.given, needs=of_all, events=planned.events)
    return _Job(task=task, motion=motion, problem=problem)


def _ends(jobs: list[_Job], scheduler: str | None, workers: int | None) -> Iterator[tuple[Task, Outcome]]:
    """Run tasks on a cluster and give what becomes of them, as they end."""
    if not jobs:
        return
    with client_of(scheduler, workers) as client:
        from distributed import as_completed

        tasks = _submitted(client, jobs)
        ends = as_completed(tasks, loop=client.loop)
        # what has ended is let go, here and on the cluster
        for future in ends:
            task, _ = tasks.pop(future)
            yield task, _outcome(future, task)


def _submitted(client: Client, jobs: list[_Job]) -> dict[Future, tuple[Task, Future | None]]:
    """Hand tasks to a cluster: an extraction before those that share it, and kept until they have ended.

    A scheduler may hear that nobody wants an extraction any more before it hears of all that build on it.
    """
    call = uuid.uuid4().hex  # a call that was killed may have left others of these names
    sharing = Counter((job.task.folder.parent, job.motion) for job in jobs)
    extractions: dict[tuple[Path, MotionInput | None], Future] = {}
    tasks = {}
    for job in jobs:
        shared, name = (job.task.folder.parent, job.motion), f"{job.task.trial.folder}-{call}"
        if sharing[shared] > 1 and shared not in extractions:
            extractions[shared] = client.submit(extract_motion, job.task, key=f"extract-{name}")
        extraction = extractions.get(shared)
        future = client.submit(solve_trial, job.task, extraction, key=f"solve-{name}")
        tasks[future] = job.task, extraction
    return tasks


def _outcome(future: Future, task: Task) -> Outcome:
    """Take what a task says, or say what became of its worker."""
    from distributed import KilledWorker

    try:
        outcome: Outcome = future.result()
        return outcome
    except CancelledError:
        raise EngineError(
            "the Dask scheduler is gone, or somebody cancelled the study there; what was done stays, and the "
            "same command goes on with the rest"
        ) from None
    except KilledWorker:
        return task.ended(
            "failed",
            "worker processes ended again and again while they ran this trial: they may need more memory",
        )
    except Exception as error:
        return task.ended("failed", f"a worker could not run this trial: {error}")
