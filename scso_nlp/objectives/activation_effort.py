"""Muscle effort: the sum of activations to a power, over muscles and other actuators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows, VariableSpec
from scso_nlp.motion import Motion
from scso_nlp.objectives.objective import FrameObjective, require_weights
from scso_nlp.validation import FloatArray, by_name

#: Finite exponents above this one are refused: 0.5 to that power is near the end of the doubles.
LARGEST_EXPONENT = 1000.0
#: Exponents above this one are approached from half the exponent: a^p is flat far from the optimum.
_STEEP_EXPONENT = 4.0


@dataclass(frozen=True, kw_only=True)
@checked
class ActivationEffort(FrameObjective):
    r"""Effort of muscles and actuators in each frame.   weight [-]   depends on: one frame.

    .. math:: \sum_m w_m |a_m|^p + \sum_j w_j |c_j|^p

    With `exponent` infinite it is the largest :math:`w_m |a_m|`, :math:`w_j |c_j|`, in epigraph form.

    Attributes
    ----------
    exponent : float
        :math:`p`, any real number of at least 1, or ``math.inf`` for min/max.
    weights : None, "volume", "pcsa" or mapping of str to float
        Weight of each muscle and actuator, 1 by default. ``"volume"`` and ``"pcsa"`` weigh muscles by
        maximum isometric force × optimal fiber length and by maximum isometric force, divided by the
        mean of all muscles. A mapping goes from names or patterns with ``*``, ``?`` or ``[...]`` to
        weights; later entries win.
    weight : float
        Weight of the whole term among other objectives.
    label : str
        Name in reports, needed where a problem has two of these.

    Raises
    ------
    ProblemError
        Exponent below 1, not a number, or finite and above 1000; a negative weight; negative activations
        allowed at an exponent below 2 or infinite.
    NameMismatchError
        A name in `weights` that fits no muscle and no actuator.

    Notes
    -----
    OpenSim's static optimization has the same sum with all weights 1, reserves included.

    References
    ----------
    Crowninshield and Brand (1981), J Biomech 14:793-801; Akhavanfar et al. (2019), eq. 1; for min/max
    Rasmussen et al. (2001), J Biomech 34:409-415.

    Examples
    --------
    >>> minimax = replace(problem, objectives=(scso.ActivationEffort(exponent=float("inf")),))
    >>> scso.solve_trajectory(minimax).activation[1].round(6)
    array([0.266667, 0.266667, 0.266667])
    >>> by_name = scso.ActivationEffort(weights={"*": 1.0, "biceps": 10.0})
    """

    exponent: float = 2.0
    weights: str | Mapping[str, float] | None = None
    weight: float = 1.0
    label: str = ""

    def __post_init__(self) -> None:
        if not self.exponent >= 1:
            raise ProblemError(
                f"exponent is {self.exponent:g}, expected a number of at least 1 (or infinity)"
            )
        if LARGEST_EXPONENT < self.exponent < math.inf:
            raise ProblemError(
                f"exponent is {self.exponent:g}, expected at most {LARGEST_EXPONENT:g}: powers of small "
                "activations vanish among the doubles; infinity is min/max"
            )
        require_weights(self.weight, self.weights if isinstance(self.weights, Mapping) else None)
        if isinstance(self.weights, str) and self.weights not in ("volume", "pcsa"):
            raise ProblemError(f"weights is {self.weights!r}, expected 'volume', 'pcsa' or a mapping")

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Weights of muscles and actuators, the same in every frame."""
        muscles = motion.muscles
        negative = np.flatnonzero(muscles.min_activation < 0)
        if negative.size and not 2 <= self.exponent < math.inf:
            first = int(negative[0])
            raise ProblemError(
                f"exponent {self.exponent:g} needs activations of at least 0, but min_activation of "
                f"{muscles.muscles[first]!r} is {muscles.min_activation[first]:g}; raise the bound, or take "
                "a finite exponent of at least 2"
            )
        weights = self._weights(motion)
        return {"weights": np.broadcast_to(weights, (motion.trajectory.n_frames, weights.size))}

    def _weights(self, motion: Motion) -> FloatArray:
        muscles, actuators = motion.muscles, motion.actuators
        names = muscles.muscles + actuators.actuators
        weights = np.ones(len(names))
        if isinstance(self.weights, str):
            size = muscles.max_isometric_force.copy()
            if self.weights == "volume":
                size = size * muscles.optimal_fiber_length
            weights[: muscles.n_muscles] = size / size.mean()
        elif self.weights is not None:
            return by_name("muscle or actuator", self.weights, names, default=1.0)
        return weights

    def unseen(self, motion: Motion) -> tuple[str, ...]:
        """Weights by size are numbers."""
        if self.weights == "volume":
            return ("max_isometric_force", "optimal_fiber_length")
        return ("max_isometric_force",) if self.weights == "pcsa" else ()

    def variables(self, motion: Motion) -> tuple[VariableSpec, ...]:
        """Largest effort for min/max; both signs of controls apart where the power has no curvature at 0."""
        if math.isinf(self.exponent):
            return (VariableSpec(name="largest", labels=("largest_effort",), lower=0.0, guess=1.0),)
        if self.exponent < 2 and motion.actuators.n_actuators:
            names = motion.actuators.actuators
            return tuple(
                VariableSpec(
                    name=sign, labels=tuple(f"{name}_{sign}" for name in names), lower=0.0, guess=1.0
                )
                for sign in ("pull", "push")
            )
        return ()

    def value(self, frame: Frame) -> ca.SX:
        """Effort of one frame."""
        n_muscles = frame.activation.numel()
        weights = frame.data["weights"]
        exponent = frame.constant("exponent", [self.exponent])
        if math.isinf(self.exponent):
            return frame.variables["largest"]
        effort = ca.SX(0)
        if n_muscles:
            effort += ca.dot(weights[:n_muscles], power(frame.activation, self.exponent, exponent))
        if frame.control.numel():
            parts = frame.variables
            size = parts["pull"] + parts["push"] if self.exponent < 2 else frame.control
            effort += ca.dot(weights[n_muscles:], power(size, self.exponent, exponent))
        return effort

    def efforts(
        self, motion: Motion, activation: FloatArray, control: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Split the effort of given frames; of min/max, where there is no sum, the larger part is all of it.

        Parameters
        ----------
        motion : Motion
        activation : ndarray, shape (n_frames, n_muscles) [-]
        control : ndarray, shape (n_frames, n_actuators) [-]

        Returns
        -------
        of muscles, of actuators : ndarray, shape (n_frames,) [-]
        """
        weights = np.split(self._weights(motion), [motion.muscles.n_muscles])
        parts = zip(weights, (activation, control), strict=True)
        if math.isinf(self.exponent):
            muscles, actuators = ((w * np.abs(x)).max(axis=1, initial=0.0) for w, x in parts)
        else:
            muscles, actuators = (np.abs(x) ** self.exponent @ w for w, x in parts)
        return self.weight * muscles, self.weight * actuators

    def rows(self, frame: Frame) -> Rows | None:
        """Ties of the term's own unknowns to activations and controls."""
        if math.isinf(self.exponent):
            unknowns = ca.vertcat(frame.activation, frame.control)
            effort = frame.data["weights"] * unknowns
            largest = frame.variables["largest"]
            value = ca.vertcat(largest - effort, largest + effort[frame.activation.numel() :])
            names = [f"largest_effort_{i}" for i in range(value.numel())]
            return Rows(value=value, lower=0.0, upper=np.inf, names=names, unit="-")
        if "pull" in frame.variables:
            value = frame.control - frame.variables["pull"] + frame.variables["push"]
            names = [f"signs_{i}" for i in range(value.numel())]
            return Rows(value=value, lower=0.0, upper=0.0, names=names, unit="-")
        return None

    @property
    def degree(self) -> float:
        """The exponent; 1 for min/max."""
        return self.exponent if math.isfinite(self.exponent) else 1.0

    def gentler(self) -> ActivationEffort | None:
        """Half the exponent, for exponents whose powers are flat far from the optimum."""
        if math.isinf(self.exponent) or self.exponent <= _STEEP_EXPONENT:
            return None
        return replace(self, exponent=max(2.0, self.exponent / 2))


def power(size: ca.SX, exponent: float, symbol: ca.DM | ca.SX) -> ca.SX:
    """|size|^p; with the modulus its first and second derivatives are finite at 0 for p >= 2.

    A symbol that stands for the exponent adds what is zero for its number: derivatives by it are not zero.
    """
    if isinstance(symbol, ca.SX):
        at_zero = size == 0
        other = ca.fabs(ca.if_else(at_zero, 1.0, size))
        return power(size, exponent, ca.DM(exponent)) + (1 - at_zero) * (other**symbol - other**exponent)
    if exponent == 1:
        return size
    if exponent == 2:
        return size * size
    if exponent < 2:
        return size**exponent
    return ca.fabs(size) ** exponent
