r"""Curves made of quintic Bezier corners, continued by straight lines: OpenSim's SmoothSegmentedFunction.

A point of such a curve needs the root of a quintic, x(u) = x. Here the root comes from three Halley steps, is
rounded so that automatic differentiation does not see it, and the curve is continued from there by its exact
Taylor polynomial: value, gradient and Hessian are exact to rounding, also with respect to the shape
parameters, at the price of the value alone. ``order=3`` adds the third derivative.
Formulas as in OpenSim 4.6 ``SegmentedQuinticBezierToolkit.cpp``, ``SmoothSegmentedFunctionFactory.cpp``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca

from scso_nlp.muscle_models.curves import Expression, select

#: Halley steps from the cubic guess. They bring every curve of OpenSim's models to x(u) - x < 1e-12, and the
#: Taylor step makes the value exact to the third power of what is left.
HALLEY_STEPS = 3

#: The same from the cube-root guess of the tendon's inverse, whose toe starts with a triple root.
INVERSE_HALLEY_STEPS = 4

#: Roots are rounded to this many per unit, which has no derivative [-].
ROUNDING = 2.0**50


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


def _cubic_guess(c: Corner, part: Expression) -> Expression:
    """Cubic Hermite polynomial through both ends with the root's end slopes (at most 3)."""
    length = c.x_d0 + c.x_dm + c.x_d1
    s0, s1 = (ca.fmin(length / (5.0 * d), 3.0) for d in (c.x_d0, c.x_d1))
    return part * (s0 + part * (3.0 - 2.0 * s0 - s1 + part * (s0 + s1 - 2.0)))


def cube_root_guess(c: Corner, part: Expression) -> Expression:
    """Guess a root of a corner that may start with a triple one (d0 = 0).

    Parameters
    ----------
    c : Corner
        Its x.
    part : float or DM or SX or MX, any shape [-]
        Where, as a fraction of the corner's length.

    Returns
    -------
    DM or SX or MX, same shape [-]
        The `guess` of :func:`bezier_curve` for an inverse curve; use :data:`INVERSE_HALLEY_STEPS` with it.
    """
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
