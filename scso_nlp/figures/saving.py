"""How figures are written: once to look at, once for print."""

from __future__ import annotations

import os
from pathlib import Path

from matplotlib.figure import Figure

from scso_nlp.files import write_whole

#: One format to look at, one for print.
FIGURE_FORMATS = ("png", "pdf")


def save_figure(figure: Figure, folder: str | os.PathLike[str], name: str) -> None:
    """Write a figure as PNG and as PDF, each whole or not at all.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    folder : str or path-like
        Exists.
    name : str
        Of the files, without ending.

    Raises
    ------
    DataError
        A file cannot be written.
    """
    for kind in FIGURE_FORMATS:
        with write_whole(Path(folder) / f"{name}.{kind}") as temporary:
            figure.savefig(temporary, format=kind)
