r"""DeGrooteFregly2016Muscle: three Gaussian-like bumps, an inverse hyperbolic sine, two exponentials.

Smooth everywhere in its domain and without clamps. Formulas as in OpenSim 4.6 ``DeGrooteFregly2016Muscle.h``,
whose constants differ from the paper's: passive strain 0.6 at unit force with zero force at a length of 0.2,
tendon through zero force at slack length and through unit force at a stated strain (4.9 %) where the paper
fixes a stiffness of 35. Keep the normalized fiber length above 0.1495, where one bump's width is zero
(only when ``active_force_width_scale`` is 1; OpenSim's stated domain is 0.2 to 1.8).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import casadi as ca

from scso_nlp.muscle_models.curves import CurveParameters, Expression, complete_parameters, require
from scso_nlp.muscle_models.hill_muscle import HillMuscle
from scso_nlp.muscle_models.pennation import rigid_tendon_fiber

#: The OpenSim class whose curves these are.
OPENSIM_CLASS = "DeGrooteFregly2016Muscle"

#: OpenSim's defaults by property name (``DeGrooteFregly2016Muscle.cpp``, constructProperties) [-].
DEFAULT_CURVE_PARAMETERS: Mapping[str, float] = MappingProxyType(
    {
        "active_force_width_scale": 1.0,
        "fiber_damping": 0.0,
        "passive_fiber_strain_at_one_norm_force": 0.6,
        "tendon_strain_at_one_norm_force": 0.049,
        "ignore_passive_fiber_force": 0.0,
    }
)

HAS_ELASTIC_TENDON = True
FORCE_VELOCITY_DEPENDS_ON_ACTIVATION = False

#: b1..b4 of the three bumps of the active curve [-]. OpenSim ``DeGrooteFregly2016Muscle.h``, b11..b43.
ACTIVE_BUMPS = (
    (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
    (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
    (0.1, 1.0, 0.353553390593274, 0.0),
)

#: d1..d4 of the force-velocity curve [-]. OpenSim ``DeGrooteFregly2016Muscle.h``: f(-1) = 0, f(0) = 1.
FORCE_VELOCITY = (-0.3211346127989808, -8.149, -0.374, 0.8825327733249912)

#: Exponent of the passive curve [-]. De Groote et al. (2016); OpenSim kPE.
PASSIVE_SHAPE = 4.0

#: Normalized fiber length of zero passive force and lower end of the domain [-]. m_minNormFiberLength.
MIN_NORMALIZED_FIBER_LENGTH = 0.2

#: c1, c2, c3 of the tendon curve [-]. OpenSim ``DeGrooteFregly2016Muscle.h`` (the paper: 0.2, 0.995, 0.25).
TENDON = (0.2, 1.0, 0.2)


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
        One sentence: unknown name or value out of range.
    """
    complete = complete_parameters(muscle, OPENSIM_CLASS, parameters, DEFAULT_CURVE_PARAMETERS)
    rules = {name: (0.0, math.inf) for name in DEFAULT_CURVE_PARAMETERS}
    rules |= {"fiber_damping": (-5e-324, math.inf), "ignore_passive_fiber_force": (-5e-324, 1.0 + 1e-12)}
    require(muscle, complete, rules)
    return complete


