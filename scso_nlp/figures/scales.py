"""Ticks, their labels and a light grid of one panel, drawn in one go."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import RendererBase
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Bbox, IdentityTransform

from scso_nlp.figures.style import PAD, TICK
from scso_nlp.validation import FloatArray

#: From the labels of the horizontal axis to the factor below them [points].
_LINE = 9.0


class Scales(Artist):
    """Ticks, tick labels and grid of a panel: two paths and one text per label.

    Matplotlib makes five objects for every tick and asks each of them several times: half the time of eighty
    panels. Here the panel's axes keep all that they know, so limits, scales, locators, formatters,
    ``grid(visible=...)`` and ``tick_params(labelleft=..., labelsize=...)`` work as ever, but are not drawn
    themselves.

    Parameters
    ----------
    panel : matplotlib.axes.Axes
        With ticks at its lower and left side.
    """

    def __init__(self, panel: Axes) -> None:
        super().__init__()
        self._panel = panel
        self.set(zorder=0.5, clip_on=False)  # above shades and below curves, like matplotlib's own
        panel.add_artist(self)
        panel.xaxis.set_visible(False)
        panel.yaxis.set_visible(False)

    def draw(self, renderer: RendererBase) -> None:
        """Draw the scales as the panel is now."""
        for part in self._parts():
            part.draw(renderer)

    def get_window_extent(self, renderer: RendererBase | None = None) -> Bbox:
        """Give the box around the panel and all labels [pixels]."""
        texts = [part for part in self._parts() if isinstance(part, Text)]
        return Bbox.union([self._panel.bbox, *(text.get_window_extent(renderer) for text in texts)])

    def _parts(self) -> list[PathPatch | Text]:
        """Make what is drawn, in pixels of the figure as it is now."""
        panel, figure = self._panel, self._panel.figure
        points = figure.dpi / 72
        length, away, line = TICK * points, (TICK + PAD) * points, _LINE * points
        (left, low), (right, high) = panel.bbox.get_points()
        x, y = _Ticks(panel, panel.xaxis), _Ticks(panel, panel.yaxis)
        grid = [((a, low), (a, high)) for a in x.places if x.has_grid]
        grid += [((left, b), (right, b)) for b in y.places if y.has_grid]
        marks = [((a, low), (a, low - length)) for a in x.places]
        marks += [((left, b), (left - length, b)) for b in y.places]
        parts: list[PathPatch | Text] = [
            _lines(grid, color="0.9", linewidth=0.5),
            _lines(marks, color="black", linewidth=0.6),
        ]
        if x.has_labels:
            look: dict[str, Any] = {"va": "top", "fontsize": x.label_size, "rotation": x.rotation}
            for a, label in zip(x.places, x.labels, strict=True):
                parts.append(Text(a, low - away, label, ha="center", **look))
            if x.factor:
                parts.append(
                    Text(right, low - away - line, x.factor, ha="right", va="top", fontsize=x.label_size)
                )
        if y.has_labels:
            look = {"ha": "right", "fontsize": y.label_size}
            for b, label in zip(y.places, y.labels, strict=True):
                parts.append(Text(left - away, b, label, va="center_baseline", **look))
            if y.factor:  # beside the title, which stands above the panel
                parts.append(Text(left - length, high + length, y.factor, va="bottom", **look))
        for part in parts:
            part.set_figure(figure)
        return parts


class _Ticks:
    """Where the ticks of one axis of a panel are [pixels], and what stands at them."""

    def __init__(self, panel: Axes, axis: Axis) -> None:
        along = 0 if axis is panel.xaxis else 1
        values = np.asarray(axis.get_majorticklocs(), dtype=float)
        places: FloatArray = panel.transData.transform(np.column_stack((values, values)))[:, along]
        formatter = axis.get_major_formatter()
        labels = formatter.format_ticks(values.tolist())
        start, stop = panel.bbox.get_points()[:, along]
        # half a pixel, because limits are often round numbers with a rounding error
        shown = (places > start - 0.5) & (places < stop + 0.5)
        self.places: list[float] = places[shown].tolist()
        self.labels = [label for label, is_shown in zip(labels, shown, strict=True) if is_shown]
        self.factor = formatter.get_offset()
        (look,) = axis.get_major_ticks(1)
        self.has_grid, self.has_labels = look.gridline.get_visible(), look.label1.get_visible()
        self.label_size, self.rotation = look.label1.get_fontsize(), look.label1.get_rotation()


def _lines(ends: list[tuple[tuple[float, float], tuple[float, float]]], **look: Any) -> PathPatch:
    """Make one path of separate lines."""
    path = Path(np.reshape(ends, (-1, 2)), [Path.MOVETO, Path.LINETO] * len(ends))
    return PathPatch(path, fill=False, transform=IdentityTransform(), snap=True, **look)
