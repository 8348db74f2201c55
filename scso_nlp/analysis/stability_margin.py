"""Stability of every row against its level, for solutions with and without stability rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import NameMismatchError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import RowResult, Solution
from scso_nlp.transcription.build import describe
from scso_nlp.transcription.check import row_results
from scso_nlp.transcription.layout import PROBLEM
from scso_nlp.validation import BoolArray, FloatArray

#: A row with less margin than this is called active [N·m/rad]; interior-point solvers stop a little inside.
ACTIVE_MARGIN = 1e-3


@dataclass(frozen=True, kw_only=True)
class StabilityMargin:
    """Stability rows of one solution.

    Attributes
    ----------
    rows : tuple of str
        ``"<joint>_<axis>"``, or what the constraint calls them.
    stability : ndarray, shape (n_frames, n_rows) [N·m/rad]
        NaN in frames that are not solved.
    level : ndarray, shape (n_rows,) [N·m/rad]
    multiplier : ndarray, shape (n_frames, n_rows) [rad/(N·m)]
        Cost in the objective per N·m/rad of extra stability; NaN where the solver gives none.
    """

    rows: tuple[str, ...]
    stability: FloatArray
    level: FloatArray
    multiplier: FloatArray

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
    terms = [term.name for term in source.problem.constraints if isinstance(term, StabilityConstraint)]
    if not terms:
        return None
    if source is solution:
        results = [solution.rows[name] for name in terms]
        missed = [solution.variables.get(f"{name}.missed", 0.0) for name in terms]
    else:
        rows = _rows_at(solution, source.problem)
        results, missed = [rows[name] for name in terms], [0.0] * len(terms)
    failed = ~solution.is_solved[:, np.newaxis]
    # rows of a soft constraint count what they miss as reached
    stability = np.hstack([result.value - gap for result, gap in zip(results, missed, strict=True)])
    multiplier = np.hstack([result.multiplier for result in results])
    return StabilityMargin(
        rows=tuple(name for result in results for name in result.names),
        stability=np.where(failed, np.nan, stability),
        level=np.concatenate([result.lower for result in results]),
        multiplier=np.where(failed, np.nan, multiplier),
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
