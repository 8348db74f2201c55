"""Stability of every row against its level, for solutions with and without stability rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.exceptions import NameMismatchError
from scso_nlp.solution import Solution
from scso_nlp.validation import BoolArray, FloatArray

#: A row with less margin than this is called active [N·m/rad]; interior-point solvers stop a little inside.
ACTIVE_MARGIN = 1e-3


@dataclass(frozen=True, kw_only=True)
class StabilityMargin:
    """Stability rows of one solution.

    Attributes
    ----------
    rows : tuple of str
        ``"<joint>_<axis>"``.
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
    terms = [term for term in source.problem.constraints if isinstance(term, JointStability)]
    if not terms:
        return None
    results = [source.rows[term.name] for term in terms]
    if source is solution:
        stability = np.hstack([result.value for result in results])
        multiplier = np.hstack([result.multiplier for result in results])
    else:
        stability = np.hstack([_stability(term, source, solution.tendon_force) for term in terms])
        multiplier = np.full(stability.shape, np.nan)
    failed = ~solution.is_solved[:, np.newaxis]
    return StabilityMargin(
        rows=tuple(name for result in results for name in result.names),
        stability=np.where(failed, np.nan, stability),
        level=np.concatenate([result.lower for result in results]),
        multiplier=np.where(failed, np.nan, multiplier),
    )


def _stability(term: JointStability, source: Solution, tendon_force: FloatArray) -> FloatArray:
    data = term.data(source.problem)
    return np.einsum("krm,km->kr", data["geometric_stability"], tendon_force) - data["external_work"]


def _same_motion(solution: Solution, other: Solution) -> None:
    first, second = solution.problem.trajectory, other.problem.trajectory
    if first.muscles != second.muscles or not np.array_equal(first.time, second.time):
        raise NameMismatchError(
            f"the solutions of {first.name!r} and {second.name!r} differ in muscles or frames, "
            "expected the same motion"
        )
