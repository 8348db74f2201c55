"""Figures say what the solution holds, need no display and leave no trace."""

import sys
import threading
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from helpers import with_motion
from matplotlib.backends.backend_agg import FigureCanvasAgg
from solution_by_hand import antagonists, solution_by_hand

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.figures import (
    HorizontalAxis,
    activation_pages,
    plot_activations,
    plot_moments,
    plot_stability,
)
from scso_nlp.figures.style import ONE_COLUMN, TWO_COLUMNS
from scso_nlp.solver import observe


def lines(panel):
    return {line.get_label(): line for line in panel.get_lines() if not line.get_label().startswith("_")}


def test_every_muscle_has_one_titled_panel_with_its_own_activation():
    solution = solution_by_hand(21, n_pairs=3)
    figure = plot_activations(solution)
    titles = [panel.get_title(loc="left") for panel in figure.axes]
    assert tuple(titles) == solution.problem.motion.trajectory.muscles
    for m, panel in enumerate(figure.axes):
        (line,) = panel.get_lines()
        np.testing.assert_array_equal(line.get_ydata(), solution.activation[:, m])
        np.testing.assert_array_equal(line.get_xdata(), solution.problem.motion.trajectory.time)


def test_the_baseline_is_drawn_and_named():
    figure = plot_activations(solution_by_hand(), baseline=solution_by_hand(stability=False, tonus=0.0))
    panel = lines(figure.axes[0])
    assert set(panel) == {"static optimization", "with stability rows"}
    assert panel["static optimization"].get_ydata()[0] == 0.0
    assert panel["with stability rows"].get_ydata()[0] == 0.05
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert set(texts) == set(panel)


def test_frames_that_are_not_solved_are_blank_and_shaded():
    solution = solution_by_hand(n_frames=21, failed=(2, 3, 20))
    for figure in (plot_activations(solution), plot_stability(solution)):
        panel = figure.axes[0]
        curve = lines(panel)["solution" if "solution" in lines(panel) else "with stability rows"]
        assert np.flatnonzero(np.isnan(curve.get_ydata())).tolist() == [2, 3, 20]
        (shade,) = [spans for spans in panel.collections if spans.get_label() == "not solved"]
        # 2 and 3 share one span, 20 has its own; half a frame around them, from the lower to the upper end
        ends = [(path.vertices.min(axis=0), path.vertices.max(axis=0)) for path in shade.get_paths()]
        frame = curve.get_xdata()[1] - curve.get_xdata()[0]
        spans = [[(1.5 * frame, 0), (3.5 * frame, 1)], [(19.5 * frame, 0), (20.5 * frame, 1)]]
        np.testing.assert_allclose(ends, spans)
        assert "not solved" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_required_muscle_and_reserve_moment_are_drawn_with_the_reserve_share():
    solution = solution_by_hand(n_pairs=2)
    figure = plot_moments(solution)
    for c, panel in enumerate(figure.axes):
        drawn = lines(panel)
        required = solution.problem.motion.trajectory.generalized_forces[:, c]
        np.testing.assert_array_equal(drawn["required"].get_ydata(), required)
        np.testing.assert_allclose(drawn["muscles"].get_ydata(), 0.9 * required, atol=1e-12)
        np.testing.assert_allclose(drawn["reserves"].get_ydata(), 0.1 * required, atol=1e-12)
        assert panel.get_title(loc="left") == f"hinge_{c}\nreserves, RMS: 10\u00a0%"
    assert figure.get_supylabel() == "Moment [N·m]"


def test_reserve_shares_of_both_sides_are_told_apart_and_keep_their_unit_on_the_line():
    solution = solution_by_hand(n_pairs=2)
    balance = replace(solution.moment_balance, coordinates=("knee_r", "knee_l"))
    (panel,) = plot_moments(replace(solution, moment_balance=balance)).axes
    lines_of_title = panel.get_title(loc="left").split("\n")
    assert " ".join(lines_of_title) == "knee reserves, RMS: right\u00a010\u00a0%, left\u00a010\u00a0%"


