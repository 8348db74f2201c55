r"""Thelen2003Muscle: exponential curves, a Hill force-velocity curve that depends on activation.

Formulas and constants as in OpenSim 4.6 ``Thelen2003Muscle.cpp``, which inverts its force-velocity curve by
iteration; here the inverse is closed. Continuous but not smooth: the passive curve at optimal length (slope
0.0565 beyond), the tendon at slack length (slope 2.1 beyond) and the force-velocity curve at zero velocity
(its slope doubles) have kinks. OpenSim has no rigid-tendon Thelen2003Muscle except the formula its static
optimization uses, :func:`opensim_optimal_force`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import casadi as ca

from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models.curves import CurveParameters, Expression, complete_parameters, require, select
from scso_nlp.muscle_models.hill_muscle import HillMuscle
from scso_nlp.muscle_models.pennation import clamped_rigid_tendon_fiber, min_pennated_fiber_length

#: The OpenSim class whose curves these are.
OPENSIM_CLASS = "Thelen2003Muscle"

#: OpenSim's defaults by property name (``Thelen2003Muscle.cpp``, constructProperties) [-, the angle rad].
DEFAULT_CURVE_PARAMETERS: Mapping[str, float] = MappingProxyType(
    {
        "FmaxTendonStrain": 0.04,
        "FmaxMuscleStrain": 0.6,
        "KshapeActive": 0.45,
        "KshapePassive": 5.0,
        "Af": 0.25,
        "Flen": 1.4,
        "fv_linear_extrap_threshold": 0.95,
        "maximum_pennation_angle": math.acos(0.1),
        "minimum_activation": 0.01,
    }
)

HAS_ELASTIC_TENDON = True
FORCE_VELOCITY_DEPENDS_ON_ACTIVATION = True

#: Normalized tendon force where the exponential toe ends [-]. Thelen (2003).
TOE_FORCE = 0.33

#: Exponent of the tendon's toe [-]. Thelen (2003).
TOE_SHAPE = 3.0


def check_curve_parameters(muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
    """Fill in defaults and refuse curve parameters without a meaning.

    Parameters
    ----------
    muscle : str
        Name, for messages.
    parameters : mapping of str to float [mixed]
        By OpenSim property name.

    Returns
    -------
    dict of str to float [mixed]
        All parameters of the class.

    Raises
    ------
    DataError
        One sentence: unknown name, value out of range, or an extrapolation threshold that would start
        before the isometric point, so that the force-velocity curve would not be monotone.
    """
    complete = complete_parameters(muscle, OPENSIM_CLASS, parameters, DEFAULT_CURVE_PARAMETERS)
    positive = ("FmaxTendonStrain", "FmaxMuscleStrain", "KshapeActive", "KshapePassive", "Af")
    rules = {name: (0.0, math.inf) for name in positive}
    rules |= {"Flen": (1.0, math.inf), "fv_linear_extrap_threshold": (0.0, 1.0)}
    rules |= {"maximum_pennation_angle": (0.0, 0.5 * math.pi + 1e-12), "minimum_activation": (-5e-324, 1.0)}
    require(muscle, complete, rules)
    if complete["fv_linear_extrap_threshold"] * complete["Flen"] <= 1.0:
        raise DataError(
            f"muscle {muscle!r}: fv_linear_extrap_threshold is {complete['fv_linear_extrap_threshold']:g}, "
            f"must be greater than 1/Flen = {1.0 / complete['Flen']:g} for a monotone force-velocity curve"
        )
    return complete


def active_force_length(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Active force over maximum isometric force at zero velocity and full activation.

    .. math:: f_L = e^{-(\tilde\ell - 1)^2 / K_A}

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``KshapeActive``.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        1 at optimal fiber length, never exactly zero.

    References
    ----------
    Thelen (2003), J Biomech Eng 125:70-77. OpenSim ``Thelen2003Muscle.cpp``, calcfal.
    """
    return ca.exp(-((normalized_fiber_length - 1.0) ** 2) / parameters["KshapeActive"])


