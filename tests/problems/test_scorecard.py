"""The scorecard's rules on made-up numbers with known answers, its page, one small set from end to end."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import PROJECT_ROOT

from problems.scorecard import rules
from problems.scorecard.page import COLUMNS, PARAGRAPH, counts, judged, lines, paragraph, write_pages
from problems.scorecard.rules import Entry, verdict
from problems.scorecard.running import at_effort_along

MEASURED = sorted((PROJECT_ROOT / "problems" / "scorecard" / "measured").glob("*.json"))


def entry(power=1.0, solved=1.0, reserves=0.0, **errors):
    return Entry(power=power, solved=solved, reserves=reserves, errors=errors)


#: Four units of static optimization.
SO = entry(agonists=[0.2, 0.3, 0.2, 0.3], antagonists=[0.5, 0.6, 0.5, 0.6])


def moved(by, metric="antagonists", **more):
    errors = np.array(SO.errors[metric]) + by + [-0.01, 0.01, 0.01, -0.01]
    return entry(**{**SO.errors, metric: errors}, **more)


def test_power_counts_frames_in_which_any_row_is_not_kept():
    margin = np.array([[1.0, 0.0], [-0.0005, 2.0], [3.0, -0.1], [-5.0, -5.0]])
    assert rules.power(margin) == 0.5


def test_agonists_have_the_sign_of_the_net_moment():
    moments = np.array([[10.0, -10.0], [0.4, -10.0], [-0.6, 10.0]])
    arms = np.array([[0.1, 0.1], [0.1, 0.0], [0.1, 0.2]])
    # the second moment of the first group is 4 % of its largest; an arm of zero is neither
    assert rules.kinds(arms, moments).tolist() == [[1, -1], [0, 0], [-1, 1]]


def test_bends_meet_halfway_and_short_spans_are_none():
    time = np.arange(20) * 0.25
    moment = np.zeros(20)
    moment[3:7] = moment[12:16] = 100.0  # 0.75 to 1.5 s and 3 to 3.75 s
    moment[9] = 100.0
    assert rules.bends(time, moment).tolist() == [0] * 9 + [1] * 11  # halfway is 2.25 s


def test_levels_differ_by_unit_over_the_cells_of_a_kind():
    measured = np.zeros((4, 2))
    predicted = np.array([[0.1, 9.0], [0.3, 9.0], [0.5, 0.7], [9.0, 9.0]])
    cells = np.array([[1, 0], [1, 0], [1, 1], [0, 0]], dtype=bool)
    found = rules.level_errors(predicted, measured, cells, np.array([0, 0, 1, 2]))
    assert found[:2] == pytest.approx([0.2, 0.6])
    assert math.isnan(found[2])


def test_shapes_are_one_minus_r_and_silence_has_no_correlation():
    wave = np.sin(np.arange(20.0))
    measured = np.tile(wave[:, None], (1, 4))
    predicted = np.column_stack([3 * wave + 1, -wave, np.full(20, 0.01), wave])
    cells = np.ones((20, 4), dtype=bool)
    unit = np.repeat([0, 1], 10)
    cells[3:, 3] = False  # three cells have no shape
    assert rules.shape_errors(predicted, measured, cells, unit) == pytest.approx([1.0, 1.0])
    assert rules.shape_errors(predicted[:, :1], measured[:, :1], cells[:, :1], unit) == pytest.approx([0, 0])


def test_the_lag_is_that_by_which_emg_runs_ahead():
    time = np.arange(0.0, 2.0, 0.02)
    emg_time = np.arange(-1.0, 3.0, 0.01)
    able = np.column_stack([np.sin(5 * time), np.cos(5 * time)])
    emg = np.column_stack([np.sin(5 * (emg_time + 0.13)), np.cos(5 * (emg_time + 0.13))])
    assert rules.lag(time, able, emg_time, emg) == pytest.approx(0.13)


def test_the_interval_is_students_over_units():
    mean, low, high = rules.interval([1.0, 2.0, 3.0])
    half = 4.302652729696142 / math.sqrt(3)  # t at 97.5 % with 2 degrees of freedom, tabulated
    assert (mean, low, high) == pytest.approx((2.0, 2 - half, 2 + half))
    assert rules.interval([1.0, math.nan, 3.0])[0] == 2.0
    assert math.isnan(rules.interval([1.0, math.nan, 3.0])[1])


@pytest.mark.parametrize(
    ("found", "nulls", "word", "note"),
    [
        (moved(-0.2, power=0.04), {}, "no power", ""),
        (moved(-0.2, solved=0.89), {}, "not solved", ""),
        (entry(antagonists=[0.1, 0.1, math.nan, math.nan]), {}, "too few units", "n = 2"),
        (moved(-0.2), {"floor": moved(-0.1)}, "better", "antagonists"),
        (moved(-0.2), None, "better", "antagonists"),
        (moved(-0.2), {}, "undecided", "better than SO, null models not run"),
        (moved(-0.2), {"floor": moved(-0.1), "shift": moved(-0.2)},
         "no difference", "better than SO, not than shift"),
        (moved(-0.2, reserves=0.11), {}, "no difference", "better than SO, with reserves"),
        (moved(-0.2, "agonists"), {}, "no difference", ""),
        (moved(-0.005), {}, "no difference", ""),
        (moved(0.2), {}, "worse", "antagonists"),
        (entry(agonists=[0.4, 0.5, 0.4, 0.51], antagonists=[0.1, 0.2, 0.1, 0.21]), {}, "worse", "agonists"),
    ],
)  # fmt: skip
def test_verdicts_follow_the_protocol(found, nulls, word, note):
    # of entry(antagonists=...) alone there are two units only
    plain = SO if len(found.errors) > 1 else entry(antagonists=SO.errors["antagonists"])
    assert verdict(found, plain, nulls) == (word, note)


def test_reserves_may_be_as_large_as_those_of_static_optimization():
    plain = replace(SO, reserves=0.4)
    assert verdict(moved(-0.2, reserves=0.4), plain)[0] == "better"


def test_rounding_of_solvers_is_no_difference():
    rival = np.array([0.5, 0.6, 0.5, math.nan])
    for more, sign in ((1e-9, 0), (-1e-9, 0), (1e-5, 1), (-1e-5, -1)):
        assert rules.seen(rival + more, rival) == sign


def test_predictions_change_by_more_than_rounding():
    assert rules.is_above(0.0520, 0.05)
    assert not rules.is_above(0.0509, 0.05)
    assert not rules.is_above(1.009, 1.0)


def test_a_pattern_is_moved_until_it_costs_the_effort():
    found = at_effort_along(np.zeros(2), np.array([1.0, 1.0]), 0.5)
    assert found == pytest.approx([0.5, 0.5])
    assert at_effort_along(np.zeros(2), np.array([0.1, 0.0]), 0.5) == pytest.approx([0.1, 0.0])
    assert at_effort_along(np.ones(2), np.zeros(2), 0.5).tolist() == [1.0, 1.0]
    apart = at_effort_along(np.array([1.0, 0.0]), np.array([0.0, 2.0]), 2.0)
    assert apart @ apart == pytest.approx(2.0)


@pytest.mark.opensim
def test_one_set_from_end_to_end(tmp_path):
    from problems.scorecard.__main__ import main

    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("# x\n\nScorecard of old.\nMore.\n\nEnd.\n", encoding="utf-8")
    main(["effort_ramp", "--measured", str(tmp_path / "measured"), "--output", str(tmp_path)])
    (path,) = (tmp_path / "measured").glob("*.json")
    result = json.loads(path.read_text(encoding="utf-8"))
    rows = {row["method"]: row for row in result["sets"]["effort_ramp"]["rows"]}
    assert rows["SO"]["solved"] == 1
    # moments in proportion, activations in proportion: no prediction of static optimization
    assert np.ptp(rows["SO"]["errors"]["flexors over extensors"]) < 1e-3
    reference = rows["axes, q = 5"]
    for null in ("activation floor", "shifted effort", "random patterns"):
        assert rows[null]["effort"] == pytest.approx(reference["effort"], rel=0.011)
    words = {row["method"]: word for row, word, _ in judged("effort_ramp", result["sets"]["effort_ramp"])}
    assert words["SO"] == "as measured"
    text = (tmp_path / "docs" / "scorecard.md").read_text(encoding="utf-8")
    assert "### effort_ramp" in text
    assert "$" not in text
    readme = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert readme == f"# x\n\n{paragraph(result)}\n\nEnd.\n"


@pytest.mark.skipif(not MEASURED, reason="nothing is measured yet")
def test_page_and_readme_say_what_was_measured(tmp_path):
    result = json.loads(MEASURED[-1].read_text(encoding="utf-8"))
    readme = (PROJECT_ROOT / "README.md").read_text(encoding="utf-8")
    assert PARAGRAPH.search(readme)[0] == paragraph(result)
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text(readme, encoding="utf-8")
    write_pages(result, tmp_path)
    for name in ("README.md", "docs/scorecard.md", "docs/scorecard.csv"):
        assert (tmp_path / name).read_bytes() == (PROJECT_ROOT / name).read_bytes()
    with open(tmp_path / "docs" / "scorecard.csv", encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    measured = [row for row in table if row["kind"] == "measured" and row["method"] != "SO"]
    assert len(measured) == sum(counts(result).values()) + sum(counts(result, nulls=True).values())
    better = [row for row in measured if row["verdict"] == "better" and not row["at the effort of"]]
    assert len(better) == counts(result).get("better", 0)
    widths = {len(line) for name, found in result["sets"].items() for line in lines(name, found)}
    assert widths == {len(COLUMNS)}
