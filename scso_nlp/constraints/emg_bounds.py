"""Electromyography as a bound: activations stay within a band about what was measured."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.activity import MuscleActivity
from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint, require_price
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows
from scso_nlp.motion import Motion
from scso_nlp.validation import FloatArray


@dataclass(frozen=True, kw_only=True)
@checked
class EmgBounds(FrameConstraint):
    r"""Activations stay within a band about measured activity.   depends on: one frame.

    .. math:: e_g - \text{below} \le a_m \le e_g + \text{above}

    for every muscle m of a group g with measured activity e; the rows are affine.

    Attributes
    ----------
    activity : MuscleActivity
        From EMG by :func:`scso_nlp.emg.activity_of`. Where it lies outside the muscle's own bounds of
        activation, the nearest of these counts.
    below, above : float [-]
        How far activation may be below and above. Infinite: no bound on that side.
    soft : float or None [objective per unit of activation]
        If given, a bound may be missed at this price; the amounts are in
        ``solution.variables["<name>.missed"]``.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        A width that is negative, two infinite ones, a price that is not positive.
    NameMismatchError
        A muscle that the motion does not have.
    DataError
        Activity that does not cover the motion.

    References
    ----------
    Uhlrich et al. (2022), Sci Rep 12:9842: bounds on activations from EMG in static optimization.

    Examples
    --------
    >>> activity = scso.MuscleActivity(
    ...     groups=("flexors",), muscles=(("biceps",),), time=[0.0, 10.0], values=[[0.2], [0.2]]
    ... )
    >>> near = scso.EmgBounds(activity=activity, below=0.05, above=0.05, soft=10.0)
    >>> held = scso.solve_trajectory(replace(problem, constraints=(*problem.constraints, near)))
    >>> held["biceps"].activation.round(2)
    array([0.15, 0.15, 0.22, 0.25, 0.25, 0.25, 0.58])
    """

    activity: MuscleActivity
    below: float = 0.1
    above: float = 0.1
    soft: float | None = None
    label: str = ""

    def __post_init__(self) -> None:
        for name, value in (("below", self.below), ("above", self.above)):
            if not value >= 0:
                raise ProblemError(f"{name} is {value:g}, expected a number of at least 0")
        if math.isinf(self.below) and math.isinf(self.above):
            raise ProblemError("below and above are both infinite, expected at least one bound")
        require_price(self.soft, "unit of activation")

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give measured activity of the muscles that have one, within their bounds."""
        positions, _, measured = self.activity.of(motion)
        low, high = motion.muscles.min_activation[positions], motion.muscles.max_activation[positions]
        return {"measured": np.clip(measured, low, high)}

    def rows(self, frame: Frame, motion: Motion) -> Rows:
        """How far each activation is within its band [-]: its lower sides, then its upper ones."""
        positions = self.activity.of(motion)[0].tolist()
        above_measured = frame.activation[positions] - frame.data["measured"]
        values, names = [], []
        for side, distance, width in (
            ("low", above_measured, self.below),
            ("high", -above_measured, self.above),
        ):
            if math.isfinite(width):
                values.append(distance + width)
                names += [f"{motion.trajectory.muscles[m]} {side}" for m in positions]
        return Rows(
            value=ca.vertcat(*values),
            lower=0.0,
            upper=np.inf,
            names=names,
            unit="-",
            scale=0.1,
            price=self.soft,
        )
