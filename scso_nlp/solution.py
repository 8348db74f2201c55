"""What a solve gives back: arrays, a status per frame, rows with margins and multipliers, a report.

Data only: :mod:`scso_nlp.solver.judge` is the one place where they are made of a solver's unknowns.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ScsoError
from scso_nlp.objectives.activation_effort import ActivationEffort
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.trajectory import time_text
from scso_nlp.validation import BoolArray, FloatArray
from scso_nlp.verdict import USABLE, Extreme, Verdict

#: A row with less margin than this is called active [N·m/rad]; interior-point solvers stop a little inside.
ACTIVE_MARGIN = 1e-3
#: Name of the row that stands for all combined turns.
SMALLEST_EIGENVALUE = "smallest_eigenvalue"

#: A coordinate whose required moment stays below this has no share [N·m or N].
NEGLIGIBLE_MOMENT = 1e-9

#: A coordinate counts as moved by muscles if one has a larger moment arm [m, or N/N of a translation].
LEAST_MOMENT_ARM = 1e-3


class Status(enum.Enum):
    """How the solve of a frame ended; the value is a sentence with the remedy."""

    SOLVED = "Solved to the requested tolerance."
    STABILITY_MISSED = "Solved, and a soft stability level is missed at its price; see what is missed."
    ACCEPTABLE = "Solved to a looser tolerance than requested; check the violations before use."
    INFEASIBLE = (
        "No activations within their bounds satisfy all rows, which is proven; see the named rows, add "
        "reserves, raise strengths or lower the stability level."
    )
    LOCALLY_INFEASIBLE = (
        "The solver found no way to keep all rows from where it began, and there is no proof that there is "
        "none; see the named rows, try another initial guess, add reserves or lower the stability level."
    )
    NOT_OPTIMAL = (
        "The rows are kept, but the answer could not be shown to be the optimum; try a smaller exponent or "
        "min/max, weights and moments nearer to one, or another initial guess."
    )
    ITERATION_LIMIT = "The iteration limit was reached; raise max_iterations or give a better initial guess."
    NUMERICAL_ERROR = "The solver met numbers it could not use; check the objective for NaN at its bounds."

    @property
    def is_solved(self) -> bool:
        """True if the frame may be used."""
        return self.name in USABLE


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

    Notes
    -----
    NaN in frames without an iterate. In scaled unknowns and rows. Frames that terms couple share their
    neighbours' multipliers, and have one size.
    """

    feasibility: FloatArray
    stationarity: FloatArray
    complementarity: FloatArray
    duality_gap: FloatArray

    @property
    def worst(self) -> FloatArray:
        """Largest of these, shape (n_frames,) [-]."""
        gap = np.where(np.isnan(self.duality_gap), self.complementarity, self.duality_gap)
        return np.maximum(np.maximum(self.feasibility, self.stationarity), gap)


@dataclass(frozen=True, kw_only=True)
@checked
class Shortfall:
    """A row that a failed frame could not keep, or an objective that is no number there.

    Attributes
    ----------
    frame : int
    time : float [s]
    constraint, row : str
        `row` is empty for an objective.
    amount : float [unit]
        How much is missing; infinite for an objective.
    unit : str
    proven : bool
        True if no activations within bounds can reach the row; False if it is the violation at the last
        iterate.
    helpers : tuple of str
        Muscles and actuators that would help most, best first; where the row is beyond reach, they would
        help if they were stronger.
    """

    frame: int
    time: float
    constraint: str
    row: str
    amount: float
    unit: str
    proven: bool
    helpers: tuple[str, ...] = ()

    @classmethod
    def of_objective(cls, *, frame: int, time: float, objective: str) -> Shortfall:
        """Say that an objective, or its slope, is no number at the last iterate of a frame."""
        return cls(
            frame=frame, time=time, constraint=objective, row="", amount=math.inf, unit="", proven=False
        )

    def __str__(self) -> str:
        at = time_text(self.time)
        if not self.row:
            return f"objective {self.constraint}, or its slope, is not a number at t = {at} s"
        short = f"{self.constraint}[{self.row}] short by {self.amount:.4g} {self.unit} at t = {at} s"
        remedy = "would help"
        if self.proven:
            short += " (beyond reach at any activation)"
            stiffer = " or stiffer (larger q)" if self.unit == "N·m/rad" else ""
            remedy = f"would help if they were stronger{stiffer}"
        return short + (f"; {remedy}: {', '.join(self.helpers)}" if self.helpers else "")


