"""Colors, lines and sizes that all figures share.

Colors are those of Okabe and Ito, distinct for all common forms of color blindness; line styles and hatches
repeat the distinction without color. Nothing here touches matplotlib's global settings.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

#: Color of measured EMG.
EMG_COLOR = "0.62"
#: Color of text that explains.
QUIET = "0.35"
#: Size of text, and the least on the page [points]: journals ask for 6 to 8 at final size.
TEXT, LEAST_TEXT = 7.0, 6.0
#: Width of a figure over one and over both columns of a journal's page [mm].
ONE_COLUMN, TWO_COLUMNS = 85.0, 175.0
#: One inch [mm].
INCH = 25.4
#: Width of a curve [points].
CURVE = 1.1
#: Length of ticks, and from there to their labels [points].
TICK, PAD = 2.5, 2.0
#: Resolution of figures that are not vectors [dots per inch].
RESOLUTION = 200

_COLORS = ("#E69F00", "#0072B2", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#000000")
_LINES = ("--", "-", "-.", ":")
_HATCHES = ("", "///", "...", "xxx")


@dataclass(frozen=True, kw_only=True)
class SeriesStyle:
    """How one result is drawn in every figure.

    Attributes
    ----------
    color, line, hatch : str
        As matplotlib has them.
    weight : float [-]
        Times the common width of curves.
    """

    color: str
    line: str
    hatch: str = ""
    weight: float = 1.0


def series_style(position: int) -> SeriesStyle:
    """Give the style of the result at a position; no two of the first 28 are equal."""
    return SeriesStyle(
        color=_COLORS[position % len(_COLORS)],
        line=_LINES[position % len(_LINES)],
        hatch=_HATCHES[position % len(_HATCHES)],
    )


class ShownFigure(Figure):
    """A figure that a notebook shows, whether pyplot was imported or not."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


#: The run that others are compared with, usually plain static optimization.
BASELINE = series_style(0)
#: The run itself, usually with stability rows.
RESULT = series_style(1)
#: What a reader should notice: reserves, active rows.
MARK = SeriesStyle(color=_COLORS[3], line="-")
#: What was asked for.
REQUIRED = SeriesStyle(color=_COLORS[6], line="-", weight=1.8)


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


def literal(text: str) -> str:
    """Write a name so that matplotlib shows its dollars instead of reading mathematics between them."""
    return text.replace("$", r"\$")


def panel_title(panel: Axes, text: str) -> None:
    """Write the title of one panel above its left end, at a fixed place: looking for one is slow."""
    panel.set_title(literal(text), fontsize=TEXT, loc="left", pad=3, y=1.0)


def quiet_axes(panel: Axes) -> None:
    """Give a panel quiet axes with few ticks and a light grid behind the data."""
    panel.tick_params(labelsize=LEAST_TEXT, length=TICK, pad=PAD, width=0.6)
    panel.spines[["left", "bottom"]].set_linewidth(0.6)
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="0.9", linewidth=0.5)
    panel.set_axisbelow(True)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axis.get_offset_text().set_fontsize(LEAST_TEXT)
