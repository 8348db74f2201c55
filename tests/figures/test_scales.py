"""Ticks drawn in one go stand where matplotlib's own would, and follow the panel."""

import numpy as np
import pytest
from drawn import drawn
from matplotlib.figure import Figure
from matplotlib.text import Text

from scso_nlp.figures.scales import Scales
from scso_nlp.figures.style import quiet_axes


def panels():
    """Two equal panels, one with matplotlib's own ticks, and the other's scales."""
    figure = Figure(figsize=(6, 2.5), dpi=150)
    own, ours = figure.subplots(1, 2)
    for panel in (own, ours):
        quiet_axes(panel)
    return own, ours, Scales(ours)


def labels(scales):
    """Text and box of every label, the box relative to the panel."""
    drawn(scales._panel.figure)
    corner = scales._panel.bbox.p0
    texts = [part for part in scales._parts() if isinstance(part, Text)]
    return {text.get_text(): text.get_window_extent().get_points() - corner for text in texts}


def own_labels(panel):
    drawn(panel.get_figure())
    found = {}
    for axis in (panel.xaxis, panel.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in axis.get_major_ticks():
            if low <= tick.get_loc() <= high and tick.label1.get_visible():
                box = tick.label1.get_window_extent()
                found[tick.label1.get_text()] = box.get_points() - panel.bbox.p0
    return found


@pytest.mark.parametrize(
    "change",
    [
        lambda panel: panel.set(xlim=(0.48, 1.61), ylim=(-230.0, 180.0)),
        lambda panel: panel.set(xlim=(100.0, 0.0), ylim=(-0.05, 1.08)),
        lambda panel: panel.set(xscale="log", xlim=(1.0, 1000.0), ylim=(2.0, 7.0)),
        lambda panel: (
            panel.set(xlim=(-0.5, 2.5), ylim=(3.0, 4.0)),
            panel.set_xticks([0, 1, 2], ["stoop", "squat", "$x$"]),
        ),
        lambda panel: (
            panel.set(xlim=(0, 1.1), ylim=(2.2, 3.3)),
            panel.tick_params(labelleft=False, labelsize=11),
        ),
    ],
    ids=["linear", "backward", "logarithmic", "named", "one side without labels"],
)
def test_labels_are_those_of_matplotlib_and_stand_there(change):
    own, ours, scales = panels()
    for panel in (own, ours):
        change(panel)
    expected, found = own_labels(own), labels(scales)
    assert found.keys() == expected.keys()
    assert len(found) > 2
    for text, box in expected.items():
        np.testing.assert_allclose(found[text], box, atol=1.5)  # pixels


def test_limits_changed_after_drawing_change_the_labels():
    _, panel, scales = panels()
    panel.set(xlim=(0, 1), ylim=(10, 20))
    assert {"0.0", "0.5", "1.0"} <= labels(scales).keys()
    panel.set_xlim(6.5, 9.5)
    assert {"7", "8", "9"} <= labels(scales).keys()
    assert "0.5" not in labels(scales)


def test_a_common_factor_is_written_and_covers_no_title():
    _, panel, scales = panels()
    title = panel.set_title("a title", loc="left", y=1.0)
    panel.set(xlim=(0, 1), ylim=(0, 3e-7))
    found = labels(scales)
    assert "1e−7" in found
    box = title.get_window_extent().get_points() - panel.bbox.p0
    assert found["1e−7"][1, 0] < box[0, 0]


def grid_lines(scales):
    """Ends of the grid's lines [pixels of the panel]."""
    drawn(scales._panel.figure)
    return scales._parts()[0].get_path().vertices.reshape(-1, 2, 2) - scales._panel.bbox.p0


def test_the_grid_covers_the_panel_and_can_be_turned_off_along_one_axis():
    _, panel, scales = panels()
    panel.set(xlim=(0, 1), ylim=(0, 1))
    lines = grid_lines(scales)
    lengths = np.abs(np.diff(lines, axis=1)[:, 0])
    size = panel.bbox.size
    np.testing.assert_allclose(lengths[lengths[:, 0] > 0], [[size[0], 0]] * 3)
    np.testing.assert_allclose(lengths[lengths[:, 1] > 0], [[0, size[1]]] * 3)
    panel.grid(visible=False, axis="x")
    assert (np.diff(grid_lines(scales), axis=1)[:, 0, 0] > 0).all()


def test_labels_count_where_the_page_is_cut_to_what_is_on_it():
    figure = Figure(figsize=(3, 2), dpi=100)
    panel = figure.add_axes((0.4, 0.4, 0.5, 0.5))
    quiet_axes(panel)
    Scales(panel)
    panel.set(xlim=(0, 1), ylim=(10_000, 20_000))
    box = drawn(figure).get_tightbbox()
    assert box.x0 < 0.4 * 3 - 0.3  # five digits are more than 0.3 inch
    assert box.y0 < 0.4 * 2 - 0.1
