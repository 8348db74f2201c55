"""A Hill-type muscle as OpenSim parameterizes it, and the forces that its four curves imply.

Here: the constants (:class:`HillMuscle`), rigid-tendon force in the textbook form, the equilibrium of an
elastic tendon and its numerical solution. Not here: the curves and OpenSim's own static-optimization
capacity, which differ from class to class (`thelen2003`, `millard2012`, `degroote2016`,
`rigid_tendon_muscle`); stiffness (`stiffness`); what a trajectory does with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple, Protocol

import casadi as ca
import numpy as np

from scso_nlp.muscle_models.curves import CurveParameters, Expression
from scso_nlp.muscle_models.pennation import (
    fiber_length_of,
    fiber_width,
    rigid_tendon_fiber,
)
from scso_nlp.validation import BoolArray, FloatArray, IntArray


class HillCurves(Protocol):
    """The names that the module of every muscle class provides, with the same signatures.

    All curves are normalized and elementwise; parameters are OpenSim's property names.
    """

    OPENSIM_CLASS: str
    DEFAULT_CURVE_PARAMETERS: Mapping[str, float]
    HAS_ELASTIC_TENDON: bool
    FORCE_VELOCITY_DEPENDS_ON_ACTIVATION: bool

    def check_curve_parameters(self, muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
        """Return all parameters with defaults filled in, or raise DataError in one sentence."""

    def active_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Active force over maximum isometric force at zero velocity and full activation [-]."""

    def active_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """First derivative of the active force-length curve [-]."""

    def force_velocity(
        self, normalized_fiber_velocity: Expression, parameters: CurveParameters, activation: Expression = 1.0
    ) -> Expression:
        """Force multiplier at a normalized fiber velocity, lengthening positive [-]."""

    def inverse_force_velocity(
        self, multiplier: Expression, parameters: CurveParameters, activation: Expression = 1.0
    ) -> Expression:
        """Fiber velocity over the maximum at a force multiplier [-]."""

    def passive_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Passive fiber force over maximum isometric force [-]."""

    def passive_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """First derivative of the passive force-length curve [-]."""

    def tendon_force_length(
        self, normalized_tendon_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Tendon force over maximum isometric force [-]."""

    def tendon_force_length_slope(
        self, normalized_tendon_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """First derivative of the tendon curve [-]."""

    def inverse_tendon_force_length(
        self, normalized_force: Expression, parameters: CurveParameters
    ) -> Expression:
        """Tendon length over slack length at a tendon force [-]."""

    def tendon_slope_at_force(self, normalized_force: Expression, parameters: CurveParameters) -> Expression:
        """Slope of the tendon curve as a function of tendon force [-]."""

    def fiber_damping(self, parameters: CurveParameters) -> Expression:
        """Damping coefficient, force over max isometric force per normalized velocity [-]."""

    def min_fiber_length(self, muscle: HillMuscle) -> Expression:
        """Shortest fiber the class allows [m]."""

    def opensim_optimal_force(
        self,
        muscle: HillMuscle,
        muscle_tendon_length: Expression,
        muscle_tendon_velocity: Expression,
        activation: Expression = 1.0,
    ) -> Expression:
        """OpenSim's ``calcInextensibleTendonActiveFiberForce`` [N]."""


@dataclass(frozen=True, kw_only=True)
class HillMuscle:
    """Constants of one muscle, or of several muscles of one class as columns.

    Attributes
    ----------
    curves : module
        `thelen2003`, `millard2012`, `degroote2016` or `rigid_tendon_muscle`.
    max_isometric_force : float or column, shape (n_muscles,) [N]
    optimal_fiber_length : float or column, shape (n_muscles,) [m]
    tendon_slack_length : float or column, shape (n_muscles,) [m]
    pennation_angle_at_optimal : float or column, shape (n_muscles,) [rad]
    max_contraction_velocity : float or column, shape (n_muscles,) [1/s]
        In optimal fiber lengths per second.
    curve_parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
        By OpenSim property name; OpenSim's defaults if empty.

    Notes
    -----
    Any entry may be a symbol, for example to find a tendon slack length or a curve shape: all
    functions of this folder are twice differentiable with respect to their parameters too.
    """

    curves: HillCurves
    max_isometric_force: Expression = 1000.0
    optimal_fiber_length: Expression = 0.1
    tendon_slack_length: Expression = 0.2
    pennation_angle_at_optimal: Expression = 0.0
    max_contraction_velocity: Expression = 10.0
    curve_parameters: CurveParameters = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.curve_parameters:
            object.__setattr__(self, "curve_parameters", dict(self.curves.DEFAULT_CURVE_PARAMETERS))


#: The numbers of a muscle, in the order of the packed vector; the curve parameters follow.
_CONSTANTS = tuple(f.name for f in fields(HillMuscle) if f.name not in ("curves", "curve_parameters"))


def pack(muscle: HillMuscle) -> Expression:
    """Stack all constants of a muscle, one row per constant and one column per muscle.

    Parameters
    ----------
    muscle : HillMuscle
        One muscle or a column of muscles.

    Returns
    -------
    DM or SX or MX, shape (n_constants, n_muscles) [mixed]
        What :func:`unpack` reads; the parameter input of a mapped function.
    """
    values = [getattr(muscle, name) for name in _CONSTANTS]
    values += [muscle.curve_parameters[name] for name in muscle.curves.DEFAULT_CURVE_PARAMETERS]
    columns: list[Expression] = [v if isinstance(v, (ca.SX, ca.MX)) else ca.DM(v) for v in values]
    n_muscles = max(c.numel() for c in columns)
    rows = [ca.repmat(c, 1, n_muscles) if c.numel() == 1 else ca.reshape(c, 1, n_muscles) for c in columns]
    return ca.densify(ca.vertcat(*rows))


def unpack(curves: HillCurves, packed: Expression) -> HillMuscle:
    """Read a muscle from a vector of constants.

    Parameters
    ----------
    curves : module
        The class.
    packed : DM or SX or MX, shape (n_constants, n_muscles) [mixed]
        As :func:`pack` makes it.

    Returns
    -------
    HillMuscle
        With columns of shape (n_muscles, 1).
    """
    rows = [packed[i, :].T for i in range(packed.shape[0])]
    names = list(curves.DEFAULT_CURVE_PARAMETERS)
    n = len(_CONSTANTS)
    return HillMuscle(
        curves=curves,
        **dict(zip(_CONSTANTS, rows[:n], strict=True)),
        curve_parameters=dict(zip(names, rows[n:], strict=True)),
    )


def n_constants(curves: HillCurves) -> int:
    """Count the rows of :func:`pack` for a class."""
    return len(_CONSTANTS) + len(curves.DEFAULT_CURVE_PARAMETERS)


def repeat_over_frames(muscle: HillMuscle, n_frames: int) -> HillMuscle:
    """Repeat the columns once per frame, to meet arrays of shape (n_frames, n_muscles) unrolled.

    Parameters
    ----------
    muscle : HillMuscle
        With numbers or columns of shape (n_muscles,).
    n_frames : int
        How often.

    Returns
    -------
    HillMuscle
        With columns of shape (n_frames * n_muscles,), muscles running fastest.
    """

    def repeat(value: Expression) -> Expression:
        column = ca.DM(value)
        return value if column.numel() == 1 else ca.repmat(column, n_frames, 1)

    return replace(
        muscle,
        **{name: repeat(getattr(muscle, name)) for name in _CONSTANTS},
        curve_parameters={name: repeat(value) for name, value in muscle.curve_parameters.items()},
    )


class RigidTendonForce(NamedTuple):
    """Force along the tendon, affine in activation: ``activation * active + passive``."""

    active: Expression  #: coefficient of activation [N]
    passive: Expression  #: passive elastic and damping part [N]


def rigid_tendon_force_parts(
    muscle: HillMuscle, muscle_tendon_length: Expression, muscle_tendon_velocity: Expression
) -> RigidTendonForce:
    r"""Active coefficient and passive part of the force of a muscle with a rigid tendon.

    .. math:: F = a\,c + p, \quad c = F_0 f_L(\tilde\ell) f_V(\tilde v) \cos\alpha, \quad
              p = F_0 (f_P(\tilde\ell) + \beta \tilde v) \cos\alpha

    with :math:`\ell^M = \sqrt{(\ell^{MT}-\ell_s^T)^2 + h^2}`,
    :math:`\cos\alpha = (\ell^{MT}-\ell_s^T)/\ell^M`, :math:`v^M = v^{MT}\cos\alpha`.

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    muscle_tendon_length : float or DM or SX or MX, any shape [m]
        Length of the path.
    muscle_tendon_velocity : float or DM or SX or MX, same shape [m/s]
        Its rate, lengthening positive.

    Returns
    -------
    RigidTendonForce
        `active` and `passive`, same shape [N].

    Notes
    -----
    The physical convention: cosine of the pennation angle, passive force and damping included, no clamps
    (smooth where the curves are), so a path shorter than the tendon gives a negative cosine: check lengths
    first. For Thelen2003Muscle the force-velocity curve depends on activation; the affine form uses the
    curve at full activation, which overestimates a shortening muscle at low activation
    (at :math:`\tilde v=-0.2` and default parameters the true force is 0.25 of it at a = 0.1 and 0.49 at
    a = 0.3) and :func:`rigid_tendon_force` gives the exact, not affine, force.

    References
    ----------
    Zajac (1989), Crit Rev Biomed Eng 17:359-411. Millard et al. (2013), J Biomech Eng 135:021005.
    """
    return _rigid_tendon_parts(muscle, muscle_tendon_length, muscle_tendon_velocity, 1.0)


def rigid_tendon_force(
    muscle: HillMuscle,
    activation: Expression,
    muscle_tendon_length: Expression,
    muscle_tendon_velocity: Expression,
) -> Expression:
    r"""Force along a rigid tendon at a given activation.

    .. math:: F = F_0 (a f_L f_V(\tilde v, a) + f_P + \beta \tilde v) \cos\alpha

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    activation : float or DM or SX or MX, any shape [-]
        0 to 1, greater than 0 for Thelen2003Muscle with a shortening fiber.
    muscle_tendon_length : float or DM or SX or MX, same shape [m]
        Length of the path.
    muscle_tendon_velocity : float or DM or SX or MX, same shape [m/s]
        Its rate, lengthening positive.

    Returns
    -------
    float or DM or SX or MX, same shape [N]
        Tension along the tendon.

    Notes
    -----
    Affine in activation except for Thelen2003Muscle, whose force-velocity curve depends on it.
    """
    active, passive = _rigid_tendon_parts(muscle, muscle_tendon_length, muscle_tendon_velocity, activation)
    return activation * active + passive


def _rigid_tendon_parts(
    muscle: HillMuscle, length: Expression, velocity: Expression, activation: Expression
) -> RigidTendonForce:
    curves, shape = muscle.curves, muscle.curve_parameters
    fiber = rigid_tendon_fiber(muscle, length, velocity)
    normalized_length = fiber.fiber_length / muscle.optimal_fiber_length
    normalized_velocity = fiber.fiber_velocity / (
        muscle.optimal_fiber_length * muscle.max_contraction_velocity
    )
    along_tendon = muscle.max_isometric_force * fiber.cos_pennation_angle
    active = curves.active_force_length(normalized_length, shape) * curves.force_velocity(
        normalized_velocity, shape, activation
    )
    passive = (
        curves.passive_force_length(normalized_length, shape)
        + curves.fiber_damping(shape) * normalized_velocity
    )
    return RigidTendonForce(along_tendon * active, along_tendon * passive)


def tendon_force(
    muscle: HillMuscle, fiber_length_along_tendon: Expression, muscle_tendon_length: Expression
) -> Expression:
    r"""Force of an elastic tendon.

    .. math:: F^T = F_0 f_T\big((\ell^{MT} - q)/\ell_s^T\big), \quad q = \ell^M \cos\alpha

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    fiber_length_along_tendon : float or DM or SX or MX, any shape [m]
        q.
    muscle_tendon_length : float or DM or SX or MX, same shape [m]
        Length of the path.

    Returns
    -------
    float or DM or SX or MX, same shape [N]
        Tension.

    Raises
    ------
    DataError
        The class has no elastic tendon.
    """
    stretch = (muscle_tendon_length - fiber_length_along_tendon) / muscle.tendon_slack_length
    return muscle.max_isometric_force * muscle.curves.tendon_force_length(stretch, muscle.curve_parameters)


def equilibrium_residual(
    muscle: HillMuscle,
    fiber_length_along_tendon: Expression,
    activation: Expression,
    muscle_tendon_length: Expression,
    muscle_tendon_velocity: Expression = 0.0,
) -> Expression:
    r"""Fiber force along the tendon minus tendon force, over maximum isometric force.

    .. math:: R = (a f_L(\tilde\ell) f_V(\tilde v, a) + f_P(\tilde\ell) + \beta\tilde v)\cos\alpha
                  - f_T\big((\ell^{MT}-q)/\ell_s^T\big), \quad \ell^M = \sqrt{q^2+h^2}

    Parameters
    ----------
    muscle : HillMuscle
        Constants.
    fiber_length_along_tendon : float or DM or SX or MX, any shape [m]
        q, positive.
    activation : float or DM or SX or MX, same shape [-]
        0 to 1.
    muscle_tendon_length : float or DM or SX or MX, same shape [m]
        Length of the path.
    muscle_tendon_velocity : float or DM or SX or MX, same shape [m/s]
        Zero is the quasi-static state. Otherwise the tendon keeps its length and the fiber takes the whole
        velocity, :math:`v^M = v^{MT}\cos\alpha`.

    Returns
    -------
    float or DM or SX or MX, same shape [-]
        Zero in equilibrium.

    Raises
    ------
    DataError
        The class has no elastic tendon.

    Notes
    -----
    The unknown is q because :math:`\ell^M` then needs no arc sine and has no singular pennation angle.
    OpenSim's ``equilibrateMuscles`` means: zero velocity for Millard2012EquilibriumMuscle whatever the
    path does, constant tendon length for DeGrooteFregly2016Muscle, and for Thelen2003Muscle a heuristic
    that shares the path's velocity (it agrees with this residual at zero path velocity only).
    """
    curves, shape = muscle.curves, muscle.curve_parameters
    fiber_length = fiber_length_of(fiber_length_along_tendon, fiber_width(muscle))
    cos_pennation_angle = fiber_length_along_tendon / fiber_length
    normalized_length = fiber_length / muscle.optimal_fiber_length
    normalized_velocity = (
        muscle_tendon_velocity
        * cos_pennation_angle
        / (muscle.optimal_fiber_length * muscle.max_contraction_velocity)
    )
    fiber_force = (
        activation
        * curves.active_force_length(normalized_length, shape)
        * curves.force_velocity(normalized_velocity, shape, activation)
        + curves.passive_force_length(normalized_length, shape)
        + curves.fiber_damping(shape) * normalized_velocity
    )
    stretch = (muscle_tendon_length - fiber_length_along_tendon) / muscle.tendon_slack_length
    return fiber_force * cos_pennation_angle - curves.tendon_force_length(stretch, shape)


class Equilibrium(NamedTuple):
    """Fiber and tendon in equilibrium; arrays of shape (n_frames, n_muscles) or as given."""

    fiber_length_along_tendon: FloatArray  #: q [m]
    fiber_length: FloatArray  #: [m]
    tendon_force: FloatArray  #: [N]
    residual: FloatArray  #: fiber force along the tendon minus tendon force over max isometric force [-]
    is_at_lower_bound: BoolArray  #: fiber at its shortest: short path, or the fiber outpulls the tendon
    is_slack: BoolArray  #: no length with a taut tendon, because the fiber pushes (damping)


def solve_equilibrium(
    muscle: HillMuscle,
    activation: FloatArray,
    muscle_tendon_length: FloatArray,
    muscle_tendon_velocity: FloatArray | float = 0.0,
) -> Equilibrium:
    """Find the fiber length at which fiber and tendon pull equally.

    Newton's method inside a shrinking bracket, from the rigid-tendon force put on the tendon curve, until
    the step is the rounding of the path length.

    Parameters
    ----------
    muscle : HillMuscle
        Constants, numbers or columns of shape (n_muscles,).
    activation : ndarray, shape (n_frames, n_muscles) or (n_muscles,) [-]
        0 to 1.
    muscle_tendon_length : ndarray, same shape [m]
        Length of the path.
    muscle_tendon_velocity : float or ndarray, same shape [m/s]
        See :func:`equilibrium_residual`.

    Returns
    -------
    Equilibrium
        Arrays of the same shape. Where the fiber is at its lower bound or the tendon slack, the residual is
        not zero and the tendon force is that of the tendon, as in OpenSim.

    Raises
    ------
    DataError
        The class has no elastic tendon.
    """
    curves = muscle.curves
    a, length, velocity = np.broadcast_arrays(
        *(np.asarray(x, dtype=float) for x in (activation, muscle_tendon_length, muscle_tendon_velocity))
    )
    shape = a.shape
    constants = np.asarray(pack(muscle).full())
    n_muscles = constants.shape[1]
    constants = np.tile(constants, (1, a.size // n_muscles))
    a, length, velocity = a.ravel(), length.ravel(), velocity.ravel()
    rows = unpack(curves, ca.DM(constants))
    slack_length, width, shortest, guess = (
        np.broadcast_to(ca.DM(x).full().ravel(), a.shape)
        for x in (
            rows.tendon_slack_length,
            fiber_width(rows),
            curves.min_fiber_length(rows),
            _first_guess(rows, ca.DM(a), ca.DM(length)),
        )
    )
    optimal = np.broadcast_to(ca.DM(rows.optimal_fiber_length).full().ravel(), a.shape)

    low = np.maximum(np.sqrt(np.maximum(shortest**2 - width**2, 0.0)), 1e-6 * optimal)
    high = np.maximum(length - slack_length, low)
    residual_and_slope = _residual_and_slope(curves)

    def evaluate(where: IntArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        inputs = (q, a[where], length[where], velocity[where])
        values = residual_and_slope.map(len(q))(*(ca.DM(x).T for x in inputs), ca.DM(constants[:, where]))
        return values[0].full().ravel(), values[1].full().ravel()

    everywhere = np.arange(a.size, dtype=np.int64)
    at_low, _ = evaluate(everywhere, low)
    at_high, _ = evaluate(everywhere, high)
    is_at_lower_bound = (at_low >= 0.0) | (high <= low)
    is_slack = ~is_at_lower_bound & (at_high < 0.0)
    q = np.where(is_at_lower_bound, low, np.where(is_slack, high, np.clip(guess, low, high)))
    active: IntArray = everywhere[~is_at_lower_bound & ~is_slack]
    for _ in range(100):
        if not active.size:
            break
        value, slope = evaluate(active, q[active])
        above = value >= 0.0
        high[active] = np.where(above, q[active], high[active])
        low[active] = np.where(above, low[active], q[active])
        with np.errstate(divide="ignore", invalid="ignore"):
            trial = q[active] - value / slope
        outside = ~((trial >= low[active]) & (trial <= high[active]))
        trial = np.where(outside, 0.5 * (low[active] + high[active]), trial)
        trial = np.where(value == 0.0, q[active], trial)
        step = np.abs(trial - q[active])
        q[active] = trial
        active = active[step > 2.0 * np.spacing(length[active])]
    residual, _ = evaluate(everywhere, q)
    force = ca.DM(tendon_force(rows, ca.DM(q), ca.DM(length))).full().ravel()
    fiber = np.sqrt(q**2 + width**2)
    return Equilibrium(
        fiber_length_along_tendon=q.reshape(shape),
        fiber_length=fiber.reshape(shape),
        tendon_force=force.reshape(shape),
        residual=residual.reshape(shape),
        is_at_lower_bound=is_at_lower_bound.reshape(shape),
        is_slack=is_slack.reshape(shape),
    )


def _first_guess(muscle: HillMuscle, activation: Expression, muscle_tendon_length: Expression) -> Expression:
    parts = rigid_tendon_force_parts(muscle, muscle_tendon_length, 0.0)
    force = (activation * parts.active + parts.passive) / muscle.max_isometric_force
    stretch = muscle.curves.inverse_tendon_force_length(
        ca.fmin(ca.fmax(force, 1e-3), 1.5), muscle.curve_parameters
    )
    return muscle_tendon_length - muscle.tendon_slack_length * stretch


def _residual_and_slope(curves: HillCurves) -> Expression:
    q, a, length, velocity = (ca.SX.sym(name) for name in ("q", "a", "length", "velocity"))
    packed = ca.SX.sym("constants", n_constants(curves))
    residual = equilibrium_residual(unpack(curves, packed), q, a, length, velocity)
    return ca.Function("residual", [q, a, length, velocity, packed], [residual, ca.jacobian(residual, q)])
