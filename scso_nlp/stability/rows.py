"""What a stability row is made of, and what becomes of it with muscle forces.

A row is one way in which a joint can turn. Its numbers are given per newton of muscle force and do
not depend on the stiffness law; they come from :mod:`scso_nlp.stability.potvin_brown`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from scso_nlp.exceptions import DataError
from scso_nlp.trajectory import Skeleton
from scso_nlp.validation import (
    BoolArray,
    FloatArray,
    IntArray,
    positions,
    read_only,
    shown_names,
    unique_names,
)

#: Letters of the axes of a joint, in the order of `Skeleton.joint_axes`.
AXES = ("x", "y", "z")

#: How far the length of a joint axis may be from one [-]: round-off of rotation matrices is 1e-15.
UNIT_AXIS_TOLERANCE = 1e-9


@dataclass(frozen=True, kw_only=True)
class StabilityRows:
    """Geometry and loads of every stability row of a motion.

    Attributes
    ----------
    rows : tuple of str
        Names: ``"<joint>_<x|y|z>"``, or a coordinate.
    muscles : tuple of str
        Names, as in the trajectory.
    curvature : ndarray, shape (n_frames, n_rows, n_muscles) [m]
        Second derivative of path length, ∂²ℓ/∂θ², for a turn θ of the row; the geometric part.
    moment_arms : ndarray, shape (n_frames, n_rows, n_muscles) [m]
        r = -∂ℓ/∂θ.
    path_length : ndarray, shape (n_frames, n_muscles) [m]
        Full length L of each path, through all its points.
    external_work : ndarray, shape (n_frames, n_rows) [N·m/rad]
        What weights and external loads take away from stability.
    notes : tuple of str
        Approximations that were made, one sentence each.
    """

    rows: tuple[str, ...]
    muscles: tuple[str, ...]
    curvature: FloatArray
    moment_arms: FloatArray
    path_length: FloatArray
    external_work: FloatArray
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "rows", unique_names("row", self.rows))
        set_field(self, "muscles", unique_names("muscle", self.muscles))
        set_field(self, "notes", tuple(str(note) for note in self.notes))
        n_rows, n_muscles = len(self.rows), len(self.muscles)
        path_length = read_only("path_length", self.path_length, (-1, n_muscles), "n_frames, n_muscles")
        set_field(self, "path_length", path_length)
        if (path_length <= 0).any():
            frame, muscle = (int(i) for i in np.argwhere(path_length <= 0)[0])
            raise DataError(
                f"path_length of muscle {self.muscles[muscle]!r} is {path_length[frame, muscle]:g} m "
                f"at frame {frame}, must be positive"
            )
        n_frames = path_length.shape[0]
        table = ((n_frames, n_rows, n_muscles), "n_frames, n_rows, n_muscles")
        for name, (shape, axes) in {
            "curvature": table,
            "moment_arms": table,
            "external_work": ((n_frames, n_rows), "n_frames, n_rows"),
        }.items():
            set_field(self, name, read_only(name, getattr(self, name), shape, axes))

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.path_length.shape[0]

    def frames(self, selection: slice | IntArray) -> StabilityRows:
        """Keep some frames; all else stays.

        Parameters
        ----------
        selection : slice or ndarray of int
            As for indexing the first axis of an array.

        Returns
        -------
        StabilityRows
        """
        return replace(
            self,
            curvature=self.curvature[selection],
            moment_arms=self.moment_arms[selection],
            path_length=self.path_length[selection],
            external_work=self.external_work[selection],
        )


def geometric_stability(rows: StabilityRows, q: ArrayLike) -> FloatArray:
    r"""Stability per newton of muscle force, stiffness part included.

    .. math:: GS_{im} = \frac{\partial^2 \ell_m}{\partial\theta_i^2} + \frac{q_m\, r_{im}^2}{L_m}

    Parameters
    ----------
    rows : StabilityRows
    q : float or array_like, shape (n_muscles,) [-]
        Stiffness of a muscle over its force per length, k = q F / L. One number, or one per muscle in
        the order of ``rows.muscles``.

    Returns
    -------
    ndarray, shape (n_frames, n_rows, n_muscles) [m]

    Raises
    ------
    DataError
        `q` is negative, not finite, or neither one number nor one per muscle.

    References
    ----------
    Akhavanfar et al. (2019), J Biomech, doi 10.1016/j.jbiomech.2019.05.007, equation (4).
    Potvin & Brown (2005), J Biomech 38:973-980.
    """
    n_muscles = len(rows.muscles)
    if np.ndim(q) == 0:
        q = np.full(n_muscles, q)
    stiffness_ratio = read_only("q", q, (n_muscles,), "n_muscles")
    if (stiffness_ratio < 0).any():
        first = int(np.flatnonzero(stiffness_ratio < 0)[0])
        raise DataError(
            f"q of muscle {rows.muscles[first]!r} is {stiffness_ratio[first]:g}, must not be negative"
        )
    return rows.curvature + (stiffness_ratio / rows.path_length)[:, None, :] * rows.moment_arms**2


def joint_stability(rows: StabilityRows, tendon_force: ArrayLike, q: ArrayLike) -> FloatArray:
    r"""Rotational stability of every row with given muscle forces.

    .. math:: S_i = \sum_m F_m\, GS_{im} - EW_i

    Parameters
    ----------
    rows : StabilityRows
    tendon_force : array_like, shape (n_frames, n_muscles) [N]
        In the order of ``rows.muscles``.
    q : float or array_like, shape (n_muscles,) [-]
        As for :func:`geometric_stability`.

    Returns
    -------
    ndarray, shape (n_frames, n_rows) [N·m/rad]
        Positive: a small turn about that axis alone is pushed back.

    Raises
    ------
    DataError
        `tendon_force` has another shape or is not finite, or `q` is unusable.
    """
    force = read_only("tendon_force", tendon_force, (rows.n_frames, len(rows.muscles)), "n_frames, n_muscles")
    return np.einsum("krm,km->kr", geometric_stability(rows, q), force) - rows.external_work


def select_rows(
    skeleton: Skeleton, joints: Iterable[str] | None, axes: Iterable[str] | None
) -> tuple[tuple[str, ...], IntArray, IntArray]:
    """Find joints and axes by name; what is not named is what muscles can make stable.

    Parameters
    ----------
    skeleton : Skeleton
    joints : iterable of str, or None
        None: every joint that has such an axis.
    axes : iterable of str, or None
        Letters among x, y and z; None: all such axes of each joint.

    Returns
    -------
    rows : tuple of str
        ``"<joint>_<axis>"``, axes within joints.
    joint_of_row, axis_of_row : ndarray of int, shape (n_rows,)
        Index into ``skeleton.joints`` and into :data:`AXES`.

    Raises
    ------
    NameMismatchError
        A joint or an axis is not there.
    DataError
        A name stands twice, an axis of the skeleton is not of unit length, or a joint that is named has no
        axis that muscles can make stable, or none has.
    """
    wanted_joints = skeleton.joints if joints is None else unique_names("joint", _names(joints))
    wanted_axes = AXES if axes is None else unique_names("axis", _names(axes))
    joint_indices = positions("joint", wanted_joints, skeleton.joints)
    axis_indices = positions("axis", wanted_axes, AXES)
    joint_of_row = np.repeat(joint_indices, len(axis_indices))
    axis_of_row = np.tile(axis_indices, len(joint_indices))
    if joints is None or axes is None:
        chosen = _can_be_stable(skeleton, joint_of_row, axis_of_row)
        if joints is not None:
            _refuse_joints_without_rows(skeleton, joint_indices, joint_of_row[chosen])
        elif joint_indices.size and not chosen.any():
            raise DataError(
                "muscles can make no joint axis stable, expected one at least: "
                f"{left_out(skeleton, None, axes)}"
            )
        joint_of_row, axis_of_row = joint_of_row[chosen], axis_of_row[chosen]
    rows = tuple(f"{skeleton.joints[j]}_{AXES[a]}" for j, a in zip(joint_of_row, axis_of_row, strict=True))
    lengths = np.linalg.norm(skeleton.joint_axes[:, joint_of_row, axis_of_row], axis=-1)
    wrong = np.abs(lengths - 1.0) > UNIT_AXIS_TOLERANCE
    if wrong.any():
        frame, row = (int(i) for i in np.argwhere(wrong)[0])
        raise DataError(
            f"joint_axes of {rows[row]} has length {lengths[frame, row]:g} at frame {frame}, expected 1"
        )
    return rows, joint_of_row, axis_of_row


def left_out(skeleton: Skeleton, joints: Iterable[str] | None, axes: Iterable[str] | None) -> str:
    """Say which rows :func:`select_rows` leaves out, and why.

    Parameters
    ----------
    skeleton : Skeleton
    joints, axes : iterable of str, or None
        As for :func:`select_rows`.

    Returns
    -------
    str
        By reason, axes and joints; empty where nothing is left out.
    """
    if (joints is not None and axes is not None) or not skeleton.joint_obstacles:
        return ""
    wanted_axes = AXES if axes is None else _names(axes)
    groups: dict[str, dict[str, list[str]]] = {}
    for joint in skeleton.joints if joints is None else _names(joints):
        by_reason: dict[str, list[str]] = {}
        for axis in wanted_axes:
            reason = _obstacle(skeleton, skeleton.joints.index(joint), AXES.index(axis))
            if reason:
                by_reason.setdefault(reason, []).append(axis)
        for reason, found in by_reason.items():
            which = "" if len(found) == len(wanted_axes) else f"{' and '.join(found)} of "
            groups.setdefault(reason, {}).setdefault(which, []).append(joint)
    return "; ".join(
        f"{reason}: " + ", ".join(which + shown_names(names) for which, names in found.items())
        for reason, found in groups.items()
    )


def _obstacle(skeleton: Skeleton, joint: int, axis: int) -> str:
    return skeleton.joint_obstacles[joint * len(AXES) + axis] if skeleton.joint_obstacles else ""


def _can_be_stable(skeleton: Skeleton, joint_of_row: IntArray, axis_of_row: IntArray) -> BoolArray:
    """Tell which rows muscles can make stable as far as is known, shape (n_rows,)."""
    rows = zip(joint_of_row.tolist(), axis_of_row.tolist(), strict=True)
    return np.array([not _obstacle(skeleton, joint, axis) for joint, axis in rows], dtype=bool)


def _refuse_joints_without_rows(skeleton: Skeleton, wanted: IntArray, found: IntArray) -> None:
    without = [skeleton.joints[j] for j in wanted.tolist() if j not in found]
    if without:
        raise DataError(
            f"muscles can make no axis of {shown_names(without)} stable "
            f"({left_out(skeleton, without, None)}): leave it out, or name its axes to have rows all the same"
        )


def _names(names: Iterable[str]) -> tuple[str, ...]:
    """Take one bare string as one name, not as its letters."""
    return (names,) if isinstance(names, str) else tuple(names)
