"""``scso init``: a commented settings file to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scso_nlp.cli.exit_codes import exit_codes
from scso_nlp.declared_settings import reference, template
from scso_nlp.exceptions import DataError


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
        if path.is_dir():
            path = path / "scso.toml"
        try:
            with open(path, "x", encoding="utf-8") as file:
                file.write(template())
        except FileExistsError:
            raise DataError(f"{path} exists already, choose another name") from None
        except OSError as error:
            raise DataError(f"{path} cannot be written: {error.strerror or error}") from None
        typer.echo(f"wrote {path}: fill in the paths, then scso run {path}")
