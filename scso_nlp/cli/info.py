"""``scso info``: what a model holds, and whether a setup's files fit it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from scso_nlp.cli.exit_codes import BAD_INPUT, exit_codes
from scso_nlp.cli.options import Verbose
from scso_nlp.signals import undisturbed


def info(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL.osim|SETUP.xml|SETTINGS.toml",
            help="A model; or a setup or settings file, whose motion and loads are looked at too.",
        ),
    ],
    muscles: Annotated[bool, typer.Option("--muscles", help="One row for every muscle.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="All of it, as JSON.")] = False,
    verbose: Verbose = False,
) -> None:
    """Say what a model holds: joints, axes, coordinates, muscles that cross, reserves; and what files hold.

    Exit code 0; 2: a file that cannot be used, or that does not fit the model.
    """
    with exit_codes(verbose):
        typer.echo(f"{source.name}: asking OpenSim ...", err=True)
        with undisturbed():
            from scso_nlp.overview.info import WIDTH
            from scso_nlp.overview.info import info as look
            from scso_nlp.overview.table import as_text

        found = look(source)
        if as_json:
            typer.echo(found.to_json())
        else:
            width = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDTH
            typer.echo(as_text(found.tables(muscles=muscles), width), nl=False)
        if found.inputs is not None and found.inputs.problem:
            raise typer.Exit(BAD_INPUT)
