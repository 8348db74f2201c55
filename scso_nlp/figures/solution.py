"""Figures of a solution: activations, moment balance, stability.

Every function returns a new :class:`matplotlib.figure.Figure` and touches no global state, so that
figures can be made without a display and from several threads. Save with ``figure.savefig``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from scso_nlp.analysis.moment_balance import moment_balance
from scso_nlp.analysis.stability_margin import stability_margin
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.figures import style
from scso_nlp.solution import Solution
from scso_nlp.trajectory import LONG_AGO, time_text
from scso_nlp.validation import FloatArray, read_only

#: Up to this many frames are shown as separate tasks, with markers.
_FEW_FRAMES = 15
#: Least vertical range of moments and margins [N·m, N or N·m/rad].
_LEAST_RANGE = 0.1
#: Size of one panel, of the gap beside it (with tick labels where panels have scales of their own), of a
#: line of title above it, and of the figure's margins [inch].
_PANEL_WIDTH, _PANEL_HEIGHT = 2.0, 1.3
_TIGHT_GAP, _WIDE_GAP = 0.2, 0.55
_TITLE_GAP = 0.2
_LEFT, _TOP, _BOTTOM, _LEAST_WIDTH = 0.6, 0.22, 0.95, 5.0


@dataclass(frozen=True, kw_only=True)
class HorizontalAxis:
    """What stands on the horizontal axis of every panel.

    Attributes
    ----------
    values : array_like, shape (n_frames,) [unit of the label]
        Increasing, e.g. percent of a gait cycle.
    label : str
        With its unit, e.g. ``"Gait cycle [%]"``.
    """

    values: ArrayLike
    label: str


def plot_activations(
    solution: Solution, *, baseline: Solution | None = None, horizontal: HorizontalAxis | None = None
) -> Figure:
    """Draw the activation of every muscle, one panel each.

    Parameters
    ----------
    solution : Solution
    baseline : Solution, optional
        Of the same motion, usually without stability rows; drawn behind.
    horizontal : HorizontalAxis, optional
        Time by default.

    Returns
    -------
    matplotlib.figure.Figure
        Frames that are not solved are left blank and shaded.

    Raises
    ------
    NameMismatchError
        The baseline has other muscles or another number of frames.
    DataError
        The horizontal values do not fit the frames or do not increase.
    """
    muscles = solution.problem.trajectory.muscles
    x, label = _horizontal(solution, horizontal)
    name, baseline_name = _names(solution, baseline)
    curves = [(solution, style.RESULT_COLOR, name, "-")]
    if baseline is not None:
        _require_same_motion(solution, baseline)
        curves.insert(0, (baseline, style.BASELINE_COLOR, baseline_name, "--"))
    largest = max(float(np.nanmax(_solved(run, run.activation), initial=0.1)) for run, *_ in curves)
    figure, panels = _grid(len(muscles), x, share_y=True)
    for m, (muscle, panel) in enumerate(zip(muscles, panels, strict=True)):
        for run, color, name, line in curves:
            _curve(panel, x, _solved(run, run.activation[:, [m]])[:, 0], color=color, line=line, label=name)
        _shade_failed(panel, x, solution)
        panel.set_ylim(-0.05 * largest, 1.08 * largest)
        _title(panel, muscle)
    _finish(figure, panels, label, "Activation [-]", f"{solution.problem.trajectory.name}: activations")
    return figure


def plot_moments(solution: Solution, *, horizontal: HorizontalAxis | None = None) -> Figure:
    """Draw required, muscle and reserve moment of every coordinate.

    The share of reserves and residuals (root mean square over that of the required moment) stands in
    each panel.

    Parameters
    ----------
    solution : Solution
    horizontal : HorizontalAxis, optional
        Time by default.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        The horizontal values do not fit the frames or do not increase.
    """
    balance = moment_balance(solution)
    x, label = _horizontal(solution, horizontal)
    has_actuators = solution.control.shape[1] > 0
    figure, panels = _grid(len(balance.coordinates), x, share_y=False, title_lines=1 + has_actuators)
    for c, (coordinate, panel) in enumerate(zip(balance.coordinates, panels, strict=True)):
        _curve(
            panel,
            x,
            balance.required[:, c],
            color=style.REQUIRED_COLOR,
            line="-",
            label="required",
            width=2.4,
        )
        _curve(panel, x, balance.muscles[:, c], color=style.RESULT_COLOR, line="--", label="muscles")
        title = f"{coordinate} [{balance.unit[c]}]"
        if has_actuators:
            _curve(panel, x, balance.actuators[:, c], color=style.MARK_COLOR, line="-", label="reserves")
            share = balance.actuator_share[c]
            title += f"\nreserves: {_percent(share)}"
        _shade_failed(panel, x, solution)
        _widen(panel)
        _title(panel, title)
    name = solution.problem.trajectory.name
    _finish(figure, panels, label, "Moment or force", f"{name}: moment balance")
    return figure


def plot_stability(
    solution: Solution, *, baseline: Solution | None = None, horizontal: HorizontalAxis | None = None
) -> Figure:
    """Draw the stability margin of every row; frames in which the row is active are marked.

    Parameters
    ----------
    solution : Solution
        With stability rows.
    baseline : Solution, optional
        Of the same motion; the same rows are evaluated at its forces.
    horizontal : HorizontalAxis, optional
        Time by default.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        No stability rows, or the horizontal values do not fit the frames.
    NameMismatchError
        The baseline is of another motion.
    """
    own = stability_margin(solution)
    if own is None:
        raise DataError(
            f"the solution of {solution.problem.trajectory.name!r} has no stability rows, "
            "expected a stability constraint"
        )
    other = None if baseline is None else stability_margin(baseline, rows_of=solution)
    x, label = _horizontal(solution, horizontal)
    name, baseline_name = _names(solution, baseline)
    figure, panels = _grid(len(own.rows), x, share_y=False)
    for r, (row, panel) in enumerate(zip(own.rows, panels, strict=True)):
        panel.axhline(0.0, color=style.QUIET, linewidth=0.8)
        if other is not None:
            _curve(panel, x, other.margin[:, r], color=style.BASELINE_COLOR, line="--", label=baseline_name)
        _curve(panel, x, own.margin[:, r], color=style.RESULT_COLOR, line="-", label=name)
        active = own.is_active[:, r]
        if active.any():
            panel.plot(
                x[active], own.margin[active, r], linestyle="none", marker="s", markersize=4.5,
                color=style.MARK_COLOR, label="row active", zorder=4,
            )  # fmt: skip
        _shade_failed(panel, x, solution)
        _widen(panel)
        _title(panel, row if own.level[r] == 0 else f"{row}, level {own.level[r]:g}")
    title = f"{solution.problem.trajectory.name}: joint stability"
    _finish(figure, panels, label, "Margin S - level [N·m/rad]", title)
    return figure


def _horizontal(solution: Solution, horizontal: HorizontalAxis | None) -> tuple[FloatArray, str]:
    time = solution.problem.trajectory.time
    if horizontal is None:
        if abs(time[0]) < LONG_AGO:
            return time, "Time [s]"
        return time - time[0], f"Time since t = {time_text(time[0])} s [s]"
    values = read_only("horizontal values", horizontal.values, time.shape, "n_frames")
    if (np.diff(values) <= 0).any():
        raise DataError(f"the horizontal values of {horizontal.label!r} must increase from frame to frame")
    return values, horizontal.label


def _names(solution: Solution, baseline: Solution | None) -> tuple[str, str]:
    """Name both curves: by the stability rows that only one of them has, otherwise by their roles."""
    own, other = (
        run is not None and any(isinstance(term, StabilityConstraint) for term in run.problem.constraints)
        for run in (solution, baseline)
    )
    if own == other:
        return "solution", "baseline"
    plain, stable = "static optimization", "with stability rows"
    return (stable, plain) if own else (plain, stable)


def _solved(solution: Solution, values: FloatArray) -> FloatArray:
    """Blank the frames that are not solved."""
    return np.where(solution.is_solved[:, np.newaxis], values, np.nan)


def _require_same_motion(solution: Solution, baseline: Solution) -> None:
    own, other = solution.problem.trajectory, baseline.problem.trajectory
    if own.muscles != other.muscles or own.n_frames != other.n_frames:
        raise NameMismatchError(
            f"the baseline {other.name!r} has other muscles or another number of frames than {own.name!r}"
        )


def _grid(n_panels: int, x: FloatArray, *, share_y: bool, title_lines: int = 1) -> tuple[Figure, list[Axes]]:
    """Lay out one panel per item, in about as many columns as rows, all with the same horizontal range."""
    edges = _edges(x)
    left, right = (
        (float(edges[0]), float(edges[-1])) if len(x) <= _FEW_FRAMES else (float(x[0]), float(x[-1]))
    )
    title_gap = 0.15 + title_lines * _TITLE_GAP
    n_columns = max(1, min(n_panels, math.ceil(math.sqrt(n_panels * 0.8))))
    n_rows = max(1, math.ceil(n_panels / n_columns))
    gap = _TIGHT_GAP if share_y else _WIDE_GAP
    width = max(_LEFT + n_columns * (_PANEL_WIDTH + gap), _LEAST_WIDTH)
    height = _TOP + n_rows * (_PANEL_HEIGHT + title_gap) + _BOTTOM
    figure = Figure(figsize=(width, height), dpi=style.RESOLUTION)
    # fixed margins and no shared axes: matplotlib's own ways take many seconds for eighty panels
    figure.subplots_adjust(
        left=(_LEFT + gap / 2) / width, right=1 - gap / 2 / width,
        bottom=_BOTTOM / height, top=1 - (_TOP + title_gap) / height,
        wspace=gap / _PANEL_WIDTH, hspace=title_gap / _PANEL_HEIGHT,
    )  # fmt: skip
    panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel().tolist()
    for panel in panels[n_panels:]:
        panel.remove()
    panels = panels[:n_panels]
    for i, panel in enumerate(panels):
        panel.tick_params(
            labelsize=style.TEXT - 1,
            labelbottom=i + n_columns >= n_panels,  # lowest panel of its column, also above an empty place
            labelleft=not share_y or i % n_columns == 0,
        )
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="0.9", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.set_xlim(left, right)
        panel.xaxis.set_major_locator(MaxNLocator(4))
        panel.yaxis.set_major_locator(MaxNLocator(4))
        for axis in (panel.xaxis, panel.yaxis):
            axis.get_offset_text().set_fontsize(style.TEXT - 1)
    return figure, panels


def _curve(
    panel: Axes, x: FloatArray, values: FloatArray, *, color: str, line: str, label: str, width: float = 1.4
) -> None:
    marker = "o" if len(x) <= _FEW_FRAMES else ""
    panel.plot(
        x, values, linestyle=line, color=color, marker=marker, markersize=3, linewidth=width, label=label
    )


def _edges(x: FloatArray) -> FloatArray:
    """Limits half-way between neighboring frames, shape (n_frames + 1,)."""
    if len(x) == 1:
        return np.array([x[0] - 0.5, x[0] + 0.5])
    middles = (x[1:] + x[:-1]) / 2
    return np.concatenate(([2 * x[0] - middles[0]], middles, [2 * x[-1] - middles[-1]]))


def _shade_failed(panel: Axes, x: FloatArray, solution: Solution) -> None:
    """Shade the frames that are not solved, one span for each run of them."""
    edges = _edges(x)
    failed = np.concatenate(([False], ~solution.is_solved, [False]))
    starts, stops = np.flatnonzero(failed[1:] & ~failed[:-1]), np.flatnonzero(failed[:-1] & ~failed[1:])
    for start, stop in zip(starts, stops, strict=True):
        panel.axvspan(edges[start], edges[stop], color="0.8", linewidth=0, zorder=0, label="not solved")


def _percent(share: float) -> str:
    """Two digits are enough for a share; a dash where there is none."""
    if not np.isfinite(share):
        return "-"
    return f"{100 * share:.0f} %" if share >= 0.0995 else f"{100 * share:.1f} %"


def _widen(panel: Axes) -> None:
    """Keep round-off from filling a panel in which nothing happens."""
    low, high = panel.get_ylim()
    if high - low < _LEAST_RANGE:
        middle = (low + high) / 2
        panel.set_ylim(middle - _LEAST_RANGE / 2, middle + _LEAST_RANGE / 2)


def _title(panel: Axes, text: str) -> None:
    panel.set_title(text, fontsize=style.TEXT, loc="left", pad=3)


def _finish(figure: Figure, panels: list[Axes], x_label: str, y_label: str, title: str) -> None:
    width, height = figure.get_size_inches()
    middle = (_LEFT + (width - _LEFT) / 2) / width
    figure.supxlabel(x_label, fontsize=style.TEXT + 1, x=middle, y=0.47 / height, va="bottom")
    figure.supylabel(y_label, fontsize=style.TEXT + 1, x=0.12 / width, ha="left")
    figure.suptitle(title, fontsize=style.TEXT + 2, x=0.12 / width, y=1 - 0.12 / height, ha="left", va="top")
    entries: dict[str, Artist] = {}
    for panel in panels:
        for artist, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, artist)
    figure.legend(
        list(entries.values()), list(entries), loc="lower center", ncols=len(entries) or 1,
        bbox_to_anchor=(0.5, 0.06 / height), fontsize=style.TEXT, frameon=False,
    )  # fmt: skip
