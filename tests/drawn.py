"""Figures drawn for real, so that layout and fonts are exercised, warnings being errors."""

from matplotlib.backends.backend_agg import FigureCanvasAgg


def drawn(figure):
    """Draw a figure and return it."""
    FigureCanvasAgg(figure).draw()
    return figure
