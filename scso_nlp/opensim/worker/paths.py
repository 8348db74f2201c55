"""Muscle paths: which points they have, and what a tension of 1 N in them does."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import opensim as osim
from numpy.typing import NDArray

from scso_nlp.opensim.worker.bodies import Bodies, MovingBodies, frame_offsets, rotation
from scso_nlp.opensim.worker.wrapping import WrapSurfaces
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Points of a path that stay where they are on their body, when they are part of it.
STAYING_POINTS = ("PathPoint", "ConditionalPathPoint")


@dataclass(frozen=True, kw_only=True)
class PathPoints:
    """Points of one path from origin to insertion, or some of them, that are fixed to bodies."""

    bodies: IntArray  # (n_points,), which each is fixed to or lies on
    locations: FloatArray  # (n_points, 3) [m], in these bodies


@dataclass(frozen=True, kw_only=True)
class MusclePath:
    """The path of one muscle."""

    opensim: osim.AbstractGeometryPath
    geometry: osim.GeometryPath | None  # None for fitted paths (FunctionBasedPath), which have no points
    fixed: PathPoints | None  # in their bodies; None where they may change
    wraps: bool  # it may touch wrap surfaces
    moves: bool  # its points may change: wraps, moving or conditional points, or fitted
    drives_mobilities: bool  # it also pushes coordinates directly: moving points and fitted paths


def read_path(muscle: osim.Muscle, state: osim.State, bodies: Bodies) -> MusclePath:
    """Find what a muscle's path is made of."""
    path = muscle.getPath()
    geometry = osim.GeometryPath.safeDownCast(path)
    if geometry is None:
        return MusclePath(
            opensim=path,
            geometry=None,
            fixed=_points([], []),
            wraps=False,
            moves=True,
            drives_mobilities=True,
        )
    points = _every(geometry.getPathPointSet())
    kinds = [point.getConcreteClassName() for point in points]
    wraps = geometry.getWrapSet().getSize() > 0
    moves = wraps or any(kind != "PathPoint" for kind in kinds)
    return MusclePath(
        opensim=path,
        geometry=geometry,
        fixed=None if moves else _fixed_points(points, state, bodies),
        wraps=wraps,
        moves=moves,
        drives_mobilities="MovingPathPoint" in kinds,
    )


def path_bodies(geometry: osim.GeometryPath, bodies: Bodies) -> set[int]:
    """Return every body that a path may touch."""
    points, wraps = _every(geometry.getPathPointSet()), _every(geometry.getWrapSet())
    frames = [point.getParentFrame() for point in points]
    return {bodies.of(frame) for frame in (*frames, *(wrap.getWrapObject().getFrame() for wrap in wraps))}


def crosses(geometry: osim.GeometryPath, bodies: Bodies, distal: Collection[int]) -> bool:
    """Tell whether a path may touch bodies both among some and beside them, such as those behind a joint."""
    return len({body in distal for body in path_bodies(geometry, bodies)}) == 2


