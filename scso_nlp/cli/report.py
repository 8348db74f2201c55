"""``scso report``: one HTML page about results of a motion, or about a study."""

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
from scso_nlp.exceptions import DataError
from scso_nlp.signals import undisturbed

#: Figures of a result folder that the page shows, beside those of the comparison.
_PICTURES = ("moments", "stability", "joint_reactions")


def report(
    results: Results,
    output: Annotated[
        Path | None,
        typer.Option(help="The page to write. [default: report.html; of a study, in its folder]"),
    ] = None,
    labels: Labels = None,
    emg: EmgFile = None,
    emg_map: EmgMapFile = None,
    raw_emg: RawEmg = False,
    peak_emg: PeakEmg = False,
    emg_offset: EmgOffset = 0.0,
    verbose: Verbose = False,
) -> None:
    """Write one HTML page: what was asked, what it is worth, what changed; it needs no network to open.

    A single result of a run with stability rows stands beside the static optimization that it began with.
    Of a run that failed the page says what each row misses. The folder of a study gives its tables, too, and
    a page that leads to one for every trial.
    """
    with exit_codes(verbose):
        from scso_nlp.files import absolute
        from scso_nlp.report.folder import failed_run
        from scso_nlp.report.page import write_failure, write_report
        from scso_nlp.report.story import with_static_optimization
        from scso_nlp.studies.record import STUDY

        if len(results) == 1 and os.path.isfile(absolute(results[0]) / STUDY):
            if emg or labels:
                raise DataError(
                    f"{results[0]} is a study, in which labels and EMG have no place; name folders of one of "
                    "its trials"
                )
            _report_study(absolute(results[0]), output)
            return
        output = output or Path("report.html")
        if len(results) == 1 and (failed := failed_run(absolute(results[0]))):
            write_failure(failed, labels or absolute(results[0]).name, output)
            typer.echo(f"{output}: a run that failed, {output.stat().st_size / 1e6:.2g} MB")
            return
        comparison = read_comparison(
            results,
            labels=labels,
            emg=emg,
            emg_map=emg_map,
            raw_emg=raw_emg,
            peak_emg=peak_emg,
            emg_offset=emg_offset,
            prepare=with_static_optimization,
        )
        name = comparison.results[0].name
        pictures = [folder / f"{name}_{what}.png" for folder in results for what in _PICTURES]
        write_report(comparison, output, pictures=[path for path in pictures if os.path.isfile(path)])
        n = len(results)
        typer.echo(f"{output}: {n} result{'s' if n > 1 else ''}, {output.stat().st_size / 1e6:.2g} MB")


def _report_study(folder: Path, output: Path | None) -> None:
    """Write tables, figures and pages of a study."""
    with undisturbed():
        from scso_nlp.studies.page import write_cohort
        from scso_nlp.studies.results import read, write_tables

    study = read(folder)
    write_tables(study)
    page = write_cohort(study, output)
    typer.echo(f"{study}\n{page}: {page.stat().st_size / 1e6:.2g} MB; tables and figures in {folder}")
