"""Derivatives of moment arms, loads and passive forces along chosen coordinates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import opensim as osim

from scso_nlp.exceptions import DataError, EngineError, NameMismatchError
from scso_nlp.opensim.worker.dependence import find_dependence, find_followers, is_smooth, moved_bodies
from scso_nlp.opensim.worker.dynamics import Dynamics
from scso_nlp.opensim.worker.elimination import Elimination
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.paths import fixed_paths
from scso_nlp.opensim.worker.poses import POSE_TOLERANCE, Pose
from scso_nlp.opensim.worker.skeleton import LoadVectors
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Half step of the derivatives along coordinates [rad or m], for points fixed to bodies and for loads.
FINE_STEP = 2e-5
#: For paths that wrap, move or follow splines: half step, a wider one that must agree with it, and one that
#: spans the artefacts where they do not.
STEP, WIDE_STEP, WIDEST_STEP = 1e-4, 1e-3, 1e-2
#: Derivatives of moment arms agree if they differ by no more than this [m], or this share of the larger.
SAME_SLOPE, SAME_SLOPE_SHARE = 1e-4, 1e-2
#: Largest constraint error at the points of the stencil [m] or [rad], and most Newton steps to get there.
LOOP_TOLERANCE, LOOP_ITERATIONS = 1e-13, 8


@dataclass(frozen=True, kw_only=True)
class _Center:
    """The frame itself, in the middle of the stencil."""

    pose: Pose
    coupling: FloatArray  # (n_u, n_chosen), du over the speeds of the chosen coordinates
    loads: LoadVectors
    load_stations: FloatArray  # (n_loads, 3) [m], where the loads act, fixed to their bodies
    constraint_errors: FloatArray  # (n_position_constraints,) [m] or [rad], what assembling left open


@dataclass(frozen=True, kw_only=True)
class _NearbyPaths:
    """Some muscles' paths at one point of the stencil."""

    arms: FloatArray  # (n_chosen, n) [m], moment arms
    sizes: IntArray  # (n,), numbers of path points; 0 for paths whose points never change


@dataclass(frozen=True, kw_only=True)
class _NearbyBodies:
    """What follows from bodies at one point of the stencil."""

    arms: FloatArray  # (n_chosen, n_fixed) [m], of the muscles whose points are all fixed to bodies
    loads: FloatArray  # (n_bodies, n_chosen) [N·m], generalized forces of its weight and loads, by body
    passive: FloatArray  # (n_chosen,) [N·m], of passive elements at rest