class CurrentPaths:
    """The points of all paths in one pose after the other; what cannot change is read once.

    Public are the `surfaces` that they may touch.
    """

    def __init__(self, paths: Sequence[MusclePath], state: osim.State, bodies: Bodies) -> None:
        self._bodies = bodies
        self._n_muscles = len(paths)
        fixed = {m: path.fixed for m, path in enumerate(paths) if path.fixed is not None}
        #: muscle, place on the path and number, among those that stay on their bodies, of points of paths
        #: that cannot change
        places = [(m, i) for m, points in fixed.items() for i in range(len(points.bodies))]
        self._fixed = [(m, i, k) for k, (m, i) in enumerate(places)]
        self._geometries = {
            m: path.geometry
            for m, path in enumerate(paths)
            if path.geometry is not None and path.fixed is None
        }
        others = [
            point
            for geometry in self._geometries.values()
            for point in _every(geometry.getPathPointSet())
            if point.getConcreteClassName() in STAYING_POINTS
        ]
        #: and the number of those of other paths, by their address: they live as long as the model
        self._known = {int(point.this): k for k, point in enumerate(others, start=len(places))}
        staying = [*fixed.values(), _fixed_points(others, state, bodies)]
        self._owners = np.concatenate([points.bodies for points in staying])
        self._locations = np.concatenate([points.locations for points in staying])
        wraps = [_every(path.geometry.getWrapSet()) for path in paths if path.geometry is not None]
        self.surfaces = _wrap_surfaces(wraps, state, bodies)
        #: the surface of contact points, by their address: Python gets nothing but that
        self._contacts = {
            int(point): i
            for i, wrap in enumerate(wrap for own in wraps for wrap in own)
            for point in (wrap.getWrapPoint1(), wrap.getWrapPoint2())
        }

    def at(self, state: osim.State, rotations: FloatArray, origins: FloatArray) -> dict[str, NDArray[Any]]:
        """Return all paths' points in ground, their bodies, whether they move, and the surfaces they lie on.

        And where OpenSim's forces act: on the contact points of its last round, if there are several
        surfaces. Shapes (n_muscles, n_points, 3), else (n_muscles, n_points), padded to the longest path.
        """
        staying, moving, points = self._fixed.copy(), [], []
        for m, geometry in self._geometries.items():
            for i, point in enumerate(_every(geometry.getCurrentPath(state))):
                known = self._known.get(int(point.this))
                if known is None:
                    moving.append((m, i))
                    points.append(point)
                else:
                    staying.append((m, i, known))
        found = self._empty(max((at[1] + 1 for at in (*staying, *moving)), default=0))
        locations, owners, moves, surfaces, acting = found.values()
        muscles, places, numbers = np.array(staying, dtype=np.int64).reshape(-1, 3).T
        own = self._owners[numbers]
        in_ground = np.einsum("pij,pj->pi", rotations[own], self._locations[numbers]) + origins[own]
        owners[muscles, places] = own
        locations[muscles, places] = acting[muscles, places] = in_ground
        for (m, i), point in zip(moving, points, strict=True):
            frame, moves[m, i] = point.getParentFrame(), True
            owners[m, i], surfaces[m, i] = self._bodies.of(frame), self._contacts.get(int(point.this), -1)
            locations[m, i] = acting[m, i] = point.getLocationInGround(state).to_numpy()
            if surfaces[m, i] >= 0 and not self.surfaces.is_alone[surfaces[m, i]]:
                last = frame.findStationLocationInGround(state, point.getLocation(state))
                acting[m, i] = last.to_numpy()
        return found

    @property
    def nothing(self) -> dict[str, NDArray[Any]]:
        """The arrays of :meth:`at` without points."""
        return self._empty(0)

    def _empty(self, n_points: int) -> dict[str, NDArray[Any]]:
        shape = (self._n_muscles, n_points)
        return {
            "path_points": np.zeros((*shape, 3)),
            "path_point_bodies": np.full(shape, -1, dtype=np.int16),
            "path_point_moves": np.zeros(shape, dtype=bool),
            "path_point_surfaces": np.full(shape, -1, dtype=np.int16),
            "path_points_acting": np.zeros((*shape, 3)),
        }


class PathForces:
    """The generalized forces of paths in one model, by their equivalent forces on bodies."""

    def __init__(
        self,
        model: osim.Model,
        state: osim.State,
        paths: Sequence[osim.AbstractGeometryPath],
        drives_mobilities: Sequence[bool],
    ) -> None:
        self._paths, self._drives_mobilities = paths, drives_mobilities
        self._matter = model.getMatterSubsystem()
        matrix = osim.Matrix()
        self._matter.calcSystemJacobian(state, matrix)
        n_bodies = int(matrix.to_numpy().shape[0]) // 6
        nothing = osim.SpatialVec(osim.Vec3(0), osim.Vec3(0))
        self._no_body_forces = osim.VectorOfSpatialVec(n_bodies, nothing)
        self._no_mobility_forces = osim.Vector(state.getNU(), 0.0)

    def columns(self, state: osim.State, chosen: Sequence[int]) -> FloatArray:
        """Return the generalized force of each chosen path at 1 N tension, shape (n_u, n_chosen)."""
        out, unused = osim.Vector(), osim.Vector(self._no_mobility_forces)
        columns = np.zeros((state.getNU(), len(chosen)))
        for j, m in enumerate(chosen):
            # only moving points and fitted paths add to mobilities
            drives = self._drives_mobilities[m]
            mobility_forces = osim.Vector(self._no_mobility_forces) if drives else unused
            body_forces = self._on_bodies(state, m, mobility_forces)
            self._matter.multiplyBySystemJacobianTranspose(state, body_forces, out)
            columns[:, j] = out.to_numpy()
            if drives:
                columns[:, j] += mobility_forces.to_numpy()
        return columns

    def on_bodies(self, state: osim.State, m: int) -> osim.VectorOfSpatialVec:
        """Return moments and forces of a path at 1 N tension on all bodies, at their origins."""
        return self._on_bodies(state, m, osim.Vector(self._no_mobility_forces))

    def _on_bodies(self, state: osim.State, m: int, mobility_forces: osim.Vector) -> osim.VectorOfSpatialVec:
        # the call adds to what it is given
        body_forces = osim.VectorOfSpatialVec(self._no_body_forces)
        self._paths[m].addInEquivalentForces(state, 1.0, body_forces, mobility_forces)
        return body_forces


