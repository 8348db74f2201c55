r"""Millard2012EquilibriumMuscle: curves made of quintic Bezier corners, straight lines outside.

A point of such a curve needs the root of a quintic, x(u) = x. Here the root comes from three Halley steps, is
rounded so that automatic differentiation does not see it, and the curve is continued from there by its exact
Taylor polynomial: value, gradient and Hessian are exact to rounding, also with respect to the shape
parameters, at the price of the value alone. ``order=3`` adds the third derivative.
Formulas as in OpenSim 4.6 ``SmoothSegmentedFunctionFactory.cpp``, ``SegmentedQuinticBezierToolkit.cpp`` and
the curve classes; parameters are the effective ones, after OpenSim's finalize step has rewritten them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models.curves import CurveParameters, Expression, complete_parameters, require, select
from scso_nlp.muscle_models.hill_muscle import HillMuscle
from scso_nlp.muscle_models.pennation import (
    clamped_pennation_cosine,
    clamped_rigid_tendon_fiber,
    min_pennated_fiber_length,
)

#: The OpenSim class whose curves these are.
OPENSIM_CLASS = "Millard2012EquilibriumMuscle"

#: OpenSim's defaults by property name (curve objects by their role), as they are in use with fiber damping
#: (the default) or a rigid tendon: the finalize step then sets minimum_value and both force-velocity end
#: slopes to 0. Without damping it leaves at least 0.1 and half the slopes near vmax [-, the angle rad].
#: ``Millard2012EquilibriumMuscle.cpp``, constructProperties, extendFinalizeFromProperties; the curve classes'
#: constructProperties and ``get...InUse``.
DEFAULT_CURVE_PARAMETERS: Mapping[str, float] = MappingProxyType(
    {
        "fiber_damping": 0.1,
        "maximum_pennation_angle": math.acos(0.1),
        "minimum_activation": 0.01,
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

#: Halley steps from the cubic guess. They bring every curve of OpenSim's models to x(u) - x < 1e-12, and the
#: Taylor step makes the value exact to the third power of what is left.
HALLEY_STEPS = 3

#: The same from the cube-root guess of the tendon's inverse, whose toe starts with a triple root.
INVERSE_HALLEY_STEPS = 4

#: Roots are rounded to this many per unit, which has no derivative [-].
ROUNDING = 2.0**50

#: Normalized tendon force below which its stiffness is held constant as a function of force [-]. The toe
#: starts like a cube, so slope over force has an infinite derivative at zero force.
MIN_FORCE_OF_TENDON_SLOPE = 1e-4


class Corner(NamedTuple):
    """A quintic Bezier segment with doubled inner control points, as its first point and three differences.

    Control points P0, Pm, Pm, Pn, Pn, P1 with d0 = Pm - P0, dm = Pn - Pm, d1 = P1 - Pn.
    """

    x: Expression
    x_d0: Expression
    x_dm: Expression
    x_d1: Expression
    y: Expression
    y_d0: Expression
    y_dm: Expression
    y_d1: Expression


def corner(
    start: tuple[Expression, Expression, Expression],
    end: tuple[Expression, Expression, Expression],
    curviness: Expression,
) -> Corner:
    r"""Bezier segment between two points with given slopes.

    .. math:: x_C = \frac{y_1 - y_0 - x_1 d_1 + x_0 d_0}{d_0 - d_1}, \quad
              y_C = (x_C - x_1) d_1 + y_1, \quad P_m = P_0 + c (P_C - P_0), \quad
              P_n = P_1 + c (P_C - P_1), \quad c = 0.1 + 0.8\,\mathrm{curviness}

    Parameters
    ----------
    start, end : tuple of three float or column [-]
        x, y and slope.
    curviness : float or column [-]
        0 (nearly straight) to 1 (nearly the two lines).

    Returns
    -------
    Corner
        The control points.

    References
    ----------
    Millard et al. (2013), J Biomech Eng 135:021005. OpenSim ``SegmentedQuinticBezierToolkit.cpp``,
    calcQuinticBezierCornerControlPoints; ``SmoothSegmentedFunctionFactory.cpp``, scaleCurviness.
    """
    x0, y0, slope0 = start
    x1, y1, slope1 = end
    difference = slope0 - slope1
    is_straight = ca.fabs(difference) <= 1.4901161193847656e-08
    x_corner = select(
        is_straight,
        0.5 * (x0 + x1),
        (y1 - y0 - x1 * slope1 + x0 * slope0) / select(is_straight, 1.0, difference),
    )
    c = 0.1 + 0.8 * curviness
    x_d0, x_d1 = c * (x_corner - x0), c * (x1 - x_corner)
    # along the tangents, so that a flat end is flat to the last bit
    y_d0, y_d1 = slope0 * x_d0, slope1 * x_d1
    return Corner(x0, x_d0, x1 - x0 - x_d0 - x_d1, x_d1, y0, y_d0, y1 - y0 - y_d0 - y_d1, y_d1)


def swapped(corners: tuple[Corner, ...]) -> tuple[Corner, ...]:
    """Exchange x and y: the inverse of a rising curve.

    Parameters
    ----------
    corners : tuple of Corner
        A curve.

    Returns
    -------
    tuple of Corner
        Its mirror image.
    """
    return tuple(Corner(*c[4:], *c[:4]) for c in corners)


def active_force_length_corners(parameters: CurveParameters) -> tuple[Corner, ...]:
    """Five corners of the active force-length curve.

    Parameters
    ----------
    parameters : mapping of str to float or column [-]
        Uses ``active_force_length_curve...``.

    Returns
    -------
    tuple of Corner
        From the shortest to the longest active length.

    References
    ----------
    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createFiberActiveForceLengthCurve; curviness 1
    (``ActiveForceLengthCurve.cpp``).
    """
    x0, x1, x3, slope, low = (
        parameters["active_force_length_curve." + name]
        for name in (
            "min_norm_active_fiber_length",
            "transition_norm_fiber_length",
            "max_norm_active_fiber_length",
            "shallow_ascending_slope",
            "minimum_value",
        )
    )
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


def force_velocity_corners(
    parameters: CurveParameters, slopes_at_vmax: tuple[Expression, Expression] | None = None
) -> tuple[Corner, ...]:
    """Four corners of the force-velocity curve.

    Parameters
    ----------
    parameters : mapping of str to float or column [-]
        Uses ``force_velocity_curve...``.
    slopes_at_vmax : tuple of two float or column, optional [-]
        Concentric and eccentric slopes instead of those among the parameters, for the inverse curve.

    Returns
    -------
    tuple of Corner
        From -1 to 1.

    References
    ----------
    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createFiberforce_velocity_curve.
    """
    near_c, isometric, near_e, highest, curved_c, curved_e = (
        parameters["force_velocity_curve." + name]
        for name in (
            "concentric_slope_near_vmax",
            "isometric_slope",
            "eccentric_slope_near_vmax",
            "max_eccentric_velocity_force_multiplier",
            "concentric_curviness",
            "eccentric_curviness",
        )
    )
    if slopes_at_vmax is None:
        slopes_at_vmax = (
            parameters["force_velocity_curve.concentric_slope_at_vmax"],
            parameters["force_velocity_curve.eccentric_slope_at_vmax"],
        )
    last_c, last_e = slopes_at_vmax
    nodes = (
        (-1.0, 0.0, last_c),
        (-0.9, 0.5 * 0.1 * (near_c + last_c), near_c),
        (0.0, 1.0, isometric),
        (0.9, highest - 0.5 * 0.1 * (near_e + last_e), near_e),
        (1.0, highest, last_e),
    )
    curviness = (curved_c, curved_c, curved_e, curved_e)
    return tuple(corner(a, b, c) for (a, b), c in zip(itertools.pairwise(nodes), curviness, strict=True))


def passive_force_length_corners(parameters: CurveParameters) -> tuple[Corner, ...]:
    """Two corners of the passive force-length curve.

    Parameters
    ----------
    parameters : mapping of str to float or column [-]
        Uses ``fiber_force_length_curve...``.

    Returns
    -------
    tuple of Corner
        From zero force to unit force.

    References
    ----------
    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createfiber_force_length_curve.
    """
    zero, one, low, stiffness, curviness = (
        parameters["fiber_force_length_curve." + name]
        for name in (
            "strain_at_zero_force",
            "strain_at_one_norm_force",
            "stiffness_at_low_force",
            "stiffness_at_one_norm_force",
            "curviness",
        )
    )
    x_zero, x_one = 1.0 + zero, 1.0 + one
    delta = ca.fmin(0.1 / stiffness, 0.1 * (x_one - x_zero))
    x_low = x_zero + delta
    y_low = low * (x_low - (x_zero + 0.5 * delta))
    return (
        corner((x_zero, 0.0, 0.0), (x_low, y_low, low), curviness),
        corner((x_low, y_low, low), (x_one, 1.0, stiffness), curviness),
    )


def tendon_force_length_corners(parameters: CurveParameters) -> tuple[Corner, ...]:
    """Two corners of the tendon curve.

    Parameters
    ----------
    parameters : mapping of str to float or column [-]
        Uses ``tendon_force_length_curve...``.

    Returns
    -------
    tuple of Corner
        From slack length to the end of the toe; a straight line follows.

    References
    ----------
    OpenSim ``SmoothSegmentedFunctionFactory.cpp``, createtendon_force_length_curve.
    """
    strain, stiffness, toe, curviness = (
        parameters["tendon_force_length_curve." + name]
        for name in (
            "strain_at_one_norm_force",
            "stiffness_at_one_norm_force",
            "norm_force_at_toe_end",
            "curviness",
        )
    )
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


def _cubic_guess(c: Corner, part: Expression) -> Expression:
    """Cubic Hermite polynomial through both ends with the root's end slopes (at most 3)."""
    length = c.x_d0 + c.x_dm + c.x_d1
    s0, s1 = (ca.fmin(length / (5.0 * d), 3.0) for d in (c.x_d0, c.x_d1))
    return part * (s0 + part * (3.0 - 2.0 * s0 - s1 + part * (s0 + s1 - 2.0)))