def active_force_length(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Active force over maximum isometric force at zero velocity and full activation.

    .. math:: f_L = \sum_{i=1}^3 b_{1i}\, e^{-\frac12 (x - b_{2i})^2/(b_{3i} + b_{4i} x)^2}, \quad
              x = (\tilde\ell - 1)/W + 1

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``active_force_width_scale`` (W).

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        1 at optimal fiber length, 0.014 at 0.3, 0.031 at 1.8.

    References
    ----------
    De Groote et al. (2016), Ann Biomed Eng 44:2922-2936. OpenSim
    ``DeGrooteFregly2016Muscle.h``, calcActiveForceLengthMultiplier.
    """
    x = _scaled_length(normalized_fiber_length, parameters)
    return sum(b1 * ca.exp(-0.5 * ((x - b2) / (b3 + b4 * x)) ** 2) for b1, b2, b3, b4 in ACTIVE_BUMPS)


def active_force_length_slope(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""First derivative of the active force-length curve.

    .. math:: f_L' = -\frac1W \sum_i b_{1i}\, e^{-z_i^2/2}\, z_i
              \frac{b_{3i} + b_{4i} b_{2i}}{(b_{3i} + b_{4i} x)^2}, \quad
              z_i = \frac{x - b_{2i}}{b_{3i} + b_{4i} x}

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``active_force_width_scale`` (W).

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        Positive on the ascending limb.
    """
    x = _scaled_length(normalized_fiber_length, parameters)
    slope = 0.0
    for b1, b2, b3, b4 in ACTIVE_BUMPS:
        width = b3 + b4 * x
        z = (x - b2) / width
        slope = slope - b1 * ca.exp(-0.5 * z**2) * z * (b3 + b4 * b2) / width**2
    return slope / parameters["active_force_width_scale"]


def _scaled_length(normalized_fiber_length: Expression, parameters: CurveParameters) -> Expression:
    return (normalized_fiber_length - 1.0) / parameters["active_force_width_scale"] + 1.0


def force_velocity(
    normalized_fiber_velocity: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    activation: Expression = 1.0,
) -> Expression:
    r"""Force multiplier at a fiber velocity.

    .. math:: f_V = d_1 \sinh^{-1}(d_2 \tilde v + d_3) + d_4

    Parameters
    ----------
    normalized_fiber_velocity : float or DM or SX or MX, any shape [-]
        Fiber velocity over the maximum contraction velocity, lengthening positive.
    parameters : mapping of str to float or column [-]
        Not used.
    activation : float or DM or SX or MX, same shape [-]
        Not used: one curve for every activation.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        0 at -1, 1 at 0, 1.794 at 1; not limited beyond.

    References
    ----------
    De Groote et al. (2016), Ann Biomed Eng 44:2922-2936 (as a logarithm). OpenSim
    ``DeGrooteFregly2016Muscle.h``, calcForceVelocityMultiplier.
    """
    d1, d2, d3, d4 = FORCE_VELOCITY
    return d1 * ca.asinh(d2 * normalized_fiber_velocity + d3) + d4


def inverse_force_velocity(
    multiplier: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    activation: Expression = 1.0,
) -> Expression:
    r"""Fiber velocity at a force multiplier.

    .. math:: \tilde v = \big(\sinh((f - d_4)/d_1) - d_3\big)/d_2

    Parameters
    ----------
    multiplier : float or DM or SX or MX, any shape [-]
        Force over active isometric force.
    parameters : mapping of str to float or column [-]
        Not used.
    activation : float or DM or SX or MX, same shape [-]
        Not used.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        Normalized fiber velocity, lengthening positive.
    """
    d1, d2, d3, d4 = FORCE_VELOCITY
    return (ca.sinh((multiplier - d4) / d1) - d3) / d2


def passive_force_length(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Passive fiber force over maximum isometric force.

    .. math:: f_P = \frac{e^{4(\tilde\ell - 1)/\epsilon_0} - o}{e^4 - o}, \quad o = e^{4 (0.2 - 1)/\epsilon_0}

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``passive_fiber_strain_at_one_norm_force`` and ``ignore_passive_fiber_force`` (0 or 1).

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        0 at 0.2, 0.018 at optimal length, 1 at a strain of 0.6 (default). Not limited: slightly negative
        below 0.2. Zero everywhere if the model ignores passive fiber force.

    References
    ----------
    De Groote et al. (2016), Ann Biomed Eng 44:2922-2936 (without o). OpenSim
    ``DeGrooteFregly2016Muscle.h``, calcPassiveForceMultiplier.
    """
    strain = parameters["passive_fiber_strain_at_one_norm_force"]
    offset = ca.exp(PASSIVE_SHAPE * (MIN_NORMALIZED_FIBER_LENGTH - 1.0) / strain)
    exponential = ca.exp(PASSIVE_SHAPE * (normalized_fiber_length - 1.0) / strain)
    share = 1.0 - parameters["ignore_passive_fiber_force"]
    return share * (exponential - offset) / (math.exp(PASSIVE_SHAPE) - offset)


def passive_force_length_slope(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """First derivative of the passive force-length curve.

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``passive_fiber_strain_at_one_norm_force`` and ``ignore_passive_fiber_force`` (0 or 1).

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        Positive.
    """
    strain = parameters["passive_fiber_strain_at_one_norm_force"]
    offset = ca.exp(PASSIVE_SHAPE * (MIN_NORMALIZED_FIBER_LENGTH - 1.0) / strain)
    exponential = ca.exp(PASSIVE_SHAPE * (normalized_fiber_length - 1.0) / strain)
    share = 1.0 - parameters["ignore_passive_fiber_force"]
    return share * PASSIVE_SHAPE / strain * exponential / (math.exp(PASSIVE_SHAPE) - offset)


def tendon_force_length(
    normalized_tendon_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Tendon force over maximum isometric force.

    .. math:: f_T = c_1 e^{k_T (\tilde\ell_T - c_2)} - c_3, \quad
              k_T = \ln\big((1 + c_3)/c_1\big)/(1 + \epsilon_0^T - c_2)

    Parameters
    ----------
    normalized_tendon_length : float or DM or SX or MX, any shape [-]
        Tendon length over slack length.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_strain_at_one_norm_force``.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        0 at slack length, 1 at a strain of 4.9 % (default), negative down to -0.2 when slack: not limited,
        to stay smooth.

    References
    ----------
    De Groote et al. (2016), Ann Biomed Eng 44:2922-2936. OpenSim
    ``DeGrooteFregly2016Muscle.h``, calcTendonForceMultiplier, calcTendonStiffnessParameter.
    """
    c1, c2, c3 = TENDON
    return c1 * ca.exp(_tendon_stiffness(parameters) * (normalized_tendon_length - c2)) - c3


def tendon_force_length_slope(
    normalized_tendon_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """First derivative of the tendon curve.

    Parameters
    ----------
    normalized_tendon_length : float or DM or SX or MX, any shape [-]
        Tendon length over slack length.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_strain_at_one_norm_force``.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        Positive.
    """
    c1, c2, _ = TENDON
    stiffness = _tendon_stiffness(parameters)
    return c1 * stiffness * ca.exp(stiffness * (normalized_tendon_length - c2))


def inverse_tendon_force_length(
    normalized_force: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Tendon length over slack length at a tendon force.

    .. math:: \tilde\ell_T = c_2 + \ln\big((f + c_3)/c_1\big)/k_T

    Parameters
    ----------
    normalized_force : float or DM or SX or MX, any shape [-]
        Tendon force over maximum isometric force, greater than -0.2.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_strain_at_one_norm_force``.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        1 at zero force.
    """
    c1, c2, c3 = TENDON
    return c2 + ca.log((normalized_force + c3) / c1) / _tendon_stiffness(parameters)


def tendon_slope_at_force(
    normalized_force: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    r"""Slope of the tendon curve as a function of tendon force.

    .. math:: f_T' = k_T (f + c_3)

    Parameters
    ----------
    normalized_force : float or DM or SX or MX, any shape [-]
        Tendon force over maximum isometric force.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_strain_at_one_norm_force``.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        7.31 at zero force (default).
    """
    return _tendon_stiffness(parameters) * (normalized_force + TENDON[2])


def _tendon_stiffness(parameters: CurveParameters) -> Expression:
    c1, c2, c3 = TENDON
    return math.log((1.0 + c3) / c1) / (1.0 + parameters["tendon_strain_at_one_norm_force"] - c2)


def fiber_damping(parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS) -> Expression:
    """Damping coefficient of the fiber.

    Parameters
    ----------
    parameters : mapping of str to float or column [-]
        Uses ``fiber_damping``.

    Returns
    -------
    float or column [-]
        Force over maximum isometric force per normalized velocity.
    """
    return parameters["fiber_damping"]


def min_fiber_length(muscle: HillMuscle) -> Expression:
    """Lower end of OpenSim's stated domain, 0.2 optimal fiber lengths.

    Parameters
    ----------
    muscle : HillMuscle
        Constants.

    Returns
    -------
    float or DM or SX or MX, shape (n_muscles,) [m]
        OpenSim does not enforce it.
    """
    return MIN_NORMALIZED_FIBER_LENGTH * muscle.optimal_fiber_length


def opensim_optimal_force(
    muscle: HillMuscle,
    muscle_tendon_length: Expression,
    muscle_tendon_velocity: Expression,
    activation: Expression = 1.0,
) -> Expression:
    r"""Active fiber force with a rigid tendon as OpenSim's static optimization uses it.

    .. math:: F = F_0\, a f_L(\tilde\ell) f_V(\tilde v)

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    muscle_tendon_length : float or DM or SX or MX, any shape [m]
        Length of the path.
    muscle_tendon_velocity : float or DM or SX or MX, same shape [m/s]
        Its rate, lengthening positive.
    activation : float or DM or SX or MX, same shape [-]
        Static optimization asks at 1.

    Returns
    -------
    float or DM or SX or MX, same shape [N]
        Force along the fiber: OpenSim does not multiply by the cosine of the pennation angle here. No passive
        force.

    References
    ----------
    OpenSim ``DeGrooteFregly2016Muscle.cpp``, calcInextensibleTendonActiveFiberForce.
    """
    shape = muscle.curve_parameters
    fiber = rigid_tendon_fiber(muscle, muscle_tendon_length, muscle_tendon_velocity)
    velocity = fiber.fiber_velocity / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    return (
        muscle.max_isometric_force
        * activation
        * active_force_length(fiber.fiber_length / muscle.optimal_fiber_length, shape)
        * force_velocity(velocity, shape)
    )
