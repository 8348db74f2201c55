r"""Thelen2003Muscle: exponential curves, a Hill force-velocity curve that depends on activation.

Thelen (2003), J Biomech Eng 125:70-77; formulas and constants as in OpenSim 4.6 ``Thelen2003Muscle.cpp``,
which inverts its force-velocity curve by iteration; here the inverse is closed. Continuous but not smooth:
the passive curve at optimal length (slope 0.0565 beyond), the tendon at slack length (slope 2.1 beyond) and
the force-velocity curve at zero velocity (its slope doubles) have kinks. OpenSim has no rigid-tendon
Thelen2003Muscle except the formula of its static optimization, ``calcInextensibleTendonActiveFiberForce``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import final

import casadi as ca

from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models.curves import CurveParameters, Expression, complete_parameters, require, select
from scso_nlp.muscle_models.hill_muscle import HillCurves, HillMuscle
from scso_nlp.muscle_models.pennation import min_pennated_fiber_length

#: Normalized tendon force where the exponential toe ends [-]. Thelen (2003).
TOE_FORCE = 0.33

#: Exponent of the tendon's toe [-]. Thelen (2003).
TOE_SHAPE = 3.0


@final
class Thelen2003Curves(HillCurves):
    """Curves of Thelen2003Muscle; defaults as in OpenSim's constructProperties [-, the angle rad]."""

    OPENSIM_CLASS = "Thelen2003Muscle"
    DEFAULT_CURVE_PARAMETERS = MappingProxyType(
        {
            "FmaxTendonStrain": 0.04,
            "FmaxMuscleStrain": 0.6,
            "KshapeActive": 0.45,
            "KshapePassive": 5.0,
            "Af": 0.25,
            "Flen": 1.4,
            "fv_linear_extrap_threshold": 0.95,
            "maximum_pennation_angle": math.acos(0.1),
        }
    )
    HAS_ELASTIC_TENDON = True
    FORCE_VELOCITY_DEPENDS_ON_ACTIVATION = True

    def check_curve_parameters(self, muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
        """Refuse also an extrapolation of the force-velocity curve that would start before rest."""
        complete = complete_parameters(muscle, self.OPENSIM_CLASS, parameters, self.DEFAULT_CURVE_PARAMETERS)
        positive = ("FmaxTendonStrain", "FmaxMuscleStrain", "KshapeActive", "KshapePassive", "Af")
        rules = {name: (0.0, math.inf) for name in positive}
        rules |= {"Flen": (1.0, math.inf), "fv_linear_extrap_threshold": (0.0, 1.0)}
        rules |= {"maximum_pennation_angle": (0.0, 0.5 * math.pi + 1e-12)}
        require(muscle, complete, rules)
        threshold, flen = complete["fv_linear_extrap_threshold"], complete["Flen"]
        if threshold * flen <= 1.0:
            raise DataError(
                f"muscle {muscle!r}: fv_linear_extrap_threshold is {threshold:g}, "
                f"must be greater than 1/Flen = {1.0 / flen:g} for a monotone force-velocity curve"
            )
        return complete

    def active_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""One Gaussian, never exactly zero; ``KshapeActive`` is :math:`K_A`.

        .. math:: f_L = e^{-(\tilde\ell - 1)^2 / K_A}

        Thelen (2003); OpenSim calcfal.
        """
        return ca.exp(-((normalized_fiber_length - 1.0) ** 2) / parameters["KshapeActive"])

    def active_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Slope of the Gaussian.

        .. math:: f_L' = -2 (\tilde\ell - 1) f_L / K_A
        """
        return (
            -2.0
            * (normalized_fiber_length - 1.0)
            / parameters["KshapeActive"]
            * self.active_force_length(normalized_fiber_length, parameters)
        )

    def passive_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Exponential from optimal length on, where its slope jumps from 0 to 0.0565 (default parameters).

        .. math:: f_P = \frac{e^{K_P (\tilde\ell - 1)/\epsilon_0^M} - 1}{e^{K_P} - 1} \ (\tilde\ell > 1),
                  \quad 0 \ \text{else}

        1 at a strain of ``FmaxMuscleStrain`` (:math:`\epsilon_0^M`, 0.6), not limited beyond;
        ``KshapePassive`` is :math:`K_P`. Thelen (2003); OpenSim calcfpe.
        """
        shape = parameters["KshapePassive"]
        exponent = shape * (normalized_fiber_length - 1.0) / parameters["FmaxMuscleStrain"]
        return select(normalized_fiber_length > 1.0, (ca.exp(exponent) - 1.0) / (ca.exp(shape) - 1.0), 0.0)

    def passive_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Slope of the exponential; zero at and below optimal length."""
        shape, strain = parameters["KshapePassive"], parameters["FmaxMuscleStrain"]
        exponential = ca.exp(shape * (normalized_fiber_length - 1.0) / strain)
        return select(
            normalized_fiber_length > 1.0, shape / strain * exponential / (ca.exp(shape) - 1.0), 0.0
        )

    def force_velocity(
        self, normalized_fiber_velocity: Expression, parameters: CurveParameters, activation: Expression = 1.0
    ) -> Expression:
        r"""Two hyperbolas and a line, in closed form: the less activated, the slower the muscle.

        .. math::
            w = \frac{\tilde v}{0.25 + 0.75 a}, \quad B = \frac{2 + 2/A_f}{F_{len} - 1}, \quad
            f_V = \begin{cases} 0 & w \le -1 \\ (1 + w)/(1 - w/A_f) & -1 < w \le 0 \\
            (1 + w B F_{len})/(1 + w B) & 0 < w < w_0 \\
            f_0 + (w - w_0)\,/\,\big(1/b + (f_0 - 1) B/b^2\big) & w \ge w_0 \end{cases}

        with :math:`f_0 = \theta F_{len}`, :math:`b = B F_{len} (1 - \theta)`, :math:`w_0 = (f_0 - 1)/b`;
        ``Af``, ``Flen`` and the extrapolation threshold :math:`\theta`, ``fv_linear_extrap_threshold``.

        Notes
        -----
        OpenSim defines the velocity as a function of force and inverts it by Newton's method to 1e-6 in
        velocity; the closed form is its exact inverse and does not depend on fiber length. OpenSim cuts the
        linear extrapolation below zero force off, hence the zero from ``-(0.25 + 0.75 a)`` on. At zero
        velocity the slope doubles. OpenSim's static optimization asks at full activation always.

        References
        ----------
        Thelen (2003), equations 6 and 7. OpenSim calcdlceN, calcfvInv.
        """
        af, flen = parameters["Af"], parameters["Flen"]
        w = normalized_fiber_velocity / (0.25 + 0.75 * activation)
        steep, f0, slope, w0 = _eccentric(parameters)
        concentric = select(w > -1.0, (1.0 + w) / (1.0 - w / af), 0.0)
        eccentric = (1.0 + w * steep * flen) / (1.0 + w * steep)
        return select(w <= 0.0, concentric, select(w < w0, eccentric, f0 + (w - w0) * slope))

    def tendon_force_length(
        self, normalized_tendon_length: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Exponential toe up to a force of 0.33, then a line; 1 at a strain of ``FmaxTendonStrain`` (4 %).

        .. math::
            f_T = \begin{cases} 0 & \epsilon \le 0 \\
            0.33\,(e^{3\epsilon/\epsilon_{toe}} - 1)/(e^3 - 1) & \epsilon \le \epsilon_{toe} \\
            0.33 + k_{lin} (\epsilon - \epsilon_{toe}) & \epsilon > \epsilon_{toe} \end{cases}, \quad
            \epsilon_{toe} = \frac{99\, \epsilon_0 e^3}{166 e^3 - 67}, \quad
            k_{lin} = \frac{0.67}{\epsilon_0 - \epsilon_{toe}}

        OpenSim computes the end of the toe so that the slope is continuous there (0.6086 times
        ``FmaxTendonStrain``) where Thelen (2003) rounds to 0.609 and 1.712. OpenSim calcfse.
        """
        strain = normalized_tendon_length - 1.0
        toe, linear = _tendon_toe(parameters)
        exponential = TOE_FORCE / (math.exp(TOE_SHAPE) - 1.0) * (ca.exp(TOE_SHAPE * strain / toe) - 1.0)
        stretched = select(strain > toe, linear * (strain - toe) + TOE_FORCE, exponential)
        return select(strain > 0.0, stretched, 0.0)

    def inverse_tendon_force_length(
        self, normalized_force: Expression, parameters: CurveParameters
    ) -> Expression:
        r"""Logarithm, then a line; 1 at and below zero force.

        .. math:: \epsilon = \tfrac13 \epsilon_{toe} \ln\big(1 + f (e^3 - 1)/0.33\big) \ (f \le 0.33), \quad
                  \epsilon_{toe} + (f - 0.33)/k_{lin} \ (f > 0.33)
        """
        toe, linear = _tendon_toe(parameters)
        scale = TOE_FORCE / (math.exp(TOE_SHAPE) - 1.0)
        exponential = toe / TOE_SHAPE * ca.log(1.0 + normalized_force / scale)
        stretched = select(
            normalized_force > TOE_FORCE, toe + (normalized_force - TOE_FORCE) / linear, exponential
        )
        return 1.0 + select(normalized_force > 0.0, stretched, 0.0)

    def tendon_slope_at_force(self, normalized_force: Expression, parameters: CurveParameters) -> Expression:
        r"""Affine in force along the toe, then constant.

        .. math:: f_T' = \frac{3}{\epsilon_{toe}} \Big(f + \frac{0.33}{e^3 - 1}\Big) \ (f \le 0.33), \quad
                  k_{lin} \ (f > 0.33)
        """
        toe, linear = _tendon_toe(parameters)
        scale = TOE_FORCE / (math.exp(TOE_SHAPE) - 1.0)
        return select(normalized_force > TOE_FORCE, linear, TOE_SHAPE / toe * (normalized_force + scale))

    def fiber_damping(self, parameters: CurveParameters) -> Expression:
        """Zero: this class has none."""
        return 0.0

    def min_fiber_length(self, muscle: HillMuscle) -> Expression:
        """Length at the largest pennation angle; zero for parallel fibers."""
        return min_pennated_fiber_length(muscle)


def _eccentric(parameters: CurveParameters) -> tuple[Expression, Expression, Expression, Expression]:
    """Steepness B, force and velocity where the linear extrapolation starts, and its slope (in w)."""
    flen, threshold = parameters["Flen"], parameters["fv_linear_extrap_threshold"]
    steep = (2.0 + 2.0 / parameters["Af"]) / (flen - 1.0)
    f0 = threshold * flen
    b = steep * flen * (1.0 - threshold)
    return steep, f0, 1.0 / (1.0 / b + (f0 - 1.0) * steep / b**2), (f0 - 1.0) / b


def _tendon_toe(parameters: CurveParameters) -> tuple[Expression, Expression]:
    """Strain where the toe ends, and the slope beyond."""
    strain, e3 = parameters["FmaxTendonStrain"], math.exp(TOE_SHAPE)
    toe = 99.0 * strain * e3 / (166.0 * e3 - 67.0)
    return toe, 0.67 / (strain - toe)
