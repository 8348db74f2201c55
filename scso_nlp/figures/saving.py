"""How figures are written: once to look at, once for print."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from matplotlib.figure import Figure

from scso_nlp.files import write_whole

_LOG = logging.getLogger("scso_nlp")

#: One format to look at, one for print.
FIGURE_FORMATS = ("png", "pdf")


def save_figure(figure: Figure, folder: str | os.PathLike[str], name: str) -> None:
    """Write a figure as PNG and as PDF, each whole or not at all; what lays it out is asked once.

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
    layout = figure.get_layout_engine()
    try:
        for kind in FIGURE_FORMATS:
            with write_whole(Path(folder) / f"{name}.{kind}") as temporary:
                figure.savefig(temporary, format=kind)
            figure.set_layout_engine("none")
    finally:
        figure.set_layout_engine(layout)


def draw_and_save(draw: Callable[[], Figure | None], folder: str | os.PathLike[str], name: str) -> None:
    """Draw a figure beside results and write it; what fails costs only this figure, with a warning.

    Parameters
    ----------
    draw : callable
        Without arguments; None where there is nothing to draw.
    folder : str or path-like
        Exists.
    name : str
        Of the files, without ending.
    """
    try:
        with _nothing_thrown_away():
            figure = draw()
            if figure is not None:
                save_figure(figure, folder, name)
    except Exception as error:  # whatever a drawing library may raise, also for a text that it cannot set
        _LOG.warning("the figure %s is left out: %s", name, " ".join(str(error).split()) or repr(error))


@contextlib.contextmanager
def _nothing_thrown_away() -> Iterator[None]:
    """Keep Python from searching a figure's thousands of objects for garbage: a sixth of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
