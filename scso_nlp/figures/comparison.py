"""Figures of a comparison: results beside EMG over the motion, as bars, and over a sweep of a parameter.

Every function returns a new :class:`matplotlib.figure.Figure` and touches no global state. Figures of one
solution alone (activations, moments, stability margins) are in :mod:`scso_nlp.figures.solution`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from scso_nlp.emg.comparison import EMG_LABEL, Comparison
from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import FEW_FRAMES, HorizontalAxis, horizontal_axis
from scso_nlp.figures.grid import add_legend, draw_curve, legend_entries, panel_grid
from scso_nlp.figures.quantity import of_how_many, plot_quantity, quantity_pages
from scso_nlp.figures.series import Series
from scso_nlp.figures.style import (
    BASELINE,
    EMG_COLOR,
    INCH,
    LEAST_TEXT,
    QUIET,
    RESOLUTION,
    RESULT,
    TEXT,
    TWO_COLUMNS,
    SeriesStyle,
    ShownFigure,
    literal,
    quiet_axes,
    series_style,
)
from scso_nlp.validation import FloatArray, read_only

#: Activations that stay below this are drawn on a scale up to this value [-].
LEAST_SCALE = 0.1
#: Width of all bars of a row, of one bar, and of the groups' names; height of a row with names [mm].
_BARS_WIDTH, _BAR_WIDTH, _NAME_WIDTH, _BARS_HEIGHT = 155.0, 2.0, 5.5, 42.0


def plot_activity(comparison: Comparison, *, horizontal: HorizontalAxis | None = None) -> Figure:
    """Draw activations over the motion: of every group with its EMG envelope as a gray area behind, if any.

    Without EMG left and right of a group share a panel, and of many groups those are drawn that change most.

    Parameters
    ----------
    comparison : Comparison
    horizontal : HorizontalAxis, optional
        Time by default.

    Returns
    -------
    matplotlib.figure.Figure
        Frames that are not solved are left blank.

    Raises
    ------
    DataError
        The horizontal values are not one per frame.
    """
    heading = f"{comparison.results[0].name}: activation"
    if comparison.emg is None:
        series = _series(comparison)
        return plot_quantity(series, heading=f"{heading}{of_how_many(series)}", horizontal=horizontal)
    axis = horizontal_axis(comparison.time, horizontal)
    figure, panels = panel_grid(
        comparison.group_names,
        heading=heading,
        x_label=axis.label,
        y_label="Activation, EMG envelope [-]",
        horizontal=axis,
        y_range=_y_range(*comparison.activity.values(), comparison.emg),
    )
    for g, panel in enumerate(panels):
        measured = comparison.emg_of(g)
        if measured is not None:
            panel.fill_between(axis.values, 0, measured, color=EMG_COLOR, linewidth=0, label=EMG_LABEL)
        for i, label in enumerate(comparison.labels):
            activity = comparison.activity[label][:, g]
            draw_curve(panel, axis.values, activity, series_style(i), label=label)
    add_legend(figure)
    return figure


def activity_pages(comparison: Comparison) -> tuple[Figure, ...]:
    """Draw :func:`plot_activity`, and without EMG all groups on further pages where there are many.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    tuple of matplotlib.figure.Figure
    """
    if comparison.emg is not None:
        return (plot_activity(comparison),)
    return quantity_pages(_series(comparison), heading=f"{comparison.results[0].name}: activation")


def _series(comparison: Comparison) -> tuple[Series, ...]:
    return tuple(
        Series(
            label=label,
            time=comparison.time,
            names=comparison.group_names,
            values=comparison.activity[label],
            units=("-",),
            are_tasks=are_tasks(comparison),
        )
        for label in comparison.labels
    )


def are_tasks(comparison: Comparison) -> bool:
    """Tell whether nothing moves in a few frames, which then are tasks, not moments of a movement."""
    at_rest = all(result.is_at_rest for result in comparison.results)
    return at_rest and len(comparison.time) <= FEW_FRAMES


def plot_mean_activity(comparison: Comparison) -> Figure:
    """Draw the mean activation of every group as bars: results and EMG side by side.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
        Whiskers on EMG bars: standard deviation over the frames. Many groups stand in several rows.
    """
    used = comparison.is_used
    names = [literal(name) for name in comparison.group_names]
    n_bars = len(comparison.labels) + (comparison.emg is not None)
    most = max(1, int(_BARS_WIDTH / max(_NAME_WIDTH, n_bars * _BAR_WIDTH)))
    rows = np.array_split(np.arange(len(names)), max(math.ceil(len(names) / most), 1))
    height = (12.0 + _BARS_HEIGHT * len(rows)) / INCH
    figure = ShownFigure(figsize=(TWO_COLUMNS / INCH, height), dpi=RESOLUTION, layout="constrained")
    panels = figure.subplots(len(rows), squeeze=False, sharey=True)[:, 0]
    means = {label: activity[used].mean(axis=0) for label, activity in comparison.activity.items()}
    measured = None if comparison.emg is None else comparison.emg[used].mean(axis=0)
    deviation = None if comparison.emg is None or used.sum() < 2 else comparison.emg[used].std(axis=0)
    for panel, row in zip(panels, rows, strict=True):
        quiet_axes(panel)
        _draw_bars(
            panel,
            {label: mean[row] for label, mean in means.items()},
            None if measured is None else measured[row],
            None if deviation is None else deviation[row],
            hatched=True,
        )
        panel.set_xticks(
            range(len(row)), [names[g] for g in row], rotation=35, ha="right", fontsize=LEAST_TEXT
        )
        panel.set_xlim(-0.6, len(rows[0]) - 0.4)
        panel.set_ylim(bottom=0)
        panel.set_ylabel("Mean activation [-]", fontsize=TEXT)
    title = literal(f"{comparison.results[0].name}: mean over the motion")
    panels[0].set_title(title, fontsize=TEXT + 1, loc="left")
    entries = legend_entries(figure)
    figure.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=min(n_bars, 6),
        fontsize=TEXT, frameon=False,
    )  # fmt: skip
    return figure


def plot_task_bars(
    comparison: Comparison, tasks: Sequence[str] | None = None, *, x_label: str = "Task"
) -> Figure:
    """Draw static tasks as bars, one panel per group: the layout of the paper's figures 3 to 6.

    Parameters
    ----------
    comparison : Comparison
        Every frame is one task.
    tasks : sequence of str, optional
        Name of every frame; its time by default.
    x_label : str

    Returns
    -------
    matplotlib.figure.Figure
        A task that a result has not solved is marked with a cross.

    Raises
    ------
    DataError
        Not one name per frame, or more frames than bars can show.
    """
    n_tasks = len(comparison.time)
    if tasks is None:
        tasks, x_label = [f"{time:g}" for time in comparison.time], f"{x_label}, by its time [s]"
    if len(tasks) != n_tasks:
        raise DataError(f"{len(tasks)} task names for {n_tasks} frames, expected one each")
    if n_tasks > FEW_FRAMES:
        raise DataError(
            f"{n_tasks} frames are a movement, not tasks; use plot_mean_activity or plot_activity (up to "
            f"{FEW_FRAMES} tasks can be shown)"
        )
    figure, panels = panel_grid(
        comparison.group_names,
        heading=f"{comparison.results[0].name}: activation per task",
        x_label=x_label,
        y_label="Activation [-]",
        y_range=_y_range(*comparison.activity.values(), comparison.emg),
    )
    for g, panel in enumerate(panels):
        activities = {label: activity[:, g] for label, activity in comparison.activity.items()}
        _draw_bars(panel, activities, None if comparison.emg is None else comparison.emg[:, g])
        panel.set_xticks(range(n_tasks), list(map(literal, tasks)), fontsize=LEAST_TEXT)
    add_legend(figure)
    return figure


def plot_sweep(
    comparison: Comparison,
    values: Sequence[float] | FloatArray,
    *,
    label: str = "Stiffness gain q [-]",
    reference: str | None = None,
    infeasible: Sequence[bool] = (),
) -> Figure:
    """Draw every group's mean activation against a parameter, e.g. q, on a logarithmic axis.

    Parameters
    ----------
    comparison : Comparison
        One result per value, in the order of `values`, and the `reference`.
    values : array_like, shape (n_values,) [unit of `label`]
        Positive and increasing.
    label : str
    reference : str, optional
        Label of the result without the parameter, e.g. plain static optimization; drawn as a level line.
    infeasible : sequence of bool
        One per value: True where some frame has no answer that keeps all rows, so that the result comes from
        soft rows or reserves; drawn hollow.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        Not one result per value, or values that are not positive and increasing, or `infeasible` of another
        length.
    """
    labels = [name for name in comparison.labels if name != reference]
    if reference is not None and reference not in comparison.labels:
        raise DataError(f"no result is called {reference!r}, found: {', '.join(comparison.labels)}")
    x = read_only("values of the sweep", values, (-1,), "n_values")
    if len(x) != len(labels):
        raise DataError(
            f"the sweep has {len(x)} values and {len(labels)} results, expected one result per value"
        )
    if not (len(x) and x[0] > 0 and (np.diff(x) > 0).all()):
        raise DataError("the values of a sweep must be positive and increase")
    hollow = np.array(infeasible or [False] * len(x), dtype=bool)
    if hollow.shape != x.shape:
        raise DataError(f"infeasible has {hollow.size} entries for {len(x)} values, expected one each")
    used = comparison.is_used
    means = np.array([comparison.activity[name][used].mean(axis=0) for name in labels])
    # level lines: (label, mean of every group, style)
    levels: list[tuple[str, FloatArray, SeriesStyle]] = []
    if reference is not None:
        levels.append((reference, comparison.activity[reference][used].mean(axis=0), BASELINE))
    if comparison.emg is not None:
        look = SeriesStyle(color=EMG_COLOR, line="-")
        levels.append((EMG_LABEL, comparison.emg[used].mean(axis=0), look))
    figure, panels = panel_grid(
        comparison.group_names,
        heading=f"{comparison.results[0].name}: sensitivity",
        x_label=label,
        y_label="Mean activation [-]",
        y_range=_y_range(means, *(level for _, level, _ in levels)),
    )
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 3.5, "color": RESULT.color}
    for g, panel in enumerate(panels):
        panel.plot(x, means[:, g], "-", color=RESULT.color, linewidth=1.4)
        panel.plot(x[~hollow], means[~hollow, g], **dots, label="with stability rows")
        if hollow.any():
            panel.plot(x[hollow], means[hollow, g], **dots, markerfacecolor="white", label="some rows missed")
        for name, level, look in levels:
            if np.isfinite(level[g]):
                panel.axhline(
                    level[g],
                    linestyle=look.line,
                    color=look.color,
                    linewidth=1.4,
                    label=literal(name),
                    zorder=1,
                )
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(FixedLocator(_few_ticks(x)))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.xaxis.set_minor_locator(NullLocator())
    add_legend(figure)
    return figure


def _draw_bars(
    panel: Axes,
    activities: Mapping[str, FloatArray],
    measured: FloatArray | None,
    deviation: FloatArray | None = None,
    *,
    hatched: bool = False,
) -> None:
    """Draw bars side by side at 0, 1, ...: one per result, and EMG where there is some; NaN is a cross."""
    place = np.arange(len(next(iter(activities.values()))))
    n_bars = len(activities) + (measured is not None)
    bar = 0.8 / n_bars
    first = place - (n_bars - 1) / 2 * bar
    for i, (label, height) in enumerate(activities.items()):
        look = series_style(i)
        at = first + i * bar
        lines: dict[str, Any] = (
            {"hatch": look.hatch, "edgecolor": "white", "linewidth": 0.4} if hatched else {}
        )
        panel.bar(at, np.nan_to_num(height), bar, color=look.color, label=literal(label), **lines)
        missing = at[np.isnan(height)]
        if missing.size:
            panel.plot(missing, 0 * missing, "x", color=look.color, clip_on=False, markersize=4)
    there = np.zeros(place.shape, dtype=bool) if measured is None else np.isfinite(measured)
    if measured is not None and there.any():
        panel.bar(
            first[there] + len(activities) * bar, measured[there], bar, color=EMG_COLOR, label=EMG_LABEL,
            yerr=None if deviation is None else deviation[there], ecolor=QUIET, capsize=2,
        )  # fmt: skip
    panel.grid(visible=False, axis="x")


def _y_range(*activities: FloatArray | None) -> tuple[float, float]:
    """From zero to a little above all that is drawn."""
    shown = [values for values in activities if values is not None]
    return 0.0, 1.06 * max(LEAST_SCALE, *(float(np.nanmax(values, initial=0.0)) for values in shown))


def _few_ticks(x: FloatArray) -> list[float]:
    """Keep values that are far enough apart on a logarithmic axis for their labels."""
    span = float(np.log(x[-1] / x[0])) or 1.0
    kept: list[float] = []
    for value in x.tolist():
        if not kept or np.log(value / kept[-1]) > 0.14 * span:
            kept.append(value)
    return kept
