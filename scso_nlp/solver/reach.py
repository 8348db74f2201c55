"""Whether a stability level can be reached at all, and what stiffness it would take to have it for nothing.

For every frame: the most stability that activations within their bounds can give while all other rows,
moment equilibrium first, are kept. Rows one by one by exact linear programs; the full Hessian by its
largest possible smallest eigenvalue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from scso_nlp.arguments import checked
from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.display import without_arrays
from scso_nlp.exceptions import ProblemError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import Solution
from scso_nlp.solver.conic import highest_eigenvalues
from scso_nlp.solver.local_model import LocalModel, local_model
from scso_nlp.solver.threads import one_thread
from scso_nlp.solver.verbs import solve_framewise
from scso_nlp.stability.hessian import describe_turn, smallest_eigenvalues
from scso_nlp.transcription.describe import describe
from scso_nlp.validation import BoolArray, FloatArray

#: A larger critical gain rests on forces that the solver left at its bounds, and counts as infinite [-].
_LARGEST_GAIN = 1e4

#: Halvings of the interval in which the full Hessian's critical gain is sought: 1e-14 of the largest.
_HALVINGS = 60

#: Shortfalls below this are taken for round-off [N·m/rad].
_LEAST_SHORTFALL = 1e-5

#: Muscles and actuators named as helpers.
_MOST_HELPERS = 3

#: Share of the best helper's effect below which none is named [-].
_LEAST_HELP = 1e-3


@dataclass(frozen=True, kw_only=True)
@checked
class Reach:
    """How far the stability of one constraint can be raised in every frame.

    Attributes
    ----------
    constraint : str
    time : ndarray, shape (n_frames,) [s]
    rows : tuple of str
        The constraint's rows, or ``("smallest eigenvalue",)`` of the full Hessian.
    level : ndarray, shape (n_rows,) [N·m/rad]
        What is asked for; 0 for the eigenvalue, which is that of the Hessian minus its levels.
    highest : ndarray, shape (n_frames, n_rows) [N·m/rad]
        Each row's greatest value, the constraint's other rows aside; NaN where the other terms alone are
        out of reach, so that no answer exists.
    labels : tuple of str
        Muscles and actuators, and whatever else the terms add.
    help : ndarray, shape (n_frames, n_rows, n_labels) [N·m/rad]
        Rise of `highest` per unit of extra maximum activation (or control); 0 where it is not used up.
    turns : tuple of str, one per frame
        For the full Hessian the turn that limits it, by coordinate; empty otherwise.
    """

    constraint: str
    time: FloatArray
    rows: tuple[str, ...]
    level: FloatArray
    highest: FloatArray
    labels: tuple[str, ...]
    help: FloatArray
    turns: tuple[str, ...] = ()

    __repr__ = without_arrays

    @property
    def shortfall(self) -> FloatArray:
        """How far each row stays below its level at best, shape (n_frames, n_rows) [N·m/rad]."""
        return np.maximum(self.level - self.highest, 0.0)

    @property
    def is_reachable_by_row(self) -> BoolArray:
        """Tell which frames can reach each row's level, shape (n_frames, n_rows)."""
        return self.shortfall <= _LEAST_SHORTFALL

    @property
    def is_reachable(self) -> BoolArray:
        """Tell which frames can reach every row's level, each alone; shape (n_frames,)."""
        return np.asarray(self.is_reachable_by_row.all(axis=1))

    def helpers(self, frame: int, row: int) -> tuple[str, ...]:
        """Name the muscles and actuators that would help most if they were stronger, best first."""
        gain = self.help[frame, row]
        best = np.argsort(-gain)[:_MOST_HELPERS]
        return tuple(self.labels[i] for i in best if gain[i] > _LEAST_HELP * gain.max() and gain[i] > 0)

    def messages(self) -> tuple[str, ...]:
        """One sentence per row out of reach, worst first."""
        sentences = []
        short = np.nan_to_num(self.shortfall)
        for flat in np.argsort(-short, axis=None):
            k, i = (int(index) for index in np.unravel_index(flat, short.shape))
            if short[k, i] <= _LEAST_SHORTFALL:
                break
            turn = f" (turn {self.turns[k]})" if self.turns else ""
            helpers = ", ".join(self.helpers(k, i))
            sentences.append(
                f"{self.constraint}[{self.rows[i]}]{turn} reaches at most {self.highest[k, i]:.4g} of "
                f"{self.level[i]:.4g} N·m/rad at frame {k} (t = {self.time[k]:g} s), short by "
                f"{short[k, i]:.4g}" + (f"; stronger {helpers} would help" if helpers else "")
            )
        sentences += [
            f"{self.constraint}: the other rows alone are out of reach at frame {k} "
            f"(t = {self.time[k]:g} s); add reserves or raise strengths"
            for k in np.flatnonzero(np.isnan(self.highest).any(axis=1))
        ]
        return tuple(sentences)


