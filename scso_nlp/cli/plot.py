"""``scso plot``: figures of results for print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scso_nlp.cli.compare import Labels, Results, Verbose
from scso_nlp.cli.exit_codes import exit_codes
from scso_nlp.exceptions import DataError
from scso_nlp.signals import undisturbed
from scso_nlp.text import number, shown

#: Units of a width [mm].
_UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "": 1.0}


def plot(
    results: Results,
    quantity: Annotated[
        str, typer.Option(help="What is drawn: activation, force, stability, reaction or moment.")
    ] = "activation",
    names: Annotated[
        str,
        typer.Option(
            "--muscles",
            "--names",
            metavar="A,B*,...",
            help="Names or patterns of muscles, rows, joints or coordinates. [default: 12 that tell most]",
        ),
    ] = "",
    percent: Annotated[bool, typer.Option("--percent", help="Over per cent of the cycle, not time.")] = False,
    events: Annotated[
        str, typer.Option(metavar="T0,T1,...", help="0 and 100 % of cycles [s]; of several, their mean, too.")
    ] = "",
    tasks: Annotated[
        str, typer.Option(metavar="A,B,...", help="Names of the frames, which are tasks and no movement.")
    ] = "",
    columns: Annotated[
        int, typer.Option(min=1, max=2, help="Columns of a journal's page: 85 or 175 mm.")
    ] = 2,
    width: Annotated[
        str, typer.Option(metavar="85mm", help="Width of the figure on the page. [default: --columns]")
    ] = "",
    formats: Annotated[
        str, typer.Option("--format", metavar="pdf,svg,png", help="Formats, each a file.")
    ] = "pdf,png",
    dpi: Annotated[float, typer.Option(min=50, max=2400, help="Dots per inch of PNG.")] = 600.0,
    labels: Labels = None,
    output: Annotated[
        Path | None, typer.Option(help="Files without ending. [default: <motion>_<quantity> here]")
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Draw results for print: as wide as on the page, no text below 6 points.

    Left and right share a panel. Of two results the first is what the others are compared with; a folder that
    holds several results, as scso example writes it, stands for all of them.
    """
    with exit_codes(verbose):
        with undisturbed():
            from scso_nlp.figures import save_figure
            from scso_nlp.figures.quantity import plot_quantity
            from scso_nlp.figures.style import ONE_COLUMN, TWO_COLUMNS
            from scso_nlp.report.folder import read_report
            from scso_nlp.report.series import read_series, result_folders, telling_panels

        width_in_mm = _length(width) if width else (ONE_COLUMN, TWO_COLUMNS)[columns - 1]
        series = read_series(results, quantity, _words(labels or ""))
        panels, notes = ((), ()) if names else telling_panels(quantity, series)
        figure = plot_quantity(
            series,
            quantity=quantity,
            names=names,
            panels=panels,
            notes=notes,
            percent=percent,
            events=[_time(word) for word in _words(events)],
            tasks=_words(tasks),
            width=width_in_mm,
        )
        name = (read_report(result_folders(results)[0]) or {}).get("name", "results")
        target = output or Path(f"{name}_{quantity}")
        files = save_figure(figure, target.parent, target.name, formats=_words(formats), dpi=dpi)
        typer.echo(f"{', '.join(map(str, files))}: {width_in_mm:g} mm wide")


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _time(text: str) -> float:
    try:
        return number(text)
    except ValueError as error:
        raise DataError(f"--events: {error}, expected times in s such as 0.52,1.61") from None


def _length(text: str) -> float:
    """Read a length [mm]."""
    unit = text.lstrip("0123456789. ").strip()
    try:
        return number(text.strip().removesuffix(unit)) * _UNITS[unit]
    except (ValueError, KeyError):
        raise DataError(
            f"--width is {shown(text)}, expected a length such as 85mm, 8.5cm or 3.35in"
        ) from None
