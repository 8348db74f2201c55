"""The figure of joint reactions shows lengths of forces in body weights."""

import dataclasses

import numpy as np
import pytest
from drawn import drawn
from helpers import with_joint_reactions
from solution_by_hand import solution_by_hand

from scso_nlp.exceptions import NameMismatchError, ProblemError
from scso_nlp.figures import plot_joint_reactions


@pytest.fixture
def solution(rng):
    plain = solution_by_hand(30, failed=(2,))
    problem = with_joint_reactions(plain.problem, rng, ("hip_r", "hip_l", "back"))
    return dataclasses.replace(plain, problem=problem)


def test_both_sides_of_a_joint_are_in_one_panel_in_body_weights(solution):
    figure = drawn(plot_joint_reactions(solution))
    assert len(figure.axes) == 2
    expected = solution.joint_reactions().resultant / 700.0
    expected[2] = np.nan
    shown = [line.get_ydata() for line in figure.axes[0].lines if len(line.get_ydata()) == 30]
    assert len(shown) == 2
    for values in shown:
        assert any(np.allclose(values, expected[:, j], equal_nan=True) for j in range(3))
    assert "BW" in figure.get_supylabel()


def test_a_baseline_is_drawn_behind_and_joints_are_chosen(solution):
    figure = drawn(plot_joint_reactions(solution, baseline=solution, joints="back"))
    assert len(figure.axes) == 1
    assert sum(len(line.get_ydata()) == 30 for line in figure.axes[0].lines) == 2
    with pytest.raises(NameMismatchError, match="bakc"):
        plot_joint_reactions(solution, joints="bakc")


def test_without_joint_reactions_there_is_nothing_to_show():
    with pytest.raises(ProblemError, match="without joint reactions"):
        plot_joint_reactions(solution_by_hand(2))
