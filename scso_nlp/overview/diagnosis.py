"""A setup solved with and without stability: what is kept already, and what it would take to keep all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.coordinate_stability import CoordinateStability
from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.declared_settings import SOLVERS
from scso_nlp.exceptions import ProblemError
from scso_nlp.opensim.description import ModelDescription
from scso_nlp.opensim.engine import load_motion
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.report.record import plain
from scso_nlp.run import check_names, describe
from scso_nlp.settings import OutputSettings, RunSettings
from scso_nlp.solution import Solution
from scso_nlp.solver import SolverOptions, critical_q, reachable_stability
from scso_nlp.validation import BoolArray, FloatArray

#: A row counts as kept if its margin is not below this [N·m/rad].
LEAST_MARGIN = -1e-6


@dataclass(frozen=True, kw_only=True)
class RowDiagnosis:
    """A stability row beside plain static optimization.

    Attributes
    ----------
    row : str
    margin : ndarray, shape (n_frames,) [N·m/rad]
        Of static optimization, with the muscle stiffness that is asked about; NaN where it has no answer.
    highest : ndarray, shape (n_frames,) [N·m/rad]
        The most stability less level that the row can have, if moments are kept; NaN where nothing is known.
    q : ndarray, shape (n_frames,) [-]
        From which on static optimization keeps the row; infinite where none is enough.
    multiplier : ndarray, shape (n_frames,) [rad/(N·m)]
        What it costs to keep the row, with all others; NaN where they cannot all be kept.
    """

    row: str
    margin: FloatArray
    highest: FloatArray
    q: FloatArray
    multiplier: FloatArray

    @property
    def is_kept(self) -> BoolArray:
        """Tell in which frames static optimization keeps the row, shape (n_frames,)."""
        return np.asarray(self.margin >= LEAST_MARGIN)

    @property
    def is_out_of_reach(self) -> BoolArray:
        """Tell in which frames no activation keeps it, shape (n_frames,)."""
        return np.asarray(self.highest < LEAST_MARGIN)


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """What can be said of a setup before stability is asked of it.

    Attributes
    ----------
    constraints : tuple of StabilityConstraint
        Those that were looked at: the settings' own, else every row that muscles can keep.
    baseline : Solution
        Static optimization.
    solution : Solution or None
        With the constraints; None if there are none.
    rows : tuple of RowDiagnosis
    """

    constraints: tuple[StabilityConstraint, ...]
    baseline: Solution
    solution: Solution | None
    rows: tuple[RowDiagnosis, ...]

    @property
    def is_kept(self) -> BoolArray:
        """Tell in which frames static optimization keeps all rows, shape (n_frames,)."""
        return np.all([row.is_kept for row in self.rows], axis=0)

    def to_dict(self) -> dict[str, Any]:
        """Return what is known of frames and rows as text, numbers, lists and mappings."""
        return {
            "time": plain(self.baseline.problem.motion.trajectory.time),
            "constraints": [repr(term) for term in self.constraints],
            "is_solved_without_stability": plain(self.baseline.is_solved),
            "is_solved_with_stability": None if self.solution is None else plain(self.solution.is_solved),
            "rows": [
                {**plain(row), "is_kept": plain(row.is_kept), "is_out_of_reach": plain(row.is_out_of_reach)}
                for row in self.rows
            ],
        }


@checked
def diagnose(settings: RunSettings, output: OutputSettings, model: ModelDescription) -> Diagnosis:
    """Solve a setup with and without stability, and find what stability would take.

    Parameters
    ----------
    settings : RunSettings
    output : OutputSettings
        Only `processes` and `cache` matter here.
    model : ModelDescription
        Says which rows to look at where the settings name none.

    Returns
    -------
    Diagnosis

    Raises
    ------
    DataError, EngineError, NameMismatchError, ProblemError
        As for :func:`scso_nlp.run.run`.
    """
    own = settings.stability
    terms = (replace(own, soft=None),) if own is not None else stable_terms(model)
    check_names(settings.motion, terms, settings.weights)
    without = replace(settings, stability=None)
    needing = (*without.terms, *terms)
    motion = load_motion(settings.motion, prepare_for=needing, processes=output.processes, cache=output.cache)
    plain = describe(without, motion)
    problem = replace(plain, constraints=(*plain.constraints, *terms))
    return diagnosis_of(problem, solver=settings.solver, options=settings.options)


def diagnosis_of(
    problem: MuscleForceProblem, *, solver: str = "trajectory", options: SolverOptions | None = None
) -> Diagnosis:
    """Do what :func:`diagnose` does with a problem.

    Parameters
    ----------
    problem : MuscleForceProblem
        With the stability constraints to look at, if any.
    solver, options
        As for :func:`scso_nlp.run.solve`.

    Returns
    -------
    Diagnosis
    """
    terms, solve = problem.stability_terms, SOLVERS[solver].thing
    baseline = solve(problem.without_stability(), options=options, on_failure="return")
    solution = solve(problem, options=options, on_failure="return", baseline=baseline) if terms else None
    rows = [row for term in terms for row in _rows(problem, term, baseline, solution)]
    return Diagnosis(constraints=terms, baseline=baseline, solution=solution, rows=tuple(rows))


def stable_terms(model: ModelDescription) -> tuple[JointStability, ...]:
    """Return the constraint that holds all rows that muscles can keep.

    Parameters
    ----------
    model : ModelDescription

    Returns
    -------
    tuple of JointStability
        Empty if no row can be kept.
    """
    return (JointStability(),) if any(axis.can_be_stable for axis in model.axes) else ()


def _rows(
    problem: MuscleForceProblem, term: StabilityConstraint, baseline: Solution, solution: Solution | None
) -> list[RowDiagnosis]:
    names = term.row_names(problem.motion)
    if not isinstance(term, JointStability | CoordinateStability):
        names = ("smallest_eigenvalue",)
    found, with_rows = baseline.stability, None if solution is None else solution.stability
    assert found is not None
    alone = replace(problem, constraints=(*problem.without_stability().constraints, term))
    try:
        (reach,) = reachable_stability(alone)
        highest = reach.highest - reach.level
    # rows that are not affine
    except ProblemError:
        highest = np.full((problem.motion.n_frames, len(names)), np.nan)
    rows = []
    for i, name in enumerate(names):
        k = found.rows.index(name)
        one = replace(alone, constraints=(*alone.without_stability().constraints, _only(term, name, problem)))
        multiplier = np.full(problem.motion.n_frames, np.nan)
        if solution is not None and with_rows is not None:
            found_there = with_rows.multiplier[:, with_rows.rows.index(name)]
            multiplier = np.where(solution.is_solved, found_there, np.nan)
        rows.append(
            RowDiagnosis(
                row=name,
                margin=found.margin[:, k],
                highest=highest[:, i],
                q=critical_q(one, baseline),
                multiplier=multiplier,
            )
        )
    return rows


def _only(term: StabilityConstraint, row: str, problem: MuscleForceProblem) -> StabilityConstraint:
    """Return a constraint with one of its rows."""
    names = term.row_names(problem.motion)
    if row not in names:
        return term
    i = names.index(row)
    level, passive = ({row: float(term.by_row(v, names)[i])} for v in (term.level, term.passive_stiffness))
    if isinstance(term, JointStability):
        joint, _, axis = row.rpartition("_")
        return replace(term, joints=(joint,), axes=(axis,), level=level, passive_stiffness=passive)
    assert isinstance(term, CoordinateStability)
    return replace(term, coordinates=(row,), level=level, passive_stiffness=passive)
