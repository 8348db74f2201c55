r"""Pennation with a fiber of constant width: fiber and tendon as two sides of a parallelogram.

.. math:: h = \ell_0^M \sin\alpha_0, \quad \ell^M \sin\alpha = h, \quad \ell^T = \ell^{MT} - \ell^M \cos\alpha

Source: Scott and Winter (1991), J Biomech 24:163-167; OpenSim ``MuscleFixedWidthPennationModel.cpp``.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from scso_nlp.muscle_models.curves import Expression, select
from scso_nlp.muscle_models.hill_muscle import HillMuscle

#: Machine epsilon; OpenSim takes a smaller pennation angle for none (``SimTK::Eps``) [rad].
NO_PENNATION = 2.220446049250313e-16


class FiberKinematics(NamedTuple):
    """Fiber of a muscle whose tendon has its slack length."""

    fiber_length: Expression  #: [m]
    cos_pennation_angle: Expression  #: [-]
    fiber_velocity: Expression  #: lengthening positive [m/s]


def fiber_width(muscle: HillMuscle) -> Expression:
    r"""Width h of the parallelogram, the same at every fiber length, shape (n_muscles,) [m].

    .. math:: h = \ell_0^M \sin\alpha_0
    """
    return muscle.optimal_fiber_length * ca.sin(muscle.pennation_angle_at_optimal)


def fiber_length_of(fiber_length_along_tendon: Expression, width: Expression) -> Expression:
    r"""Fiber length [m] from its projection q on the tendon [m] and its :func:`fiber_width` h [m].

    .. math:: \ell^M = \sqrt{q^2 + h^2}
    """
    return ca.sqrt(fiber_length_along_tendon**2 + width**2)


def rigid_tendon_fiber(
    muscle: HillMuscle, muscle_tendon_length: Expression, muscle_tendon_velocity: Expression
) -> FiberKinematics:
    r"""Fiber length, pennation and velocity with a tendon of slack length, without clamps.

    .. math:: \ell^M = \sqrt{(\ell^{MT}-\ell_s^T)^2 + h^2}, \quad
              \cos\alpha = (\ell^{MT}-\ell_s^T)/\ell^M, \quad v^M = v^{MT} \cos\alpha

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    muscle_tendon_length : float or DM or SX or MX, any shape [m]
        Length of the path.
    muscle_tendon_velocity : float or DM or SX or MX, same shape [m/s]
        Its rate, lengthening positive.

    Returns
    -------
    FiberKinematics
        Same shape.

    Notes
    -----
    Smooth, so fit for a program whose lengths are unknown. A path shorter than the tendon gives a negative
    cosine, which no muscle has: check lengths first, or use :func:`clamped_rigid_tendon_fiber`.
    """
    along_tendon = muscle_tendon_length - muscle.tendon_slack_length
    fiber_length = fiber_length_of(along_tendon, fiber_width(muscle))
    cos_pennation_angle = along_tendon / fiber_length
    return FiberKinematics(fiber_length, cos_pennation_angle, muscle_tendon_velocity * cos_pennation_angle)


def min_pennated_fiber_length(muscle: HillMuscle) -> Expression:
    r"""Fiber length at the largest pennation angle, shape (n_muscles,) [m]; zero for parallel fibers.

    .. math:: \ell_{min} = h / \sin\alpha_{max}

    The angle is the curve parameter ``maximum_pennation_angle``. OpenSim's m_minimumFiberLength.
    """
    return fiber_width(muscle) / ca.sin(muscle.curve_parameters["maximum_pennation_angle"])


def clamped_pennation_cosine(muscle: HillMuscle, fiber_length: Expression) -> Expression:
    """Cosine of the pennation angle [-] at a fiber length [m]; 1 without pennation.

    The angle stays at its maximum for shorter fibers. OpenSim's calcPennationAngle.
    """
    largest = muscle.curve_parameters["maximum_pennation_angle"]
    regular = fiber_length > min_pennated_fiber_length(muscle)
    sine = fiber_width(muscle) / select(regular, fiber_length, 1.0)
    regular = ca.logic_and(regular, sine < ca.sin(largest))
    cosine = select(regular, ca.sqrt(1.0 - select(regular, sine, 0.0) ** 2), ca.cos(largest))
    return select(muscle.pennation_angle_at_optimal > NO_PENNATION, cosine, 1.0)


def clamped_rigid_tendon_fiber(
    muscle: HillMuscle, muscle_tendon_length: Expression, muscle_tendon_velocity: Expression
) -> FiberKinematics:
    """Fiber length, pennation and velocity with a tendon of slack length and OpenSim's clamps.

    Parameters
    ----------
    muscle, muscle_tendon_length, muscle_tendon_velocity
        As for :func:`rigid_tendon_fiber`.

    Returns
    -------
    FiberKinematics
        Same shape; the fiber is never shorter than :func:`min_pennated_fiber_length`.

    Notes
    -----
    Not smooth where a clamp begins to act: for data, not for unknown lengths.

    References
    ----------
    OpenSim ``MuscleFixedWidthPennationModel.cpp``, calcFiberLength, calcPennationAngle, calcFiberVelocity.
    """
    along_tendon = muscle_tendon_length - muscle.tendon_slack_length
    shortest = min_pennated_fiber_length(muscle)
    is_free = along_tendon >= shortest * ca.cos(muscle.curve_parameters["maximum_pennation_angle"])
    fiber_length = select(is_free, fiber_length_of(along_tendon, fiber_width(muscle)), shortest)
    cos_pennation_angle = clamped_pennation_cosine(muscle, fiber_length)
    return FiberKinematics(fiber_length, cos_pennation_angle, muscle_tendon_velocity * cos_pennation_angle)
