"""The heat map of what muscles add to stability rows."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from solution_by_hand import solution_by_hand

from scso_nlp.contributions import row_contributions
from scso_nlp.exceptions import DataError
from scso_nlp.figures import plot_contributions


def test_the_heat_map_shows_the_mean_of_the_solved_frames_of_the_muscles_that_matter():
    solution = solution_by_hand(5, failed=(2,), n_pairs=2)
    shares = row_contributions(solution)
    figure = drawn(plot_contributions(shares, most_muscles=2))
    assert "2 of 4 muscles" in figure.get_suptitle()
    shown = figure.axes[0].collections[0].get_array()
    assert shown.shape == (2, 2)
    kept = [label.get_text() for label in figure.axes[0].get_xticklabels()]
    columns = [shares.muscles.index(name) for name in kept]
    expected = shares.of_muscles[solution.is_solved].mean(axis=0)[:, columns]
    np.testing.assert_allclose(shown, expected)
    # a muscle adds nothing to a joint that it does not cross
    assert shares.of_muscles[0, 0, 2:] == pytest.approx(0)


@pytest.mark.parametrize(
    ("scale", "numbers"), [(2e-5, ("0.035", "-0.025")), (0.02, ("35", "-25"))], ids=["a finger", "a knee"]
)
def test_numbers_have_two_digits_of_the_largest(scale, numbers):
    shares = row_contributions(solution_by_hand(2))
    stiffness = np.zeros_like(shares.stiffness)
    stiffness[:, 0, :2] = 1750.0 * scale, -1250.0 * scale
    figure = drawn(plot_contributions(replace(shares, geometric=0 * stiffness, stiffness=stiffness)))
    assert [text.get_text() for text in figure.axes[0].texts] == list(numbers)


def test_without_a_solved_frame_there_is_nothing_to_show():
    with pytest.raises(DataError, match="no frame is solved"):
        plot_contributions(row_contributions(solution_by_hand(2, failed=(0, 1))))
