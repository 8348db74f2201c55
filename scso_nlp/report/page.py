"""One self-contained HTML page about results of a motion: what was asked, what came out, how sure it is.

The page needs no network and runs no script: figures stand in it as data, the style is a few lines of CSS,
and everything that comes from files is escaped. It is plain enough for a phone and for a screen reader.
Its template is ``page.html``; here stands what goes into it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scso_nlp.emg.comparison import Comparison, ComparisonRow, format_number
from scso_nlp.emg.motion_result import MotionResult
from scso_nlp.exceptions import DataError
from scso_nlp.figures.comparison import are_tasks, plot_activity, plot_mean_activity, plot_task_bars
from scso_nlp.figures.quantity import Quantity, plot_quantity
from scso_nlp.figures.series import Series
from scso_nlp.figures.sides import paired
from scso_nlp.files import read_bytes
from scso_nlp.report import story
from scso_nlp.report.html import address, figure_address, render, write_page
from scso_nlp.trajectory import time_text
from scso_nlp.verdict import USABLE

#: More muscles than this, left and right together, get a figure for every joint [panels].
MOST_PANELS_OF_ONE = 12
#: More groups than this get no panels of their own in the report; the table has them all.
MOST_PANELS = 60
#: What rows of a failed run miss: in no result file, so that nobody can ask for it.
_SHORTFALL = Quantity(word="Shortfall", kind="row")
#: Entries of one list or mapping that are shown.
MOST_ENTRIES = 40

#: What the metrics mean, in the order in which their tables stand; others come first.
_MEANING = {
    "mean absolute difference": "Mean over frames of |prediction - EMG|, the paper's measure.",
    "RMSE": "Root mean squared difference from EMG.",
    "Pearson r": "Likeness of shape at no lag, whatever the level. Not defined where a muscle stays silent.",
    "best lagged r": "Pearson r at the lag of at most 0.2 s where it is largest.",
    "lag of best r": "Positive: the prediction comes later than EMG.",
    "activity ratio": "Mean activity of the first side over that of the second.",
    "common activity": "Falconer and Winter (1985): 0 never together, 1 always equal.",
    "co-contraction": "Rudolph et al. (2000): 0 one side silent, 2 both fully active.",
    "mean activity": "Mean activation over the frames used, and mean EMG envelope.",
    "peak activity": "Largest activation over the frames used, and largest EMG envelope.",
    "smallest stability": "Least stability of the row over the frames used. Rows that are all kept do "
    "not prove a joint stable in every direction.",
}
_MUSCLES = "Activation: all muscles, or those that differ most."
#: What the page says of EMG.
_WITH_EMG = "Gray in figures is measured EMG."
_WITHOUT_EMG = "No EMG was given: nothing here says which result is nearer to a person."
#: Parts of the page that not every page has.
_EMPTY: dict[str, object] = dict.fromkeys(("about_emg", "headlines", "changes", "missing", "tables"), "")
_EMPTY |= {"joints": {}, "has_intervals": False}
#: Entries of a result's report that stand elsewhere on the page, or nowhere.
_SHOWN_ELSEWHERE = {"frame_status", "without_stability", "summary", "verdict", "files_sha256", "name"}


def write_report(
    comparison: Comparison,
    path: str | os.PathLike[str],
    *,
    figures: Mapping[str, Figure] | None = None,
    pictures: Iterable[str | os.PathLike[str]] = (),
) -> None:
    """Write the page.

    Parameters
    ----------
    comparison : Comparison
    path : path
        The ``.html`` file; an existing one is replaced.
    figures : mapping of str to Figure, optional
        More figures, by caption, below the standard ones.
    pictures : iterable of path
        PNG files to embed, e.g. those of the result folders.

    Raises
    ------
    DataError
        A picture that is no PNG file, or a page that cannot be written.
    """
    text = render_report(comparison, figures=figures, pictures=pictures)
    write_page(path, text)


def render_report(
    comparison: Comparison,
    *,
    figures: Mapping[str, Figure] | None = None,
    pictures: Iterable[str | os.PathLike[str]] = (),
) -> str:
    """Make the page's text, see :func:`write_report`.

    Returns
    -------
    str
        HTML.
    """
    drawn = {**_standard_figures(comparison), **(figures or {})}
    return _page(
        name=comparison.results[0].name,
        extent=_extent(comparison),
        about_emg=_WITH_EMG if comparison.emg is not None else _WITHOUT_EMG,
        results=[_result(result) for result in comparison.results],
        joints=_addresses(_joint_figures(comparison)),
        headlines=story.emg_headline(comparison),
        changes=story.largest_changes(comparison),
        figures=_addresses(drawn) | dict(map(_picture, map(Path, pictures))),
        has_intervals=any(not math.isnan(row.low) for row in comparison.rows),
        tables=_tables(comparison.rows),
    )


def write_failure(report: Mapping[str, Any], label: str, path: str | os.PathLike[str]) -> None:
    """Write the page about a run that left no results: what was asked, and what each row misses.

    Parameters
    ----------
    report : mapping
        As in ``report.json``.
    label : str
    path : path
        The ``.html`` file; an existing one is replaced.

    Raises
    ------
    DataError
        A page that cannot be written.
    """
    statuses = [str(status) for status in report["frame_status"]]
    solved = sum(status in USABLE for status in statuses)
    card = _card(label, report) | {"solved": f"{solved} of {len(statuses)}", "is_failed": True}
    text = _page(
        name=report["name"],
        extent=f"{len(statuses)} frames. The run failed, so it left no activations.",
        results=[card],
        missing=story.missing(report),
        figures=_addresses(_shortfall_figures(report)),
    )
    write_page(path, text)


def _page(**contents: object) -> str:
    """Fill the template; what is not given is empty."""
    return render("page.html", **_EMPTY | contents)


def _addresses(figures: Mapping[str, Figure]) -> dict[str, str]:
    return {caption: figure_address(figure) for caption, figure in figures.items()}


def _extent(comparison: Comparison) -> str:
    used, n_frames = int(comparison.is_used.sum()), len(comparison.time)
    first, last = float(comparison.time[0]), float(comparison.time[-1])
    return f"{n_frames} frames over {last - first:.4g} s, from t = {time_text(first)} s. " + (
        "All frames are used below."
        if used == n_frames
        else f"Tables use the {used} frames that all results have solved."
    )


def _result(result: MotionResult) -> dict[str, Any]:
    solved = int(result.is_solved.sum())
    return _card(result.label, result.report) | {
        "solved": f"{solved} of {result.n_frames}",
        "is_failed": solved < result.n_frames,
    }


def _card(label: str, report: Mapping[str, Any]) -> dict[str, Any]:
    """Tell of one run, whether it left results or not."""
    seconds = report.get("seconds")
    seconds = seconds.get("solve") if isinstance(seconds, Mapping) else report.get("solve_seconds")
    return {
        "label": label,
        "summary": report.get("summary", ""),
        "model": story.model_of(report),
        "asked": story.asked(report),
        "standing": story.standing(report),
        "time": f"{seconds:.3g} s" if isinstance(seconds, int | float) else "",
        "facts": list(_facts("", {k: v for k, v in report.items() if k not in _SHOWN_ELSEWHERE})),
    }


def _standard_figures(comparison: Comparison) -> dict[str, Figure]:
    if comparison.emg is None:
        series = [_series(result) for result in comparison.results]
        return {f"{_MUSCLES} Frames that are not solved are left blank.": plot_quantity(series)}
    if len(comparison.groups) > MOST_PANELS:
        return {}
    figures = {
        "Mean activation of every group. Whiskers on EMG: standard deviation over the frames.": (
            plot_mean_activity(comparison)
        )
    }
    if are_tasks(comparison):
        figures["Activation in every task, by its time."] = plot_task_bars(comparison)
    else:
        figures["Activation over the motion. Frames that are not solved are left blank."] = plot_activity(
            comparison
        )
    return figures


def _joint_figures(comparison: Comparison) -> dict[str, Figure]:
    """Draw all muscles, by the coordinate that they move most, where one figure has not room for them."""
    series = [_series(result) for result in comparison.results]
    muscles = comparison.results[0].muscles
    moved = story.moved_coordinates(comparison.results[-1].report, muscles)
    if len(paired(muscles)) <= MOST_PANELS_OF_ONE:
        return {}
    figures = {}
    for joint in paired(tuple(dict.fromkeys(moved.values()))):
        of_joint = [muscle for muscle, name in moved.items() if name in joint.members.values()]
        figures[joint.title] = plot_quantity(series, panels=paired(of_joint), heading=joint.title)
    return figures


def _series(result: MotionResult) -> Series:
    return Series(
        label=result.label,
        time=result.time,
        names=result.muscles,
        values=np.where(result.is_solved[:, None], result.activation, np.nan),
        units=("-",),
    )


def _shortfall_figures(report: Mapping[str, Any]) -> dict[str, Figure]:
    """Draw what a failed run misses over time; nothing for a single frame."""
    entries = list(story.shortfalls(report))
    times = sorted({time for *_, time in entries})
    if len(times) < 2:
        return {}
    rows = tuple(dict.fromkeys(row for _, row, *_ in entries))
    units = {row: unit for _, row, unit, *_ in entries}
    values = np.zeros((len(times), len(rows)))
    for _, row, _, amount, time in entries:
        values[times.index(time), rows.index(row)] = amount
    series = Series(
        label="missing",
        time=np.array(times),
        names=rows,
        values=values,
        units=tuple(units[row] for row in rows),
    )
    return {"What the rows miss over time, largest first.": plot_quantity([series], quantity=_SHORTFALL)}


def _picture(path: Path) -> tuple[str, str]:
    """Give caption and address of a PNG file."""
    content = read_bytes(path)
    if not content.startswith(b"\x89PNG\r\n\x1a\n"):
        raise DataError(f"{path} is not a PNG file, expected one to embed")
    return f"{path.parent.name}: {path.stem.replace('_', ' ')}", address("image/png", content)


def _tables(rows: Sequence[ComparisonRow]) -> list[dict[str, Any]]:
    """One table per metric: groups down, results across."""
    by_metric: dict[str, list[ComparisonRow]] = {}
    for row in rows:
        by_metric.setdefault(row.metric, []).append(row)
    order = list(_MEANING)
    metrics = sorted(by_metric, key=lambda metric: order.index(metric) if metric in _MEANING else -1)
    return [_table(metric, by_metric[metric]) for metric in metrics]


def _table(metric: str, rows: Sequence[ComparisonRow]) -> dict[str, Any]:
    columns = list(dict.fromkeys(row.result for row in rows))
    notes = list(dict.fromkeys(row.note for row in rows if row.note))
    found = {(row.group, row.result): format_number(row, notes) for row in rows}
    groups = dict.fromkeys(row.group for row in rows)
    unit = "" if rows[0].unit == "-" else f" [{rows[0].unit}]"
    return {
        "metric": metric,
        "meaning": _MEANING.get(metric, "") + unit,
        "columns": columns,
        "lines": {group: [found.get((group, column), "") for column in columns] for group in groups},
        "notes": notes,
    }


def _facts(prefix: str, facts: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    """List settings as label and value, mappings within mappings flattened."""
    for position, (key, value) in enumerate(facts.items()):
        if position == MOST_ENTRIES:
            yield f"{prefix}…", f"{len(facts) - MOST_ENTRIES} more"
            return
        label = f"{prefix}{key}".replace("_", " ")
        if isinstance(value, Mapping):
            yield from _facts(f"{label}: ", value)
        elif isinstance(value, list | tuple):
            shown = [
                str(item["text"]) if isinstance(item, Mapping) and "text" in item else str(item)
                for item in value
            ]
            rest = f" … and {len(shown) - MOST_ENTRIES} more" if len(shown) > MOST_ENTRIES else ""
            yield label, "\n".join(shown[:MOST_ENTRIES]) + rest
        elif value is not None:
            yield label, f"{value:.6g}" if isinstance(value, float) else str(value)
