"""What OpenSim makes of the curves and the package reads from OpenSim instead, or does not need.

The capacity of static optimization, fiber velocity from force, and the stiffnesses that OpenSim reports:
OpenSim's tables of them are independent checks of the package's curves and geometry.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
from muscle_models.classes import slope

from scso_nlp.muscle_models import stiffness
from scso_nlp.muscle_models.bezier import bezier_curve, swapped
from scso_nlp.muscle_models.curves import select
from scso_nlp.muscle_models.degroote2016 import FORCE_VELOCITY
from scso_nlp.muscle_models.millard2012 import force_velocity_corners
from scso_nlp.muscle_models.pennation import (
    clamped_pennation_cosine,
    clamped_rigid_tendon_fiber,
    fiber_length_of,
    fiber_width,
    min_pennated_fiber_length,
    rigid_tendon_fiber,
)
from scso_nlp.muscle_models.thelen2003 import _eccentric

#: OpenSim's default ``minimum_activation`` [-].
MIN_ACTIVATION = 0.01

#: Width below which RigidTendonMuscle takes the fibers for parallel [m]. ``SimTK::SqrtEps``.
NO_WIDTH = 1.4901161193847656e-08


# Capacity: calcInextensibleTendonActiveFiberForce ----------------------------------------------------


def optimal_force(muscle, length, velocity, activation=1.0):
    """Active force of a muscle with a rigid tendon as OpenSim's static optimization uses it [N].

    No passive force and no damping. Static optimization asks once, at an activation of 1, and scales the
    answer: the force-velocity curve is that of the fully active muscle at every activation.
    """
    return _OPTIMAL_FORCE[muscle.curves.OPENSIM_CLASS](muscle, length, velocity, activation)


def _thelen(muscle, length, velocity, activation):
    """F0 a fL fV(v, a) cos(alpha), 0 for a fiber at its shortest. ``Thelen2003Muscle.cpp``."""
    curves, shape = muscle.curves, muscle.curve_parameters
    active = ca.fmin(ca.fmax(activation, MIN_ACTIVATION), 1.0)
    fiber = clamped_rigid_tendon_fiber(muscle, length, velocity)
    velocity = fiber.fiber_velocity / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    force = (
        muscle.max_isometric_force
        * active
        * curves.active_force_length(fiber.fiber_length / muscle.optimal_fiber_length, shape)
        * curves.force_velocity(velocity, shape, active)
        * fiber.cos_pennation_angle
    )
    return select(fiber.fiber_length > min_pennated_fiber_length(muscle), force, 0.0)


def _millard(muscle, length, velocity, activation):
    """F0 a fL fV cos(beta), 0 for a fiber at its shortest. ``Millard2012EquilibriumMuscle.cpp``.

    OpenSim takes the pennation angle of the normalized fiber length where it should take the fiber length
    (sin(beta) = h over normalized length), so the cosine is close to 1 and the force too large by up to
    1/cos(alpha): 1.35 for the soleus of gait2392. The velocity uses the right cosine.
    """
    curves, shape = muscle.curves, muscle.curve_parameters
    active = ca.fmin(ca.fmax(activation, MIN_ACTIVATION), 1.0)
    fiber = clamped_rigid_tendon_fiber(muscle, length, velocity)
    normalized_length = fiber.fiber_length / muscle.optimal_fiber_length
    velocity = fiber.fiber_velocity / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    force = (
        muscle.max_isometric_force
        * active
        * curves.active_force_length(normalized_length, shape)
        * curves.force_velocity(velocity, shape)
        * clamped_pennation_cosine(muscle, normalized_length)
    )
    return select(fiber.fiber_length > curves.min_fiber_length(muscle), force, 0.0)


def _de_groote(muscle, length, velocity, activation):
    """F0 a fL fV, without the cosine of the pennation angle. ``DeGrooteFregly2016Muscle.cpp``."""
    curves, shape = muscle.curves, muscle.curve_parameters
    fiber = rigid_tendon_fiber(muscle, length, velocity)
    velocity = fiber.fiber_velocity / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    return (
        muscle.max_isometric_force
        * activation
        * curves.active_force_length(fiber.fiber_length / muscle.optimal_fiber_length, shape)
        * curves.force_velocity(velocity, shape)
    )


def _rigid(muscle, length, velocity, activation):
    """F0 a fL fV cos(alpha), with the velocity of the path for that of the fiber, without the cosine.

    ``RigidTendonMuscle.cpp``, calcMuscleLengthInfo, calcFiberVelocityInfo; ``Muscle.cpp``.
    """
    curves, shape = muscle.curves, muscle.curve_parameters
    along_tendon = length - muscle.tendon_slack_length
    along_tendon = select(along_tendon > 0.0, along_tendon, 0.0)
    width = fiber_width(muscle)
    is_pennate = width > NO_WIDTH
    fiber_length = select(is_pennate, fiber_length_of(along_tendon, width), along_tendon)
    cosine = select(is_pennate, along_tendon / select(is_pennate, fiber_length, 1.0), 1.0)
    velocity = velocity / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    return (
        muscle.max_isometric_force
        * activation
        * curves.active_force_length(fiber_length / muscle.optimal_fiber_length, shape)
        * curves.force_velocity(velocity, shape)
        * cosine
    )


_OPTIMAL_FORCE = {
    "Thelen2003Muscle": _thelen,
    "Millard2012EquilibriumMuscle": _millard,
    "DeGrooteFregly2016Muscle": _de_groote,
    "RigidTendonMuscle": _rigid,
}


# Fiber velocity from force ---------------------------------------------------------------------------


def inverse_force_velocity(curves, multiplier, parameters, activation=1.0):
    """Normalized fiber velocity at a force multiplier, lengthening positive [-].

    OpenSim has no inverse of RigidTendonMuscle's curve.
    """
    return _INVERSE[curves.OPENSIM_CLASS](multiplier, parameters, activation)


def _inverse_thelen(multiplier, parameters, activation):
    """Thelen (2003), equations 6 and 7. ``Thelen2003Muscle.cpp``, calcdlceN.

    Below zero force OpenSim's linear extrapolation (slope 1 + 1/Af in w), which its force-velocity curve
    does not follow.
    """
    af, flen = parameters["Af"], parameters["Flen"]
    steep, f0, slope_in_w, w0 = _eccentric(parameters)
    negative = multiplier * (1.0 + 1.0 / af) - 1.0
    concentric = (multiplier - 1.0) / (1.0 + multiplier / af)
    eccentric = (multiplier - 1.0) / (steep * (flen - multiplier))
    lengthening = select(multiplier < f0, eccentric, w0 + (multiplier - f0) / slope_in_w)
    w = select(multiplier <= 1.0, select(multiplier < 0.0, negative, concentric), lengthening)
    return w * (0.25 + 0.75 * activation)


def _inverse_millard(multiplier, parameters, activation):
    """OpenSim's inverse curve. ``ForceVelocityInverseCurve.cpp``; ``Millard2012EquilibriumMuscle.cpp``.

    It has half the slopes near vmax as end slopes, so it is the exact inverse where the force-velocity curve
    has these end slopes too (no damping); else it differs by up to 0.03 in velocity inside, which OpenSim
    uses as a first guess only, and without bound beyond.
    """
    ends = {
        f"force_velocity_curve.{way}_slope_at_vmax": 0.5
        * parameters[f"force_velocity_curve.{way}_slope_near_vmax"]
        for way in ("concentric", "eccentric")
    }
    return bezier_curve(multiplier, swapped(force_velocity_corners({**parameters, **ends})))


def _inverse_de_groote(multiplier, parameters, activation):
    """The hyperbolic sine."""
    d1, d2, d3, d4 = FORCE_VELOCITY
    return (ca.sinh((multiplier - d4) / d1) - d3) / d2


_INVERSE = {
    "Thelen2003Muscle": _inverse_thelen,
    "Millard2012EquilibriumMuscle": _inverse_millard,
    "DeGrooteFregly2016Muscle": _inverse_de_groote,
}


# Stiffness that OpenSim reports ----------------------------------------------------------------------


class ForceLengthStiffness(NamedTuple):
    """Stiffnesses from the slopes of the curves [N/m]."""

    fiber: object  #: derivative of fiber force by fiber length
    fiber_along_tendon: object  #: the same along the tendon
    tendon: object
    muscle: object  #: fiber along the tendon and tendon in series


def tendon_stiffness_at_length(muscle, tendon_length):
    """F0/ls fT'(lT/ls), with the slope of the tendon curve by automatic differentiation [N/m]."""
    curve = slope(lambda x: muscle.curves.tendon_force_length(x, muscle.curve_parameters))
    stretch = tendon_length / muscle.tendon_slack_length
    return muscle.max_isometric_force / muscle.tendon_slack_length * curve(stretch)


def force_length_stiffness(
    muscle, activation, fiber_length, cos_pennation_angle, tendon_length, normalized_fiber_velocity=0.0
):
    """Stiffness of an elastic muscle from the slopes of its curves, as OpenSim reports it [N/m].

    At static equilibrium `muscle` is the derivative of tendon force by path length at constant activation.
    """
    curves, shape = muscle.curves, muscle.curve_parameters
    length = fiber_length / muscle.optimal_fiber_length
    multiplier = curves.force_velocity(normalized_fiber_velocity, shape, activation)
    fiber_force = muscle.max_isometric_force * (
        activation * curves.active_force_length(length, shape) * multiplier
        + curves.passive_force_length(length, shape)
        + curves.fiber_damping(shape) * normalized_fiber_velocity
    )
    fiber = stiffness.fiber_stiffness(muscle, activation, fiber_length, multiplier)
    along = stiffness.stiffness_along_tendon(fiber, fiber_force, fiber_length, cos_pennation_angle)
    tendon = tendon_stiffness_at_length(muscle, tendon_length)
    return ForceLengthStiffness(fiber, along, tendon, stiffness.in_series(along, tendon))
