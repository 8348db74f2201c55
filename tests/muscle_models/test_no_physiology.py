"""Force is activation times maximum isometric force."""

from __future__ import annotations

import numpy as np
from helpers import evaluate_terms, random_problem

import scso_nlp as scso


def test_force_is_proportional_to_activation_whatever_the_motion(rng):
    problem = random_problem(rng, muscle_model=scso.NoPhysiology())
    activation = rng.uniform(0, 1, (3, 10))
    force = evaluate_terms(problem, activation)[2]
    np.testing.assert_allclose(force, activation * problem.motion.muscles.max_isometric_force, rtol=1e-15)
