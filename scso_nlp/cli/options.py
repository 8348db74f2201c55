"""Options that are made from the settings, for the commands that take them all."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any

import typer

from scso_nlp.declared_settings import FLAG, SETTINGS, Setting

#: What a command starts from.
Source = Annotated[
    Path,
    typer.Argument(
        metavar="SETUP.xml|SETTINGS.toml",
        help="AnalyzeTool setup file with a StaticOptimization, or a settings file (see scso init).",
    ),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say what is being done.")]


def _option(setting: Setting) -> inspect.Parameter:
    """Make a parameter of a command, for typer to make an option of."""
    words = setting.kind.words or None
    option = typer.Option(None, setting.spelling, metavar=words, help=setting.description)
    kind = bool | None if setting.kind is FLAG else str | None
    return inspect.Parameter(setting.name, inspect.Parameter.KEYWORD_ONLY, default=option, annotation=kind)


def with_every_setting(command: Callable[..., None]) -> Any:
    """Put an option for every setting in place of ``**changes``."""
    return with_settings()(command)


def with_settings(without: Collection[str] = ()) -> Callable[[Callable[..., None]], Any]:
    """Put an option for every setting but some in place of ``**changes``, after the argument."""

    def decorate(command: Callable[..., None]) -> Any:
        signature = inspect.signature(command, eval_str=True)
        argument, *others, _ = signature.parameters.values()
        options = [_option(setting) for name, setting in SETTINGS.items() if name not in without]
        signed: Any = command
        signed.__signature__ = signature.replace(parameters=[argument, *options, *others])
        return signed

    return decorate
