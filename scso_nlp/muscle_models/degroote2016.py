r"""DeGrooteFregly2016Muscle: three Gaussian-like bumps, an inverse hyperbolic sine, two exponentials.

De Groote et al. (2016), Ann Biomed Eng 44:2922-2936. Smooth everywhere in its domain and without clamps.
Formulas as in OpenSim 4.6 ``DeGrooteFregly2016Muscle.h``, whose constants differ from the paper's: passive
strain 0.6 at unit force with zero force at a length of 0.2, tendon through zero force at slack length and
through unit force at a stated strain (4.9 %) where the paper fixes a stiffness of 35. Keep the normalized
fiber length above 0.1495, where one bump's width is zero (only when ``active_force_width_scale`` is 1;
OpenSim's stated domain is 0.2 to 1.8).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import final

import casadi as ca

from scso_nlp.muscle_models.curves import CurveParameters, Expression, complete_parameters, require
from scso_nlp.muscle_models.hill_muscle import HillCurves, HillMuscle

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


@final
class DeGroote2016Curves(HillCurves):
    """Curves of DeGrooteFregly2016Muscle; defaults as in the .cpp file's constructProperties [-]."""

    OPENSIM_CLASS = "DeGrooteFregly2016Muscle"
    DEFAULT_CURVE_PARAMETERS = MappingProxyType(
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

    def check_curve_parameters(self, muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
        """Every parameter must be positive, but damping may be 0 and the switch is 0 or 1."""
        complete = complete_parameters(muscle, self.OPENSIM_CLASS, parameters, self.DEFAULT_CURVE_PARAMETERS)
        rules = {name: (0.0, math.inf) for name in self.DEFAULT_CURVE_PARAMETERS}
        rules |= {"fiber_damping": (-5e-324, math.inf), "ignore_passive_fiber_force": (-5e-324, 1.0 + 1e-12)}
        require(muscle, complete, rules)
        return complete

    def active_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Three bumps: 1 at optimal fiber length, 0.014 at 0.3, 0.031 at 1.8.

        .. math:: f_L = \sum_{i=1}^3 b_{1i}\, e^{-\frac12 (x - b_{2i})^2/(b_{3i} + b_{4i} x)^2}, \quad
                  x = (\tilde\ell - 1)/W + 1

        ``active_force_width_scale`` is W. De Groote et al. (2016); OpenSim calcActiveForceLengthMultiplier.
        """
        x = _scaled_length(normalized_fiber_length, parameters)
        return sum(b1 * ca.exp(-0.5 * ((x - b2) / (b3 + b4 * x)) ** 2) for b1, b2, b3, b4 in ACTIVE_BUMPS)

    def active_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Sum of the bumps' slopes.

        .. math:: f_L' = -\frac1W \sum_i b_{1i}\, e^{-z_i^2/2}\, z_i
                  \frac{b_{3i} + b_{4i} b_{2i}}{(b_{3i} + b_{4i} x)^2}, \quad
                  z_i = \frac{x - b_{2i}}{b_{3i} + b_{4i} x}
        """
        x = _scaled_length(normalized_fiber_length, parameters)
        slope = 0.0
        for b1, b2, b3, b4 in ACTIVE_BUMPS:
            width = b3 + b4 * x
            z = (x - b2) / width
            slope = slope - b1 * ca.exp(-0.5 * z**2) * z * (b3 + b4 * b2) / width**2
        return slope / parameters["active_force_width_scale"]

    def passive_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Exponential: 0 at 0.2, 0.018 at optimal length, 1 at a strain of 0.6 (default).

        .. math:: f_P = \frac{e^{4(\tilde\ell - 1)/\epsilon_0} - o}{e^4 - o}, \quad
                  o = e^{4 (0.2 - 1)/\epsilon_0}

        ``passive_fiber_strain_at_one_norm_force`` is :math:`\epsilon_0`. Not limited: slightly negative below
        0.2. Zero everywhere if the model has ``ignore_passive_fiber_force`` (0 or 1). De Groote et al.
        (2016), without o; OpenSim calcPassiveForceMultiplier.
        """
        strain = parameters["passive_fiber_strain_at_one_norm_force"]
        offset = ca.exp(PASSIVE_SHAPE * (MIN_NORMALIZED_FIBER_LENGTH - 1.0) / strain)
        exponential = ca.exp(PASSIVE_SHAPE * (normalized_fiber_length - 1.0) / strain)
        share = 1.0 - parameters["ignore_passive_fiber_force"]
        return share * (exponential - offset) / (math.exp(PASSIVE_SHAPE) - offset)

    def passive_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Slope of the exponential: positive at any length, zero if passive force is ignored."""
        strain = parameters["passive_fiber_strain_at_one_norm_force"]
        offset = ca.exp(PASSIVE_SHAPE * (MIN_NORMALIZED_FIBER_LENGTH - 1.0) / strain)
        exponential = ca.exp(PASSIVE_SHAPE * (normalized_fiber_length - 1.0) / strain)
        share = 1.0 - parameters["ignore_passive_fiber_force"]
        return share * PASSIVE_SHAPE / strain * exponential / (math.exp(PASSIVE_SHAPE) - offset)

    def force_velocity(
        self, normalized_fiber_velocity: Expression, parameters: CurveParameters, activation: Expression = 1.0
    ) -> Expression:
        r"""Inverse hyperbolic sine: 1.794 at 1, not limited beyond, so negative below -1.

        .. math:: f_V = d_1 \sinh^{-1}(d_2 \tilde v + d_3) + d_4

        De Groote et al. (2016), as a logarithm; OpenSim calcForceVelocityMultiplier.
        """
        d1, d2, d3, d4 = FORCE_VELOCITY
        return d1 * ca.asinh(d2 * normalized_fiber_velocity + d3) + d4

    def tendon_force_length(
        self, normalized_tendon_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Exponential: 1 at a strain of 4.9 % (default), negative down to -0.2 when slack.

        .. math:: f_T = c_1 e^{k_T (\tilde\ell_T - c_2)} - c_3, \quad
                  k_T = \ln\big((1 + c_3)/c_1\big)/(1 + \epsilon_0^T - c_2)

        Not limited, to stay smooth; ``tendon_strain_at_one_norm_force`` is :math:`\epsilon_0^T`. De Groote et
        al. (2016); OpenSim calcTendonForceMultiplier, calcTendonStiffnessParameter.
        """
        c1, c2, c3 = TENDON
        return c1 * ca.exp(_tendon_stiffness(parameters) * (normalized_tendon_length - c2)) - c3

    def inverse_tendon_force_length(
        self, normalized_force: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Logarithm, for forces greater than -0.2.

        .. math:: \tilde\ell_T = c_2 + \ln\big((f + c_3)/c_1\big)/k_T
        """
        c1, c2, c3 = TENDON
        return c2 + ca.log((normalized_force + c3) / c1) / _tendon_stiffness(parameters)

    def tendon_slope_at_force(self, normalized_force: Expression, parameters: CurveParameters) -> Expression:
        r"""Affine in force; 7.31 at zero force (default).

        .. math:: f_T' = k_T (f + c_3)
        """
        return _tendon_stiffness(parameters) * (normalized_force + TENDON[2])

    def fiber_damping(self, parameters: CurveParameters) -> Expression:
        """Parameter ``fiber_damping``."""
        return parameters["fiber_damping"]

    def min_fiber_length(self, muscle: HillMuscle) -> Expression:
        """Lower end of OpenSim's stated domain, 0.2 optimal fiber lengths, which OpenSim does not enforce."""
        return MIN_NORMALIZED_FIBER_LENGTH * muscle.optimal_fiber_length


def _scaled_length(normalized_fiber_length: Expression, parameters: CurveParameters) -> Expression:
    return (normalized_fiber_length - 1.0) / parameters["active_force_width_scale"] + 1.0


def _tendon_stiffness(parameters: CurveParameters) -> Expression:
    c1, c2, c3 = TENDON
    return math.log((1.0 + c3) / c1) / (1.0 + parameters["tendon_strain_at_one_norm_force"] - c2)
