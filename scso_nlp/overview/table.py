"""Tables of text, for a terminal and for a notebook."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass

from rich import box
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from scso_nlp.display import card
from scso_nlp.display import table as html_table
from scso_nlp.text import printable


@dataclass(frozen=True, kw_only=True)
class Table:
    """A title, rows under a head, and sentences below them; any of these may be missing."""

    title: str
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()


def as_text(tables: Iterable[Table], width: int) -> str:
    """Write tables for a terminal.

    Parameters
    ----------
    tables : iterable of Table
    width : int
        Columns of the terminal: long cells are continued on the next line.

    Returns
    -------
    str
    """
    console = Console(file=io.StringIO(), width=width, color_system=None, legacy_windows=False)
    with console.capture() as written:
        for table in tables:
            console.print(Text(printable(table.title)))
            if table.rows:
                console.print(_framed(table))
            for note in table.notes:
                console.print(_hanging(note))
            console.print()
    return "\n".join(line.rstrip() for line in written.get().splitlines()).rstrip() + "\n"


def as_html(tables: Iterable[Table]) -> str:
    """Write tables for a notebook, everything from files escaped.

    Parameters
    ----------
    tables : iterable of Table

    Returns
    -------
    str
    """
    return "".join(
        card("\n".join((table.title, *table.notes)), html_table(table.head, table.rows, most=len(table.rows)))
        for table in tables
    )


def _framed(table: Table) -> RichTable:
    framed = RichTable(box=box.SIMPLE_HEAD, show_edge=False, header_style="")
    for name in table.head:
        framed.add_column(Text(name), overflow="fold")
    for row in table.rows:
        framed.add_row(*(Text(printable(cell)) for cell in row))
    return framed


def _hanging(note: str) -> RichTable:
    """Indent a sentence that may go on for several lines."""
    grid = RichTable.grid(padding=(0, 1))
    grid.add_row(" ", Text(printable(note)))
    return grid
