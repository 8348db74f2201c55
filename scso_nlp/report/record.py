"""What ``report.json`` says."""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from scso_nlp.display import without_defaults
from scso_nlp.solution import InfeasibilityProof, Solution, Status
from scso_nlp.trajectory import MotionTrajectory

#: Version of the layout of ``report.json``.
REPORT_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """What the report says beyond the solution itself.

    Attributes
    ----------
    inputs : mapping of str to str
        SHA-256 of every input file, by path.
    settings : mapping of str to object
        Settings of the run.
    seconds : mapping of str to float [s]
        Wall times beside those of the solver, e.g. of the extraction.
    notes : tuple of str
        What was assumed or approximated, one sentence each.
    warnings : tuple of str
        Of reading and solving, one sentence each.
    """

    inputs: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def report_on(solution: Solution, record: RunRecord, baseline: Solution | None) -> dict[str, Any]:
    """Say in plain data, as JSON has them, what a solution is; hashes of its files are still missing.

    Parameters
    ----------
    solution : Solution
    record : RunRecord
    baseline : Solution or None
        The same motion without stability rows.

    Returns
    -------
    dict of str to object
    """
    problem = solution.problem
    trajectory = problem.motion.trajectory
    reactions = trajectory.joint_reactions
    balance = solution.moment_balance
    statuses = solution.frame_status
    counts = {status.name: statuses.count(status) for status in Status if status in statuses}
    report = {
        "program": "scso_nlp",
        "report_version": REPORT_VERSION,
        "written": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "name": trajectory.name,
        "summary": solution.summary(),
        "status": solution.status.name,
        "problem": {
            "frames": trajectory.n_frames,
            "initial_time": trajectory.time[0],
            "final_time": trajectory.time[-1],
            "muscles": len(trajectory.muscles),
            "muscle_names": list(trajectory.muscles),
            "max_activation": problem.motion.muscles.max_activation,
            "at_rest": trajectory.is_at_rest,
            "body_weight": None if reactions is None else reactions.body_weight,
            "moved_coordinate": _moved_coordinates(trajectory),
            "actuators": len(trajectory.actuators),
            "coordinates": list(trajectory.coordinates),
            "muscle_model": repr(problem.muscle_model),
            "objectives": [repr(term) for term in problem.objectives],
            "constraints": [repr(term) for term in problem.constraints],
            "in_short": {
                "Muscle model": [without_defaults(problem.muscle_model)],
                "Least": [without_defaults(term) for term in problem.objectives],
                "Subject to": [without_defaults(term) for term in problem.constraints],
            },
        },
        "settings": dict(record.settings),
        "inputs_sha256": dict(record.inputs),
        "files_sha256": {},
        "versions": dict(solution.report.versions),
        "solver": {
            "name": solution.report.solver,
            "options": dict(solution.report.options),
            "iterations": solution.report.iterations,
            "frames_kept_by_static_optimization": solution.report.kept_frames,
        },
        "seconds": {
            **record.seconds,
            "build": solution.report.build_seconds,
            "solve": solution.report.solve_seconds,
        },
        "objective": {"total": solution.objective, "terms": dict(solution.objective_terms)},
        "joint_reaction_peaks": _peaks(solution),
        "largest_violation": dict(solution.violation),
        "actuator_share": dict(zip(balance.coordinates, balance.actuator_share.tolist(), strict=True)),
        "status_counts": counts,
        "frame_status": [status.name for status in statuses],
        "verdict": {
            **asdict(solution.verdict),
            "lines": solution.verdict.lines(baseline.verdict if baseline else None),
        },
        "without_stability": None
        if baseline is None
        else {
            "frame_status": [status.name for status in baseline.frame_status],
            "verdict": asdict(baseline.verdict),
        },
        "shortfalls": [{**asdict(item), "text": str(item)} for item in solution.shortfalls],
        "infeasibility": [_proof(proof) for proof in solution.infeasibility],
        "notes": list(record.notes),
        "warnings": list(record.warnings),
    }
    values: dict[str, Any] = plain(report)
    return values


def _moved_coordinates(trajectory: MotionTrajectory) -> dict[str, str]:
    """Name for every muscle the coordinate about which its mean moment arm is largest."""
    if not trajectory.coordinates:
        return {}
    arm = np.abs(trajectory.moment_arms).mean(axis=0)
    turns = np.asarray(trajectory.is_rotational)
    arm = np.where(turns[:, None] | ~turns.any(), arm, 0.0)
    largest = arm.argmax(axis=0)
    return {
        muscle: trajectory.coordinates[i]
        for m, (muscle, i) in enumerate(zip(trajectory.muscles, largest, strict=True))
        if arm[i, m] > 0
    }


def _peaks(solution: Solution) -> dict[str, dict[str, float]]:
    """Largest joint forces over the solved frames, where the motion has joint reactions."""
    if solution.problem.motion.trajectory.joint_reactions is None or not solution.is_solved.any():
        return {}
    found = solution.joint_reactions()
    peaks = found.resultant[solution.is_solved].max(axis=0)
    return {
        joint: {"force": float(peak), "body_weights": float(peak / found.body_weight)}
        for joint, peak in zip(found.joints, peaks, strict=True)
    }


def _proof(proof: InfeasibilityProof) -> dict[str, object]:
    """Which rows exclude each other, with what multipliers; their entries follow from the inputs."""
    rows = zip(
        proof.constraints, proof.rows, proof.frames, proof.multipliers, proof.units, proof.turns, strict=True
    )
    return {
        "frame": proof.frame,
        "time": proof.time,
        "margin": proof.margin,
        "text": str(proof),
        "rows": [
            {"constraint": name, "row": row, "frame": k, "multiplier": y, "unit": f"1/({unit})", "turn": turn}
            for name, row, k, y, unit, turn in rows
        ],
    }


def plain(value: Any) -> Any:
    """Turn NumPy numbers, tuples and paths into what JSON has; NaN becomes null, infinity text."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)
