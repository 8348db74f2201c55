"""Colors, lines and sizes that all figures of a comparison share.

Colors are those of Okabe and Ito, distinct for all common forms of color blindness; line styles and hatches
repeat the distinction without color. Nothing here touches matplotlib's global settings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

#: Color of measured EMG.
EMG_COLOR = "0.62"
#: Color of text that explains.
QUIET = "0.35"
#: Size of text [points].
TEXT = 8.0
#: Resolution of figures that are not vectors [dots per inch].
RESOLUTION = 150
#: Size of one panel of a grid [inch].
PANEL_WIDTH, PANEL_HEIGHT = 2.4, 1.6

#: Color of the run that others are compared with, usually plain static optimization.
BASELINE_COLOR = "#E69F00"
#: Color of the run itself, usually with stability rows.
RESULT_COLOR = "#0072B2"
#: Color of what a reader should notice: reserves, active rows.
MARK_COLOR = "#D55E00"
#: Color of what was asked for.
REQUIRED_COLOR = "#000000"

_COLORS = (BASELINE_COLOR, RESULT_COLOR, "#009E73", MARK_COLOR, "#56B4E9", "#CC79A7", "#000000")
_LINES = ("--", "-", "-.", ":")
_HATCHES = ("", "///", "...", "xxx")


@dataclass(frozen=True, kw_only=True)
class SeriesStyle:
    """How one result is drawn in every figure.

    Attributes
    ----------
    color, line, hatch : str
        As matplotlib has them.
    """

    color: str
    line: str
    hatch: str


def series_style(position: int) -> SeriesStyle:
    """Give the style of the result at a position; no two of the first 28 are equal.

    Parameters
    ----------
    position : int

    Returns
    -------
    SeriesStyle
    """
    n = len(_COLORS)
    return SeriesStyle(
        color=_COLORS[position % n],
        line=_LINES[position % len(_LINES)],
        hatch=_HATCHES[position % len(_HATCHES)],
    )


def activation_colors() -> Colormap:
    """Give the color map for activation: pale gray at rest, orange, nearly black at the top.

    Returns
    -------
    matplotlib.colors.Colormap
        Ever darker, so that it can be read in gray.
    """
    return LinearSegmentedColormap.from_list(
        "activation", ["#dcdcdc", "#fdc086", "#e6550d", "#8c1d04", "#2b0300"]
    )


def panel_grid(n_panels: int, *, title: str, share_y: bool = True) -> tuple[Figure, list[Axes]]:
    """Make a figure with one panel per item, in about as many columns as rows.

    Parameters
    ----------
    n_panels : int
        At least one.
    title : str
    share_y : bool
        One scale for all panels.

    Returns
    -------
    figure : matplotlib.figure.Figure
    panels : list of matplotlib.axes.Axes
    """
    n_columns = min(n_panels, max(1, math.ceil(math.sqrt(n_panels * 0.8))))
    n_rows = math.ceil(n_panels / n_columns)
    gap, left, top, bottom, heading = (0.25 if share_y else 0.55), 0.62, 0.24, 0.85, 0.3
    width = max(left + n_columns * (PANEL_WIDTH + gap), 4.6)
    height = top + n_rows * (PANEL_HEIGHT + heading) + bottom
    figure = Figure(figsize=(width, height), dpi=RESOLUTION)
    figure.subplots_adjust(
        left=left / width,
        right=1 - 0.12 / width,
        bottom=bottom / height,
        top=1 - (top + heading) / height,
        wspace=gap / PANEL_WIDTH,
        hspace=heading / PANEL_HEIGHT + 0.05,
    )
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=share_y, squeeze=False).ravel().tolist()
    for i, panel in enumerate(panels):
        finish_panel(panel)
        # the lowest panel of a column, also above an empty place
        panel.tick_params(labelbottom=i + n_columns >= n_panels)
    for panel in panels[n_panels:]:
        panel.remove()
    figure.suptitle(title, fontsize=TEXT + 2, x=0.12 / width, y=1 - 0.1 / height, ha="left", va="top")
    return figure, panels[:n_panels]


def finish_panel(panel: Axes) -> None:
    """Give a panel quiet axes and a light grid behind the data.

    Parameters
    ----------
    panel : matplotlib.axes.Axes
    """
    panel.tick_params(labelsize=TEXT - 1)
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="0.9", linewidth=0.6)
    panel.set_axisbelow(True)
    panel.yaxis.set_major_locator(MaxNLocator(4))


def label_figure(figure: Figure, panels: list[Axes], x_label: str, y_label: str) -> None:
    """Write the common labels and one legend below all panels.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    panels : list of matplotlib.axes.Axes
    x_label, y_label : str
        With units.
    """
    width, height = figure.get_size_inches()
    figure.supxlabel(x_label, fontsize=TEXT + 1, y=0.42 / height, va="bottom")
    figure.supylabel(y_label, fontsize=TEXT + 1, x=0.1 / width, ha="left")
    entries: dict[str, Artist] = {}
    for panel in panels:
        for artist, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, artist)
    if entries:
        figure.legend(
            list(entries.values()),
            list(entries),
            loc="lower center",
            ncols=min(len(entries), 6),
            bbox_to_anchor=(0.5, 0.04 / height),
            fontsize=TEXT,
            frameon=False,
        )
