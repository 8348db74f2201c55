"""The one panel grid: a panel per muscle, group, coordinate or row, common labels, one legend below.

A figure is as wide as it will be on the page, with text that can be read there. Margins are fixed and axes
are not tied to each other: matplotlib's own ways, ``layout`` and ``sharex``, take many seconds for eighty
panels.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import FEW_FRAMES, HorizontalAxis, frame_edges
from scso_nlp.figures.scales import Scales
from scso_nlp.figures.style import (
    CURVE,
    INCH,
    LEAST_TEXT,
    RESOLUTION,
    TEXT,
    TWO_COLUMNS,
    SeriesStyle,
    ShownFigure,
    literal,
    panel_title,
    quiet_axes,
)
from scso_nlp.validation import FloatArray

#: Least width of a panel, and its height over its width and between which limits [mm].
_LEAST_PANEL, _ASPECT, _LOW, _HIGH = 24.0, 0.62, 15.0, 45.0
#: Gap beside a panel, without and with tick labels of its own [mm].
_TIGHT_GAP, _WIDE_GAP = 3.5, 9.5
#: Gap above a panel, and what each line of its title adds to it [mm].
_ROW_GAP, _LINE = 2.0, 3.2
#: Margins of the figure: beside the gap of the first column, without and with tick labels in it; at the
#: right, below for tick labels and label, and above without and with a heading [mm].
_LEFT, _LEFT_OWN, _RIGHT, _BOTTOM, _TOP, _HEADING = 8.5, 4.0, 3.0, 8.5, 0.5, 6.0
#: Lines of the legend and of notes below it [mm].
_LEGEND_LINE, _NOTE_LINE = 3.7, 2.9
#: Least and largest width of a figure [mm].
WIDTHS = (50.0, 500.0)
#: Mean width of a character over the size of the text, and width of a line or patch of the legend [mm].
_CHARACTER, _HANDLE = 0.58, 12.0


def panel_grid(
    titles: Sequence[str],
    *,
    heading: str = "",
    x_label: str,
    y_label: str,
    horizontal: HorizontalAxis | None = None,
    y_range: tuple[float, float] | None = None,
    width: float = TWO_COLUMNS,
    below: float = 0.0,
) -> tuple[Figure, list[Axes]]:
    """Make a figure with one panel per title, in as many columns as can be read.

    Parameters
    ----------
    titles : sequence of str
        One per panel, of as many lines as are needed.
    heading : str
        Of the whole figure.
    x_label, y_label : str
        Common to all panels, with units.
    horizontal : HorizontalAxis, optional
        Gives all panels the range of the frames.
    y_range : tuple of two floats, optional
        One scale for all panels, labelled in the first column only; otherwise each panel has its own.
    width : float [mm]
        Of the figure on the page.
    below : float [mm]
        Room for long tick labels of the horizontal axis.

    Returns
    -------
    figure : matplotlib.figure.Figure
    panels : list of matplotlib.axes.Axes
        In the order of the titles, row by row. Only the lowest panel of each column has labels of the
        horizontal axis.

    Raises
    ------
    DataError
        A width that no page has, or in which no panel can be read.
    """
    if not WIDTHS[0] <= width <= WIDTHS[1]:
        raise DataError(f"the figure's width is {width:g} mm, expected {WIDTHS[0]:g} to {WIDTHS[1]:g} mm")
    left, gap = (_LEFT_OWN, _WIDE_GAP) if y_range is None else (_LEFT, _TIGHT_GAP)
    room = width - left - _RIGHT
    n_panels = len(titles)
    most = max(1, int(room / (_LEAST_PANEL + gap)))
    # as few empty places as can be, then as many columns
    n_columns = min(range(most, math.ceil(0.6 * most) - 1, -1), key=lambda columns: -n_panels % columns)
    n_columns = max(1, min(n_columns, n_panels))
    n_rows = max(1, math.ceil(n_panels / n_columns))
    panel_width = room / n_columns - gap
    panel_height = min(max(_ASPECT * panel_width, _LOW), _HIGH)
    titles = [_wrapped(title, panel_width + 0.5 * gap, TEXT) for title in titles]
    above = _ROW_GAP + _LINE * max((title.count("\n") + 1 for title in titles), default=1)
    top, bottom = _HEADING if heading else _TOP, _BOTTOM + below
    height = top + n_rows * (panel_height + above) + bottom
    figure = ShownFigure(figsize=(width / INCH, height / INCH), dpi=RESOLUTION)
    figure.subplots_adjust(
        left=(left + gap) / width, right=1 - _RIGHT / width,
        bottom=bottom / height, top=1 - (top + above) / height,
        wspace=gap / panel_width, hspace=above / panel_height,
    )  # fmt: skip
    panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel().tolist()
    for panel in panels[n_panels:]:
        panel.remove()
    panels = panels[:n_panels]
    for i, (panel, title) in enumerate(zip(panels, titles, strict=True)):
        quiet_axes(panel)
        Scales(panel)
        panel_title(panel, title)
        panel.tick_params(
            labelbottom=i + n_columns >= n_panels,  # lowest panel of its column, also above an empty place
            labelleft=y_range is None or i % n_columns == 0,
        )
        if horizontal is not None:
            panel.set_xlim(*limits(horizontal.values))
        if y_range is not None:
            panel.set_ylim(*y_range)
    figure.suptitle(
        literal(heading), fontsize=TEXT + 1, x=1.5 / width, y=1 - 1.5 / height, ha="left", va="top"
    )
    middle = (left + room / 2) / width
    figure.supxlabel(literal(x_label), fontsize=TEXT, x=middle, y=1.0 / height, va="bottom")
    center = (bottom + (height - top - above - bottom) / 2) / height
    figure.supylabel(literal(y_label), fontsize=TEXT, x=1.5 / width, y=center, ha="left")
    return figure, panels


def draw_curve(
    panel: Axes, x: FloatArray, values: FloatArray, look: SeriesStyle, *, label: str, width: float = CURVE
) -> None:
    """Draw one quantity over the frames, with a marker per frame where there are few.

    Parameters
    ----------
    panel : matplotlib.axes.Axes
    x, values : ndarray, shape (n_frames,) [any]
        NaN leaves a frame blank.
    look : SeriesStyle
    label : str
        For the legend.
    width : float [points]
    """
    marker = "o" if len(x) <= FEW_FRAMES else ""
    panel.plot(
        x,
        values,
        look.line,
        color=look.color,
        marker=marker,
        markersize=2.5,
        linewidth=width,
        label=literal(label),
    )


def add_legend(
    figure: Figure, entries: Mapping[str, Artist] | None = None, *, notes: Sequence[str] = ()
) -> None:
    """Put one legend below all panels, with every label once, and sentences below it; after all is drawn.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        It grows by what is put below it.
    entries : mapping of str to artist, optional
        By label; what the panels' artists are called by default.
    notes : sequence of str
        One paragraph each.
    """
    width = figure.get_figwidth() * INCH
    entries = legend_entries(figure) if entries is None else entries
    widths = [_HANDLE + text_width(label, TEXT) for label in entries]
    n_columns = len(widths)
    while n_columns > 1 and sum(max(widths[i::n_columns]) for i in range(n_columns)) > width:
        n_columns -= 1
    lines = [line for note in notes for line in textwrap.wrap(note, _fitting(width - 3.0, LEAST_TEXT))]
    of_notes = _NOTE_LINE * len(lines) + 1.0 if lines else 0.0
    height = _grow(
        figure, of_notes + (_LEGEND_LINE * math.ceil(len(widths) / max(n_columns, 1)) if entries else 0.0)
    )
    if lines:
        figure.text(
            1.5 / width, 1.0 / height, literal("\n".join(lines)), fontsize=LEAST_TEXT, va="bottom",
            linespacing=1.15,
        )  # fmt: skip
    if entries:
        order = [label for i in range(n_columns) for label in list(entries)[i::n_columns]]  # row by row
        figure.legend(
            [entries[label] for label in order], order, loc="lower center", ncols=n_columns,
            bbox_to_anchor=(0.5, of_notes / height), fontsize=TEXT, frameon=False, borderpad=0.2,
            borderaxespad=0.0, labelspacing=0.25, handlelength=2.2, columnspacing=1.5,
        )  # fmt: skip


def legend_entries(figure: Figure) -> dict[str, Artist]:
    """Find what stands for each label, in the first panel that has it."""
    entries: dict[str, Artist] = {}
    for panel in figure.axes:
        for artist, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, artist)
    return entries


def limits(x: FloatArray) -> tuple[float, float]:
    """From the first to the last frame; half a frame more where frames have markers."""
    ends = frame_edges(x) if len(x) <= FEW_FRAMES else x
    return float(ends[0]), float(ends[-1])


def _grow(figure: Figure, more: float) -> float:
    """Make a figure higher at its lower end, all that is there keeping its place; give its height [mm]."""
    old = figure.get_figheight() * INCH
    new = old + more
    inside = figure.subplotpars
    bottom, top = ((y * old + more) / new for y in (inside.bottom, inside.top))
    figure.set_figheight(new / INCH)
    figure.subplots_adjust(bottom=bottom, top=top)
    for text in figure.texts:
        text.set_y((text.get_position()[1] * old + more) / new)
    return new


def text_width(text: str, size: float) -> float:
    """Estimate the width of a text of a size [points] on the page [mm]."""
    return _CHARACTER * size * INCH / 72 * len(text)


def _fitting(width: float, size: float) -> int:
    """Characters of a size [points] that fit into a width [mm]."""
    return max(8, int(width / text_width("x", size)))


def _wrapped(title: str, width: float, size: float) -> str:
    """Break a title into lines that fit into a width [mm], after underscores where there are some."""
    most = _fitting(width, size)
    lines: list[str] = []
    for line in title.split("\n"):
        while len(line) > most:
            cut = max(line.rfind("_", 0, most), line.rfind(" ", 0, most)) + 1 or most
            lines.append(line[:cut].rstrip())
            line = line[cut:]
        lines.append(line)
    return "\n".join(lines)
