"""Where stability comes from: every muscle's share of every row and mode, and stiffness in other words.

Margins, multipliers and smallest eigenvalues are in :mod:`scso_nlp.analysis.stability_margin`; what can
be reached at all is in :mod:`scso_nlp.analysis.reach`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.muscle_models.stiffness_law import ProportionalStiffness
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import Solution
from scso_nlp.solve import solve_framewise
from scso_nlp.stability.hessian import smallest_eigenvalues
from scso_nlp.transcription.build import describe, evaluate
from scso_nlp.transcription.layout import PROBLEM
from scso_nlp.validation import BoolArray, FloatArray

#: A muscle with less force than this share of its strength has no stiffness ratio [-].
_LEAST_FORCE = 1e-6

#: A larger critical gain rests on forces that the solver left at its bounds, and counts as infinite [-].
_LARGEST_GAIN = 1e4

#: Halvings of the interval in which the full Hessian's critical gain is sought: 1e-14 of the largest.
_HALVINGS = 60


@dataclass(frozen=True, kw_only=True)
class Contributions:
    """What every muscle gives to every row; with `constant` the shares add up to the row's value.

    Attributes
    ----------
    constraint : str
    rows : tuple of str
    muscles : tuple of str
    geometric : ndarray, shape (n_frames, n_rows, n_muscles) [N·m/rad]
        Force times curvature of the path.
    stiffness : ndarray, shape (n_frames, n_rows, n_muscles) [N·m/rad]
        Muscle stiffness times squared moment arm.
    constant : ndarray, shape (n_frames, n_rows) [N·m/rad]
        Passive stiffness less what weights and loads take away; of the full Hessian less its levels too.
    coordinates : tuple of str
        Coordinates of `turns`; empty for rows about joint axes.
    turns : ndarray, shape (n_frames, n_rows, n_coordinates) [-]
        The combined turn of each row, a unit vector.
    """

    constraint: str
    rows: tuple[str, ...]
    muscles: tuple[str, ...]
    geometric: FloatArray
    stiffness: FloatArray
    constant: FloatArray
    coordinates: tuple[str, ...]
    turns: FloatArray

    @property
    def of_muscles(self) -> FloatArray:
        """Geometric and stiffness share together, shape (n_frames, n_rows, n_muscles) [N·m/rad]."""
        return self.geometric + self.stiffness

    @property
    def total(self) -> FloatArray:
        """Value of each row, shape (n_frames, n_rows) [N·m/rad]."""
        return self.of_muscles.sum(axis=2) + self.constant


def row_contributions(solution: Solution, constraint: StabilityConstraint | None = None) -> Contributions:
    """Split the rows of a stability constraint by muscle.

    Parameters
    ----------
    solution : Solution
    constraint : StabilityConstraint, optional
        The first one of the solution's problem by default. Another one is evaluated at the solution's
        forces, e.g. to see what plain static optimization lacks.

    Returns
    -------
    Contributions
        NaN in frames that are not solved.

    Raises
    ------
    ProblemError
        No constraint is given and the problem has none.
    """
    term = _chosen(solution, constraint)
    rows = term.stability_rows(solution.problem)
    passive = np.zeros(len(rows.rows))
    turns = np.zeros((rows.n_frames, len(rows.rows), 0))
    coordinates: tuple[str, ...] = ()
    if isinstance(term, HessianStability):
        coordinates = term.chosen(solution.problem)
        turns = np.eye(len(coordinates)) if term.directions is None else term.directions
        turns = np.broadcast_to(turns, (rows.n_frames, *turns.shape[-2:]))
    else:
        passive = term.by_row(term.passive_stiffness or {}, rows.rows)
    force, stiffness = _force_and_stiffness(solution, term)
    return Contributions(
        constraint=term.name,
        rows=rows.rows,
        muscles=rows.muscles,
        geometric=rows.curvature * force[:, None],
        stiffness=rows.moment_arms**2 * stiffness[:, None],
        constant=np.where(solution.is_solved[:, None], passive - rows.external_work, np.nan),
        coordinates=coordinates,
        turns=turns,
    )


def mode_contributions(solution: Solution, constraint: HessianStability | None = None) -> Contributions:
    """Split the smallest eigenvalue of the full Hessian minus its levels by muscle.

    Parameters
    ----------
    solution : Solution
    constraint : HessianStability, optional
        The one of the solution's problem by default. Another one is evaluated at the solution's forces.

    Returns
    -------
    Contributions
        One row, ``"smallest_eigenvalue"``; its turn is the mode. NaN in frames that are not solved.

    Raises
    ------
    ProblemError
        No constraint is given and the problem has none on the full Hessian.
    """
    if constraint is None:
        found = [term for term in solution.problem.constraints if isinstance(term, HessianStability)]
        if not found:
            raise ProblemError("the problem has no HessianStability; give one to be evaluated")
        constraint = found[0]
    force, stiffness = _force_and_stiffness(solution, constraint)
    hessian = constraint.terms(solution.problem).hessian(force, stiffness)
    mode = np.full(hessian.shape[:2], np.nan)
    solved = np.isfinite(hessian).all(axis=(1, 2))
    if solved.any():
        mode[solved] = smallest_eigenvalues(hessian[solved])[1]
    along = replace(constraint, directions=np.nan_to_num(mode)[:, None])
    return replace(row_contributions(solution, along), rows=("smallest_eigenvalue",), turns=mode[:, None])


def equivalent_q(solution: Solution, constraint: StabilityConstraint | None = None) -> FloatArray:
    """Muscle stiffness as the gain q of stiffness proportional to force, k = q F / L.

    Parameters
    ----------
    solution : Solution
    constraint : StabilityConstraint, optional
        Whose stiffness law; as for :func:`row_contributions`.

    Returns
    -------
    ndarray, shape (n_frames, n_muscles) [-]
        NaN for muscles without force and in frames that are not solved.
    """
    force, stiffness = _force_and_stiffness(solution, _chosen(solution, constraint))
    problem = solution.problem
    pulls = force > _LEAST_FORCE * problem.muscles.max_isometric_force
    ratio = stiffness * problem.trajectory.muscle_tendon_length / np.where(pulls, force, 1.0)
    return np.where(pulls, ratio, np.nan)


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
    """
    terms = [term for term in problem.constraints if isinstance(term, StabilityConstraint)]
    if not terms:
        raise ProblemError("the problem has no stability constraint whose critical q could be found")
    if baseline is None:
        baseline = solve_framewise(problem.without_stability().without_coupling(), on_failure="return")
    force = np.where(baseline.is_solved[:, None], baseline.tendon_force, np.nan)
    per_gain = force / problem.trajectory.muscle_tendon_length
    critical = np.where(baseline.is_solved, 0.0, np.nan)
    for term in terms:
        if isinstance(term, HessianStability):
            parts = term.terms(problem)
            without = parts.hessian(force, np.zeros_like(force))
            gained = parts.hessian(np.zeros_like(force), per_gain) - parts.constant
            threshold = _critical_gain(without, gained, baseline.is_solved)
        else:
            rows = term.stability_rows(problem)
            passive = term.by_row(term.passive_stiffness or {}, rows.rows)
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
    never, always = ~is_stable(high), is_stable(low)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        stable = is_stable(middle)
        low, high = np.where(stable, low, middle), np.where(stable, middle, high)
    return np.where(always, 0.0, np.where(never, np.inf, high))


