"""Force-length-velocity with an inextensible tendon: force is affine in activation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca

from scso_nlp.exceptions import ProblemError
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.transcription.frame import Frame, MuscleState
from scso_nlp.validation import FloatArray

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


@dataclass(frozen=True, kw_only=True)
class RigidTendon(MuscleModel):
    r"""Tendon force :math:`F = a\,c(t)` with the capacity c of the motion.

    Fiber length and velocity follow from the motion because the tendon keeps its slack length.

    Attributes
    ----------
    convention : "opensim"
        Capacity as OpenSim's static optimization uses it: active force only, with the
        particularities of each muscle class.

    References
    ----------
    OpenSim 4.6, ``StaticOptimizationTarget.cpp``; Akhavanfar et al. (2019), eq. 3.
    """

    convention: str = "opensim"

    def __post_init__(self) -> None:
        if self.convention != "opensim":
            raise ProblemError(f"convention is {self.convention!r}, expected 'opensim'")

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Active force capacity, shape (n_frames, n_muscles) [N]."""
        return {"active_force_capacity": problem.trajectory.active_force_capacity}

    def state(self, frame: Frame, problem: MuscleForceProblem) -> MuscleState:
        """Tendon force of one frame."""
        return MuscleState(
            tendon_force=frame.data["active_force_capacity"] * frame.activation,
            passive_force=ca.SX.zeros(problem.muscles.n_muscles, 1),
        )
