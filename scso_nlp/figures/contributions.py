"""Which muscle stabilizes which axis, as a heat map."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from scso_nlp.arguments import checked
from scso_nlp.contributions import Contributions
from scso_nlp.exceptions import DataError
from scso_nlp.figures import style

#: Muscles that add less than this share of what the first one adds are left out of the heat map [-].
NEGLIGIBLE_SHARE = 0.01
#: Muscles shown in the heat map at most.
MOST_MUSCLES = 40
#: Height of a row of the heat map [mm], and the most columns that are wide enough for numbers.
_ROW, _MOST_NUMBERS = 5.0, 20


@checked
def plot_contributions(contributions: Contributions, *, most_muscles: int = MOST_MUSCLES) -> Figure:
    """Draw which muscle stabilizes which axis, mean over the solved frames, as a heat map.

    Parameters
    ----------
    contributions : Contributions
    most_muscles : int
        Of more muscles than this, and of those that add next to nothing, only the ones that matter most
        are shown; the title says how many.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        No solved frame.

    Examples
    --------
    >>> figure = scso.plot_contributions(scso.row_contributions(solution))
    """
    solved = np.isfinite(contributions.constant).all(axis=1)
    if not solved.any():
        raise DataError("no frame is solved, there is nothing to split")
    values = contributions.of_muscles[solved].mean(axis=0)
    largest = np.abs(values).max(axis=0)
    order = np.argsort(-largest, kind="stable")[:most_muscles]
    order = np.sort(order[largest[order] >= NEGLIGIBLE_SHARE * largest.max()])
    shown = values[:, order]
    names = [style.literal(contributions.muscles[m]) for m in order]
    n_rows, n_columns = shown.shape
    height = 30.0 + _ROW * n_rows
    figure = style.ShownFigure(
        figsize=(style.TWO_COLUMNS / style.INCH, height / style.INCH),
        dpi=style.RESOLUTION,
        layout="constrained",
    )
    panel = figure.subplots()
    limit = float(np.abs(shown).max()) or 1.0
    # two digits of the largest, and no sign of a zero
    number = f"{{:z.{max(1 - math.floor(math.log10(limit)), 0)}f}}".format
    cells = panel.pcolormesh(
        shown, cmap="RdBu", norm=Normalize(-limit, limit), edgecolors="white", linewidth=0.5
    )
    panel.invert_yaxis()
    panel.set_xticks(np.arange(n_columns) + 0.5, names, rotation=90, fontsize=style.LEAST_TEXT)
    loads = contributions.constant[solved].mean(axis=0)
    panel.set_yticks(
        np.arange(n_rows) + 0.5,
        [
            f"{style.literal(row)}  (load {number(load)})"
            for row, load in zip(contributions.rows, loads, strict=True)
        ],
        fontsize=style.LEAST_TEXT,
    )
    if n_columns <= _MOST_NUMBERS:
        for r in range(n_rows):
            for c in range(n_columns):
                dark = abs(shown[r, c]) > 0.55 * limit
                panel.text(
                    c + 0.5, r + 0.5, number(shown[r, c]), ha="center", va="center",
                    fontsize=style.LEAST_TEXT, color="white" if dark else "black",
                )  # fmt: skip
    panel.tick_params(length=0)
    title = "What each muscle adds to the stability of each axis, mean of the motion"
    if n_columns < len(contributions.muscles):
        title += f" ({n_columns} of {len(contributions.muscles)} muscles)"
    # of the figure, not of the panel: the panel may be narrower than the text
    figure.suptitle(title, fontsize=style.TEXT + 1, x=0.01, ha="left")
    bar = figure.colorbar(cells, ax=panel, fraction=0.03, pad=0.01)
    bar.set_label("N·m/rad", fontsize=style.TEXT)
    bar.ax.tick_params(labelsize=style.LEAST_TEXT)
    return figure