def _chosen(solution: Solution, constraint: StabilityConstraint | None) -> StabilityConstraint:
    if constraint is not None:
        return constraint
    found = [term for term in solution.problem.constraints if isinstance(term, StabilityConstraint)]
    if not found:
        raise ProblemError("the problem has no stability constraint; give one to be evaluated")
    return found[0]


def _force_and_stiffness(solution: Solution, term: StabilityConstraint) -> tuple[FloatArray, FloatArray]:
    """Tendon forces [N] and muscle stiffness [N/m] under a constraint's law; NaN where not solved."""
    problem = solution.problem
    failed = ~solution.is_solved[:, None]
    force = np.where(failed, np.nan, solution.tendon_force)
    if isinstance(term.stiffness_law, ProportionalStiffness):
        gains = term.stiffness_law.gains(problem.trajectory.muscles)
        return force, gains * force / problem.trajectory.muscle_tendon_length
    law = replace(term, soft=None)
    program = describe(replace(problem.without_coupling(), constraints=(law,)))
    parts = {(PROBLEM, "activation"): solution.activation, (PROBLEM, "control"): solution.control}
    for name, values in solution.variables.items():
        owner, _, variable = name.rpartition(".")
        parts[owner, variable] = values
    guess = program.layout.rows("guess", problem.trajectory.n_frames)
    given = program.layout.join(parts, guess)
    unknowns = np.where(np.isfinite(given), given, guess) / program.layout.scale
    piece = program.quantities[f"{law.name}.muscle_stiffness"]
    stiffness = evaluate(piece, piece.function(), unknowns, program.arrays)[0]
    return force, np.where(failed, np.nan, stiffness)
