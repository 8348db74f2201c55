"""Force proportional to activation: no force-length-velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca

from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.transcription.frame import Frame, MuscleState

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


@dataclass(frozen=True, kw_only=True)
class NoPhysiology(MuscleModel):
    r"""Tendon force :math:`F = a F_0` with the maximum isometric force.

    OpenSim's static optimization with ``use_muscle_physiology`` false; the paper's spine model.

    References
    ----------
    Akhavanfar et al. (2019), eq. 2.
    """

    def state(self, frame: Frame, problem: MuscleForceProblem) -> MuscleState:
        """Tendon force of one frame."""
        strength = ca.DM(problem.muscles.max_isometric_force)
        return MuscleState(
            tendon_force=strength * frame.activation,
            passive_force=ca.SX.zeros(problem.muscles.n_muscles, 1),
        )