def test_stability_is_drawn_over_the_shade_of_what_is_below_its_level():
    solution = solution_by_hand()
    baseline = observe(solution_by_hand(stability=False, tonus=0.0), solution.problem.constraints[1])
    figure = plot_stability(solution, baseline=baseline)
    (panel,) = figure.axes
    drawn = lines(panel)
    # at level 10 the row is just kept where the moment is zero: frames 0, 2 and 4
    np.testing.assert_allclose(drawn["with stability rows"].get_ydata(), [10, 19, 10, 19, 10], atol=1e-12)
    np.testing.assert_allclose(drawn["static optimization"].get_ydata(), [0, 9, 0, 9, 0], atol=1e-12)
    (shade,) = [patch for patch in panel.patches if patch.get_label() == "unstable: below its level"]
    low, high = panel.get_ylim()
    assert (shade.get_y(), shade.get_y() + shade.get_height()) == (low, 10.0)
    assert low < 0
    assert high > 19


def test_a_level_far_below_is_in_view():
    solution = solution_by_hand(level=-100.0)
    low, _ = plot_stability(solution).axes[0].get_ylim()
    assert low < -100


def test_no_stability_rows_is_an_error_that_says_so():
    with pytest.raises(DataError, match="no stability rows"):
        plot_stability(solution_by_hand(stability=False))


def test_a_baseline_of_another_motion_is_refused():
    with pytest.raises(DataError, match="'baseline' has 6 frames and 'solution' has 5: expected one motion"):
        plot_activations(solution_by_hand(), baseline=solution_by_hand(n_frames=6))
    with pytest.raises(NameMismatchError, match="'baseline' and 'solution' are not of one model"):
        plot_activations(solution_by_hand(), baseline=solution_by_hand(n_pairs=2))
    with pytest.raises(DataError, match="'baseline' has 6 frames and 'solution' has 5: expected one motion"):
        plot_stability(solution_by_hand(), baseline=solution_by_hand(n_frames=6))


def test_the_horizontal_axis_can_be_something_else_than_time():
    axis = HorizontalAxis(values=np.linspace(0, 100, 5), label="Gait cycle [%]")
    figure = plot_activations(solution_by_hand(), horizontal=axis)
    np.testing.assert_array_equal(figure.axes[0].get_lines()[0].get_xdata(), np.linspace(0, 100, 5))
    assert figure.get_supxlabel() == "Gait cycle [%]"
    with pytest.raises(DataError, match="must increase"):
        plot_moments(solution_by_hand(), horizontal=replace(axis, values=[0, 1, 2, 1, 3]))
    with pytest.raises(DataError, match="n_frames"):
        plot_moments(solution_by_hand(), horizontal=replace(axis, values=[0, 1]))


def test_a_clock_that_counts_from_long_ago_starts_at_zero():
    solution = solution_by_hand(21)
    trajectory = replace(
        solution.problem.motion.trajectory, time=solution.problem.motion.trajectory.time + 1667315995.25
    )
    late = replace(
        solution,
        problem=with_motion(solution.problem, trajectory=trajectory),
    )
    figure = plot_activations(late)
    assert figure.get_supxlabel() == "Time since t = 1667315995.250 s [s]"
    assert figure.axes[0].get_xlim()[0] < 1


@pytest.mark.parametrize("n_frames", [1, 2, 200])
@pytest.mark.parametrize("width", [ONE_COLUMN, TWO_COLUMNS])
def test_titles_scales_and_legend_do_not_overlap_with_eighty_muscles(n_frames, width):
    solution = solution_by_hand(n_frames=n_frames, n_pairs=40, name="walking3d")
    figure = plot_activations(solution, muscles="*", width=width)
    assert len(figure.axes) == 80
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    titles = [panel._left_title.get_window_extent(renderer) for panel in figure.axes]
    boxes = [panel.get_window_extent(renderer) for panel in figure.axes]
    legend = figure.legends[0].get_window_extent(renderer)
    page = figure.bbox
    for i, title in enumerate(titles):
        assert page.x0 <= title.x0
        assert title.x1 <= page.x1
        assert not legend.overlaps(boxes[i])
        for j, other in enumerate(titles):
            assert i == j or not title.overlaps(other)
            assert not title.overlaps(boxes[j])


