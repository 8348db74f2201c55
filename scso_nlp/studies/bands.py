"""Mean curves of a study as figures draw them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from scso_nlp.figures.bands import Band, plot_bands
from scso_nlp.figures.cycles import PERCENT
from scso_nlp.figures.series import Series
from scso_nlp.figures.style import series_style
from scso_nlp.studies.cycles import POINTS
from scso_nlp.studies.results import StudyTables

if TYPE_CHECKING:
    import pandas as pd

#: Figures of a study by their quantity, with the start of the caption.
FIGURES = {
    "activation": "Activation",
    "margin": "Margin of stability rows",
    "reaction": "Resultant force of joints",
}


def bands_of(curves: pd.DataFrame, quantity: str, conditions: tuple[str, ...]) -> list[Band]:
    """Take the bands of one quantity out of the table of mean curves.

    Parameters
    ----------
    curves : DataFrame
        As :func:`~scso_nlp.studies.statistics.mean_curves` gives it.
    quantity : str
    conditions : tuple of str
        In the order of their colors; those without this quantity are left out.

    Returns
    -------
    list of Band
    """
    found = []
    for i, condition in enumerate(conditions):
        of_it = curves[(curves["quantity"] == quantity) & (curves["condition"] == condition)]
        if of_it.empty:
            continue
        mean, deviation = (of_it[of_it["measure"] == measure] for measure in ("mean", "sd"))
        names = tuple(mean["name"])
        series = Series(
            label=condition,
            time=PERCENT,
            names=names,
            values=mean[list(POINTS)].to_numpy().T,
            units=tuple(mean["unit"]),
            level=np.zeros(len(names)) if quantity == "margin" else None,
            look=series_style(i),
        )
        found.append(Band(mean=series, deviation=deviation[list(POINTS)].to_numpy().T))
    return found


def draw_bands(study: StudyTables) -> Iterator[tuple[str, str, Figure]]:
    """Draw the figures of a study, those for which there are cycles.

    Parameters
    ----------
    study : StudyTables

    Yields
    ------
    name, caption : str
    figure : matplotlib.figure.Figure
    """
    curves = study.bands
    for quantity, words in FIGURES.items():
        if bands := bands_of(curves, quantity, study.conditions):
            over = curves["over"].iloc[0]
            counts = sorted(set(curves.loc[curves["quantity"] == quantity, "n"]))
            n = "-".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
            spread = f"; bands: one standard deviation over {n} {over}" if counts[-1] > 1 else ""
            caption = f"{words}: mean over the cycle{spread}."
            yield f"bands_{quantity}", caption, plot_bands(bands, quantity=quantity)
