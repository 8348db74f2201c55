"""RigidTendonMuscle: three cubic splines, no elastic tendon.

Points, spline coefficients and extrapolation as in OpenSim 4.6 ``RigidTendonMuscle.cpp`` and
``SimmSpline.cpp``. Only OpenSim's default points are modelled; a muscle with its own splines is refused.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, NoReturn, final

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models.curves import OTHER_PROPERTIES, CurveParameters, Expression, select
from scso_nlp.muscle_models.hill_muscle import HillCurves, HillMuscle
from scso_nlp.muscle_models.pennation import fiber_width
from scso_nlp.validation import FloatArray

#: Points of the active force-length curve: normalized length, multiplier [-]. ``RigidTendonMuscle.cpp``.
ACTIVE_FORCE_LENGTH_POINTS = (
    (-5.307692, 0.012188), (-4.307692, 0.021899), (-1.923077, 0.036466), (-0.884615, 0.052493),
    (-0.269231, 0.075312), (0.230769, 0.114158), (0.461538, 0.157859), (0.52725, 0.226667),
    (0.62875, 0.636667), (0.71875, 0.856667), (0.86125, 0.95), (1.045, 0.993333),
    (1.2175, 0.77), (1.43875, 0.246667), (1.5, 0.193821), (1.615385, 0.133252),
    (2.0, 0.072683), (2.961538, 0.044417), (3.692308, 0.036341), (5.461538, 0.021899),
    (9.901902, 0.007332),
)  # fmt: skip

#: Points of the passive force-length curve: normalized length, multiplier [-]. ``RigidTendonMuscle.cpp``.
PASSIVE_FORCE_LENGTH_POINTS = (
    (-5.0, 0.0), (0.998, 0.0), (0.999, 0.0), (1.0, 0.0), (1.1, 0.035), (1.2, 0.12), (1.3, 0.26),
    (1.4, 0.55), (1.5, 1.17), (1.6, 2.0), (1.601, 2.0), (1.602, 2.0), (5.0, 2.0),
)  # fmt: skip

#: Points of the force-velocity curve: normalized velocity, multiplier [-]. ``RigidTendonMuscle.cpp``.
FORCE_VELOCITY_POINTS = (
    (-1.001, 0.0), (-1.0, 0.0), (-0.95, 0.010417), (-0.9, 0.021739), (-0.85, 0.034091), (-0.8, 0.047619),
    (-0.75, 0.0625), (-0.7, 0.078947), (-0.65, 0.097222), (-0.6, 0.117647), (-0.55, 0.140625),
    (-0.5, 0.166667), (-0.45, 0.196429), (-0.4, 0.230769), (-0.35, 0.270833), (-0.3, 0.318182),
    (-0.25, 0.375), (-0.2, 0.444444), (-0.15, 0.53125), (-0.1, 0.642857), (-0.05, 0.791667), (0.0, 1.0),
    (0.05, 1.482014), (0.1, 1.601571), (0.15, 1.655791), (0.2, 1.686739), (0.25, 1.706751), (0.3, 1.720753),
    (0.35, 1.731099), (0.4, 1.739055), (0.45, 1.745365), (0.5, 1.75049), (0.55, 1.754736), (0.6, 1.758312),
    (0.65, 1.761364), (0.7, 1.763999), (0.75, 1.766298), (0.8, 1.768321), (0.85, 1.770115), (0.9, 1.771717),
    (0.95, 1.773155), (1.0, 1.774455),
)  # fmt: skip

#: Largest passive multiplier [-]. ``RigidTendonMuscle.cpp``, calcMuscleLengthInfo.
MAX_PASSIVE_MULTIPLIER = 10.0


class Spline(NamedTuple):
    """Cubic pieces ``y + dx (b + dx (c + dx d))`` with dx from the piece's start; lines outside."""

    x: FloatArray  #: shape (n_points,) [-]
    y: FloatArray  #: shape (n_points,) [-]
    b: FloatArray  #: shape (n_points,) [-]
    c: FloatArray  #: shape (n_points,) [-]
    d: FloatArray  #: shape (n_points,) [-]