class CoordinateDerivatives:
    """Central differences of moment arms, reduced to the free coordinates at every point of the stencil.

    So dependent coordinates follow their constraints. Moment arms are OpenSim's own; only those of points
    fixed to bodies, along coordinates without splines, come from the bodies' poses and velocities, all
    muscles together. Coordinates that move other bodies and other muscles, such as those of two legs, are
    moved at once: what changes by which is known. Where a path changes its points or two steps disagree, the
    side or step without the artefact is taken and the muscle is marked.
    """

    def __init__(
        self, model: Model, elimination: Elimination, dynamics: Dynamics, chosen: Sequence[str]
    ) -> None:
        self._model, self._elimination, self._dynamics = model, elimination, dynamics
        coordinates = model.coordinates
        followers = find_followers(model, elimination)
        depends = find_dependence(model, followers)
        # of the chosen coordinates: positions among the free ones, and among all
        self._columns = _chosen_columns(model, elimination, depends, chosen)
        self._indices = [int(elimination.free[c]) for c in self._columns]
        self.names = [coordinates.names[k] for k in self._indices]
        self._depends = depends[:, self._columns]
        own = [followers[c] for c in self._columns]
        self._has_followers = [len(moved) > 1 for moved in own]
        self._smooth = [is_smooth(model, k, moved) for k, moved in zip(self._indices, own, strict=True)]
        self._moved = [moved_bodies(model, moved) for moved in own]
        self._groups = self._apart(own)
        self._moves = np.array([path.moves for path in model.paths], dtype=bool)
        self._fixed = fixed_paths(model.paths)
        weights = np.array(model.opensim.getGravity().to_numpy())
        self._weights = model.bodies.masses[:, None] * weights
        self._state = osim.State(model.state)
        for load in model.forces.loads:
            load.setAppliesForce(self._state, False)

    def at(
        self, pose: Pose, loads: LoadVectors, moment_arms: FloatArray
    ) -> dict[str, FloatArray | BoolArray]:
        """Return the fields of :class:`scso_nlp.CoordinateCurvature` in one pose.

        `moment_arms` are those of the pose, shape (n_free, n_muscles) [m].
        """
        n, n_muscles = len(self._columns), len(self._model.paths)
        center = self._take(pose, loads)
        slopes = np.zeros((n, n, n_muscles))
        load_slopes, passive_slopes = np.zeros((n, n)), np.zeros((n, n))
        is_uncertain = np.zeros(n_muscles, dtype=bool)
        base = moment_arms[self._columns]
        sizes = self._sizes(np.arange(n_muscles))
        for group in self._groups:
            before, after = (self._bodies_at(center, group, sign * FINE_STEP) for sign in (-1, 1))
            of_bodies = -(after.loads - before.loads) / (2 * FINE_STEP)
            for j in group:
                slopes[:, j, self._fixed.muscles] = (after.arms - before.arms) / (2 * FINE_STEP)
                load_slopes[:, j] = of_bodies[sorted(self._moved[j])].sum(axis=0)
                passive_slopes[:, j] = -(after.passive - before.passive) / (2 * FINE_STEP)
            own = {j: self._asked(j) for j in group}
            muscles = np.concatenate(list(own.values()))
            if muscles.size:
                middle = _NearbyPaths(arms=base[:, muscles], sizes=sizes[muscles])
                found, doubtful = self._judge(center, group, muscles, middle)
                slopes[:, np.repeat(list(own), [len(of) for of in own.values()]), muscles] = found
                is_uncertain[muscles] |= doubtful
        # a muscle's own rows only: beyond wraps OpenSim has traces of moment arms that no length follows
        slopes *= self._depends.T[:, None, :] & self._depends.T[None, :, :]
        return {
            # adding zero turns -0 into 0
            "path_curvature": -(slopes + slopes.transpose(1, 0, 2)) / 2 + 0.0,
            "load_stiffness": (load_slopes + load_slopes.T) / 2 + 0.0,
            "passive_stiffness": (passive_slopes + passive_slopes.T) / 2 + 0.0,
            "asymmetry": np.abs(slopes - slopes.transpose(1, 0, 2)).max(axis=(0, 1), initial=0.0),
            "is_uncertain": is_uncertain,
        }

    def _apart(self, followers: list[set[int]]) -> list[list[int]]:
        """Group chosen coordinates that have no body, no muscle and no coordinate in common.

        With passive elements, which may connect any bodies, each stands alone.
        """
        groups: list[list[int]] = []
        for j, own in enumerate(followers):
            free = (
                group
                for group in groups
                if not self._model.forces.passives
                and all(
                    own.isdisjoint(followers[i])
                    and self._moved[j].isdisjoint(self._moved[i])
                    and not (self._depends[:, j] & self._depends[:, i]).any()
                    for i in group
                )
            )
            group = next(free, None)
            if group is None:
                groups.append([j])
            else:
                group.append(j)
        return groups

    def _asked(self, j: int) -> IntArray:
        """Return the muscles whose moment arms OpenSim is asked for near chosen coordinate j."""
        muscles = np.flatnonzero(self._depends[:, j])
        return muscles[self._moves[muscles]] if self._smooth[j] else muscles

    def _judge(
        self, center: _Center, group: list[int], muscles: IntArray, middle: _NearbyPaths
    ) -> tuple[FloatArray, BoolArray]:
        """Compare two steps on both sides of a group of chosen coordinates, each muscle with one of them.

        Return the better slopes of some muscles, shape (n_chosen, n), and which are uncertain, (n,).
        """
        near, far = (
            [self._paths_at(center, group, sign * step, muscles) for sign in (-1, 1)]
            for step in (STEP, WIDE_STEP)
        )
        slopes = (near[1].arms - near[0].arms) / (2 * STEP)
        wide_slopes = (far[1].arms - far[0].arms) / (2 * WIDE_STEP)
        agree = _agree(slopes, wide_slopes).all(axis=0)
        same = [(near[i].sizes == middle.sizes) & (far[i].sizes == middle.sizes) for i in range(2)]
        doubtful = ~(agree & same[0] & same[1])
        if not doubtful.any():
            return slopes, doubtful
        clean, one_sided = [], []
        for i, sign in enumerate((-1.0, 1.0)):
            short = sign * (near[i].arms - middle.arms) / STEP
            long = sign * (far[i].arms - middle.arms) / WIDE_STEP
            clean.append(same[i] & _agree(short, long).all(axis=0))
            # the parabola through three points, its slope at the frame
            one_sided.append((short * WIDE_STEP - long * STEP) / (WIDE_STEP - STEP))
        for i in range(2):
            alone = doubtful & clean[i] & ~clean[1 - i]
            slopes[:, alone] = one_sided[i][:, alone]
        neither = doubtful & ~clean[0] & ~clean[1]
        if neither.any():
            widest = [self._paths_at(center, group, sign * WIDEST_STEP, muscles[neither]) for sign in (-1, 1)]
            slopes[:, neither] = (widest[1].arms - widest[0].arms) / (2 * WIDEST_STEP)
        return slopes, doubtful

    def _take(self, pose: Pose, loads: LoadVectors) -> _Center:
        """Give this object's own state a pose, at rest."""
        self._state.setTime(pose.time)
        self._state.setQ(pose.state.getQ())
        self._state.setU(osim.Vector(self._model.n_u, 0.0))
        self._model.opensim.realizePosition(self._state)
        bodies = self._model.loads.bodies
        arms = loads.points - pose.origins[bodies]
        return _Center(
            pose=pose,
            coupling=pose.coupling[:, self._columns],
            loads=loads,
            load_stations=np.einsum("lba,lb->la", pose.rotations[bodies], arms),
            constraint_errors=np.array(self._state.getQErr().to_numpy()),
        )

    @contextmanager
    def _away(self, center: _Center, group: list[int], step: float) -> Iterator[FloatArray]:
        """Move chosen coordinates away from the center, dependent ones follow, and back again.

        Give du over the speeds of the chosen coordinates there, shape (n_u, n_chosen): as in the center
        where no other coordinate follows.
        """
        model, values, coupling = self._model, center.pose.values.copy(), center.coupling
        moved = [self._indices[j] for j in group]
        values[moved] += step
        has_followers = any(self._has_followers[j] for j in group)
        if has_followers:
            model.coordinates.follow(values)
            moved += self._elimination.gone.tolist()
        self._set_values(moved, values[moved])
        model.opensim.realizePosition(self._state)
        if has_followers:
            self._close_loops(center)
            constraints = model.constraint_matrix(self._state)
            coupling = self._elimination.coupling(constraints, center.pose.time)[:, self._columns]
        yield coupling
        self._set_values(moved, center.pose.values[moved])

    def _set_values(self, moved: Sequence[int], values: FloatArray) -> None:
        coordinates = self._model.coordinates
        for k, value in zip(moved, values, strict=True):
            if not coordinates.is_locked[k]:
                coordinates.items[k].setValue(self._state, float(value), False)

    def _close_loops(self, center: _Center) -> None:
        """Move the dependent coordinates until the constraints hold as in the center; the free ones stay."""
        model, state, gone = self._model, self._state, self._elimination.gone.tolist()
        for _ in range(LOOP_ITERATIONS):
            error = np.array(state.getQErr().to_numpy()) - center.constraint_errors
            if np.abs(error).max(initial=0.0) <= LOOP_TOLERANCE:
                return
            change = self._elimination.remedy(model.constraint_matrix(state)[: len(error)], error)
            values = np.array([model.coordinates.items[k].getValue(state) for k in gone])
            self._set_values(gone, values + change)
            model.opensim.realizePosition(state)
        if np.abs(state.getQErr().to_numpy() - center.constraint_errors).max(initial=0.0) > POSE_TOLERANCE:
            raise EngineError(
                f"the model's constraints cannot be kept near its pose at t = {state.getTime():.9g} s"
            )

    def _paths_at(self, center: _Center, group: list[int], step: float, muscles: IntArray) -> _NearbyPaths:
        """Return OpenSim's moment arms of some muscles at a point of the stencil."""
        with self._away(center, group, step) as coupling:
            columns = self._model.path_forces.columns(self._state, muscles.tolist())
            return _NearbyPaths(arms=coupling.T @ columns, sizes=self._sizes(muscles))

    def _bodies_at(self, center: _Center, group: list[int], step: float) -> _NearbyBodies:
        """Return what follows from the bodies' poses and velocities at a point of the stencil."""
        pose, loads, bodies, loaded = center.pose, center.loads, self._model.bodies, self._model.loads.bodies
        moved = sorted(set().union(*(self._moved[j] for j in group)))
        with self._away(center, group, step) as coupling:
            at = bodies.moving(self._state, moved, pose.rotations, pose.origins, coupling)
            center_arms = np.einsum("bij,bj->bi", at.rotations, bodies.mass_centers)
            load_arms = np.einsum("lij,lj->li", at.rotations[loaded], center.load_stations)
            every = np.arange(len(bodies.names))
            weight = np.einsum("bi,bic->bc", self._weights, at.point_velocities(every, center_arms))
            load = np.einsum("li,lic->lc", loads.forces, at.point_velocities(loaded, load_arms))
            load += np.einsum("li,lic->lc", loads.torques, at.angular_velocities[loaded])
            passive = np.zeros(len(self._columns))
            if self._model.forces.passives:
                at_rest = self._dynamics.inverse_dynamics(self._state, np.zeros(self._model.n_u))
                passive = -coupling.T @ at_rest - weight.sum(axis=0)
            np.add.at(weight, loaded, load)
            return _NearbyBodies(arms=self._fixed.moment_arms(at), loads=weight, passive=passive)

    def _sizes(self, muscles: IntArray) -> IntArray:
        sizes = np.zeros(len(muscles), dtype=np.int64)
        for i, m in enumerate(muscles):
            path = self._model.paths[m]
            if path.moves and path.geometry is not None:
                sizes[i] = path.geometry.getCurrentPath(self._state).getSize()
        return sizes


