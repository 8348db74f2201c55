"""First-order activation dynamics with excitations as unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FramePairConstraint
from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.frame import Frame, Rows, VariableSpec
from scso_nlp.motion import Motion

if TYPE_CHECKING:
    from scso_nlp.muscles import MuscleParameters

#: How sharply the time constant changes between activation and deactivation [-]. De Groote et al. (2016) have
#: 0.1; OpenSim 4.6 keeps it as the default of ``activation_dynamics_smoothing`` and recommends 10, with which
#: rise and fall come closer to their time constants.
SMOOTHNESS = 10.0


def activation_rate(
    excitation: ca.SX,
    activation: ca.SX,
    activation_time_constant: ca.DM,
    deactivation_time_constant: ca.DM,
    smoothness: float = SMOOTHNESS,
) -> ca.SX:
    r"""Rate of activation.

    .. math:: \dot a = \left[\frac{f + 1/2}{\tau_a (1/2 + 3a/2)} + \frac{(1/2 + 3a/2)(1/2 - f)}{\tau_d}\right]
              (e - a), \quad f = \tfrac12 \tanh(b(e - a))

    Parameters
    ----------
    excitation, activation : float or DM or SX or MX, any shape [-]
    activation_time_constant, deactivation_time_constant : float or DM, same shape [s]
    smoothness : float [-]
        b.

    Returns
    -------
    float or DM or SX or MX, same shape [1/s]

    References
    ----------
    De Groote et al. (2009), Comput Methods Biomech Biomed Engin 12:563-574; De Groote et al. (2016), Ann
    Biomed Eng 44:2922-2936; OpenSim ``DeGrooteFregly2016Muscle.cpp``, computeStateVariableDerivatives.
    """
    f = 0.5 * ca.tanh(smoothness * (excitation - activation))
    z = 0.5 + 1.5 * activation
    rate = (f + 0.5) / (activation_time_constant * z) + z * (0.5 - f) / deactivation_time_constant
    return rate * (excitation - activation)


def time_constants(muscles: MuscleParameters, term: str) -> tuple[ca.DM, ca.DM]:
    """Time constants of activation and deactivation, columns of shape (n_muscles, 1) [s].

    Parameters
    ----------
    muscles : MuscleParameters
    term : str
        Who asks, for the message.

    Returns
    -------
    DM, DM
        In the model's order.

    Raises
    ------
    DataError
        A muscle whose class has no activation dynamics, or a constant that is not positive.
    """
    for name in ("activation_time_constant", "deactivation_time_constant"):
        values = getattr(muscles, name)
        wrong = np.flatnonzero(values <= 0)
        if wrong.size:
            m = int(wrong[0])
            raise DataError(
                f"{name} of {muscles.muscles[m]!r} ({muscles.muscle_class[m]}) is {values[m]:g} s, "
                f"{term} needs a positive time"
            )
    return ca.DM(muscles.activation_time_constant), ca.DM(muscles.deactivation_time_constant)


@dataclass(frozen=True, kw_only=True)
@checked
class ActivationDynamics(FramePairConstraint):
    r"""Activation follows excitation by first-order dynamics.   depends on: two frames.

    .. math:: a_{k+1} - a_k = \tfrac{\Delta t}{2} \left(\dot a(e_k, a_k) + \dot a(e_{k+1}, a_{k+1})\right)

    Excitations e are unknowns within the model's bounds of control (``min_activation`` and
    ``max_activation``): ``solution.variables["ActivationDynamics.excitation"]``. Time constants are the
    model's.

    Attributes
    ----------
    smoothness : float [-]
        b of :func:`activation_rate`, how sharply the time constant changes between rise and fall.

    Raises
    ------
    DataError
        A time constant that is not positive.
    ProblemError
        A smoothness that is not positive.

    Notes
    -----
    With the source's b = 0.1, the default of OpenSim's muscle, rise and fall are hardly told apart: f stays
    below 0.05, and both go at about the mean of the two rates; OpenSim recommends 10. From b = 100 on the
    rate is that of Thelen (2003), (e - a)/(tau_a z) on the rise and (e - a) z/tau_d on the fall with
    z = 1/2 + 3a/2.

    The trapezoidal rule is of second order in the time step. Nothing costs or damps the excitations
    themselves, and one frame more than there are rows has them: where activations do not touch a bound, the
    excitations of neighbouring frames may alternate about the smooth course. Activations do not.

    Rates of activation that excitations between bounds can reach are not a convex set: at a large smoothness
    the largest is (e_max - a)/(tau_a z), which is convex in activation, and the smallest (e_min - a) z/tau_d,
    which is concave. A motion may therefore have several optima of slightly different effort; the one that is
    found is reported, and :func:`solve_trajectory` may find another from another ``initial_guess``.

    References
    ----------
    De Groote et al. (2016), Ann Biomed Eng 44:2922-2936.

    Examples
    --------
    >>> coupled = replace(problem, constraints=(*problem.constraints, scso.ActivationDynamics()))
    >>> scso.solve_trajectory(coupled).variables["ActivationDynamics.excitation"].shape
    (7, 3)
    """

    smoothness: float = SMOOTHNESS

    def __post_init__(self) -> None:
        if not (np.isfinite(self.smoothness) and self.smoothness > 0):
            raise ProblemError(f"smoothness is {self.smoothness:g}, expected a positive number")

    def variables(self, motion: Motion) -> tuple[VariableSpec, ...]:
        """Name the excitations."""
        names = tuple(f"{name}_excitation" for name in motion.muscles.muscles)
        lower, upper = motion.muscles.min_activation, motion.muscles.max_activation
        guess = np.clip(0.1, lower, upper)
        return (
            VariableSpec(
                name="excitation", labels=names, lower=lower, upper=upper, guess=guess, follows="activation"
            ),
        )

    def rows(self, previous: Frame, current: Frame, dt: ca.SX, motion: Motion) -> Rows:
        """One row per muscle: step of activation minus the integrated rate [-]."""
        constants = time_constants(motion.muscles, self.name)
        rates = [
            activation_rate(frame.variables["excitation"], frame.activation, *constants, self.smoothness)
            for frame in (previous, current)
        ]
        step = current.activation - previous.activation - 0.5 * dt * (rates[0] + rates[1])
        return Rows(value=step, lower=0.0, upper=0.0, names=motion.muscles.muscles, unit="-", scale=1e-2)
