"""One recording of one person, as a layout finds it, and the settings that its folders add."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from scso_nlp.arguments import checked
from scso_nlp.declared_settings import of_type
from scso_nlp.exceptions import DataError
from scso_nlp.files import read_toml
from scso_nlp.settings import check_settings, overlaid
from scso_nlp.text import shown

#: Settings of a study, of a person or of a trial, in the folder of each; the deeper one wins.
SETTINGS_FILE = "scso.toml"
#: Key beside the settings of a run: times at which cycles begin and end [s].
EVENTS = "events"


@dataclass(frozen=True, kw_only=True)
@checked
class Trial:
    """One recording of one person.

    Attributes
    ----------
    subject, trial : str
    source : Path
        File or folder that it was found by.
    settings : mapping of str to object
        What is known of it, checked, by the names of a settings file.
    events : tuple of float or None [s]
        Times at which its cycles begin and end.
    missing : tuple of str
        What the layout would hold and was not found, one phrase each.
    problem : str
        Why it cannot be used; empty where nothing speaks against it.
    """

    subject: str
    trial: str
    source: Path
    settings: Mapping[str, Any] = field(default_factory=dict)
    events: tuple[float, ...] | None = None
    missing: tuple[str, ...] = ()
    problem: str = ""


def settings_in(folder: Path) -> dict[str, Any]:
    """Read the settings file of a folder; empty where there is none.

    Returns
    -------
    dict of str to object
        Values as the file holds them.

    Raises
    ------
    DataError, FileFormatError
        A file that cannot be read.
    """
    path = folder / SETTINGS_FILE
    return read_toml(path) if path.is_file() else {}


def with_values(trial: Trial, values: Mapping[str, Any], where: str, folder: Path) -> Trial:
    """Lay what a file says over what is known of a trial.

    Parameters
    ----------
    trial : Trial
    values : mapping of str to object
        Settings, and `EVENTS`.
    where : str
        What a message begins with.
    folder : Path
        What relative paths are relative to.

    Returns
    -------
    Trial

    Raises
    ------
    NameMismatchError
        A name that is not known; the closest one is suggested.
    DataError
        A value that is not what its setting expects.
    """
    settings = check_settings({k: v for k, v in values.items() if k != EVENTS}, where, folder)
    events = trial.events if values.get(EVENTS) is None else checked_events(values[EVENTS], where)
    found = [what for what in trial.missing if what.split()[0] not in settings]
    return replace(trial, settings=overlaid(trial.settings, settings), events=events, missing=tuple(found))


def inherited(trial: Trial, root: Path, folder: Path) -> Trial:
    """Lay the settings files of all folders from the study's down to the trial's over what is known of it.

    Parameters
    ----------
    trial : Trial
    root, folder : Path
        Of the study, and of the trial, which is in it or the same.

    Returns
    -------
    Trial

    Raises
    ------
    DataError
        As for :func:`with_values`, and a file that cannot be read.
    """
    for level in (*reversed(folder.relative_to(root).parents), Path(folder.relative_to(root))):
        place = root / level
        trial = with_values(trial, settings_in(place), str(place / SETTINGS_FILE), place)
    return trial


def checked_events(value: object, where: str) -> tuple[float, ...]:
    """Check times of events.

    Parameters
    ----------
    value : object
    where : str
        What a message begins with.

    Returns
    -------
    tuple of float [s]

    Raises
    ------
    DataError
        Not a list of rising numbers.
    """
    try:
        times = tuple(of_type(value, list[float]))
    except ValueError:
        times = ()
    if len(times) < 2 or any(b <= a for a, b in itertools.pairwise(times)):
        raise DataError(
            f"{where}: {EVENTS} is {shown(value)}, expected a list of at least two rising times [s]"
        )
    return times
