"""Figures of a solution: activations, moment balance, stability.

Every function returns a new :class:`matplotlib.figure.Figure` and touches no global state, so that
figures can be made without a display and from several threads. Tendon forces of several solutions beside
each other are in :mod:`scso_nlp.figures.tendon_forces`, comparisons with EMG in
:mod:`scso_nlp.figures.comparison`.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import HorizontalAxis, horizontal_axis, shade_failed
from scso_nlp.figures.grid import add_legend, draw_curve, panel_grid
from scso_nlp.figures.style import BASELINE, MARK, QUIET, REQUIRED, RESULT, SeriesStyle
from scso_nlp.solution import Solution
from scso_nlp.trajectory import require_same_motion
from scso_nlp.validation import FloatArray

#: Least vertical range of moments and margins [N·m, N or N·m/rad].
_LEAST_RANGE = 0.1


@checked
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
        The baseline has other muscles.
    DataError
        The baseline has other frames, or the horizontal values are not one per frame.
    """
    trajectory = solution.problem.motion.trajectory
    axis = horizontal_axis(trajectory.time, horizontal)
    name, baseline_name = _names(solution, baseline)
    curves = [(_solved(solution, solution.activation), RESULT, name)]
    if baseline is not None:
        require_same_motion({"solution": trajectory, "baseline": baseline.problem.motion.trajectory})
        curves.insert(0, (_solved(baseline, baseline.activation), BASELINE, baseline_name))
    largest = max(float(np.nanmax(activation, initial=0.1)) for activation, *_ in curves)
    figure, panels = panel_grid(
        trajectory.muscles,
        heading=f"{trajectory.name}: activations",
        x_label=axis.label,
        y_label="Activation [-]",
        horizontal=axis,
        y_range=(-0.05 * largest, 1.08 * largest),
    )
    for m, panel in enumerate(panels):
        for activation, look, label in curves:
            draw_curve(panel, axis.values, activation[:, m], look, label=label)
        shade_failed(panel, axis.values, solution.is_solved)
    add_legend(figure)
    return figure


@checked
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
        The horizontal values are not one per frame.
    """
    trajectory = solution.problem.motion.trajectory
    balance = solution.moment_balance
    axis = horizontal_axis(trajectory.time, horizontal)
    has_actuators = solution.control.shape[1] > 0
    titles = [f"{name} [{unit}]" for name, unit in zip(balance.coordinates, balance.unit, strict=True)]
    if has_actuators:
        shares = balance.actuator_share
        titles = [f"{title}\nreserves: {_percent(s)}" for title, s in zip(titles, shares, strict=True)]
    figure, panels = panel_grid(
        titles,
        heading=f"{trajectory.name}: moment balance",
        x_label=axis.label,
        y_label="Moment or force",
        horizontal=axis,
    )
    muscles = SeriesStyle(color=RESULT.color, line="--")
    for c, panel in enumerate(panels):
        draw_curve(panel, axis.values, balance.required[:, c], REQUIRED, label="required", width=2.4)
        draw_curve(panel, axis.values, balance.muscles[:, c], muscles, label="muscles")
        if has_actuators:
            draw_curve(panel, axis.values, balance.actuators[:, c], MARK, label="reserves")
        shade_failed(panel, axis.values, solution.is_solved)
        _widen(panel)
    add_legend(figure)
    return figure


@checked
def plot_stability(
    solution: Solution, *, baseline: Solution | None = None, horizontal: HorizontalAxis | None = None
) -> Figure:
    """Draw the stability margin of every row; frames in which the row is active are marked.

    Parameters
    ----------
    solution : Solution
        With stability rows.
    baseline : Solution, optional
        Of the same motion; drawn where it kept or observed the same rows, see
        :meth:`~scso_nlp.MuscleForceProblem.without_stability`.
    horizontal : HorizontalAxis, optional
        Time by default.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        No stability rows, or the horizontal values are not one per frame.
    NameMismatchError
        The baseline has other muscles.
    """
    trajectory = solution.problem.motion.trajectory
    own = solution.stability
    if own is None:
        raise DataError(
            f"the solution of {trajectory.name!r} has no stability rows, expected a stability constraint"
        )
    other = None
    if baseline is not None:
        require_same_motion({"solution": trajectory, "baseline": baseline.problem.motion.trajectory})
        other = baseline.stability
    if other is not None and other.rows != own.rows:
        other = None
    axis = horizontal_axis(trajectory.time, horizontal)
    x = axis.values
    name, baseline_name = _names(solution, baseline)
    figure, panels = panel_grid(
        [row if v == 0 else f"{row}, level {v:g}" for row, v in zip(own.rows, own.level, strict=True)],
        heading=f"{trajectory.name}: joint stability",
        x_label=axis.label,
        y_label="Margin S - level [N·m/rad]",
        horizontal=axis,
    )
    for r, panel in enumerate(panels):
        panel.axhline(0.0, color=QUIET, linewidth=0.8)
        if other is not None:
            draw_curve(panel, x, other.margin[:, r], BASELINE, label=baseline_name)
        draw_curve(panel, x, own.margin[:, r], RESULT, label=name)
        active = own.is_active[:, r]
        if active.any():
            panel.plot(
                x[active], own.margin[active, r], "s", markersize=4.5, color=MARK.color, zorder=4,
                label="row active",
            )  # fmt: skip
        shade_failed(panel, x, solution.is_solved)
        _widen(panel)
    add_legend(figure)
    return figure


def _names(solution: Solution, baseline: Solution | None) -> tuple[str, str]:
    """Name both curves: by the stability rows that only one of them has, otherwise by their roles."""
    own, other = (
        run is not None and any(term in run.problem.stability_terms for term in run.problem.constraints)
        for run in (solution, baseline)
    )
    if own == other:
        return "solution", "baseline"
    plain, stable = "static optimization", "with stability rows"
    return (stable, plain) if own else (plain, stable)


def _solved(solution: Solution, values: FloatArray) -> FloatArray:
    """Blank the frames that are not solved."""
    return np.where(solution.is_solved[:, np.newaxis], values, np.nan)


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
