"""The problem as data: one motion, a muscle model, objectives and constraints."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.arguments import checked_as
from scso_nlp.constraints.constraint import FrameConstraint, FramePairConstraint
from scso_nlp.constraints.moment_equilibrium import MomentEquilibrium
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.display import card, table, without_defaults
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Term
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.objectives.function_objective import FunctionObjective
from scso_nlp.objectives.objective import FrameObjective, FramePairObjective


@dataclass(frozen=True, kw_only=True)
@checked_as(objectives=Iterable)
class MuscleForceProblem:
    r"""Find activations and controls of every frame that cost least and keep every row.

    .. math::
        \min \sum_t \text{objectives} \quad\text{s.t. constraints},\;
        a_\min \le a \le a_\max,\; c_\min \le c \le c_\max

    Attributes
    ----------
    motion : Motion
    muscle_model : MuscleModel
    objectives : tuple of FrameObjective, FramePairObjective or functions of a frame
        A function becomes a :class:`FunctionObjective`.
    constraints : tuple of FrameConstraint or FramePairConstraint
    observed : tuple of FrameConstraint
        Constraints without unknowns of their own whose rows are evaluated at the solution, but need not be
        kept. One that bears the name of a constraint that is kept gives way to it.

    Raises
    ------
    ProblemError
        No objective, two terms of one name, or something that is no term.

    Examples
    --------
    >>> problem.coupled_terms, [term.name for term in problem.terms]
    ((), ['NoPhysiology', 'ActivationEffort', 'MomentEquilibrium', 'JointStability'])
    >>> [term.name for term in problem.without_stability().observed]
    ['JointStability']
    """

    motion: Motion
    muscle_model: MuscleModel
    objectives: tuple[FrameObjective | FramePairObjective, ...]
    constraints: tuple[FrameConstraint | FramePairConstraint, ...] = (MomentEquilibrium(),)
    observed: tuple[FrameConstraint, ...] = ()

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "objectives", tuple(as_objective(term) for term in self.objectives))
        set_field(self, "constraints", tuple(self.constraints))
        kept = {term.name for term in self.constraints}
        set_field(self, "observed", tuple(t for t in self.observed if t.name not in kept))
        if not self.objectives:
            raise ProblemError("the problem has no objective, expected at least one, e.g. ActivationEffort()")
        names = [term.name for term in self.terms]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ProblemError(
                f"two terms are called {', '.join(twice)}; give one of them a label of its own"
            )

    @property
    def terms(self) -> tuple[Term, ...]:
        """Muscle model, objectives, constraints and observed constraints, in this order."""
        return (self.muscle_model, *self.objectives, *self.constraints, *self.observed)

    @property
    def coupled_terms(self) -> tuple[str, ...]:
        """Names of the terms that couple frames."""
        return tuple(t.name for t in self.terms if isinstance(t, FramePairObjective | FramePairConstraint))

    @property
    def stability_terms(self) -> tuple[StabilityConstraint, ...]:
        """Stability constraints, kept or observed."""
        return tuple(t for t in self.terms if isinstance(t, StabilityConstraint))

    def frames(self, start: int | Iterable[int], stop: int | None = None) -> MuscleForceProblem:
        """Keep some frames, as :meth:`MotionTrajectory.frames`."""
        return replace(self, motion=self.motion.frames(start, stop))

    def without_coupling(self) -> MuscleForceProblem:
        """Drop the terms that couple frames, explicitly."""
        return replace(
            self,
            objectives=tuple(t for t in self.objectives if not isinstance(t, FramePairObjective)),
            constraints=tuple(t for t in self.constraints if not isinstance(t, FramePairConstraint)),
        )

    def without_stability(self) -> MuscleForceProblem:
        """Only observe the stability rows: plain static optimization of the same motion."""
        kept = tuple(t for t in self.constraints if not isinstance(t, StabilityConstraint))
        left = tuple(t for t in self.constraints if isinstance(t, StabilityConstraint))
        return replace(self, constraints=kept, observed=(*left, *self.observed))

    def __str__(self) -> str:
        muscles, actuators = self.motion.muscles, self.motion.actuators
        lines = [
            self.motion.trajectory.summary(),
            f"  unknowns    a ({muscles.n_muscles}), c ({actuators.n_actuators}) in every frame",
            f"  forces      {without_defaults(self.muscle_model)}",
        ]
        lines += [f"  minimise    {without_defaults(term)}" for term in self.objectives]
        lines += [f"  subject to  {without_defaults(term)}" for term in self.constraints]
        lines += [f"  observed    {without_defaults(term)}" for term in self.observed]
        if muscles.n_muscles:
            low, high = float(np.min(muscles.min_activation)), float(np.max(muscles.max_activation))
            lines.append(f"  bounds      {low:g} <= a <= {high:g}, controls as in the model")
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        heading, *lines = str(self).splitlines()
        return card(heading, table(("", ""), [(line[:13], line[13:]) for line in lines]))


def as_objective(term: object) -> FrameObjective | FramePairObjective:
    """Return an objective as it is, a function of a frame as one; raise ProblemError for all else."""
    if isinstance(term, FrameObjective | FramePairObjective):
        return term
    if callable(term):
        return FunctionObjective(function=term)
    raise ProblemError(f"{term!r} is no objective, expected a FrameObjective or a function of a frame")
