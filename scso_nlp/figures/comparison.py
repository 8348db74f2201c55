"""Figures of a comparison: results beside EMG, bars, sweeps, what stabilizes what, and the muscles in space.

Every function returns a new :class:`matplotlib.figure.Figure` and touches no global state. Figures of one
solution alone (activations, moments, stability margins) are in :mod:`scso_nlp.figures.solution`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.emg.comparison import EMG_LABEL, Comparison
from scso_nlp.exceptions import DataError
from scso_nlp.figures import style
from scso_nlp.trajectory import NO_POINT, Skeleton
from scso_nlp.validation import FloatArray, IntArray, read_only

if TYPE_CHECKING:
    from scso_nlp.solution import Solution

#: Up to this many frames are separate tasks rather than a movement.
FEW_FRAMES = 15
#: A muscle group whose largest activation stays below this is drawn on a scale up to this value [-].
LEAST_SCALE = 0.1
#: Muscles that add less than this share of what the first one adds are left out of the heat map [-].
NEGLIGIBLE_SHARE = 0.01
#: Muscles shown in the heat map at most.
MOST_MUSCLES = 40


def plot_activity(
    comparison: Comparison, *, x: Sequence[float] | FloatArray | None = None, x_label: str = "Time [s]"
) -> Figure:
    """Draw every group's activation over the motion, with the EMG envelope as a gray area behind.

    Parameters
    ----------
    comparison : Comparison
    x : array_like, shape (n_frames,) [unit of `x_label`], optional
        Time from the first frame by default; see :func:`percent_of_motion`.
    x_label : str

    Returns
    -------
    matplotlib.figure.Figure
        Frames that are not solved are left blank.

    Raises
    ------
    DataError
        `x` does not fit the frames.
    """
    values = comparison.time - comparison.time[0] if x is None else x
    values = read_only("x", values, (len(comparison.time),), "n_frames")
    figure, panels = style.panel_grid(
        len(comparison.groups), title=f"{comparison.results[0].name}: activation"
    )
    marker = "o" if len(values) <= FEW_FRAMES else ""
    largest = LEAST_SCALE
    for g, (group, panel) in enumerate(zip(comparison.group_names, panels, strict=True)):
        if comparison.emg is not None and group_has_emg(comparison, g):
            measured = comparison.emg[:, g]
            panel.fill_between(values, 0, measured, color=style.EMG_COLOR, linewidth=0, label=EMG_LABEL)
            largest = max(largest, float(measured.max()))
        for i, label in enumerate(comparison.labels):
            look = style.series_style(i)
            series = comparison.activity[label][:, g]
            panel.plot(
                values, series, look.line, color=look.color, linewidth=1.4, marker=marker, markersize=3,
                label=label,
            )  # fmt: skip
            largest = max(largest, float(np.nanmax(series, initial=0.0)))
        _panel_title(panel, group)
    for panel in panels:
        panel.set_ylim(0, 1.06 * largest)
        panel.set_xlim(float(values.min()), float(values.max()) if len(values) > 1 else None)
    quantity = "Activation [-]" if comparison.emg is None else "Activation, EMG envelope [-]"
    style.label_figure(figure, panels, x_label, quantity)
    return figure


def percent_of_motion(time: FloatArray, start: float | None = None, stop: float | None = None) -> FloatArray:
    """Turn time into per cent of a motion or of a gait cycle.

    Parameters
    ----------
    time : ndarray, shape (n_frames,) [s]
    start, stop : float [s], optional
        0 and 100 %; first and last frame by default.

    Returns
    -------
    ndarray, shape (n_frames,) [%]

    Raises
    ------
    DataError
        `stop` is not after `start`.
    """
    start = float(time[0]) if start is None else start
    stop = float(time[-1]) if stop is None else stop
    if not stop > start:
        raise DataError(f"the cycle ends at {stop} s, expected after its start at {start} s")
    return 100 * (np.asarray(time, dtype=float) - start) / (stop - start)


def plot_mean_activity(comparison: Comparison) -> Figure:
    """Draw the mean activation of every group as bars: results and EMG side by side.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
        Whiskers on EMG bars: standard deviation over the frames.
    """
    used = comparison.is_used
    names = comparison.group_names
    n_bars = len(comparison.labels) + (comparison.emg is not None)
    width = max(5.0, 0.9 + len(names) * (0.25 + 0.16 * n_bars))
    figure = Figure(figsize=(width, 3.6), dpi=style.RESOLUTION, layout="constrained")
    panel = figure.subplots()
    style.finish_panel(panel)
    panel.grid(visible=False, axis="x")
    place = np.arange(len(names))
    bar = 0.8 / n_bars
    for i, label in enumerate(comparison.labels):
        look = style.series_style(i)
        panel.bar(
            place + (i - (n_bars - 1) / 2) * bar,
            comparison.activity[label][used].mean(axis=0),
            bar,
            color=look.color,
            hatch=look.hatch,
            edgecolor="white",
            linewidth=0.4,
            label=label,
        )
    if comparison.emg is not None:
        shown = [g for g in range(len(names)) if group_has_emg(comparison, g)]
        measured = comparison.emg[used][:, shown]
        panel.bar(
            place[shown] + (n_bars - 1) / 2 * bar,
            measured.mean(axis=0),
            bar,
            yerr=measured.std(axis=0) if used.sum() > 1 else None,
            color=style.EMG_COLOR,
            ecolor=style.QUIET,
            capsize=2,
            label=EMG_LABEL,
        )
    panel.set_xticks(place, names, rotation=35, ha="right", fontsize=style.TEXT)
    panel.set_ylim(bottom=0)
    panel.set_ylabel("Mean activation [-]", fontsize=style.TEXT + 1)
    panel.set_title(
        f"{comparison.results[0].name}: mean over the motion", fontsize=style.TEXT + 2, loc="left"
    )
    figure.legend(loc="outside lower center", ncols=min(n_bars, 6), fontsize=style.TEXT, frameon=False)
    return figure


def plot_task_bars(comparison: Comparison, tasks: Sequence[str], *, x_label: str = "Task") -> Figure:
    """Draw static tasks as bars, one panel per group: the layout of the paper's figures 3 to 6.

    Parameters
    ----------
    comparison : Comparison
        Every frame is one task.
    tasks : sequence of str
        Name of every frame.
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
    if len(tasks) != n_tasks:
        raise DataError(f"{len(tasks)} task names for {n_tasks} frames, expected one each")
    if n_tasks > FEW_FRAMES:
        raise DataError(
            f"{n_tasks} frames are a movement, not tasks; use plot_mean_activity or plot_activity (up to "
            f"{FEW_FRAMES} tasks can be shown)"
        )
    figure, panels = style.panel_grid(
        len(comparison.groups), title=f"{comparison.results[0].name}: activation per task"
    )
    n_bars = len(comparison.labels) + (comparison.emg is not None)
    bar = 0.8 / n_bars
    place = np.arange(n_tasks)
    for g, (group, panel) in enumerate(zip(comparison.group_names, panels, strict=True)):
        for i, label in enumerate(comparison.labels):
            look = style.series_style(i)
            series = comparison.activity[label][:, g]
            at = place + (i - (n_bars - 1) / 2) * bar
            panel.bar(
                at, np.nan_to_num(series), bar, color=look.color,
                linewidth=0.4, label=label,
            )  # fmt: skip
            missing = np.isnan(series)
            if missing.any():
                panel.plot(
                    at[missing], np.zeros(missing.sum()), "x", color=look.color, clip_on=False, markersize=4
                )
        if comparison.emg is not None and group_has_emg(comparison, g):
            panel.bar(
                place + (n_bars - 1) / 2 * bar,
                comparison.emg[:, g],
                bar,
                color=style.EMG_COLOR,
                label=EMG_LABEL,
            )
        panel.grid(visible=False, axis="x")
        panel.set_xticks(place, tasks, fontsize=style.TEXT - 1)
        _panel_title(panel, group)
    panels[0].set_ylim(bottom=0)
    style.label_figure(figure, panels, x_label, "Activation [-]")
    return figure


