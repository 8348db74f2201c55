"""Lines of muscles in space are the paths, colored by activation."""

import numpy as np
import pytest
from drawn import drawn
from matplotlib.collections import LineCollection
from solution_by_hand import antagonists

from scso_nlp.exceptions import DataError
from scso_nlp.figures import plot_muscle_lines


def test_muscle_lines_run_through_the_path_points_and_carry_their_activation():
    skeleton = antagonists(3).trajectory.skeleton
    activation = np.array([[0.1, 0.2], [0.6, 0.3], [0.0, 0.4]])
    figure = drawn(plot_muscle_lines(skeleton, activation, [1], titles=["start"]))
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
        plot_muscle_lines(antagonists(3).trajectory.skeleton, np.zeros((3, 2)), frames, titles=titles)
