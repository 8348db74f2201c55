"""``scso run``: from a setup or settings file to result files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from scso_nlp.cli.exit_codes import FRAME_FAILED, exit_codes
from scso_nlp.cli.options import Source, Verbose, with_every_setting
from scso_nlp.declared_settings import SETTINGS
from scso_nlp.messages import STAGES
from scso_nlp.opensim.workers import number_of_cores, started_early
from scso_nlp.progress import stages_shown
from scso_nlp.signals import undisturbed

if TYPE_CHECKING:
    from scso_nlp.run import RunResult


@with_every_setting
def run(source: Source, *, verbose: Verbose = False, **changes: Any) -> None:
    """Find muscle activations and forces of a motion, and write them as OpenSim does.

    With a plain setup file the answer is that of OpenSim's own static optimization. Exit code 0: all frames
    solved; 1: some frame failed, is acceptable only or misses a soft level; 2: input that cannot be used.
    """
    with exit_codes(verbose) as console, started_early(_most_workers(source, changes)):
        with stages_shown(delay=0.0), undisturbed():
            STAGES.info("starting")
            from scso_nlp.report.folder import read_report, refuse_unwritable
            from scso_nlp.run import run as solve
            from scso_nlp.run import write_run
            from scso_nlp.settings import read_settings

        settings, where = read_settings(source, changes)
        folder = where.folder_for(settings.motion.name).absolute()
        refuse_unwritable(folder)
        before = (read_report(folder) or {}).get("warnings")
        with stages_shown(delay=0.0), console.held_back():
            result = solve(settings, where)
        console.tell(result.record.warnings, known=before if isinstance(before, list) else ())
        # known now; figures take longer than solving
        _tell_answer(result)
        with stages_shown(delay=0.0):
            files = write_run(result, where)
        _tell_files(result, files)
        if not result.solution.verdict.is_clean:
            raise typer.Exit(FRAME_FAILED)


def _most_workers(source: Path, changes: Mapping[str, Any]) -> int:
    """Return how many workers may be needed, as far as options tell."""
    if not source.is_file() or changes["cache"] is not None:
        return 0
    told = changes["processes"] or ""
    return int(told) if told.isdecimal() else number_of_cores()


def _tell_answer(result: RunResult) -> None:
    from scso_nlp.solver.advice import next_steps

    solution = result.solution
    trajectory = solution.problem.motion.trajectory
    typer.echo(f"{trajectory.name}: {solution.summary()}", err=not result.is_solved)
    for line in result.verdict_lines:
        typer.echo(f"  {line}")
    if kept := solution.report.kept(trajectory.n_frames):
        typer.echo(f"  {kept}")
    for reason in (*solution.other_rows()[:4], *solution.contradictions[:1]):
        typer.echo(f"  {reason}", err=True)
    for step in next_steps(solution):
        option = SETTINGS[step.setting].spelling
        typer.echo(f"  try {option} {step.value}: {step.effect}", err=True)


def _tell_files(result: RunResult, files: tuple[Path, ...]) -> None:
    """Say where the files are, and what each stage of the run took: the times of the report."""
    from scso_nlp.report.folder import read_report

    folder = files[-1].parent
    seconds = (read_report(folder) or {}).get("seconds", {})
    typer.echo("  " + ", ".join(f"{stage} {value:.2f} s" for stage, value in seconds.items()))
    has_results = any("_activation" in path.name for path in files)
    kind = "results" if has_results else "status and report, no results,"
    typer.echo(f"  {kind} in {folder}")
    for note in result.record.notes:
        typer.echo(f"  {note}")
