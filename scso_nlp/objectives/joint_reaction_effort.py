"""Joint loads as a cost: squared forces that joints carry, in body weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame
from scso_nlp.joint_reactions import required
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.objectives.objective import FrameObjective, require_weights
from scso_nlp.validation import FloatArray, by_name, chosen_names


@dataclass(frozen=True, kw_only=True)
@checked
class JointReactionEffort(FrameObjective):
    r"""Mean square of joint forces in body weights.   weight [-]   depends on: one frame.

    .. math:: \frac1n \sum_{j=1}^n w_j \left(\frac{|f_j|}{BW}\right)^2

    with the force f of each joint's reaction and the weight BW of the model: about 10 for a joint that
    carries three body weights. Convex and quadratic in tendon forces and controls.

    Attributes
    ----------
    joints : sequence of str or None
        Names or patterns; None for all joints that the motion was read with.
    weights : mapping of str to float, or None [-]
        By joint or pattern, 1 where not named; later entries win.
    weight : float
        Weight of the whole term among other objectives.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        A weight that is negative or not finite; a motion read without joint reactions, or without mass.
    NameMismatchError
        An unknown joint.

    References
    ----------
    Dembia et al. (2020), PLoS Comput Biol 16:e1008493: effort and knee load minimized together.

    Examples
    --------
    >>> cost = scso.JointReactionEffort(joints=["elbow"], weight=0.1)
    >>> elbow = scso.load_motion(example_folder("elbow") / "setup.xml", prepare_for=[cost])
    >>> elbow.trajectory.joint_reactions.joints
    ('elbow',)
    """

    joints: Sequence[str] | None = None
    weights: Mapping[str, float] | None = None
    weight: float = 1.0
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", chosen_names("joint", self.joints))
        require_weights(self.weight, self.weights)

    @property
    def needs(self) -> MotionNeeds:
        """Reactions of the joints."""
        return MotionNeeds(joint_reactions=tuple(self.joints or ("all",)))

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give forces of joints [BW], each times the root of its share of the mean."""
        reactions = required(motion.trajectory.joint_reactions, self.joints)
        if not reactions.body_weight > 0:
            raise ProblemError(
                "the model weighs nothing, so that joint forces cannot be told in body weights"
            )
        weights = np.ones(len(reactions.joints))
        if self.weights is not None:
            weights = by_name("joint", self.weights, reactions.joints, default=1.0)
        share = np.repeat(np.sqrt(weights / weights.size), 3) / reactions.body_weight
        forces = reactions.forces("child", "ground")
        return {name: share.reshape(-1, *[1] * (part.ndim - 2)) * part for name, part in forces.items()}

    def value(self, frame: Frame) -> ca.SX:
        """Mean square of the forces of one frame."""
        data = frame.data
        forces = data["per_tendon_force"] @ frame.muscle.tendon_force + data["per_control"] @ frame.control
        return ca.sumsqr(forces + data["constant"])
