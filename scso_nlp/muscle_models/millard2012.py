r"""Millard2012EquilibriumMuscle: curves made of quintic Bezier corners, straight lines outside.

Millard et al. (2013), J Biomech Eng 135:021005. Corners as in OpenSim 4.6
``SmoothSegmentedFunctionFactory.cpp`` and the curve classes; how a curve is evaluated is in `bezier`.
Parameters are the effective ones, after OpenSim's finalize step has rewritten them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import final

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models.bezier import (
    INVERSE_HALLEY_STEPS,
    Corner,
    bezier_curve,
    corner,
    cube_root_guess,
    swapped,
)
from scso_nlp.muscle_models.curves import CurveParameters, Expression, complete_parameters, require, select
from scso_nlp.muscle_models.hill_muscle import HillCurves, HillMuscle
from scso_nlp.muscle_models.pennation import min_pennated_fiber_length

#: Normalized tendon force below which its stiffness is held constant as a function of force [-]. The toe
#: starts like a cube, so slope over force has an infinite derivative at zero force.
MIN_FORCE_OF_TENDON_SLOPE = 1e-4


@final
class Millard2012Curves(HillCurves):
    """Curves of Millard2012EquilibriumMuscle; parameters of curve objects by their role.

    Defaults are OpenSim's as they are in use with fiber damping (the default) or a rigid tendon: the
    finalize step then sets minimum_value and both force-velocity end slopes to 0. Without damping it leaves
    at least 0.1 and half the slopes near vmax [-, the angle rad].

    References
    ----------
    OpenSim ``Millard2012EquilibriumMuscle.cpp``, constructProperties, extendFinalizeFromProperties; the
    curve classes' constructProperties and ``get...InUse``.
    """

    OPENSIM_CLASS = "Millard2012EquilibriumMuscle"
    DEFAULT_CURVE_PARAMETERS = MappingProxyType(
        {
            "fiber_damping": 0.1,
            "maximum_pennation_angle": math.acos(0.1),
            "active_force_length_curve.min_norm_active_fiber_length": 0.4441,
            "active_force_length_curve.transition_norm_fiber_length": 0.73,
            "active_force_length_curve.max_norm_active_fiber_length": 1.8123,
            "active_force_length_curve.shallow_ascending_slope": 0.8616,
            "active_force_length_curve.minimum_value": 0.0,
            "force_velocity_curve.concentric_slope_at_vmax": 0.0,
            "force_velocity_curve.concentric_slope_near_vmax": 0.25,
            "force_velocity_curve.isometric_slope": 5.0,
            "force_velocity_curve.eccentric_slope_at_vmax": 0.0,
            "force_velocity_curve.eccentric_slope_near_vmax": 0.15,
            "force_velocity_curve.max_eccentric_velocity_force_multiplier": 1.4,
            "force_velocity_curve.concentric_curviness": 0.6,
            "force_velocity_curve.eccentric_curviness": 0.9,
            "fiber_force_length_curve.strain_at_zero_force": 0.0,
            "fiber_force_length_curve.strain_at_one_norm_force": 0.7,
            "fiber_force_length_curve.stiffness_at_low_force": 0.2,
            "fiber_force_length_curve.stiffness_at_one_norm_force": 2.0 / 0.7,
            "fiber_force_length_curve.curviness": 0.75,
            "tendon_force_length_curve.strain_at_one_norm_force": 0.049,
            "tendon_force_length_curve.stiffness_at_one_norm_force": 1.375 / 0.049,
            "tendon_force_length_curve.norm_force_at_toe_end": 2.0 / 3.0,
            "tendon_force_length_curve.curviness": 0.5,
        }
    )
    HAS_ELASTIC_TENDON = True
    FORCE_VELOCITY_DEPENDS_ON_ACTIVATION = False

    def check_curve_parameters(self, muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
        """Refuse also a curve that is not monotone between its nodes."""
        complete = complete_parameters(muscle, self.OPENSIM_CLASS, parameters, self.DEFAULT_CURVE_PARAMETERS)
        require(muscle, complete, _rules(complete))
        for curve, build, directions in (
            ("active_force_length_curve", active_force_length_corners, (1.0, 1.0, 1.0, -1.0, -1.0)),
            ("force_velocity_curve", force_velocity_corners, (1.0,) * 4),
            ("fiber_force_length_curve", passive_force_length_corners, (1.0,) * 2),
            ("tendon_force_length_curve", tendon_force_length_corners, (1.0,) * 2),
        ):
            for number, (c, direction) in enumerate(zip(build(complete), directions, strict=True), start=1):
                x_steps = np.array([float(v) for v in c[1:4]])
                y_steps = direction * np.array([float(v) for v in c[5:8]])
                if (x_steps <= 0.0).any() or (y_steps < -1e-14).any():
                    values = ", ".join(f"{name}={v:g}" for name, v in _of(complete, curve).items())
                    raise DataError(
                        f"muscle {muscle!r}: {curve} is not monotone in its segment {number} with {values}; "
                        "a slope does not fit the points that it joins"
                    )
        return complete

    def active_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Five corners; ``minimum_value`` (0) outside 0.4441 ... 1.8123.

        OpenSim ``ActiveForceLengthCurve``.
        """
        return bezier_curve(normalized_fiber_length, active_force_length_corners(parameters))

    def active_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Slope of the five corners; zero outside the active range."""
        return bezier_curve(normalized_fiber_length, active_force_length_corners(parameters), derivative=1)

    def passive_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Two corners: 0 up to optimal length, 1 at a strain of 0.7 (default), a straight line beyond.

        OpenSim ``FiberForceLengthCurve``.
        """
        return bezier_curve(normalized_fiber_length, passive_force_length_corners(parameters))

    def passive_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Slope of the two corners."""
        return bezier_curve(normalized_fiber_length, passive_force_length_corners(parameters), derivative=1)

    def force_velocity(
        self, normalized_fiber_velocity: Expression, parameters: CurveParameters, activation: Expression = 1.0
    ) -> Expression:
        """Four corners: 0 at -1, 1 at 0, 1.4 at 1 (default). OpenSim ``ForceVelocityCurve``."""
        return bezier_curve(normalized_fiber_velocity, force_velocity_corners(parameters))

    def tendon_force_length(
        self, normalized_tendon_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Two corners, then a line: 0 up to slack length, 1 at a strain of 4.9 % (default).

        OpenSim ``TendonForceLengthCurve``. The slope beyond the toe is 28.06 (default).
        """
        return bezier_curve(normalized_tendon_length, tendon_force_length_corners(parameters))

    def inverse_tendon_force_length(
        self, normalized_force: Expression, parameters: CurveParameters
    ) -> Expression:
        """Mirrored corners; 1 at and below zero force, with an infinite derivative on the stretched side."""
        is_stretched = normalized_force > 0.0
        length = bezier_curve(
            select(is_stretched, normalized_force, 1.0),
            swapped(tendon_force_length_corners(parameters)),
            order=3,
            guess=cube_root_guess,
            steps=INVERSE_HALLEY_STEPS,
        )
        return select(is_stretched, length, 1.0)

    def tendon_slope_at_force(self, normalized_force: Expression, parameters: CurveParameters) -> Expression:
        """Slope at the length of a force; constant below :data:`MIN_FORCE_OF_TENDON_SLOPE`."""
        force = select(
            normalized_force > MIN_FORCE_OF_TENDON_SLOPE, normalized_force, MIN_FORCE_OF_TENDON_SLOPE
        )
        length = self.inverse_tendon_force_length(force, parameters)
        return bezier_curve(length, tendon_force_length_corners(parameters), derivative=1)

    def fiber_damping(self, parameters: CurveParameters) -> Expression:
        """Parameter ``fiber_damping``."""
        return parameters["fiber_damping"]

    def min_fiber_length(self, muscle: HillMuscle) -> Expression:
        """Shortest active length or length at the largest pennation angle, the longer of the two.

        OpenSim ``Millard2012EquilibriumMuscle.cpp``, extendFinalizeFromProperties, m_minimumFiberLength.
        """
        shortest_active = muscle.curve_parameters["active_force_length_curve.min_norm_active_fiber_length"]
        return ca.fmax(shortest_active * muscle.optimal_fiber_length, min_pennated_fiber_length(muscle))


