"""The scorecard as a figure: differences from static optimization with their intervals, and their count."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from problems.outputs import markdown_table
from problems.scorecard.running import SO
from scso_nlp.figures.grid import add_legend
from scso_nlp.figures.style import (
    CURVE,
    INCH,
    LEAST_TEXT,
    MARK,
    QUIET,
    REQUIRED,
    RESOLUTION,
    RESULT,
    TEXT,
    ShownFigure,
    panel_title,
    quiet_axes,
)

#: Marker and color of each verdict.
LOOKS = {
    "better": ("^", RESULT.color),
    "worse": ("v", MARK.color),
    "no difference": ("o", REQUIRED.color),
    "undecided": ("P", RESULT.color),
    "no power": ("D", QUIET),
    "too few units": ("s", QUIET),
    "not solved": ("X", QUIET),
}
#: Width on the page [mm]: a phone shrinks it by a tenth.
WIDTH = 110.0
#: A line of labels; labels beside panels and how far they are set in; between columns; above and below the
#: panels of a block; above all, and at the right [mm].
_LINE, _LABELS, _INDENT, _GAP, _ABOVE, _BELOW, _TOP, _RIGHT = 2.35, 44.5, 2.5, 3.0, 7.6, 7.4, 5.0, 4.0
#: Size of markers [points].
_MARKER = 3.2

Cell = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Block:
    """Sets that share a scale.

    Attributes
    ----------
    title : str
        What their errors are.
    metrics : tuple of str
        One panel each, as columns of the CSV file.
    sets : tuple of str
    digits : int
        That tables show.
    most : float or None
        What is beyond is written in numbers at the edge, for the rest to be seen.
    """

    title: str
    metrics: tuple[str, ...]
    sets: tuple[str, ...]
    digits: int = 3
    most: float | None = None


_EMG = ("agonists", "antagonists")
BLOCKS = (
    Block(title="Lifts: mean absolute difference of activation and EMG [-]", metrics=_EMG,
          sets=("lift_5kg", "lift_15kg")),
    Block(title="Walking and running: 1 − r of activation and EMG [-]", metrics=_EMG,
          sets=("walking_3d", "treadmill_walk", "treadmill_run")),
    Block(title="Knee implant: root mean square difference of force [N]", metrics=("contact force [N]",),
          sets=("knee_implant",), digits=0, most=1500.0),
)  # fmt: skip


def draw(cells: Sequence[Cell]) -> Figure:
    """Draw the differences from static optimization of all sets with a measurement.

    Parameters
    ----------
    cells : sequence of mapping
        Rows of the CSV file by column.

    Returns
    -------
    matplotlib.figure.Figure
        Sets that share a scale have a row of panels, one per metric; 95 % intervals where there are enough
        units.
    """
    shown = [(block, found) for block in BLOCKS if (found := list(_labelled(block, cells)))]
    heights = [_LINE * (len(found) + 0.6) for _, found in shown]
    between = _ABOVE + _BELOW
    height = _TOP + sum(heights) + between * len(shown)
    half = (WIDTH - _LABELS - _RIGHT - _GAP) / 2
    figure = ShownFigure(figsize=(WIDTH / INCH, height / INCH), dpi=RESOLUTION)
    figure.subplots_adjust(
        left=_LABELS / WIDTH, right=1 - _RIGHT / WIDTH,
        bottom=_BELOW / height, top=1 - (_TOP + _ABOVE) / height,
        wspace=_GAP / half, hspace=between * len(shown) / sum(heights),
    )  # fmt: skip
    figure.suptitle(
        "Difference from static optimization, with 95 % intervals",
        fontsize=TEXT + 1, x=1.5 / WIDTH, y=1 - 1.0 / height, ha="left", va="top",
    )  # fmt: skip
    grid = figure.add_gridspec(len(shown), 2, height_ratios=heights)
    for i, (block, found) in enumerate(shown):
        places = [grid[i, 0], grid[i, 1]] if len(block.metrics) == 2 else [grid[i, :]]
        panels = [figure.add_subplot(place) for place in places]
        _write(panels[0], block.title, (0, 1), (1.5 - _LABELS, 4.6), size=TEXT, weight="bold")
        for y, (label, cell) in enumerate(found):
            _write_label(panels[0], y, label, cell)
        for panel, metric in zip(panels, block.metrics, strict=True):
            _draw_panel(panel, metric, [cell for _, cell in found], block.most)
        ends = [end for panel in panels for end in panel.get_xlim()]
        for panel in panels:
            panel.set_xlim(min(ends), max(ends) if block.most is None else block.most)
    used = {str(cell["verdict"]) for _, found in shown for _, cell in found if cell and _has_numbers(cell)}
    entries = {word: _point(*look) for word, look in LOOKS.items() if word in used}
    kinds = {"stability rows": False, "null models": True}
    add_legend(figure, entries | {kind: _point("o", QUIET, is_hollow=v) for kind, v in kinds.items()})
    return figure


def counted(cells: Sequence[Cell]) -> str:
    """Count the intervals on either side of zero, to the digits of the tables, as a Markdown table."""
    rows = []
    for metric in dict.fromkeys(metric for block in BLOCKS for metric in block.metrics):
        for kind, is_null in (("stability rows", False), ("null models", True)):
            signs = []
            for block in BLOCKS:
                for cell in cells:
                    here = cell["set"] in block.sets and cell["method"] != SO and metric in block.metrics
                    if here and _is_null(cell) == is_null:
                        signs.append(_sign(cell, metric, block.digits))
            found = [signs.count(sign) for sign in ("further", "nearer", "neither", "none")]
            if any(found):
                rows.append((metric.split(" [")[0], kind, *found))
    return markdown_table(("metric", "of", "further than SO", "nearer", "around zero", "no interval"), rows)


def _sign(cell: Cell, metric: str, digits: int) -> str:
    low, high = cell[f"{metric}, low"], cell[f"{metric}, high"]
    if low == "":
        return "none"
    return "further" if round(low, digits) > 0 else "nearer" if round(high, digits) < 0 else "neither"


def _is_null(cell: Cell) -> bool:
    return bool(cell["at the effort of"])


def _has_numbers(cell: Cell) -> bool:
    return any(cell[f"{metric}, minus SO"] != "" for block in BLOCKS for metric in block.metrics)


def _labelled(block: Block, cells: Sequence[Cell]) -> Iterator[tuple[str, Cell | None]]:
    """Give every line of a block: sets, their methods with stability rows, null models by effort."""
    for name in block.sets:
        found = [cell for cell in cells if cell["set"] == name]
        if not found:
            continue
        n = max(int(cell["units"]) for cell in found)
        yield f"{name} ({n} {found[0]['unit']}{'s' * (n != 1)})", None
        for reference in dict.fromkeys(cell["at the effort of"] for cell in found):
            if reference:
                yield f"at the effort of {reference}:", None
            yield from (
                (str(cell["method"]), cell)
                for cell in found
                if cell["at the effort of"] == reference and cell["method"] != SO
            )


def _write(panel: Axes, text: str, at: tuple[float, float], away: tuple[float, float], **more: Any) -> None:
    """Write at a place in shares of the panel's width and in its rows (or height), `away` from it [mm]."""
    size = more.pop("size", LEAST_TEXT)
    places = ("axes fraction", more.pop("vertical", "axes fraction"))
    points = [length * 72 / INCH for length in away]
    panel.annotate(text, at, points, places, "offset points", fontsize=size, annotation_clip=False, **more)