def _cube_root_guess(c: Corner, part: Expression) -> Expression:
    """Guess for a segment that may start with a triple root (d0 = 0)."""
    length = c.x_d0 + c.x_dm + c.x_d1
    root = (0.1 * length / c.x_dm) ** (1.0 / 3.0)
    cubic = ca.fmin(root + (1.0 - root) * part, 1.0) * part ** (1.0 / 3.0)
    return select(c.x_d0 <= 1e-12 * length, cubic, _cubic_guess(c, part))


def _weights(u: Expression) -> tuple[tuple[Expression, ...], ...]:
    """Weigh the three differences of a corner at u, for a coordinate and its three derivatives.

    The Bernstein sum with doubled control points in powers of u and v = 1 - u:
    1 - v^5, u^3 (10 - 15 u + 6 u^2), u^5.
    """
    v = 1.0 - u
    u2, v2, uv = u * u, v * v, u * v
    u3, v3, u4, v4 = u2 * u, v2 * v, u2 * u2, v2 * v2
    return (
        (1.0 - v4 * v, u3 * (10.0 - 15.0 * u + 6.0 * u2), u4 * u),
        (5.0 * v4, 30.0 * (uv * uv), 5.0 * u4),
        (-20.0 * v3, 60.0 * (uv * (v - u)), 20.0 * u3),
        (60.0 * v2, 60.0 * (1.0 - 6.0 * uv), 60.0 * u2),
    )


