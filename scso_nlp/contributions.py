"""Where stability comes from: every muscle's share of every row and mode, and stiffness in other words.

Margins, multipliers and smallest eigenvalues are in :class:`~scso_nlp.Solution`; what can be reached at all
is in :mod:`scso_nlp.solver.reach`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.display import without_arrays
from scso_nlp.exceptions import NameMismatchError, ProblemError
from scso_nlp.solution import SMALLEST_EIGENVALUE, Solution
from scso_nlp.validation import FloatArray

#: A muscle with less force than this share of its strength has no stiffness ratio [-].
_LEAST_FORCE = 1e-6


@dataclass(frozen=True, kw_only=True)
@checked
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
        Passive stiffness less what weights and loads take away; of the smallest eigenvalue less the levels.
    """

    constraint: str
    rows: tuple[str, ...]
    muscles: tuple[str, ...]
    geometric: FloatArray
    stiffness: FloatArray
    constant: FloatArray

    __repr__ = without_arrays

    @property
    def of_muscles(self) -> FloatArray:
        """Geometric and stiffness share together, shape (n_frames, n_rows, n_muscles) [N·m/rad]."""
        return self.geometric + self.stiffness

    @property
    def total(self) -> FloatArray:
        """Value of each row, shape (n_frames, n_rows) [N·m/rad]."""
        return self.of_muscles.sum(axis=2) + self.constant


@checked
def row_contributions(solution: Solution, name: str | None = None) -> Contributions:
    """Split the rows of a stability constraint by muscle; of the full Hessian each coordinate alone.

    Parameters
    ----------
    solution : Solution
    name : str, optional
        Of a stability constraint that the solution kept or observed, see :func:`scso_nlp.observe`; the
        first one by default.

    Returns
    -------
    Contributions
        NaN in frames that are not solved.

    Raises
    ------
    ProblemError
        The problem has no stability constraint.
    NameMismatchError
        It has none of this name.

    Examples
    --------
    >>> shares = scso.row_contributions(solution)
    >>> dict(zip(shares.muscles, shares.of_muscles[1, 0].round(2).tolist(), strict=True))
    {'brachioradialis': 84.02, 'biceps': 7.19, 'brachialis': 0.32}
    """
    term = _chosen(solution, name)
    rows = term.stability_rows(solution.problem.motion)
    # the Hessian's own rows hold its passive stiffness already
    passive = 0.0 if isinstance(term, HessianStability) else term.passive_by_row(rows.rows)
    force, stiffness = _force_and_stiffness(solution, term)
    return Contributions(
        constraint=term.name,
        rows=rows.rows,
        muscles=rows.muscles,
        geometric=rows.curvature * force[:, None],
        stiffness=rows.moment_arms**2 * stiffness[:, None],
        constant=np.where(solution.is_solved[:, None], passive - rows.external_work, np.nan),
    )


@checked
def mode_contributions(solution: Solution, name: str | None = None) -> Contributions:
    """Split the smallest eigenvalue of the full Hessian minus its levels by muscle.

    Parameters
    ----------
    solution : Solution
    name : str, optional
        Of a :class:`~scso_nlp.HessianStability` that the solution kept or observed; the first one by default.

    Returns
    -------
    Contributions
        One row, ``"smallest_eigenvalue"``; its turn is the mode of ``solution.matrices``. NaN in frames that
        are not solved.

    Raises
    ------
    ProblemError
        The problem has no constraint on the full Hessian.
    NameMismatchError
        It has none of this name.

    Examples
    --------
    >>> seen = scso.observe(solution, scso.HessianStability(q=5.0))
    >>> scso.mode_contributions(seen).total[:3, 0].round(2)
    array([ 45.76,  91.53, 137.29])
    """
    term = _chosen(solution, name, on_hessian=True)
    assert isinstance(term, HessianStability)
    terms, matrix = term.terms(solution.problem.motion), solution.matrices[term.name]
    mode = np.where(solution.is_solved[:, None], matrix.mode, np.nan)
    force, stiffness = _force_and_stiffness(solution, term)
    along = np.einsum("ki,kijm,kj->km", mode, terms.curvature, mode, optimize=True)
    arms = np.einsum("ki,kim->km", mode, terms.moment_arms)
    constant = np.einsum("ki,kij,kj->k", mode, terms.constant - np.diag(matrix.lower), mode)
    return Contributions(
        constraint=term.name,
        rows=(SMALLEST_EIGENVALUE,),
        muscles=solution.problem.motion.trajectory.muscles,
        geometric=(along * force)[:, None],
        stiffness=(arms**2 * stiffness)[:, None],
        constant=constant[:, None],
    )


@checked
def equivalent_q(solution: Solution, name: str | None = None) -> FloatArray:
    """Muscle stiffness as the gain q of stiffness proportional to force, k = q F / L.

    Parameters
    ----------
    solution : Solution
    name : str, optional
        Of the constraint whose stiffness law is meant; as for :func:`row_contributions`.

    Returns
    -------
    ndarray, shape (n_frames, n_muscles) [-]
        NaN for muscles without force and in frames that are not solved.

    Examples
    --------
    >>> seen = scso.observe(solution, scso.CoordinateStability(stiffness=scso.ProportionalStiffness(q=8.0)))
    >>> scso.equivalent_q(seen, "CoordinateStability")[0].round(6)
    array([8., 8., 8.])
    """
    force, stiffness = _force_and_stiffness(solution, _chosen(solution, name))
    motion = solution.problem.motion
    pulls = force > _LEAST_FORCE * motion.muscles.max_isometric_force
    ratio = stiffness * motion.trajectory.muscle_tendon_length / np.where(pulls, force, 1.0)
    return np.where(pulls, ratio, np.nan)


def _chosen(solution: Solution, name: str | None, *, on_hessian: bool = False) -> StabilityConstraint:
    kind = HessianStability if on_hessian else StabilityConstraint
    found = [term for term in solution.problem.stability_terms if isinstance(term, kind)]
    if not found:
        raise ProblemError(
            f"the solution has no {kind.__name__}, kept or observed; give it one with scso_nlp.observe"
        )
    if name is None:
        return found[0]
    named = [term for term in found if term.name == name]
    if not named:
        raise NameMismatchError(
            f"the solution has no {kind.__name__} called {name!r}, known: {', '.join(t.name for t in found)}"
        )
    return named[0]


def _force_and_stiffness(solution: Solution, term: StabilityConstraint) -> tuple[FloatArray, FloatArray]:
    """Tendon forces [N] and muscle stiffness [N/m] under a constraint's law; NaN where not solved."""
    failed = ~solution.is_solved[:, None]
    stiffness = solution.quantities[f"{term.name}.muscle_stiffness"]
    return np.where(failed, np.nan, solution.tendon_force), np.where(failed, np.nan, stiffness)
