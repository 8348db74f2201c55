"""Antagonists work at a given share of agonists: a null model of co-contraction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint, require_price
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows
from scso_nlp.motion import Motion
from scso_nlp.validation import FloatArray, IntArray, chosen_names, matches


@dataclass(frozen=True, kw_only=True)
@checked
class AntagonistRatio(FrameConstraint):
    r"""Moments against the net moment are at least a share of those along it.   depends on: one frame.

    .. math:: \sum_{m:\, s\, r_m < 0} |r_m| F_m \;\ge\; \text{ratio} \sum_{m:\, s\, r_m > 0} |r_m| F_m, \quad
              s = \operatorname{sign} M

    for each chosen coordinate, with its moment arms r and the moment M that muscles and actuators must
    produce; the rows are affine in the tendon forces. An empirical ratio says nothing of stability: a null
    model for claims about it.

    Attributes
    ----------
    ratio : float [-]
        At least 0 and below 1.
    coordinates : sequence of str or None
        Names or patterns; None for all rotations that muscles turn both ways in every frame.
    soft : float or None [objective per N·m]
        If given, the ratio may be missed at this price; the amounts are in
        ``solution.variables["<name>.missed"]``.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        A ratio outside of its range, a price that is not positive, no coordinate with antagonists.
    NameMismatchError
        An unknown coordinate.

    Notes
    -----
    The source has ratios of the activations of pairs of muscles at the shoulder; moments make it a rule for
    any joint.

    References
    ----------
    Brookham et al. (2011), J Biomech 44:1582-1587: an empirical ratio of co-activation as a constraint.

    Examples
    --------
    >>> ratio = scso.AntagonistRatio(ratio=0.1, coordinates=["trunk_flexion"])
    >>> ratio.coordinates
    ('trunk_flexion',)
    """

    ratio: float = 0.1
    coordinates: Sequence[str] | None = None
    soft: float | None = None
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "coordinates", chosen_names("coordinate", self.coordinates))
        if not 0 <= self.ratio < 1:
            raise ProblemError(f"ratio is {self.ratio:g}, expected a number of at least 0 and below 1")
        require_price(self.soft, "N·m")

    def _chosen(self, motion: Motion) -> IntArray:
        """Positions of the coordinates, shape (n_chosen,)."""
        trajectory = motion.trajectory
        if self.coordinates is not None:
            found = [matches("coordinate", name, trajectory.coordinates) for name in self.coordinates]
            return np.unique(np.concatenate(found))
        arms = trajectory.moment_arms
        both = ((arms > 0).any(axis=2) & (arms < 0).any(axis=2)).all(axis=0) & trajectory.is_rotational
        if not both.any():
            raise ProblemError(
                "no coordinate has muscles on both sides in every frame, expected at least one"
            )
        return np.flatnonzero(both)

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give what one newton of each muscle adds to each row [m]."""
        chosen = self._chosen(motion)
        trajectory = motion.trajectory
        sign = np.where(trajectory.generalized_forces[:, chosen, None] >= 0, 1.0, -1.0)
        along = sign * trajectory.moment_arms[:, chosen]
        return {"arms": np.where(along < 0, -along, -self.ratio * along)}

    def rows(self, frame: Frame, motion: Motion) -> Rows:
        """By how much antagonists exceed their share [N·m]."""
        names = [motion.trajectory.coordinates[c] for c in self._chosen(motion)]
        return Rows(
            value=frame.data["arms"] @ frame.muscle.tendon_force,
            lower=0.0,
            upper=np.inf,
            names=names,
            unit="N·m",
            price=self.soft,
        )
