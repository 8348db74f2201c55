"""How data show themselves: a few lines in a terminal, a card with a table in a notebook, never arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from scso_nlp.text import shown

#: At most so many rows stand in a table.
MOST_ROWS = 12


def without_arrays(data: Any) -> str:
    """Write a data class as Python does, but arrays by their shapes and data within by their class.

    Parameters
    ----------
    data : data class

    Returns
    -------
    str
        To be its ``__repr__``.
    """
    values = ((item.name, getattr(data, item.name)) for item in dataclasses.fields(data) if item.repr)
    return f"{type(data).__name__}({', '.join(f'{name}={_brief(value)}' for name, value in values)})"


def without_defaults(data: Any) -> str:
    """Write a data class as Python does, but leave out what is as it is by default.

    Parameters
    ----------
    data : object
        What is no data class is written as Python does.

    Returns
    -------
    str
    """
    if not dataclasses.is_dataclass(data) or isinstance(data, type):
        return repr(data)
    values = ((item, getattr(data, item.name)) for item in dataclasses.fields(data) if item.repr)
    changed = [f"{item.name}={_brief(value)}" for item, value in values if not _is_default(item, value)]
    return f"{type(data).__name__}({', '.join(changed)})"


def _is_default(item: dataclasses.Field[Any], value: object) -> bool:
    return type(value) is type(item.default) and value == item.default


def _brief(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"array of shape {value.shape}"
    if dataclasses.is_dataclass(value):
        return f"{type(value).__name__}(...)"
    if isinstance(value, Mapping):
        items = [f"{shown(name)}: {_brief(item)}" for name, item in [*value.items()][:MOST_ROWS]]
        if len(value) > MOST_ROWS:
            items.append("...")
        return f"{{{', '.join(items)}}}"
    return shown(value)


def card(text: str, *tables: str) -> str:
    """Make what a notebook shows of something.

    Parameters
    ----------
    text : str
        Its first line is the heading; all of it is escaped.
    *tables : str
        Made by :func:`table`.

    Returns
    -------
    str
        HTML.
    """
    heading, *lines = text.splitlines()
    shown_lines = "".join(f"<div>{escape(line.strip())}</div>" for line in lines)
    return f"<div><strong>{escape(heading)}</strong>{shown_lines}{''.join(tables)}</div>"


def table(head: Sequence[str], rows: Sequence[Sequence[object]], most: int = MOST_ROWS) -> str:
    """Make a small table in HTML.

    Parameters
    ----------
    head : sequence of str
    rows : sequence of sequences
        Numbers are written with four digits, text stands to the left; everything is escaped.
    most : int
        How many rows are shown; the others are counted in a last one.

    Returns
    -------
    str
        Empty without rows.
    """
    if not rows:
        return ""
    lines = [_line("th", head), *(_line("td", row) for row in rows[:most])]
    if len(rows) > most:
        lines.append(f"<tr>{_cell('td', f'and {len(rows) - most} more', f' colspan={len(head)}')}</tr>")
    # a narrow screen scrolls the table, not the page
    return f'<div style="overflow-x: auto"><table>{"".join(lines)}</table></div>'


def _line(kind: str, cells: Sequence[object]) -> str:
    return f"<tr>{''.join(_cell(kind, cell) for cell in cells)}</tr>"


def _cell(kind: str, value: object, attributes: str = "") -> str:
    if isinstance(value, str):
        return f'<{kind}{attributes} style="text-align: left">{escape(value)}</{kind}>'
    return f"<{kind}>{value:.4g}</{kind}>"
