"""Figures for print: read at their size on the page, both sides in a panel, cycles and tasks as they are."""

import re

import numpy as np
import pytest
from drawn import drawn
from matplotlib.text import Text

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.figures import Series, plot_quantity, save_figure
from scso_nlp.figures.scales import Scales
from scso_nlp.figures.style import INCH, LEAST_TEXT, ONE_COLUMN, TWO_COLUMNS

MUSCLES = tuple(f"muscle_number_{i}_{side}" for side in "rl" for i in range(40))


def series(label="result", names=MUSCLES, n_frames=50, values=None, **more):
    """Columns whose mean squares grow with their number."""
    time = np.linspace(0.2, 1.4, n_frames)
    if values is None:
        values = np.outer(np.abs(np.sin(5 * time)), np.linspace(0.1, 0.9, len(names)))
    return Series(**{"label": label, "time": time, "names": names, "values": values, "units": ("-",), **more})


def titles(figure):
    return [panel.get_title(loc="left").replace("\n", "") for panel in figure.axes]


def texts(figure):
    """All texts that are drawn, the labels of ticks too."""
    drawn(figure)
    found = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text()]
    for scales in figure.findobj(Scales):
        found += [part for part in scales._parts() if isinstance(part, Text)]
    return found


@pytest.mark.parametrize("width", [ONE_COLUMN, TWO_COLUMNS])
@pytest.mark.parametrize("quantity", ["activation", "stability"])
def test_all_text_of_eighty_muscles_has_six_points_at_its_width_on_the_page(width, quantity):
    stable = {"level": np.full(80, 0.2), "highest": np.full(80, 0.5)}
    both = (series(), series("with stability rows", values=np.full((50, 80), 0.5), **stable))
    figure = plot_quantity(both, quantity=quantity, names="*", width=width, heading="walk", notes=["A note."])
    assert figure.get_figwidth() * INCH == pytest.approx(width)
    sizes = [text.get_fontsize() for text in texts(figure)]
    assert len(sizes) > 80
    assert min(sizes) >= LEAST_TEXT == 6
    box = figure.get_tightbbox()  # what would be cut off by the page
    assert box.x0 > 0
    assert box.x1 * INCH < width


@pytest.mark.parametrize("width", [ONE_COLUMN, 120.0])
def test_files_have_the_width_that_is_asked_for_and_letters_as_text(tmp_path, width):
    pdf, svg, png = save_figure(
        plot_quantity([series()], width=width), tmp_path, "walk", formats=("pdf", "svg", "png"), dpi=600
    )
    points = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", pdf.read_bytes()).group(1)
    assert float(points) * INCH / 72 == pytest.approx(width, abs=0.01)
    assert b"/FontFile2" in pdf.read_bytes()
    assert b"/Type3" not in pdf.read_bytes()
    points = re.search(r'<svg .*?width="([\d.]+)pt"', svg.read_text(), re.S).group(1)
    assert float(points) * INCH / 72 == pytest.approx(width, abs=0.01)
    assert ">muscle_number_39<" in svg.read_text()
    pixels = int.from_bytes(png.read_bytes()[16:20])
    assert pixels == pytest.approx(width / INCH * 600, abs=1)


@pytest.mark.parametrize("width", [10.0, 2000.0])
def test_a_width_that_no_page_has_is_refused(width):
    with pytest.raises(DataError, match=f"the figure's width is {width:g} mm, expected 50 to 500 mm"):
        plot_quantity([series()], width=width)


def test_both_sides_are_in_one_panel_with_two_line_styles():
    values = np.tile([0.1, 0.2, 0.3], (50, 1))
    figure = plot_quantity([series(names=("soleus_r", "trunk", "soleus_l"), values=values)])
    assert titles(figure) == ["soleus", "trunk"]
    right, left = figure.axes[0].get_lines()
    assert (right.get_linestyle(), right.get_ydata()[0]) == ("-", 0.1)
    assert (left.get_linestyle(), left.get_ydata()[0]) == ("--", 0.3)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["right", "left"]


