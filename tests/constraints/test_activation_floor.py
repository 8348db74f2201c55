"""A floor under activations: closed form of one joint."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, two_antagonists

import scso_nlp as scso


def with_floor(problem, floor):
    return dataclasses.replace(
        problem, constraints=(scso.MomentEquilibrium(), scso.ActivationFloor(floor=floor))
    )


def test_an_antagonist_stays_on_its_floor_and_the_agonist_makes_up_for_it():
    found = scso.solve_trajectory(with_floor(two_antagonists(20.0, strength=2000.0), 0.1))
    # 0.05 m · 2000 N · (a1 - 0.1) = 20 N·m
    np.testing.assert_allclose(found.activation[0], [0.3, 0.1], atol=1e-8)
    np.testing.assert_allclose(found.rows["ActivationFloor"].value[0], [0.3, 0.1], atol=1e-8)


def test_only_muscles_that_are_named_have_one():
    found = scso.solve_trajectory(with_floor(elbow([50.0]), {"m3": 0.4}))
    assert found.rows["ActivationFloor"].names == ("m3",)
    np.testing.assert_allclose(found.activation[0, 2], 0.4, atol=1e-8)


@pytest.mark.parametrize("floor", [-0.1, 1.1, np.nan, {"m1": 2.0}])
def test_a_floor_that_is_none_is_refused(floor):
    with pytest.raises(scso.ProblemError, match="expected a number from 0 to 1"):
        scso.ActivationFloor(floor=floor)


def test_an_unknown_muscle_is_refused():
    with pytest.raises(scso.NameMismatchError, match="'m9'"):
        scso.solve_trajectory(with_floor(elbow([50.0]), {"m9": 0.4}))