def _write_label(panel: Axes, y: int, label: str, cell: Cell | None) -> None:
    is_set = cell is None and not label.startswith("at the effort")
    depth = 0 if is_set else 1 if cell is None or not _is_null(cell) else 2
    _write(
        panel, label, (0, y), (1.5 - _LABELS + _INDENT * depth, 0), vertical="data", va="center_baseline",
        weight="bold" if is_set else "normal", style="italic" if depth == 2 else "normal",
    )  # fmt: skip


def _draw_panel(panel: Axes, metric: str, found: Sequence[Cell | None], most: float | None) -> None:
    quiet_axes(panel)
    panel.grid(visible=False, axis="y")
    panel.set(ylim=(len(found) - 0.4, -0.8), yticks=[])
    panel.spines["left"].set_visible(False)
    panel.axvline(0, color=QUIET, linewidth=0.8, zorder=1)
    panel_title(panel, metric.split(" [")[0].capitalize())
    _write(panel, "← nearer", (0, 0), (0, -5.6), color=QUIET)
    _write(panel, "further →", (1, 0), (0, -5.6), color=QUIET, ha="right")
    for y, cell in enumerate(found):
        if cell is None:
            continue
        panel.axhline(y, color="0.93", linewidth=0.5, zorder=0)
        mean, low, high = (cell[f"{metric}, {what}"] for what in ("minus SO", "low", "high"))
        marker, color = LOOKS[cell["verdict"]]
        if mean == "" or (most is not None and max(mean, high or mean) > most):
            text = cell["verdict"] if mean == "" else f"{mean:+.0f}"
            text += f" ({low:+.0f} to {high:+.0f})" if low != "" else ""
            text += "" if mean == "" else " →"
            place = {"vertical": "data", "va": "center_baseline", "ha": "right"}
            _write(panel, text, (1, y), (0, 0), color=color, **place)
            continue
        if low != "":
            panel.plot([low, high], [y, y], color=color, linewidth=CURVE, solid_capstyle="butt", zorder=2)
        panel.add_line(_point(marker, color, is_hollow=_is_null(cell), at=(mean, y)))
    panel.autoscale_view(scaley=False)


def _point(
    marker: str, color: str, *, is_hollow: bool = False, at: tuple[float, float] | None = None
) -> Line2D:
    x, y = ([], []) if at is None else ([at[0]], [at[1]])
    return Line2D(
        x, y, linestyle="", marker=marker, markersize=_MARKER, color=color, markeredgewidth=0.8, zorder=3,
        markerfacecolor="white" if is_hollow else color,
    )  # fmt: skip
