"""The scorecard's figure on made-up measurements, and what its page says beside it."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import two_antagonists
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import same_color
from matplotlib.text import Text

import scso_nlp as scso
from problems.scorecard import figure, rules
from problems.scorecard.page import COLUMNS, judged, lines, trial_table
from problems.scorecard.running import SO
from problems.scorecard.sets import SETS
from scso_nlp.figures.style import INCH, LEAST_TEXT

BESIDE = "axes, q = 5"


def row(method, more=0.0, *, metrics=("agonists", "antagonists"), units=3, reference=None, **changed):
    """A method that is `more` further from the measurement than static optimization in every metric."""
    around = np.array([0.0, -0.01, 0.01])[:units]
    errors = {metric: (more * (1 + around)).tolist() for metric in metrics}
    found = {"method": method, "power": 1.0, "solved": 1.0, "reserves": 0.0, "missed": 0.0, "effort": 1.0}
    return found | {"errors": errors} | ({"reference": reference} if reference else {}) | changed


def made_up(rows, unit="bend", **facts):
    return {"kind": "measured", "unit": unit, "rows": rows, **facts}


FORCE = {"metrics": ("contact force",)}
RESULT = {
    "lift_5kg": made_up([
        row(SO),
        row(BESIDE, 0.1),
        row("coordinates, q = 5", -0.2),
        row("whole Hessian, q = 5", power=0.01),
        row("activation floor", 0.3, reference=BESIDE),
    ]),
    "walking_3d": made_up([row(SO, units=1), row(BESIDE, 0.4, units=1)], unit="stride"),
    "knee_implant": made_up([
        row(SO, **FORCE),
        row(BESIDE, 4000.0, **FORCE),
        row("coordinates, q = 40", 1000.0, **FORCE),
        row("antagonist ratio", reference="coordinates, q = 40", solved=0.0, errors={}),
    ], unit="trial", **{"body weight [N]": 100.0}),
}  # fmt: skip


@pytest.fixture(scope="module")
def cells():
    return [
        dict(zip(COLUMNS, line, strict=True)) for name, found in RESULT.items() for line in lines(name, found)
    ]


@pytest.fixture(scope="module")
def drawn(cells):
    found = figure.draw(cells)
    FigureCanvasAgg(found).draw()
    return found


def labels(panel):
    """Rows of the labels beside a panel, by text."""
    found = [text for text in panel.texts if text.xy[0] == 0 and "nearer" not in text.get_text()]
    return {text.get_text(): text.xy[1] for text in found if text.xycoords == ("axes fraction", "data")}


def points(panel):
    return {line.get_ydata()[0]: line for line in panel.lines if len(line.get_ydata()) == 1}


def bars(panel):
    """Ends of the intervals by row; lines at zero and along rows are in shares of the panel."""
    plain = [line for line in panel.lines if line.get_transform() == panel.transData]
    return {line.get_ydata()[0]: line.get_xdata() for line in plain if len(line.get_ydata()) == 2}


def test_points_and_intervals_are_the_differences_beside_their_labels(drawn):
    agonists, antagonists = drawn.axes[:2]
    at = labels(agonists)
    assert agonists.get_title(loc="left") == "Agonists"
    for method, more in ((BESIDE, 0.1), ("coordinates, q = 5", -0.2), ("activation floor", 0.3)):
        _, low, high = rules.interval(more * np.array([0.99, 1.0, 1.01]))
        for panel in (agonists, antagonists):
            assert points(panel)[at[method]].get_xdata() == pytest.approx([more])
            assert sorted(bars(panel)[at[method]]) == pytest.approx(sorted([low, high]))
    assert at["lift_5kg (3 bends)"] < at[BESIDE] < at[f"at the effort of {BESIDE}:"] < at["activation floor"]


def test_verdicts_differ_in_shape_and_color_and_null_models_are_hollow(drawn):
    panel = drawn.axes[0]
    at, found = labels(panel), points(panel)
    looks = {
        BESIDE: "worse",
        "coordinates, q = 5": "undecided",
        "whole Hessian, q = 5": "no power",
        "activation floor": "worse",
    }
    for method, verdict in looks.items():
        assert found[at[method]].get_marker() == figure.LOOKS[verdict][0]
        assert same_color(found[at[method]].get_color(), figure.LOOKS[verdict][1])
        hollow = same_color(found[at[method]].get_markerfacecolor(), "white")
        assert hollow == (method == "activation floor")
    assert len({marker for marker, _ in figure.LOOKS.values()}) == len(figure.LOOKS)
    shown = {text.get_text() for text in drawn.legends[0].get_texts()}
    assert shown == {"worse", "undecided", "no power", "too few units", "stability rows", "null models"}


def test_one_unit_is_a_point_without_an_interval(drawn):
    panel = drawn.axes[2]
    assert points(panel)[labels(panel)[BESIDE]].get_xdata() == pytest.approx([0.4])
    assert labels(panel)[BESIDE] not in bars(panel)


def test_what_is_beyond_the_edge_or_not_solved_is_written(drawn):
    panel = drawn.axes[-1]
    written = {text.xy[1]: text.get_text() for text in panel.texts if text.xy[0] == 1}
    at = labels(panel)
    assert written[at[BESIDE]].startswith("+4000 (+3")
    assert written[at["antagonist ratio"]] == "not solved"
    assert set(points(panel)) == {at["coordinates, q = 40"]}
    assert panel.get_xlim()[1] == figure.BLOCKS[-1].most


def test_text_can_be_read_and_none_is_over_another_or_cut_off(drawn):
    outside = [
        label
        for panel in drawn.axes
        for label in panel.get_xticklabels()
        if not panel.get_xlim()[0] <= label.get_position()[0] <= panel.get_xlim()[1]
    ]
    found = [t for t in drawn.findobj(Text) if t.get_visible() and t.get_text() and t not in outside]
    assert min(text.get_fontsize() for text in found) >= LEAST_TEXT
    # letters of neighboring lines do not touch; boxes have room for those that hang
    boxes = [(text.get_text(), text.get_window_extent().expanded(1.0, 0.7)) for text in found]
    over = [(a, b) for (a, one), (b, other) in itertools.combinations(boxes, 2) if one.overlaps(other)]
    assert over == []
    page = drawn.get_tightbbox()
    assert page.x0 >= 0
    assert page.x1 * INCH <= figure.WIDTH


def test_intervals_are_counted_by_side_metric_and_kind(cells):
    counted = figure.counted(cells).splitlines()
    assert "| agonists | stability rows | 1 | 1 | 1 | 1 |" in counted
    assert "| agonists | null models | 1 | 0 | 0 | 0 |" in counted
    assert "| contact force | stability rows | 2 | 0 | 0 | 0 |" in counted
    assert "| contact force | null models | 0 | 0 | 0 | 1 |" in counted


def test_every_set_with_a_measurement_has_a_place_in_the_figure():
    shown = [name for block in figure.BLOCKS for name in block.sets]
    assert sorted(shown) == sorted(each.name for each in SETS if each.kind == "measured")


def test_contact_forces_stand_trial_by_trial():
    table = trial_table(RESULT["knee_implant"]).splitlines()
    assert table[0].endswith("| GC5_ss1 | GC5_ss3 | GC5_ss8 |")
    assert "| coordinates, q = 40 | 1000, 10.00 | 990, 9.90 | 1010, 10.10 |" in table
    assert not any("antagonist ratio" in line for line in table)


@pytest.mark.parametrize(
    ("alternative", "strongest"),
    [
        (lambda s: scso.ActivationFloor(floor=s), 0.01),
        (lambda s: scso.AntagonistRatio(ratio=s, soft=0.01), 0.95),  # is rather missed
    ],
)
def test_a_term_that_is_too_weak_is_no_advice_to_who_reads_a_table(alternative, strongest):
    """With what the solver really says."""
    problem = replace(two_antagonists(20.0, strength=2000.0), constraints=(scso.MomentEquilibrium(),))
    with pytest.raises(scso.ProblemError) as told:
        scso.at_effort(problem, 0.1, alternative, strongest=strongest)
    rows = [row(SO), row("activation floor", reference=BESIDE, solved=0.0, errors={}, note=str(told.value))]
    *_, (_, verdict, note) = judged("lift_5kg", made_up(rows))
    assert verdict == "not solved"
    assert re.fullmatch(
        rf"short of the effort: 0\.04\d* of 0\.1 in one motion, at its greatest strength, {strongest}", note
    )
