"""Force proportional to activation: no force-length-velocity."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from scso_nlp.arguments import checked
from scso_nlp.frame import Frame, MuscleState
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.muscle_model import MuscleModel


@dataclass(frozen=True, kw_only=True)
@checked
class NoPhysiology(MuscleModel):
    r"""Tendon force :math:`F = a F_0` with the maximum isometric force.

    OpenSim's static optimization with ``use_muscle_physiology`` false; the paper's spine model.

    References
    ----------
    Akhavanfar et al. (2019), eq. 2.

    Examples
    --------
    >>> solution.problem.muscle_model
    NoPhysiology()
    >>> bool((solution.tendon_force == solution.activation * motion.muscles.max_isometric_force).all())
    True
    """

    def state(self, frame: Frame, motion: Motion) -> MuscleState:
        """Tendon force of one frame."""
        strength = frame.constant("max_isometric_force", motion.muscles.max_isometric_force)
        return MuscleState(
            tendon_force=strength * frame.activation,
            passive_force=ca.SX.zeros(motion.muscles.n_muscles, 1),
        )
