r"""How far activations and stability may be from the optimum at a little more effort, frame by frame.

The least :math:`c^T x` with effort :math:`E(x) \le \beta`, all rows, all bounds and matrices
:math:`G(x) \succeq 0` is found in :mod:`scso_nlp.solver.extreme_paths`, and where there are matrices in
:mod:`scso_nlp.solver.extreme_cones`. Multipliers are a certificate:

.. math:: c^T x \ge \min_{l \le z \le u} \left( c^T z + \tfrac1s (E(z) - \beta) + y^T (A z - b)
          - \langle \Lambda, G(z) \rangle \right)

holds whatever y, s > 0 and :math:`\Lambda \succeq 0` are, with b the side of each row that the sign of y
means. It is evaluated by multiplication, because E is a sum over unknowns, of which each has its minimum
written down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.display import without_arrays
from scso_nlp.exceptions import ProblemError
from scso_nlp.solution import Solution
from scso_nlp.solver.convex_objective import ConvexObjective
from scso_nlp.solver.extreme_cones import extremes_by_cones
from scso_nlp.solver.extreme_paths import Paths
from scso_nlp.solver.judge import unknowns_of
from scso_nlp.solver.near_optimum import Matrix, NearOptimum
from scso_nlp.solver.powers import Powers
from scso_nlp.solver.presolve import can_presolve
from scso_nlp.solver.redundant import without_redundant_rows
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import FrameProgram, describe
from scso_nlp.transcription.turns import MatrixModel, matrix_models
from scso_nlp.validation import BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True)
@checked
class Ranges:
    """Least and greatest values that rows, bounds and a little more effort allow; NaN in unsolved frames.

    Attributes
    ----------
    solution : Solution
        The optimum.
    effort : float [-]
        Share by which the objective of a frame may exceed its optimum, without what rows determine.
    least, greatest : ndarray, shape (n_frames, n_muscles) [-]
        Activations, each attained by some pattern that keeps everything.
    certified_least, certified_greatest : ndarray, shape (n_frames, n_muscles) [-]
        No pattern goes beyond these: lower and upper bounds from duality.
    rows : tuple of str
        Stability rows; of a whole Hessian its coordinates, each an entry of the diagonal.
    least_stability, greatest_stability : ndarray, shape (n_frames, n_rows) [N·m/rad]
        Attained.
    certified_least_stability, certified_greatest_stability : ndarray, shape (n_frames, n_rows) [N·m/rad]
        Bounds from duality.
    """

    solution: Solution
    effort: float
    least: FloatArray
    greatest: FloatArray
    certified_least: FloatArray
    certified_greatest: FloatArray
    rows: tuple[str, ...]
    least_stability: FloatArray
    greatest_stability: FloatArray
    certified_least_stability: FloatArray
    certified_greatest_stability: FloatArray

    __repr__ = without_arrays

    @property
    def gap(self) -> float:
        """Largest distance between what is attained and what is certified, of activations [-]."""
        below, above = self.least - self.certified_least, self.certified_greatest - self.greatest
        return float(np.nanmax(np.maximum(below, above), initial=0.0))

    def necessary(self, threshold: float = 0.01) -> dict[str, BoolArray]:
        """Name muscles without which it does not work: in some frame no pattern leaves them at rest.

        Parameters
        ----------
        threshold : float [-]
            By how much the certified least activation is above the muscle's lower bound.

        Returns
        -------
        dict of str to ndarray of bool, shape (n_frames,)
            In which frames.
        """
        muscles = self.solution.problem.motion.muscles
        needed = self.certified_least > muscles.min_activation + threshold
        return {muscles.muscles[m]: needed[:, m] for m in np.flatnonzero(needed.any(axis=0))}


@checked
def ranges(solution: Solution, *, effort: float = 0.05) -> Ranges:
    """Find the least and greatest activation of every muscle, and stability of every row, near an optimum.

    Parameters
    ----------
    solution : Solution
        Of a problem whose frames are apart, whose rows and matrices are affine, with an effort of any finite
        exponent.
    effort : float [-]
        Share by which the objective of each frame may exceed its optimum, positive. What an equation
        determines by itself, as a residual that no muscle helps, is no choice: its cost does not count.

    Returns
    -------
    Ranges

    Notes
    -----
    Where levels may be missed at a price, effort buys misses, and least stability is what it buys.

    The stability of a whole Hessian along one coordinate is affine in the unknowns and has a certificate. Its
    smallest eigenvalue is a concave function of them: how low it may be is no convex problem, of which
    multipliers would certify nothing; it has no ranges here, and is at least its level all the same. With
    matrices, an exponent of 5 or more and much effort to spend, the method may not get on for some extremes:
    there the optimum is what is attained and bounds alone certify, which is seen in ``gap`` too.

    Raises
    ------
    ProblemError
        Frames that are coupled, rows or matrices that are not affine, an objective that is no sum of squares
        or of one power (as with actuators below exponent 2), or a share that is not positive.

    Examples
    --------
    >>> found = scso.ranges(solution, effort=0.05)
    >>> found.least[1].round(3), found.greatest[1].round(3)
    (array([0.314, 0.065, 0.   ]), array([0.382, 0.222, 0.132]))
    >>> sorted(found.necessary(0.1))
    ['biceps', 'brachioradialis']
    """
    if not (np.isfinite(effort) and effort > 0):
        raise ProblemError(
            f"effort is {effort:g}, expected a positive share by which effort may rise, e.g. 0.05"
        )
    program = without_redundant_rows(describe(solution.problem))
    objective = ConvexObjective.of(program)
    if not can_presolve(program):
        raise ProblemError(
            "ranges need frames that are apart and affine rows: leave out terms that couple frames, and "
            "muscle models with elastic tendons"
        )
    models = matrix_models(program)
    bent = [model.block.term for model in models if not model.is_affine]
    if bent:
        raise ProblemError(
            f"ranges need matrices that are affine in the unknowns, but that of {bent[0]} is not"
        )
    powers = Powers.of(program, objective)
    if powers is None:
        raise ProblemError(
            "ranges need an objective that is a sum of squares, or of one power of every unknown, as "
            "ActivationEffort(exponent=p) is: with p finite, and without actuators where p is below 2"
        )
    with one_thread():
        return _Search(program, models, solution, powers, effort).found()


class _Search:
    """Extremes of all frames; unknowns are scaled."""

    def __init__(
        self,
        program: FrameProgram,
        models: tuple[MatrixModel, ...],
        solution: Solution,
        powers: Powers,
        effort: float,
    ) -> None:
        self.program, self.solution, self.powers, self.effort = program, solution, powers, effort
        self.unknowns = np.clip(unknowns_of(program, solution), *program.bounds())
        self.lower, self.upper = program.bounds()
        affine = program.split.affine
        self.rows = affine.dense(program.layout.size)
        self.low, self.high = (
            bound[affine.rows] - affine.constant for bound in (program.rows.lower, program.rows.upper)
        )
        self.is_free = ~affine.determined(program.rows, program.layout.size)
        self.n_muscles = solution.activation.shape[1]
        zero = np.zeros_like(self.unknowns)
        self.matrices = [(model.block, *model.triangle(zero, program.arrays)) for model in models]
        self._collect_wanted()

    def _collect_wanted(self) -> None:
        """Stability rows: their names, coefficients (n_frames, n_rows, size) and constants, unscaled.

        Of a matrix, the entries on its diagonal.
        """
        stability = {t.name for t in self.program.problem.constraints if isinstance(t, StabilityConstraint)}
        affine = self.program.split.affine
        names: list[str] = []
        wanted, offset = [self.rows[:, :0]], [affine.constant[:, :0]]
        for block, where in self.program.rows:
            if block.term in stability:
                names += block.names
                place = affine.place[where]
                wanted.append(block.scale * self.rows[:, place])
                offset.append(block.scale * affine.constant[:, place])
                if block.missed is not None:  # what is missed is no stability
                    own = np.arange(len(block.names))
                    wanted[-1][:, own, block.missed + own] = 0.0
        for matrix, constant, slopes in self.matrices:
            if matrix.term in stability:
                names += matrix.names
                row, column = matrix.triangle
                wanted.append(slopes[:, row == column])
                offset.append(constant[:, row == column] + matrix.lower)
                if matrix.missed is not None:
                    wanted[-1][:, :, matrix.missed] = 0.0
        self.names, self.wanted, self.offset = tuple(names), np.hstack(wanted), np.hstack(offset)

    def found(self) -> Ranges:
        """Go through the frames."""
        n_frames, n = len(self.unknowns), self.n_muscles
        attained, certified = (np.full((n_frames, 2, n + len(self.names)), np.nan) for _ in range(2))
        prices: FloatArray | None = None
        for k in np.flatnonzero(self.solution.is_solved):
            frame = self._frame(int(k))
            if frame.matrix is None:
                paths = Paths(frame, prices)
                extremes, prices = paths.extremes(), paths.prices
            else:
                extremes = extremes_by_cones(frame, frame.matrix)
            attained[k], certified[k] = frame.attained_and_certified(extremes)
        attained[:, :, n:] += self.offset[:, None]
        certified[:, :, n:] += self.offset[:, None]
        return Ranges(
            solution=self.solution,
            effort=self.effort,
            least=attained[:, 0, :n],
            greatest=attained[:, 1, :n],
            certified_least=certified[:, 0, :n],
            certified_greatest=certified[:, 1, :n],
            rows=self.names,
            least_stability=attained[:, 0, n:],
            greatest_stability=attained[:, 1, n:],
            certified_least_stability=certified[:, 0, n:],
            certified_greatest_stability=certified[:, 1, n:],
        )

    def _frame(self, k: int) -> NearOptimum:
        free = self.is_free[k]
        return NearOptimum(
            optimum=self.unknowns[k],
            free=free,
            bounds=(self.lower[k], self.upper[k]),
            rows=(self.rows[k], self.low[k], self.high[k]),
            matrix=self._matrix(k),
            powers=self.powers.at(k, free),
            share=self.effort,
            costs=np.vstack([np.eye(self.n_muscles, free.size), self.wanted[k]]),
        )

    def _matrix(self, k: int) -> Matrix | None:
        """All matrices of a frame as the blocks of one, or None."""
        if not self.matrices:
            return None
        constants = [block.filled(constant[k]) for block, constant, _ in self.matrices]
        slopes = [block.filled(slopes[k].T) for block, _, slopes in self.matrices]
        return Matrix(
            constant=block_diag(*constants),
            slopes=np.array([block_diag(*each) for each in zip(*slopes, strict=True)]),
        )
