"""Moment equilibrium: muscles and actuators produce the generalized forces of the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows
from scso_nlp.motion import Motion
from scso_nlp.validation import FloatArray


@dataclass(frozen=True, kw_only=True)
@checked
class MomentEquilibrium(FrameConstraint):
    r"""Muscles and actuators balance every free coordinate.   depends on: one frame.

    .. math:: R F + A c = M

    with moment arms R, tendon forces F, generalized forces per unit control A, controls c and
    generalized forces M.

    Attributes
    ----------
    passive_elements : "taken_off" or "left_in"
        What becomes of the generalized forces of the model's passive elements (springs, bushings,
        ligaments, coordinate limits). ``"taken_off"``: they carry their share, and muscles and actuators
        the rest, as in OpenSim. ``"left_in"``: muscles and actuators carry their share too, as if the
        model had no such elements.

    Notes
    -----
    Passive forces of muscle fibers are the muscle model's business.

    References
    ----------
    Akhavanfar et al. (2019), eq. 1.

    Examples
    --------
    >>> solution.rows["MomentEquilibrium"].names
    ('elbow_flexion',)
    >>> bool(solution.violation["MomentEquilibrium"] < 1e-9)
    True
    """

    passive_elements: Literal["taken_off", "left_in"] = "taken_off"

    def __post_init__(self) -> None:
        if self.passive_elements not in ("taken_off", "left_in"):
            raise ProblemError(
                f"passive_elements is {self.passive_elements!r}, expected 'taken_off' or 'left_in'"
            )

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give the passive elements' share [N·m or N] if muscles are to carry it."""
        if self.passive_elements == "taken_off":
            return {}
        return {"passive": motion.trajectory.passive_generalized_forces}

    def notes(self, motion: Motion) -> tuple[str, ...]:
        """Say what becomes of passive elements, if there are any that act."""
        trajectory = motion.trajectory
        passive = np.abs(trajectory.passive_generalized_forces)
        if not passive.any():
            return ()
        _, c = np.unravel_index(passive.argmax(), passive.shape)
        words = {"taken_off": "taken off", "left_in": "left in"}[self.passive_elements]
        unit = "N·m" if trajectory.is_rotational[c] else "N"
        return (
            f"generalized forces of passive elements are {words} the moment equilibrium (up to "
            f"{passive.max():.3g} {unit}, {trajectory.coordinates[c]})",
        )

    def rows(self, frame: Frame, motion: Motion) -> Rows:
        """One row per free coordinate, in N·m (rotation) or N (translation)."""
        produced = frame.moment_arms @ frame.muscle.tendon_force
        if frame.control.numel():
            produced += frame.actuator_generalized_forces @ frame.control
        target = frame.generalized_forces
        if self.passive_elements == "left_in":
            target = target + frame.data["passive"]
        return Rows(
            value=produced - target,
            lower=0.0,
            upper=0.0,
            names=motion.trajectory.coordinates,
            unit=["N·m" if angle else "N" for angle in motion.trajectory.is_rotational],
        )
