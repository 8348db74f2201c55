"""``scso run``: from a setup or settings file to result files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scso_nlp.cli.exit_codes import FRAME_FAILED, exit_codes
from scso_nlp.exceptions import DataError

if TYPE_CHECKING:
    from scso_nlp.run import RunResult


def run(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SETUP.xml|SETTINGS.toml",
            help="AnalyzeTool setup file with a StaticOptimization, or a settings file (see scso init).",
        ),
    ],
    output: Annotated[
        Path | None, typer.Option(help="Folder of the results. [default: scso_results/<name>]")
    ] = None,
    stability: Annotated[
        str | None,
        typer.Option(
            metavar="potvin-brown|diagonal|full|off",
            help="Stability about joint axes, along coordinates, or of their whole Hessian. [default: off]",
        ),
    ] = None,
    q: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|NAME=NUMBER,...",
            help="Muscle stiffness = q x force / length; for all, or by name or pattern. [default: 5]",
        ),
    ] = None,
    level: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|ROW=NUMBER,...",
            help="Least stability [N.m/rad]; for all, or by <joint>_<axis> or coordinate. [default: 0]",
        ),
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="A,B,...", help="Joints of potvin-brown. [default: all]")
    ] = None,
    axes: Annotated[
        str | None, typer.Option(metavar="x,y,z", help="Axes of each of these joints. [default: all]")
    ] = None,
    coordinates: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,...",
            help="Coordinates of diagonal and full. [default: all that muscles cross]",
        ),
    ] = None,
    stiffness: Annotated[
        str | None,
        typer.Option(
            metavar="proportional|short-range|fiber", help="Law of muscle stiffness. [default: proportional]"
        ),
    ] = None,
    passive: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NAME=NUMBER,...",
            help="Passive stiffness [N.m/rad] besides the model's own: by row, or a file (see scso init).",
        ),
    ] = None,
    soft: Annotated[
        float | None,
        typer.Option(
            metavar="PENALTY",
            help="Let levels be missed, at this price per N.m/rad. [default: they may not]",
        ),
    ] = None,
    exponent: Annotated[
        float | None, typer.Option(help="Power of the activations, at least 1; inf for min/max.")
    ] = None,
    muscle_physiology: Annotated[
        bool | None,
        typer.Option(
            "--muscle-physiology/--no-muscle-physiology",
            help="Force-length-velocity, or force = activation x strength. [default: as in the setup]",
        ),
    ] = None,
    muscle_model: Annotated[
        str | None,
        typer.Option(
            metavar="opensim-rigid|physical-rigid|compliant|none",
            help="OpenSim's own capacity, the textbook's rigid tendon, elastic tendons, or strength alone. "
            "[default: opensim-rigid or none, as in the setup]",
        ),
    ] = None,
    keep_coupled_speeds: Annotated[
        bool | None,
        typer.Option(
            "--keep-coupled-speeds/--coupled-speeds-from-constraints",
            help="Speeds of coupled coordinates: as in the motion and in OpenSim, or as the model's "
            "constraints have them. [default: keep]",
        ),
    ] = None,
    solver: Annotated[
        str | None, typer.Option(metavar="trajectory|framewise", help="[default: trajectory]")
    ] = None,
    keep_failed: Annotated[
        bool | None,
        typer.Option("--keep-failed", help="Write results even so, with NaN in frames that failed."),
    ] = None,
    figures: Annotated[bool | None, typer.Option("--figures/--no-figures", help="[default: figures]")] = None,
    processes: Annotated[int | None, typer.Option(help="OpenSim processes. [default: one per core]")] = None,
    cache: Annotated[
        Path | None, typer.Option(help="Folder for what OpenSim computed, to be used again. [default: none]")
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say what is being done.")] = False,
) -> None:
    """Find muscle activations and forces of a motion, and write them as OpenSim does.

    With a plain setup file the answer is that of OpenSim's own static optimization. Exit code 0: all frames
    solved; 1: some frame failed; 2: input that cannot be used.
    """
    with exit_codes(verbose):
        from scso_nlp.run import run as solve
        from scso_nlp.run import write_run
        from scso_nlp.settings import read_settings

        changes: dict[str, Any] = {
            "output": output,
            "stability": stability,
            "q": _number_or_table("q", q),
            "level": _number_or_table("level", level),
            "joints": _list(joints),
            "axes": _list(axes),
            "stability_coordinates": _list(coordinates),
            "stiffness": stiffness,
            "passive": passive
            if passive is None or "=" not in passive
            else _number_or_table("passive", passive),
            "soft": soft,
            "keep_coupled_speeds": keep_coupled_speeds,
            "exponent": exponent,
            "muscle_physiology": muscle_physiology,
            "muscle_model": muscle_model,
            "solver": solver,
            "keep_failed": keep_failed,
            "figures": figures,
            "processes": processes,
            "cache": cache,
        }
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
    seconds = {
        **result.record.seconds,
        "solve": solution.report.build_seconds + solution.report.solve_seconds,
    }
    typer.echo("  " + ", ".join(f"{what} {value:.2f} s" for what, value in seconds.items()))
    kind = (
        "results" if any("_activation" in path.name for path in files) else "status and report, no results,"
    )
    typer.echo(f"  {kind} in {files[-1].parent}")


def _list(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _number_or_table(name: str, text: str | None) -> float | dict[str, float] | None:
    if text is None:
        return None
    try:
        if "=" not in text:
            return float(text)
        pairs = [part.rsplit("=", 1) for part in text.split(",")]
        return {key.strip(): float(value) for key, value in pairs}
    except ValueError:
        raise DataError(f"{name} is {text!r}, expected a number or name=number,...") from None
