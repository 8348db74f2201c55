"""How frames are weighed before they are given to the solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import random_problem

import scso_nlp as scso
from scso_nlp.solver import programs
from scso_nlp.solver.programs import frame_weights
from scso_nlp.transcription.describe import describe


@pytest.mark.parametrize("exponent", [2.0, 3.0])
@pytest.mark.parametrize("guess", [0.0, 1e-5, 1e-3, 0.1])
def test_an_objective_is_near_one_at_the_guess_or_at_a_thousandth_whichever_is_more(rng, exponent, guess):
    """The size of sum a^p is p n a^p; below a = 0.001 it is taken there, so that no weight runs away."""
    program = describe(random_problem(rng, n_frames=2, exponent=exponent))
    found = frame_weights(program, np.full((2, 10), guess))
    np.testing.assert_allclose(found, 1 / (exponent * 10 * max(guess, 1e-3) ** exponent), rtol=1e-12)


def test_frames_that_start_beside_their_optimum_are_confirmed_alone(rng, monkeypatch):
    """They would make all frames of their program take as many steps; the answer stays the same."""
    problem = random_problem(rng, n_frames=9, exponent=3.0)
    expected = scso.solve_trajectory(problem)
    presolve, call, sizes = programs.presolve, programs._Run._call, []

    def beside(*arguments):
        found = presolve(*arguments)
        unknowns, worst = found.unknowns.copy(), found.worst.copy()
        unknowns[4], worst[4] = 0.5 * (unknowns[4] + 0.5), 1e-3
        return replace(found, unknowns=unknowns, worst=worst)

    def calling(run, nlp, solver, frames, *arguments):
        sizes.append(frames.size)
        return call(run, nlp, solver, frames, *arguments)

    monkeypatch.setattr(programs, "presolve", beside)
    monkeypatch.setattr(programs, "_CONFIRMED_UNKNOWNS", 3 * describe(problem).layout.size)
    monkeypatch.setattr(programs._Run, "_call", calling)
    found = scso.solve_trajectory(problem)
    assert sizes == [3, 3, 3, 1, 1, 1]
    np.testing.assert_allclose(found.activation, expected.activation, atol=1e-8)
