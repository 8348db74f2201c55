"""Bodies of a model: which hangs on which, where they are, how they and their points move."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import opensim as osim

from scso_nlp.validation import FloatArray, IntArray

#: Origin and unit points of a frame: where they lie tells the frame's pose.
FRAME_POINTS = (osim.Vec3(0), osim.Vec3(1, 0, 0), osim.Vec3(0, 1, 0), osim.Vec3(0, 0, 1))


@dataclass(frozen=True, kw_only=True)
class MovingBodies:
    """Poses of all bodies, and their velocities per speed of n coordinates."""

    rotations: FloatArray  # (n_bodies, 3, 3) [-]
    origins: FloatArray  # (n_bodies, 3) [m]
    angular_velocities: FloatArray  # (n_bodies, 3, n)
    velocities: FloatArray  # (n_bodies, 3, n), of the origins

    def point_velocities(self, bodies: IntArray, arms: FloatArray) -> FloatArray:
        """Return velocities of points, shape (..., 3, n), at some arm from bodies' origins, (..., 3) [m]."""
        return self.velocities[bodies] - cross_matrices(arms) @ self.angular_velocities[bodies]


class Bodies:
    """Ground and all bodies of the multibody tree, whatever set they stand in, by index; ground is 0.

    Public are `names`, `masses` [kg], `mass_centers` in the bodies, shape (n_bodies, 3) [m], `inertias`
    about these and in the bodies, (n_bodies, 3, 3) [kg·m²], and `parents`, the body that each hangs on in
    the tree rooted at ground, -1 for ground. A joint's own parent and child do not tell that: it may be
    written from its distal body to ground. `mobilized` are the bodies' numbers in Simbody, (n_bodies,).
    """

    def __init__(self, model: osim.Model) -> None:
        joints = list(model.getJointList())
        frames = (frame for joint in joints for frame in (joint.getParentFrame(), joint.getChildFrame()))
        jointed = {int(frame.getMobilizedBodyIndex()) for frame in frames}
        # where OpenSim cuts a loop it adds a body of its own, which no joint names
        self._bodies = [body for body in model.getBodyList() if int(body.getMobilizedBodyIndex()) in jointed]
        mobilized = [int(body.getMobilizedBodyIndex()) for body in self._bodies]
        self.mobilized = np.array([0, *mobilized], dtype=np.int64)
        self._index = {int(model.getGround().getMobilizedBodyIndex()): 0}
        self._index |= {index: b for b, index in enumerate(mobilized, start=1)}
        self.names = ["ground", *unique_labels(self._bodies)]
        self.masses = np.array([0.0, *(float(body.getMass()) for body in self._bodies)])
        centers = [body.getMassCenter().to_numpy() for body in self._bodies]
        self.mass_centers = np.array([np.zeros(3), *centers])
        self.inertias = np.array([np.zeros((3, 3)), *(_inertia(body) for body in self._bodies)])
        sides = [(self.of(joint.getParentFrame()), self.of(joint.getChildFrame())) for joint in joints]
        self.parents, is_reversed = _tree(sides, len(self.names))
        self._reversed = {
            joint.getAbsolutePathString() for joint, turned in zip(joints, is_reversed, strict=True) if turned
        }
        self._welded = {
            outboard
            for joint in joints
            if joint.numCoordinates() == 0
            for outboard in [self.of(self.outboard_frame(joint))]
            if self.parents[outboard] == self.of(self.inboard_frame(joint))
        }
        self._matter = model.getMatterSubsystem()

    def of(self, frame: osim.PhysicalFrame) -> int:
        """Return the index of the body that a physical frame is fixed to."""
        return self._index[int(frame.getMobilizedBodyIndex())]

    def inboard_frame(self, joint: osim.Joint) -> osim.PhysicalFrame:
        """Return a joint's frame on the side of ground."""
        is_reversed = joint.getAbsolutePathString() in self._reversed
        return joint.getChildFrame() if is_reversed else joint.getParentFrame()

    def outboard_frame(self, joint: osim.Joint) -> osim.PhysicalFrame:
        """Return a joint's frame on the distal side."""
        is_reversed = joint.getAbsolutePathString() in self._reversed
        return joint.getParentFrame() if is_reversed else joint.getChildFrame()

    def is_in_tree(self, joint: osim.Joint) -> bool:
        """Tell whether a joint is one by which its outer body hangs on the inner one; others close loops."""
        outer, inner = self.of(self.outboard_frame(joint)), self.of(self.inboard_frame(joint))
        return bool(self.parents[outer] == inner)

    def is_fixed(self, body: int) -> bool:
        """Tell whether a body is ground or welded to it, over other bodies too."""
        while body in self._welded:
            body = int(self.parents[body])
        return body == 0

    def moved_by(self, coordinate: osim.Coordinate) -> set[int]:
        """Return the bodies on the distal side of a coordinate's joint."""
        return self.distal(self.of(self.outboard_frame(coordinate.getJoint())))

    def distal(self, outboard: int) -> set[int]:
        """Return the bodies that hang on a body, itself included."""
        distal = {outboard}
        for _ in self.names:
            distal |= {b for b, parent in enumerate(self.parents) if parent in distal}
        return distal

    def poses(self, state: osim.State) -> tuple[FloatArray, FloatArray]:
        """Return rotations (columns are axes), shape (n_bodies, 3, 3), and origins, (n_bodies, 3) [m]."""
        rotations, origins = np.zeros((len(self.names), 3, 3)), np.zeros((len(self.names), 3))
        rotations[0] = np.eye(3)
        self._read_poses(state, range(1, len(self.names)), rotations, origins)
        return rotations, origins

    def moving(
        self,
        state: osim.State,
        moved: Iterable[int],
        rotations: FloatArray,
        origins: FloatArray,
        coupling: FloatArray,
    ) -> MovingBodies:
        """Return the bodies after some have moved from the poses given; the coupling has shape (n_u, n)."""
        rotations, origins = rotations.copy(), origins.copy()
        self._read_poses(state, moved, rotations, origins)
        matrix = osim.Matrix()
        self._matter.calcSystemJacobian(state, matrix)
        jacobian = np.array(matrix.to_numpy()).reshape(-1, 6, len(coupling))
        per_mobility = np.zeros((len(self.names), 6, len(coupling)))
        per_mobility[1:] = jacobian[self.mobilized[1:]]
        velocities = per_mobility @ coupling
        return MovingBodies(
            rotations=rotations,
            origins=origins,
            angular_velocities=velocities[:, :3],
            velocities=velocities[:, 3:],
        )

    def _read_poses(
        self, state: osim.State, chosen: Iterable[int], rotations: FloatArray, origins: FloatArray
    ) -> None:
        """Overwrite the poses of chosen bodies by those in a state."""
        for b in chosen:
            body = self._bodies[b - 1]
            points = [body.findStationLocationInGround(state, point).to_numpy() for point in FRAME_POINTS]
            rotations[b], origins[b] = _pose(points)


