"""Stiffness of fiber, tendon and both in series: how much force rises per length.

Short-range stiffness (Cui et al.), and the slope of the force-length curves as OpenSim has it. The laws made
of them are in `stiffness_law`, what a joint makes of those in :mod:`scso_nlp.stability`.
"""

from __future__ import annotations

from scso_nlp.muscle_models.curves import Expression, select
from scso_nlp.muscle_models.hill_muscle import HillMuscle

#: Short-range stiffness of a fiber times optimal length over force [-]. Cui et al. (2008), feline muscle.
SHORT_RANGE_CONSTANT = 23.4


def stiffness_along_tendon(
    fiber_stiffness: Expression,
    fiber_force: Expression,
    fiber_length: Expression,
    cos_pennation_angle: Expression,
) -> Expression:
    r"""Stiffness of a fiber of constant width along the tendon.

    .. math:: k_{AT} = \frac{\partial (F^M \cos\alpha)}{\partial (\ell^M \cos\alpha)}
              = k^M \cos^2\alpha + \frac{F^M}{\ell^M} \sin^2\alpha

    Parameters
    ----------
    fiber_stiffness : float or DM or SX or MX, any shape [N/m]
        Derivative of fiber force by fiber length.
    fiber_force : float or DM or SX or MX, same shape [N]
        Along the fiber.
    fiber_length : float or DM or SX or MX, same shape [m]
        Fiber length.
    cos_pennation_angle : float or DM or SX or MX, same shape [-]
        Cosine of the pennation angle.

    Returns
    -------
    float or DM or SX or MX, same shape [N/m]
        Stiffness along the tendon.

    References
    ----------
    The closed form of OpenSim ``Millard2012EquilibriumMuscle.cpp``, calc_DFiberForceAT_DFiberLengthAT, and
    ``Thelen2003Muscle.cpp``, calcDFmATDlce.
    """
    cos_squared = cos_pennation_angle**2
    return fiber_stiffness * cos_squared + fiber_force / fiber_length * (1.0 - cos_squared)


def in_series(first: Expression, second: Expression) -> Expression:
    r"""Stiffness of two springs in series [N/m]; one may be negative, infinite when they cancel.

    .. math:: k = k_1 k_2/(k_1 + k_2), \quad 0 \ \text{if}\ k_1 k_2 = 0

    OpenSim ``Muscle.cpp``, calcMuscleStiffness.
    """
    total = first + second
    return first * second / select(first * second == 0.0, 1.0, total)


def tendon_stiffness_at_force(muscle: HillMuscle, tendon_force: Expression) -> Expression:
    r"""Tendon stiffness from its force, also for a muscle solved with a rigid tendon.

    .. math:: k_T = \frac{F_0}{\ell_s^T} f_T'\big(f_T^{-1}(F/F_0)\big)

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    tendon_force : float or DM or SX or MX, any shape [N]
        Tension, not negative.

    Returns
    -------
    DM or SX or MX, same shape [N/m]
        Stiffness.

    Notes
    -----
    Affine in force for Thelen2003Muscle (up to a third of F0) and DeGrooteFregly2016Muscle.
    """
    slope = muscle.curves.tendon_slope_at_force(
        tendon_force / muscle.max_isometric_force, muscle.curve_parameters
    )
    return muscle.max_isometric_force / muscle.tendon_slack_length * slope


def short_range_stiffness(
    muscle: HillMuscle,
    tendon_force: Expression,
    fiber_length: Expression,
    cos_pennation_angle: Expression,
    gamma: Expression = SHORT_RANGE_CONSTANT,
    tendon_compliance: Expression = 1.0,
) -> Expression:
    r"""Short-range stiffness, that of the cross-bridges that are attached, of fiber and tendon in series.

    .. math:: k = \Big(\frac1{k_{AT}} + \frac1{k_T(F)}\Big)^{-1}, \quad k^M = \gamma F^M/\ell_0^M, \quad
              F^M = F/\cos\alpha

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    tendon_force : float or DM or SX or MX, any shape [N]
        Tension, not negative.
    fiber_length : float or DM or SX or MX, same shape [m]
        Fiber length.
    cos_pennation_angle : float or DM or SX or MX, same shape [-]
        Cosine of the pennation angle, not zero.
    gamma : float or DM or SX or MX, same shape [-]
        Dimensionless fiber stiffness, 23.4.
    tendon_compliance : float or DM or SX or MX, same shape [-]
        The tendon's stiffness is divided by it; 0 for a rigid tendon.

    Returns
    -------
    DM or SX or MX, same shape [N/m]
        Along the path. Not linear in force, because the tendon stiffens. A class whose tendon is rigid gets
        the fiber's stiffness along the tendon, which is linear in force.

    References
    ----------
    Cui, Perreault, Maas and Sandercock (2008), J Biomech 41:1945-1952.
    """
    # k k_T / (c k + k_T) is k in series with k_T / c
    fiber_force = tendon_force / cos_pennation_angle
    fiber = stiffness_along_tendon(
        gamma * fiber_force / muscle.optimal_fiber_length, fiber_force, fiber_length, cos_pennation_angle
    )
    if not muscle.curves.HAS_ELASTIC_TENDON:
        return fiber
    tendon = tendon_stiffness_at_force(muscle, tendon_force)
    return fiber * tendon / (tendon_compliance * fiber + tendon)


def fiber_stiffness(
    muscle: HillMuscle,
    activation: Expression,
    fiber_length: Expression,
    force_velocity_multiplier: Expression,
) -> Expression:
    r"""Slope of the fiber's force-length curves at constant activation and velocity.

    .. math:: k^M = \frac{F_0}{\ell_0^M} (a f_V f_L' + f_P')

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    activation : float or DM or SX or MX, any shape [-]
        0 to 1.
    fiber_length : float or DM or SX or MX, same shape [m]
        Fiber length.
    force_velocity_multiplier : float or DM or SX or MX, same shape [-]
        1 at zero velocity.

    Returns
    -------
    DM or SX or MX, same shape [N/m]
        Negative on the descending limb.

    References
    ----------
    OpenSim ``Thelen2003Muscle.cpp``, calcDFmDlce; ``Millard2012EquilibriumMuscle.cpp``, calcFiberStiffness;
    ``DeGrooteFregly2016Muscle.h``, calcFiberStiffness.
    """
    curves, shape = muscle.curves, muscle.curve_parameters
    length = fiber_length / muscle.optimal_fiber_length
    slope = activation * force_velocity_multiplier * curves.active_force_length_slope(
        length, shape
    ) + curves.passive_force_length_slope(length, shape)
    return muscle.max_isometric_force / muscle.optimal_fiber_length * slope
