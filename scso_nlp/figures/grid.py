"""The one panel grid: a panel per muscle, group, coordinate or row, common labels, one legend below.

Margins are fixed in inches and axes are not tied to each other: matplotlib's own ways, ``layout`` and
``sharex``, take many seconds for eighty panels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scso_nlp.figures.frames import FEW_FRAMES, HorizontalAxis, frame_edges
from scso_nlp.figures.scales import Scales
from scso_nlp.figures.style import RESOLUTION, TEXT, SeriesStyle, literal, panel_title, quiet_axes
from scso_nlp.validation import FloatArray

#: Size of one panel [inch].
_PANEL_WIDTH, _PANEL_HEIGHT = 2.0, 1.3
#: Gap beside a panel, without and with tick labels of its own [inch].
_TIGHT_GAP, _WIDE_GAP = 0.2, 0.55
#: Gap above a panel, and what each line of its title adds to it [inch].
_ROW_GAP, _TITLE_LINE = 0.15, 0.2
#: Margins of the figure, and its least width [inch].
_LEFT, _RIGHT, _TOP, _BOTTOM, _LEAST_WIDTH = 0.6, 0.08, 0.22, 0.95, 5.0
#: Width of a character of the legend, and of a line or patch with its gaps [inch].
_CHARACTER, _HANDLE = 0.056, 0.5


def panel_grid(
    titles: Sequence[str],
    *,
    heading: str,
    x_label: str,
    y_label: str,
    horizontal: HorizontalAxis | None = None,
    y_range: tuple[float, float] | None = None,
) -> tuple[Figure, list[Axes]]:
    """Make a figure with one panel per title, in about as many columns as rows.

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

    Returns
    -------
    figure : matplotlib.figure.Figure
    panels : list of matplotlib.axes.Axes
        In the order of the titles, row by row.
    """
    n_panels = len(titles)
    n_columns = max(1, min(n_panels, math.ceil(math.sqrt(n_panels * 0.8))))
    n_rows = max(1, math.ceil(n_panels / n_columns))
    gap = _WIDE_GAP if y_range is None else _TIGHT_GAP
    above = _ROW_GAP + _TITLE_LINE * max((title.count("\n") + 1 for title in titles), default=1)
    width = max(_LEFT + n_columns * (_PANEL_WIDTH + gap) + _RIGHT, _LEAST_WIDTH)
    height = _TOP + n_rows * (_PANEL_HEIGHT + above) + _BOTTOM
    figure = Figure(figsize=(width, height), dpi=RESOLUTION)
    figure.subplots_adjust(
        left=(_LEFT + gap / 2) / width, right=1 - (_RIGHT + gap / 2) / width,
        bottom=_BOTTOM / height, top=1 - (_TOP + above) / height,
        wspace=gap / _PANEL_WIDTH, hspace=above / _PANEL_HEIGHT,
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
            panel.set_xlim(*_limits(horizontal.values))
        if y_range is not None:
            panel.set_ylim(*y_range)
    figure.suptitle(
        literal(heading), fontsize=TEXT + 2, x=0.12 / width, y=1 - 0.12 / height, ha="left", va="top"
    )
    middle = (_LEFT + (width - _LEFT - _RIGHT) / 2) / width
    figure.supxlabel(x_label, fontsize=TEXT + 1, x=middle, y=0.47 / height, va="bottom")
    figure.supylabel(y_label, fontsize=TEXT + 1, x=0.12 / width, ha="left")
    return figure, panels


def draw_curve(
    panel: Axes, x: FloatArray, values: FloatArray, look: SeriesStyle, *, label: str, width: float = 1.4
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
        markersize=3,
        linewidth=width,
        label=literal(label),
    )


def add_legend(figure: Figure) -> None:
    """Put one legend below all panels, with every label once; after all is drawn."""
    width, height = figure.get_size_inches()
    entries = legend_entries(figure)
    if not entries:
        return
    widths = [_HANDLE + _CHARACTER * len(label) for label in entries]
    n_columns = len(widths) if sum(widths) <= width else max(1, int(width / max(widths)))
    figure.legend(
        list(entries.values()), list(entries), loc="lower center", ncols=n_columns,
        bbox_to_anchor=(0.5, 0.06 / height), fontsize=TEXT, frameon=False,
    )  # fmt: skip


def legend_entries(figure: Figure) -> dict[str, Artist]:
    """Find what stands for each label, in the first panel that has it."""
    entries: dict[str, Artist] = {}
    for panel in figure.axes:
        for artist, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, artist)
    return entries


def _limits(x: FloatArray) -> tuple[float, float]:
    """From the first to the last frame; half a frame more where frames have markers."""
    ends = frame_edges(x) if len(x) <= FEW_FRAMES else x
    return float(ends[0]), float(ends[-1])
