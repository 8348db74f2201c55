"""Whether a stability level can be reached at all, before anything is solved.

For every frame: the most stability that activations within their bounds can give while all other rows,
moment equilibrium first, are kept. Rows one by one by exact linear programs; the full Hessian by its
largest possible smallest eigenvalue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.stability.critical_turns import highest_eigenvalues
from scso_nlp.stability.hessian import describe_turn, smallest_eigenvalues
from scso_nlp.transcription.build import describe, split_rows
from scso_nlp.transcription.local_model import LocalModel, local_model
from scso_nlp.validation import BoolArray, FloatArray

#: Shortfalls below this are taken for round-off [N·m/rad].
_LEAST_SHORTFALL = 1e-5

#: Muscles and actuators named as helpers.
_MOST_HELPERS = 3

#: Share of the best helper's effect below which none is named [-].
_LEAST_HELP = 1e-3


@dataclass(frozen=True, kw_only=True)
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

    @property
    def shortfall(self) -> FloatArray:
        """How far each row stays below its level at best, shape (n_frames, n_rows) [N·m/rad]."""
        return np.maximum(self.level - self.highest, 0.0)

    @property
    def is_reachable(self) -> BoolArray:
        """Tell which frames can reach every row's level, each alone; shape (n_frames,)."""
        return np.asarray((self.shortfall <= _LEAST_SHORTFALL).all(axis=1))

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
    """
    return tuple(
        _reach(problem, term) for term in problem.constraints if isinstance(term, StabilityConstraint)
    )


def _reach(problem: MuscleForceProblem, term: StabilityConstraint) -> Reach:
    hard = replace(term, soft=None)
    if isinstance(hard, HessianStability):
        hard = replace(hard, directions=None)
    frames = replace(problem.without_coupling(), constraints=())
    others = [t for t in problem.without_coupling().constraints if t is not term]
    others = [t for t in others if not isinstance(t, StabilityConstraint)]
    alone = replace(frames, constraints=(*others, hard))
    program = describe(alone)
    split = split_rows(program)
    if any(not piece.is_pair for piece, _ in split.nonlinear):
        raise ProblemError(
            f"the reach of {term.name} is found by linear programs, but some rows of the problem are not "
            "affine in activation (the stiffness law or the muscle model); solve with soft=... instead"
        )
    n_frames = problem.trajectory.n_frames
    near = local_model(
        program,
        split,
        np.zeros((n_frames, program.layout.size)),
        is_solution=False,
        usable=np.ones(n_frames, dtype=bool),
    )
    if isinstance(hard, HessianStability):
        return _reach_of_hessian(alone, hard, near)
    return _reach_of_rows(alone, hard, near)


def _reach_of_rows(problem: MuscleForceProblem, term: StabilityConstraint, near: LocalModel) -> Reach:
    """Maximise every row alone by a linear program."""
    program, affine = near.program, near.split.affine
    lower, upper = near.bounds()
    matrix, least, most = near.rows(without=term.name)
    names = term.row_names(problem)
    blocks = [b for b in program.row_blocks if not b.is_pair]
    start = 0
    for block in blocks:
        if block.term == term.name:
            break
        start += len(block.names)
    n_frames, n = near.unknowns.shape
    gain = np.zeros((n_frames, len(names), n))
    constant = np.zeros((n_frames, len(names)))
    own = (affine.row >= start) & (affine.row < start + len(names))
    gain[:, affine.row[own] - start, affine.column[own]] = affine.values[:, own] * block.scale
    ours = (affine.rows >= start) & (affine.rows < start + len(names))
    constant[:, affine.rows[ours] - start] = affine.constant[:, ours] * block.scale
    highest = np.full((n_frames, len(names)), np.nan)
    helping = np.zeros((n_frames, len(names), n))
    scale = near.program.layout.scale
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
        for i in range(len(names)):
            answer = linprog(-gain[k, i], method="highs", **limits)
            if answer.status == 3:  # unbounded
                highest[k, i] = np.inf
            elif answer.success:
                highest[k, i] = constant[k, i] - answer.fun
                helping[k, i] = -np.asarray(answer.upper.marginals) / scale
    return Reach(
        constraint=term.name,
        time=problem.trajectory.time,
        rows=names,
        level=term.by_row(term.level, names),
        highest=highest,
        labels=program.layout.labels,
        help=helping,
    )


def _reach_of_hessian(problem: MuscleForceProblem, term: HessianStability, near: LocalModel) -> Reach:
    """Maximise the smallest eigenvalue, as one more unknown t with H - diag(level) - t 1 ⪰ 0."""
    terms = term.terms(problem)
    n_frames = len(near.unknowns)
    program = term.matrix_program(terms, near, near.bounds())
    answer = highest_eigenvalues(program)
    hessian = program.constant + np.einsum("kxij,kx->kij", program.matrices, answer.x)
    highest = np.full(n_frames, np.nan)
    turns = [""] * n_frames
    solved = answer.is_solved
    if solved.any():
        highest[solved], modes = smallest_eigenvalues(hessian[solved])
        for k, mode in zip(np.flatnonzero(solved), modes, strict=True):
            turns[k] = describe_turn(terms.coordinates, mode)
    helping = np.nan_to_num(answer.upper_multiplier) / near.program.layout.scale
    return Reach(
        constraint=term.name,
        time=problem.trajectory.time,
        rows=("smallest eigenvalue",),
        level=np.zeros(1),
        highest=highest[:, None],
        labels=near.program.layout.labels,
        help=helping[:, None],
        turns=tuple(turns),
    )
