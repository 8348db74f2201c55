"""The answer itself: arrays, statuses and a report as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from scso_nlp.accessors import accessor
from scso_nlp.arguments import checked
from scso_nlp.display import card, table
from scso_nlp.exceptions import NameMismatchError, ScsoError
from scso_nlp.joint_reactions import JointReactions, required
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution.muscle import MuscleResult
from scso_nlp.solution.rows import MatrixResult, MomentBalance, Optimality, RowResult, StabilityMargin
from scso_nlp.solution.status import InfeasibilityProof, Shortfall, Status
from scso_nlp.solution.tables import Table, data_frame, moments_table, rows_table
from scso_nlp.solution.worth import effort_of, verdict_of
from scso_nlp.trajectory import time_text
from scso_nlp.validation import BoolArray, FloatArray, nearest, positions
from scso_nlp.verdict import ROUNDING, Verdict

if TYPE_CHECKING:
    import pandas as pd


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
    kept_frames : int or None
        Frames in which the baseline that was given keeps all rows, so that it is their optimum; None where
        none was given, or frames cannot be looked at one by one.
    """

    solver: str
    iterations: int
    build_seconds: float
    solve_seconds: float
    options: Mapping[str, object]
    versions: Mapping[str, str]
    rounds: int = 1
    kept_frames: int | None = None

    def kept(self, n_frames: int) -> str:
        """Say in how many frames the baseline was enough; nothing where that is not known."""
        if self.kept_frames is None:
            return ""
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

    Examples
    --------
    >>> solution.activation[1].round(6)
    array([0.347652, 0.143856, 0.047952])
    >>> bool(solution.is_solved.all()), bool(solution.optimality.worst.max() < 1e-6)
    (True, True)
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
        solved = self.is_solved
        return verdict_of(
            self.problem.motion.trajectory,
            self.frame_status,
            kept=self.kept,
            stability=self.stability,
            balance=self.moment_balance,
            effort=effort_of(
                self.problem, self.objective_terms, self.activation[solved], self.control[solved]
            ),
        )

    def joint_reactions(
        self,
        joints: Sequence[str] | None = None,
        *,
        on: Literal["child", "parent"] = "child",
        frame: Literal["ground", "child", "parent"] = "ground",
    ) -> JointReactions:
        """Say what joints carry, as OpenSim's JointReaction defines it.

        Parameters
        ----------
        joints : sequence of str, optional
            Names or patterns; all that the motion was read with by default.
        on : "child" or "parent"
            The body that forces and moments act on.
        frame : "ground", "child" or "parent"
            Ground, or the body whose frame they are expressed in.

        Returns
        -------
        JointReactions
            In frames that are not solved as far as there are forces, else NaN.

        Raises
        ------
        ProblemError
            The motion was read without joint reactions; another body or frame.
        NameMismatchError
            An unknown joint.
        """
        found = required(self.problem.motion.trajectory.joint_reactions, joints)
        return found.at(self.tendon_force, self.control, on=on, frame=frame)

    @property
    def excitation(self) -> FloatArray | None:
        """Excitations, shape (n_frames, n_muscles) [-]; None without activation dynamics."""
        return self.variables.get("ActivationDynamics.excitation")

    @property
    def fiber_length(self) -> FloatArray | None:
        """Fiber lengths, shape (n_frames, n_muscles) [m]; None without :class:`~scso_nlp.CompliantTendon`."""
        return self.quantities.get(f"{self.problem.muscle_model.name}.fiber_length")

    @property
    def tendon_strain(self) -> FloatArray | None:
        """Strain of the tendons, shape (n_frames, n_muscles) [-]; None as for `fiber_length`."""
        return self.quantities.get(f"{self.problem.muscle_model.name}.tendon_strain")

    @property
    def contradictions(self) -> tuple[InfeasibilityProof, ...]:
        """Proofs of several rows that exclude each other, in the order of their shortfalls."""
        order = [shortfall.frame for shortfall in self.shortfalls]
        several = (proof for proof in self.infeasibility if len(proof.rows) > 1)
        return tuple(sorted(several, key=lambda p: order.index(p.frame) if p.frame in order else len(order)))

    def other_rows(self) -> tuple[str, ...]:
        """Say by how much each row but the worst is short at most, and in how many frames it is.

        Of a matrix inequality only its worst turn counts.
        """
        worst: dict[tuple[str, str], list[Shortfall]] = {}
        for found in self.shortfalls:
            row = "" if found.constraint in self.matrices else found.row
            worst.setdefault((found.constraint, row), []).append(found)
        return tuple(
            (f"in {len(found)} frames, at worst: " if len(found) > 1 else "") + str(found[0])
            for found in [*worst.values()][1:]
        )

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

    def __getitem__(self, muscle: str) -> MuscleResult:
        """One muscle over time, by name; NameMismatchError names the nearest where there is none."""
        trajectory = self.problem.motion.trajectory
        m = int(positions("muscle", (muscle,), trajectory.muscles)[0])
        found = {"activation": self.activation, "tendon_force": self.tendon_force}
        found["muscle_tendon_length"] = trajectory.muscle_tendon_length
        further = {name: getattr(self, name) for name in ("excitation", "fiber_length", "tendon_strain")}
        found |= {name: values for name, values in further.items() if values is not None}
        columns = {name: np.where(self.is_solved, values[:, m], np.nan) for name, values in found.items()}
        return MuscleResult(name=muscle, time=trajectory.time, **columns)

    def to_dataframe(self, quantity: str = "activation") -> pd.DataFrame:
        """Make a data frame of pandas of one quantity; NaN in frames that are not solved.

        Parameters
        ----------
        quantity : str
            ``"activation"``, ``"excitation"`` [-], ``"force"`` of tendons [N], ``"fiber_length"`` [m],
            ``"tendon_strain"`` [-] of every muscle; ``"control"`` [-] and ``"actuator_force"`` [N or N·m] of
            every other actuator; ``"moments"`` [N·m or N], required and of muscles and actuators, of every
            coordinate; ``"rows"`` of all constraints; ``"stability"`` and ``"margin"`` [N·m/rad] of every
            stability row.

        Returns
        -------
        pandas.DataFrame
            One row per frame, its time [s] the index; units by column in ``attrs["units"]``.

        Raises
        ------
        NameMismatchError
            No such quantity, or the solution has none of it.
        ScsoError
            pandas is not installed.
        """
        found = _TABLES[quantity](self) if quantity in _TABLES else None
        if found is None:
            known = [name for name, make in _TABLES.items() if make(self) is not None]
            raise NameMismatchError(f"the solution has no {quantity!r} ({nearest(str(quantity), known)})")
        values = np.where(self.is_solved[:, None], found.values, np.nan)
        return data_frame(self.problem.motion.trajectory.time, found._replace(values=values))

    @property
    def plot(self) -> Any:
        """Figures, e.g. ``solution.plot.activation()``: :class:`~scso_nlp.figures.plots.SolutionPlots`."""
        return accessor("plot", self)

    def __repr__(self) -> str:
        lines = [f"Solution of {self.problem.motion.trajectory.summary()}", *self.verdict.lines()]
        lines += [f"worst: {self.shortfalls[0]}"] if self.shortfalls else []
        return "\n  ".join(lines)

    def _repr_html_(self) -> str:
        return card(repr(self), self._table_of_rows(), self._table_of_muscles())

    def _table_of_rows(self) -> str:
        """Least margins of the stability rows, smallest first."""
        if self.stability is None or not self.is_solved.any():
            return ""
        time, margin = self.problem.motion.trajectory.time, self.stability.margin
        margin = np.where(np.isfinite(margin), margin, np.inf)
        margin = np.where(np.abs(margin) < ROUNDING, 0.0, margin)
        order = np.argsort(margin.min(axis=0), kind="stable")
        lines = [(r, int(margin[:, r].argmin())) for r in order]
        rows = [
            (
                self.stability.rows[r],
                float(margin[k, r]),
                time_text(time[k]),
                int(active),
            )
            for (r, k), active in zip(lines, self.stability.is_active.sum(axis=0)[order], strict=True)
        ]
        return table(("stability row", "least margin [N·m/rad]", "at [s]", "frames active"), rows)

    def _table_of_muscles(self) -> str:
        """Peaks and means of all muscles, most active first."""
        solved, trajectory = self.is_solved, self.problem.motion.trajectory
        if not solved.any() or not trajectory.muscles:
            return ""
        activation, force, time = self.activation[solved], self.tendon_force[solved], trajectory.time[solved]
        peak = activation.argmax(axis=0)
        rows = [
            (trajectory.muscles[m], float(activation[peak[m], m]), time_text(time[peak[m]]),
             float(activation[:, m].mean()), float(force[:, m].max()))
            for m in np.argsort(-activation.max(axis=0), kind="stable")
        ]  # fmt: skip
        return table(("muscle", "peak activation", "at [s]", "mean activation", "peak force [N]"), rows)


