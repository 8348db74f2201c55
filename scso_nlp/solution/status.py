"""How the solve of a frame ended, and why it failed where it did."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.display import without_arrays
from scso_nlp.trajectory import time_text
from scso_nlp.validation import FloatArray
from scso_nlp.verdict import USABLE


class Status(enum.Enum):
    """How the solve of a frame ended; the value is a sentence with the remedy."""

    SOLVED = "Solved to the requested tolerance."
    STABILITY_MISSED = "Solved, and a soft level or limit is missed at its price; see what is missed."
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
        "min/max, weights, moments and controls nearer to one, or another initial guess."
    )
    ITERATION_LIMIT = "The iteration limit was reached; raise max_iterations or give a better initial guess."
    NUMERICAL_ERROR = "The solver met numbers it could not use; check the objective for NaN at its bounds."

    @property
    def is_solved(self) -> bool:
        """True if the frame may be used."""
        return self.name in USABLE


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

    __repr__ = without_arrays

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
