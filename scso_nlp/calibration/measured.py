"""What was measured in a trial, and how far a solution is from it, with derivatives."""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scso_nlp.activity import MuscleActivity
from scso_nlp.arguments import checked
from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.emg.metrics import is_constant
from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.motion import Motion
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.sensitivities import Sensitivity
from scso_nlp.solution import Solution
from scso_nlp.validation import FloatArray, IntArray, positions


class Measurement(abc.ABC):
    """Something measured: residuals of a solution, whose squares add up to its error, and their slopes."""

    @property
    @abc.abstractmethod
    def meaning(self) -> str:
        """What the error of a trial is, with its unit."""

    @abc.abstractmethod
    def residuals(self, solution: Solution, frames: IntArray) -> FloatArray:
        """Distances from the measurement over the frames of one unit, shape (n_frames, n)."""

    @abc.abstractmethod
    def slopes(self, change: Sensitivity, frames: IntArray) -> FloatArray:
        """Their derivatives, shape (n_frames, n, n_parameters); zero in frames without derivatives."""


@dataclass(frozen=True, kw_only=True)
@checked
class MeasuredEmg(Measurement):
    r"""Activity of muscle groups over a trial.

    .. math:: \frac1{n_g n_k} \sum_{g,k} (\bar a_{gk} - e_{gk})^2 \quad\text{or}\quad
              \frac1{n_g} \sum_g (1 - r_g)

    is its error, with the mean activation of a group's muscles, its measured activity e and their
    correlation r over the :math:`n_k` frames.

    Attributes
    ----------
    activity : MuscleActivity
        From EMG by :func:`scso_nlp.emg.activity_of`.
    compare : "levels" or "shapes"
        Shapes where the EMG is not a share of a maximal contraction. The model's activity is silent where it
        does not change: such a group counts 1/2, and has no derivative.

    Examples
    --------
    >>> activity = scso.MuscleActivity(
    ...     groups=("flexors",), muscles=(("biceps", "brachialis"),), time=[0.0, 9.0], values=[[0.1], [0.3]]
    ... )
    >>> scso.MeasuredEmg(activity=activity, compare="shapes").meaning
    '1 - r of activation and EMG [-]'
    """

    activity: MuscleActivity
    compare: Literal["levels", "shapes"] = "levels"

    @property
    def meaning(self) -> str:
        """What the error of a trial is, with its unit."""
        if self.compare == "shapes":
            return "1 - r of activation and EMG [-]"
        return "mean squared difference of activation and EMG [-]"

    def residuals(self, solution: Solution, frames: IntArray) -> FloatArray:
        """Distances of levels, or of shapes of unit length, by frame and group."""
        share, measured = self._groups(solution.problem.motion, frames)
        modeled = solution.activation[frames] @ share
        if self.compare == "levels":
            return np.asarray((modeled - measured) / math.sqrt(measured.size))
        for group, series in zip(self.activity.groups, measured.T, strict=True):
            if is_constant(series):
                raise DataError(f"{self.activity.source}: group {group!r} does not change, it has no shape")
        return (_shape(modeled)[0] - _shape(measured)[0]) / math.sqrt(2 * measured.shape[1])

    def slopes(self, change: Sensitivity, frames: IntArray) -> FloatArray:
        """Give the derivatives of the distances."""
        share, measured = self._groups(change.solution.problem.motion, frames)
        slope = np.einsum("kpm,mg->kgp", np.nan_to_num(change.activation[frames]), share)
        if self.compare == "levels":
            return np.asarray(slope / math.sqrt(measured.size))
        shape, size = _shape(change.solution.activation[frames] @ share)
        centred = (slope - slope.mean(axis=0)) / size[:, None]
        along = np.einsum("kg,kgp->gp", shape, centred)
        return (centred - shape[:, :, None] * along) / math.sqrt(2 * measured.shape[1])

    def _groups(self, motion: Motion, frames: IntArray) -> tuple[FloatArray, FloatArray]:
        """Share of each muscle in the mean of its group, and measured activity (n_frames, n_groups)."""
        where, groups, measured = self.activity.of(motion)
        share = np.zeros((motion.muscles.n_muscles, len(self.activity.groups)))
        share[where, groups] = 1 / np.bincount(groups)[groups]
        first = np.unique(groups, return_index=True)[1]
        return share, measured[frames][:, first]


