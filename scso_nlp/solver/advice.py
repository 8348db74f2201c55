"""What to try where frames have no answer: settings by name, with values that were computed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.constraints.moment_equilibrium import MomentEquilibrium
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.muscle_models.stiffness_law import PUBLISHED_GAINS, ProportionalStiffness
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import Solution, Status
from scso_nlp.solver.feasible_gain import feasible_q
from scso_nlp.solver.optimality import OPTIMALITY_TOLERANCE
from scso_nlp.stability.rows import select_rows
from scso_nlp.trajectory import Skeleton, time_text
from scso_nlp.validation import FloatArray, shown_names

#: At most so many failed frames, the worst first, are asked for what they would need.
MOST_FRAMES = 100
#: Price of a missed level [objective per N·m/rad]: above what nearly every frame pays for keeping it.
PRICE = 1.0
#: Statuses of frames in which rows cannot be kept.
_OUT_OF_REACH = (Status.INFEASIBLE, Status.LOCALLY_INFEASIBLE)


@dataclass(frozen=True, kw_only=True)
class NextStep:
    """A setting that would help.

    Attributes
    ----------
    setting : str
        Its key in settings files; in Python the argument of that name.
    value : str
    effect : str
        What it does, in words.
    """

    setting: str
    value: str
    effect: str

    def __str__(self) -> str:
        return f"{self.setting} = {self.value}: {self.effect}"


def next_steps(solution: Solution) -> tuple[NextStep, ...]:
    """Say what would give the failed frames of a solution an answer, what helps most first.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    tuple of NextStep
        None where no frame failed for rows that are out of reach, or for costs that hide each other.
    """
    stronger = _less_control(solution)
    failed = [k for k, status in enumerate(solution.frame_status) if status in _OUT_OF_REACH]
    if not failed:
        return stronger
    worst = [shortfall.frame for shortfall in solution.shortfalls if shortfall.frame in set(failed)]
    asked = sorted(tuple(dict.fromkeys((*worst, *failed)))[:MOST_FRAMES])
    problem = solution.problem
    hard = tuple(t for t in problem.constraints if isinstance(t, StabilityConstraint) and t.soft is None)
    if not hard:
        return (*_more_strength(solution, asked), *stronger)
    others = tuple(t for t in problem.constraints if not isinstance(t, StabilityConstraint))
    turned = _about_turned_axes(hard, problem.motion.trajectory.skeleton)
    fewer = () if turned == hard else (_fewer_axes(turned),)
    hard = turned
    only_hard = replace(problem.frames(asked), constraints=(*others, *hard), observed=())
    laws = [law for term in hard if isinstance(law := term.stiffness_law, ProportionalStiffness)]
    try:
        gain = feasible_q(only_hard) if len(laws) == len(hard) else np.full(len(asked), np.inf)
    # rows that are not affine
    except ProblemError:
        gain = np.full(len(asked), np.inf)
    beyond = [k for k, q in zip(asked, gain, strict=True) if math.isnan(q)]
    return (
        *_more_strength(solution, beyond),
        *fewer,
        *_more_stiffness(gain, len(failed), "with these axes, " if fewer else ""),
        *(_lower_level(only_hard, hard, laws) if np.isfinite(gain).any() else ()),
        *(() if len(beyond) == len(asked) else (_price(),)),
        *stronger,
    )


def rounded_up(gain: float) -> float:
    """Round a gain up to two digits.

    Parameters
    ----------
    gain : float [-]

    Returns
    -------
    float [-]
    """
    if not gain > 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(gain)) - 1)
    return float(f"{math.ceil(gain / unit * (1 - 1e-9)) * unit:.2g}")


def _more_strength(solution: Solution, frames: Sequence[int]) -> tuple[NextStep, ...]:
    """Name the coordinates whose moments no activation reaches."""
    names = {term.name for term in solution.problem.constraints if isinstance(term, MomentEquilibrium)}
    rows = dict.fromkeys(
        s.row for s in solution.shortfalls if s.frame in set(frames) and s.constraint in names
    )
    if not rows:
        return ()
    return (
        NextStep(
            setting="actuators",
            value="RESERVES.xml",
            effect=f"muscles and actuators cannot make the moments of {shown_names(tuple(rows))} in "
            f"{len(frames)} frame{'s' if len(frames) > 1 else ''}, stable or not: reserves would",
        ),
    )


def _less_control(solution: Solution) -> tuple[NextStep, ...]:
    """Name the actuator with the largest control where costs are too far apart for an optimum."""
    is_hidden = np.array([status is Status.NOT_OPTIMAL for status in solution.frame_status])
    is_hidden &= np.nan_to_num(solution.optimality.imbalance) > OPTIMALITY_TOLERANCE
    control = np.abs(np.where(is_hidden[:, None], np.nan_to_num(solution.control), 0.0))
    if not control.max(initial=0.0) > 1:
        return ()
    k, a = np.unravel_index(control.argmax(), control.shape)
    motion = solution.problem.motion
    force = motion.actuators.optimal_force[a] * control[k, a]
    effect = (
        f"{motion.actuators.actuators[a]} has a control of {control[k, a]:.4g} at t = "
        f"{time_text(motion.trajectory.time[k])} s, whose cost hides what muscles cost: an optimal_force of "
        f"{rounded_up(float(force)):g} would bring it to one"
    )
    return (NextStep(setting="actuators", value="RESERVES.xml", effect=effect),)


def _about_turned_axes(
    hard: tuple[StabilityConstraint, ...], skeleton: Skeleton | None
) -> tuple[StabilityConstraint, ...]:
    """Leave out axes that were named, but that muscles cannot make stable, where this leaves some."""

    def turned(term: StabilityConstraint) -> StabilityConstraint:
        is_by_row = isinstance(term.level, Mapping) or term.passive_stiffness
        if not isinstance(term, JointStability) or term.axes is None or skeleton is None or is_by_row:
            return term
        try:
            rows = select_rows(skeleton, term.joints, None)[0]
        # a joint that is named has no such axis
        except DataError:
            return term
        axes = tuple(axis for axis in term.axes if any(row.endswith(f"_{axis}") for row in rows))
        return replace(term, axes=axes) if axes else term

    return tuple(turned(term) for term in hard)


def _fewer_axes(terms: Sequence[StabilityConstraint]) -> NextStep:
    axes = dict.fromkeys(
        axis for term in terms if isinstance(term, JointStability) for axis in term.axes or ()
    )
    effect = "no free coordinate turns the other axes, so that muscles cannot be asked to keep them stable"
    return NextStep(setting="axes", value=",".join(axes), effect=effect)


def _more_stiffness(gain: FloatArray, n_failed: int, condition: str) -> tuple[NextStep, ...]:
    known = gain[np.isfinite(gain)]
    if not known.size:
        return ()
    least = float(known.max())
    whole = (
        "the failed frames" if n_failed == gain.size else f"the {gain.size} worst of {n_failed} failed frames"
    )
    effect = f"{condition}at q = {least:.4g} and above {whole} have an answer"
    if known.size < gain.size:
        effect = f"{condition}at q = {least:.4g} and above {known.size} of {whole} have an answer"
    if least > PUBLISHED_GAINS[1]:
        effect += "; published gains are {:g} to {:g}".format(*PUBLISHED_GAINS)
    return (NextStep(setting="q", value=f"{rounded_up(least):g}", effect=effect),)


def _lower_level(
    problem: MuscleForceProblem,
    hard: Sequence[StabilityConstraint],
    laws: Sequence[ProportionalStiffness],
) -> tuple[NextStep, ...]:
    """Say so where level 0 would do at the gain in use."""
    terms = tuple(replace(term, level=0.0) for term in hard)
    is_raised = any(np.max(term.by_row(term.level, term.row_names(problem.motion))) > 0 for term in hard)
    if not is_raised:
        return ()
    least = min(float(law.gains(problem.motion.trajectory.muscles).min()) for law in laws)
    kept = tuple(term for term in problem.constraints if term not in hard)
    enough = feasible_q(replace(problem, constraints=(*kept, *terms))) <= least
    if not enough.any():
        return ()
    some = "they" if enough.all() else f"{enough.sum()} of {enough.size} of them"
    return (NextStep(setting="level", value="0", effect=f"at level 0 {some} have an answer"),)


def _price() -> NextStep:
    effect = "levels may be missed at this price per N·m/rad, and what is missed is told"
    return NextStep(setting="soft", value=f"{PRICE:g}", effect=effect)
