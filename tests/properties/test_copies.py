"""Problems, motions and solutions are plain data: they pickle, and they copy deeply."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from helpers import random_problem, with_motion

import scso_nlp as scso


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))])
def test_a_copy_of_a_solution_has_its_numbers_and_can_be_solved_again(rng, copied):
    problem = random_problem(rng, reserve=5.0)
    curves = tuple({"strain": 0.04 + 0.001 * m} for m in range(10))
    muscles = dataclasses.replace(problem.motion.muscles, curve_parameters=curves)
    problem = with_motion(problem, muscles=muscles)
    solution = scso.solve_trajectory(problem)
    other = copied(solution)
    np.testing.assert_array_equal(other.activation, solution.activation)
    assert other.frame_status == solution.frame_status
    assert other.problem.motion.muscles.curve_parameters == curves
    with pytest.raises(TypeError):
        other.problem.motion.muscles.curve_parameters[0]["strain"] = 1.0
    again = scso.solve_trajectory(other.problem)
    np.testing.assert_array_equal(again.activation, solution.activation)
    assert other.stability.rows == solution.stability.rows