@dataclass(frozen=True, kw_only=True)
class StabilityContributions:
    """What every muscle adds to every stability row.

    Attributes
    ----------
    rows : tuple of str
        ``"<joint>_<axis>"``.
    muscles : tuple of str
    values : ndarray, shape (n_rows, n_muscles) [N·m/rad]
        Tendon force times curvature plus stiffness times squared moment arm, mean over the solved frames;
        negative where the muscle takes stability away. Passive stiffness is not part of it.
    external_work : ndarray, shape (n_rows,) [N·m/rad]
        What the loads take away, mean over the solved frames.
    """

    rows: tuple[str, ...]
    muscles: tuple[str, ...]
    values: FloatArray
    external_work: FloatArray


def stability_contributions(solution: Solution) -> StabilityContributions:
    r"""Split the stability of every row by muscle.

    .. math:: S_i = \sum_m \left(F_m \frac{\partial^2\ell_m}{\partial\theta_i^2} + k_m r_{im}^2\right) - EW_i

    Parameters
    ----------
    solution : Solution
        With stability rows.

    Returns
    -------
    StabilityContributions

    Raises
    ------
    DataError
        No stability rows, or no solved frame.
    """
    problem, solved = solution.problem, solution.is_solved
    if not solved.any():
        raise DataError("no frame is solved, there is nothing to split")
    rows: list[str] = []
    values, work = [], []
    for term in problem.constraints:
        if isinstance(term, StabilityConstraint):
            found = term.stability_rows(problem)
            force = solution.tendon_force[solved]
            stiffness = _stiffness(solution, term.name)[solved]
            rows.extend(found.rows)
            values.append(
                np.einsum("krm,km->rm", found.curvature[solved], force) / solved.sum()
                + np.einsum("krm,km->rm", found.moment_arms[solved] ** 2, stiffness) / solved.sum()
            )
            work.append(found.external_work[solved].mean(axis=0))
    if not rows:
        raise DataError(f"the solution of {problem.trajectory.name!r} has no stability rows to split")
    return StabilityContributions(
        rows=tuple(rows),
        muscles=problem.trajectory.muscles,
        values=np.vstack(values),
        external_work=np.concatenate(work),
    )


