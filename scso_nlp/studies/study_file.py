"""Study files: one row a trial, with a column for anything a setting can be.

A ``.csv`` has names in its first line and cells as on the command line; an empty one is not set. In a
``.toml`` every trial is a table ``[[trial]]``; what stands above them holds for all, and a table ``[grid]``
holds lists of values. Besides settings there are ``subject``, ``trial`` and ``events``. Paths are relative to
the file.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scso_nlp.declared_settings import SETTINGS
from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.files import read_text, read_toml
from scso_nlp.settings import check_settings
from scso_nlp.studies.trial import EVENTS, Trial, with_values
from scso_nlp.text import number

#: Columns beside the settings.
NAMES = ("subject", "trial")


def read_study_file(path: Path) -> tuple[tuple[Trial, ...], dict[str, Any]]:
    """Read the trials of a study file, and its grid.

    Parameters
    ----------
    path : Path
        ``.toml`` or ``.csv``.

    Returns
    -------
    tuple of Trial, dict of str to object

    Raises
    ------
    DataError, FileFormatError
        A file that cannot be read, a value that is not what its setting expects, a row without names.
    NameMismatchError
        A column that is not known; the closest one is suggested.
    """
    if path.suffix.lower() == ".csv":
        rows, common, grid = _rows(path), {}, {}
    else:
        common = read_toml(path)
        rows, grid = common.pop("trial", []), common.pop("grid", {})
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise FileFormatError(f"{path} names no trial, expected tables [[trial]]")
    if not isinstance(grid, dict):
        raise FileFormatError(f"{path}: grid is {grid!r}, expected a table [grid] of lists")
    return tuple(_trial(path, k, common, row) for k, row in enumerate(rows, start=1)), grid


def _trial(path: Path, k: int, common: Mapping[str, Any], row: dict[str, Any]) -> Trial:
    where = f"{path}, trial {k}"
    names = [row.pop(name, "") for name in NAMES]
    for name, value in zip(NAMES, names, strict=True):
        if not isinstance(value, str) or not value.strip():
            raise DataError(f"{where}: {name} is {value!r}, expected a name")
    trial = with_values(
        Trial(subject=names[0].strip(), trial=names[1].strip(), source=path), common, str(path), path.parent
    )
    return with_values(trial, row, where, path.parent)


def _rows(path: Path) -> list[dict[str, Any]]:
    """Read the cells of a table, each as its setting does on the command line."""
    head, *lines = [row for row in csv.reader(read_text(path).splitlines()) if any(map(str.strip, row))] or [
        []
    ]
    head = [name.strip() for name in head]
    if len(set(head)) < len(head) or not set(NAMES) <= set(head):
        raise FileFormatError(
            f"{path} begins with {', '.join(head) or 'nothing'}, expected a line of different names, subject "
            "and trial among them"
        )
    rows = []
    for k, line in enumerate(lines, start=1):
        if len(line) != len(head):
            raise FileFormatError(f"{path}, trial {k} has {len(line)} cells, expected {len(head)}")
        given = {name: cell.strip() for name, cell in zip(head, line, strict=True) if cell.strip()}
        rows.append({name: _cell(path, k, name, cell) for name, cell in given.items()})
    return rows


def _cell(path: Path, k: int, name: str, cell: str) -> Any:
    where = f"{path}, trial {k}"
    if name == EVENTS:
        try:
            return [number(part) for part in cell.split(";")]
        except ValueError:
            raise DataError(f"{where}: events is {cell!r}, expected times with semicolons [s]") from None
    if name in NAMES:
        return cell
    is_flag = name in SETTINGS and SETTINGS[name].kind.type is bool
    value = {"true": True, "false": False}.get(cell.lower(), cell) if is_flag else cell
    return check_settings({name: value}, where, path.parent, as_option=True)[name]
