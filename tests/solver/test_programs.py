"""How frames are weighed before they are given to the solver."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_problem

from scso_nlp.solver.programs import frame_weights
from scso_nlp.transcription.describe import describe


@pytest.mark.parametrize("exponent", [2.0, 3.0])
@pytest.mark.parametrize("guess", [0.0, 1e-5, 1e-3, 0.1])
def test_an_objective_is_near_one_at_the_guess_or_at_a_thousandth_whichever_is_more(rng, exponent, guess):
    """The size of sum a^p is p n a^p; below a = 0.001 it is taken there, so that no weight runs away."""
    program = describe(random_problem(rng, n_frames=2, exponent=exponent))
    found = frame_weights(program, np.full((2, 10), guess))
    np.testing.assert_allclose(found, 1 / (exponent * 10 * max(guess, 1e-3) ** exponent), rtol=1e-12)
