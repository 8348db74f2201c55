"""Forces of a Hill-type muscle along its tendon: with a rigid tendon, and of an elastic one.

The textbook's: cosine of the pennation angle, passive force and damping included, no clamps. OpenSim's
static optimization has capacities of its own, which differ from class to class and are read from OpenSim.
"""

from __future__ import annotations

from typing import NamedTuple

from scso_nlp.muscle_models.curves import Expression
from scso_nlp.muscle_models.hill_muscle import HillMuscle
from scso_nlp.muscle_models.pennation import rigid_tendon_fiber


class RigidTendonForce(NamedTuple):
    """Force along the tendon: ``activation * active + passive``."""

    active: Expression  #: coefficient of activation [N]
    passive: Expression  #: passive elastic and damping part [N]


def rigid_tendon_force_parts(
    muscle: HillMuscle,
    muscle_tendon_length: Expression,
    muscle_tendon_velocity: Expression,
    activation: Expression = 1.0,
) -> RigidTendonForce:
    r"""Active coefficient and passive part of the force of a muscle with a rigid tendon.

    .. math:: F = a\,c + p, \quad c = F_0 f_L(\tilde\ell) f_V(\tilde v, a) \cos\alpha, \quad
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
    activation : float or DM or SX or MX, same shape [-]
        That of the force-velocity curve, where it depends on activation.

    Returns
    -------
    RigidTendonForce
        `active` and `passive`, same shape [N].

    Notes
    -----
    Smooth where the curves are, so a path shorter than the tendon gives a negative cosine: check lengths
    first. For Thelen2003Muscle the coefficient depends on activation. That of full activation overestimates
    a shortening muscle at low activation (at :math:`\tilde v=-0.2` and default parameters the true force is
    0.25 of it at a = 0.1 and 0.49 at a = 0.3); :func:`rigid_tendon_force` is exact and not affine.

    References
    ----------
    Zajac (1989), Crit Rev Biomed Eng 17:359-411. Millard et al. (2013), J Biomech Eng 135:021005.
    """
    curves, shape = muscle.curves, muscle.curve_parameters
    fiber = rigid_tendon_fiber(muscle, muscle_tendon_length, muscle_tendon_velocity)
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
    muscle_tendon_length, muscle_tendon_velocity
        As for :func:`rigid_tendon_force_parts`, same shape.

    Returns
    -------
    float or DM or SX or MX, same shape [N]
        Tension; affine in activation except for Thelen2003Muscle.
    """
    active, passive = rigid_tendon_force_parts(
        muscle, muscle_tendon_length, muscle_tendon_velocity, activation
    )
    return activation * active + passive


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
