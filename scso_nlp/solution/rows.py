"""Rows, matrices, margins and balances at a solution, and how well it is an optimum."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.display import without_arrays
from scso_nlp.validation import BoolArray, FloatArray

#: A row with less margin than this is called active [N·m/rad]; interior-point solvers stop a little inside.
ACTIVE_MARGIN = 1e-3
#: Name of the row that stands for all combined turns.
SMALLEST_EIGENVALUE = "smallest_eigenvalue"
#: A coordinate whose required moment stays below this has no share [N·m or N].
NEGLIGIBLE_MOMENT = 1e-9


@dataclass(frozen=True, kw_only=True)
@checked
class RowResult:
    """Rows of one constraint at the solution, evaluated from the arrays that the user receives.

    Attributes
    ----------
    names : tuple of str
        One per row.
    unit : tuple of str
        One per row.
    value : ndarray, shape (n_frames, n_rows) [unit]
        Rows of a pair of frames stand at the later frame; NaN at the first.
    lower, upper : ndarray, shape (n_rows,) [unit]
    missed : ndarray, shape (n_frames, n_rows) [unit]
        By how much `value` was allowed to fall below `lower`, at a price; zero where the row is hard.
    multiplier : ndarray, shape (n_frames, n_rows) [1/unit]
        Increase of the optimal objective per unit by which the row's active bound is tightened
        (for an equation: per unit of increase of its value); 0 where the row is inactive, NaN where
        the solver gives none.
    is_observed : bool
        True if the rows were only evaluated and need not be kept.
    """

    names: tuple[str, ...]
    unit: tuple[str, ...]
    value: FloatArray
    lower: FloatArray
    upper: FloatArray
    missed: FloatArray
    multiplier: FloatArray
    is_observed: bool = False

    __repr__ = without_arrays

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each entry of `missed_by_row`."""
        return self.unit

    @property
    def missed_by_row(self) -> dict[str, FloatArray]:
        """By how much each row is missed, shape (n_frames,) [unit]."""
        return dict(zip(self.names, self.missed.T, strict=True))

    @property
    def violation(self) -> FloatArray:
        """How far each row is outside its bounds beyond what it may miss, shape (n_frames, n_rows) [unit]."""
        below = self.lower - self.missed - self.value
        return np.maximum(np.maximum(below, self.value - self.upper), 0.0)


