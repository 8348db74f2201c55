"""``scso init``: a commented settings file to start from."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from scso_nlp.cli.exit_codes import exit_codes
from scso_nlp.declared_settings import reference, template
from scso_nlp.exceptions import DataError
from scso_nlp.files import write_whole


def init(
    path: Annotated[Path, typer.Argument(help="File to write, or a folder for scso.toml.")] = Path(
        "scso.toml"
    ),
    show_reference: Annotated[
        bool, typer.Option("--reference", help="Only print the reference page of all settings, in Markdown.")
    ] = False,
) -> None:
    """Write a settings file with every setting explained. An existing file is left alone."""
    with exit_codes(verbose=False):
        if show_reference:
            typer.echo(reference(), nl=False)
            return
        if os.path.isdir(path):
            path = path / "scso.toml"
        if os.path.lexists(path):
            raise DataError(f"{path} exists already, choose another name")
        with write_whole(path) as temporary:
            temporary.write_text(template(), encoding="utf-8")
        typer.echo(f"wrote {path}: fill in the paths, then scso run {path}")
