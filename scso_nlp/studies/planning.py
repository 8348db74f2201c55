"""What a study would run: every trial that a path holds, each by every condition of a grid."""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, NameMismatchError, ProblemError, ScsoError
from scso_nlp.files import absolute
from scso_nlp.settings import OutputSettings, RunSettings, check_settings, overlaid, settings_of
from scso_nlp.studies.grid import checked_grid, conditions
from scso_nlp.studies.layouts import trials_in
from scso_nlp.studies.layouts.setups import named
from scso_nlp.studies.study_file import read_study_file
from scso_nlp.studies.trial import Trial, inherited

if TYPE_CHECKING:
    import pandas as pd

#: Settings of a run that the study decides for all.
OF_THE_STUDY = ("output", "overwrite", "processes", "cache")
#: Longest part of a folder's path; longer names end in a hash.
LONGEST_PART = 80


@dataclass(frozen=True, kw_only=True)
@checked
class PlannedTrial:
    """One trial by one condition.

    Attributes
    ----------
    subject, trial, condition : str
    folder : str
        Of its results, relative to the study's.
    source : Path
        What it was found by.
    given : mapping of str to object
        What is set, checked; the rest is as by default.
    settings : RunSettings or None
        None where its input cannot be used.
    output : OutputSettings or None
    events : tuple of float or None [s]
    missing : tuple of str
        What its layout would hold and was not found.
    problem : str
        Why its input cannot be used; empty where it can.
    """

    subject: str
    trial: str
    condition: str
    folder: str
    source: Path
    given: Mapping[str, Any]
    settings: RunSettings | None
    output: OutputSettings | None
    events: tuple[float, ...] | None
    missing: tuple[str, ...]
    problem: str

    @property
    def lacks(self) -> str:
        """What is missing or wrong, in words; empty where nothing is."""
        return self.problem or (f"not found: {', '.join(self.missing)}" if self.missing else "")


@dataclass(frozen=True, kw_only=True)
@checked
class Plan:
    """What a study would run.

    Attributes
    ----------
    name : str
        Of the path that it was made of.
    source : str
        That path, and the layout that was recognised.
    grid : mapping of str to list
        Values of the settings that differ between conditions.
    trials : tuple of PlannedTrial
        Subject by subject, trial by trial, condition by condition.
    """

    name: str
    source: str
    grid: Mapping[str, list[Any]]
    trials: tuple[PlannedTrial, ...]

    #: Head of the rows that `rows` gives.
    HEAD = ("subject", "trial", "condition", "model", "motion", "loads", "missing")

    def __repr__(self) -> str:
        return f"{self.summary()} from {self.source}"

    def summary(self) -> str:
        """Count subjects, trials, conditions and what cannot be run, in one line."""
        counts = {
            "subject": len({trial.subject for trial in self.trials}),
            "trial": len({(trial.subject, trial.trial) for trial in self.trials}),
            "condition": len({trial.condition for trial in self.trials}),
        }
        text = ", ".join(f"{n} {what}{'' if n == 1 else 's'}" for what, n in counts.items())
        unusable = sum(1 for trial in self.trials if trial.problem)
        runs = len(self.trials)
        return f"{text}: {runs} run{'' if runs == 1 else 's'}" + (
            f", {unusable} of them with input that cannot be used" if unusable else ""
        )

    def rows(self) -> tuple[tuple[str, ...], ...]:
        """Say of every trial what would be read, and what is missing, under `HEAD`."""
        return tuple(
            (trial.subject, trial.trial, trial.condition, *_file_names(trial), trial.lacks)
            for trial in self.trials
        )

    def table(self) -> pd.DataFrame:
        """Say of every trial what would be read, and what is missing.

        Returns
        -------
        pandas.DataFrame
            One row for every trial and condition, with a column for every setting that is set.

        Raises
        ------
        ImportError
            Without pandas.
        """
        import pandas as pd

        rows = [
            {
                "subject": trial.subject,
                "trial": trial.trial,
                "condition": trial.condition,
                **trial.given,
                "missing": trial.lacks,
            }
            for trial in self.trials
        ]
        return pd.DataFrame(rows)


