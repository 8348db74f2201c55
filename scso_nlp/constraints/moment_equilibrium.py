"""Moment equilibrium: muscles and actuators produce the generalized forces of the motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.transcription.frame import Frame, Rows

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


@dataclass(frozen=True, kw_only=True)
class MomentEquilibrium(FrameConstraint):
    r"""Muscles and actuators balance every free coordinate.   depends on: one frame.

    .. math:: R F + A c = M

    with moment arms R, tendon forces F, generalized forces per unit control A, controls c and
    generalized forces M.

    References
    ----------
    Akhavanfar et al. (2019), eq. 1.
    """

    def rows(self, frame: Frame, problem: MuscleForceProblem) -> Rows:
        """One row per free coordinate, in N·m (rotation) or N (translation)."""
        produced = frame.moment_arms @ frame.muscle.tendon_force
        if frame.control.numel():
            produced += frame.actuator_generalized_forces @ frame.control
        return Rows(
            value=produced - frame.generalized_forces,
            lower=0.0,
            upper=0.0,
            names=problem.trajectory.coordinates,
            unit=["N·m" if angle else "N" for angle in problem.trajectory.is_rotational],
        )
