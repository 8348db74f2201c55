"""Which coordinates are eliminated, and what follows for the others: linear algebra in closed form."""

import numpy as np
import pytest

from scso_nlp.exceptions import EngineError
from scso_nlp.opensim.worker.elimination import Elimination, choose_dependent

#: u1 = 2 u0 by a coupler, and a loop that binds u2 and u3: u2 + 4 u3 = u0.
CONSTRAINTS = np.array([[2.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 1.0, 4.0]])
COUPLED = np.array([False, True, False, False])


def test_a_loop_gives_up_the_coordinate_that_it_determines_best():
    assert choose_dependent(CONSTRAINTS, COUPLED).tolist() == [False, True, False, True]


def test_a_constraint_that_says_the_same_twice_eliminates_one_coordinate():
    twice = np.vstack([CONSTRAINTS, CONSTRAINTS[1] - 3.0 * CONSTRAINTS[0]])
    assert choose_dependent(twice, COUPLED).sum() == 2


def test_dependent_speeds_follow_the_free_ones():
    elimination = Elimination(np.array([False, True, False, True]))
    assert elimination.free.tolist() == [0, 2]
    coupling = elimination.coupling(CONSTRAINTS, time=0.0)
    # rounding of numbers of size one
    np.testing.assert_allclose(coupling, [[1, 0], [2, 0], [0, 1], [0.25, -0.25]], atol=1e-15)


def test_the_remedy_takes_an_error_away_and_leaves_the_free_coordinates_alone():
    elimination, error = Elimination(np.array([False, True, False, True])), np.array([0.3, -0.7])
    change = np.zeros(4)
    change[elimination.gone] = elimination.remedy(CONSTRAINTS, error)
    np.testing.assert_allclose(error + CONSTRAINTS @ change, 0, atol=1e-15)


def test_a_choice_that_does_not_determine_the_loop_is_refused():
    singular = np.array([[1.0, 1.0, 0.0]])
    with pytest.raises(EngineError, match=r"constraints are singular there"):
        Elimination(np.array([False, False, True])).coupling(singular, time=0.5)
