"""Whether a stability level can be reached at all.

For every frame: the most stability that activations within their bounds can give while all other rows,
moment equilibrium first, are kept. Rows one by one by exact linear programs; the full Hessian by its
largest possible smallest eigenvalue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.display import without_arrays
from scso_nlp.exceptions import ProblemError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solver.conic import highest_eigenvalues
from scso_nlp.solver.local_model import LocalModel, local_model
from scso_nlp.solver.threads import one_thread
from scso_nlp.stability.hessian import describe_turn, smallest_eigenvalues
from scso_nlp.transcription.describe import describe
from scso_nlp.transcription.rows import RowBlock
from scso_nlp.validation import BoolArray, FloatArray

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


def affine_model(problem: MuscleForceProblem, term: StabilityConstraint) -> LocalModel:
    """Model a problem with one hard stability constraint, whose rows must be affine in the unknowns.

    Parameters
    ----------
    problem : MuscleForceProblem
        Its own stability constraints, and terms that couple frames, are left out.
    term : StabilityConstraint
        Taken as hard.

    Returns
    -------
    LocalModel

    Raises
    ------
    ProblemError
        Rows that are not affine.
    """
    separable = problem.without_coupling()
    others = tuple(t for t in separable.constraints if not isinstance(t, StabilityConstraint))
    constraints = (*others, replace(term, soft=None))
    model = local_model(describe(replace(separable, constraints=constraints, observed=())))
    if not all(matrix.is_affine for matrix in model.matrices) or model.curved_rows:
        raise ProblemError(
            f"the reach of {term.name} is found by linear programs, but some rows of the problem are not "
            "affine in activation (the stiffness law or the muscle model); solve with soft=... instead"
        )
    return model


def _reach(problem: MuscleForceProblem, term: StabilityConstraint) -> Reach:
    model = affine_model(problem, term)
    return _reach_of_matrix(model) if model.matrices else _reach_of_rows(model, term.name)


@dataclass(frozen=True, kw_only=True)
class OwnRows:
    """Affine rows of one term apart from all others, per frame, in scaled unknowns and the rows' own unit.

    Attributes
    ----------
    block : RowBlock
    gain : ndarray, shape (n_frames, n_rows, n_unknowns)
    constant : ndarray, shape (n_frames, n_rows)
    others : ndarray, shape (n_frames, n_others, n_unknowns)
    least, most : ndarray, shape (n_frames, n_others)
    lower, upper : ndarray, shape (n_frames, n_unknowns)
    """

    block: RowBlock
    gain: FloatArray
    constant: FloatArray
    others: FloatArray
    least: FloatArray
    most: FloatArray
    lower: FloatArray
    upper: FloatArray

    def limits(self, k: int) -> dict[str, FloatArray]:
        """Give the other rows and the bounds of a frame as arguments of SciPy's linprog."""
        least, most, matrix = self.least[k], self.most[k], self.others[k]
        equal = least == most
        above, below = np.isfinite(least) & ~equal, np.isfinite(most) & ~equal
        return {
            "A_ub": np.vstack([-matrix[above], matrix[below]]),
            "b_ub": np.concatenate([-least[above], most[below]]),
            "A_eq": matrix[equal],
            "b_eq": least[equal],
            "bounds": np.column_stack([self.lower[k], self.upper[k]]),
        }


def own_rows(model: LocalModel, name: str) -> OwnRows:
    """Take the rows of a term out of a model.

    Parameters
    ----------
    model : LocalModel
        Of affine rows.
    name : str

    Returns
    -------
    OwnRows
    """
    program = model.program
    affine, own = program.split.affine, program.rows.term == name
    block = next(block for block, _ in program.rows if block.term == name)
    others = ~own[affine.rows] & ~affine.is_empty.all(axis=0)
    dense = affine.dense(program.layout.size)
    least, most = (
        bound[affine.rows[others]] - affine.constant[:, others]
        for bound in (program.rows.lower, program.rows.upper)
    )
    lower, upper = program.bounds()
    return OwnRows(
        block=block,
        gain=dense[:, own[affine.rows]] * block.scale,
        constant=affine.constant[:, own[affine.rows]] * block.scale,
        others=dense[:, others],
        least=least,
        most=most,
        lower=lower,
        upper=upper,
    )


def _reach_of_rows(model: LocalModel, name: str) -> Reach:
    """Maximise every row alone by a linear program."""
    program, rows = model.program, own_rows(model, name)
    n_frames, n_rows, size = rows.gain.shape
    highest = np.full((n_frames, n_rows), np.nan)
    helping = np.zeros((n_frames, n_rows, size))
    for k in range(n_frames):
        limits = rows.limits(k)
        for i in range(n_rows):
            answer = linprog(-rows.gain[k, i], method="highs", **limits)
            if answer.status == 3:  # unbounded
                highest[k, i] = np.inf
            elif answer.success:
                highest[k, i] = rows.constant[k, i] - answer.fun
                helping[k, i] = -np.asarray(answer.upper.marginals) / program.layout.scale
    return Reach(
        constraint=name,
        time=program.time,
        rows=rows.block.names,
        level=rows.block.lower,
        highest=highest,
        labels=program.layout.labels,
        help=helping,
    )


def _reach_of_matrix(model: LocalModel) -> Reach:
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
        constraint=matrix.block.term,
        time=program.time,
        rows=("smallest eigenvalue",),
        level=np.zeros(1),
        highest=highest[:, None],
        labels=program.layout.labels,
        help=helping[:, None],
        turns=tuple(turns),
    )
