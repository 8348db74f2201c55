"""``scso example``: the embedded examples, solved with and without stability rows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scso_nlp.cli.exit_codes import FRAME_FAILED, exit_codes
from scso_nlp.progress import stages_shown
from scso_nlp.signals import undisturbed

if TYPE_CHECKING:
    from scso_nlp.run import RunResult


def example(
    name: Annotated[str | None, typer.Argument(help="Without it: list the examples.")] = None,
    output: Annotated[
        Path | None, typer.Option(help="Folder of the results. [default: scso_results/<name>]")
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")] = True,
    copy: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Only copy its model, motion and setup.xml to this folder."),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say what is being done.")] = False,
) -> None:
    """Solve an embedded example by static optimization and with stability rows, and compare."""
    with exit_codes(verbose):
        from scso_nlp.examples import example_folder, example_names

        if name is None:
            width = max(len(known) for known in example_names())
            for known in example_names():
                typer.echo(f"{known:<{width}}  {_title(example_folder(known))}")
            return
        source = example_folder(name)
        if copy is not None:
            _copy(source, copy)
            typer.echo(f"{name} in {copy}: scso run {copy / 'setup.xml'}")
            return
        with undisturbed():
            from dataclasses import replace

            from scso_nlp.run import run, write_run
            from scso_nlp.settings import OutputSettings, read_settings

        settings, _ = read_settings(source / "scso.toml")
        with stages_shown(delay=0.0):
            result = run(settings)
        folder = output or Path("scso_results") / name
        if result.baseline is not None:
            plain = replace(result, solution=result.baseline, baseline=None)
            write_run(plain, OutputSettings(folder=folder / "static_optimization", figures=figures))
        write_run(result, OutputSettings(folder=folder / "with_stability", figures=figures))
        typer.echo(f"{name}: {_title(source)}")
        typer.echo(f"(provenance and limits: {source / 'README.md'})\n")
        typer.echo(_table(result))
        typer.echo(f"\n{result.solution.summary()}\nfiles and figures in {folder}")
        if not result.is_solved:
            raise typer.Exit(FRAME_FAILED)


def _copy(source: Path, folder: Path) -> None:
    """Copy the files of an example; none that exists is replaced."""
    import shutil

    from scso_nlp.exceptions import DataError
    from scso_nlp.files import make_folder

    make_folder(folder)
    files = sorted(path for path in source.iterdir() if path.is_file())
    for path in files:
        if (folder / path.name).exists():
            raise DataError(f"{folder / path.name} exists already, choose another folder")
    for path in files:
        shutil.copyfile(path, folder / path.name)


def _title(folder: Path) -> str:
    """First line of the example's settings file."""
    with open(folder / "scso.toml", encoding="utf-8") as file:
        return file.readline().removeprefix("#").strip()


def _table(result: RunResult) -> str:
    """One line per frame: mean activation and least stable row, without and with stability rows."""
    import numpy as np

    solution = result.solution
    runs = [run for run in (result.baseline, solution) if run is not None]
    margins = [run.stability for run in runs]
    names = ["static optimization", "with stability rows"][-len(runs) :]
    lines = [
        " " * 8 + "".join(f"  | {name:<40}" for name in names),
        f"{'time [s]':>8}" + f"  | {'activation':>10}  {'least margin [N·m/rad]':<28}" * len(runs),
    ]
    for k, time in enumerate(solution.problem.motion.trajectory.time):
        cells = f"{time:8.4g}"
        for run, margin in zip(runs, margins, strict=True):
            if not run.is_solved[k]:
                cells += f"  | {'not solved':<40}"
                continue
            cells += f"  | {np.mean(run.activation[k]):10.4f}  "
            if margin is not None:
                row = int(np.argmin(margin.margin[k]))
                cells += f"{margin.margin[k, row]:z8.2f} {margin.rows[row]:<19}"
        lines.append(cells.rstrip())
    return "\n".join(
        [*lines, "", "activation: mean of all muscles; margin: stability minus level, least of all rows"]
    )
