"""Figures of groups: means over a cycle and how far units vary about them, conditions overlaid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import HorizontalAxis
from scso_nlp.figures.grid import add_legend, panel_grid
from scso_nlp.figures.quantity import known_quantity, shade_unstable, widen
from scso_nlp.figures.series import Series, chosen, most_telling
from scso_nlp.figures.style import CURVE, TWO_COLUMNS, literal, series_style
from scso_nlp.validation import FloatArray, read_only

#: Panels of a figure that nobody has chosen names for, left and right in panels of their own.
MOST_BANDS = 12
#: How much of a band covers what is behind it [-].
_COVER = 0.22


@dataclass(frozen=True, kw_only=True)
class Band:
    """Mean curves of one condition, and their standard deviation.

    Attributes
    ----------
    mean : Series
        Over per cent of the cycle, which stands in `time`.
    deviation : ndarray, shape (n_points, n_names) [unit of the mean]
        NaN where there is none, e.g. of a single person.
    """

    mean: Series
    deviation: FloatArray

    def __post_init__(self) -> None:
        of_whom = f"deviation of {self.mean.label!r}"
        shape = self.mean.values.shape
        kept = read_only(of_whom, self.deviation, shape, "n_points, n_names", finite=False)
        object.__setattr__(self, "deviation", kept)

    def limits(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Mean less and plus one standard deviation, shape (n_points,) each [unit]; NaN where not known."""
        mean = self.mean.column(name)
        if name not in self.mean.names:
            return mean, mean
        half = self.deviation[:, self.mean.names.index(name)]
        return mean - half, mean + half


def plot_bands(
    bands: Sequence[Band],
    *,
    quantity: str = "activation",
    names: str = "",
    width: float = TWO_COLUMNS,
    heading: str = "",
    notes: Sequence[str] = (),
    horizontal: HorizontalAxis | None = None,
) -> Figure:
    """Draw mean curves over a cycle with bands of one standard deviation, conditions overlaid.

    Parameters
    ----------
    bands : sequence of Band
        One per condition; the first is what others are compared with.
    quantity : str
        One of :data:`~scso_nlp.figures.quantity.QUANTITIES`.
    names : str
        Names or patterns, separated by commas; by default those that differ most between conditions, of
        stability those with the least margin.
    width, heading, notes
        As for :func:`~scso_nlp.figures.plot_quantity`.
    horizontal : HorizontalAxis, optional
        In place of the cycle.

    Returns
    -------
    matplotlib.figure.Figure
        Left and right in panels of their own; no text is smaller than 6 points at that width.

    Raises
    ------
    DataError
        No band, or an unknown quantity.
    NameMismatchError
        A pattern fits no name; the closest are suggested.
    """
    if not bands:
        raise DataError("no band to draw, expected at least one")
    what, means = known_quantity(quantity), [band.mean for band in bands]
    shown = _names(means, chosen(what.kind, names, means) if names else ())
    units = dict.fromkeys(
        unit for mean in means for name, unit in zip(mean.names, mean.units, strict=True) if name in shown
    )
    tops = (np.fmax(band.mean.column(name), band.limits(name)[1]) for band in bands for name in shown)
    largest = max((float(np.nanmax(top, initial=0.1)) for top in tops), default=0.1)
    axis = horizontal or HorizontalAxis(values=means[0].time, label="Cycle [%]")
    figure, panels = panel_grid(
        shown,
        heading=heading,
        x_label=axis.label,
        y_label=f"{what.word} [{', '.join(units)}]",
        horizontal=axis,
        y_range=(-0.05 * largest, 1.05 * largest) if what.has_one_scale else None,
        width=width,
    )
    for panel, name in zip(panels, shown, strict=True):
        for i, band in enumerate(bands):
            look = band.mean.look or series_style(i)
            low, high = band.limits(name)
            fill: dict[str, Any] = {"color": look.color, "alpha": _COVER, "linewidth": 0}
            x = band.mean.time if horizontal is None else axis.values
            panel.fill_between(x, low, high, **fill)
            panel.plot(
                x, band.mean.column(name), look.line, color=look.color,
                linewidth=CURVE * look.weight, label=literal(band.mean.label),
            )  # fmt: skip
        if not what.has_one_scale:
            widen(panel)
        shade_unstable(panel, means, (name,))
    add_legend(figure, notes=notes)
    return figure


def _names(means: Sequence[Series], asked: Sequence[Any]) -> tuple[str, ...]:
    """Names of the panels: those asked for, or the most telling, both sides of what is paired."""
    pairs = asked or most_telling(means, MOST_BANDS)
    if not asked and any(len(pair.members) > 1 for pair in pairs):
        pairs = most_telling(means, MOST_BANDS // 2)
    return tuple(name for pair in pairs for name in pair.members.values())
