"""Bounds on how fast activation can rise and fall: the cheap form of activation dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.activation_dynamics import time_constants
from scso_nlp.constraints.constraint import FramePairConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows
from scso_nlp.motion import Motion


@dataclass(frozen=True, kw_only=True)
@checked
class ActivationRate(FramePairConstraint):
    r"""Activation rises and falls no faster than its time constants allow.   depends on: two frames.

    .. math:: \frac{a_\min - \bar a}{\tau_{deact}} \le \frac{a_{k+1} - a_k}{\Delta t}
              \le \frac{a_\max - \bar a}{\tau_{act}}, \quad \bar a = \tfrac12 (a_k + a_{k+1})

    What first-order dynamics with the time constants of the model lets excitations between the muscle's
    bounds do, without excitations as unknowns; the rows are affine.

    Attributes
    ----------
    bounds : "first_order" or "constant"
        ``"first_order"``: as above. ``"constant"``: the looser bounds
        :math:`-(a_\max - a_\min)/\tau_{deact}` and :math:`(a_\max - a_\min)/\tau_{act}`, whatever the
        activation is.

    Raises
    ------
    DataError
        A time constant that is not positive.

    Notes
    -----
    The rate is that of the time step and the activation its mean: the trapezoidal rule.

    References
    ----------
    De Groote et al. (2009), Comput Methods Biomech Biomed Engin 12:563-574.

    Examples
    --------
    >>> coupled = replace(problem, constraints=(*problem.constraints, scso.ActivationRate()))
    >>> scso.solve_trajectory(coupled).rows["ActivationRate"].names[0]
    'brachioradialis rising'
    >>> scso.solve_framewise(coupled)
    Traceback (most recent call last):
    ...
    scso_nlp.exceptions.CouplingError: ActivationRate couples frames, ...
    """

    bounds: Literal["first_order", "constant"] = "first_order"

    def __post_init__(self) -> None:
        if self.bounds not in ("first_order", "constant"):
            raise ProblemError(f"bounds is {self.bounds!r}, expected 'first_order' or 'constant'")

    def rows(self, previous: Frame, current: Frame, dt: ca.SX, motion: Motion) -> Rows:
        """One row per muscle, or two for first-order bounds: rate of activation less its bound [1/s]."""
        muscles = motion.muscles
        rise, fall = time_constants(muscles, self.name)
        low, high = ca.DM(muscles.min_activation), ca.DM(muscles.max_activation)
        rate = (current.activation - previous.activation) / dt
        if self.bounds == "constant":
            span = muscles.max_activation - muscles.min_activation
            return Rows(
                value=rate,
                lower=-span / muscles.deactivation_time_constant,
                upper=span / muscles.activation_time_constant,
                names=muscles.muscles,
                unit="1/s",
                scale=10.0,
            )
        mean = 0.5 * (current.activation + previous.activation)
        n = muscles.n_muscles
        return Rows(
            value=ca.vertcat(rate - (high - mean) / rise, rate - (low - mean) / fall),
            lower=np.repeat([-np.inf, 0.0], n),
            upper=np.repeat([0.0, np.inf], n),
            names=[f"{name} {change}" for change in ("rising", "falling") for name in muscles.muscles],
            unit="1/s",
            scale=10.0,
        )
