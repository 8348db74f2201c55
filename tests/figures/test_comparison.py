"""What stands in the figures must be the numbers they are made from."""

import dataclasses
import io

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.container import BarContainer
from solution_by_hand import antagonists, solution_by_hand

from scso_nlp.emg import Emg, EmgMap, MotionResult, MuscleGroup, compare
from scso_nlp.exceptions import DataError
from scso_nlp.figures import comparison as plots
from scso_nlp.figures import style

TIME = 10 + np.linspace(0.0, 2.0, 41)
MAP = EmgMap(
    groups=(
        MuscleGroup(name="back", muscles=("erector",), channels=("es",)),
        MuscleGroup(name="deep", muscles=("psoas",)),
    )
)
ENVELOPE = 0.35 + 0.05 * np.sin(TIME)


def make_result(label="SO", time=TIME, level=0.2, solved=None):
    n = len(time)
    solved = np.ones(n, bool) if solved is None else solved
    activation = np.column_stack([level + 0.001 * np.arange(n), np.full(n, 0.5 * level)])
    activation[~solved] = np.nan
    return MotionResult(
        label=label,
        name="lift",
        time=time,
        muscles=("erector", "psoas"),
        activation=activation,
        is_solved=solved,
    )


def comparison(results=None, time=TIME):
    emg = Emg(channels=("es",), time=TIME, values=ENVELOPE[:, None])
    results = [make_result(), make_result("SCSO", level=0.3)] if results is None else results
    return compare(results, emg=emg if time is TIME else None, emg_map=MAP, n_resamples=0)


def drawn(figure):
    """Draw for real, so that layout and fonts are exercised, warnings being errors."""
    figure.savefig(io.BytesIO(), format="png")
    return figure


def test_activity_shows_every_result_from_time_zero_and_emg_only_where_there_is_some():
    solved = np.ones(41, bool)
    solved[5:9] = False
    figure = drawn(plots.plot_activity(comparison([make_result(), make_result("SCSO", solved=solved)])))
    back, deep = figure.axes
    assert [line.get_label() for line in back.lines] == ["SO", "SCSO"]
    assert back.lines[0].get_xdata()[[0, -1]] == pytest.approx([0, 2])
    assert back.lines[0].get_ydata() == pytest.approx(0.2 + 0.001 * np.arange(41))
    assert np.isnan(back.lines[1].get_ydata()[5:9]).all()
    area = back.collections[0].get_paths()[0].vertices[:, 1]
    assert area.max() == pytest.approx(ENVELOPE.max(), rel=1e-6)
    assert not deep.collections
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"SO", "SCSO", "EMG"}


def test_activity_can_be_drawn_over_per_cent_of_a_cycle():
    per_cent = plots.percent_of_motion(TIME, 10.5, 11.5)
    assert per_cent[[10, 30]] == pytest.approx([0, 100])
    figure = drawn(plots.plot_activity(comparison(), x=per_cent, x_label="Cycle [%]"))
    assert figure.get_supxlabel() == "Cycle [%]"
    with pytest.raises(DataError, match=r"the cycle ends at 10\.0 s"):
        plots.percent_of_motion(TIME, 11, 10.0)
    with pytest.raises(DataError, match="x has shape"):
        plots.plot_activity(comparison(), x=[1.0, 2.0])


def test_mean_bars_are_the_means():
    figure = drawn(plots.plot_mean_activity(comparison()))
    panel = figure.axes[0]
    bars = {group.get_label(): group for group in panel.containers if isinstance(group, BarContainer)}
    so, scso, emg = bars["SO"], bars["SCSO"], bars["EMG"]
    assert [bar.get_height() for bar in so] == pytest.approx([0.22, 0.1])
    assert [bar.get_height() for bar in scso] == pytest.approx([0.32, 0.15])
    assert len(emg) == 1


def test_task_bars_stand_for_every_task_and_mark_what_was_not_solved():
    time = np.arange(4.0)
    solved = np.array([True, True, False, True])
    found = comparison([make_result(time=time), make_result("SCSO", time=time, solved=solved)], time)
    figure = drawn(plots.plot_task_bars(found, ["0 m", "0.2 m", "0.4 m", "0.6 m"], x_label="Height"))
    panel = figure.axes[0]
    assert [bar.get_height() for bar in panel.containers[0]] == pytest.approx([0.2, 0.201, 0.202, 0.203])
    assert panel.containers[1][2].get_height() == 0
    assert len(panel.lines) == 1
    with pytest.raises(DataError, match="2 task names for 4 frames"):
        plots.plot_task_bars(found, ["a", "b"])
    with pytest.raises(DataError, match="41 frames are a movement"):
        plots.plot_task_bars(comparison(), [str(k) for k in range(41)])