def _of(parameters: CurveParameters, curve: str) -> dict[str, Expression]:
    """Parameters of one curve by their names within it."""
    prefix = curve + "."
    return {key.removeprefix(prefix): v for key, v in parameters.items() if key.startswith(prefix)}


def _rules(complete: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Open intervals of all parameters; `zero` as a lower end lets 0 itself in."""
    inf, zero = math.inf, -5e-324
    curviness = (zero, 1.0 + 1e-12)
    active, velocity, passive = (
        _of(complete, curve)
        for curve in ("active_force_length_curve", "force_velocity_curve", "fiber_force_length_curve")
    )
    rules = {
        "active_force_length_curve": {
            "min_norm_active_fiber_length": (0.0, active["transition_norm_fiber_length"]),
            "transition_norm_fiber_length": (0.0, 0.95),
            "max_norm_active_fiber_length": (1.1, inf),
            "shallow_ascending_slope": (0.0, inf),
            "minimum_value": (zero, 1.0),
        },
        "force_velocity_curve": {
            "concentric_slope_at_vmax": (zero, 1.0),
            "concentric_slope_near_vmax": (velocity["concentric_slope_at_vmax"], 1.0),
            "isometric_slope": (1.0, inf),
            "eccentric_slope_at_vmax": (zero, inf),
            "eccentric_slope_near_vmax": (velocity["eccentric_slope_at_vmax"], inf),
            "max_eccentric_velocity_force_multiplier": (1.0, inf),
            "concentric_curviness": curviness,
            "eccentric_curviness": curviness,
        },
        "fiber_force_length_curve": {
            "strain_at_zero_force": (-1.0, passive["strain_at_one_norm_force"]),
            "stiffness_at_low_force": (0.0, inf),
            "stiffness_at_one_norm_force": (0.0, inf),
            "curviness": curviness,
        },
        "tendon_force_length_curve": {
            "strain_at_one_norm_force": (0.0, inf),
            "stiffness_at_one_norm_force": (0.0, inf),
            "norm_force_at_toe_end": (0.0, 1.0),
            "curviness": curviness,
        },
    }
    return {"fiber_damping": (zero, inf), "maximum_pennation_angle": (0.0, 0.5 * math.pi + 1e-12)} | {
        f"{curve}.{name}": interval for curve, own in rules.items() for name, interval in own.items()
    }


def active_force_length_corners(parameters: CurveParameters) -> tuple[Corner, ...]:
    """Five corners of the active force-length curve, from the shortest to the longest active length.

    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createFiberActiveForceLengthCurve; curviness 1
    (``ActiveForceLengthCurve.cpp``).
    """
    given = _of(parameters, "active_force_length_curve")
    x0, x1 = given["min_norm_active_fiber_length"], given["transition_norm_fiber_length"]
    x3, slope = given["max_norm_active_fiber_length"], given["shallow_ascending_slope"]
    low = given["minimum_value"]
    x2, plateau = 1.0, 0.05
    shallow_end = x2 - plateau
    y1 = 1.0 - slope * (shallow_end - x1)
    steep = (0.5 * (x0 + x1), 0.5 * y1, 1.25 * y1 / (x1 - x0))
    shallow = (x1 + 0.5 * (shallow_end - x1), y1 + 0.5 * (1.0 - y1), slope)
    descending = (
        x2 + plateau + 0.5 * (x3 - x2 - plateau),
        0.5,
        -1.0 / ((x3 - plateau) - (x2 + plateau)),
    )
    nodes = ((x0, low, 0.0), steep, shallow, (x2, 1.0, 0.0), descending, (x3, low, 0.0))
    return tuple(corner(a, b, 1.0) for a, b in itertools.pairwise(nodes))


def force_velocity_corners(parameters: CurveParameters) -> tuple[Corner, ...]:
    """Four corners of the force-velocity curve, from -1 to 1.

    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createFiberforce_velocity_curve.
    """
    given = _of(parameters, "force_velocity_curve")
    last_c, near_c = given["concentric_slope_at_vmax"], given["concentric_slope_near_vmax"]
    last_e, near_e = given["eccentric_slope_at_vmax"], given["eccentric_slope_near_vmax"]
    highest = given["max_eccentric_velocity_force_multiplier"]
    nodes = (
        (-1.0, 0.0, last_c),
        (-0.9, 0.5 * 0.1 * (near_c + last_c), near_c),
        (0.0, 1.0, given["isometric_slope"]),
        (0.9, highest - 0.5 * 0.1 * (near_e + last_e), near_e),
        (1.0, highest, last_e),
    )
    curviness = [given[name] for name in ("concentric_curviness", "eccentric_curviness") for _ in range(2)]
    return tuple(corner(a, b, c) for (a, b), c in zip(itertools.pairwise(nodes), curviness, strict=True))


def passive_force_length_corners(parameters: CurveParameters) -> tuple[Corner, ...]:
    """Two corners of the passive force-length curve, from zero force to unit force.

    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createfiber_force_length_curve.
    """
    given = _of(parameters, "fiber_force_length_curve")
    low, stiffness, curviness = (
        given[name] for name in ("stiffness_at_low_force", "stiffness_at_one_norm_force", "curviness")
    )
    x_zero, x_one = 1.0 + given["strain_at_zero_force"], 1.0 + given["strain_at_one_norm_force"]
    delta = ca.fmin(0.1 / stiffness, 0.1 * (x_one - x_zero))
    x_low = x_zero + delta
    y_low = low * (x_low - (x_zero + 0.5 * delta))
    return (
        corner((x_zero, 0.0, 0.0), (x_low, y_low, low), curviness),
        corner((x_low, y_low, low), (x_one, 1.0, stiffness), curviness),
    )


def tendon_force_length_corners(parameters: CurveParameters) -> tuple[Corner, ...]:
    """Two corners of the tendon curve, from slack length to the end of the toe; a straight line follows.

    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createtendon_force_length_curve.
    """
    given = _of(parameters, "tendon_force_length_curve")
    strain, stiffness = given["strain_at_one_norm_force"], given["stiffness_at_one_norm_force"]
    toe, curviness = given["norm_force_at_toe_end"], given["curviness"]
    x_toe = (toe - 1.0) / stiffness + 1.0 + strain
    x_foot = 1.0 + 0.1 * (x_toe - 1.0)
    y_mid = 0.5 * toe
    x_mid = (y_mid - 1.0) / stiffness + 1.0 + strain
    slope = y_mid / (x_mid - x_foot)
    middle = (x_foot + 0.5 * (x_mid - x_foot), slope * 0.5 * (x_mid - x_foot), slope)
    return (
        corner((1.0, 0.0, 0.0), middle, curviness),
        corner(middle, (x_toe, toe, stiffness), curviness),
    )