def plot_stability_contributions(
    contributions: StabilityContributions, *, most_muscles: int = MOST_MUSCLES
) -> Figure:
    """Draw which muscle stabilizes which axis, as a heat map.

    Parameters
    ----------
    contributions : StabilityContributions
    most_muscles : int
        Of more muscles than this, and of those that add next to nothing, only the ones that matter most
        are shown; the title says how many.

    Returns
    -------
    matplotlib.figure.Figure
    """
    values = contributions.values
    largest = np.abs(values).max(axis=0)
    order = np.argsort(-largest, kind="stable")[:most_muscles]
    order = np.sort(order[largest[order] >= NEGLIGIBLE_SHARE * largest.max()])
    shown = values[:, order]
    names = [contributions.muscles[m] for m in order]
    n_rows, n_columns = shown.shape
    figure = Figure(
        figsize=(max(5.0, 2.2 + 0.27 * n_columns), max(2.6, 1.9 + 0.27 * n_rows)),
        dpi=style.RESOLUTION,
        layout="constrained",
    )
    panel = figure.subplots()
    limit = float(np.abs(shown).max()) or 1.0
    image = panel.imshow(shown, cmap="RdBu", norm=Normalize(-limit, limit), aspect="auto")
    panel.set_xticks(np.arange(n_columns), names, rotation=90, fontsize=style.TEXT - 1)
    loads = -contributions.external_work
    panel.set_yticks(
        np.arange(n_rows),
        [f"{row}  (load {_whole(load)})" for row, load in zip(contributions.rows, loads, strict=True)],
        fontsize=style.TEXT - 1,
    )
    if n_rows * n_columns <= 200:
        for r in range(n_rows):
            for c in range(n_columns):
                dark = abs(shown[r, c]) > 0.55 * limit
                panel.text(
                    c, r, _whole(shown[r, c]), ha="center", va="center", fontsize=style.TEXT - 2.5,
                    color="white" if dark else "black",
                )  # fmt: skip
    panel.set_xticks(np.arange(n_columns + 1) - 0.5, minor=True)
    panel.set_yticks(np.arange(n_rows + 1) - 0.5, minor=True)
    panel.grid(which="minor", color="white", linewidth=0.8)
    panel.tick_params(which="both", length=0)
    title = "What each muscle adds to the stability of each axis"
    if n_columns < len(contributions.muscles):
        title += f" ({n_columns} of {len(contributions.muscles)} muscles)"
    # of the figure, not of the panel: the panel may be narrower than the text
    figure.suptitle(title, fontsize=style.TEXT + 1, x=0.01, ha="left")
    bar = figure.colorbar(image, ax=panel, shrink=0.9)
    bar.set_label("N·m/rad", fontsize=style.TEXT)
    bar.ax.tick_params(labelsize=style.TEXT - 1)
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
    figure, panels = style.panel_grid(
        len(comparison.groups), title=f"{comparison.results[0].name}: sensitivity"
    )
    largest = LEAST_SCALE
    for g, (group, panel) in enumerate(zip(comparison.group_names, panels, strict=True)):
        means = np.array([comparison.activity[name][used, g].mean() for name in labels])
        look = style.series_style(1)
        panel.plot(x, means, "-", color=look.color, linewidth=1.4)
        panel.plot(
            x[~hollow], means[~hollow], "o", color=look.color, markersize=3.5, label="with stability rows"
        )
        if hollow.any():
            panel.plot(
                x[hollow], means[hollow], "o", color=look.color, markerfacecolor="white", markersize=3.5,
                label="some rows missed",
            )  # fmt: skip
        largest = max(largest, float(means.max()))
        for name, level, line, color in (
            (reference, None if reference is None else comparison.activity[reference][used, g].mean(), "--",
             style.series_style(0).color),
            (EMG_LABEL, comparison.emg[used, g].mean() if comparison.emg is not None else None, "-",
             style.EMG_COLOR),
        ):  # fmt: skip
            if name is not None and level is not None and np.isfinite(level):
                panel.axhline(float(level), linestyle=line, color=color, linewidth=1.4, label=name, zorder=1)
                largest = max(largest, float(level))
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(FixedLocator(_few_ticks(x)))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.xaxis.set_minor_locator(NullLocator())
        _panel_title(panel, group)
    panels[0].set_ylim(0, 1.06 * largest)
    style.label_figure(figure, panels, label, "Mean activation [-]")
    return figure


