"""Stability of every row against its level, for solutions with and without stability rows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import NameMismatchError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import RowResult, Solution
from scso_nlp.stability.hessian import smallest_eigenvalues
from scso_nlp.transcription.build import describe
from scso_nlp.transcription.check import row_results
from scso_nlp.transcription.layout import PROBLEM
from scso_nlp.validation import BoolArray, FloatArray

#: A row with less margin than this is called active [N·m/rad]; interior-point solvers stop a little inside.
ACTIVE_MARGIN = 1e-3
#: Name of the row that stands for all combined turns.
SMALLEST_EIGENVALUE = "smallest_eigenvalue"


@dataclass(frozen=True, kw_only=True)
class StabilityMargin:
    """Stability rows of one solution.

    Attributes
    ----------
    rows : tuple of str
        ``"<joint>_<axis>"``, or what the constraint calls them. For the whole Hessian: its coordinates, and
        ``"smallest_eigenvalue"`` of the Hessian minus levels.
    stability : ndarray, shape (n_frames, n_rows) [N·m/rad]
        NaN in frames that are not solved.
    level : ndarray, shape (n_rows,) [N·m/rad]
    multiplier : ndarray, shape (n_frames, n_rows) [rad/(N·m)]
        Cost in the objective per N·m/rad of extra stability; NaN where the solver gives none.
    mode_coordinates : tuple of str
        Coordinates of `mode`; empty unless there is a constraint on the whole Hessian.
    mode : ndarray, shape (n_frames, n_mode_coordinates) [-]
        Unit vector of the combined turn that is least stable; NaN in frames that are not solved.
    """

    rows: tuple[str, ...]
    stability: FloatArray
    level: FloatArray
    multiplier: FloatArray
    mode_coordinates: tuple[str, ...] = ()
    mode: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def margin(self) -> FloatArray:
        """Stability minus level, shape (n_frames, n_rows) [N·m/rad]; negative where the row is not kept."""
        return self.stability - self.level

    @property
    def is_active(self) -> BoolArray:
        """Tell where a row keeps no more than its level, shape (n_frames, n_rows)."""
        margin = self.margin
        return np.isfinite(margin) & (np.abs(margin) <= ACTIVE_MARGIN)


def stability_margin(solution: Solution, rows_of: Solution | None = None) -> StabilityMargin | None:
    """Collect the stability rows of a solution, or evaluate another solution's rows at its forces.

    Parameters
    ----------
    solution : Solution
    rows_of : Solution, optional
        Its stability rows are evaluated at the tendon forces of `solution`, e.g. the rows of a
        stability-constrained solution at the forces of plain static optimization of the same motion.

    Returns
    -------
    StabilityMargin or None
        None if there are no stability rows.

    Raises
    ------
    NameMismatchError
        The two solutions have different muscles or frames.
    """
    source = solution if rows_of is None else rows_of
    _same_motion(solution, source)
    terms = [term for term in source.problem.constraints if isinstance(term, StabilityConstraint)]
    if not terms:
        return None
    parts = [
        _hessian_margin(solution, source.problem, term)
        if isinstance(term, HessianStability)
        else _row_margin(solution, source, term)
        for term in terms
    ]
    failed = ~solution.is_solved[:, np.newaxis]
    modes = [part for part in parts if part.mode_coordinates]
    return StabilityMargin(
        rows=tuple(name for part in parts for name in part.rows),
        stability=np.where(failed, np.nan, np.hstack([part.stability for part in parts])),
        level=np.concatenate([part.level for part in parts]),
        multiplier=np.where(failed, np.nan, np.hstack([part.multiplier for part in parts])),
        mode_coordinates=modes[0].mode_coordinates if modes else (),
        mode=np.where(failed, np.nan, modes[0].mode) if modes else np.zeros((failed.size, 0)),
    )


def _row_margin(solution: Solution, source: Solution, term: StabilityConstraint) -> StabilityMargin:
    """Take the rows of a constraint as they are."""
    missed: FloatArray | float = 0.0
    if source is solution:
        result = solution.rows[term.name]
        # rows of a soft constraint count what they miss as reached
        missed = solution.variables.get(f"{term.name}.missed", 0.0)
    else:
        result = _rows_at(solution, source.problem)[term.name]
    return StabilityMargin(
        rows=result.names, stability=result.value - missed, level=result.lower, multiplier=result.multiplier
    )


def _hessian_margin(
    solution: Solution, problem: MuscleForceProblem, term: HessianStability
) -> StabilityMargin:
    """Put the Hessian together from rows along the coordinates and along the sums of two of them."""
    names = term.chosen(problem)
    n, n_frames = len(names), problem.trajectory.n_frames
    pairs = np.array([(i, j) for i in range(n) for j in range(i)], dtype=np.int64).reshape(-1, 2)
    directions = np.concatenate([np.eye(n), np.eye(n)[pairs[:, 0]] + np.eye(n)[pairs[:, 1]]])
    every = replace(term, directions=np.broadcast_to(directions, (n_frames, *directions.shape)), soft=None)
    values = _rows_at(solution, replace(problem, constraints=(every,)))[term.name].value
    hessian = np.zeros((n_frames, n, n))
    diagonal = values[:, :n]
    hessian[:, np.arange(n), np.arange(n)] = diagonal
    i, j = pairs.T
    hessian[:, i, j] = hessian[:, j, i] = (values[:, n:] - diagonal[:, i] - diagonal[:, j]) / 2
    usable = solution.is_solved[:, np.newaxis, np.newaxis]
    smallest, mode = smallest_eigenvalues(np.where(usable, hessian, 0.0))
    level = term.by_row(term.level, names)
    stability = np.column_stack([diagonal + level, smallest])
    return StabilityMargin(
        rows=(*names, SMALLEST_EIGENVALUE),
        stability=stability,
        level=np.append(level, 0.0),
        multiplier=np.full(stability.shape, np.nan),
        mode_coordinates=names,
        mode=mode,
    )


def _rows_at(solution: Solution, problem: MuscleForceProblem) -> dict[str, RowResult]:
    """Evaluate the rows of a problem at the unknowns of a solution; unknowns it has not are zero."""
    program = describe(problem)
    n_frames = problem.trajectory.n_frames
    parts = {(PROBLEM, "activation"): solution.activation, (PROBLEM, "control"): solution.control}
    for name, values in solution.variables.items():
        owner, _, variable = name.rpartition(".")
        parts[owner, variable] = values
    unknowns = program.layout.join(parts, np.zeros_like(program.layout.rows("guess", n_frames)))
    n_rows = [sum(len(b.names) for b in program.row_blocks if b.is_pair == pair) for pair in (False, True)]
    unknown_multipliers = np.full((n_frames, n_rows[0]), np.nan), np.full((n_frames - 1, n_rows[1]), np.nan)
    return row_results(program, np.nan_to_num(unknowns), unknown_multipliers)


def _same_motion(solution: Solution, other: Solution) -> None:
    first, second = solution.problem.trajectory, other.problem.trajectory
    if first.muscles != second.muscles or not np.array_equal(first.time, second.time):
        raise NameMismatchError(
            f"the solutions of {first.name!r} and {second.name!r} differ in muscles or frames, "
            "expected the same motion"
        )
