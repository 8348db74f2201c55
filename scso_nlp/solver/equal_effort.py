"""The strength of a term at which a motion takes a given effort: alternatives compared on equal terms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.constraint import FrameConstraint, FramePairConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.objectives.activation_effort import ActivationEffort
from scso_nlp.objectives.objective import FrameObjective, FramePairObjective
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import Solution
from scso_nlp.solver.ipopt import SolverOptions
from scso_nlp.solver.verbs import solve_trajectory

#: Width of the interval in which the strength is known, at last, as a share of it [-].
_NARROW = 1e-8
#: A term is missed at its price by more than this, in the unit of its rows.
_MISSED = 1e-6

Alternative = FrameObjective | FramePairObjective | FrameConstraint | FramePairConstraint


@dataclass(frozen=True, kw_only=True)
@checked
class EqualEffort:
    """A term at the strength that takes a given effort.

    Attributes
    ----------
    strength : float
    effort : float [-]
        What the muscles' activations cost then, over all frames.
    solution : Solution
    """

    strength: float
    effort: float
    solution: Solution


@checked
def at_effort(
    problem: MuscleForceProblem,
    effort: float,
    alternative: Callable[[float], Alternative],
    *,
    strongest: float = 1.0,
    tolerance: float = 1e-3,
    options: SolverOptions | None = None,
) -> EqualEffort:
    r"""Find the strength of a term at which the muscles take a given effort.

    Parameters
    ----------
    problem : MuscleForceProblem
        Without the term, with one :class:`ActivationEffort`, by which effort is measured:
        :math:`\sum_t \sum_m w_m a_m^p`.
    effort : float [-]
        At least what the problem takes as it is.
    alternative : callable
        Makes the term from its strength, e.g. ``lambda s: ActivationFloor(floor=s)``. A constraint is added;
        an objective stands instead of the problem's effort. More strength must not take less effort.
    strongest : float
        Largest strength that is tried.
    tolerance : float [-]
        Share by which the effort may be off.
    options : SolverOptions, optional

    Returns
    -------
    EqualEffort

    Raises
    ------
    ProblemError
        A problem without one effort; an effort below what the problem takes, or beyond what the term can
        take: at `strongest`, as where it is rather missed at its price, or because frames have no answer.
    SolveFailed
        The problem itself is not solved.

    Notes
    -----
    By halving. Frames are solved together, with one strength for all: what a rule for a whole motion means.
    Terms that may be missed at a price take less effort again when they are too strong: what is found is
    where effort rises with strength.

    Examples
    --------
    >>> found = scso.at_effort(
    ...     problem.without_stability(), 1.001 * solution.objective, lambda s: scso.ActivationFloor(floor=s)
    ... )
    >>> bool(found.solution.activation.min() > found.strength - 1e-6)
    True
    """
    measures = [term for term in problem.objectives if isinstance(term, ActivationEffort)]
    if len(measures) != 1:
        raise ProblemError(f"the problem has {len(measures)} ActivationEffort, expected one to measure by")

    def taken(solution: Solution) -> float:
        """Effort of the muscles over all frames, infinite where some frame has no answer."""
        if not solution.is_solved.all():
            return np.inf
        return float(measures[0].efforts(problem.motion, solution.activation, solution.control)[0].sum())

    def solved(strength: float) -> Solution:
        term = alternative(strength)
        if isinstance(term, FrameObjective | FramePairObjective):
            others = tuple(t for t in problem.objectives if t is not measures[0])
            changed = replace(problem, objectives=(term, *others))
        else:
            changed = replace(problem, constraints=(*problem.constraints, term))
        return solve_trajectory(changed, options=options, on_failure="return")

    least = taken(solve_trajectory(problem, options=options))
    if effort < least * (1 - tolerance):
        raise ProblemError(f"effort is {effort:g}, expected at least the {least:g} of the problem as it is")
    weak, strong = 0.0, strongest
    found = solved(strongest)
    most = taken(found)
    if most < effort * (1 - tolerance):
        missed = found.variables.get(f"{alternative(strongest).name}.missed", np.zeros(1)).max() > _MISSED
        remedy = (
            ", where it is missed at its price (soft): raise the price or lower " if missed else ": raise "
        )
        raise ProblemError(
            f"effort is {effort:g}, but the term takes {most:g} at its strongest, {strongest:g}{remedy}that"
        )
    strength, reached = strongest, most
    while strong - weak > _NARROW * strong:
        if abs(reached - effort) <= tolerance * effort:
            return EqualEffort(strength=strength, effort=reached, solution=found)
        if reached > effort:
            strong = strength
        else:
            weak = strength
        strength = 0.5 * (weak + strong)
        found = solved(strength)
        reached = taken(found)
    raise ProblemError(
        f"effort {effort:g} is not reached: at strength {strong:g} frames have no answer, or it jumps there"
    )
