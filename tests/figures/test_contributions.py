"""What muscles add to stability rows, and the heat map of it."""

import dataclasses

import numpy as np
import pytest
from drawn import drawn
from solution_by_hand import solution_by_hand

from scso_nlp.exceptions import DataError
from scso_nlp.figures import plot_stability_contributions, stability_contributions


def test_contributions_of_muscles_minus_the_load_add_up_to_the_stability_of_each_row():
    solution = solution_by_hand(5, failed=(2,), n_pairs=2)
    length = np.linalg.norm(np.diff(solution.problem.trajectory.skeleton.path_points[0, 0], axis=0))
    quantities = {"JointStability.muscle_stiffness": 5.0 * solution.tendon_force / length}
    solution = dataclasses.replace(solution, quantities=quantities)
    found = stability_contributions(solution)
    assert found.rows == solution.rows["JointStability"].names
    expected = solution.rows["JointStability"].value[solution.is_solved].mean(axis=0)
    assert found.values.sum(axis=1) - found.external_work == pytest.approx(expected, rel=1e-9)
    # a muscle adds nothing to a joint that it does not cross
    assert found.values[0, 2:] == pytest.approx(0)
    figure = drawn(plot_stability_contributions(found, most_muscles=2))
    assert "2 of 4 muscles" in figure.get_suptitle()
    assert figure.axes[0].images[0].get_array().shape == (2, 2)


def test_contributions_need_stability_rows_and_a_solved_frame():
    with pytest.raises(DataError, match="has no stability rows to split"):
        stability_contributions(solution_by_hand(3, stability=False))
    with pytest.raises(DataError, match="no frame is solved"):
        stability_contributions(solution_by_hand(2, failed=(0, 1)))
