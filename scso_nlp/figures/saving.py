"""How figures are written: to look at, and for print with text that stays text."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from scso_nlp.exceptions import DataError
from scso_nlp.figures.style import RESOLUTION
from scso_nlp.files import write_whole

_LOG = logging.getLogger("scso_nlp")

#: One format to look at, one for print.
FIGURE_FORMATS = ("png", "pdf")
#: All formats that figures can be written in.
ALL_FORMATS = ("pdf", "svg", "png")
#: Text as letters of a font, not as outlines: it can be searched and edited, and journals ask for it.
_LETTERS: Any = {"pdf.fonttype": 42, "svg.fonttype": "none"}


def save_figure(
    figure: Figure | Sequence[Figure],
    folder: str | os.PathLike[str],
    name: str,
    *,
    formats: Sequence[str] = FIGURE_FORMATS,
    dpi: float = RESOLUTION,
) -> tuple[Path, ...]:
    """Write a figure at its own size, each file whole or not at all; what lays it out is asked once.

    Parameters
    ----------
    figure : matplotlib.figure.Figure, or several
        Several are the pages of one PDF; other formats hold the first.
    folder : str or path-like
        Exists.
    name : str
        Of the files, without ending.
    formats : sequence of str
        Of :data:`ALL_FORMATS`.
    dpi : float [dots per inch]
        Of what is no vector.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    DataError
        A file cannot be written, or a format that is not known.
    """
    pages = (figure,) if isinstance(figure, Figure) else tuple(figure)
    if unknown := [kind for kind in formats if kind not in ALL_FORMATS]:
        raise DataError(
            f"figures cannot be written as {unknown[0]!r}, expected some of {', '.join(ALL_FORMATS)}"
        )
    files = []
    layouts = [page.get_layout_engine() for page in pages]
    try:
        for kind in formats:
            files.append(Path(folder) / f"{name}.{kind}")
            with write_whole(files[-1]) as temporary, matplotlib.rc_context(_LETTERS):
                if kind == "pdf":
                    with PdfPages(temporary) as pdf:
                        for page in pages:
                            pdf.savefig(page)
                else:
                    pages[0].savefig(temporary, format=kind, dpi=dpi)
            for page in pages if kind == "pdf" else pages[:1]:
                page.set_layout_engine("none")
    finally:
        for page, layout in zip(pages, layouts, strict=True):
            page.set_layout_engine(layout)
    return tuple(files)


def draw_and_save(
    draw: Callable[[], Figure | Sequence[Figure] | None], folder: str | os.PathLike[str], name: str
) -> None:
    """Draw a figure beside results and write it; what fails costs only this figure, with a warning.

    Parameters
    ----------
    draw : callable
        Without arguments; the figure, its pages, or None where there is nothing to draw.
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
