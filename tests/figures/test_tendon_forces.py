"""Tendon forces of different muscle models beside each other."""

import dataclasses

import numpy as np
import pytest
from drawn import drawn
from solution_by_hand import solution_by_hand

from scso_nlp.exceptions import DataError
from scso_nlp.figures import plot_tendon_forces, tendon_force_difference


def shifted(solution, by):
    return dataclasses.replace(solution, tendon_force=solution.tendon_force + np.asarray(by))


def test_differences_are_taken_muscle_by_muscle_over_frames_that_both_have_solved():
    reference = solution_by_hand(n_frames=5, failed=(1,))
    n = reference.tendon_force.shape[1]
    by = np.zeros((5, n))
    by[0, 0], by[2, 0], by[1, 1] = 3.0, -4.0, 100.0
    difference = tendon_force_difference(shifted(solution_by_hand(n_frames=5), by), reference)
    assert difference.muscles == reference.problem.motion.trajectory.muscles
    np.testing.assert_allclose(difference.largest, [4.0] + [0.0] * (n - 1), atol=1e-9)
    np.testing.assert_allclose(difference.root_mean_square[0], np.sqrt(25 / 4), rtol=1e-9)


def test_every_muscle_has_a_panel_with_one_line_per_solution_and_its_difference():
    rigid = solution_by_hand(n_frames=7, failed=(2,))
    strength = rigid.problem.motion.muscles.max_isometric_force
    figure = plot_tendon_forces({"rigid": rigid, "elastic": shifted(rigid, 0.05 * strength)}, title="walk")
    drawn(figure)
    assert len(figure.axes) == len(strength)
    for m, (name, panel) in enumerate(zip(rigid.problem.motion.trajectory.muscles, figure.axes, strict=True)):
        first, second = panel.get_lines()
        assert (first.get_label(), second.get_label()) == ("rigid", "elastic")
        assert np.flatnonzero(np.isnan(first.get_ydata())).tolist() == [2]
        solved = rigid.is_solved
        np.testing.assert_allclose(first.get_ydata()[solved], rigid.tendon_force[solved, m])
        assert panel.get_title(loc="left") == f"{name}\nup to 5.0 % of F0 apart"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["rigid", "elastic"]


def test_one_solution_alone_has_nothing_to_differ_from():
    solution = solution_by_hand()
    panel = plot_tendon_forces({"rigid": solution}).axes[0]
    assert panel.get_title(loc="left") == solution.problem.motion.trajectory.muscles[0]


def test_solutions_of_other_motions_are_refused():
    with pytest.raises(DataError, match="'b' has 6 frames and 'a' has 5: expected one motion"):
        plot_tendon_forces({"a": solution_by_hand(n_frames=5), "b": solution_by_hand(n_frames=6)})
    with pytest.raises(DataError, match="no solution to draw"):
        plot_tendon_forces({})
    with pytest.raises(DataError, match="no frame is solved in both"):
        tendon_force_difference(
            solution_by_hand(n_frames=2, failed=(0,)), solution_by_hand(n_frames=2, failed=(1,))
        )
