"""What a solve gives back: arrays, a status per frame, rows with margins and multipliers, a report."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scso_nlp.exceptions import ScsoError
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.trajectory import time_text
from scso_nlp.validation import BoolArray, FloatArray


class Status(enum.Enum):
    """How the solve of a frame ended; the value is a sentence with the remedy."""

    SOLVED = "Solved to the requested tolerance."
    ACCEPTABLE = "Solved to a looser tolerance than requested; check the violations before use."
    INFEASIBLE = (
        "No activations within their bounds satisfy all rows; see the named rows, add reserves, "
        "raise strengths or lower the stability level."
    )
    ITERATION_LIMIT = "The iteration limit was reached; raise max_iterations or give a better initial guess."
    NUMERICAL_ERROR = "The solver met numbers it could not use; check the objective for NaN at its bounds."

    @property
    def is_solved(self) -> bool:
        """True if the frame may be used."""
        return self in (Status.SOLVED, Status.ACCEPTABLE)


@dataclass(frozen=True, kw_only=True)
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
    multiplier : ndarray, shape (n_frames, n_rows) [1/unit]
        Increase of the optimal objective per unit by which the row's active bound is tightened
        (for an equation: per unit of increase of its value); 0 where the row is inactive, NaN where
        the solver gives none.
    """

    names: tuple[str, ...]
    unit: tuple[str, ...]
    value: FloatArray
    lower: FloatArray
    upper: FloatArray
    multiplier: FloatArray


@dataclass(frozen=True, kw_only=True)
class Shortfall:
    """A row that a failed frame could not keep.

    Attributes
    ----------
    frame : int
    time : float [s]
    constraint, row : str
    amount : float [unit]
        How much is missing.
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

    def __str__(self) -> str:
        at = time_text(self.time)
        short = f"{self.constraint}[{self.row}] short by {self.amount:.4g} {self.unit} at t = {at} s"
        remedy = "would help"
        if self.proven:
            short += " (beyond reach at any activation)"
            stiffer = " or stiffer (larger q)" if self.unit == "N·m/rad" else ""
            remedy = f"would help if they were stronger{stiffer}"
        return short + (f"; {remedy}: {', '.join(self.helpers)}" if self.helpers else "")


@dataclass(frozen=True, kw_only=True)
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
    """

    solver: str
    iterations: int
    build_seconds: float
    solve_seconds: float
    options: Mapping[str, object]
    versions: Mapping[str, str]
    rounds: int = 1


@dataclass(frozen=True, kw_only=True)
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
    objective_terms : mapping of str to float
        Weighted sum over the solved frames, by objective name; they sum to `objective`.
    violation : mapping of str to float
        Largest violation over the solved frames in the row's own unit, by constraint name; bounds of
        activations and controls stand under ``"bounds"``.
    shortfalls : tuple of Shortfall
        Worst rows of the failed frames.
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
    objective_terms: Mapping[str, float]
    violation: Mapping[str, float]
    shortfalls: tuple[Shortfall, ...]
    report: SolveReport

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

    def summary(self) -> str:
        """One sentence: how many frames failed, when, and the worst row."""
        failed = [k for k, status in enumerate(self.frame_status) if not status.is_solved]
        n_frames = len(self.frame_status)
        if not failed:
            return f"all {n_frames} frames solved, objective {self.objective:.6g}"
        time = self.problem.trajectory.time
        times = ", ".join(time_text(time[k]) for k in failed[:5]) + (", …" if len(failed) > 5 else "")
        kinds = sorted({self.frame_status[k].name.lower().replace("_", " ") for k in failed})
        text = f"{len(failed)} of {n_frames} frames failed ({', '.join(kinds)}): t = {times} s"
        return text + (f"; worst: {self.shortfalls[0]}" if self.shortfalls else "")


class SolveFailed(ScsoError):
    """Some frame was not solved; `solution` holds what there is, with its statuses and shortfalls."""

    def __init__(self, solution: Solution) -> None:
        self.solution = solution
        lines = [solution.summary(), *(f"  {shortfall}" for shortfall in solution.shortfalls[1:3])]
        super().__init__("\n".join(lines))