def test_there_is_one_time_axis():
    figure = plot_quantity([series(), series("other")], names="*", width=TWO_COLUMNS)
    by_column = {}
    for panel in figure.axes:
        (tick,) = panel.xaxis.get_major_ticks(1)
        place = panel.get_subplotspec()
        by_column.setdefault(place.colspan.start, []).append((place.rowspan.start, tick.label1.get_visible()))
    assert len(by_column) == 5
    for panels in by_column.values():
        *above, (_, lowest) = sorted(panels)
        assert lowest
        assert not any(is_labelled for _, is_labelled in above)


def test_what_changes_most_comes_first_and_what_is_largest_where_there_is_one_result():
    plain = series()
    changed = plain.values.copy()
    changed[:, MUSCLES.index("muscle_number_3_l")] += 0.5
    changed[:, MUSCLES.index("muscle_number_20_r")] += 0.7
    assert titles(plot_quantity([plain]))[:2] == ["muscle_number_39", "muscle_number_38"]
    figure = plot_quantity([plain, series("other", values=changed)])
    assert titles(figure)[:2] == ["muscle_number_20", "muscle_number_3"]
    assert len(figure.axes) == 12


def test_the_least_stable_rows_come_first():
    names = tuple(f"row_{i}" for i in range(20))
    level = np.where(np.arange(20) == 7, 500.0, 0.0)
    values = np.ones((50, 20)) * np.arange(100, 120)
    figure = plot_quantity([series(names=names, values=values, level=level)], quantity="stability")
    assert titles(figure)[:3] == ["row_7", "row_0", "row_1"]


def test_names_are_chosen_by_patterns_in_their_order():
    assert titles(plot_quantity([series()], names="*_12_?, muscle_number_3_l,*_3_r")) == [
        "muscle_number_12",
        "muscle_number_3",
    ]
    assert titles(plot_quantity([series()], names="muscle_number_3_l")) == ["muscle_number_3_l"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("soleas*", r"pattern 'soleas\*' fits no muscle \(closest: soleus_r, soleus_l\)"),
        ("soleus_r,soleas", "unknown muscle 'soleas' .closest: soleus_r"),
        (" , ", "no muscle is named in ' , '"),
    ],
)
def test_a_pattern_that_fits_nothing_names_what_is_near(names, message):
    with pytest.raises(NameMismatchError, match=message):
        plot_quantity([series(names=("soleus_r", "soleus_l", "vasti"))], names=names)


def test_saturated_frames_have_bars_of_their_own():
    values = np.full((50, 2), 0.3)
    values[10:20, 0] = values[30:32, 1] = 0.8
    figure = plot_quantity([series(names=("a_r", "a_l"), values=values, highest=np.array([0.8, 0.8]))])
    bars = [each for each in figure.axes[0].collections if each.get_label() == "saturated"]
    frame = 1.2 / 49
    ends = [bar.get_segments()[0][:, 0] for bar in bars]
    np.testing.assert_allclose(
        ends, [[0.2 + 9.5 * frame, 0.2 + 19.5 * frame], [0.2 + 29.5 * frame, 0.2 + 31.5 * frame]]
    )
    heights = {bar.get_segments()[0][0, 1] for bar in bars}
    assert len(heights) == 2
    assert "saturated" in [text.get_text() for text in figure.legends[0].get_texts()]
    # above all curves
    panel = figure.axes[0]
    low, high = panel.get_ylim()
    assert low + min(heights) * (high - low) > 0.8


def test_per_cent_go_from_the_first_frame_to_the_last_or_between_events():
    time = np.linspace(0.2, 1.4, 50)
    ramp = series(names=("a",), values=time[:, None])
    (line,) = plot_quantity([ramp], percent=True).axes[0].get_lines()
    np.testing.assert_allclose(line.get_xdata()[[0, -1]], [0, 100])
    np.testing.assert_allclose(line.get_ydata(), time)
    figure = plot_quantity([ramp], events=(0.3, 0.8))
    (line,) = figure.axes[0].get_lines()
    np.testing.assert_allclose(line.get_ydata(), 0.3 + 0.5 * line.get_xdata() / 100)
    assert figure.get_supxlabel() == "Cycle [%]"
    assert figure.axes[0].get_xlim() == (0, 100)


