"""``scso run``: from a setup or settings file to result files."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scso_nlp.cli.exit_codes import FRAME_FAILED, exit_codes
from scso_nlp.declared_settings import FLAG, SETTINGS, Setting

if TYPE_CHECKING:
    from scso_nlp.run import RunResult


def _option(setting: Setting) -> inspect.Parameter:
    """Make a parameter of a command, for typer to make an option of."""
    words = setting.kind.words or None
    option = typer.Option(None, setting.spelling, metavar=words, help=setting.description)
    kind = bool | None if setting.kind is FLAG else str | None
    return inspect.Parameter(setting.name, inspect.Parameter.KEYWORD_ONLY, default=option, annotation=kind)


def _with_every_setting(command: Callable[..., None]) -> Any:
    """Put an option for every setting in place of ``**changes``."""
    signature = inspect.signature(command, eval_str=True)
    source, verbose, _ = signature.parameters.values()
    options = [_option(setting) for setting in SETTINGS.values()]
    signed: Any = command
    signed.__signature__ = signature.replace(parameters=[source, *options, verbose])
    return signed


@_with_every_setting
def run(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SETUP.xml|SETTINGS.toml",
            help="AnalyzeTool setup file with a StaticOptimization, or a settings file (see scso init).",
        ),
    ],
    *,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say what is being done.")] = False,
    **changes: Any,
) -> None:
    """Find muscle activations and forces of a motion, and write them as OpenSim does.

    With a plain setup file the answer is that of OpenSim's own static optimization. Exit code 0: all frames
    solved; 1: some frame failed; 2: input that cannot be used.
    """
    with exit_codes(verbose):
        from scso_nlp.run import run as solve
        from scso_nlp.run import write_run
        from scso_nlp.settings import read_settings

        settings, where = read_settings(source, changes)
        result = solve(settings, where)
        files = write_run(result, where)
        _report(result, files)
        if not result.is_solved:
            raise typer.Exit(FRAME_FAILED)


def _report(result: RunResult, files: tuple[Path, ...]) -> None:
    solution = result.solution
    trajectory = solution.problem.motion.trajectory
    typer.echo(f"{trajectory.name}: {solution.summary()}", err=not result.is_solved)
    for shortfall in solution.shortfalls[1:5]:
        typer.echo(f"  {shortfall}", err=True)
    report = solution.report
    seconds = {**result.record.seconds, "solve": report.build_seconds + report.solve_seconds}
    typer.echo("  " + ", ".join(f"{what} {value:.2f} s" for what, value in seconds.items()))
    has_results = any("_activation" in path.name for path in files)
    kind = "results" if has_results else "status and report, no results,"
    typer.echo(f"  {kind} in {files[-1].parent}")
