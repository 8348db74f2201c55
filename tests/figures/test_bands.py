"""Bands over a cycle: what is drawn is the mean, and one standard deviation to both sides."""

import numpy as np
import pytest
from drawn import drawn
from matplotlib.text import Text

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.figures.bands import Band, plot_bands
from scso_nlp.figures.cycles import PERCENT
from scso_nlp.figures.series import Series
from scso_nlp.figures.style import INCH, LEAST_TEXT

NAMES = tuple(f"muscle_{i}_{side}" for i in range(20) for side in "rl")


def band(label="off", share=1.0, names=NAMES, deviation=0.1, **more):
    values = share * np.outer(0.5 + 0.4 * np.sin(PERCENT / 10), np.linspace(0.2, 1.0, len(names)))
    mean = Series(label=label, time=PERCENT, names=names, values=values, units=("-",), **more)
    return Band(mean=mean, deviation=np.full(values.shape, deviation))


def titles(figure):
    return [panel.get_title(loc="left").replace("\n", "") for panel in figure.axes]


@pytest.mark.parametrize("width", [85.0, 175.0])
def test_all_text_has_six_points_at_its_width_on_the_page(width):
    figure = drawn(plot_bands([band(), band("stiff", 0.6)], width=width, notes=["A note."]))
    assert figure.get_figwidth() * INCH == pytest.approx(width)
    sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_visible() and text.get_text()]
    assert min(sizes) >= LEAST_TEXT


def test_a_band_reaches_one_deviation_to_both_sides_of_its_line():
    (panel,) = plot_bands([band(names=("soleus",))]).axes
    (fill,), (line,) = panel.collections, panel.lines
    heights = fill.get_paths()[0].vertices[:, 1]
    assert line.get_ydata().tolist() == band(names=("soleus",)).mean.column("soleus").tolist()
    assert heights.max() == pytest.approx(line.get_ydata().max() + 0.1)
    assert heights.min() == pytest.approx(line.get_ydata().min() - 0.1)


def test_what_differs_most_is_drawn_both_sides_in_panels_of_their_own():
    """The difference grows with the number of the muscle."""
    assert sorted(titles(plot_bands([band(), band("stiff", 0.6)]))) == sorted(NAMES[-12:])


def test_without_deviation_there_are_lines_alone():
    figure = drawn(plot_bands([band(names=("soleus",), deviation=np.nan)]))
    assert np.isfinite(figure.axes[0].get_ylim()).all()
    assert figure.axes[0].get_ylim()[1] > 0.15


def test_a_name_that_only_one_condition_has_is_drawn_for_that_one():
    figure = plot_bands([band(names=("a",)), band("stiff", names=("a", "b"))], names="b")
    (line,) = [line for line in figure.axes[0].lines if np.isfinite(line.get_ydata()).any()]
    assert line.get_label() == "stiff"


def test_margins_are_shaded_below_zero():
    rows = [band(names=("knee_r_z",), level=np.zeros(1))]
    (panel,) = plot_bands(rows, quantity="margin").axes
    assert panel.get_ylim()[0] < 0
    assert "unstable: below its level" in panel.get_legend_handles_labels()[1]


@pytest.mark.parametrize(
    ("bands", "options", "error", "words"),
    [
        ([], {}, DataError, "no band to draw"),
        ([band()], {"quantity": "speed"}, DataError, "the quantity is 'speed', expected one of activation"),
        ([band()], {"names": "muscel_1_r"}, NameMismatchError, "muscle_1_r"),
    ],
)
def test_what_cannot_be_drawn_is_said(bands, options, error, words):
    with pytest.raises(error, match=words):
        plot_bands(bands, **options)


def test_deviations_of_another_shape_are_refused():
    with pytest.raises(DataError, match=r"deviation of 'off' has shape \(3, 2\), expected \(101, 40\)"):
        Band(mean=band().mean, deviation=np.zeros((3, 2)))
