"""A solution with the bands that spreads of its problem's numbers make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError
from scso_nlp.figures.bands import Band, plot_bands
from scso_nlp.figures.frames import HorizontalAxis, horizontal_axis
from scso_nlp.figures.solution import series_of
from scso_nlp.figures.style import RESULT, TWO_COLUMNS
from scso_nlp.sensitivities import Bands
from scso_nlp.validation import FloatArray


@checked
def plot_uncertainty(
    bands: Bands,
    *,
    quantity: str = "activation",
    names: str = "",
    width: float = TWO_COLUMNS,
    horizontal: HorizontalAxis | None = None,
) -> Figure:
    """Draw a solution with bands about it.

    Parameters
    ----------
    bands : Bands
    quantity : str
        ``"activation"``, ``"force"`` or ``"stability"``.
    names : str
        Names or patterns, separated by commas; by default those that are largest.
    width : float [mm]
    horizontal : HorizontalAxis, optional
        Time by default.

    Returns
    -------
    matplotlib.figure.Figure
        Without a band in frames without derivatives.

    Raises
    ------
    DataError
        Another quantity, or a solution without stability rows that have bands.
    NameMismatchError
        A pattern fits no name.

    Examples
    --------
    >>> change = scso.sensitivity(solution, ["generalized_forces"])
    >>> figure = scso.plot_uncertainty(scso.bands(change, covariance=[4.0]))
    """
    solution = bands.solution
    mean = replace(series_of(solution, quantity, "optimum"), look=RESULT)
    trajectory = solution.problem.motion.trajectory
    axis = horizontal_axis(trajectory.time, horizontal)
    band = Band(mean=mean, deviation=_half_widths(bands, quantity))
    return plot_bands(
        [band],
        quantity=quantity,
        names=names,
        width=width,
        heading=f"{trajectory.name}: {bands.meaning}",
        notes=[f"What spreads: {bands.spreads}"],
        horizontal=axis,
    )


def _half_widths(bands: Bands, quantity: str) -> FloatArray:
    if quantity != "stability":
        return bands.activation if quantity == "activation" else bands.tendon_force
    parts = [bands.row_value.get(term.name) for term in bands.solution.problem.stability_terms]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        raise DataError("bands of eigenvalues, and of rows that are only observed, are not known")
    return np.hstack(known)
