"""``scso batch``: every trial of every person, each by every formulation."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from scso_nlp.cli.console import Console
from scso_nlp.cli.exit_codes import FRAME_FAILED, exit_codes
from scso_nlp.cli.options import Verbose, with_settings
from scso_nlp.declared_settings import CALIBRATION, SETTINGS
from scso_nlp.messages import kept_warnings
from scso_nlp.signals import undisturbed

#: Columns of the table of a dry run where there is no terminal.
WIDTH = 160
#: As many warnings about setups are told.
MOST_WARNINGS = 5
#: Settings that the study decides, that no trials can share, or of scso calibrate.
NOT_FOR_STUDIES = (
    *("setup", "output", "overwrite", "processes", "cache", "emg_compare"),
    *(name for name, setting in SETTINGS.items() if setting.group is CALIBRATION),
)


@with_settings(without=NOT_FOR_STUDIES)
def batch(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER|STUDY.toml|STUDY.csv|SETUP.xml...",
            help="A folder of trials, a study file with one row a trial, or setup files, or a pattern.",
        ),
    ],
    *,
    output: Annotated[
        Path | None, typer.Option(help="Folder of the study. [default: scso_results/<name of the path>]")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler that runs; without it this machine works."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(help="Processes of this machine. [default: one per core, fewer where memory is short]"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Run what is done, too.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only say what would be run, and what is missing for it.")
    ] = False,
    formulation: Annotated[
        str | None,
        typer.Option(metavar="off|potvin-brown|diagonal|full,...", help="As --stability."),
    ] = None,
    verbose: Verbose = False,
    **changes: Any,
) -> None:
    """Run every trial of a study, and say what becomes of each.

    Options are settings of all trials; several values between commas make a grid, and every combination is
    run. What is done already, with the same inputs, settings and version, is left as it is. Tables of all
    results are written beside them; scso report draws figures and a page. Exit code 0: all done; 1: some
    failed or have bad input, the rest is done; 2: no study at all.
    """
    with exit_codes(verbose) as console:
        with undisturbed():
            from scso_nlp.exceptions import ProblemError
            from scso_nlp.studies.grid import alternatives
            from scso_nlp.studies.planning import plan
            from scso_nlp.studies.results import read, write_tables
            from scso_nlp.studies.running import run

        if formulation is not None and changes["stability"] is not None:
            raise ProblemError("--formulation and --stability are the same, expected one of them")
        changes["stability"] = changes["stability"] if formulation is None else formulation
        values = {
            name: alternatives(name, value) if isinstance(value, str) else [value]
            for name, value in changes.items()
            if value is not None
        }
        grid = {name: several for name, several in values.items() if len(several) > 1}
        settings = {name: several[0] for name, several in values.items() if len(several) == 1}
        with kept_warnings() as warnings, console.held_back():
            found = plan(paths[0] if len(paths) == 1 else paths, grid=grid or None, **settings)
        _tell_warnings(console, list(warnings))
        if dry_run:
            _tell_plan(found)
            return
        typer.echo(f"{found!r}", err=True)
        result = run(found, output=output, scheduler=scheduler, workers=workers, force=force)
        for outcome in result.outcomes:
            if outcome.state != "done":
                name = f"{outcome.subject}/{outcome.trial}/{outcome.condition}"
                typer.echo(f"  {name}: {outcome.state}: {outcome.sentence}", err=True)
        typer.echo(f"{result!r}")
        write_tables(read(result.folder))
        typer.echo(f"  its tables are there; scso report {result.folder} draws figures and writes a page")
        if not result.is_done:
            raise typer.Exit(FRAME_FAILED)


def _tell_warnings(console: Console, warnings: list[str]) -> None:
    """Tell what reading the setups of many trials warns of, as far as anybody would read it."""
    console.tell(warnings[:MOST_WARNINGS])
    if (more := len(warnings) - MOST_WARNINGS) > 0:
        console.tell([f"{more} more warnings; scso run tells those of one trial"])


def _tell_plan(found: Any) -> None:
    from scso_nlp.overview.table import Table, as_text

    table = Table(title=repr(found), head=found.HEAD, rows=found.rows())
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDTH
    typer.echo(as_text([table], width), nl=False)
