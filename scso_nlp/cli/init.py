"""``scso init``: a commented settings file to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scso_nlp.cli.exit_codes import exit_codes


def init(
    path: Annotated[Path, typer.Argument(help="File to write, or a folder for scso.toml.")] = Path(
        "scso.toml"
    ),
) -> None:
    """Write a settings file with every setting explained. An existing file is left alone."""
    with exit_codes(verbose=False):
        from scso_nlp.exceptions import DataError
        from scso_nlp.settings import template

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