def _shape(series: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns less their means and of unit length, zero where constant, and what they were divided by."""
    centred = series - series.mean(axis=0)
    size = np.linalg.norm(centred, axis=0)
    size[[is_constant(column) for column in series.T]] = np.inf
    return centred / size, size


@dataclass(frozen=True, kw_only=True)
@checked
class MeasuredStiffness(Measurement):
    r"""Stiffness of a point, or about a row, in every frame of a trial.

    .. math:: k = \Big(\sum_i h_i^2 / S_i\Big)^{-1}

    with the stability S of rows in series and the lever arms h of the point about their axes. The error is
    the mean of the squares of :math:`k / k_{measured} - 1` over frames.

    Attributes
    ----------
    stiffness : float [N/m]
        As a point at the arms moves it: 14.5 N/mm are 14500 N/m. About one row, with an arm of 1, it is in
        N·m/rad.
    arms : mapping of str to float [m]
        By row of a :class:`~scso_nlp.JointStability` or :class:`~scso_nlp.CoordinateStability` that the
        problem keeps.

    Raises
    ------
    ProblemError
        A stiffness that is not positive, no arm, an arm that is zero or not finite.

    Notes
    -----
    A stiffness measured with reflexes is more than what muscles have by themselves.

    Examples
    --------
    >>> measured = scso.MeasuredStiffness(stiffness=14500.0, arms={"elbow_z": 0.3})
    >>> measured.of(solution).shape
    (7,)
    """

    stiffness: float
    arms: Mapping[str, float]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.stiffness) and self.stiffness > 0):
            raise ProblemError(f"stiffness is {self.stiffness:g}, expected a positive number of N/m")
        if not self.arms:
            raise ProblemError("arms is empty, expected the arm of at least one row")
        for row, arm in self.arms.items():
            if not math.isfinite(arm) or arm == 0:
                raise ProblemError(f"arm of {row!r} is {arm:g}, expected a finite number of m that is not 0")

    @property
    def meaning(self) -> str:
        """What the error of a trial is, with its unit."""
        return "mean squared relative difference of stiffness [-]"

    def residuals(self, solution: Solution, frames: IntArray) -> FloatArray:
        """Relative differences of the stiffness by frame."""
        ratio = self.of(solution)[frames] / self.stiffness
        return np.asarray((ratio - 1)[:, None] / math.sqrt(len(ratio)))

    def of(self, solution: Solution) -> FloatArray:
        """Stiffness of a solution, shape (n_frames,) [N/m]; 0 where a row has none."""
        values = np.hstack([solution.rows[name].value[:, rows] for name, rows, _ in self._rows(solution)])
        with np.errstate(divide="ignore"):
            return np.asarray(1 / (self._arms(solution) ** 2 / values).sum(axis=1))

    def slopes(self, change: Sensitivity, frames: IntArray) -> FloatArray:
        """Give the derivatives of the relative differences."""
        solution, total = change.solution, 0.0
        stiffness = self.of(solution)
        for name, rows, arms in self._rows(solution):
            value, slope = solution.rows[name].value[:, rows], change.row_value[name][:, :, rows]
            if f"{name}.missed" in change.variables:
                slope = slope - change.variables[f"{name}.missed"][:, :, rows]
            with np.errstate(divide="ignore", invalid="ignore"):
                weight = (stiffness[:, None] * arms / value) ** 2
            total = total + np.einsum("kr,kpr->kp", weight, slope)
        slopes = np.nan_to_num(total, posinf=0.0, neginf=0.0)[frames, None]
        return np.asarray(slopes / (self.stiffness * math.sqrt(len(frames))))

    def _rows(self, solution: Solution) -> list[tuple[str, list[int], FloatArray]]:
        """Constraints that have rows with an arm: name, positions of the rows, arms."""
        found, left = [], dict(self.arms)
        known: list[str] = []
        for term in solution.problem.constraints:
            if isinstance(term, StabilityConstraint) and term.name in solution.rows:
                names = solution.rows[term.name].names
                known += names
                mine = [row for row in names if row in left]
                arms = np.array([left.pop(row) for row in mine])
                if mine:
                    found.append((term.name, positions("stability row", mine, names).tolist(), arms))
        positions("stability row of arms", left, known)
        return found

    def _arms(self, solution: Solution) -> FloatArray:
        return np.concatenate([arms for _, _, arms in self._rows(solution)])


@dataclass(frozen=True, kw_only=True)
@checked
class MeasuredTrial:
    """A motion and what was measured in it.

    Attributes
    ----------
    problem : MuscleForceProblem
        With a stability constraint that it keeps, which begins with its own gains and levels.
    measured : MeasuredEmg or MeasuredStiffness
    unit : str or sequence of str, one per frame
        What is left out together: all trials of a person, or the frames of one stride or lift. Each trial is
        a unit by default.

    Raises
    ------
    ProblemError
        A problem that keeps no stability constraint, or only a whole Hessian, which has no rows that a
        stiffness could be about; units of frames in a problem that couples frames.
    DataError
        Units for another number of frames.

    Examples
    --------
    >>> stiff = scso.MeasuredStiffness(stiffness=100.0, arms={"elbow_z": 1.0})
    >>> scso.MeasuredTrial(problem=problem, measured=stiff, unit="person 1").unit
    'person 1'
    """

    problem: MuscleForceProblem
    measured: MeasuredEmg | MeasuredStiffness
    unit: str | Sequence[str] = ""

    def __post_init__(self) -> None:
        kept = [term for term in self.problem.constraints if isinstance(term, StabilityConstraint)]
        if not kept:
            raise ProblemError("the problem keeps no stability constraint whose numbers could be calibrated")
        is_stiffness = isinstance(self.measured, MeasuredStiffness)
        if is_stiffness and all(isinstance(term, HessianStability) for term in kept):
            raise ProblemError(
                "a measured stiffness is about rows, and a whole Hessian has none: keep a JointStability or "
                "CoordinateStability, besides it or instead (potvin-brown, diagonal), or compare EMG"
            )
        if not isinstance(self.unit, str):
            object.__setattr__(self, "unit", tuple(self.unit))
            if self.problem.coupled_terms:
                raise ProblemError(
                    f"{', '.join(self.problem.coupled_terms)} couples frames, expected one unit for the trial"
                )
            if len(self.unit) != (n := self.problem.motion.n_frames):
                raise DataError(
                    f"unit names {len(self.unit)} frames, expected {n}, as many as the motion has"
                )
