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
from scso_nlp.messages import STAGES
from scso_nlp.progress import stages_shown
from scso_nlp.signals import undisturbed

#: Name of the file where none is given.
FILE = "scso.toml"


def init(
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SETUP.xml]",
            help="AnalyzeTool setup file to find settings for; without one, the file to write.",
        ),
    ] = None,
    target: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="File to write, or a folder for it. [default: scso.toml]"),
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
    """Write a settings file with every setting explained. An existing file is left alone.

    With a setup file the settings are for its model and motion: joints that muscles can make stable, and a
    stiffness gain q at which they can.
    """
    with exit_codes(verbose=False):
        if show_reference:
            typer.echo(reference(), nl=False)
            return
        is_setup = emg_map is None and source is not None and source.suffix.lower() == ".xml"
        if target is not None and not is_setup:
            raise DataError(f"{source} is no setup file, expected one that ends in .xml before {target}")
        where, name = target if is_setup else source, FILE if emg_map is None else "emg_map.toml"
        path = Path(name) if where is None else where / name if os.path.isdir(where) else where
        if os.path.lexists(path):
            raise DataError(f"{path} exists already, choose another name")
        if emg_map is not None:
            text = _map_of(emg_map)
            next_step = f"fill in the channels, then scso compare RESULT --emg EMG --emg-map {path}"
        elif is_setup and source is not None:
            text, reasons = _for_setup(source, path)
            next_step = "\n  ".join([f"settings for {source}, then scso run {path}", *reasons])
        else:
            text, next_step = template(), f"fill in the paths, then scso run {path}"
        with write_whole(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        typer.echo(f"wrote {path}: {next_step}")


def _map_of(model: Path) -> str:
    """Write a map file for the muscles that stand in a model's file."""
    from scso_nlp.emg.map import map_skeleton
    from scso_nlp.opensim.model_names import names_in

    return map_skeleton(names_in(model).muscles, model.name)


def _for_setup(setup: Path, path: Path) -> tuple[str, list[str]]:
    """Return the text of the file, and why its settings are as they are."""
    with stages_shown(delay=0.0):
        STAGES.info("starting")
        with undisturbed():
            from scso_nlp.first_settings import first_settings

        found = first_settings(setup)
    reasons = [f"{name}: {reason}" for name, reason in found.reasons.items()]
    return found.text(path.absolute().parent), reasons