@checked
def reachable_stability(problem: MuscleForceProblem) -> tuple[Reach, ...]:
    """Find how much stability every frame can have, for each stability constraint of a problem.

    Parameters
    ----------
    problem : MuscleForceProblem
        Soft levels are taken as hard ones.

    Returns
    -------
    tuple of Reach
        In the order of the constraints.

    Raises
    ------
    ProblemError
        Rows that are not affine in the unknowns: a stiffness law or muscle model that is not.

    Notes
    -----
    Terms that couple frames are left out, so a level that is reachable here may not be reachable with them.

    Examples
    --------
    >>> reach = scso.reachable_stability(problem)[0]
    >>> reach.rows, reach.highest[:3, 0].round(1)
    (('elbow_z',), array([ 50., 100., 150.]))
    """
    return tuple(_reach(problem, term) for term in problem.stability_terms)


def _reach(problem: MuscleForceProblem, term: StabilityConstraint) -> Reach:
    hard = replace(term, soft=None)
    separable = problem.without_coupling()
    others = tuple(t for t in separable.constraints if not isinstance(t, StabilityConstraint))
    model = local_model(describe(replace(separable, constraints=(*others, hard), observed=())))
    if not all(matrix.is_affine for matrix in model.matrices) or model.curved_rows:
        raise ProblemError(
            f"the reach of {term.name} is found by linear programs, but some rows of the problem are not "
            "affine in activation (the stiffness law or the muscle model); solve with soft=... instead"
        )
    return _reach_of_matrix(model, hard) if model.matrices else _reach_of_rows(model, hard)


def _reach_of_rows(model: LocalModel, term: StabilityConstraint) -> Reach:
    """Maximise every row alone by a linear program."""
    program = model.program
    n_frames, size = program.time.size, program.layout.size
    lower, upper = program.bounds()
    affine, own = program.split.affine, program.rows.term == term.name
    block = next(block for block, _ in program.rows if block.term == term.name)
    others = ~own[affine.rows] & ~affine.is_empty.all(axis=0)
    dense = affine.dense(size)
    matrix, gain = dense[:, others], dense[:, own[affine.rows]] * block.scale
    constant = affine.constant[:, own[affine.rows]] * block.scale
    least, most = (
        bound[affine.rows[others]] - affine.constant[:, others]
        for bound in (program.rows.lower, program.rows.upper)
    )
    highest = np.full((n_frames, len(block.names)), np.nan)
    helping = np.zeros((n_frames, len(block.names), size))
    for k in range(n_frames):
        equal = least[k] == most[k]
        above, below = np.isfinite(least[k]) & ~equal, np.isfinite(most[k]) & ~equal
        limits = {
            "A_ub": np.vstack([-matrix[k, above], matrix[k, below]]),
            "b_ub": np.concatenate([-least[k, above], most[k, below]]),
            "A_eq": matrix[k, equal],
            "b_eq": least[k, equal],
            "bounds": np.column_stack([lower[k], upper[k]]),
        }
        for i in range(len(block.names)):
            answer = linprog(-gain[k, i], method="highs", **limits)
            if answer.status == 3:  # unbounded
                highest[k, i] = np.inf
            elif answer.success:
                highest[k, i] = constant[k, i] - answer.fun
                helping[k, i] = -np.asarray(answer.upper.marginals) / program.layout.scale
    return Reach(
        constraint=term.name,
        time=program.time,
        rows=block.names,
        level=block.lower,
        highest=highest,
        labels=program.layout.labels,
        help=helping,
    )


