"""Three elbow flexors about one joint: the answer is known in closed form."""

from __future__ import annotations

import numpy as np

from problems.fetch import motion_cache
from scso_nlp import MuscleForceProblem, NoPhysiology, static_optimization
from scso_nlp.examples import example_folder
from scso_nlp.opensim.engine import load_motion
from scso_nlp.validation import FloatArray

#: Moment arm [m] times maximum isometric force [N] of each muscle.
MOMENT_CAPACITY = np.array([0.10 * 1450.0, 0.05 * 1200.0, 0.02 * 1000.0])


def make_problem(exponent: float = 2.0) -> MuscleForceProblem:
    """Describe static optimization of seven load levels.

    Parameters
    ----------
    exponent : float [-]
        Power of the activations, at least 1.

    Returns
    -------
    MuscleForceProblem
    """
    motion = load_motion(example_folder("elbow") / "setup.xml", cache=motion_cache())
    return static_optimization(motion, muscle_model=NoPhysiology(), exponent=exponent)


def closed_form(moment: float, exponent: float = 2.0) -> FloatArray:
    r"""Give the optimum while no activation reaches 1.

    .. math:: a_i = M\, c_i^{1/(p-1)} / \sum_j c_j^{p/(p-1)}

    Parameters
    ----------
    moment : float [N·m]
    exponent : float [-]
        Above 1.

    Returns
    -------
    ndarray, shape (3,) [-]

    References
    ----------
    Lagrange conditions of min sum a^p subject to sum c a = M.
    """
    power = 1 / (exponent - 1)
    return moment * MOMENT_CAPACITY**power / (MOMENT_CAPACITY ** (exponent * power)).sum()