@dataclass(frozen=True, kw_only=True)
@checked
class InfeasibilityProof:
    r"""Rows of a frame that no unknowns within their bounds keep together, with Farkas' multipliers y.

    Of all x within their bounds the rows :math:`l \le A x \le u` ask for :math:`y^T A x \ge b`, where b adds
    up :math:`y_i l_i` of positive and :math:`y_i u_i` of negative multipliers. If the greatest value of
    :math:`(A^T y)^T x` within the bounds is less than b, the rows contradict each other: :attr:`margin`
    multiplies these arrays out.

    Attributes
    ----------
    frame : int
        That of the row with the largest part.
    frames : tuple of int
        One per row: differ only where terms couple frames; a row of a pair stands at the later one.
    time : float [s]
        Of `frame`.
    constraints, rows, units : tuple of str
        One per row, that with the largest part first.
    turns : tuple of ndarray
        Of a row of a matrix inequality G its turn v, the row being :math:`v^T G v \ge 0`; else empty.
        With their multipliers they are a positive semi-definite matrix that multiplies G.
    multipliers : ndarray, shape (n_rows,) [1/unit]
    matrix : ndarray, shape (n_rows, n_unknowns) [unit]
        A, of the unknowns that these rows have.
    row_lower, row_upper : ndarray, shape (n_rows,) [unit]
        Bounds of the rows less what no unknown changes.
    size : ndarray, shape (n_rows,) [unit]
        What the entries of the largest row of the same term and frame add up to: the scale of a miss.
    unknowns : tuple of str
    lower, upper : ndarray, shape (n_unknowns,)

    References
    ----------
    Boyd and Vandenberghe (2004), Convex Optimization, 5.8.
    """

    #: Least margin of a proof: far above rounding.
    PROVEN: ClassVar[float] = 1e-9
    #: A sum of less than this share of its entries' sizes is zero: an unknown without bound drops out.
    ROUNDING: ClassVar[float] = 1e-12

    frame: int
    frames: tuple[int, ...]
    time: float
    constraints: tuple[str, ...]
    rows: tuple[str, ...]
    units: tuple[str, ...]
    turns: tuple[FloatArray, ...]
    multipliers: FloatArray
    matrix: FloatArray
    row_lower: FloatArray
    row_upper: FloatArray
    size: FloatArray
    unknowns: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray

    @property
    def margin(self) -> float:
        """Least share of its `size` by which some row is missed, whatever the unknowns are [-].

        Not positive where the multipliers prove nothing.
        """
        y = self.multipliers
        weight = float(np.abs(y) @ self.size)
        pull, entries = y @ self.matrix, np.abs(y) @ np.abs(self.matrix)
        at = np.where(pull > 0, self.upper, self.lower)
        used = np.abs(pull) > self.ROUNDING * entries
        asked = np.where(y > 0, self.row_lower, self.row_upper)[y != 0] @ y[y != 0]
        margin = float(asked - pull[used] @ at[used])
        return margin / weight if weight > 0 and np.isfinite(margin) else -np.inf

    @property
    def holds(self) -> bool:
        """True if the multipliers prove it."""
        return self.margin > self.PROVEN

    def __str__(self) -> str:
        several = len(set(self.frames)) > 1
        names = [
            f"{constraint}[{row}]" + (f" at frame {frame}" if several else "")
            for constraint, row, frame in zip(self.constraints, self.rows, self.frames, strict=True)
        ]
        verb = "these rows cannot hold together" if len(names) > 1 else "this row cannot be kept"
        return f"{verb} at t = {time_text(self.time)} s: {', '.join(names)}"


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
class SolveReport:
    """How the solve went: enough to reproduce it.

    Attributes
    ----------
    solver : str
        ``"trajectory"`` or ``"framewise"``.
    iterations : int
        Solver iterations, summed over all programs solved.
    build_seconds, solve_seconds : float [s]
        Wall time.
    options : mapping
        Solver options as given.
    versions : mapping of str to str
        Versions of this package and of what it stands on.
    rounds : int
        How often the program was solved while rows were added.
    kept_frames : int
        Frames in which the baseline that was given keeps all rows, so that it is their optimum.
    """

    solver: str
    iterations: int
    build_seconds: float
    solve_seconds: float
    options: Mapping[str, object]
    versions: Mapping[str, str]
    rounds: int = 1
    kept_frames: int = 0

    def kept(self, n_frames: int) -> str:
        """Say in how many frames the baseline was enough."""
        return f"static optimization already keeps all rows in {self.kept_frames} of {n_frames} frames"