@checked
def plan(
    path: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    grid: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Plan:
    """Find the trials of a study and make their settings; nothing is run.

    Parameters
    ----------
    path : path, or several of setup files
        A folder in a layout that labs have, a glob of AnalyzeTool setups, such files one by one, or a study
        file: ``.toml`` or ``.csv`` with one row a trial.
    grid : mapping of str to list, optional
        Values of some settings: every combination is a condition. It replaces that of a study file.
    **settings
        Of all trials, by the names of a settings file; they win over all files.

    Returns
    -------
    Plan
        Trials whose input cannot be used are in it, with the reason.

    Raises
    ------
    DataError
        No trial, or a file or value that is not what it should be.
    NameMismatchError
        A setting that is not known.
    ProblemError
        A setting that the study decides itself, such as its output.

    Examples
    --------
    >>> found = scso.studies.plan(example_folder("elbow"), grid={"q": [3, 5]}, stability="potvin-brown")
    >>> [trial.folder for trial in found.trials]
    ['elbow/scso/q=3', 'elbow/scso/q=5']
    """
    if given := sorted(set(settings) & set(OF_THE_STUDY) | set(grid or {}) & set(OF_THE_STUDY)):
        raise ProblemError(
            f"{', '.join(given)} cannot be set for trials of a study, which decides it for all"
        )
    root, layout, trials, own_grid = _trials(path)
    changes = check_settings(settings, "the settings", Path.cwd())
    values = checked_grid(own_grid, str(path), root) if grid is None else {}
    values |= checked_grid(grid or {}, "the grid", Path.cwd())
    if twice := sorted(values.keys() & changes.keys()):
        raise ProblemError(f"{', '.join(twice)} is in the grid and set for all, expected one of them")
    # one value for all is no condition
    changes |= {name: several[0] for name, several in values.items() if len(several) == 1}
    values = {name: several for name, several in values.items() if len(several) > 1}
    chosen = conditions(values)
    planned = [
        _planned(trial, label, overlaid(overlaid(trial.settings, changes), more))
        for trial in trials
        for label, more in chosen
    ]
    problems = {trial.problem for trial in planned}
    if len(problems) == 1 and "" not in problems:
        raise DataError(*problems)
    _refuse_same_folders(planned)
    return Plan(name=root.stem or root.name, source=f"{path} ({layout})", grid=values, trials=tuple(planned))


def _trials(
    path: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
) -> tuple[Path, str, tuple[Trial, ...], dict[str, Any]]:
    """Find the trials of a path: what they are called after, the layout, themselves, and their own grid."""
    if not isinstance(path, str | os.PathLike):
        return _of_files([absolute(each) for each in path])
    place = absolute(path)
    if place.is_dir():
        layout, found = trials_in(place)
        return place, layout, tuple(_inherited(trial, place) for trial in found), {}
    if not place.exists() and glob.has_magic(os.fspath(path)):
        return _of_files([Path(each) for each in sorted(glob.glob(str(place), recursive=True))], str(path))
    if place.suffix.lower() in (".toml", ".csv"):
        return place, "a study file", *read_study_file(place)
    return _of_files([place])


def _of_files(files: list[Path], pattern: str = "") -> tuple[Path, str, tuple[Trial, ...], dict[str, Any]]:
    """Take setup files that were named one by one, or by a pattern."""
    if not files:
        raise DataError(
            f"no file fits {pattern}" if pattern else "no setup file is named, expected one or more"
        )
    for file in files:
        if not file.is_file():
            state = "is a folder" if file.is_dir() else "does not exist"
            raise DataError(f"{file} {state}, expected setup files, one folder or one study file")
    root = Path(os.path.commonpath([file.parent for file in files]))
    alone = Counter(file.parent for file in files)
    found = (named(root, file, is_alone=alone[file.parent] == 1) for file in files)
    return root, "setup files", tuple(_inherited(trial, root) for trial in found), {}


def _inherited(trial: Trial, root: Path) -> Trial:
    """Add what settings files of its folders say; what is wrong with one concerns its trials alone."""
    try:
        return inherited(trial, root, trial.source if trial.source.is_dir() else trial.source.parent)
    except DataError as error:
        return replace(trial, problem=str(error))


def _planned(trial: Trial, label: str, given: dict[str, Any]) -> PlannedTrial:
    given = {name: value for name, value in given.items() if name not in OF_THE_STUDY}
    condition = label or str(given.get("stability", "off"))
    settings, output, problem = None, None, trial.problem
    if not problem:
        try:
            settings, output = settings_of({"figures": False, **given}, str(trial.source))
        except ScsoError as error:
            lost = f"; not found: {', '.join(trial.missing)}" if trial.missing else ""
            problem = f"{error}{lost}"
    return PlannedTrial(
        subject=trial.subject,
        trial=trial.trial,
        condition=condition,
        folder="/".join(map(_part, (trial.subject, trial.trial, condition))),
        source=trial.source,
        given=given,
        settings=settings,
        output=output,
        events=trial.events,
        missing=trial.missing,
        problem=problem,
    )


def _part(name: str) -> str:
    """Make a name part of a path on every system, short enough."""
    plain = re.sub(r"[^\w.+=-]", "_", name).strip(".") or "_"
    if len(plain) <= LONGEST_PART:
        return plain
    return f"{plain[:LONGEST_PART]}_{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _refuse_same_folders(planned: list[PlannedTrial]) -> None:
    first: dict[str, PlannedTrial] = {}
    for trial in planned:
        # some systems do not tell capitals apart
        other = first.setdefault(trial.folder.casefold(), trial)
        if other is not trial:
            raise NameMismatchError(
                f"{other.source} and {trial.source} would both be {trial.folder}: give one of "
                "them another subject or trial name"
            )


def _file_names(trial: PlannedTrial) -> tuple[str, str, str]:
    if trial.settings is None:
        return tuple(_name(trial.given.get(name)) for name in ("model", "coordinates", "external_loads"))  # type: ignore[return-value]
    motion = trial.settings.motion
    return _name(motion.model), _name(motion.motion), _name(motion.external_loads)


def _name(path: Path | None) -> str:
    return "" if path is None else path.name
