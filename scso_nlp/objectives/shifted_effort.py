"""Effort counted from an activation above zero: a null model of co-contraction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame
from scso_nlp.motion import Motion
from scso_nlp.objectives.activation_effort import LARGEST_EXPONENT, power
from scso_nlp.objectives.objective import FrameObjective, require_weights
from scso_nlp.validation import FloatArray, by_name


@dataclass(frozen=True, kw_only=True)
@checked
class ShiftedEffort(FrameObjective):
    r"""Distance of activations from a shift, instead of from zero.   weight [-]   depends on: one frame.

    .. math:: \sum_m |a_m - s_m|^p + \sum_j |c_j|^p

    A muscle that nothing asks for is active at its shift s, which makes antagonists work together whatever
    stability is: a null model for claims about it. Controls of reserves and other actuators are not shifted.

    Attributes
    ----------
    shift : float or mapping of str to float [-]
        For all muscles, or by name or pattern (0 where not named; later entries win).
    exponent : float [-]
        p, at least 2.
    weight : float
        Weight of the whole term among other objectives.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        A shift that is negative or not finite; an exponent below 2 or above 1000; a negative weight.
    NameMismatchError
        An unknown muscle.

    References
    ----------
    Forster, Simon, Augat and Claes (2004), J Biomech 37:577-581: a shift parameter in a quadratic criterion.

    Examples
    --------
    >>> shifted = replace(problem, objectives=(scso.ShiftedEffort(shift=0.1),))
    >>> bool((scso.solve_trajectory(shifted).activation[0] > solution.activation[0]).any())
    True
    """

    shift: float | Mapping[str, float] = 0.05
    exponent: float = 2.0
    weight: float = 1.0
    label: str = ""

    def __post_init__(self) -> None:
        shifts: Sequence[float] = (
            list(self.shift.values()) if isinstance(self.shift, Mapping) else [self.shift]
        )
        for shift in shifts:
            if not (math.isfinite(shift) and shift >= 0):
                raise ProblemError(f"shift is {shift:g}, expected a finite number of at least 0")
        if not 2 <= self.exponent <= LARGEST_EXPONENT:
            raise ProblemError(
                f"exponent is {self.exponent:g}, expected a number from 2 to {LARGEST_EXPONENT:g}"
            )
        require_weights(self.weight)

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Shift of every muscle, the same in every frame."""
        names = motion.trajectory.muscles
        shifts = (
            by_name("muscle", self.shift, names, default=0.0)
            if isinstance(self.shift, Mapping)
            else np.full(len(names), float(self.shift))
        )
        return {"shift": np.broadcast_to(shifts, (motion.trajectory.n_frames, len(names)))}

    def value(self, frame: Frame) -> ca.SX:
        """Effort of one frame."""
        away = ca.vertcat(frame.activation - frame.data["shift"], frame.control)
        return ca.sum1(power(away, self.exponent, frame.constant("exponent", [self.exponent])))
