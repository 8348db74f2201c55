"""``scso compare``: results of one motion side by side, and EMG beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scso_nlp.cli.exit_codes import exit_codes
from scso_nlp.exceptions import DataError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from scso_nlp.emg import Comparison, MotionResult

Results = Annotated[
    list[Path], typer.Argument(metavar="RESULT...", help="Result folders of one motion, written by scso run.")
]
Labels = Annotated[
    str | None, typer.Option(metavar="A,B,...", help="Names of the results. [default: their folders']")
]
EmgFile = Annotated[Path | None, typer.Option("--emg", help="EMG: .sto, .mot or .csv, see --emg-map.")]
EmgMapFile = Annotated[
    Path | None,
    typer.Option("--emg-map", help="TOML file: groups of muscles and the EMG channels over them."),
]
RawEmg = Annotated[
    bool, typer.Option("--raw-emg", help="The EMG is raw: band-pass, rectify and smooth it first.")
]
PeakEmg = Annotated[
    bool, typer.Option("--peak-emg", help="Divide each channel by its largest value: compare shapes only.")
]
EmgOffset = Annotated[float, typer.Option(help="Added to the times of the EMG [s].")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say what is being done.")]


def compare(
    results: Results,
    labels: Labels = None,
    emg: EmgFile = None,
    emg_map: EmgMapFile = None,
    raw_emg: RawEmg = False,
    peak_emg: PeakEmg = False,
    emg_offset: EmgOffset = 0.0,
    output: Annotated[
        Path | None, typer.Option(help="Folder for comparison.csv and figures. [default: only print]")
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Compare results of one motion with each other and with EMG.

    Without a map file every muscle stands for itself. Frames that some result has not solved are left out of
    all numbers.
    """
    with exit_codes(verbose):
        from scso_nlp.emg import format_comparison, write_comparison_csv
        from scso_nlp.files import make_folder

        comparison = read_comparison(
            results,
            labels=labels,
            emg=emg,
            emg_map=emg_map,
            raw_emg=raw_emg,
            peak_emg=peak_emg,
            emg_offset=emg_offset,
        )
        if output is not None:
            make_folder(output)
            write_comparison_csv(comparison, output / "comparison.csv")
            _write_figures(comparison, output)
        # files first: a reader such as `head` may close the output early
        typer.echo(format_comparison(comparison))
        if output is not None:
            typer.echo(f"\ntable and figures in {output}")


def read_comparison(
    results: list[Path],
    *,
    labels: str | None,
    emg: Path | None,
    emg_map: Path | None,
    raw_emg: bool,
    peak_emg: bool,
    emg_offset: float,
    prepare: Callable[[Sequence[MotionResult]], Sequence[MotionResult]] = tuple,
) -> Comparison:
    """Read everything that the options name and compare it; see :func:`compare`.

    The results go through `prepare` before.
    """
    from scso_nlp.emg import compare as compare_results
    from scso_nlp.emg import read_emg_map, read_envelope, read_results

    if emg is None and (raw_emg or peak_emg or emg_offset):
        raise DataError(
            "--raw-emg, --peak-emg and --emg-offset say something about EMG, but there is no --emg"
        )
    if emg is not None and emg_map is None:
        raise DataError("EMG needs a map file that says which channels belong to which muscles: --emg-map")
    groups = None if emg_map is None else read_emg_map(emg_map)
    measured = None
    if emg is not None and groups is not None:
        measured = read_envelope(emg, groups, is_raw=raw_emg, by_peak=peak_emg)
    names = [name.strip() for name in labels.split(",")] if labels else []
    return compare_results(
        prepare(read_results(results, names)), emg=measured, emg_map=groups, start_offset=emg_offset
    )


def _write_figures(comparison: Comparison, folder: Path) -> None:
    from functools import partial

    from scso_nlp.figures import activity_pages, draw_and_save, plot_mean_activity, plot_task_bars
    from scso_nlp.figures.comparison import are_tasks

    figures: dict[str, Callable[[Comparison], Figure | Sequence[Figure]]]
    figures = {"activity": activity_pages, "mean_activity": plot_mean_activity}
    if are_tasks(comparison):
        figures["tasks"] = plot_task_bars
    for what, draw in figures.items():
        draw_and_save(partial(draw, comparison), folder, f"comparison_{what}")
