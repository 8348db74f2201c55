"""The panel grid leaves nothing outside the page, and no two results look alike."""

import numpy as np
import pytest
from drawn import drawn

from scso_nlp.figures import style
from scso_nlp.figures.frames import HorizontalAxis
from scso_nlp.figures.grid import add_legend, draw_curve, panel_grid
from scso_nlp.figures.style import INCH


def test_no_two_results_look_alike():
    looks = [style.series_style(i) for i in range(28)]
    assert len({(look.color, look.line) for look in looks}) == 28
    grays = [sum(style.activation_colors()(x)[:3]) for x in np.linspace(0, 1, 50)]
    assert (np.diff(grays) < 0).all()


@pytest.mark.parametrize("n_panels", [1, 2, 7])
def test_a_long_legend_stays_on_the_page(n_panels):
    figure, panels = panel_grid(
        [f"muscle {i}" for i in range(n_panels)], heading="walk", x_label="Time [s]", y_label="Activation [-]"
    )
    x = np.arange(30.0)
    for i in range(5):
        label = f"a result with quite a long name, q = {i}"
        draw_curve(panels[-1], x, x, style.series_style(i), label=label)
        draw_curve(panels[0], x, x + 1, style.series_style(i), label=label)
    add_legend(figure)
    legend = drawn(figure).legends[0]
    box = legend.get_window_extent()
    assert len(legend.get_texts()) == 5
    assert figure.bbox.x0 <= box.x0
    assert box.x1 <= figure.bbox.x1


def is_labelled(axis):
    (tick,) = axis.get_major_ticks(1)
    return tick.label1.get_visible()


def test_panels_of_one_scale_are_labelled_at_the_edges_of_the_grid_only():
    axis = HorizontalAxis(values=[0.0, 1.0, 2.0], label="Time [s]")
    titles = [f"muscle {i}" for i in range(7)]
    figure, panels = panel_grid(
        titles, heading="walk", x_label="x", y_label="y", horizontal=axis, y_range=(0.0, 1.0)
    )
    drawn(figure)
    assert [panel.get_title(loc="left") for panel in panels] == titles
    # four columns; below the last of the first row stands nothing
    assert [is_labelled(panel.yaxis) for panel in panels] == [i % 4 == 0 for i in range(7)]
    assert [is_labelled(panel.xaxis) for panel in panels] == [i >= 3 for i in range(7)]
    # few frames have markers, and half a frame of room for them
    assert {panel.get_xlim() for panel in panels} == {(-0.5, 2.5)}
    assert {panel.get_ylim() for panel in panels} == {(0.0, 1.0)}


@pytest.mark.parametrize("n_panels", [1, 3, 12])
@pytest.mark.parametrize("y_range", [None, (0.0, 1.0)])
def test_nothing_is_cut_off_by_the_edges_of_the_page(n_panels, y_range):
    # the last tick label stands half outside its panel
    axis = HorizontalAxis(values=np.linspace(0.0, 100.0, 101), label="Gait cycle [%]")
    figure, _ = panel_grid(
        ["muscle\nwith a note"] * n_panels, heading="walk", x_label="x", y_label="y", horizontal=axis,
        y_range=y_range,
    )  # fmt: skip
    box = drawn(figure).get_tightbbox()
    width, height = figure.get_size_inches()
    margin = 0.5 / INCH
    assert box.x0 > margin
    assert box.x1 < width - margin
    assert box.y0 > margin
    assert box.y1 < height - margin


def test_a_notebook_shows_figures_without_pyplot():
    figure, _ = panel_grid(["soleus"], x_label="Time [s]", y_label="Activation [-]")
    assert figure._repr_png_().startswith(b"\x89PNG")
