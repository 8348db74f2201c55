"""``scso report``: one HTML page about results of a motion."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from scso_nlp.cli.compare import (
    EmgFile,
    EmgMapFile,
    EmgOffset,
    Labels,
    PeakEmg,
    RawEmg,
    Results,
    Verbose,
    read_comparison,
)
from scso_nlp.cli.exit_codes import exit_codes

#: Figures of a result folder that the page shows, beside those of the comparison.
_PICTURES = ("moments", "stability")


def report(
    results: Results,
    output: Annotated[Path, typer.Option(help="The page to write.")] = Path("report.html"),
    labels: Labels = None,
    emg: EmgFile = None,
    emg_map: EmgMapFile = None,
    raw_emg: RawEmg = False,
    peak_emg: PeakEmg = False,
    emg_offset: EmgOffset = 0.0,
    verbose: Verbose = False,
) -> None:
    """Write one HTML page with settings, statuses, tables and figures; it needs no network to open."""
    with exit_codes(verbose):
        from scso_nlp.report.page import write_report

        comparison = read_comparison(
            results,
            labels=labels,
            emg=emg,
            emg_map=emg_map,
            raw_emg=raw_emg,
            peak_emg=peak_emg,
            emg_offset=emg_offset,
        )
        pictures = [
            folder / f"{result.name}_{what}.png"
            for folder, result in zip(results, comparison.results, strict=True)
            for what in _PICTURES
        ]
        write_report(comparison, output, pictures=[path for path in pictures if os.path.isfile(path)])
        n = len(comparison.results)
        typer.echo(f"{output}: {n} result{'s' if n > 1 else ''}, {output.stat().st_size / 1e6:.2g} MB")