def _powers(differences: tuple[Expression, ...]) -> tuple[Expression, ...]:
    """Coefficients of u to u^5: cheaper than the Bernstein sum and exact enough for the search of a root."""
    d0, dm, d1 = differences
    first = 5.0 * d0
    return first, -2.0 * first, 10.0 * (d0 + dm), -first - 15.0 * dm, d0 + 6.0 * dm + d1


def _halley_step(u: Expression, target: Expression, powers: tuple[Expression, ...]) -> Expression:
    """Improve a root of the polynomial minus its target, by Horner's scheme for value and two derivatives."""
    value = slope = half_curvature = powers[-1]
    value = powers[3] + u * value
    slope = value + u * slope
    for power in (powers[2], powers[1], powers[0]):
        half_curvature = slope + u * half_curvature
        value = power + u * value
        slope = value + u * slope
    error = u * value - target
    return u - error * slope / (slope * slope - error * half_curvature)


def _dot(weights: tuple[Expression, ...], differences: tuple[Expression, ...]) -> Expression:
    return weights[0] * differences[0] + weights[1] * differences[1] + weights[2] * differences[2]


def bezier_curve(
    x: Expression,
    corners: tuple[Corner, ...],
    *,
    derivative: int = 0,
    order: int = 2,
    guess: Callable[[Corner, Expression], Expression] = _cubic_guess,
    steps: int = HALLEY_STEPS,
) -> Expression:
    r"""Evaluate a chain of corners, continued by straight lines, exactly and differentiably.

    .. math:: y = \hat y + y_1 r + \tfrac12 y_2 r^2 + \tfrac16 y_3 r^3, \quad r = x - \hat x, \quad
        y_1 = \frac{\dot y}{\dot x}, \quad y_2 = \frac{\ddot y - y_1 \ddot x}{\dot x^2}, \quad
        y_3 = \frac{\dddot y - y_1 \dddot x - 3 y_2 \dot x \ddot x}{\dot x^3}

    at the rounded root :math:`\hat u` of :math:`x(u) = x`, with dots for derivatives by u.

    Parameters
    ----------
    x : float or DM or SX or MX, any shape [-]
        Where.
    corners : tuple of Corner
        The curve, x rising.
    derivative : int
        0 for the curve, 1 for its slope.
    order : int
        Number of derivatives of the result that automatic differentiation finds exactly, 2 or 3
        (of the slope: always 2).
    guess : callable
        Root of a corner from the fraction of its length.
    steps : int
        Halley steps.

    Returns
    -------
    DM or SX or MX, same shape [-]
        The value.

    Notes
    -----
    The residual r is of the order of rounding, so the Taylor polynomial is exact in value, and its
    derivatives by x and by the control points are those of the curve because the root is rounded by a
    function whose derivative is zero everywhere. The end values need no case: the root is clamped, and
    the second and third derivatives vanish outside.
    """
    starts = [c.x for c in corners[1:]]
    later = [x >= s for s in starts]
    masks = [
        ca.logic_not(later[0]),
        *(ca.logic_and(a, ca.logic_not(b)) for a, b in itertools.pairwise(later)),
        later[-1],
    ]
    c = Corner(
        *(
            sum(ca.if_else(mask, value, 0.0) for mask, value in zip(masks, values, strict=True))
            for values in zip(*corners, strict=True)
        )
    )
    first, last = corners[0].x, corners[-1]
    end = last.x + last.x_d0 + last.x_dm + last.x_d1
    length = c.x_d0 + c.x_dm + c.x_d1
    target = ca.fmin(ca.fmax(x - c.x, 0.0), length)
    u = guess(c, target / length)
    x_differences, y_differences = c[1:4], c[5:8]
    powers = _powers(x_differences)
    for _ in range(steps):
        u = _halley_step(u, target, powers)
    u = ca.floor(ca.fmin(ca.fmax(u, 0.0), 1.0) * ROUNDING) / ROUNDING

    weights = _weights(u)
    x0, xu, xuu, xuuu = (_dot(w, x_differences) for w in weights)
    y0, yu, yuu, yuuu = (_dot(w, y_differences) for w in weights)
    r = (x - c.x) - x0
    inside = ca.logic_and(x >= first, x <= end)
    y1 = yu / xu
    y2 = ca.if_else(inside, (yuu - y1 * xuu) / xu**2, 0.0)
    if derivative == 0 and order == 2:
        return c.y + y0 + r * (y1 + 0.5 * r * y2)
    y3 = ca.if_else(inside, (yuuu - y1 * xuuu - 3.0 * y2 * xu * xuu) / xu**3, 0.0)
    if derivative == 0:
        return c.y + y0 + r * (y1 + r * (0.5 * y2 + r * y3 / 6.0))
    return y1 + r * (y2 + 0.5 * r * y3)


