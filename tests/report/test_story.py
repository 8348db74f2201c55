"""What the page tells before its figures, by hand."""

import numpy as np
import pytest
from helpers import random_problem, with_stability

import scso_nlp as scso
from scso_nlp.emg import MotionResult, compare, read_results
from scso_nlp.report.page import render_report, write_failure
from scso_nlp.report.record import RunRecord, report_on
from scso_nlp.report.story import (
    asked,
    emg_headline,
    largest_changes,
    missing,
    model_of,
    standing,
    with_static_optimization,
)

TIME = np.array([0.0, 0.5, 1.0])


def result(label, activation, **kwargs):
    return MotionResult(
        label=label,
        name="lift",
        time=TIME,
        muscles=("back", "belly"),
        activation=np.array(activation),
        is_solved=kwargs.pop("is_solved", np.ones(3, bool)),
        **kwargs,
    )


def solved(rng):
    """A run with stability rows, its static optimization and its report."""
    problem = random_problem(rng, reserve=50.0)
    baseline = scso.solve_trajectory(problem.without_stability())
    solution = scso.solve_trajectory(problem, baseline=baseline)
    return solution, baseline, report_on(solution, RunRecord(settings={"model": "/a/b/arm.osim"}), baseline)


def test_changes_are_sorted_by_the_largest_difference_in_some_frame():
    before = result("a", [[0.1, 0.2], [0.1, 0.2], [0.1, 0.2]])
    after = result("b", [[0.2, 0.2], [0.1, 0.2], [0.1, 0.5]])
    belly, back = largest_changes(compare([before, after]))
    assert (belly.muscle, back.muscle) == ("belly", "back")
    assert (belly.largest, belly.time) == (pytest.approx(0.3), 1.0)
    assert (back.before, back.after, back.time) == (pytest.approx(0.1), pytest.approx(0.4 / 3), 0.0)


def test_muscles_that_do_not_change_and_frames_that_are_not_solved_are_left_out():
    before = result("a", [[0.1, 0.2], [0.1, 0.2], [0.1, 0.2]])
    after = result("b", [[0.9, 0.2], [0.2, 0.2], [0.1, 0.2]], is_solved=np.array([False, True, True]))
    (only,) = largest_changes(compare([before, after]))
    assert (only.muscle, only.time, only.before) == ("back", 0.5, pytest.approx(0.1))
    assert largest_changes(compare([before])) == ()


def test_the_standing_is_the_verdicts_against_the_limits_that_opensim_advises(rng):
    solution, _, report = solved(rng)
    lines = {line.quantity: line for line in standing(report)}
    assert lines["all stability rows kept"].value == "in 3 of 3 frames"
    reserve = lines["most that reserves carry of a peak moment"]
    assert reserve.limit == "10"
    assert reserve.is_beyond == (solution.verdict.reserve.amount > 10)
    assert reserve.value.startswith(
        f"{solution.verdict.reserve.amount:.4g} % ({solution.verdict.reserve.name} "
    )
    effort = next(line for line in standing(report) if line.quantity.startswith("effort"))
    assert effort.quantity == f"effort {solution.objective:.4g}"


def test_a_miss_says_how_much_and_in_how_many_frames():
    hock = {"name": "hock", "time": 0.22, "amount": 222.0, "unit": "N"}
    (line,) = standing({"verdict": {"n_frames": 37, "missed": hock, "frames_missed": 17}})
    assert line.value == "222 N (hock at t = 0.22 s), some in 17 of 37 frames"
    assert line.is_beyond


@pytest.mark.parametrize("verdict", [None, "all well", {}, {"margin": 3, "effort": [1], "n_frames": "2"}])
def test_a_verdict_of_another_program_is_left_out(verdict):
    assert standing({"verdict": verdict}) == ()
    assert asked({"problem": verdict, "settings": verdict}) == ()
    assert model_of({"problem": verdict}) == ""


def test_what_was_asked_is_said_without_what_is_so_by_default(rng):
    *_, report = solved(rng)
    sentences = asked(report)
    assert sentences[0] == "From arm.osim."
    assert "Least: ActivationEffort()." in sentences or "Least: ActivationEffort(exponent=" in sentences[2]
    assert not [sentence for sentence in sentences if "label=" in sentence]


def test_a_single_result_stands_beside_the_static_optimization_of_its_run(rng, tmp_path):
    solution, baseline, _ = solved(rng)
    scso.write_solution(solution, tmp_path / "r", baseline=baseline, figures=False)
    first, second = with_static_optimization(read_results([tmp_path / "r"]))
    assert first.label == "static optimization"
    np.testing.assert_allclose(first.activation, baseline.activation, atol=1e-14)
    np.testing.assert_allclose(second.activation, solution.activation, atol=1e-14)
    assert standing(first.report), "the static optimization has no verdict"
    assert with_static_optimization((first, second)) == (first, second)


def test_agreement_with_emg_stands_at_the_top(rng):
    from report.test_page import make_result, with_emg

    (first, *_) = emg_headline(with_emg([make_result(), make_result("SCSO")]))
    assert first == "mean absolute difference from EMG, one group: 0.050 (SO), 0.050 (SCSO)."
    assert emg_headline(compare([make_result()])) == ()


def test_a_failed_run_says_what_every_row_misses(rng, tmp_path):
    problem = with_stability(random_problem(rng, stability=False), {"elbow_x": 1e6})
    solution = scso.solve_trajectory(problem, on_failure="return")
    report = report_on(solution, RunRecord(), None)
    rows = {one.row: one for one in missing(report)}
    assert rows["elbow_x"].frames == 3
    worst = max((s for s in solution.shortfalls if s.row == "elbow_x"), key=lambda s: s.amount)
    assert (rows["elbow_x"].most, rows["elbow_x"].time) == (worst.amount, worst.time)
    write_failure(report, "run", tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "0 of 3 frames solved" in text
    assert "elbow_x" in text


def test_the_page_links_only_to_what_it_has():
    text = render_report(compare([result("a", np.full((3, 2), 0.1))]))
    assert "#changes" not in text
    assert "#missing" not in text