def plot_muscle_lines(
    skeleton: Skeleton,
    activation: FloatArray,
    frames: Sequence[int],
    *,
    titles: Sequence[str] = (),
    highest: float | None = None,
) -> Figure:
    """Draw the muscles' lines in space, colored by activation: side view above, front view below.

    Parameters
    ----------
    skeleton : Skeleton
    activation : ndarray, shape (n_frames, n_muscles) [-]
    frames : sequence of int
        Frames to show, one column each.
    titles : sequence of str
        One per column.
    highest : float [-], optional
        Activation at the dark end of the colors; the largest shown by default.

    Returns
    -------
    matplotlib.figure.Figure
        Joints that the muscles' paths cross are black dots.

    Raises
    ------
    DataError
        Shapes do not fit, or a frame that is not there.
    """
    n_frames, n_muscles = skeleton.path_point_bodies.shape[:2]
    activation = read_only(
        "activation", activation, (n_frames, n_muscles), "n_frames, n_muscles", finite=False
    )
    frames = list(frames)
    outside = [k for k in frames if not 0 <= k < n_frames]
    if not frames or outside:
        raise DataError(f"frames to show are {frames}, expected some of 0 to {n_frames - 1}")
    if titles and len(titles) != len(frames):
        raise DataError(f"{len(titles)} titles for {len(frames)} frames, expected one each")
    if highest is None:
        highest = max(float(np.nanmax(activation[frames], initial=0.0)), 0.01)
    colors, scale = style.activation_colors(), Normalize(0.0, highest)
    moving = _crossed_joints(skeleton)
    figure = Figure(figsize=(1.2 + 1.75 * len(frames), 5.2), dpi=style.RESOLUTION, layout="constrained")
    panels = figure.subplots(2, len(frames), squeeze=False)
    views = ((0, 1, "side"), (2, 1, "front"))
    shown = skeleton.path_points[frames][skeleton.path_point_bodies[frames] != NO_POINT]
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = 0.06 * float((high - low).max())
    for column, k in enumerate(frames):
        order = np.argsort(np.nan_to_num(activation[k], nan=-1.0))
        for row, (across, up, view) in enumerate(views):
            panel = panels[row, column]
            lines = []
            for m in order:
                there = skeleton.path_point_bodies[k, m] != NO_POINT
                lines.append(skeleton.path_points[k, m, there][:, [across, up]])
            collection = LineCollection(lines, cmap=colors, norm=scale, linewidths=1.8, capstyle="round")
            collection.set_array(np.ma.masked_invalid(activation[k, order]))
            panel.add_collection(collection)
            centers = skeleton.joint_centers[k, moving]
            panel.plot(centers[:, across], centers[:, up], "o", color="black", markersize=3)
            panel.set_xlim(low[across] - margin, high[across] + margin)
            panel.set_ylim(low[up] - margin, high[up] + margin)
            panel.set_aspect("equal")
            panel.xaxis.set_major_locator(MaxNLocator(3))
            panel.tick_params(labelsize=style.TEXT - 2, labelleft=column == 0)
            panel.spines[["top", "right"]].set_visible(False)
            if column == 0:
                panel.set_ylabel(f"{view} view, y [m]", fontsize=style.TEXT)
            panel.set_xlabel(f"{'xyz'[across]} [m]", fontsize=style.TEXT)
            if row == 0:
                _panel_title(panel, titles[column] if titles else f"frame {k}")
    bar = figure.colorbar(ScalarMappable(norm=scale, cmap=colors), ax=panels, shrink=0.6, pad=0.02)
    bar.set_label("Activation [-]", fontsize=style.TEXT)
    bar.ax.tick_params(labelsize=style.TEXT - 1)
    return figure


