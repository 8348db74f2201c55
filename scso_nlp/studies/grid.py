"""Grids: every combination of the values of some settings is a condition, with a name that can be read."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scso_nlp.declared_settings import SETTINGS
from scso_nlp.exceptions import DataError
from scso_nlp.settings import check_settings, overlaid
from scso_nlp.text import shown


def alternatives(name: str, text: str) -> list[Any]:
    """Read an option that may hold several values, between commas, or semicolons where one has commas.

    Parameters
    ----------
    name : str
        Of a setting.
    text : str
        What can be read as one value is one, e.g. a list of joints.

    Returns
    -------
    list
        Checked values; paths are relative to the working folder.

    Raises
    ------
    DataError
        One of them is not what the setting expects.
    """

    def read(words: str) -> Any:
        return check_settings({name: words.strip()}, "the options", Path.cwd(), as_option=True)[name]

    if ";" in text:
        return [read(words) for words in text.split(";")]
    try:
        return [read(text)]
    except DataError:
        if "," not in text:
            raise
    return [read(words) for words in text.split(",")]


def conditions(grid: Mapping[str, Sequence[Any]]) -> tuple[tuple[str, dict[str, Any]], ...]:
    """Make every combination of a grid, each once.

    Parameters
    ----------
    grid : mapping of str to sequence
        Checked values by setting. Where the stability method is among them, a combination leaves out the
        settings that have no effect with its method.

    Returns
    -------
    tuple of (str, dict of str to object)
        Name and settings of each; one without a name for an empty grid.
    """
    names = sorted(grid, key=list(SETTINGS).index)
    found: dict[str, dict[str, Any]] = {}
    for values in itertools.product(*(grid[name] for name in names)):
        chosen = dict(zip(names, values, strict=True))
        if "stability" in chosen:
            chosen = overlaid(chosen, {"stability": chosen["stability"]})
        label = "_".join(_words(name, chosen[name]) for name in _stability_first(names) if name in chosen)
        found.setdefault(label, chosen)
    return tuple(found.items())


def checked_grid(grid: Mapping[str, Any], where: str, folder: Path) -> dict[str, list[Any]]:
    """Check a grid as a file or a Python user gives it.

    Parameters
    ----------
    grid : mapping of str to list
    where : str
        What a message begins with.
    folder : Path
        What relative paths are relative to.

    Returns
    -------
    dict of str to list

    Raises
    ------
    NameMismatchError
        A setting that is not known.
    DataError
        Not a list, an empty one, the same value twice, or a value that is not what its setting expects.
    """
    found: dict[str, list[Any]] = {}
    for name, values in grid.items():
        if isinstance(values, str | Mapping) or not isinstance(values, Sequence) or not len(values):
            raise DataError(f"{where}: the grid's {name} is {shown(values)}, expected a list of values")
        found[name] = [check_settings({name: value}, where, folder)[name] for value in values]
        if any(one == other for one, other in itertools.combinations(found[name], 2)):
            raise DataError(f"{where}: the grid's {name} holds a value twice: {shown(values)}")
    return found


def _stability_first(names: Sequence[str]) -> list[str]:
    return sorted(names, key=lambda name: name != "stability")


def _words(name: str, value: Any) -> str:
    """Write a value so that people know it in the name of a folder."""
    if isinstance(value, Mapping):
        text = "+".join(f"{key}={_number(item)}" for key, item in value.items())
    elif isinstance(value, tuple):
        text = "+".join(Path(item).stem if isinstance(item, Path) else str(item) for item in value)
    else:
        text = value.stem if isinstance(value, Path) else _number(value)
    return text if name == "stability" else f"{name}={text}"


def _number(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)
