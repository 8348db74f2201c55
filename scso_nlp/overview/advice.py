"""What to do with a setup, each thing in a sentence with the option to type next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.declared_settings import SETTINGS
from scso_nlp.muscle_models.stiffness_law import ProportionalStiffness
from scso_nlp.overview.diagnosis import Diagnosis
from scso_nlp.overview.table import Table
from scso_nlp.solver.advice import next_steps
from scso_nlp.trajectory import time_text
from scso_nlp.validation import FloatArray, shown_names
from scso_nlp.verdict import RESERVE_LIMIT, RESIDUAL_LIMITS

#: A coordinate stands at the end of its range if it is no farther from it [rad or m]: assembly is not exact.
AT_END = 1e-6
#: A gain that is advised is this share above the one that is just enough [-]: more than its last digit.
MORE = 0.01


def advice_tables(
    found: Diagnosis, source: str, clamped: Mapping[str, tuple[float, float]] | None = None
) -> tuple[Table, ...]:
    """Say it in a table of rows, and in sentences with the options to type next.

    Parameters
    ----------
    found : Diagnosis
    source : str
        What ``scso run`` would be given.
    clamped : mapping of str to (float, float), optional [rad or m]
        Coordinates that the model keeps in their ranges, with these.

    Returns
    -------
    tuple of Table
    """
    advice = [
        *_on_moments(found),
        *_on_limits(found, clamped or {}),
        *_on_power(found, source),
        *_on_reserves(found),
    ]
    tables = (_row_table(found), Table(title="Advice", notes=tuple(advice)))
    return tables if found.rows else tables[1:]


def _row_table(found: Diagnosis) -> Table:
    time = found.baseline.problem.motion.trajectory.time
    rows = []
    for row in found.rows:
        known = np.isfinite(row.margin)
        k = int(np.nanargmin(row.margin)) if known.any() else 0
        rows.append(
            (
                row.row,
                f"{row.is_kept.sum()} of {known.sum()}",
                f"{row.margin[k]:.4g} at {time_text(time[k])}" if known.any() else "–",
                _gain(row.q),
                f"{row.is_out_of_reach.sum()}" if np.isfinite(row.highest).any() else "–",
                _cost(row.multiplier),
            )
        )
    laws = {_law(term) for term in found.constraints}
    return Table(
        title=f"Stability of plain static optimization with {', '.join(sorted(laws))}",
        head=(
            "row",
            "kept in frames",
            "least margin [N·m/rad, s]",
            "keeps it from q =",
            "frames out of reach",
            "frames where it costs",
        ),
        rows=tuple(rows),
        notes=(
            "keeps it from q: the gain from which on static optimization keeps the row in every frame",
            "costs: where keeping all rows is paid for at this one, and the most per N·m/rad",
        ),
    )


def _cost(multiplier: FloatArray) -> str:
    """Say where a row costs something, among the frames that have an answer with all rows."""
    solved, active = np.isfinite(multiplier), multiplier > 0
    if not solved.any():
        return "no answer"
    return f"{active.sum()} of {solved.sum()}" + (
        f", most {multiplier[active].max():.2g}" if active.any() else ""
    )


def _law(term: StabilityConstraint) -> str:
    law = term.stiffness_law
    return f"q = {law.q}" if isinstance(law, ProportionalStiffness) else type(law).__name__


def _above(gain: float) -> str:
    """Write a number of three digits that is a little larger."""
    return f"{float(f'{(1 + MORE) * gain:.3g}'):g}"


def _gain(q: FloatArray) -> str:
    finite = q[np.isfinite(q)]
    never = int(np.isinf(q).sum())
    text = f"{finite.max():.4g}" if finite.size else "none"
    return text + (f", no q in {never} frames" if never else "")


def _on_moments(found: Diagnosis) -> list[str]:
    solved, n = int(found.baseline.is_solved.sum()), found.baseline.is_solved.size
    if solved == n:
        return [f"static optimization solves all {n} frames"]
    worst = dict.fromkeys(shortfall.row for shortfall in found.baseline.shortfalls)
    return [
        f"static optimization solves {solved} of {n} frames: muscles and actuators cannot make the moments "
        f"of {shown_names(tuple(worst)) or 'some coordinates'}; add reserves there (--actuators RESERVES.xml)"
    ]


def _on_limits(found: Diagnosis, clamped: Mapping[str, tuple[float, float]]) -> list[str]:
    """Name limits of joints where moments are out of reach or left to reserves."""
    baseline, reserve = found.baseline, found.baseline.verdict.reserve
    motion = baseline.problem.motion.trajectory
    looked_at = {row.row: row.frame for row in baseline.shortfalls if row.row in motion.coordinates}
    if reserve is not None and reserve.amount > 100 * RESERVE_LIMIT:
        looked_at.setdefault(reserve.name, int(np.abs(motion.time - reserve.time).argmin()))
    advice = []
    for name, k in looked_at.items():
        c, place = motion.coordinates.index(name), f"{name} at t = {time_text(motion.time[k])} s"
        passive = motion.passive_generalized_forces[k, c]
        if name in clamped and np.abs(clamped[name] - motion.coordinate_values[k, c]).min() <= AT_END:
            advice.append(
                f"the model clamps {place} to the end of its range: widen the range, or mend the motion"
            )
        elif abs(passive) > abs(motion.generalized_forces[k, c] + passive):
            unit = "N·m" if motion.is_rotational[c] else "N"
            advice.append(
                f"the model's own springs and limits push {place} by {passive:.3g} {unit}, more than is "
                "needed: see whether the motion goes beyond a joint's limit"
            )
    return advice


def _on_power(found: Diagnosis, source: str) -> list[str]:
    if not found.rows:
        return ["there is no stability row that muscles can keep: --stability full looks along coordinates"]
    kept, n = int(found.is_kept.sum()), int(found.baseline.is_solved.sum())
    frames = f"{n} frames" if found.baseline.is_solved.all() else f"{n} frames that it solves"
    advice = []
    if kept == n:
        advice.append(f"static optimization keeps all rows in all {frames}: stability changes nothing here")
    else:
        advice.append(
            f"static optimization keeps all rows in {kept} of {frames}: "
            f"stability changes the other {n - kept}"
        )
    out = [row for row in found.rows if row.is_out_of_reach.any()]
    gains = np.array([row.q for row in found.rows]).max(axis=0)
    finite = gains[np.isfinite(gains)]
    enough = _above(finite.max()) if finite.size else ""
    if out:
        most, names = (
            max(int(row.is_out_of_reach.sum()) for row in out),
            shown_names([row.row for row in out]),
        )
        advice.append(
            f"{names} cannot be kept in up to {most} frames at this stiffness, whatever the activations"
        )
    elif kept < n and enough:
        advice.append(f"from q = {enough} on no frame would change any more (--q {enough})")
    if found.solution is not None and (solved := int(found.solution.is_solved.sum())) < n:
        advice.append(f"all rows together are kept in {solved} of {n} frames")
        advice += [
            f"{SETTINGS[step.setting].spelling} {step.value}: {step.effect}"
            for step in next_steps(found.solution)
        ]
    for term in found.constraints:
        if isinstance(term, JointStability):
            joints = f" --joints {','.join(term.joints)}" if term.joints else ""
            axes = f" --axes {','.join(term.axes)}" if term.axes else ""
            options = f"--stability potvin-brown{joints}{axes}"
            advice.append(f"to solve with them: scso run {source} {options}")
    return advice


def _on_reserves(found: Diagnosis) -> Sequence[str]:
    verdict = found.baseline.verdict
    advice = []
    reserve = verdict.reserve
    if reserve is not None and reserve.amount > 100 * RESERVE_LIMIT:
        advice.append(
            f"reserves carry up to {reserve.amount:.3g} % of a peak moment ({reserve.name} at t = "
            f"{time_text(reserve.time)} s), OpenSim advises at most {100 * RESERVE_LIMIT:g} %: lower "
            "their optimal_force so that muscles come first; for what they still carry muscles are too weak"
        )
    for what, residual in (("force", verdict.residual_force), ("moment", verdict.residual_moment)):
        if residual is not None and residual.amount > RESIDUAL_LIMITS[residual.unit]:
            advice.append(
                f"the residual {what} reaches {residual}, OpenSim advises at most "
                f"{RESIDUAL_LIMITS[residual.unit]:g} {residual.unit}: motion and loads do not fit the "
                "masses; reduce it by OpenSim's residual reduction before muscle forces are believed"
            )
    if not advice:
        return [f"reserves and residuals are within OpenSim's limits ({verdict.lines()[1]})"]
    return advice