def _chosen_columns(
    model: Model, elimination: Elimination, depends: BoolArray, chosen: Sequence[str]
) -> list[int]:
    """Return the positions of the chosen coordinates among the free ones."""
    free = [model.coordinates.names[k] for k in elimination.free]
    if list(chosen) == ["all"]:
        columns: list[int] = np.flatnonzero(depends.any(axis=0)).tolist()
        if not columns:
            raise DataError(
                "curvature_coordinates asks for all that muscles act on, but no muscle acts on any: "
                f"name coordinates (free: {', '.join(free)}) or leave it out"
            )
        return columns
    for name in chosen:
        if name in free:
            continue
        if name in model.coordinates.names:
            raise DataError(
                f"curvature_coordinates names {name!r}, which the model locks, prescribes or couples to "
                f"others (free: {', '.join(free)})"
            )
        raise NameMismatchError(
            f"unknown coordinate {name!r} in curvature_coordinates (free: {', '.join(free)})"
        )
    return [free.index(name) for name in chosen]


def _agree(one: FloatArray, other: FloatArray) -> BoolArray:
    """Tell which derivatives of moment arms agree."""
    size = np.maximum(np.abs(one), np.abs(other))
    agree: BoolArray = np.abs(one - other) <= SAME_SLOPE + SAME_SLOPE_SHARE * size
    return agree
