"""A study on disk: where everything stands, for those who write it and those who read it.

::

    STUDY/
      study.json                                what was planned: a Study
      study.log                                 one line for every trial that ended
      <subject>/<trial>/*.npz                   its extracted motion, which all conditions share
      <subject>/<trial>/<condition>/            the result files of `scso run`, and
      <subject>/<trial>/<condition>/trial.json  what became of it: an Outcome

A trial stands here as often as there are conditions: combinations of the values of a grid. Every file is
written whole or not at all.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ArgumentError, DataError, FileFormatError
from scso_nlp.files import absolute, make_folder, read_text, write_whole

#: Version of the layout.
VERSION = 1
#: Files of a study, and of each of its folders of results.
STUDY, LOG, TRIAL = "study.json", "study.log", "trial.json"

#: What becomes of a trial: results of all frames; none or with gaps; input that cannot be used.
State = Literal["done", "failed", "bad input"]


@dataclass(frozen=True, kw_only=True)
@checked
class StudyTrial:
    """One trial by one condition, as it was planned.

    Attributes
    ----------
    subject, trial, condition : str
    folder : str
        Of its results, relative to the study's, with slashes.
    identity : str
        Hash of its input files, its settings and the version; empty where its input cannot be used.
    settings : mapping of str to object
        What was set, by the names of a settings file; JSON values.
    """

    subject: str
    trial: str
    condition: str
    folder: str
    identity: str
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
@checked
class Study:
    """What was planned.

    Attributes
    ----------
    name : str
    source : str
        Where the trials were found.
    grid : mapping of str to list
        Values of every setting that differs between conditions.
    trials : tuple of StudyTrial
        Subject by subject, trial by trial, condition by condition.
    """

    name: str
    source: str
    grid: Mapping[str, list[Any]]
    trials: tuple[StudyTrial, ...]


@dataclass(frozen=True, kw_only=True)
@checked
class Outcome:
    """What became of one trial by one condition.

    Attributes
    ----------
    identity : str
        Of what was read indeed.
    subject, trial, condition : str
    settings : mapping of str to object
        As in the plan; those in effect, defaults included, are in ``report.json``.
    state : "done", "failed" or "bad input"
        Only with "done" do the result files beside it belong to it.
    sentence : str
        What the run says of itself, or why there are no results.
    events : tuple of float or None [s]
        Times at which cycles begin and end, where somebody gave them.
    seconds : mapping of str to float [s]
        Wall time by stage.
    """

    identity: str
    subject: str
    trial: str
    condition: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    state: State
    sentence: str = ""
    events: tuple[float, ...] | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)


def write_study(folder: Path, study: Study) -> None:
    """Write what was planned into the folder of a study, which is made if it is not there."""
    make_folder(folder)
    _write(folder / STUDY, {"version": VERSION, **asdict(study)})


def read_study(folder: str | os.PathLike[str]) -> Study:
    """Read what was planned.

    Parameters
    ----------
    folder : path

    Returns
    -------
    Study

    Raises
    ------
    DataError
        No study is there.
    FileFormatError
        Its file is damaged, or of a later version.
    """
    path = absolute(folder) / STUDY
    if not path.is_file():
        raise DataError(f"{path.parent} holds no study: {STUDY} is missing; scso batch --output makes one")
    text = read_text(path)
    try:
        values = json.loads(text)
        if (version := int(values["version"])) <= VERSION:
            trials = tuple(_made(StudyTrial, trial) for trial in values["trials"])
            return _made(Study, {**values, "trials": trials})
    except (ArgumentError, KeyError, TypeError, ValueError, AttributeError, RecursionError):
        raise FileFormatError(f"{path} is damaged: it does not describe a study") from None
    raise FileFormatError(f"{path} has version {version}, expected at most {VERSION}: update this package")


def write_outcome(folder: Path, outcome: Outcome) -> None:
    """Write what became of a trial into the folder of its results, which is made if it is not there."""
    make_folder(folder)
    _write(folder / TRIAL, asdict(outcome))


def read_outcome(folder: Path) -> Outcome | None:
    """Read what became of a trial; None without a record that can be read."""
    try:
        values = json.loads((folder / TRIAL).read_text(encoding="utf-8"))
        events = values.get("events")
        return _made(Outcome, {**values, "events": None if events is None else tuple(events)})
    except (OSError, DataError, TypeError, ValueError, AttributeError, RecursionError):
        return None


def outcomes(folder: str | os.PathLike[str]) -> tuple[tuple[StudyTrial, Outcome | None], ...]:
    """Read what became of every trial of a study.

    Parameters
    ----------
    folder : path
        Of the study.

    Returns
    -------
    tuple of (StudyTrial, Outcome or None)
        In the order of the plan. None: not run yet, or run with other inputs, settings or another version
        than the plan's.

    Raises
    ------
    DataError, FileFormatError
        As for :func:`read_study`.
    """
    folder = absolute(folder)
    found = []
    for trial in read_study(folder).trials:
        outcome = read_outcome(folder / trial.folder)
        found.append((trial, outcome if outcome and outcome.identity == trial.identity else None))
    return tuple(found)


_Data = TypeVar("_Data")


def _made(kind: type[_Data], values: Mapping[str, Any]) -> _Data:
    """Make a data class of what a file holds; what later versions add is left out."""
    return kind(**{item.name: values[item.name] for item in fields(kind) if item.name in values})  # type: ignore[arg-type]


def _write(path: Path, values: Mapping[str, Any]) -> None:
    text = json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False)
    with write_whole(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