@dataclass(frozen=True, kw_only=True)
@checked
class MatrixResult:
    r"""A matrix inequality at the solution: :math:`H - \operatorname{diag}(\text{lower}) \succeq 0`.

    Attributes
    ----------
    names : tuple of str
        What the n directions are called.
    unit : str
    value : ndarray, shape (n_frames, n, n) [unit]
        H; NaN in frames without an iterate.
    lower : ndarray, shape (n,) [unit]
    missed : ndarray, shape (n_frames,) [unit]
        By how much the smallest eigenvalue was allowed to be negative, at a price.
    smallest_eigenvalue : ndarray, shape (n_frames,) [unit]
        Of H minus its levels.
    mode : ndarray, shape (n_frames, n) [-]
        The turn that belongs to it, of unit length, its largest entry positive.
    multiplier : ndarray, shape (n_frames, n, n) [1/unit]
        Symmetric and positive semi-definite: the objective rises by its inner product with what the levels
        rise by; NaN where the solver gives none.
    is_observed : bool
        True if the matrix was only evaluated.
    """

    names: tuple[str, ...]
    unit: str
    value: FloatArray
    lower: FloatArray
    missed: FloatArray
    smallest_eigenvalue: FloatArray
    mode: FloatArray
    multiplier: FloatArray
    is_observed: bool = False

    __repr__ = without_arrays

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each entry of `missed_by_row`."""
        return (self.unit,)

    @property
    def missed_by_row(self) -> dict[str, FloatArray]:
        """By how much the smallest eigenvalue is missed, shape (n_frames,) [unit]."""
        return {SMALLEST_EIGENVALUE: self.missed}

    @property
    def violation(self) -> FloatArray:
        """How far the smallest eigenvalue is below what it may be, shape (n_frames,) [unit]."""
        return np.maximum(-self.smallest_eigenvalue - self.missed, 0.0)


@dataclass(frozen=True, kw_only=True)
@checked
class StabilityMargin:
    """Stability rows of one solution.

    Attributes
    ----------
    rows : tuple of str
        ``"<joint>_<axis>"``, or what the constraint calls them. For the whole Hessian: its coordinates, and
        ``"smallest_eigenvalue"`` of the Hessian minus levels.
    stability : ndarray, shape (n_frames, n_rows) [N·m/rad]
        NaN in frames that are not solved.
    level : ndarray, shape (n_rows,) [N·m/rad]
    multiplier : ndarray, shape (n_frames, n_rows) [rad/(N·m)]
        Cost in the objective per N·m/rad of extra stability; NaN where the solver gives none.
    mode_coordinates : tuple of str
        Coordinates of `mode`; empty unless there is a constraint on the whole Hessian.
    mode : ndarray, shape (n_frames, n_mode_coordinates) [-]
        Unit vector of the combined turn that is least stable; NaN in frames that are not solved.
    """

    rows: tuple[str, ...]
    stability: FloatArray
    level: FloatArray
    multiplier: FloatArray
    mode_coordinates: tuple[str, ...] = ()
    mode: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    __repr__ = without_arrays

    @property
    def margin(self) -> FloatArray:
        """Stability minus level, shape (n_frames, n_rows) [N·m/rad]; negative where the row is not kept."""
        return self.stability - self.level

    @property
    def is_active(self) -> BoolArray:
        """Tell where a row keeps no more than its level, shape (n_frames, n_rows)."""
        margin = self.margin
        return np.isfinite(margin) & (np.abs(margin) <= ACTIVE_MARGIN)


@dataclass(frozen=True, kw_only=True)
@checked
class MomentBalance:
    """Required, muscle and actuator moment of every coordinate.

    Attributes
    ----------
    coordinates : tuple of str
    unit : tuple of str
        ``"N·m"`` or ``"N"``, one per coordinate.
    required : ndarray, shape (n_frames, n_coordinates) [N·m or N]
        What muscles and actuators together must produce.
    muscles, actuators : ndarray, shape (n_frames, n_coordinates) [N·m or N]
        What they produce; NaN in frames that are not solved.
    """

    coordinates: tuple[str, ...]
    unit: tuple[str, ...]
    required: FloatArray
    muscles: FloatArray
    actuators: FloatArray

    __repr__ = without_arrays

    @property
    def actuator_share(self) -> FloatArray:
        """Root mean square of the actuators' moment over that of the required one.

        Returns
        -------
        ndarray, shape (n_coordinates,) [-]
            Over the solved frames; NaN where nothing is required or no frame is solved.
        """
        solved = np.isfinite(self.muscles).all(axis=1)
        if not solved.any():
            return np.full(len(self.coordinates), np.nan)
        required = np.sqrt(np.mean(self.required[solved] ** 2, axis=0))
        actuators = np.sqrt(np.mean(self.actuators[solved] ** 2, axis=0))
        share = np.full(required.shape, np.nan)
        np.divide(actuators, required, out=share, where=required > NEGLIGIBLE_MOMENT)
        return share


@dataclass(frozen=True, kw_only=True)
@checked
class Optimality:
    r"""How well a solution meets the conditions of an optimum, frame by frame, recomputed from its arrays.

    With the Lagrangian's gradient r, a bound takes up the part of r that points against it; its multiplier
    is that part.

    Attributes
    ----------
    feasibility : ndarray, shape (n_frames,) [-]
        Largest violation of a row, over what the entries of the rows of its term add up to in the frame; of a
        matrix, over what its largest entry adds up to; and of a bound, over its unknown.
    stationarity : ndarray, shape (n_frames,) [-]
        Largest entry of r that no bound takes up, over the largest entry of the objective's gradient g.
    complementarity : ndarray, shape (n_frames,) [-]
        Largest product of a multiplier and the distance to its bound, over the objective's size
        :math:`\sum_i |x_i| \max(|g_i|, |g_i - g_i(\text{rest})|)`, rest being the point nearest to zero.
    duality_gap : ndarray, shape (n_frames,) [-]
        Sum of these products likewise: for a convex objective no point that keeps all rows costs less by
        more; NaN where some row is not affine, infinite where the objective has vanished among the doubles.
    imbalance : ndarray, shape (n_frames,) [-]
        Largest share of what acts on an unknown that is left over,
        :math:`|r_i| / (\max(|g_i|, |g_i - g_i(\text{rest})|) + \sum_j |y_j A_{ji}|)`, or its distance to the
        bound that could hold it, over the frame's largest unknown, where that is less. What balances within
        1e-6 of the largest unknown, or has no slope there, counts as zero. This is relative to each unknown's
        own scale, where the others are relative to the frame's. NaN where frames are coupled or some row is
        not affine.

    Notes
    -----
    NaN in frames without an iterate. In scaled unknowns and rows. Frames that terms couple share their
    neighbours' multipliers, and have one size. Unknowns that an equation of their frame determines by itself,
    such as controls of residuals where no muscle acts, are left out of all but feasibility: beside what they
    cost nothing else would count.
    """

    feasibility: FloatArray
    stationarity: FloatArray
    complementarity: FloatArray
    duality_gap: FloatArray
    imbalance: FloatArray

    __repr__ = without_arrays

    @property
    def worst(self) -> FloatArray:
        """Largest of these, shape (n_frames,) [-]."""
        gap = np.where(np.isnan(self.duality_gap), self.complementarity, self.duality_gap)
        return np.fmax(np.maximum(np.maximum(self.feasibility, self.stationarity), gap), self.imbalance)
