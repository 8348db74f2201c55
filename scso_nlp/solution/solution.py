"""The answer itself: arrays, statuses and a report as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ScsoError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.solution.rows import MatrixResult, MomentBalance, Optimality, RowResult, StabilityMargin
from scso_nlp.solution.status import InfeasibilityProof, Shortfall, Status
from scso_nlp.solution.worth import effort_of, verdict_of
from scso_nlp.trajectory import time_text
from scso_nlp.validation import BoolArray, FloatArray
from scso_nlp.verdict import Verdict


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
