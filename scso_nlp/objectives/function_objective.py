"""A user's own cost, given as a function of the frame's symbols."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from scso_nlp.arguments import checked
from scso_nlp.frame import Frame
from scso_nlp.objectives.objective import FrameObjective


@dataclass(frozen=True, kw_only=True)
@checked
class FunctionObjective(FrameObjective):
    """A cost from a function of one frame.   weight [unit of the function's inverse]   depends on: one frame.

    Attributes
    ----------
    function : callable
        Takes a :class:`~scso_nlp.Frame`, returns a CasADi scalar; exact derivatives follow.
    label : str
        Name in reports; the function's own name by default.
    weight : float

    Examples
    --------
    >>> def largest_muscle(frame):
    ...     return frame.activation[0] ** 2
    >>> mixed = replace(problem, objectives=(scso.ActivationEffort(), largest_muscle))
    >>> sorted(scso.solve_trajectory(mixed).objective_terms)
    ['ActivationEffort', 'largest_muscle']
    """

    function: Callable[[Frame], ca.SX]
    label: str = ""
    weight: float = 1.0

    @property
    def name(self) -> str:
        """Label, or the function's name."""
        return self.label or getattr(self.function, "__name__", type(self).__name__)

    def value(self, frame: Frame) -> ca.SX:
        """Value of the function."""
        return self.function(frame)