def test_several_cycles_are_thin_below_their_mean():
    time = np.linspace(0.2, 1.4, 50)
    figure = plot_quantity([series(names=("a",), values=time[:, None])], events=(0.2, 0.6, 1.2))
    first, second, mean = figure.axes[0].get_lines()
    x = mean.get_xdata() / 100
    np.testing.assert_allclose(first.get_ydata(), 0.2 + 0.4 * x)
    np.testing.assert_allclose(second.get_ydata(), 0.6 + 0.6 * x)
    np.testing.assert_allclose(mean.get_ydata(), 0.4 + 0.5 * x)
    assert first.get_linewidth() == second.get_linewidth() < mean.get_linewidth() / 2
    assert "thin: 2 cycles" in [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ((0.3,), "the events are 0.3 s, expected two or more that increase"),
        ((0.8, 0.3), "the events are 0.8, 0.3 s, expected two or more"),
        (
            (0.3, 2.8),
            "the events reach from 0.3 to 2.8 s, expected times within the motion of 'result', 0.2 to 1.4",
        ),
    ],
)
def test_events_outside_the_motion_or_out_of_order_are_refused(events, message):
    with pytest.raises(DataError, match=message):
        plot_quantity([series()], events=events)


def test_tasks_are_points_that_nothing_connects():
    tasks = ("stoop", "squat", "free")
    values = np.array([[0.1, 0.1], [0.2, 0.3], [0.4, 0.2]])
    given = {"names": ("a_r", "a_l"), "n_frames": 3, "values": values}
    for figure in (
        plot_quantity([series(**given, are_tasks=True), series("b", **given, are_tasks=True)]),
        plot_quantity([series(**given), series("b", **given)], tasks=tasks),
    ):
        (panel,) = figure.axes
        points = panel.get_lines()
        assert [line.get_linestyle() for line in points] == ["None"] * 4
        np.testing.assert_array_equal([line.get_ydata() for line in points], [*values.T, *values.T])
        # side by side around 1, 2, 3; both sides of a result at one place, of which the left one is hollow
        np.testing.assert_allclose([line.get_xdata()[0] for line in points], [0.8, 0.8, 1.2, 1.2])
        assert points[1].get_markerfacecolor() == "none"
        assert points[1].get_markersize() > points[0].get_markersize()
        assert figure.get_supxlabel() == "Task"
    assert {text.get_text() for text in texts(figure)} > set(tasks)


def test_tasks_have_no_cycle_one_name_each_and_one_number():
    with pytest.raises(DataError, match="no movement, so there is no cycle"):
        plot_quantity([series(n_frames=4, are_tasks=True)], percent=True)
    with pytest.raises(DataError, match="2 task names for 50 frames"):
        plot_quantity([series()], tasks=("a", "b"))
    with pytest.raises(DataError, match="different tasks: 3 of 'a', 4 of 'b'"):
        plot_quantity([series(n, n_frames=k, are_tasks=True) for n, k in (("a", 3), ("b", 4))])


def test_a_name_that_only_one_result_has_is_drawn_for_that_one():
    figure = plot_quantity([series(names=("a", "b")), series("other", names=("b", "c"))], names="a,c")
    assert titles(figure) == ["a", "c"]
    known = [[np.isfinite(line.get_ydata()).all() for line in panel.get_lines()] for panel in figure.axes]
    assert known == [[True, False], [False, True]]


def test_panels_of_different_units_say_their_own():
    figure = plot_quantity([series(names=("tilt", "tx"), units=("N·m", "N"))], quantity="moment")
    assert titles(figure) == ["tilt [N·m]", "tx [N]"]
    assert figure.get_supylabel() == "Moment"


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(DataError, match="no result to draw"):
        plot_quantity([])
    with pytest.raises(DataError, match="the quantity is 'power', expected one of activation, force"):
        plot_quantity([series()], quantity="power")
    with pytest.raises(DataError, match="2 units for 80 columns of 'result'"):
        series(units=("N", "m"))
    with pytest.raises(DataError, match="the times of 'result' must increase"):
        series(time=np.zeros(50))
