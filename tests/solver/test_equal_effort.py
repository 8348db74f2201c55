"""The strength at which a term takes a given effort: closed forms of two antagonists."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, two_antagonists

import scso_nlp as scso


def plain(moment=20.0):
    """Two antagonists of 100 N·m each, static optimization: activations 0.2 and 0, effort 0.04."""
    return dataclasses.replace(
        two_antagonists(moment, strength=2000.0), constraints=(scso.MomentEquilibrium(),)
    )


#: Antagonists at (0.2 + x, x) take (0.2 + x)² + x².
X = 0.1
EFFORT = (0.2 + X) ** 2 + X**2


@pytest.mark.parametrize(
    ("alternative", "strength"),
    [
        (lambda s: scso.ActivationFloor(floor=s), X),
        (lambda s: scso.AntagonistRatio(ratio=s), X / (0.2 + X)),
        # squares of distances from s are least at (s + 0.1, s - 0.1)
        (lambda s: scso.ShiftedEffort(shift=s), X + 0.1),
    ],
)
def test_all_alternatives_at_one_effort_are_the_same_two_activations(alternative, strength):
    found = scso.at_effort(plain(), EFFORT, alternative, strongest=0.5, tolerance=1e-6)
    np.testing.assert_allclose(found.solution.activation[0], [0.2 + X, X], atol=1e-5)
    assert found.strength == pytest.approx(strength, abs=1e-5)
    assert found.effort == pytest.approx(EFFORT, rel=1e-6)


def test_frames_without_an_answer_are_beyond_the_strength_that_is_sought():
    """A floor of 0.9 under both leaves nothing for the moment; 0.1 is found all the same."""
    found = scso.at_effort(plain(), EFFORT, lambda s: scso.ActivationFloor(floor=s), strongest=1.0)
    assert found.strength == pytest.approx(X, abs=1e-3)


def test_an_effort_below_the_least_or_beyond_the_strongest_is_refused():
    with pytest.raises(scso.ProblemError, match=r"expected at least the 0\.04"):
        scso.at_effort(plain(), 0.01, lambda s: scso.ActivationFloor(floor=s))
    with pytest.raises(scso.ProblemError, match=r"at its strongest, 0\.01: raise that"):
        scso.at_effort(plain(), EFFORT, lambda s: scso.ActivationFloor(floor=s), strongest=0.01)
    with pytest.raises(scso.ProblemError, match="frames have no answer"):
        scso.at_effort(plain(), 50.0, lambda s: scso.ActivationFloor(floor=s))


def test_a_ratio_that_is_rather_missed_at_its_price_is_told():
    """At 0.01 per N·m the ratio is missed beyond 0.2, from 0.6 on antagonists do not work for it at all."""

    def soft(ratio):
        return scso.AntagonistRatio(ratio=ratio, soft=0.01)

    with pytest.raises(scso.ProblemError, match=r"takes 0\.04 at its strongest, 0\.95, where it is missed"):
        scso.at_effort(plain(), EFFORT, soft, strongest=0.95)
    found = scso.at_effort(plain(), 0.05, soft, strongest=0.5)
    assert found.strength == pytest.approx(0.1, abs=2e-3)  # (2/90)/(20/90)


def test_effort_needs_a_measure():
    problem = dataclasses.replace(elbow([10.0]), objectives=(scso.ShiftedEffort(),))
    with pytest.raises(scso.ProblemError, match="has 0 ActivationEffort"):
        scso.at_effort(problem, 1.0, lambda s: scso.ActivationFloor(floor=s))
