"""The numbers of a verdict, from the parts of a solution."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from scso_nlp.objectives.activation_effort import ActivationEffort
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution.rows import (
    ACTIVE_MARGIN,
    NEGLIGIBLE_MOMENT,
    MatrixResult,
    MomentBalance,
    RowResult,
    StabilityMargin,
)
from scso_nlp.solution.status import Status
from scso_nlp.trajectory import MotionTrajectory
from scso_nlp.validation import BoolArray, FloatArray
from scso_nlp.verdict import Extreme, Verdict

#: A coordinate counts as moved by muscles if one has a larger moment arm [m, or N/N of a translation].
LEAST_MOMENT_ARM = 1e-3


def verdict_of(
    trajectory: MotionTrajectory,
    frame_status: tuple[Status, ...],
    *,
    kept: Mapping[str, RowResult | MatrixResult],
    stability: StabilityMargin | None,
    balance: MomentBalance,
    effort: dict[str, float],
) -> Verdict:
    """Sum up what a solution is worth: frames, stability, reserves and residuals.

    Parameters
    ----------
    trajectory : MotionTrajectory
    frame_status : tuple of Status, one per frame
    kept : mapping of str to RowResult or MatrixResult
        Of the constraints that had to be kept, by name.
    stability : StabilityMargin or None
    balance : MomentBalance
    effort : dict of str to float
        As :func:`effort_of` gives it.

    Returns
    -------
    Verdict
    """
    names = [status.name for status in frame_status]
    solved = np.array([status.is_solved for status in frame_status])
    missed = [
        (name, unit, np.nan_to_num(found))
        for result in kept.values()
        for (name, found), unit in zip(result.missed_by_row.items(), result.units, strict=True)
    ]
    table = np.column_stack([found for *_, found in missed]) if missed else np.zeros((len(names), 0))
    is_missed = solved & (table.max(axis=1, initial=0.0) > ACTIVE_MARGIN)
    is_missed |= np.array([status is Status.STABILITY_MISSED for status in frame_status])
    peak = np.abs(balance.required).max(axis=0)
    arms = trajectory.moment_arms
    longest = np.maximum(arms.max(axis=(0, 2), initial=0.0), -arms.min(axis=(0, 2), initial=0.0))
    moved = longest > LEAST_MOMENT_ARM
    actuators = np.abs(balance.actuators)
    shares = np.full(actuators.shape, np.nan)
    np.divide(100 * actuators, peak, out=shares, where=moved & (peak > NEGLIGIBLE_MOMENT))
    base = trajectory.base_coordinates
    floats = np.array([base is None or name in base for name in balance.coordinates], dtype=bool)
    at = (trajectory.time, solved)
    unmoved = {
        (unit, floating): _extreme(
            at,
            balance.coordinates,
            np.where(~moved & (floats == floating) & (np.array(balance.unit) == unit), actuators, np.nan),
            unit,
        )
        for unit in ("N", "N·m")
        for floating in (True, False)
    }
    worst_miss = _extreme(at, tuple(n for n, *_ in missed), table, tuple(unit for _, unit, _ in missed))
    return Verdict(
        counts={s.name: names.count(s.name) for s in Status if s.name in names},
        n_frames=len(names),
        margin=None
        if stability is None
        else _extreme(at, stability.rows, -stability.margin, "N·m/rad", -1.0),
        frames_stable=None if stability is None else int((solved & _is_stable(stability)).sum()),
        missed=worst_miss if is_missed.any() else None,
        frames_missed=int(is_missed.sum()),
        reserve=_extreme(at, balance.coordinates, shares, "%"),
        residual_force=unmoved["N", True],
        residual_moment=unmoved["N·m", True],
        motor_force=unmoved["N", False],
        motor_moment=unmoved["N·m", False],
        effort=effort,
    )


def _is_stable(stability: StabilityMargin) -> BoolArray:
    """Tell of every frame whether all its rows keep their level, shape (n_frames,)."""
    return np.asarray((stability.margin >= -ACTIVE_MARGIN).all(axis=1))


def effort_of(
    problem: MuscleForceProblem,
    objective_terms: Mapping[str, float],
    activation: FloatArray,
    control: FloatArray,
) -> dict[str, float]:
    """Split the objective by what it is paid for.

    Parameters
    ----------
    problem : MuscleForceProblem
    objective_terms : mapping of str to float
        By name; what is no objective of the problem is the price of misses.
    activation : ndarray, shape (n_frames, n_muscles) [-]
        Of the solved frames.
    control : ndarray, shape (n_frames, n_actuators) [-]
        Likewise.

    Returns
    -------
    dict of str to float
        Of muscles, other actuators, misses and other terms.
    """
    effort = dict.fromkeys(("muscles", "other actuators", "misses", "other terms"), 0.0)
    terms = {term.name: term for term in problem.objectives}
    for name, value in objective_terms.items():
        term = terms.get(name)
        if isinstance(term, ActivationEffort):
            parts = term.efforts(problem.motion, activation, control)
            effort["muscles"] += float(parts[0].sum())
            effort["other actuators"] += float(parts[1].sum())
        else:
            effort["misses" if term is None else "other terms"] += value
    return effort


def _extreme(
    at: tuple[FloatArray, BoolArray],
    names: tuple[str, ...],
    table: FloatArray,
    unit: str | tuple[str, ...],
    sign: float = 1.0,
) -> Extreme | None:
    """Find the largest entry of a table (n_frames, n_names); None where there is none or all are zero.

    `at` are the times of the frames, and which are solved.
    """
    time, solved = at
    known = np.where(solved[:, None] & np.isfinite(table), table, -np.inf)
    if not known.size or not np.isfinite(known).any() or (sign > 0 and known.max() <= 0):
        return None
    k, i = np.unravel_index(int(known.argmax()), known.shape)
    one = unit if isinstance(unit, str) else unit[i]
    return Extreme(name=names[i], time=float(time[k]), amount=sign * float(known[k, i]), unit=one)