def active_force_length_slope(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""First derivative of the active force-length curve.

    .. math:: f_L' = -2 (\tilde\ell - 1) f_L / K_A

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``KshapeActive``.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        Positive below optimal length.
    """
    return (
        -2.0
        * (normalized_fiber_length - 1.0)
        / parameters["KshapeActive"]
        * active_force_length(normalized_fiber_length, parameters)
    )


def passive_force_length(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Passive fiber force over maximum isometric force.

    .. math:: f_P = \frac{e^{K_P (\tilde\ell - 1)/\epsilon_0^M} - 1}{e^{K_P} - 1} \ (\tilde\ell > 1), \quad
              0 \ \text{else}

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``KshapePassive`` and ``FmaxMuscleStrain``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        1 at a strain of ``FmaxMuscleStrain`` (0.6), not limited beyond.

    Notes
    -----
    The slope jumps from 0 to 0.0565 (default parameters) at optimal length.

    References
    ----------
    Thelen (2003), J Biomech Eng 125:70-77. OpenSim ``Thelen2003Muscle.cpp``, calcfpe.
    """
    shape = parameters["KshapePassive"]
    exponent = shape * (normalized_fiber_length - 1.0) / parameters["FmaxMuscleStrain"]
    return select(normalized_fiber_length > 1.0, (ca.exp(exponent) - 1.0) / (ca.exp(shape) - 1.0), 0.0)


def passive_force_length_slope(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """First derivative of the passive force-length curve.

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``KshapePassive`` and ``FmaxMuscleStrain``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Zero at and below optimal length.
    """
    shape, strain = parameters["KshapePassive"], parameters["FmaxMuscleStrain"]
    exponential = ca.exp(shape * (normalized_fiber_length - 1.0) / strain)
    return select(normalized_fiber_length > 1.0, shape / strain * exponential / (ca.exp(shape) - 1.0), 0.0)


def force_velocity(
    normalized_fiber_velocity: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    activation: Expression = 1.0,
) -> Expression:
    r"""Force multiplier at a fiber velocity, in closed form.

    .. math::
        w = \frac{\tilde v}{0.25 + 0.75 a}, \quad B = \frac{2 + 2/A_f}{F_{len} - 1}, \quad
        f_V = \begin{cases} 0 & w \le -1 \\ (1 + w)/(1 - w/A_f) & -1 < w \le 0 \\
        (1 + w B F_{len})/(1 + w B) & 0 < w < w_0 \\
        f_0 + (w - w_0)\,/\,\big(1/b + (f_0 - 1) B/b^2\big) & w \ge w_0 \end{cases}

    with :math:`f_0 = \theta F_{len}`, :math:`b = B F_{len} (1 - \theta)`, :math:`w_0 = (f_0 - 1)/b` and the
    extrapolation threshold :math:`\theta`.

    Parameters
    ----------
    normalized_fiber_velocity : float or DM or SX or MX, any shape [-]
        Fiber velocity over the maximum contraction velocity, lengthening positive.
    parameters : mapping of str to float or column [-]
        Uses ``Af``, ``Flen`` and ``fv_linear_extrap_threshold``.
    activation : float or DM or SX or MX, same shape [-]
        The less activated, the slower the muscle; 1 in OpenSim's static optimization.

    Returns
    -------
    DM or SX or MX, same shape [-]
        1 at zero velocity, 0 from ``-(0.25 + 0.75 a)`` on.

    Notes
    -----
    OpenSim defines the velocity as a function of force and inverts it by Newton's method to 1e-6 in
    velocity; the closed form is its exact inverse and does not depend on fiber length. OpenSim cuts the
    linear extrapolation below zero force off, hence the zero. At zero velocity the slope doubles.

    References
    ----------
    Thelen (2003), J Biomech Eng 125:70-77, equations 6 and 7. OpenSim ``Thelen2003Muscle.cpp``, calcdlceN,
    calcfvInv.
    """
    af, flen = parameters["Af"], parameters["Flen"]
    w = normalized_fiber_velocity / (0.25 + 0.75 * activation)
    steep, f0, slope, w0 = _eccentric(parameters)
    concentric = select(w > -1.0, (1.0 + w) / (1.0 - w / af), 0.0)
    eccentric = (1.0 + w * steep * flen) / (1.0 + w * steep)
    return select(w <= 0.0, concentric, select(w < w0, eccentric, f0 + (w - w0) * slope))


def inverse_force_velocity(
    multiplier: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    activation: Expression = 1.0,
) -> Expression:
    r"""Fiber velocity at a force multiplier.

    .. math::
        \tilde v = (0.25 + 0.75 a) \begin{cases} (f-1)/(1 + f/A_f) & 0 \le f \le 1 \\
        (f - 1)/(B (F_{len} - f)) & 1 < f < f_0 \\ \text{linear} & f < 0,\ f \ge f_0 \end{cases}

    Parameters
    ----------
    multiplier : float or DM or SX or MX, any shape [-]
        Force over active isometric force.
    parameters : mapping of str to float or column [-]
        Uses ``Af``, ``Flen`` and ``fv_linear_extrap_threshold``.
    activation : float or DM or SX or MX, same shape [-]
        As in :func:`force_velocity`.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Normalized fiber velocity, lengthening positive.

    Notes
    -----
    Below zero force OpenSim's linear extrapolation (slope 1 + 1/Af in w), which its force-velocity curve
    does not follow.

    References
    ----------
    Thelen (2003), J Biomech Eng 125:70-77, equations 6 and 7. OpenSim ``Thelen2003Muscle.cpp``, calcdlceN.
    """
    af, flen = parameters["Af"], parameters["Flen"]
    steep, f0, slope, w0 = _eccentric(parameters)
    negative = multiplier * (1.0 + 1.0 / af) - 1.0
    concentric = (multiplier - 1.0) / (1.0 + multiplier / af)
    eccentric = (multiplier - 1.0) / (steep * (flen - multiplier))
    lengthening = select(multiplier < f0, eccentric, w0 + (multiplier - f0) / slope)
    w = select(multiplier <= 1.0, select(multiplier < 0.0, negative, concentric), lengthening)
    return w * (0.25 + 0.75 * activation)


def _eccentric(parameters: CurveParameters) -> tuple[Expression, Expression, Expression, Expression]:
    """Steepness B, force and velocity where the linear extrapolation starts, and its slope (in w)."""
    flen, threshold = parameters["Flen"], parameters["fv_linear_extrap_threshold"]
    steep = (2.0 + 2.0 / parameters["Af"]) / (flen - 1.0)
    f0 = threshold * flen
    b = steep * flen * (1.0 - threshold)
    return steep, f0, 1.0 / (1.0 / b + (f0 - 1.0) * steep / b**2), (f0 - 1.0) / b


def tendon_force_length(
    normalized_tendon_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Tendon force over maximum isometric force.

    .. math::
        f_T = \begin{cases} 0 & \epsilon \le 0 \\
        0.33\,(e^{3\epsilon/\epsilon_{toe}} - 1)/(e^3 - 1) & \epsilon \le \epsilon_{toe} \\
        0.33 + k_{lin} (\epsilon - \epsilon_{toe}) & \epsilon > \epsilon_{toe} \end{cases}, \quad
        \epsilon_{toe} = \frac{99\, \epsilon_0 e^3}{166 e^3 - 67}, \quad
        k_{lin} = \frac{0.67}{\epsilon_0 - \epsilon_{toe}}

    Parameters
    ----------
    normalized_tendon_length : float or DM or SX or MX, any shape [-]
        Tendon length over slack length.
    parameters : mapping of str to float or column [-]
        Uses ``FmaxTendonStrain``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        1 at a strain of ``FmaxTendonStrain`` (4 %), 0.33 where the toe ends.

    Notes
    -----
    OpenSim computes the end of the toe so that the slope is continuous there (0.6086 times
    ``FmaxTendonStrain``) where Thelen rounds to 0.609 and 1.712.

    References
    ----------
    Thelen (2003), J Biomech Eng 125:70-77. OpenSim ``Thelen2003Muscle.cpp``, calcfse.
    """
    strain = normalized_tendon_length - 1.0
    toe, linear = _tendon_toe(parameters)
    exponential = TOE_FORCE / (math.exp(TOE_SHAPE) - 1.0) * (ca.exp(TOE_SHAPE * strain / toe) - 1.0)
    stretched = select(strain > toe, linear * (strain - toe) + TOE_FORCE, exponential)
    return select(strain > 0.0, stretched, 0.0)


def tendon_force_length_slope(
    normalized_tendon_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """First derivative of the tendon curve.

    Parameters
    ----------
    normalized_tendon_length : float or DM or SX or MX, any shape [-]
        Tendon length over slack length.
    parameters : mapping of str to float or column [-]
        Uses ``FmaxTendonStrain``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Zero for a slack tendon.
    """
    strain = normalized_tendon_length - 1.0
    toe, linear = _tendon_toe(parameters)
    exponential = TOE_FORCE / (math.exp(TOE_SHAPE) - 1.0) * TOE_SHAPE / toe * ca.exp(TOE_SHAPE * strain / toe)
    return select(strain > 0.0, select(strain > toe, linear, exponential), 0.0)


def inverse_tendon_force_length(
    normalized_force: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Tendon length over slack length at a tendon force.

    .. math:: \epsilon = \tfrac13 \epsilon_{toe} \ln\big(1 + f (e^3 - 1)/0.33\big) \ (f \le 0.33), \quad
              \epsilon_{toe} + (f - 0.33)/k_{lin} \ (f > 0.33)

    Parameters
    ----------
    normalized_force : float or DM or SX or MX, any shape [-]
        Tendon force over maximum isometric force.
    parameters : mapping of str to float or column [-]
        Uses ``FmaxTendonStrain``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        1 at and below zero force.
    """
    toe, linear = _tendon_toe(parameters)
    scale = TOE_FORCE / (math.exp(TOE_SHAPE) - 1.0)
    exponential = toe / TOE_SHAPE * ca.log(1.0 + normalized_force / scale)
    stretched = select(
        normalized_force > TOE_FORCE, toe + (normalized_force - TOE_FORCE) / linear, exponential
    )
    return 1.0 + select(normalized_force > 0.0, stretched, 0.0)


def tendon_slope_at_force(
    normalized_force: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Slope of the tendon curve as a function of tendon force.

    .. math:: f_T' = \frac{3}{\epsilon_{toe}} \Big(f + \frac{0.33}{e^3 - 1}\Big) \ (f \le 0.33), \quad
              k_{lin} \ (f > 0.33)

    Parameters
    ----------
    normalized_force : float or DM or SX or MX, any shape [-]
        Tendon force over maximum isometric force, not negative.
    parameters : mapping of str to float or column [-]
        Uses ``FmaxTendonStrain``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        At zero force the slope of the stretched side.
    """
    toe, linear = _tendon_toe(parameters)
    scale = TOE_FORCE / (math.exp(TOE_SHAPE) - 1.0)
    return select(normalized_force > TOE_FORCE, linear, TOE_SHAPE / toe * (normalized_force + scale))


def _tendon_toe(parameters: CurveParameters) -> tuple[Expression, Expression]:
    """Strain where the toe ends, and the slope beyond."""
    strain, e3 = parameters["FmaxTendonStrain"], math.exp(TOE_SHAPE)
    toe = 99.0 * strain * e3 / (166.0 * e3 - 67.0)
    return toe, 0.67 / (strain - toe)


def fiber_damping(parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS) -> Expression:
    """Damping coefficient of the fiber: this class has none.

    Parameters
    ----------
    parameters : mapping of str to float or column [-]
        Not used.

    Returns
    -------
    float [-]
        Zero.
    """
    return 0.0


def min_fiber_length(muscle: HillMuscle) -> Expression:
    """Shortest fiber OpenSim allows: the one at the largest pennation angle.

    Parameters
    ----------
    muscle : HillMuscle
        Constants.

    Returns
    -------
    float or DM or SX or MX, shape (n_muscles,) [m]
        Zero for parallel fibers.
    """
    return min_pennated_fiber_length(muscle)


def opensim_optimal_force(
    muscle: HillMuscle,
    muscle_tendon_length: Expression,
    muscle_tendon_velocity: Expression,
    activation: Expression = 1.0,
) -> Expression:
    r"""Active force along a rigid tendon as OpenSim's static optimization uses it.

    .. math:: F = F_0\, a f_L(\tilde\ell) f_V(\tilde v, a) \cos\alpha, \quad
              0 \ \text{if}\ \ell^M \le \ell_{min}

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    muscle_tendon_length : float or DM or SX or MX, any shape [m]
        Length of the path.
    muscle_tendon_velocity : float or DM or SX or MX, same shape [m/s]
        Its rate, lengthening positive.
    activation : float or DM or SX or MX, same shape [-]
        Clamped to ``minimum_activation`` ... 1. Static optimization asks once, at 1, and scales the
        answer by activation: the force-velocity curve is that of the fully active muscle at every activation.

    Returns
    -------
    DM or SX or MX, same shape [N]
        No passive force.

    References
    ----------
    OpenSim ``Thelen2003Muscle.cpp``, calcInextensibleTendonActiveFiberForce;
    ``StaticOptimizationTarget.cpp``.
    """
    shape = muscle.curve_parameters
    active = ca.fmin(ca.fmax(activation, shape["minimum_activation"]), 1.0)
    fiber = clamped_rigid_tendon_fiber(muscle, muscle_tendon_length, muscle_tendon_velocity)
    velocity = fiber.fiber_velocity / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    force = (
        muscle.max_isometric_force
        * active
        * active_force_length(fiber.fiber_length / muscle.optimal_fiber_length, shape)
        * force_velocity(velocity, shape, active)
        * fiber.cos_pennation_angle
    )
    return select(fiber.fiber_length > min_pennated_fiber_length(muscle), force, 0.0)
