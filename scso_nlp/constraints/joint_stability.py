"""Joint stability about joint axes: the paper's rule."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import NameMismatchError
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.stability.potvin_brown import potvin_brown
from scso_nlp.stability.rows import AXES, StabilityRows, left_out, select_rows
from scso_nlp.validation import FloatArray, chosen_names, positions


@dataclass(frozen=True, kw_only=True)
@checked
class JointStability(StabilityConstraint):
    r"""Stability about each chosen joint axis is at least `level`.   depends on: one frame.

    .. math:: S_u = \sum_m F_m \, GS_{u,m} - EW_u \ge \text{level}

    with the geometric stability GS per newton of muscle force, whose muscle stiffness is k = q F / L,
    and the external work EW of weights and loads. Rows are called ``"<joint>_<axis>"``.

    Attributes
    ----------
    joints : sequence of str or None
        Joints of the rows; None for all that have an axis which muscles can make stable: a free coordinate
        turns it, and muscles cross the joint.
    axes : sequence of "x", "y", "z", or None
        Axes of each joint; None for all such axes. What is named is kept, whatever it is; what is left out
        where something is not named is in the notes.
    moving_paths : "exact" or "frozen"
        What to do about contact points on wrap surfaces and moving points, see
        :func:`scso_nlp.stability.potvin_brown`.

    References
    ----------
    Potvin and Brown (2005), J Biomech 38:973-980; Akhavanfar et al. (2019), eq. 4.

    Examples
    --------
    >>> about_z = scso.JointStability(joints=["elbow"], axes=["z"], q=5.0, level={"elbow_z": 20.0})
    >>> kept = scso.solve_trajectory(replace(problem, constraints=(scso.MomentEquilibrium(), about_z)))
    >>> kept.stability.rows, float(kept.stability.margin[0, 0].round(2))
    (('elbow_z',), 25.76)
    """

    joints: Sequence[str] | None = None
    axes: Sequence[str] | None = None
    moving_paths: Literal["exact", "frozen"] = "exact"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "joints", chosen_names("joint", self.joints))
        object.__setattr__(self, "axes", chosen_names("axis", self.axes))
        positions("axis", self.axes or (), AXES)

    @property
    def needs(self) -> MotionNeeds:
        """Points of muscle paths, and virtual rotations of those that wrap or move unless they are frozen."""
        joints = ("all",) if self.joints is None else self.joints
        axes = tuple((joint, axis) for joint in joints for axis in self.axes or AXES)
        return MotionNeeds(muscle_paths=True, stability_axes=() if self.moving_paths == "frozen" else axes)

    def stability_rows(self, motion: Motion) -> StabilityRows:
        """Curvature, moment arms and external work of the rows."""
        return potvin_brown(
            motion.trajectory, joints=self.joints, axes=self.axes, moving_paths=self.moving_paths
        )

    def passive_and_taken(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Give passive stiffness and what loads take away, each axis alone."""
        rows = self.stability_rows(motion)
        alone = np.eye(len(rows.rows))
        passive = np.broadcast_to(alone * self.passive_by_row(rows.rows), (motion.n_frames, *alone.shape))
        return passive, alone * rows.external_work[:, None]

    def row_names(self, motion: Motion) -> tuple[str, ...]:
        """Names ``"<joint>_<axis>"``, one per row."""
        skeleton = motion.trajectory.skeleton
        return select_rows(skeleton, self.joints, self.axes)[0] if skeleton is not None else ()

    def by_row(self, values: float | Mapping[str, float] | None, names: Sequence[str]) -> FloatArray:
        """Spread one value, or values by name or pattern, over rows; shape (n_rows,)."""
        try:
            return super().by_row(values, names)
        except NameMismatchError as error:
            if self.joints is not None and self.axes is not None:
                raise
            raise NameMismatchError(
                f"{error}; rows that muscles cannot make stable are left out unless joints and axes are named"
            ) from None

    def notes(self, motion: Motion) -> tuple[str, ...]:
        """Say which rows are left out, and which paths are taken as they are not."""
        paths, omitted = self.stability_rows(motion.frames(0, 1)).notes, self.left_out(motion)
        return (f"no stability rows where {omitted}", *paths) if omitted else paths

    def left_out(self, motion: Motion) -> str:
        """Say which rows are left out, and why; empty where none is."""
        skeleton = motion.trajectory.skeleton
        return "" if skeleton is None else left_out(skeleton, self.joints, self.axes)