def test_many_muscles_are_drawn_on_pages_the_most_active_first():
    solution = solution_by_hand(21, n_pairs=45)
    first, *others = activation_pages(solution)
    titles = [[panel.get_title(loc="left") for panel in page.axes] for page in (first, *others)]
    muscles = solution.problem.motion.trajectory.muscles
    size = dict(zip(muscles, np.sqrt(np.mean(solution.activation**2, axis=0)), strict=True))
    assert titles[0] == sorted(muscles, key=lambda name: -size[name])[:12]
    assert [name for page in titles[1:] for name in page] == list(muscles)
    assert max(len(page) for page in titles) == 40
    assert len(activation_pages(solution_by_hand(21, n_pairs=6))) == 1


def test_moments_of_which_reserves_carry_little_are_told_in_a_sentence():
    solution = solution_by_hand(21, n_pairs=3)
    balance = solution.moment_balance
    # the third hinge is moved by its reserve alone, the second by its muscles
    share = np.array([0.1, 0.04, 1.0])
    balance = replace(
        balance, muscles=(1 - share) * balance.required, actuators=share * balance.required,
    )  # fmt: skip
    solution = replace(solution, moment_balance=balance)
    figure = plot_moments(solution)
    assert [panel.get_title(loc="left") for panel in figure.axes] == ["hinge_0\nreserves, RMS: 10\u00a0%"]
    told = " ".join(figure.texts[-1].get_text().split())
    assert told.startswith(
        "Reserves carry at most 4 % of the peak moment of hinge_1. Actuators alone move hinge_2"
    )
    everything = plot_moments(solution, coordinates="*")
    assert [panel.get_title(loc="left").split("\n")[0] for panel in everything.axes] == list(
        balance.coordinates
    )


def test_moments_that_muscles_carry_alone_are_drawn_with_the_sentence():
    solution = solution_by_hand(21)
    balance = solution.moment_balance
    balance = replace(balance, muscles=balance.required, actuators=0 * balance.required)
    figure = plot_moments(replace(solution, moment_balance=balance))
    assert len(figure.axes) == 1
    assert "Reserves carry less than 0.1 % of the peak moment of hinge_0" in figure.texts[-1].get_text()


def test_figures_are_made_without_pyplot_and_in_threads():
    before = dict(matplotlib.rcParams)
    errors = []

    def draw():
        try:
            FigureCanvasAgg(plot_moments(solution_by_hand())).draw()
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=draw) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert dict(matplotlib.rcParams) == before
    if "matplotlib.pyplot" in sys.modules:
        assert not sys.modules["matplotlib.pyplot"].get_fignums()


def test_the_moment_balance_adds_up_and_knows_its_unit():
    solution = solution_by_hand(n_pairs=2, failed=(1,))
    balance = solution.moment_balance
    assert balance.unit == ("N·m", "N·m")
    solved = solution.is_solved
    np.testing.assert_allclose(
        (balance.muscles + balance.actuators)[solved], balance.required[solved], atol=1e-12
    )
    assert np.isnan(balance.muscles[1]).all()
    np.testing.assert_allclose(balance.actuator_share, 0.1, rtol=1e-12)


def test_a_coordinate_that_needs_no_moment_has_no_share():
    solution = solution_by_hand()
    balance = replace(solution.moment_balance, required=np.zeros((5, 1)))
    assert np.isnan(balance.actuator_share).all()


def test_stability_of_a_baseline_is_evaluated_at_its_own_forces():
    solution, baseline = solution_by_hand(), solution_by_hand(stability=False, tonus=0.02)
    assert baseline.stability is None
    margin = observe(baseline, solution.problem.constraints[1]).stability
    # two muscles of 20 N at 0.1 N·m/rad per newton where the moment is zero
    assert margin.stability[0, 0] == pytest.approx(4.0)
    assert margin.margin[0, 0] == pytest.approx(-6.0)
    own = solution.stability
    np.testing.assert_array_equal(own.stability, solution.rows["JointStability"].value)
    assert own.is_active[:, 0].tolist() == [True, False, True, False, True]


def test_the_motion_made_by_hand_has_one_hinge_per_pair():
    motion = antagonists(3, n_pairs=2)
    assert motion.n_frames == 3
    assert motion.muscles.n_muscles == 4
    assert motion.actuators.n_actuators == 2