def group_has_emg(comparison: Comparison, group: int) -> bool:
    """Tell if a group has EMG channels that were read.

    Parameters
    ----------
    comparison : Comparison
    group : int
        Position in the groups.

    Returns
    -------
    bool
    """
    return comparison.emg is not None and bool(np.isfinite(comparison.emg[:, group]).all())


def _crossed_joints(skeleton: Skeleton) -> IntArray:
    """Find the joints with a muscle on both sides, in the first frame."""
    bodies = skeleton.path_point_bodies[0]
    crossed = []
    for j in range(len(skeleton.joints)):
        distal = skeleton.distal_bodies(j)
        there = bodies != NO_POINT
        on_distal = there & distal[np.where(there, bodies, 0)]
        on_base = there & ~distal[np.where(there, bodies, 0)]
        if bool(np.any(on_distal.any(axis=1) & on_base.any(axis=1))):
            crossed.append(j)
    return np.array(crossed, dtype=np.int64)


def _stiffness(solution: Solution, name: str) -> FloatArray:
    key = f"{name}.muscle_stiffness"
    if key not in solution.quantities:
        raise DataError(f"the solution has no {key!r} among its quantities, expected one from the solver")
    return solution.quantities[key]


def _few_ticks(x: FloatArray) -> list[float]:
    """Keep values that are far enough apart on a logarithmic axis for their labels."""
    span = float(np.log(x[-1] / x[0])) or 1.0
    kept: list[float] = []
    for value in x.tolist():
        if not kept or np.log(value / kept[-1]) > 0.14 * span:
            kept.append(value)
    return kept


def _whole(value: float) -> str:
    """Write a rounded number, without the sign of a zero."""
    return f"{round(float(value)) + 0:d}"


def _panel_title(panel: Axes, text: str) -> None:
    panel.set_title(text, fontsize=style.TEXT, loc="left", pad=3)