def simm_spline(points: tuple[tuple[float, float], ...]) -> Spline:
    r"""Find the cubic spline with the third derivative of the cubic through four points at each end.

    .. math:: h_{i-1}\sigma_{i-1} + 2 (h_{i-1} + h_i)\sigma_i + h_i \sigma_{i+1} = \Delta_i - \Delta_{i-1},
              \quad \sigma_1 - \sigma_0 = h_0 \Delta^{(3)}_0

    for a sixth of the second derivatives, with divided differences :math:`\Delta`, and likewise at the end.

    Parameters
    ----------
    points : tuple of (float, float), at least four [-]
        x rising, y.

    Returns
    -------
    Spline
        Coefficients.

    References
    ----------
    Forsythe, Malcolm and Moler (1977), Computer Methods for Mathematical Computations (SPLINE).
    OpenSim ``SimmSpline.cpp``, calcCoefficients.
    """
    x, y = np.array(points, dtype=float).T
    n = len(x)
    h = np.diff(x)
    first = np.diff(y) / h
    second = np.diff(first) / (x[2:] - x[:-2])
    third = np.diff(second) / (x[3:] - x[:-3])
    matrix, right = np.zeros((n, n)), np.zeros(n)
    matrix[0, :2] = -h[0], h[0]
    matrix[-1, -2:] = h[-1], -h[-1]
    right[0], right[-1] = h[0] ** 2 * third[0], -(h[-1] ** 2) * third[-1]
    for i in range(1, n - 1):
        matrix[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
        right[i] = first[i] - first[i - 1]
    sigma = np.linalg.solve(matrix, right)
    b = np.append(
        first - h * (sigma[1:] + 2.0 * sigma[:-1]), first[-1] + h[-1] * (sigma[-2] + 2.0 * sigma[-1])
    )
    d = np.append(np.diff(sigma) / h, 0.0)
    return Spline(*(np.asarray(v, dtype=np.float64) for v in (x, y, b, 3.0 * sigma, d)))


ACTIVE_FORCE_LENGTH = simm_spline(ACTIVE_FORCE_LENGTH_POINTS)
PASSIVE_FORCE_LENGTH = simm_spline(PASSIVE_FORCE_LENGTH_POINTS)
FORCE_VELOCITY = simm_spline(FORCE_VELOCITY_POINTS)


def spline_value(x: Expression, spline: Spline, derivative: int = 0) -> Expression:
    """Evaluate a spline or its slope; straight lines outside its points.

    Parameters
    ----------
    x : float or DM or SX or MX, any shape [-]
        Where.
    spline : Spline
        Coefficients.
    derivative : int
        0 or 1.

    Returns
    -------
    DM or SX or MX, same shape [-]
        Twice continuously differentiable inside; the second derivative jumps to zero at both ends.

    References
    ----------
    OpenSim ``SimmSpline.cpp``, calcValue, calcDerivative.
    """
    pieces = [[spline.x[0], spline.y[0], spline.b[0], 0.0, 0.0]]
    pieces += [[v[i] for v in spline] for i in range(len(spline.x) - 1)]
    pieces += [[spline.x[-1], spline.y[-1], spline.b[-1], 0.0, 0.0]]
    pieces = [[float(v) for v in piece] for piece in pieces]
    later = [x >= float(s) for s in spline.x[:-1]] + [x > float(spline.x[-1])]
    masks = [
        ca.logic_not(later[0]),
        *(ca.logic_and(a, ca.logic_not(b)) for a, b in itertools.pairwise(later)),
        later[-1],
    ]
    start, y, b, c, d = (
        sum(ca.if_else(m, value, 0.0) for m, value in zip(masks, values, strict=True) if value != 0.0)
        for values in zip(*pieces, strict=True)
    )
    dx = x - start
    if derivative == 1:
        return b + dx * (2.0 * c + 3.0 * dx * d)
    return y + dx * (b + dx * (c + dx * d))


@final
class RigidTendonMuscleCurves(HillCurves):
    """Curves of RigidTendonMuscle: fixed splines without parameters."""

    OPENSIM_CLASS = "RigidTendonMuscle"
    DEFAULT_CURVE_PARAMETERS = MappingProxyType({})
    HAS_ELASTIC_TENDON = False
    FORCE_VELOCITY_DEPENDS_ON_ACTIVATION = False

    def check_curve_parameters(self, muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
        """Accept the class's default splines only; the answer is empty.

        `parameters` are empty, or the points of the three splines as ``<property>.x<i>`` and
        ``<property>.y<i>`` with the properties ``active_force_length_curve``, ``passive_force_length_curve``
        and ``force_velocity_curve``.
        """
        parameters = {name: value for name, value in parameters.items() if name not in OTHER_PROPERTIES}
        if not parameters:
            return {}
        expected = {
            f"{name}.{axis}{i}": point[k]
            for name, points in (
                ("active_force_length_curve", ACTIVE_FORCE_LENGTH_POINTS),
                ("passive_force_length_curve", PASSIVE_FORCE_LENGTH_POINTS),
                ("force_velocity_curve", FORCE_VELOCITY_POINTS),
            )
            for i, point in enumerate(points)
            for k, axis in enumerate("xy")
        }
        for name in sorted(set(expected) | set(parameters)):
            found, wanted = parameters.get(name, math.nan), expected.get(name, math.nan)
            if not abs(found - wanted) <= 1e-9:
                differs = (
                    f"{name} is {found:g} where the default is {wanted:g}"
                    if name in expected
                    else f"it has {name}"
                )
                raise DataError(
                    f"muscle {muscle!r}: {self.OPENSIM_CLASS} is modelled with OpenSim's default splines "
                    f"only, and {differs}; convert it to another class"
                )
        return {}

    def active_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """0.9989 at optimal fiber length, at most 0.9992, at least 0.007: never zero."""
        return spline_value(normalized_fiber_length, ACTIVE_FORCE_LENGTH)

    def active_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Slope of the spline: once continuously differentiable."""
        return spline_value(normalized_fiber_length, ACTIVE_FORCE_LENGTH, derivative=1)

    def passive_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Limited to 0 ... 10: 0.035 at 1.1, 1.17 at 1.5, 2 at 1.6.

        Not smooth where the limits begin to act. Levels off at 2 (2.0105 at most) beyond 1.6 where a fiber
        would stiffen further. OpenSim calcMuscleLengthInfo.
        """
        value = spline_value(normalized_fiber_length, PASSIVE_FORCE_LENGTH)
        return select(value > MAX_PASSIVE_MULTIPLIER, MAX_PASSIVE_MULTIPLIER, select(value > 0.0, value, 0.0))

    def passive_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Zero where a limit acts; down to -0.033 at 1.6, where the spline overshoots, and beyond 3.3."""
        value = spline_value(normalized_fiber_length, PASSIVE_FORCE_LENGTH)
        slope = spline_value(normalized_fiber_length, PASSIVE_FORCE_LENGTH, derivative=1)
        return select(ca.logic_and(value > 0.0, value < MAX_PASSIVE_MULTIPLIER), slope, 0.0)

    def force_velocity(
        self, normalized_fiber_velocity: Expression, parameters: CurveParameters, activation: Expression = 1.0
    ) -> Expression:
        """0 at -1, 1 at 0, 1.774455 at 1. OpenSim takes the velocity of the path for that of the fiber."""
        return spline_value(normalized_fiber_velocity, FORCE_VELOCITY)

    def tendon_force_length(
        self, normalized_tendon_length: Expression, parameters: CurveParameters
    ) -> NoReturn:
        """Refuse: the tendon of this class is rigid."""
        raise DataError(
            f"{self.OPENSIM_CLASS} has no tendon curve, its tendon is rigid; use a rigid-tendon muscle model"
        )

    def inverse_tendon_force_length(
        self, normalized_force: Expression, parameters: CurveParameters
    ) -> NoReturn:
        """Refuse, as :meth:`tendon_force_length` does."""
        self.tendon_force_length(normalized_force, parameters)

    def tendon_slope_at_force(self, normalized_force: Expression, parameters: CurveParameters) -> NoReturn:
        """Refuse, as :meth:`tendon_force_length` does."""
        self.tendon_force_length(normalized_force, parameters)

    def fiber_damping(self, parameters: CurveParameters) -> Expression:
        """Zero: this class has none."""
        return 0.0

    def min_fiber_length(self, muscle: HillMuscle) -> Expression:
        """Width of the fiber, when the path is no longer than the tendon; zero for parallel fibers."""
        return fiber_width(muscle)
