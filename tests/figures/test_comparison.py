"""What stands in the figures must be the numbers they are made from."""

import numpy as np
import pytest
from drawn import drawn
from matplotlib.container import BarContainer

from scso_nlp import figures as plots
from scso_nlp.emg import Emg, EmgMap, MotionResult, MuscleGroup, compare
from scso_nlp.exceptions import DataError

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


def test_activity_shows_every_result_over_its_time_and_emg_only_where_there_is_some():
    solved = np.ones(41, bool)
    solved[5:9] = False
    figure = drawn(plots.plot_activity(comparison([make_result(), make_result("SCSO", solved=solved)])))
    back, deep = figure.axes
    assert [line.get_label() for line in back.lines] == ["SO", "SCSO"]
    assert back.lines[0].get_xdata()[[0, -1]] == pytest.approx([10, 12])
    assert figure.get_supxlabel() == "Time [s]"
    assert back.lines[0].get_ydata() == pytest.approx(0.2 + 0.001 * np.arange(41))
    assert np.isnan(back.lines[1].get_ydata()[5:9]).all()
    area = back.collections[0].get_paths()[0].vertices[:, 1]
    assert area.max() == pytest.approx(ENVELOPE.max(), rel=1e-6)
    assert not deep.collections
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"SO", "SCSO", "EMG"}


def test_activity_can_be_drawn_over_per_cent_of_a_cycle():
    per_cent = plots.percent_of_motion(TIME, 10.5, 11.5)
    assert per_cent[[10, 30]] == pytest.approx([0, 100])
    axis = plots.HorizontalAxis(values=per_cent, label="Cycle [%]")
    figure = drawn(plots.plot_activity(comparison(), horizontal=axis))
    assert figure.get_supxlabel() == "Cycle [%]"
    with pytest.raises(DataError, match=r"the cycle ends at 10\.0 s"):
        plots.percent_of_motion(TIME, 11, 10.0)
    with pytest.raises(DataError, match=r"horizontal values have shape \(2,\), expected \(41,\)"):
        plots.plot_activity(comparison(), horizontal=plots.HorizontalAxis(values=[1.0, 2.0], label="x"))


def test_mean_bars_are_the_means():
    figure = drawn(plots.plot_mean_activity(comparison()))
    panel = figure.axes[0]
    bars = {group.get_label(): group for group in panel.containers if isinstance(group, BarContainer)}
    so, scso, emg = bars["SO"], bars["SCSO"], bars["EMG"]
    assert [bar.get_height() for bar in so] == pytest.approx([0.22, 0.1])
    assert [bar.get_height() for bar in scso] == pytest.approx([0.32, 0.15])
    assert len(emg) == 1


def test_many_groups_stand_in_rows_of_bars_on_one_scale():
    names = tuple(f"muscle_{m}" for m in range(60))
    activation = np.linspace(0.1, 0.7, 60) * np.ones((len(TIME), 1))
    result = MotionResult(
        label="SO", name="walk", time=TIME, muscles=names, activation=activation,
        is_solved=np.ones(len(TIME), dtype=bool), report={},
    )  # fmt: skip
    figure = drawn(plots.plot_mean_activity(compare([result])))
    assert len(figure.axes) == 3
    shown = [tick.get_text() for panel in figure.axes for tick in panel.get_xticklabels()]
    heights = [bar.get_height() for panel in figure.axes for bar in panel.containers[0]]
    assert tuple(shown) == names
    np.testing.assert_allclose(heights, activation[0])
    assert len({panel.get_ylim() for panel in figure.axes}) == 1
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["SO"]


def test_a_model_without_muscles_has_a_figure_without_bars():
    n = len(TIME)
    torques = MotionResult(
        label="torques",
        name="lift",
        time=TIME,
        muscles=(),
        activation=np.zeros((n, 0)),
        is_solved=np.ones(n, bool),
    )
    (panel,) = drawn(plots.plot_mean_activity(compare([torques], n_resamples=0))).axes
    assert not panel.patches


def test_task_bars_stand_for_every_task_and_mark_what_was_not_solved():
    time = np.arange(4.0)
    solved = np.array([True, True, False, True])
    found = comparison([make_result(time=time), make_result("SCSO", time=time, solved=solved)], time)
    figure = drawn(plots.plot_task_bars(found, ["0 m", "0.2 m", "0.4 m", "0.6 m"], x_label="Height"))
    panel = figure.axes[0]
    assert [bar.get_height() for bar in panel.containers[0]] == pytest.approx([0.2, 0.201, 0.202, 0.203])
    assert panel.containers[1][2].get_height() == 0
    assert len(panel.lines) == 1
    by_time = plots.plot_task_bars(found)
    assert [tick.get_text() for tick in by_time.axes[1].get_xticklabels()] == ["0", "1", "2", "3"]
    assert by_time.get_supxlabel() == "Task, by its time [s]"
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