@dataclass(frozen=True, kw_only=True)
@checked
class Solution:
    """Activations and forces of every frame, judged from these very arrays.

    Attributes
    ----------
    problem : MuscleForceProblem
    frame_status : tuple of Status, one per frame
    activation : ndarray, shape (n_frames, n_muscles) [-]
        In frames that are not solved: the last iterate, or NaN where there is none.
    control : ndarray, shape (n_frames, n_actuators) [-]
    tendon_force : ndarray, shape (n_frames, n_muscles) [N]
    actuator_force : ndarray, shape (n_frames, n_actuators) [N or N·m]
    variables : mapping of str to ndarray, shape (n_frames, n)
        Unknowns that terms added, by ``"<term>.<name>"``.
    quantities : mapping of str to ndarray, shape (n_frames, n)
        What constraints report, by ``"<term>.<name>"``, e.g. ``"JointStability.muscle_stiffness"`` [N/m].
    rows : mapping of str to RowResult
        By constraint name.
    matrices : mapping of str to MatrixResult
        Likewise.
    stability : StabilityMargin or None
        Rows and matrices of all stability constraints, kept or observed; None if there are none.
    moment_balance : MomentBalance
    optimality : Optimality
    objective_terms : mapping of str to float
        Weighted sum over the solved frames, by objective name; they sum to `objective`.
    violation : mapping of str to float
        Largest violation over the solved frames in the row's own unit, by constraint name; bounds of
        activations and controls stand under ``"bounds"``.
    shortfalls : tuple of Shortfall
        Worst rows of the failed frames.
    infeasibility : tuple of InfeasibilityProof
        Why frames are INFEASIBLE: one for each, or one for a motion whose frames are coupled.
    report : SolveReport
    """

    problem: MuscleForceProblem
    frame_status: tuple[Status, ...]
    activation: FloatArray
    control: FloatArray
    tendon_force: FloatArray
    actuator_force: FloatArray
    variables: Mapping[str, FloatArray]
    quantities: Mapping[str, FloatArray]
    rows: Mapping[str, RowResult]
    matrices: Mapping[str, MatrixResult]
    stability: StabilityMargin | None
    moment_balance: MomentBalance
    optimality: Optimality
    objective_terms: Mapping[str, float]
    violation: Mapping[str, float]
    shortfalls: tuple[Shortfall, ...]
    infeasibility: tuple[InfeasibilityProof, ...]
    report: SolveReport

    @property
    def kept(self) -> dict[str, RowResult | MatrixResult]:
        """Rows and matrices of the constraints that had to be kept, by name."""
        return {
            **{name: rows for name, rows in self.rows.items() if not rows.is_observed},
            **{name: matrix for name, matrix in self.matrices.items() if not matrix.is_observed},
        }

    @property
    def objective(self) -> float:
        """Sum of the objective terms over the solved frames."""
        return float(sum(self.objective_terms.values()))

    @property
    def status(self) -> Status:
        """The worst status of all frames."""
        order = list(Status)
        return max(self.frame_status, key=order.index)

    @property
    def is_solved(self) -> BoolArray:
        """Tell which frames may be used, shape (n_frames,)."""
        return np.array([status.is_solved for status in self.frame_status])

    @property
    def verdict(self) -> Verdict:
        """What the solution is worth: frames, stability, reserves and residuals."""
        names = [status.name for status in self.frame_status]
        missed = [
            (name, unit, np.nan_to_num(found))
            for result in self.kept.values()
            for (name, found), unit in zip(result.missed_by_row.items(), result.units, strict=True)
        ]
        table = np.column_stack([found for *_, found in missed]) if missed else np.zeros((len(names), 0))
        is_missed = self.is_solved & (table.max(axis=1, initial=0.0) > ACTIVE_MARGIN)
        is_missed |= np.array([status is Status.STABILITY_MISSED for status in self.frame_status])
        margin, balance = self.stability, self.moment_balance
        peak = np.abs(balance.required).max(axis=0)
        arms = self.problem.motion.trajectory.moment_arms
        longest = np.maximum(arms.max(axis=(0, 2), initial=0.0), -arms.min(axis=(0, 2), initial=0.0))
        moved = longest > LEAST_MOMENT_ARM
        actuators = np.abs(balance.actuators)
        shares = np.full(actuators.shape, np.nan)
        np.divide(100 * actuators, peak, out=shares, where=moved & (peak > NEGLIGIBLE_MOMENT))
        base = self.problem.motion.trajectory.base_coordinates
        floats = np.array([base is None or name in base for name in balance.coordinates], dtype=bool)
        unmoved = {
            (unit, floating): self._extreme(
                balance.coordinates,
                np.where(~moved & (floats == floating) & (np.array(balance.unit) == unit), actuators, np.nan),
                unit,
            )
            for unit in ("N", "N·m")
            for floating in (True, False)
        }
        return Verdict(
            counts={s.name: names.count(s.name) for s in Status if s.name in names},
            n_frames=len(names),
            margin=None if margin is None else self._extreme(margin.rows, -margin.margin, "N·m/rad", -1.0),
            missed=self._extreme(
                tuple(name for name, *_ in missed), table, tuple(unit for _, unit, _ in missed)
            )
            if is_missed.any()
            else None,
            frames_missed=int(is_missed.sum()),
            reserve=self._extreme(balance.coordinates, shares, "%"),
            residual_force=unmoved["N", True],
            residual_moment=unmoved["N·m", True],
            motor_force=unmoved["N", False],
            motor_moment=unmoved["N·m", False],
            effort=self._effort(),
        )

    def _effort(self) -> dict[str, float]:
        """Sum the objective over the solved frames by what it is paid for."""
        solved, motion = self.is_solved, self.problem.motion
        effort = dict.fromkeys(("muscles", "other actuators", "misses", "other terms"), 0.0)
        terms = {term.name: term for term in self.problem.objectives}
        for name, value in self.objective_terms.items():
            term = terms.get(name)
            if isinstance(term, ActivationEffort):
                parts = term.efforts(motion, self.activation[solved], self.control[solved])
                effort["muscles"] += float(parts[0].sum())
                effort["other actuators"] += float(parts[1].sum())
            else:
                effort["misses" if term is None else "other terms"] += value
        return effort

    def _extreme(
        self, names: tuple[str, ...], table: FloatArray, unit: str | tuple[str, ...], sign: float = 1.0
    ) -> Extreme | None:
        """Find the largest entry of a table (n_frames, n_names); None where there is none or all are zero."""
        known = np.where(self.is_solved[:, None] & np.isfinite(table), table, -np.inf)
        if not known.size or not np.isfinite(known).any() or (sign > 0 and known.max() <= 0):
            return None
        k, i = np.unravel_index(int(known.argmax()), known.shape)
        time = float(self.problem.motion.trajectory.time[k])
        name, one = names[i], unit if isinstance(unit, str) else unit[i]
        return Extreme(name=name, time=time, amount=sign * float(known[k, i]), unit=one)

    @property
    def contradictions(self) -> tuple[InfeasibilityProof, ...]:
        """Proofs of several rows that exclude each other, in the order of their shortfalls."""
        order = [shortfall.frame for shortfall in self.shortfalls]
        several = (proof for proof in self.infeasibility if len(proof.rows) > 1)
        return tuple(sorted(several, key=lambda p: order.index(p.frame) if p.frame in order else len(order)))

    def summary(self) -> str:
        """One sentence: how many frames failed, when, and the worst row."""
        failed = [k for k, status in enumerate(self.frame_status) if not status.is_solved]
        n_frames = len(self.frame_status)
        if not failed:
            others = self.verdict.others
            solved = f"all {n_frames} frames solved" + (f", of these {others}" if others else "")
            return f"{solved}, objective {self.objective:.6g}"
        time = self.problem.motion.trajectory.time
        times = ", ".join(time_text(time[k]) for k in failed[:5]) + (", …" if len(failed) > 5 else "")
        kinds = sorted({self.frame_status[k].name.lower().replace("_", " ") for k in failed})
        text = f"{len(failed)} of {n_frames} frames failed ({', '.join(kinds)}): t = {times} s"
        return text + (f"; worst: {self.shortfalls[0]}" if self.shortfalls else "")


class SolveFailed(ScsoError):
    """Some frame was not solved; `solution` holds what there is, with its statuses and shortfalls."""

    @checked
    def __init__(self, solution: Solution) -> None:
        self.solution = solution
        lines = [solution.summary(), *(f"  {shortfall}" for shortfall in solution.shortfalls[1:3])]
        lines += [f"  {proof}" for proof in solution.contradictions[:1]]
        super().__init__("\n".join(lines))