def unique_labels(components: Sequence[osim.Component]) -> list[str]:
    """Return names, or paths where components outside a model's sets share their name with others."""
    names = [component.getName() for component in components]
    count = Counter(names)
    return [
        name if count[name] == 1 else component.getAbsolutePathString().removeprefix("/")
        for name, component in zip(names, components, strict=True)
    ]


def frame_offsets(
    frames: list[osim.PhysicalFrame], state: osim.State, bodies: Bodies
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the body of each frame, (n,), and its rotation, (n, 3, 3), and origin, (n, 3), in that body."""
    indices = np.array([bodies.of(frame) for frame in frames], dtype=np.int64)
    rotations, origins = np.zeros((len(frames), 3, 3)), np.zeros((len(frames), 3))
    for i, frame in enumerate(frames):
        base = frame.findBaseFrame()
        points = [
            frame.findStationLocationInAnotherFrame(state, point, base).to_numpy() for point in FRAME_POINTS
        ]
        rotations[i], origins[i] = _pose(points)
    return indices, rotations, origins


def rotation(axes: FloatArray, angles: FloatArray) -> FloatArray:
    """Return rotation matrices, shape (n, 3, 3), about unit axes, (n, 3), by angles, (n,) [rad]."""
    cross = cross_matrices(axes)
    angles = np.asarray(angles)[:, None, None]
    return np.eye(3) + np.sin(angles) * cross + (1.0 - np.cos(angles)) * (cross @ cross)


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """Return the matrices, shape (..., 3, 3), that take the cross product with vectors from the left."""
    matrices = np.zeros((*vectors.shape[:-1], 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[..., i, j], matrices[..., j, i] = -vectors[..., k], vectors[..., k]
    return matrices


def _inertia(body: osim.Body) -> FloatArray:
    """Return a body's moments and products of inertia about its mass center, shape (3, 3) [kg·m²]."""
    six = body.get_inertia()
    xx, yy, zz, xy, xz, yz = (float(six.get(i)) for i in range(6))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _tree(sides: list[tuple[int, int]], n_bodies: int) -> tuple[IntArray, list[bool]]:
    """Walk from ground over joints, given the bodies of their parent and child frames, level by level.

    Return the body that each body hangs on, shape (n_bodies,), -1 for ground, and which joints are written
    towards ground. Joints that close loops are passed over.
    """
    parents = np.full(n_bodies, -1, dtype=np.int64)
    is_reversed = [False] * len(sides)
    reached = {0}
    level = {0}
    while level:
        found: set[int] = set()
        for j, (parent, child) in enumerate(sides):
            for inboard, outboard in ((parent, child), (child, parent)):
                if inboard in level and outboard not in reached | found:
                    parents[outboard], is_reversed[j] = inboard, outboard == parent
                    found.add(outboard)
        reached |= found
        level = found
    return parents, is_reversed


def _pose(points: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return the rotation, shape (3, 3), and origin, (3,), of a frame from where its `FRAME_POINTS` lie."""
    return np.stack([point - points[0] for point in points[1:]], axis=1), points[0]
