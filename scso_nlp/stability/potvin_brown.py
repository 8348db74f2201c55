r"""Stability rows about joint axes from the points of muscle paths.

A path segment from A on the proximal to B on the distal side of a joint, both from the joint center,
has length ℓ = |A - B|. Turning the distal side by θ about the unit axis u moves B, so that

.. math:: r = -\ell' = \frac{u \cdot (B \times A)}{\ell}, \qquad
          \ell'' = \frac{A \cdot B - (A \cdot u)(B \cdot u) - r^2}{\ell}.

Exact for points fixed to bodies. Paths that wrap or move need the engine's own derivatives.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np

from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.stability.external_work import external_work
from scso_nlp.stability.rows import StabilityRows, select_rows
from scso_nlp.trajectory import MotionTrajectory, Skeleton
from scso_nlp.validation import BoolArray, FloatArray

#: A path segment shorter than this [m] has no direction: 1 nm, far below any anatomy.
SHORTEST_SEGMENT = 1e-9


def potvin_brown(
    trajectory: MotionTrajectory,
    joints: Iterable[str] | None = None,
    axes: Iterable[str] | None = None,
    moving_paths: Literal["exact", "frozen"] = "exact",
) -> StabilityRows:
    """Build the rows of Potvin and Brown's stability about joint axes.

    Parameters
    ----------
    trajectory : MotionTrajectory
        Its skeleton must be there.
    joints, axes : iterable of str, or None
        As for :func:`scso_nlp.stability.select_rows`.
    moving_paths : {"exact", "frozen"}
        What to do where a path crosses the joint with a point that slides: a contact on a wrap surface
        or a moving path point. ``"exact"`` takes the skeleton's virtual moment arms and curvature and
        raises where they are missing; ``"frozen"`` takes the point as fixed to its body and says so in
        `StabilityRows.notes`.

    Returns
    -------
    StabilityRows
        One row per joint and axis. A muscle that does not cross the joint has zeros; curvature and
        moment arms of several crossing segments add.

    Raises
    ------
    NameMismatchError
        A joint or an axis is not there.
    DataError
        No skeleton; a muscle without path points or with a sliding point and no virtual derivatives;
        a crossing segment without length.
    ProblemError
        `moving_paths` is neither of the two.

    Notes
    -----
    r is positive if a tensile force turns the distal side about +u. Departures from the source: any
    unit axis instead of the axes of the ground, any number of crossing segments, full path length L in
    the stiffness part. The diagonal is necessary for stability, not sufficient: coupling between axes
    is not seen.

    References
    ----------
    Potvin & Brown (2005), J Biomech 38:973-980.
    Akhavanfar et al. (2019), J Biomech, doi 10.1016/j.jbiomech.2019.05.007, equation (4).
    """
    if moving_paths not in ("exact", "frozen"):
        raise ProblemError(f"moving_paths is {moving_paths!r}, expected 'exact' or 'frozen'")
    skeleton = trajectory.skeleton
    if skeleton is None:
        raise DataError(
            f"the motion {trajectory.name!r} has no skeleton, which stability rows are computed from; "
            "load it from a model again"
        )
    skeleton.require_paths()
    joints, axes = (
        names if names is None or isinstance(names, str) else tuple(names) for names in (joints, axes)
    )
    rows, joint_of_row, axis_of_row = select_rows(skeleton, joints, axes)
    shape = (trajectory.n_frames, len(rows), len(trajectory.muscles))
    curvature, moment_arms = np.zeros(shape), np.zeros(shape)
    has_path = (skeleton.path_point_bodies >= 0).sum(axis=-1) >= 2
    frozen: dict[str, None] = {}
    for joint in dict.fromkeys(int(j) for j in joint_of_row):
        crossing = _Crossing(trajectory.muscles, skeleton, joint)
        for row in np.flatnonzero(joint_of_row == joint):
            arms, curve = crossing.derivatives(int(axis_of_row[row]))
            moment_arms[:, row], curvature[:, row] = arms, curve
            needed = ~has_path if moving_paths == "frozen" else ~has_path | crossing.slides
            _take_virtual(
                rows[row], trajectory, skeleton, needed, has_path, moment_arms[:, row], curvature[:, row]
            )
        if moving_paths == "frozen":
            frozen.update(dict.fromkeys(_named(trajectory.muscles, crossing.slides)))
    notes = (
        (
            "points that slide on wrap surfaces or move along their path are taken as fixed to their "
            f"bodies, so that the curvature is approximate for: {', '.join(frozen)}",
        )
        if frozen
        else ()
    )
    return StabilityRows(
        rows=rows,
        muscles=trajectory.muscles,
        curvature=curvature,
        moment_arms=moment_arms,
        path_length=trajectory.muscle_tendon_length,
        external_work=external_work(skeleton, joints, axes),
        notes=notes,
    )


class _Crossing:
    """The path segments that cross one joint, in all frames.

    `slides` has shape (n_frames, n_muscles): a crossing segment has an end that is not fixed to its body.
    """

    def __init__(self, muscles: tuple[str, ...], skeleton: Skeleton, joint: int) -> None:
        bodies, points = skeleton.path_point_bodies, skeleton.path_points
        present = bodies >= 0
        turns = skeleton.distal_bodies(joint)[bodies] & present
        crosses = present[..., :-1] & present[..., 1:] & (turns[..., :-1] != turns[..., 1:])
        frame, muscle, point = np.nonzero(crosses)
        center = skeleton.joint_centers[frame, joint]
        first = points[frame, muscle, point] - center
        second = points[frame, muscle, point + 1] - center
        first_turns = turns[frame, muscle, point][:, None]
        self.distal = np.where(first_turns, first, second)
        self.proximal = np.where(first_turns, second, first)
        self.length = np.linalg.norm(second - first, axis=-1)
        if (self.length < SHORTEST_SEGMENT).any():
            short = int(np.argmin(self.length))
            raise DataError(
                f"the path of muscle {muscles[muscle[short]]!r} crosses joint {skeleton.joints[joint]!r} "
                f"in a segment of {self.length[short]:g} m at frame {frame[short]}, which has no direction; "
                "move one of its two points"
            )
        self.frame, self.muscle = frame, muscle
        self.axes = skeleton.joint_axes[:, joint]
        self.shape = bodies.shape[:2]
        moves = skeleton.path_point_moves
        self.slides: BoolArray = (crosses & (moves[..., :-1] | moves[..., 1:])).any(axis=-1)

    def derivatives(self, axis: int) -> tuple[FloatArray, FloatArray]:
        """Moment arms and curvature about one axis, both of shape (n_frames, n_muscles) [m]."""
        u = self.axes[self.frame, axis]
        a, b, length = self.proximal, self.distal, self.length
        r = _dot(u, np.cross(b, a)) / length
        curvature = (_dot(a, b) - _dot(a, u) * _dot(b, u) - r**2) / length
        return self._sum(r), self._sum(curvature)

    def _sum(self, values: FloatArray) -> FloatArray:
        total = np.zeros(self.shape)
        np.add.at(total, (self.frame, self.muscle), values)
        return total


def _take_virtual(
    row: str,
    trajectory: MotionTrajectory,
    skeleton: Skeleton,
    needed: BoolArray,
    has_path: BoolArray,
    moment_arms: FloatArray,
    curvature: FloatArray,
) -> None:
    """Fill in the skeleton's virtual derivatives where `needed`, or refuse by name.

    `needed`, `has_path`, `moment_arms` and `curvature` have shape (n_frames, n_muscles); the last two
    are written to.
    """
    if not needed.any():
        return
    missing = needed
    if row in skeleton.virtual_rows:
        index = skeleton.virtual_rows.index(row)
        arms, curve = skeleton.virtual_moment_arms[:, index], skeleton.virtual_curvature[:, index]
        missing = needed & ~(np.isfinite(arms) & np.isfinite(curve))
    if missing.any():
        muscles = trajectory.muscles
        joint, axis = row.rsplit("_", 1)
        without = _named(muscles, missing & ~has_path)
        if without:
            raise DataError(
                f"{', '.join(without)} has no path points (a path given by functions?), so its stability "
                f"about axis {axis} of joint {joint!r} is unknown; load the motion with this constraint in "
                f"prepare_for, or give the muscle a geometry path"
            )
        raise DataError(
            f"{', '.join(_named(muscles, missing))} crosses joint {joint!r} with a point that slides on a "
            f"wrap surface or moves, so the straight formula is not exact about axis {axis}; load the motion "
            f"with this constraint in prepare_for, choose moving_paths='frozen', or leave the joint out"
        )
    moment_arms[needed] = arms[needed]
    curvature[needed] = curve[needed]


def _named(muscles: tuple[str, ...], mask: BoolArray) -> list[str]:
    """Names of the muscles with a True in any frame; `mask` has shape (n_frames, n_muscles)."""
    return [muscles[m] for m in np.flatnonzero(mask.any(axis=0))]


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.einsum("si,si->s", a, b)