@dataclass(frozen=True, kw_only=True)
class FixedPaths:
    """All paths whose points are fixed to bodies, padded by their last point."""

    muscles: IntArray  # (n_fixed,)
    bodies: IntArray  # (n_fixed, n_points)
    locations: FloatArray  # (n_fixed, n_points, 3) [m]
    is_segment: BoolArray  # (n_fixed, n_points - 1), False between padding points and within a body

    def moment_arms(self, at: MovingBodies) -> FloatArray:
        """Return minus the paths' lengthening per speed, shape (n, n_fixed) [m]."""
        arms = np.einsum("mpij,mpj->mpi", at.rotations[self.bodies], self.locations)
        segments = np.diff(at.origins[self.bodies] + arms, axis=1)
        lengths = np.linalg.norm(segments, axis=2)
        directions = np.where(self.is_segment[..., None], segments, 0.0)
        # as in OpenSim, a segment without length has no direction
        with np.errstate(invalid="ignore"):
            directions /= np.where(self.is_segment, lengths, 1.0)[..., None]
        rates = np.diff(at.point_velocities(self.bodies, arms), axis=1)
        return -np.einsum("mpi,mpic->cm", directions, rates)


def fixed_paths(paths: Sequence[MusclePath]) -> FixedPaths:
    """Put the points of all paths that are fixed to bodies into arrays."""
    chosen = {m: path.fixed for m, path in enumerate(paths) if path.fixed is not None and not path.moves}
    n_points = max((len(points.bodies) for points in chosen.values()), default=1)
    bodies = np.zeros((len(chosen), n_points), dtype=np.int64)
    locations = np.zeros((len(chosen), n_points, 3))
    is_segment = np.zeros((len(chosen), n_points - 1), dtype=bool)
    for i, points in enumerate(chosen.values()):
        n = len(points.bodies)
        bodies[i], locations[i] = points.bodies[-1], points.locations[-1]
        bodies[i, :n], locations[i, :n] = points.bodies, points.locations
        is_segment[i, : n - 1] = points.bodies[1:] != points.bodies[:-1]
    muscles = np.array(list(chosen), dtype=np.int64)
    return FixedPaths(muscles=muscles, bodies=bodies, locations=locations, is_segment=is_segment)


def _fixed_points(points: list[osim.AbstractPathPoint], state: osim.State, bodies: Bodies) -> PathPoints:
    locations = []
    for point in points:
        frame, location = point.getParentFrame(), point.getLocation(state)
        base = frame.findBaseFrame()
        if frame.getAbsolutePathString() != base.getAbsolutePathString():
            location = frame.findStationLocationInAnotherFrame(state, location, base)
        locations.append(location.to_numpy())
    owners = [bodies.of(point.getParentFrame()) for point in points]
    return _points(owners, locations)


def _points(bodies: list[int], locations: list[FloatArray]) -> PathPoints:
    return PathPoints(bodies=np.array(bodies, dtype=np.int64), locations=np.array(locations).reshape(-1, 3))


def _wrap_surfaces(wraps: list[list[osim.PathWrap]], state: osim.State, bodies: Bodies) -> WrapSurfaces:
    objects = [wrap.getWrapObject() for own in wraps for wrap in own]
    cylinders = [osim.WrapCylinder.safeDownCast(thing) for thing in objects]
    owners, frames, centers = frame_offsets([thing.getFrame() for thing in objects], state, bodies)
    turns = np.array([thing.get_xyz_body_rotation().to_numpy() for thing in objects]).reshape(-1, 3)
    shifts = np.array([thing.get_translation().to_numpy() for thing in objects]).reshape(-1, 3)
    x, y, z = (rotation(np.tile(axis, (len(objects), 1)), turns[:, i]) for i, axis in enumerate(np.eye(3)))
    return WrapSurfaces(
        bodies=owners,
        rotations=frames @ x @ y @ z,
        origins=np.einsum("nij,nj->ni", frames, shifts) + centers,
        radii=np.array([np.nan if cylinder is None else cylinder.get_radius() for cylinder in cylinders]),
        is_constrained=np.array([thing.get_quadrant() != "all" for thing in objects], dtype=bool),
        is_alone=np.array([len(own) == 1 for own in wraps for _ in own], dtype=bool),
        places=np.array([i for own in wraps for i in range(len(own))], dtype=np.int64),
    )


def _every(items: osim.Set) -> list[Any]:
    return [items.get(i) for i in range(items.getSize())]
