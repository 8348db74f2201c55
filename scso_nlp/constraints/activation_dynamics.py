"""First-order activation dynamics with excitations as unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from scso_nlp.constraints.constraint import FramePairConstraint
from scso_nlp.transcription.frame import Frame, Rows, VariableSpec

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem

#: How sharply the time constant changes between activation and deactivation [-]. De Groote et al. (2016).
SMOOTHNESS = 0.1


def activation_rate(
    excitation: ca.SX, activation: ca.SX, activation_time_constant: ca.DM, deactivation_time_constant: ca.DM
) -> ca.SX:
    r"""Rate of activation.

    .. math:: \dot a = \left[\frac{f + 1/2}{\tau_a (1/2 + 3a/2)} + \frac{(1/2 + 3a/2)(1/2 - f)}{\tau_d}\right]
              (e - a), \quad f = \tfrac12 \tanh(b(e - a))

    Parameters
    ----------
    excitation, activation : float or DM or SX or MX, any shape [-]
    activation_time_constant, deactivation_time_constant : float or DM, same shape [s]

    Returns
    -------
    float or DM or SX or MX, same shape [1/s]

    References
    ----------
    De Groote et al. (2009), Comput Methods Biomech Biomed Engin 12:563-574; De Groote et al. (2016), Ann
    Biomed Eng 44:2922-2936; OpenSim ``DeGrooteFregly2016Muscle.cpp``, computeStateVariableDerivatives.
    """
    f = 0.5 * ca.tanh(SMOOTHNESS * (excitation - activation))
    z = 0.5 + 1.5 * activation
    rate = (f + 0.5) / (activation_time_constant * z) + z * (0.5 - f) / deactivation_time_constant
    return rate * (excitation - activation)


@dataclass(frozen=True, kw_only=True)
class ActivationDynamics(FramePairConstraint):
    r"""Activation follows excitation by first-order dynamics.   depends on: two frames.

    .. math:: a_{k+1} - a_k = \tfrac{\Delta t}{2} \left(\dot a(e_k, a_k) + \dot a(e_{k+1}, a_{k+1})\right)

    Excitations, between 0 and 1, are unknowns: ``solution.variables["ActivationDynamics.excitation"]``.
    Time constants are the model's. The trapezoidal rule is of second order in the time step.

    References
    ----------
    De Groote et al. (2016), Ann Biomed Eng 44:2922-2936.
    """

    def variables(self, problem: MuscleForceProblem) -> tuple[VariableSpec, ...]:
        """Name the excitations."""
        names = tuple(f"{name}_excitation" for name in problem.muscles.muscles)
        guess = np.clip(0.1, problem.muscles.min_activation, problem.muscles.max_activation)
        return (VariableSpec(name="excitation", labels=names, lower=0.0, upper=1.0, guess=guess),)

    def rows(self, previous: Frame, current: Frame, dt: ca.SX, problem: MuscleForceProblem) -> Rows:
        """One row per muscle: step of activation minus the integrated rate [-]."""
        constants = (
            ca.DM(problem.muscles.activation_time_constant),
            ca.DM(problem.muscles.deactivation_time_constant),
        )
        rates = [
            activation_rate(frame.variables["excitation"], frame.activation, *constants)
            for frame in (previous, current)
        ]
        step = current.activation - previous.activation - 0.5 * dt * (rates[0] + rates[1])
        return Rows(
            value=step, lower=0.0, upper=0.0, names=problem.muscles.muscles, unit="-", scale=1e-2
        )
