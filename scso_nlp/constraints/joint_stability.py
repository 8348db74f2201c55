"""Joint stability: every chosen joint axis keeps at least a given rotational stiffness."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.exceptions import NameMismatchError, ProblemError
from scso_nlp.stability.potvin_brown import potvin_brown
from scso_nlp.stability.rows import StabilityRows, geometric_stability
from scso_nlp.transcription.frame import Frame, Rows
from scso_nlp.validation import FloatArray, positions

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


@dataclass(frozen=True, kw_only=True)
class JointStability(FrameConstraint):
    r"""Stability about each chosen joint axis is at least `level`.   depends on: one frame.

    .. math:: S_u = \sum_m F_m \, GS_{u,m} - EW_u \ge \mathrm{level}

    with the geometric stability GS per newton of muscle force, whose muscle stiffness is k = q F / L,
    and the external work EW of weights and loads.

    Attributes
    ----------
    q : float, sequence of float or mapping of str to float [-]
        Stiffness gain; per muscle in the trajectory's order, or by name or pattern with ``*``
        (every muscle must get one; later entries win).
    level : float or mapping of str to float [N·m/rad]
        Least stability, the same for all rows or by row name ``"<joint>_<axis>"``.
    joints : sequence of str or None
        Joints of the rows; None for all joints of the model.
    axes : sequence of "x", "y", "z"
        Axes of each joint.
    moving_paths : "exact" or "frozen"
        What to do about contact points on wrap surfaces and moving points, see
        :func:`scso_nlp.stability.potvin_brown`.

    Raises
    ------
    ProblemError
        q negative or not finite, level not finite.
    NameMismatchError
        Unknown joint, axis, muscle or row.

    References
    ----------
    Potvin and Brown (2005), J Biomech 38:973-980; Akhavanfar et al. (2019), eq. 4.
    """

    q: float | Sequence[float] | Mapping[str, float] = 5.0
    level: float | Mapping[str, float] = 0.0
    joints: Sequence[str] | None = None
    axes: Sequence[str] = ("x", "y", "z")
    moving_paths: Literal["exact", "frozen"] = "exact"

    def __post_init__(self) -> None:
        values = list(self.q.values()) if isinstance(self.q, Mapping) else np.ravel(np.asarray(self.q, float))
        for value in values:
            if not (math.isfinite(value) and value >= 0):
                raise ProblemError(f"q is {value:g}, expected a finite number of at least 0")
        levels = self.level.values() if isinstance(self.level, Mapping) else [self.level]
        for value in levels:
            if not math.isfinite(value):
                raise ProblemError(f"level is {value:g} N·m/rad, expected a finite number")

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Geometric stability (n_frames, n_rows, n_muscles) and external work (n_frames, n_rows)."""
        rows = self.stability_rows(problem)
        return {
            "geometric_stability": geometric_stability(rows, self.gains(problem)),
            "external_work": rows.external_work,
        }

    def stability_rows(self, problem: MuscleForceProblem) -> StabilityRows:
        """Curvature, moment arms and external work of the rows."""
        return potvin_brown(
            problem.trajectory, joints=self.joints, axes=self.axes, moving_paths=self.moving_paths
        )

    def gains(self, problem: MuscleForceProblem) -> FloatArray:
        """Stiffness gain of each muscle, shape (n_muscles,) [-]."""
        muscles = problem.trajectory.muscles
        if not isinstance(self.q, Mapping):
            q = np.asarray(self.q, dtype=float)
            if q.ndim and q.shape != (len(muscles),):
                raise ProblemError(
                    f"q has shape {q.shape}, expected a number or ({len(muscles)},) = (n_muscles,)"
                )
            return np.broadcast_to(q, (len(muscles),)).copy()
        gains = np.full(len(muscles), np.nan)
        for pattern, value in self.q.items():
            hits = [i for i, name in enumerate(muscles) if fnmatch.fnmatchcase(name, pattern)]
            if not hits and "*" in pattern:
                raise NameMismatchError(f"q: the pattern {pattern!r} fits no muscle")
            gains[hits or positions("muscle", [pattern], muscles)] = value
        if np.isnan(gains).any():
            left = ", ".join(name for name, value in zip(muscles, gains, strict=True) if np.isnan(value))
            raise NameMismatchError(
                f"q has no entry for {left}; add them, or a first entry '*' for all others"
            )
        return gains

    def row_names(self, problem: MuscleForceProblem) -> tuple[str, ...]:
        """Names ``"<joint>_<axis>"``, one per row."""
        skeleton = problem.trajectory.skeleton
        joints = self.joints if self.joints is not None else (skeleton.joints if skeleton else ())
        return tuple(f"{joint}_{axis}" for joint in joints for axis in self.axes)

    def rows(self, frame: Frame, problem: MuscleForceProblem) -> Rows:
        """One row per joint axis, in N·m/rad."""
        names = self.row_names(problem)
        if isinstance(self.level, Mapping):
            lower = np.zeros(len(names))
            lower[positions("stability row", self.level, names)] = list(self.level.values())
        else:
            lower = np.full(len(names), float(self.level))
        value = frame.data["geometric_stability"] @ frame.muscle.tendon_force - frame.data["external_work"]
        return Rows(value=value, lower=lower, upper=np.inf, names=names, unit="N·m/rad", scale=10.0)