def check_curve_parameters(muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
    """Fill in defaults and refuse curve parameters without a meaning.

    Parameters
    ----------
    muscle : str
        Name, for messages.
    parameters : mapping of str to float [mixed]
        Effective values by OpenSim property name.

    Returns
    -------
    dict of str to float [mixed]
        All parameters of the class.

    Raises
    ------
    DataError
        One sentence: unknown name, value out of range, or a curve that is not monotone between its nodes.
    """
    complete = complete_parameters(muscle, OPENSIM_CLASS, parameters, DEFAULT_CURVE_PARAMETERS)
    p = complete
    inf, tiny = math.inf, -5e-324
    require(
        muscle,
        complete,
        {
            "fiber_damping": (tiny, inf),
            "maximum_pennation_angle": (0.0, 0.5 * math.pi + 1e-12),
            "minimum_activation": (tiny, 1.0),
            "active_force_length_curve.min_norm_active_fiber_length": (
                0.0,
                p["active_force_length_curve.transition_norm_fiber_length"],
            ),
            "active_force_length_curve.transition_norm_fiber_length": (0.0, 0.95),
            "active_force_length_curve.max_norm_active_fiber_length": (1.1, inf),
            "active_force_length_curve.shallow_ascending_slope": (0.0, inf),
            "active_force_length_curve.minimum_value": (tiny, 1.0),
            "force_velocity_curve.concentric_slope_at_vmax": (tiny, 1.0),
            "force_velocity_curve.concentric_slope_near_vmax": (
                p["force_velocity_curve.concentric_slope_at_vmax"],
                1.0,
            ),
            "force_velocity_curve.isometric_slope": (1.0, inf),
            "force_velocity_curve.eccentric_slope_at_vmax": (tiny, inf),
            "force_velocity_curve.eccentric_slope_near_vmax": (
                p["force_velocity_curve.eccentric_slope_at_vmax"],
                inf,
            ),
            "force_velocity_curve.max_eccentric_velocity_force_multiplier": (1.0, inf),
            "force_velocity_curve.concentric_curviness": (tiny, 1.0 + 1e-12),
            "force_velocity_curve.eccentric_curviness": (tiny, 1.0 + 1e-12),
            "fiber_force_length_curve.strain_at_zero_force": (
                -1.0,
                p["fiber_force_length_curve.strain_at_one_norm_force"],
            ),
            "fiber_force_length_curve.stiffness_at_low_force": (0.0, inf),
            "fiber_force_length_curve.stiffness_at_one_norm_force": (0.0, inf),
            "fiber_force_length_curve.curviness": (tiny, 1.0 + 1e-12),
            "tendon_force_length_curve.strain_at_one_norm_force": (0.0, inf),
            "tendon_force_length_curve.stiffness_at_one_norm_force": (0.0, inf),
            "tendon_force_length_curve.norm_force_at_toe_end": (0.0, 1.0),
            "tendon_force_length_curve.curviness": (tiny, 1.0 + 1e-12),
        },
    )
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
                values = ", ".join(f"{k.split('.')[1]}={v:g}" for k, v in p.items() if k.startswith(curve))
                raise DataError(
                    f"muscle {muscle!r}: {curve} is not monotone in its segment {number} with {values}; "
                    "a slope does not fit the points that it joins"
                )
    return complete


def active_force_length(
    normalized_fiber_length: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    *,
    order: int = 2,
) -> Expression:
    """Active force over maximum isometric force at zero velocity and full activation.

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``active_force_length_curve...``.
    order : int
        See :func:`bezier_curve`.

    Returns
    -------
    DM or SX or MX, same shape [-]
        1 at optimal fiber length; ``minimum_value`` (0) outside 0.4441 ... 1.8123.

    References
    ----------
    Millard et al. (2013), J Biomech Eng 135:021005. OpenSim ``ActiveForceLengthCurve.cpp``.
    """
    return bezier_curve(normalized_fiber_length, active_force_length_corners(parameters), order=order)


def active_force_length_slope(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """First derivative of the active force-length curve, itself twice differentiable.

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``active_force_length_curve...``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Zero outside the active range.
    """
    return bezier_curve(normalized_fiber_length, active_force_length_corners(parameters), derivative=1)


def force_velocity(
    normalized_fiber_velocity: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    activation: Expression = 1.0,
    *,
    order: int = 2,
) -> Expression:
    """Force multiplier at a fiber velocity.

    Parameters
    ----------
    normalized_fiber_velocity : float or DM or SX or MX, any shape [-]
        Fiber velocity over the maximum contraction velocity, lengthening positive.
    parameters : mapping of str to float or column [-]
        Uses ``force_velocity_curve...``.
    activation : float or DM or SX or MX, same shape [-]
        Not used: one curve for every activation.
    order : int
        See :func:`bezier_curve`.

    Returns
    -------
    DM or SX or MX, same shape [-]
        0 at -1, 1 at 0, 1.4 at 1 (default).

    References
    ----------
    Millard et al. (2013), J Biomech Eng 135:021005. OpenSim ``ForceVelocityCurve.cpp``.
    """
    return bezier_curve(normalized_fiber_velocity, force_velocity_corners(parameters), order=order)


def inverse_force_velocity(
    multiplier: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    activation: Expression = 1.0,
    *,
    order: int = 2,
) -> Expression:
    """Fiber velocity at a force multiplier, OpenSim's inverse curve.

    Parameters
    ----------
    multiplier : float or DM or SX or MX, any shape [-]
        Force over active isometric force.
    parameters : mapping of str to float or column [-]
        Uses ``force_velocity_curve...``.
    activation : float or DM or SX or MX, same shape [-]
        Not used.
    order : int
        See :func:`bezier_curve`.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Normalized fiber velocity, lengthening positive.

    Notes
    -----
    OpenSim gives the inverse half the slopes near vmax as end slopes. It is the exact inverse where the
    force-velocity curve has these end slopes too (no damping); else it differs by up to 0.03 in velocity
    inside, which OpenSim uses as a first guess only, and without bound beyond.

    References
    ----------
    OpenSim ``ForceVelocityInverseCurve.cpp``; ``Millard2012EquilibriumMuscle.cpp``,
    extendFinalizeFromProperties.
    """
    slopes = (
        0.5 * parameters["force_velocity_curve.concentric_slope_near_vmax"],
        0.5 * parameters["force_velocity_curve.eccentric_slope_near_vmax"],
    )
    return bezier_curve(multiplier, swapped(force_velocity_corners(parameters, slopes)), order=order)


def passive_force_length(
    normalized_fiber_length: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    *,
    order: int = 2,
) -> Expression:
    """Passive fiber force over maximum isometric force.

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``fiber_force_length_curve...``.
    order : int
        See :func:`bezier_curve`.

    Returns
    -------
    DM or SX or MX, same shape [-]
        0 up to optimal length, 1 at a strain of 0.7 (default), a straight line beyond.

    References
    ----------
    Millard et al. (2013), J Biomech Eng 135:021005. OpenSim ``FiberForceLengthCurve.cpp``.
    """
    return bezier_curve(normalized_fiber_length, passive_force_length_corners(parameters), order=order)


def passive_force_length_slope(
    normalized_fiber_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """First derivative of the passive force-length curve, itself twice differentiable.

    Parameters
    ----------
    normalized_fiber_length : float or DM or SX or MX, any shape [-]
        Fiber length over optimal fiber length.
    parameters : mapping of str to float or column [-]
        Uses ``fiber_force_length_curve...``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Not negative.
    """
    return bezier_curve(normalized_fiber_length, passive_force_length_corners(parameters), derivative=1)


def tendon_force_length(
    normalized_tendon_length: Expression,
    parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS,
    *,
    order: int = 2,
) -> Expression:
    """Tendon force over maximum isometric force.

    Parameters
    ----------
    normalized_tendon_length : float or DM or SX or MX, any shape [-]
        Tendon length over slack length.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_force_length_curve...``.
    order : int
        See :func:`bezier_curve`.

    Returns
    -------
    DM or SX or MX, same shape [-]
        0 up to slack length, 1 at a strain of 4.9 % (default).

    References
    ----------
    Millard et al. (2013), J Biomech Eng 135:021005. OpenSim ``TendonForceLengthCurve.cpp``.
    """
    return bezier_curve(normalized_tendon_length, tendon_force_length_corners(parameters), order=order)


def tendon_force_length_slope(
    normalized_tendon_length: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """First derivative of the tendon curve, itself twice differentiable.

    Parameters
    ----------
    normalized_tendon_length : float or DM or SX or MX, any shape [-]
        Tendon length over slack length.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_force_length_curve...``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        28.06 beyond the toe (default).
    """
    return bezier_curve(normalized_tendon_length, tendon_force_length_corners(parameters), derivative=1)


def inverse_tendon_force_length(
    normalized_force: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """Tendon length over slack length at a tendon force.

    Parameters
    ----------
    normalized_force : float or DM or SX or MX, any shape [-]
        Tendon force over maximum isometric force, positive.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_force_length_curve...``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        1 at and below zero force, where the derivative is infinite on the stretched side.
    """
    is_stretched = normalized_force > 0.0
    length = bezier_curve(
        select(is_stretched, normalized_force, 1.0),
        swapped(tendon_force_length_corners(parameters)),
        order=3,
        guess=_cube_root_guess,
        steps=INVERSE_HALLEY_STEPS,
    )
    return select(is_stretched, length, 1.0)


def tendon_slope_at_force(
    normalized_force: Expression, parameters: CurveParameters = DEFAULT_CURVE_PARAMETERS
) -> Expression:
    """Slope of the tendon curve as a function of tendon force.

    Parameters
    ----------
    normalized_force : float or DM or SX or MX, any shape [-]
        Tendon force over maximum isometric force.
    parameters : mapping of str to float or column [-]
        Uses ``tendon_force_length_curve...``.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Held constant below a force of 1e-4, see :data:`MIN_FORCE_OF_TENDON_SLOPE`.
    """
    force = select(normalized_force > MIN_FORCE_OF_TENDON_SLOPE, normalized_force, MIN_FORCE_OF_TENDON_SLOPE)
    return tendon_force_length_slope(inverse_tendon_force_length(force, parameters), parameters)


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
    """Shortest fiber OpenSim allows: shortest active length or largest pennation angle.

    Parameters
    ----------
    muscle : HillMuscle
        Constants.

    Returns
    -------
    float or DM or SX or MX, shape (n_muscles,) [m]
        The longer of the two.

    References
    ----------
    OpenSim ``Millard2012EquilibriumMuscle.cpp``, extendFinalizeFromProperties, m_minimumFiberLength.
    """
    shortest_active = muscle.curve_parameters["active_force_length_curve.min_norm_active_fiber_length"]
    return ca.fmax(shortest_active * muscle.optimal_fiber_length, min_pennated_fiber_length(muscle))


def opensim_optimal_force(
    muscle: HillMuscle,
    muscle_tendon_length: Expression,
    muscle_tendon_velocity: Expression,
    activation: Expression = 1.0,
) -> Expression:
    r"""Active force of a rigid-tendon muscle as OpenSim's static optimization uses it.

    .. math:: F = F_0\, a f_L(\tilde\ell) f_V(\tilde v) \cos\hat\alpha, \quad
              \sin\hat\alpha = h/\tilde\ell, \quad 0 \ \text{if}\ \ell^M \le \ell_{min}

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    muscle_tendon_length : float or DM or SX or MX, any shape [m]
        Length of the path.
    muscle_tendon_velocity : float or DM or SX or MX, same shape [m/s]
        Its rate, lengthening positive.
    activation : float or DM or SX or MX, same shape [-]
        Clamped to ``minimum_activation`` ... 1. Static optimization asks at 1.

    Returns
    -------
    DM or SX or MX, same shape [N]
        No passive force and no damping.

    Notes
    -----
    OpenSim takes the pennation angle of the normalized fiber length where it should take the fiber length, so
    the cosine is close to 1 and the force too large by up to 1/cos(alpha): 1.35 for the soleus of gait2392.
    The velocity uses the right cosine. Reproduced to agree with OpenSim 4.6; the textbook form is
    :func:`hill_muscle.rigid_tendon_force_parts`.

    References
    ----------
    OpenSim ``Millard2012EquilibriumMuscle.cpp``, calcInextensibleTendonActiveFiberForce,
    calcActiveFiberForceAlongTendon.
    """
    shape = muscle.curve_parameters
    active = ca.fmin(ca.fmax(activation, shape["minimum_activation"]), 1.0)
    fiber = clamped_rigid_tendon_fiber(muscle, muscle_tendon_length, muscle_tendon_velocity)
    normalized_length = fiber.fiber_length / muscle.optimal_fiber_length
    velocity = fiber.fiber_velocity / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    force = (
        muscle.max_isometric_force
        * active
        * active_force_length(normalized_length, shape)
        * force_velocity(velocity, shape)
        * clamped_pennation_cosine(muscle, normalized_length)
    )
    return select(fiber.fiber_length > min_fiber_length(muscle), force, 0.0)