def _of_muscles(unit: str, name: str) -> Callable[[Solution], Table | None]:
    """Make the table of an attribute with a column per muscle; none where the solution lacks it."""

    def make(solution: Solution) -> Table | None:
        values, muscles = getattr(solution, name), solution.problem.motion.trajectory.muscles
        return None if values is None else Table(values, muscles, (unit,) * len(muscles), ("muscle",))

    return make


def _of_actuators(unit: str, name: str) -> Callable[[Solution], Table]:
    def make(solution: Solution) -> Table:
        names = solution.problem.motion.trajectory.actuators
        return Table(getattr(solution, name), names, (unit,) * len(names), ("actuator",))

    return make


def _of_stability(name: str) -> Callable[[Solution], Table | None]:
    def make(solution: Solution) -> Table | None:
        found = solution.stability
        if found is None:
            return None
        return Table(getattr(found, name), found.rows, ("N·m/rad",) * len(found.rows), ("row",))

    return make


#: What :meth:`Solution.to_dataframe` knows, each with what makes its table.
_TABLES: dict[str, Callable[[Solution], Table | None]] = {
    "activation": _of_muscles("-", "activation"),
    "excitation": _of_muscles("-", "excitation"),
    "force": _of_muscles("N", "tendon_force"),
    "fiber_length": _of_muscles("m", "fiber_length"),
    "tendon_strain": _of_muscles("-", "tendon_strain"),
    "control": _of_actuators("-", "control"),
    "actuator_force": _of_actuators("N or N·m", "actuator_force"),
    "moments": lambda solution: moments_table(solution.moment_balance),
    "rows": lambda solution: rows_table(solution.rows, solution.matrices),
    "stability": _of_stability("stability"),
    "margin": _of_stability("margin"),
}


class SolveFailed(ScsoError):
    """Some frame was not solved; `solution` holds what there is, with its statuses and shortfalls.

    `advice` are sentences that end its message: what to try.
    """

    @checked
    def __init__(self, solution: Solution, advice: Sequence[str] = ()) -> None:
        self.solution = solution
        lines = [solution.summary(), *(f"  {row}" for row in solution.other_rows()[:2])]
        lines += [f"  {proof}" for proof in solution.contradictions[:1]]
        super().__init__("\n".join([*lines, *(f"  {sentence}" for sentence in advice)]))