def test_values_without_an_answer_that_keeps_all_rows_are_hollow():
    results = [make_result(f"q = {q}", level=1 / q) for q in (2, 5, 10)]
    sweep = [2, 5, 10]
    figure = drawn(plots.plot_sweep(comparison(results), sweep, infeasible=[True, False, False]))
    found = {line.get_label(): list(line.get_xdata()) for line in figure.axes[0].lines}
    assert found["some rows missed"] == [2]
    assert found["with stability rows"] == [5, 10]
    with pytest.raises(DataError, match="infeasible has 1 entries for 3 values"):
        plots.plot_sweep(comparison(results), sweep, infeasible=[True])


def test_a_sweep_has_a_point_per_value_and_a_line_for_the_reference():
    results = [make_result()] + [make_result(f"q = {q}", level=1 / q) for q in (2, 5, 10)]
    figure = drawn(plots.plot_sweep(comparison(results), [2, 5, 10], reference="SO"))
    curve, *levels = figure.axes[0].lines
    assert curve.get_xdata().tolist() == [2, 5, 10]
    assert curve.get_ydata() == pytest.approx(np.array([0.5, 0.2, 0.1]) + 0.02)
    assert [line.get_label() for line in levels] == ["with stability rows", "SO", "EMG"]
    assert levels[1].get_ydata()[0] == pytest.approx(0.22)
    for values, message in (([2, 5], "2 values and 3 results"), ([5, 2, 10], "positive and increase")):
        with pytest.raises(DataError, match=message):
            plots.plot_sweep(comparison(results), values, reference="SO")
    with pytest.raises(DataError, match="no result is called 'S0'"):
        plots.plot_sweep(comparison(results), [2, 5, 10], reference="S0")


def test_contributions_of_muscles_minus_the_load_add_up_to_the_stability_of_each_row():
    solution = solution_by_hand(5, failed=(2,), n_pairs=2)
    length = np.linalg.norm(np.diff(solution.problem.trajectory.skeleton.path_points[0, 0], axis=0))
    quantities = {"JointStability.muscle_stiffness": 5.0 * solution.tendon_force / length}
    solution = dataclasses.replace(solution, quantities=quantities)
    found = plots.stability_contributions(solution)
    assert found.rows == solution.rows["JointStability"].names
    expected = solution.rows["JointStability"].value[solution.is_solved].mean(axis=0)
    assert found.values.sum(axis=1) - found.external_work == pytest.approx(expected, rel=1e-9)
    # a muscle adds nothing to a joint that it does not cross
    assert found.values[0, 2:] == pytest.approx(0)
    figure = drawn(plots.plot_stability_contributions(found, most_muscles=2))
    assert "2 of 4 muscles" in figure.get_suptitle()
    assert figure.axes[0].images[0].get_array().shape == (2, 2)


def test_contributions_need_stability_rows_and_a_solved_frame():
    with pytest.raises(DataError, match="has no stability rows to split"):
        plots.stability_contributions(solution_by_hand(3, stability=False))
    with pytest.raises(DataError, match="no frame is solved"):
        plots.stability_contributions(solution_by_hand(2, failed=(0, 1)))


def test_muscle_lines_run_through_the_path_points_and_carry_their_activation():
    skeleton = antagonists(3)[0].skeleton
    activation = np.array([[0.1, 0.2], [0.6, 0.3], [0.0, 0.4]])
    figure = drawn(plots.plot_muscle_lines(skeleton, activation, [1], titles=["start"]))
    side, front = (panel for panel in figure.axes[:2])
    lines = next(item for item in side.collections if isinstance(item, LineCollection))
    # drawn from the least active to the most active, so that the active ones lie on top
    assert lines.get_array().tolist() == [0.3, 0.6]
    assert lines.get_segments()[1] == pytest.approx(skeleton.path_points[1, 0][:, :2])
    behind = next(item for item in front.collections if isinstance(item, LineCollection))
    assert behind.get_segments()[1] == pytest.approx(skeleton.path_points[1, 0][:, [2, 1]])
    assert side.lines[0].get_xydata() == pytest.approx(np.zeros((1, 2)))
    assert side.get_title(loc="left") == "start"


@pytest.mark.parametrize(
    ("frames", "titles", "message"),
    [
        ([], [], r"frames to show are \[\]"),
        ([3], [], "expected some of 0 to 2"),
        ([0], ["a", "b"], "2 titles for 1"),
    ],
)
def test_muscle_lines_refuse_frames_that_are_not_there(frames, titles, message):
    with pytest.raises(DataError, match=message):
        plots.plot_muscle_lines(antagonists(3)[0].skeleton, np.zeros((3, 2)), frames, titles=titles)


def test_no_two_results_look_alike():
    looks = [style.series_style(i) for i in range(28)]
    assert len({(look.color, look.line) for look in looks}) == 28
    grays = [sum(style.activation_colors()(x)[:3]) for x in np.linspace(0, 1, 50)]
    assert (np.diff(grays) < 0).all()
