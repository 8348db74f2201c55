"""How the comparisons of this folder are written: figures twice, tables as CSV and as Markdown."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

#: One format to look at, one for print.
FIGURE_FORMATS = ("png", "pdf")


def save_figure(figure: Figure, folder: Path, name: str) -> str:
    """Write a figure as PNG and as PDF.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    folder : Path
        Exists.
    name : str
        Without ending.

    Returns
    -------
    str
        Name of the PNG file.
    """
    for kind in FIGURE_FORMATS:
        figure.savefig(folder / f"{name}.{kind}")
    return f"{name}.png"


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file, numbers with all digits.

    Parameters
    ----------
    path : Path
    header : sequence of str
    rows : iterable of sequences
    """
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Lay out a Markdown table.

    Parameters
    ----------
    header : sequence of str
    rows : iterable of sequences
        Floats are rounded to three digits.

    Returns
    -------
    str
        Ends with a line break.
    """
    lines = [header, ["---"] * len(header), *([_cell(value) for value in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cell(value: object) -> str:
    text = f"{value:.3g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|")
