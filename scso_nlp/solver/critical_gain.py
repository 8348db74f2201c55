"""The gain q of muscle stiffness k = q F / L from which on stability costs nothing."""

from __future__ import annotations

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.exceptions import ProblemError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution import Solution
from scso_nlp.solver.feasible_gain import LARGEST_GAIN, critical_gain, gain_for
from scso_nlp.solver.verbs import solve_framewise
from scso_nlp.validation import FloatArray


@checked
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

    Examples
    --------
    >>> bool((scso.critical_q(problem) < 1e-6).all())
    True
    """
    if not problem.stability_terms:
        raise ProblemError("the problem has no stability constraint whose critical q could be found")
    if baseline is None:
        baseline = solve_framewise(problem.without_stability().without_coupling(), on_failure="return")
    force = np.where(baseline.is_solved[:, None], baseline.tendon_force, np.nan)
    per_gain = force / problem.motion.trajectory.muscle_tendon_length
    critical = np.where(baseline.is_solved, 0.0, np.nan)
    for term in problem.stability_terms:
        if isinstance(term, HessianStability):
            parts = term.terms(problem.motion)
            level = np.diag(term.by_row(term.level, parts.coordinates))
            without = parts.hessian(force, np.zeros_like(force)) - level
            gained = parts.hessian(np.zeros_like(force), per_gain) - parts.constant
            threshold = critical_gain(without, gained, baseline.is_solved)
        else:
            rows = term.stability_rows(problem.motion)
            passive = term.passive_by_row(rows.rows)
            without = np.einsum("kim,km->ki", rows.curvature, force) + passive - rows.external_work
            missing = term.by_row(term.level, rows.rows) - without
            gained = np.einsum("kim,km->ki", rows.moment_arms**2, per_gain)
            threshold = gain_for(missing, gained).max(axis=1, initial=0.0)
        critical = np.maximum(critical, np.where(baseline.is_solved, threshold, np.nan))
    return np.where(critical > LARGEST_GAIN, np.inf, critical)
