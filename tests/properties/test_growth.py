"""Twice the frames, twice the program."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import random_problem

from scso_nlp.transcription.build import build_nlp
from scso_nlp.transcription.describe import describe


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0, np.inf])
def test_nonzeros_of_the_program_grow_exactly_linearly_with_frames(rng, exponent):
    problem = random_problem(rng, n_frames=16, exponent=exponent, reserve=5.0)
    program = describe(problem)
    counts = []
    for n_frames in (1, 2, 4, 8, 16):
        nlp = build_nlp(program, n_frames)
        counts.append(
            [
                nlp.x.numel(),
                nlp.g.numel(),
                nlp.p.numel(),
                nlp.derivatives["jac_g"].nnz_out(1),
                nlp.derivatives["hess_lag"].nnz_out(0),
            ]
        )
    counts = np.array(counts)
    np.testing.assert_array_equal(counts, counts[0] * np.array([[1], [2], [4], [8], [16]]))
