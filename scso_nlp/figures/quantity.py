"""Figures for print: one quantity of one or several results, left and right in one panel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from scso_nlp.exceptions import DataError
from scso_nlp.figures.cycles import Course, over_cycle, over_time, task_by_task
from scso_nlp.figures.frames import HorizontalAxis, shade_failed, spans
from scso_nlp.figures.grid import add_legend, limits, panel_grid, text_width
from scso_nlp.figures.series import MOST_PANELS, Series, all_names, chosen, most_telling
from scso_nlp.figures.sides import Sided, paired
from scso_nlp.figures.style import (
    CURVE,
    LEAST_TEXT,
    MARK,
    QUIET,
    RESULT,
    TWO_COLUMNS,
    SeriesStyle,
    literal,
    series_style,
)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """What can be drawn.

    Attributes
    ----------
    word : str
        For the vertical axis, without unit.
    kind : str
        What has it, for messages.
    has_one_scale : bool
        All panels have the same vertical axis.
    """

    word: str
    kind: str
    has_one_scale: bool = False


#: What can be asked for, by the word that a user says.
QUANTITIES = {
    "activation": Quantity(word="Activation", kind="muscle", has_one_scale=True),
    "force": Quantity(word="Tendon force", kind="muscle"),
    "stability": Quantity(word="Stability", kind="stability row"),
    "margin": Quantity(word="Margin", kind="stability row"),
    "reaction": Quantity(word="Joint reaction", kind="joint reaction"),
    "moment": Quantity(word="Moment", kind="coordinate"),
}
#: What is this near to its highest value is saturated [-].
SATURATED = 1e-3
#: Lines of the sides where both are in a panel.
_SIDE_LINES = {"right": "-", "left": "--"}
_MARKERS = "os^Dv"
#: Vertical range of panels in which nothing happens [unit of the quantity].
_LEAST_RANGE = 0.1
_BELOW, _SATURATED = "unstable: below its level", "saturated"
#: Height of a row of bars over saturated frames [-].
_ROW = 0.035
#: Panels of a page that shows all names.
PANELS_PER_PAGE = 40


def plot_quantity(
    series: Sequence[Series],
    *,
    quantity: str | Quantity = "activation",
    names: str = "",
    panels: Sequence[Sided] = (),
    percent: bool = False,
    events: Sequence[float] = (),
    tasks: Sequence[str] = (),
    width: float = TWO_COLUMNS,
    heading: str = "",
    notes: Sequence[str] = (),
    horizontal: HorizontalAxis | None = None,
) -> Figure:
    """Draw one quantity of one or several results, left and right in one panel.

    Parameters
    ----------
    series : sequence of Series
        One per result, or per part of a result; the first is what others are compared with.
    quantity : str or Quantity
        One of :data:`QUANTITIES`, or another.
    names : str
        Names or patterns, separated by commas; by default the twelve panels that tell most, see
        :func:`~scso_nlp.figures.series.most_telling`.
    panels : sequence of Sided, optional
        In place of `names`.
    percent : bool
        Over per cent of the motion, or of the cycle between the events.
    events : sequence of float [s]
        0 and 100 % of a cycle; of more than two, every cycle is drawn thin and their mean on top.
    tasks : sequence of str
        Names of the frames, which then are tasks, not moments of a movement.
    width : float [mm]
        Of the figure on the page.
    heading : str
    notes : sequence of str
        Sentences below the panels.
    horizontal : HorizontalAxis, optional
        In place of time.

    Returns
    -------
    matplotlib.figure.Figure
        No text is smaller than 6 points at that width.

    Raises
    ------
    DataError
        No series, an unknown quantity, a cycle of tasks, or as :mod:`scso_nlp.figures.cycles` says.
    NameMismatchError
        A pattern fits no name; the closest are suggested.
    """
    if not series:
        raise DataError("no result to draw, expected at least one")
    what = quantity if isinstance(quantity, Quantity) else known_quantity(quantity)
    are_tasks = bool(tasks) or (horizontal is None and all(each.are_tasks for each in series))
    if are_tasks and (percent or events):
        raise DataError(
            "the frames are tasks and no movement, so there is no cycle; leave percent and events out"
        )
    if are_tasks:
        courses, x_label = task_by_task(series), "Task"
        if tasks and len(tasks) != len(courses[0].x):
            raise DataError(f"{len(tasks)} task names for {len(courses[0].x)} frames, expected one each")
    elif percent or events:
        courses, x_label = over_cycle(series, events)
    else:
        courses, x_label = over_time(series, horizontal)
    shown = tuple(panels) or (chosen(what.kind, names, series) if names else most_telling(series))
    units = {unit for each in series for unit in _units(each, shown)}
    titles = [panel.title for panel in shown]
    if len(units) > 1:
        titles = [f"{title} [{_unit(series, panel)}]" for title, panel in zip(titles, shown, strict=True)]
    titles = [f"{title}\n{panel.note}".strip() for title, panel in zip(titles, shown, strict=True)]
    figure, axes = panel_grid(
        titles,
        heading=heading,
        x_label=x_label,
        y_label=f"{what.word} [{units.pop()}]" if len(units) == 1 else what.word,
        y_range=_common_range(courses, shown) if what.has_one_scale else None,
        width=width,
        below=max((text_width(name, LEAST_TEXT) for name in tasks), default=0.0),
    )
    looks = _looks(series, has_sides=any(len(panel.members) == 2 for panel in shown))
    ends = [limits(course.x) for course in courses]
    for axis, panel in zip(axes, shown, strict=True):
        axis.set_xlim(min(low for low, _ in ends), max(high for _, high in ends))
        (_draw_tasks if are_tasks else _draw_courses)(axis, courses, panel, looks)
        if what.has_one_scale:
            _mark_saturated(axis, courses, panel, looks)
        else:
            widen(axis)
        shade_unstable(axis, series, panel.members.values())
        if len(courses[-1].cycles) == 1:
            shade_failed(axis, courses[-1].x, np.isfinite(courses[-1].cycles[0]).any(axis=1))
        if are_tasks:
            _name_tasks(axis, tasks)
    add_legend(figure, _entries(figure, courses, shown, looks, are_tasks=are_tasks), notes=notes)
    return figure


def known_quantity(word: str) -> Quantity:
    """Find the quantity of a word; DataError where there is none."""
    if word not in QUANTITIES:
        raise DataError(f"the quantity is {word!r}, expected one of {', '.join(QUANTITIES)}")
    return QUANTITIES[word]


def quantity_pages(
    series: Sequence[Series], *, heading: str, quantity: str = "activation"
) -> tuple[Figure, ...]:
    """Draw all names on pages: first those that tell most, then all in their order.

    Parameters
    ----------
    series, heading, quantity
        As for :func:`plot_quantity`.

    Returns
    -------
    tuple of matplotlib.figure.Figure
        One page alone where it has all names.

    Raises
    ------
    DataError
        As for :func:`plot_quantity`.
    """
    pairs = paired(all_names(series))
    pages = [plot_quantity(series, quantity=quantity, heading=f"{heading}{of_how_many(series)}")]
    for i in range(0, len(pairs) if len(pairs) > MOST_PANELS else 0, PANELS_PER_PAGE):
        of_page, number = pairs[i : i + PANELS_PER_PAGE], len(pages) + 1
        pages.append(
            plot_quantity(series, quantity=quantity, panels=of_page, heading=f"{heading}, page {number}")
        )
    return tuple(pages)


def of_how_many(series: Sequence[Series]) -> str:
    """Say what a heading must where not all names are drawn; empty where they are."""
    n_pairs = len(paired(all_names(series)))
    if n_pairs <= MOST_PANELS:
        return ""
    what = "that change most" if len(series) > 1 else "that are largest"
    return f", the {MOST_PANELS} of {n_pairs} {what}"


def _units(series: Series, panels: Sequence[Sided]) -> set[str]:
    wanted = {name for panel in panels for name in panel.members.values()}
    return {unit for name, unit in zip(series.names, series.units, strict=True) if name in wanted}


def _unit(series: Sequence[Series], panel: Sided) -> str:
    return ", ".join(sorted({unit for each in series for unit in _units(each, (panel,))}))


def _common_range(courses: Sequence[Course], panels: Sequence[Sided]) -> tuple[float, float]:
    """From zero to the largest value, with room for the bars over saturated frames."""
    members = [(side, name) for panel in panels for side, name in panel.members.items()]
    largest = max(float(np.nanmax(course.of(name), initial=0.1)) for course in courses for _, name in members)
    rows = len(courses) * len({side for side, _ in members})
    is_saturated = any(
        largest >= course.series.bound("highest", n) - SATURATED for course in courses for _, n in members
    )
    return -0.05 * largest, (1.05 + _ROW * rows if is_saturated else 1.05) * largest


def _looks(series: Sequence[Series], *, has_sides: bool) -> list[SeriesStyle]:
    """One color per series; where sides have the line styles, all series are solid."""
    looks = [each.look or (series_style(i) if len(series) > 1 else RESULT) for i, each in enumerate(series)]
    return [replace(look, line="-") if has_sides else look for look in looks]


def _draw_courses(axis: Axes, courses: Sequence[Course], panel: Sided, looks: Sequence[SeriesStyle]) -> None:
    """Draw lines; of several cycles thin ones and their mean."""
    for course, look in zip(courses, looks, strict=True):
        for side, name in panel.members.items():
            cycles, label = course.of(name), _label(course, side)
            mean = cycles.mean(axis=0)
            line: dict[str, Any] = {"color": look.color, "linestyle": _SIDE_LINES.get(side, look.line)}
            for cycle in cycles if len(cycles) > 1 else ():
                axis.plot(course.x, cycle, **line, linewidth=0.4, alpha=0.6, label="_cycle")
            if course.series.are_few:
                line |= {"marker": "o", "markersize": 2.5}
                line |= {"markerfacecolor": "white" if side == "left" else look.color}
            axis.plot(course.x, mean, **line, linewidth=CURVE * look.weight, label=label)


def _draw_tasks(axis: Axes, courses: Sequence[Course], panel: Sided, looks: Sequence[SeriesStyle]) -> None:
    """Draw points side by side, the left side hollow; nothing connects them."""
    for i, (course, look) in enumerate(zip(courses, looks, strict=True)):
        x = course.x + (i - (len(courses) - 1) / 2) * 0.8 / len(courses)
        for side, name in panel.members.items():
            (values,) = course.of(name)
            axis.plot(x, values, **_point(i, look, side), label=_label(course, side))


def _mark_saturated(
    axis: Axes, courses: Sequence[Course], panel: Sided, looks: Sequence[SeriesStyle]
) -> None:
    """Draw a bar over the saturated frames of each curve, in rows of their own above all curves."""
    row = 0
    for course, look in zip(courses, looks, strict=True):
        for side, name in panel.members.items():
            saturated = course.of(name).mean(axis=0) >= course.series.bound("highest", name) - SATURATED
            if saturated.any():
                starts, stops = spans(course.x, saturated).T
                axis.hlines(
                    np.full(starts.shape, 0.985 - _ROW * row), starts, stops, color=look.color, linewidth=1.6,
                    linestyle=(0, (1, 0.5)) if side == "left" else "-", label=_SATURATED,
                    transform=axis.get_xaxis_transform(),
                )  # fmt: skip
            row += 1


def _point(i: int, look: SeriesStyle, side: str) -> dict[str, Any]:
    """How the points of a series and side look; both sides are seen where they are equal."""
    is_left = side == "left"
    return {
        "linestyle": "none", "marker": _MARKERS[i % len(_MARKERS)], "color": look.color,
        "markersize": 4.6 if is_left else 2.4, "markeredgewidth": 0.7,
        "markerfacecolor": "none" if is_left else look.color,
    }  # fmt: skip


def _label(course: Course, side: str) -> str:
    return literal(f"{course.series.label}, {side}" if side else course.series.label)


def shade_unstable(axis: Axes, series: Sequence[Series], names: Iterable[str]) -> None:
    """Shade what is below the level, which is in view always."""
    levels = {each.bound("level", name) for name in names for each in series}
    for level in sorted(level for level in levels if np.isfinite(level)):
        axis.axhline(level, color=QUIET, linewidth=0.6, zorder=0.9)
        low, high = axis.get_ylim()
        low = min(low, level - 0.08 * (high - low))
        axis.axhspan(low, level, color=MARK.color, alpha=0.13, linewidth=0, zorder=0.3, label=_BELOW)
        axis.set_ylim(low, high)


def _name_tasks(axis: Axes, tasks: Sequence[str]) -> None:
    axis.grid(visible=False, axis="x")
    if not tasks:
        axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        return
    axis.xaxis.set_major_locator(FixedLocator(list(range(1, len(tasks) + 1))))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda place, _: literal(tasks[round(place) - 1])))
    axis.tick_params(axis="x", labelrotation=90)


def _entries(
    figure: Figure, courses: Sequence[Course], panels: Sequence[Sided], looks: Sequence[SeriesStyle], *,
    are_tasks: bool,
) -> Mapping[str, Artist]:  # fmt: skip
    """Put into the legend what is in the figure: series, sides, marks and shades."""
    entries: dict[str, Artist] = {}
    has_sides = any(len(panel.members) == 2 for panel in panels)
    drawn = {label for axis in figure.axes for label in axis.get_legend_handles_labels()[1]}
    for i, (course, look) in enumerate(zip(courses, looks, strict=True)):
        if len(courses) > 1 or not has_sides:
            entries[literal(course.series.label)] = (
                Line2D([], [], **_point(i, look, "")) if are_tasks else _line(look)
            )
    for side, line in _SIDE_LINES.items() if has_sides else ():
        gray = SeriesStyle(color=QUIET if len(courses) > 1 else looks[0].color, line=line)
        entries[side] = Line2D([], [], **_point(0, gray, side)) if are_tasks else _line(gray)
    if any(len(course.cycles) > 1 for course in courses):
        n = max(len(course.cycles) for course in courses)
        entries[f"thin: {n} cycles"] = Line2D([], [], color=QUIET, linewidth=0.4)
    if _SATURATED in drawn:
        entries[_SATURATED] = Line2D([], [], color=QUIET, linewidth=1.6)
    for label, color, alpha in ((_BELOW, MARK.color, 0.13), ("not solved", "0.8", 1.0)):
        if label in drawn:
            entries[label] = Patch(color=color, alpha=alpha, linewidth=0)
    return entries


def _line(look: SeriesStyle) -> Line2D:
    line: dict[str, Any] = {"color": look.color, "linestyle": look.line}
    return Line2D([], [], **line, linewidth=CURVE * look.weight)


def widen(panel: Axes) -> None:
    """Keep round-off from filling a panel in which nothing happens."""
    low, high = panel.get_ylim()
    if high - low < _LEAST_RANGE:
        middle = (low + high) / 2
        panel.set_ylim(middle - _LEAST_RANGE / 2, middle + _LEAST_RANGE / 2)
