"""Electromyography as a cost: activations stay near what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.activity import MuscleActivity
from scso_nlp.arguments import checked
from scso_nlp.frame import Frame
from scso_nlp.motion import Motion
from scso_nlp.objectives.objective import FrameObjective, require_weights
from scso_nlp.validation import FloatArray, by_name


@dataclass(frozen=True, kw_only=True)
@checked
class EmgTracking(FrameObjective):
    r"""Squared distance of activations from measured activity.   weight [-]   depends on: one frame.

    .. math:: \sum_g \frac{w_g}{n_g} \sum_{m \in g} (a_m - e_g)^2

    over the groups g of muscles with measured activity e, each of :math:`n_g` muscles of the model: a group
    counts once, however finely the model divides it. Muscles without a measurement are free.

    Attributes
    ----------
    activity : MuscleActivity
        From EMG by :func:`scso_nlp.emg.activity_of`.
    weights : mapping of str to float, or None [-]
        By group or pattern, 1 where not named; later entries win.
    weight : float
        Weight of the whole term among other objectives.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        A weight that is negative or not finite.
    NameMismatchError
        An unknown group, or a muscle that the motion does not have.
    DataError
        Activity that does not cover the motion.

    Notes
    -----
    Besides an effort it is the static form of an EMG-assisted model: the larger the weight, the more the
    measurement counts, while equilibrium is kept.

    References
    ----------
    Pizzolato et al. (2015), J Biomech 48:3929-3936: the EMG-assisted mode of CEINMS has such a term.

    Examples
    --------
    >>> activity = scso.MuscleActivity(
    ...     groups=("flexors",), muscles=(("biceps",),), time=[0.0, 10.0], values=[[0.4], [0.4]]
    ... )
    >>> tracked = scso.EmgTracking(activity=activity, weight=100.0)
    >>> near = scso.solve_trajectory(replace(problem, objectives=(*problem.objectives, tracked)))
    >>> bool(abs(near.activation[1, 1] - 0.4) < abs(solution.activation[1, 1] - 0.4))
    True
    """

    activity: MuscleActivity
    weights: Mapping[str, float] | None = None
    weight: float = 1.0
    label: str = ""

    def __post_init__(self) -> None:
        require_weights(self.weight, self.weights)

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give measured activity by muscle, and the weight of each muscle, 0 where nothing is measured."""
        positions, groups, measured = self.activity.of(motion)
        weights = by_name("group", self.weights or {}, self.activity.groups, default=1.0)
        shape = (motion.trajectory.n_frames, motion.muscles.n_muscles)
        target, share = np.zeros(shape), np.zeros(shape[1])
        target[:, positions] = measured
        share[positions] = weights[groups] / np.bincount(groups)[groups]
        return {"measured": target, "shares": np.broadcast_to(share, shape)}

    def value(self, frame: Frame) -> ca.SX:
        """Weighted squares of the distances of one frame."""
        return ca.dot(frame.data["shares"], (frame.activation - frame.data["measured"]) ** 2)
