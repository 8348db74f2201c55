"""Equilibrium of fiber and elastic tendon: its residual, and its numerical solution."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from scso_nlp.muscle_models.curves import Expression
from scso_nlp.muscle_models.force import rigid_tendon_force, tendon_force
from scso_nlp.muscle_models.hill_muscle import HillCurves, HillMuscle, n_constants, pack, unpack
from scso_nlp.muscle_models.pennation import fiber_length_of, fiber_width
from scso_nlp.validation import BoolArray, FloatArray, IntArray


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
    constants = np.tile(constants, (1, a.size // constants.shape[1]))
    a, length, velocity = a.ravel(), length.ravel(), velocity.ravel()
    rows = unpack(curves, ca.DM(constants))
    slack_length, optimal, width, shortest, guess = (
        np.broadcast_to(ca.DM(x).full().ravel(), a.shape)
        for x in (
            rows.tendon_slack_length,
            rows.optimal_fiber_length,
            fiber_width(rows),
            curves.min_fiber_length(rows),
            _first_guess(rows, ca.DM(a), ca.DM(length)),
        )
    )
    residual_and_slope = _residual_and_slope(curves)

    def evaluate(where: IntArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        inputs = (q, a[where], length[where], velocity[where])
        values = residual_and_slope.map(len(q))(*(ca.DM(x).T for x in inputs), ca.DM(constants[:, where]))
        return values[0].full().ravel(), values[1].full().ravel()

    low = np.maximum(np.sqrt(np.maximum(shortest**2 - width**2, 0.0)), 1e-6 * optimal)
    high = np.maximum(length - slack_length, low)
    everywhere = np.arange(a.size, dtype=np.int64)
    at_low, at_high = (evaluate(everywhere, q)[0] for q in (low, high))
    is_at_lower_bound = (at_low >= 0.0) | (high <= low)
    is_slack = ~is_at_lower_bound & (at_high < 0.0)
    q = np.where(is_at_lower_bound, low, np.where(is_slack, high, np.clip(guess, low, high)))
    inside = everywhere[~is_at_lower_bound & ~is_slack]
    q[inside] = _roots(
        evaluate, inside, q[inside], low[inside], high[inside], 2.0 * np.spacing(length[inside])
    )
    force = ca.DM(tendon_force(rows, ca.DM(q), ca.DM(length))).full().ravel()
    residual, _ = evaluate(everywhere, q)
    return Equilibrium(
        fiber_length_along_tendon=q.reshape(shape),
        fiber_length=np.sqrt(q**2 + width**2).reshape(shape),
        tendon_force=force.reshape(shape),
        residual=residual.reshape(shape),
        is_at_lower_bound=is_at_lower_bound.reshape(shape),
        is_slack=is_slack.reshape(shape),
    )


def _roots(
    evaluate: Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]],
    where: IntArray,
    q: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rounding: FloatArray,
) -> FloatArray:
    """Newton's method inside brackets that shrink; all arrays of shape (n_where,).

    `evaluate` gives value and slope of rising functions at some positions; a step out of its bracket is
    replaced by the bracket's middle, and a root is done when its step is no longer than its rounding.
    """
    q, low, high = q.copy(), low.copy(), high.copy()
    left = np.arange(where.size)
    for _ in range(100):
        if not left.size:
            break
        value, slope = evaluate(where[left], q[left])
        above = value >= 0.0
        high[left] = np.where(above, q[left], high[left])
        low[left] = np.where(above, low[left], q[left])
        with np.errstate(divide="ignore", invalid="ignore"):
            trial = q[left] - value / slope
        outside = ~((trial >= low[left]) & (trial <= high[left]))
        trial = np.where(outside, 0.5 * (low[left] + high[left]), trial)
        trial = np.where(value == 0.0, q[left], trial)
        step = np.abs(trial - q[left])
        q[left] = trial
        left = left[step > rounding[left]]
    return q


def _first_guess(muscle: HillMuscle, activation: Expression, muscle_tendon_length: Expression) -> Expression:
    """Put the force that the muscle had with a rigid tendon on its elastic one."""
    force = rigid_tendon_force(muscle, activation, muscle_tendon_length, 0.0) / muscle.max_isometric_force
    stretch = muscle.curves.inverse_tendon_force_length(
        ca.fmin(ca.fmax(force, 1e-3), 1.5), muscle.curve_parameters
    )
    return muscle_tendon_length - muscle.tendon_slack_length * stretch


def _residual_and_slope(curves: HillCurves) -> Expression:
    """Make the residual of one muscle and its derivative by fiber length a function of numbers."""
    q, a, length, velocity = (ca.SX.sym(name) for name in ("q", "a", "length", "velocity"))
    packed = ca.SX.sym("constants", n_constants(curves))
    residual = equilibrium_residual(unpack(curves, packed), q, a, length, velocity)
    return ca.Function("residual", [q, a, length, velocity, packed], [residual, ca.jacobian(residual, q)])
