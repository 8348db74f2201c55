"""Everything known about one motion: frozen arrays, validated and named.

`MotionTrajectory` is what the optimisation needs in every frame; its `Skeleton` holds the joints,
bodies, muscle paths and loads from which stability rows are computed. Frames always come first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Protocol, TypeVar

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.display import card, table, without_arrays
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.joint_reactions import JointReactionMap
from scso_nlp.text import shown
from scso_nlp.validation import (
    BoolArray,
    FloatArray,
    IntArray,
    positions,
    read_only,
    read_only_flags,
    read_only_integers,
    unique_names,
)

#: Times beyond this need more than six digits to tell frames apart [s].
LONG_AGO = 1e4
#: Times of two results may differ by this share of a frame and still be the same frames [-].
SAME_TIME = 1e-3
#: Body index of a padding entry in `Skeleton.path_point_bodies`.
NO_POINT = -1


@dataclass(frozen=True, kw_only=True)
@checked
class Skeleton:
    """Joints, bodies, muscle paths and loads of one motion, all expressed in ground.

    Body 0 is ground. The base side of a joint is the one that holds ground.

    Attributes
    ----------
    bodies : tuple of str
        Names; the first is ``"ground"``.
    body_parents : ndarray of int, shape (n_bodies,)
        Index of the body that each body hangs on in the multibody tree; -1 for ground.
    body_masses : ndarray, shape (n_bodies,) [kg]
    body_mass_centers : ndarray, shape (n_frames, n_bodies, 3) [m]
    gravity : ndarray, shape (3,) [m/s²]
    joints : tuple of str
        Joints that can move, in the model's order.
    joint_children : ndarray of int, shape (n_joints,)
        The body on the distal side of each joint.
    joint_centers : ndarray, shape (n_frames, n_joints, 3) [m]
        Origin of the joint's frame on the distal side.
    joint_axes : ndarray, shape (n_frames, n_joints, 3, 3) [-]
        ``joint_axes[k, j, u]`` is the unit axis called x, y or z (u = 0, 1, 2). For a joint with a
        spatial transform these are its three successive rotation axes, each called by the letter it
        lies nearest to; otherwise the axes of its frame on the base side.
    joint_obstacles : tuple of str
        Why muscles cannot make a joint axis stable, empty where they can: of x, y and z of the first joint,
        then of the next; none at all where it is not known.
    load_names : tuple of str
        External loads.
    load_bodies : ndarray of int, shape (n_loads,)
        Body that each load acts on.
    load_forces, load_points, load_torques : ndarray, shape (n_frames, n_loads, 3) [N], [m], [N·m]
    path_points : ndarray, shape (n_frames, n_muscles, n_points, 3) [m]
        Points of every muscle's path from origin to insertion, padded at the end with zeros.
    path_point_bodies : ndarray of int, shape (n_frames, n_muscles, n_points)
        The body each point is fixed to; -1 where padded.
    path_point_moves : ndarray of bool, shape (n_frames, n_muscles, n_points)
        True for points that are not fixed to their body: contact points on a wrap surface and moving
        path points.
    virtual_rows : tuple of str
        ``"<joint>_<x|y|z>"`` of the joint axes for which the two following arrays are given.
    virtual_moment_arms : ndarray, shape (n_frames, n_virtual_rows, n_muscles) [m]
        Moment arms when everything distal of the joint turns rigidly about the axis, by OpenSim's own
        paths; NaN where not asked for (paths without moving points need none).
    virtual_curvature : ndarray, shape (n_frames, n_virtual_rows, n_muscles) [m]
        Second derivative of muscle-tendon length for the same rotation; NaN likewise.
    """

    bodies: tuple[str, ...]
    body_parents: IntArray
    body_masses: FloatArray
    body_mass_centers: FloatArray
    gravity: FloatArray
    joints: tuple[str, ...]
    joint_children: IntArray
    joint_centers: FloatArray
    joint_axes: FloatArray
    load_names: tuple[str, ...]
    load_bodies: IntArray
    load_forces: FloatArray
    load_points: FloatArray
    load_torques: FloatArray
    path_points: FloatArray
    path_point_bodies: IntArray
    path_point_moves: BoolArray
    virtual_rows: tuple[str, ...] = ()
    virtual_moment_arms: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    virtual_curvature: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    joint_obstacles: tuple[str, ...] = ()

    __repr__ = without_arrays

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        for kind in ("bodies", "joints", "load_names", "virtual_rows"):
            set_field(self, kind, unique_names(kind, getattr(self, kind)))
        n_bodies, n_joints, n_loads = len(self.bodies), len(self.joints), len(self.load_names)
        set_field(self, "joint_obstacles", tuple(self.joint_obstacles))
        if len(self.joint_obstacles) not in (0, 3 * n_joints):
            raise DataError(
                f"joint_obstacles has {len(self.joint_obstacles)} entries, expected none or three for each "
                f"of {n_joints} joints"
            )
        of_points = "n_frames, n_muscles, n_points"
        owners = read_only_integers(
            "path_point_bodies",
            self.path_point_bodies,
            (-1, -1, -1),
            of_points,
            least=NO_POINT,
            below=n_bodies,
        )
        set_field(self, "path_point_bodies", owners)
        n_frames, n_muscles, n_points = owners.shape
        if not self.virtual_rows:
            for name in ("virtual_moment_arms", "virtual_curvature"):
                set_field(self, name, np.zeros((n_frames, 0, n_muscles)))
        n_rows = len(self.virtual_rows)
        shapes = {
            "body_masses": ((n_bodies,), "n_bodies"),
            "body_mass_centers": ((n_frames, n_bodies, 3), "n_frames, n_bodies, 3"),
            "gravity": ((3,), "3"),
            "joint_centers": ((n_frames, n_joints, 3), "n_frames, n_joints, 3"),
            "joint_axes": ((n_frames, n_joints, 3, 3), "n_frames, n_joints, 3, 3"),
            "load_forces": ((n_frames, n_loads, 3), "n_frames, n_loads, 3"),
            "load_points": ((n_frames, n_loads, 3), "n_frames, n_loads, 3"),
            "load_torques": ((n_frames, n_loads, 3), "n_frames, n_loads, 3"),
            "path_points": ((n_frames, n_muscles, n_points, 3), "n_frames, n_muscles, n_points, 3"),
            "virtual_moment_arms": ((n_frames, n_rows, n_muscles), "n_frames, n_virtual_rows, n_muscles"),
            "virtual_curvature": ((n_frames, n_rows, n_muscles), "n_frames, n_virtual_rows, n_muscles"),
        }
        for name, (shape, axes) in shapes.items():
            finite = not name.startswith("virtual")
            set_field(self, name, read_only(name, getattr(self, name), shape, axes, finite=finite))
        for name, length, axes in (
            ("body_parents", n_bodies, "n_bodies"),
            ("joint_children", n_joints, "n_joints"),
            ("load_bodies", n_loads, "n_loads"),
        ):
            indices = read_only_integers(
                name, getattr(self, name), (length,), axes, least=NO_POINT, below=n_bodies
            )
            set_field(self, name, indices)
        moves = read_only_flags("path_point_moves", self.path_point_moves, owners.shape, of_points)
        set_field(self, "path_point_moves", moves)

    def frames(self, selection: slice | IntArray) -> Skeleton:
        """Keep some frames; all else stays."""
        return _select_frames(self, selection)

    def require_paths(self) -> None:
        """Refuse a skeleton that was read without muscle paths.

        Raises
        ------
        DataError
            No muscle has a point, and virtual rotations are not given either.
        """
        _, n_muscles, n_points = self.path_point_bodies.shape
        if n_muscles and not n_points and not self.virtual_rows:
            raise DataError(
                "the skeleton has no points of muscle paths, expected some; read the motion again with "
                "prepare_for=[the stability constraint]"
            )

    def distal_bodies(self, joint: int) -> BoolArray:
        """Tell which bodies turn with the distal side of a joint.

        Returns
        -------
        ndarray of bool, shape (n_bodies,)
        """
        distal = np.zeros(len(self.bodies), dtype=bool)
        distal[self.joint_children[joint]] = True
        for body in range(len(self.bodies)):
            chain: list[int] = []
            ancestor = body
            while ancestor >= 0 and not distal[ancestor] and len(chain) <= len(self.bodies):
                chain.append(ancestor)
                ancestor = int(self.body_parents[ancestor])
            if ancestor >= 0 and distal[ancestor]:
                distal[chain] = True
        return distal


@dataclass(frozen=True, kw_only=True)
@checked
class CoordinateCurvature:
    """Second derivatives of path lengths and loads with respect to chosen coordinates.

    Attributes
    ----------
    coordinates : tuple of str
        Free coordinates of the trajectory, n_chosen of them; all else is held still.
    path_curvature : ndarray, shape (n_frames, n_chosen, n_chosen, n_muscles) [m]
        Second derivative of muscle-tendon length, -dr_i/dq_j made symmetric; for translations [1/m].
    load_stiffness : ndarray, shape (n_frames, n_chosen, n_chosen) [N·m/rad]
        -dτ_i/dq_j of gravity and external loads (constant in direction, fixed to their bodies), made
        symmetric; it stands in the Hessian as it is.
    passive_stiffness : ndarray, shape (n_frames, n_chosen, n_chosen) [N·m/rad]
        Likewise of the model's own passive elements: springs, bushings, limit forces, ligaments.
    asymmetry : ndarray, shape (n_frames, n_muscles) [m]
        Largest difference of ∂r_i/∂q_j and ∂r_j/∂q_i; not zero where moment arms are no gradient of a length.
    is_uncertain : ndarray of bool, shape (n_frames, n_muscles)
        True where derivatives at two steps disagree or the path changes its points nearby.
    """

    coordinates: tuple[str, ...]
    path_curvature: FloatArray
    load_stiffness: FloatArray
    passive_stiffness: FloatArray
    asymmetry: FloatArray
    is_uncertain: BoolArray

    __repr__ = without_arrays

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "coordinates", unique_names("coordinate", self.coordinates))
        n = len(self.coordinates)
        of_muscles = "n_frames, n_muscles"
        n_frames, n_muscles = read_only("asymmetry", self.asymmetry, (-1, -1), of_muscles).shape
        shapes = {
            "path_curvature": ((n_frames, n, n, n_muscles), "n_frames, n_chosen, n_chosen, n_muscles"),
            "load_stiffness": ((n_frames, n, n), "n_frames, n_chosen, n_chosen"),
            "passive_stiffness": ((n_frames, n, n), "n_frames, n_chosen, n_chosen"),
            "asymmetry": ((n_frames, n_muscles), of_muscles),
        }
        for name, (shape, axes) in shapes.items():
            set_field(self, name, read_only(name, getattr(self, name), shape, axes))
        uncertain = read_only_flags("is_uncertain", self.is_uncertain, (n_frames, n_muscles), of_muscles)
        set_field(self, "is_uncertain", uncertain)

    def frames(self, selection: slice | IntArray) -> CoordinateCurvature:
        """Keep some frames; all else stays."""
        return _select_frames(self, selection)


@dataclass(frozen=True, kw_only=True)
@checked
class MotionTrajectory:
    """Time series of one motion, ready for optimisation.

    Coordinates are the free ones, in the model's multibody tree order: locked, prescribed and coupled
    coordinates have been eliminated (their share stands in the moment arms of the free ones).

    Attributes
    ----------
    name : str
        Name of the analysis; result files start with it.
    muscles, actuators, coordinates : tuple of str
    is_rotational : ndarray of bool, shape (n_coordinates,)
        True where the coordinate is an angle.
    time : ndarray, shape (n_frames,) [s]
        Strictly increasing.
    coordinate_values, coordinate_speeds : ndarray, shape (n_frames, n_coordinates) [rad, m], [rad/s, m/s]
    muscle_tendon_length : ndarray, shape (n_frames, n_muscles) [m]
    muscle_tendon_velocity : ndarray, shape (n_frames, n_muscles) [m/s]
        Positive when lengthening.
    moment_arms : ndarray, shape (n_frames, n_coordinates, n_muscles) [m]
        Generalized force per newton of tendon force, r = -dl/dq.
    actuator_generalized_forces : ndarray, shape (n_frames, n_coordinates, n_actuators) [N·m or N]
        Generalized force of each actuator at a control of one.
    generalized_forces : ndarray, shape (n_frames, n_coordinates) [N·m or N]
        What muscles and actuators together must produce.
    passive_generalized_forces : ndarray, shape (n_frames, n_coordinates) [N·m or N]
        Share of the model's passive elements (springs, bushings, limit forces, ligaments), already
        taken off `generalized_forces`.
    active_force_capacity : ndarray, shape (n_frames, n_muscles) [N]
        OpenSim's tendon force at full activation with an inextensible tendon.
    force_columns : tuple of str
        Columns of OpenSim's force file in its order: actuators and `other_force_labels`.
    other_force_labels : tuple of str
        Record labels of the forces that are not optimised.
    other_forces : ndarray, shape (n_frames, n_other_force_labels) [mixed]
    base_coordinates : tuple of str or None
        Coordinates by which the model floats: of a joint that may both turn and shift against ground. What
        actuators do there is residual: nothing real holds the model. None: not known.
    skeleton : Skeleton or None
    curvature : CoordinateCurvature or None
        Only where it was asked for.
    joint_reactions : JointReactionMap or None
        Likewise.
    """

    name: str
    muscles: tuple[str, ...]
    actuators: tuple[str, ...] = ()
    coordinates: tuple[str, ...]
    is_rotational: BoolArray
    time: FloatArray
    coordinate_values: FloatArray
    coordinate_speeds: FloatArray
    muscle_tendon_length: FloatArray
    muscle_tendon_velocity: FloatArray
    moment_arms: FloatArray
    actuator_generalized_forces: FloatArray
    generalized_forces: FloatArray
    passive_generalized_forces: FloatArray
    active_force_capacity: FloatArray
    force_columns: tuple[str, ...] = ()
    other_force_labels: tuple[str, ...] = ()
    other_forces: FloatArray
    base_coordinates: tuple[str, ...] | None = None
    skeleton: Skeleton | None = None
    curvature: CoordinateCurvature | None = None
    joint_reactions: JointReactionMap | None = None

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        for kind in ("muscles", "actuators", "coordinates", "other_force_labels"):
            set_field(self, kind, unique_names(kind, getattr(self, kind)))
        set_field(self, "force_columns", tuple(self.force_columns))
        if self.base_coordinates is not None:
            set_field(self, "base_coordinates", tuple(self.base_coordinates))
        n_muscles, n_actuators, n_coordinates = len(self.muscles), len(self.actuators), len(self.coordinates)
        time = read_only("time", self.time, (-1,), "n_frames")
        set_field(self, "time", time)
        if time.size == 0:
            raise DataError(f"the motion {self.name!r} has no frame, expected at least one")
        back = np.flatnonzero(time[1:] <= time[:-1])
        if back.size:
            late = int(back[0]) + 1
            raise DataError(
                f"time is not increasing at frame {late}: {time[late]:g} s after {time[late - 1]:g} s"
            )
        f = time.size
        shapes = {
            "coordinate_values": ((f, n_coordinates), "n_frames, n_coordinates"),
            "coordinate_speeds": ((f, n_coordinates), "n_frames, n_coordinates"),
            "muscle_tendon_length": ((f, n_muscles), "n_frames, n_muscles"),
            "muscle_tendon_velocity": ((f, n_muscles), "n_frames, n_muscles"),
            "moment_arms": ((f, n_coordinates, n_muscles), "n_frames, n_coordinates, n_muscles"),
            "actuator_generalized_forces": (
                (f, n_coordinates, n_actuators),
                "n_frames, n_coordinates, n_actuators",
            ),
            "generalized_forces": ((f, n_coordinates), "n_frames, n_coordinates"),
            "passive_generalized_forces": ((f, n_coordinates), "n_frames, n_coordinates"),
            "active_force_capacity": ((f, n_muscles), "n_frames, n_muscles"),
            "other_forces": ((f, len(self.other_force_labels)), "n_frames, n_other_force_labels"),
        }
        for name, (shape, axes) in shapes.items():
            set_field(self, name, read_only(name, getattr(self, name), shape, axes))
        rotational = read_only_flags("is_rotational", self.is_rotational, (n_coordinates,), "n_coordinates")
        set_field(self, "is_rotational", rotational)
        if self.skeleton is not None:
            found = self.skeleton.path_point_bodies.shape[:2]
            if found != (f, n_muscles):
                raise DataError(
                    f"skeleton has {found} (n_frames, n_muscles), the trajectory has {(f, n_muscles)}"
                )

        if self.curvature is not None:
            positions("coordinate", self.curvature.coordinates, self.coordinates)
            found = self.curvature.asymmetry.shape
            if found != (f, n_muscles):
                raise DataError(
                    f"curvature has {found} (n_frames, n_muscles), the trajectory has {(f, n_muscles)}"
                )

        if self.joint_reactions is not None:
            of_muscles, of_actuators = self.joint_reactions.per_tendon_force, self.joint_reactions.per_control
            sizes = (len(of_muscles), of_muscles.shape[3], of_actuators.shape[3])
            if sizes != (f, n_muscles, n_actuators):
                raise DataError(
                    f"joint_reactions has {sizes} (n_frames, n_muscles, n_actuators), the trajectory has "
                    f"{(f, n_muscles, n_actuators)}"
                )

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.time.size

    def summary(self) -> str:
        """One line: frames, muscles, actuators and free coordinates."""
        span = f"{time_text(self.time[0])} to {time_text(self.time[-1])} s"
        return (
            f"{self.name}: {self.n_frames} frames from {span}, {len(self.muscles)} muscles, "
            f"{len(self.actuators)} actuators, {len(self.coordinates)} free coordinates"
        )

    def __repr__(self) -> str:
        text = f"Motion {self.summary()}"
        if self.skeleton is not None:
            bodies, joints = len(self.skeleton.bodies), len(self.skeleton.joints)
            paths = "with" if self.skeleton.path_points.shape[2] else "without"
            text += f"\n  skeleton of {bodies} bodies and {joints} joints, {paths} points of muscle paths"
            if rows := self.skeleton.virtual_rows:
                text += f"\n  virtual rotations {shown(rows)}"
        if self.curvature is not None:
            text += f"\n  curvature along {shown(self.curvature.coordinates)}"
        return text

    def _repr_html_(self) -> str:
        values = np.where(self.is_rotational, np.rad2deg(self.coordinate_values), self.coordinate_values)
        forces = np.abs(self.generalized_forces).max(axis=0)
        rows = [
            (name, float(values[:, c].min()), float(values[:, c].max()), "°" if angle else "m",
             float(forces[c]), "N·m" if angle else "N")
            for c, (name, angle) in enumerate(zip(self.coordinates, self.is_rotational, strict=True))
        ]  # fmt: skip
        head = ("coordinate", "least", "most", "", "largest generalized force", "")
        return card(repr(self), table(head, rows))

    @property
    def is_at_rest(self) -> bool:
        """True if no coordinate moves in any frame: then few frames are tasks rather than a movement."""
        return not self.coordinate_speeds.any()

    def frames(self, start: int | Iterable[int], stop: int | None = None) -> MotionTrajectory:
        """Keep the frames from `start` up to but without `stop`, or the frames listed.

        Returns
        -------
        MotionTrajectory
            All else unchanged.
        """
        if isinstance(start, int | np.integer):
            return _select_frames(self, slice(start, stop))
        return _select_frames(self, np.array(list(start), dtype=np.int64))


def time_text(time: float) -> str:
    """Write a time for a message: six digits, and milliseconds where time counts from long ago.

    Parameters
    ----------
    time : float [s]

    Returns
    -------
    str
        Without unit. Epoch seconds would all look alike with six digits.
    """
    return f"{time:g}" if abs(time) < LONG_AGO else f"{time:.3f}"


class OfMotion(Protocol):
    """Whatever has muscles and frames: a trajectory, or a result read back from its files."""

    @property
    def muscles(self) -> tuple[str, ...]:
        """Names of the muscles."""

    @property
    def time(self) -> FloatArray:
        """Times of the frames, shape (n_frames,) [s]."""


def require_same_motion(motions: Mapping[str, OfMotion]) -> None:
    """Check that all have the same muscles at the same times.

    Parameters
    ----------
    motions : mapping of str to OfMotion
        By what messages shall call them; at least one. The first is what the others are held against.

    Raises
    ------
    NameMismatchError
        Other muscles, or the same in another order.
    DataError
        Another number of frames, or frames at other times (by more than a thousandth of the shortest step).
    """
    (first, expected), *others = motions.items()
    step = float(np.diff(expected.time).min()) if expected.time.size > 1 else 1.0
    for label, found in others:
        if found.muscles != expected.muscles:
            missing = [name for name in expected.muscles if name not in found.muscles]
            extra = [name for name in found.muscles if name not in expected.muscles]
            raise NameMismatchError(
                f"{label!r} and {first!r} are not of one model: "
                f"missing muscles {missing[:6] or 'none'}, extra {extra[:6] or 'none'}"
                + ("" if missing or extra else ", different order")
            )
        if found.time.size != expected.time.size:
            raise DataError(
                f"{label!r} has {found.time.size} frames and {first!r} has {expected.time.size}: "
                "expected one motion"
            )
        apart = np.flatnonzero(np.abs(found.time - expected.time) > SAME_TIME * step)
        if len(apart):
            k = int(apart[0])
            raise DataError(
                f"frame {k} of {label!r} is at t = {found.time[k]} s, of {first!r} at "
                f"{expected.time[k]} s: expected one motion"
            )


#: Fields whose first axis is not the frames.
_WITHOUT_FRAMES = frozenset(
    {"is_rotational", "body_parents", "body_masses", "gravity", "joint_children", "load_bodies"}
)


_Data = TypeVar("_Data", MotionTrajectory, Skeleton, CoordinateCurvature)


def _select_frames(data: _Data, selection: slice | IntArray) -> _Data:
    changes: dict[str, object] = {}
    for item in fields(data):
        value = getattr(data, item.name)
        if isinstance(value, np.ndarray) and item.name not in _WITHOUT_FRAMES:
            changes[item.name] = value[selection]
        elif isinstance(value, Skeleton | CoordinateCurvature | JointReactionMap):
            changes[item.name] = value.frames(selection)
    return replace(data, **changes)  # type: ignore[arg-type]