def _reach_of_matrix(model: LocalModel, term: StabilityConstraint) -> Reach:
    """Maximise the smallest eigenvalue, as one more unknown t with H - diag(level) - t 1 ⪰ 0."""
    program, matrix = model.program, model.matrices[0]
    n_frames = program.time.size
    zero = np.zeros((n_frames, program.layout.size))
    raised = model.matrix_program(matrix, zero, np.arange(n_frames))
    with one_thread():
        answer = highest_eigenvalues(raised)
    highest = np.full(n_frames, np.nan)
    turns = [""] * n_frames
    solved = answer.is_solved
    if solved.any():
        highest[solved], modes = smallest_eigenvalues(raised.at(answer.x)[solved])
        for k, mode in zip(np.flatnonzero(solved), modes, strict=True):
            turns[k] = describe_turn(matrix.block.names, mode)
    helping = np.nan_to_num(answer.upper_multiplier) / program.layout.scale
    return Reach(
        constraint=term.name,
        time=program.time,
        rows=("smallest eigenvalue",),
        level=np.zeros(1),
        highest=highest[:, None],
        labels=program.layout.labels,
        help=helping[:, None],
        turns=tuple(turns),
    )


@checked
def critical_q(problem: MuscleForceProblem, baseline: Solution | None = None) -> FloatArray:
    r"""Find the gain q above which stability has no effect: plain static optimization keeps every row.

    With the forces F of static optimization a row is affine in q,
    :math:`S_i = \sum_m F_m (C_{im} + q\, r_{im}^2 / L_m) + K_i - EW_i`, so its threshold is exact; that of
    the full Hessian is the largest root of its smallest eigenvalue, which never falls with q.

    Parameters
    ----------
    problem : MuscleForceProblem
        With stability constraints; their own stiffness is not used. Gains are the same for all muscles.
    baseline : Solution, optional
        Its solution without stability; solved frame by frame if not given.

    Returns
    -------
    ndarray, shape (n_frames,) [-]
        0 where the rows are kept without muscle stiffness, infinite where no stiffness is enough, NaN in
        frames that static optimization cannot solve.

    Raises
    ------
    ProblemError
        The problem has no stability constraint.

    Examples
    --------
    >>> bool((scso.critical_q(problem) < 1e-6).all())
    True
    """
    if not problem.stability_terms:
        raise ProblemError("the problem has no stability constraint whose critical q could be found")
    if baseline is None:
        baseline = solve_framewise(problem.without_stability().without_coupling(), on_failure="return")
    force = np.where(baseline.is_solved[:, None], baseline.tendon_force, np.nan)
    per_gain = force / problem.motion.trajectory.muscle_tendon_length
    critical = np.where(baseline.is_solved, 0.0, np.nan)
    for term in problem.stability_terms:
        if isinstance(term, HessianStability):
            parts = term.terms(problem.motion)
            level = np.diag(term.by_row(term.level, parts.coordinates))
            without = parts.hessian(force, np.zeros_like(force)) - level
            gained = parts.hessian(np.zeros_like(force), per_gain) - parts.constant
            threshold = _critical_gain(without, gained, baseline.is_solved)
        else:
            rows = term.stability_rows(problem.motion)
            passive = term.by_row(term.passive_stiffness, rows.rows)
            without = np.einsum("kim,km->ki", rows.curvature, force) + passive - rows.external_work
            missing = term.by_row(term.level, rows.rows) - without
            gained = np.einsum("kim,km->ki", rows.moment_arms**2, per_gain)
            with np.errstate(divide="ignore", invalid="ignore"):
                threshold = np.where(missing > 0, missing / gained, 0.0).max(axis=1, initial=0.0)
        critical = np.maximum(critical, np.where(baseline.is_solved, threshold, np.nan))
    return np.where(critical > _LARGEST_GAIN, np.inf, critical)


def _critical_gain(without: FloatArray, gained: FloatArray, usable: BoolArray) -> FloatArray:
    """Smallest q >= 0 at which `without` + q `gained` has no negative eigenvalue, shape (n_frames,)."""
    without, gained = (np.where(usable[:, None, None], matrix, 0.0) for matrix in (without, gained))

    def is_stable(q: FloatArray) -> BoolArray:
        return np.asarray(np.linalg.eigvalsh(without + q[:, None, None] * gained)[:, 0] >= 0)

    low, high = np.zeros(len(without)), np.full(len(without), _LARGEST_GAIN)
    with one_thread():
        never, always = ~is_stable(high), is_stable(low)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            stable = is_stable(middle)
            low, high = np.where(stable, low, middle), np.where(stable, middle, high)
    return np.where(always, 0.0, np.where(never, np.inf, high))
