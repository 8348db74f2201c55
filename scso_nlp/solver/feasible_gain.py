"""The gain q of muscle stiffness k = q F / L from which on a frame has an answer at all.

Stability rows are affine in the forces and in q, and never fall with q: whatever is stable at some gain is
stable at every larger one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.messages import STAGES
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solver.conic import highest_eigenvalues
from scso_nlp.solver.local_model import LocalModel
from scso_nlp.solver.reach import OwnRows, affine_model, own_rows
from scso_nlp.solver.threads import one_thread
from scso_nlp.validation import BoolArray, FloatArray

#: A larger gain rests on forces that the solver left at its bounds, and counts as infinite [-].
LARGEST_GAIN = 1e4

#: Halvings of the interval in which the full Hessian's critical gain is sought: 1e-14 of the largest.
_HALVINGS = 60

#: The least feasible gain is found when a round lowers it by less than this share [-]; and most rounds.
_GAIN_TOLERANCE, _MOST_ROUNDS = 1e-5, 50

#: Rows may be short by this much where all are raised [N·m/rad]: tolerance of the linear programs.
_ROUNDING = 1e-5


@checked
def feasible_q(problem: MuscleForceProblem) -> FloatArray:
    r"""Find the least gain q at which every frame has an answer: activations within bounds keep all rows.

    .. math:: q^* = \min_x \max_i \frac{\text{level}_i - S_i(x, 0)}{S_i(x, 1) - S_i(x, 0)}

    over the unknowns x that keep all other rows, S_i(x, q) being the stability of row i. From forces that
    keep the rows at some q follows a smaller one at which they still do; at that q the rows are raised
    together again, and so on.

    Parameters
    ----------
    problem : MuscleForceProblem
        With stability constraints, soft ones taken as hard; each is looked at alone, with all its rows. Their
        own stiffness is not used: gains are the same for all muscles. Terms that couple frames are left out.

    Returns
    -------
    ndarray, shape (n_frames,) [-]
        0 where muscle stiffness is not needed, infinite where no gain is enough, NaN where the other rows
        have no answer.

    Raises
    ------
    ProblemError
        No stability constraint; rows that are not affine in the unknowns.

    References
    ----------
    Crouzeix and Ferland (1991), Math Program 52:191-207: the algorithm of Dinkelbach type, for rows.

    Examples
    --------
    >>> bool((scso.feasible_q(problem) <= scso.critical_q(problem) + 1e-6).all())
    True
    """
    if not problem.stability_terms:
        raise ProblemError("the problem has no stability constraint whose least feasible q could be found")
    STAGES.info("finding the least q of %d frames", problem.motion.n_frames)
    return np.max([_feasible_gain(problem, term) for term in problem.stability_terms], axis=0)


def _feasible_gain(problem: MuscleForceProblem, term: StabilityConstraint) -> FloatArray:
    models = [affine_model(problem, replace(term, stiffness=None, q=q)) for q in (0.0, 1.0)]
    if models[0].matrices:
        return _feasible_gain_of_matrix(*models)
    without, at_one = (own_rows(model, term.name) for model in models)
    return np.array([_feasible_gain_of_rows(without, at_one, k) for k in range(problem.motion.n_frames)])


def _feasible_gain_of_rows(without: OwnRows, at_one: OwnRows, k: int) -> float:
    """Raise all rows of a frame together at smaller and smaller gains, by linear programs."""
    slope, gained = at_one.gain[k] - without.gain[k], at_one.constant[k] - without.constant[k]
    missing, limits = without.block.lower - without.constant[k], without.limits(k)
    least = {
        "A_eq": np.column_stack([limits["A_eq"], np.zeros(len(limits["b_eq"]))]),
        "b_eq": limits["b_eq"],
        "bounds": np.vstack([limits["bounds"], [-np.inf, LARGEST_GAIN]]),
    }
    others = np.column_stack([limits["A_ub"], np.zeros(len(limits["b_ub"]))])
    q, weight = LARGEST_GAIN, np.ones(len(slope))
    cost = np.append(np.zeros(slope.shape[1]), -1.0)
    for rounds in range(_MOST_ROUNDS):
        raised = np.column_stack([-without.gain[k] - q * slope, weight])
        answer = linprog(
            cost,
            A_ub=np.vstack([others, raised]),
            b_ub=np.concatenate([limits["b_ub"], q * gained - missing]),
            method="highs",
            **least,
        )
        if not answer.success:
            return q if rounds else np.nan
        if not rounds and answer.fun > _ROUNDING:
            return np.inf
        x = answer.x[:-1]
        support = slope @ x + gained
        smaller = gain_for(missing - without.gain[k] @ x, support).max(initial=0.0)
        if smaller >= (1 - _GAIN_TOLERANCE) * q:
            break
        q, weight = smaller, np.maximum(support, _ROUNDING)
    return float(q)


def _feasible_gain_of_matrix(without: LocalModel, at_one: LocalModel) -> FloatArray:
    """Raise the smallest eigenvalue of every frame at smaller and smaller gains, by conic programs."""
    frames = np.arange(without.program.time.size)
    zero = np.zeros((frames.size, without.program.layout.size))
    start, end = (model.matrix_program(model.matrices[0], zero, frames) for model in (without, at_one))
    slope = replace(start, matrices=end.matrices - start.matrices, constant=end.constant - start.constant)
    q = np.full(frames.size, LARGEST_GAIN)
    for rounds in range(_MOST_ROUNDS):
        here, up = start.frames(frames), slope.frames(frames)
        gain = q[frames, None, None]
        raised = replace(
            here,
            matrices=here.matrices + gain[..., None] * up.matrices,
            constant=here.constant + gain * up.constant,
        )
        with one_thread():
            answer = highest_eigenvalues(raised)
        found = answer.is_solved
        smaller = critical_gain(here.at(answer.x), up.at(answer.x), found)
        if not rounds:
            q = np.where(found, np.where(np.isinf(smaller), np.inf, q), np.nan)
        is_better = found & (smaller < (1 - _GAIN_TOLERANCE) * q[frames])
        q[frames[is_better]] = smaller[is_better]
        frames = frames[is_better]
        if not frames.size:
            break
    return q


def gain_for(missing: FloatArray, gained: FloatArray) -> FloatArray:
    """Give the least q >= 0 at which q times what is gained makes up for what is missing, entry by entry.

    Parameters
    ----------
    missing, gained : ndarray, any shape [N·m/rad]

    Returns
    -------
    ndarray, the same shape [-]
        Infinite where nothing is gained.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(missing > 0, missing / np.maximum(gained, 0.0), 0.0)


def critical_gain(without: FloatArray, gained: FloatArray, usable: BoolArray) -> FloatArray:
    """Find the smallest q >= 0 at which `without` + q `gained` has no negative eigenvalue.

    Parameters
    ----------
    without, gained : ndarray, shape (n_frames, n, n)
        Symmetric, `gained` positive semi-definite.
    usable : ndarray of bool, shape (n_frames,)

    Returns
    -------
    ndarray, shape (n_frames,) [-]
        Infinite where no gain is enough; anything where not usable.
    """
    without, gained = (np.where(usable[:, None, None], matrix, 0.0) for matrix in (without, gained))

    def is_stable(q: FloatArray) -> BoolArray:
        return np.asarray(np.linalg.eigvalsh(without + q[:, None, None] * gained)[:, 0] >= 0)

    low, high = np.zeros(len(without)), np.full(len(without), LARGEST_GAIN)
    with one_thread():
        never, always = ~is_stable(high), is_stable(low)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            stable = is_stable(middle)
            low, high = np.where(stable, low, middle), np.where(stable, middle, high)
    return np.where(always, 0.0, np.where(never, np.inf, high))
