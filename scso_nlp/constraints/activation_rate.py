"""Bounds on how fast activation can rise and fall: the cheap form of activation dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca

from scso_nlp.constraints.constraint import FramePairConstraint
from scso_nlp.transcription.frame import Frame, Rows

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


@dataclass(frozen=True, kw_only=True)
class ActivationRate(FramePairConstraint):
    r"""Activation rises and falls no faster than its time constants allow.   depends on: two frames.

    .. math:: -\frac{1}{\tau_{deact}} \le \frac{a_{k+1} - a_k}{\Delta t} \le \frac{1}{\tau_{act}}

    The bounds are the fastest rates of first-order dynamics between rest and full activation.

    References
    ----------
    De Groote et al. (2009), Comput Methods Biomech Biomed Engin 12:563-574.
    """

    def rows(self, previous: Frame, current: Frame, dt: ca.SX, problem: MuscleForceProblem) -> Rows:
        """One row per muscle: rate of activation [1/s]."""
        muscles = problem.muscles
        return Rows(
            value=(current.activation - previous.activation) / dt,
            lower=-1.0 / muscles.deactivation_time_constant,
            upper=1.0 / muscles.activation_time_constant,
            names=muscles.muscles,
            unit="1/s",
            scale=10.0,
        )
