"""Which bounds rows of two frames keep by themselves: told from their numbers, for rates of activation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow

import scso_nlp as scso
from scso_nlp.sensitivities.kept_bounds import bounds_kept_by_rows
from scso_nlp.transcription.describe import describe


def program(bounds):
    """Four frames of three muscles and a reserve with bounds on rates."""
    problem = elbow([60.0] * 4, reserve=10.0)
    rate = scso.ActivationRate(bounds=bounds)
    return describe(dataclasses.replace(problem, constraints=(*problem.constraints, rate)))


def test_rates_that_shrink_towards_a_bound_keep_it_and_say_by_which_row():
    lower, upper = bounds_kept_by_rows(program("first_order"), np.ones((4, 4), dtype=bool))
    assert (lower[0] == -1).all()
    assert (upper[0] == -1).all()
    np.testing.assert_array_equal(lower[1:, :3], [[3, 4, 5]] * 3)  # "m falling"
    np.testing.assert_array_equal(upper[1:, :3], [[0, 1, 2]] * 3)  # "m rising"
    assert (lower[:, 3] == -1).all()  # the reserve has no rate


def test_a_muscle_that_has_rested_from_the_first_frame_on_is_held_by_its_bound():
    is_free = np.ones((4, 4), dtype=bool)
    is_free[:2, 1] = False
    lower, _ = bounds_kept_by_rows(program("first_order"), is_free)
    np.testing.assert_array_equal(lower[:, 1], [-1, -1, -1, 4])


@pytest.mark.parametrize("bounds", ["constant", None])
def test_constant_rates_and_no_rates_keep_no_bound(bounds):
    found = describe(elbow([60.0] * 4, reserve=10.0)) if bounds is None else program(bounds)
    assert (bounds_kept_by_rows(found, np.ones((4, 4), dtype=bool)) == -1).all()
