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
    path: Annotated[
        Path | None, typer.Argument(help="File to write, or a folder for it. [default: scso.toml]")
    ] = None,
    show_reference: Annotated[
        bool, typer.Option("--reference", help="Only print the reference page of all settings, in Markdown.")
    ] = False,
    emg_map: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL", help="Write a map of EMG channels for this model instead, emg_map.toml."
        ),
    ] = None,
) -> None:
    """Write a settings file with every setting explained. An existing file is left alone."""
    with exit_codes(verbose=False):
        if show_reference:
            typer.echo(reference(), nl=False)
            return
        if emg_map is None:
            name, text, next_step = "scso.toml", template(), "fill in the paths, then scso run {}"
        else:
            name, text = "emg_map.toml", _map_of(emg_map)
            next_step = "fill in the channels, then scso compare RESULT --emg EMG --emg-map {}"
        path = Path(name) if path is None else path / name if os.path.isdir(path) else path
        if os.path.lexists(path):
            raise DataError(f"{path} exists already, choose another name")
        with write_whole(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        typer.echo(f"wrote {path}: {next_step.format(path)}")


def _map_of(model: Path) -> str:
    """Write a map file for the muscles that stand in a model's file."""
    from scso_nlp.emg.map import map_skeleton
    from scso_nlp.opensim.model_names import names_in

    return map_skeleton(names_in(model).muscles, model.name)
