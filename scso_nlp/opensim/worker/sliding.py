"""Curvature of paths that touch cylinders, where everything distal of a joint turns about its axes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from scso_nlp.opensim.worker.wrapping import Array, Cylinders, WrapSurfaces, contact_points
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Turned by so little [rad], as an imaginary number: its square is nothing beside 1.
TURN = 1e-20


@dataclass(frozen=True, kw_only=True)
class TurnedPaths:
    """Some paths in some frames, and a joint whose distal bodies turn."""

    points: FloatArray  # (n_frames, n_paths, n_points, 3) [m], in ground
    acting: FloatArray  # (n_frames, n_paths, n_points, 3) [m], in ground, where OpenSim's forces act
    bodies: IntArray  # (n_frames, n_paths, n_points), which each is fixed to or lies on, -1 for none
    surfaces: IntArray  # (n_frames, n_paths, n_points), which contact points lie on, else -1
    rotations: FloatArray  # (n_frames, n_bodies, 3, 3) [-], columns are the bodies' axes
    origins: FloatArray  # (n_frames, n_bodies, 3) [m]
    centers: FloatArray  # (n_frames, 3) [m], of the joint
    is_distal: BoolArray  # (n_bodies,)


@dataclass(frozen=True, kw_only=True)
class _Chains:
    """Parts of paths that touch the same number of surfaces between two points that do not slide."""

    frames: IntArray  # (n_chains,)
    paths: IntArray  # (n_chains,)
    points: IntArray  # (n_chains, 2 n_touched + 2), of the path
    surfaces: IntArray  # (n_chains, n_touched)
    order: list[int]  # in which OpenSim visits them


def sliding_curvature(
    paths: TurnedPaths, surfaces: WrapSurfaces, axes: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return what segments that end in contact points add to a path's curvature.

    With e the direction of a segment from a to b, its length changes by e · (v_b - v_a) per angle, where
    v = u x (p - c) for points of distal bodies and 0 for others: contact points count as fixed, as in
    OpenSim's forces, and p is where these act. This is differentiated once more, with the contact points as
    OpenSim's rule moves them.

    Parameters
    ----------
    paths : TurnedPaths
    surfaces : WrapSurfaces
    axes : ndarray, shape (n_frames, n_axes, 3) [-]
        Unit axes through the joint's center.

    Returns
    -------
    ndarray, shape (n_frames, n_axes, n_paths) [m]
        Zero where no such segment crosses the joint.
    ndarray of bool, shape (n_frames, n_paths)
        Whether this is known: not if a surface is no cylinder or OpenSim's rule went another way.
    """
    found = np.zeros((*paths.surfaces.shape[:2], axes.shape[1]))
    is_known = np.ones(paths.surfaces.shape[:2], dtype=bool)
    for chains in _crossing_chains(paths, surfaces):
        f, m = chains.frames, chains.paths
        curvature, is_same = _curvature(paths, surfaces, chains, axes[f])
        # a path may cross by several chains
        np.add.at(found, (f, m), curvature)
        unknown = np.isnan(surfaces.radii[chains.surfaces]).any(axis=1) | ~is_same
        is_known[f[unknown], m[unknown]] = False
    return np.swapaxes(found, 1, 2), is_known


def _crossing_chains(paths: TurnedPaths, surfaces: WrapSurfaces) -> Iterator[_Chains]:
    """Yield chains that cross the joint, those with as many surfaces, visited in the same order, together."""
    touches = paths.surfaces >= 0
    n_points = touches.shape[-1]
    # the first point behind each that does not slide
    end = np.where(touches, n_points, np.arange(n_points))
    end = np.minimum.accumulate(end[..., ::-1], axis=-1)[..., ::-1]
    frames, own, before = np.nonzero(touches[..., 1:] & ~touches[..., :-1])
    n_touched = (end[frames, own, before + 1] - before - 1) // 2
    for n in np.unique(n_touched).tolist():
        f, m, points = (array[n_touched == n] for array in (frames, own, before))
        points = points[:, None] + np.arange(2 * n + 2)
        is_distal = paths.is_distal[paths.bodies[f[:, None], m[:, None], points]]
        crosses = is_distal.any(axis=1) & ~is_distal.all(axis=1)
        f, m, points = f[crosses], m[crosses], points[crosses]
        on = paths.surfaces[f[:, None], m[:, None], points[:, 1:-1:2]]
        orders = np.argsort(surfaces.places[on], axis=1)
        for order in np.unique(orders, axis=0):
            same = (orders == order).all(axis=1)
            yield _Chains(
                frames=f[same], paths=m[same], points=points[same], surfaces=on[same], order=order.tolist()
            )


def _curvature(
    paths: TurnedPaths, surfaces: WrapSurfaces, chains: _Chains, axes: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return the curvature of chains about axes, both (n_chains, n_axes), and where it holds, (n_chains,)."""
    which = chains.frames[:, None], chains.paths[:, None], chains.points
    bodies = paths.bodies[which]
    turns, centers = paths.is_distal[bodies], paths.centers[chains.frames]
    points = paths.points[which][:, None]
    turned = points + 1j * TURN * _velocities(points, turns, centers, axes)
    cylinders = [
        _turned_cylinders(paths, surfaces, chains, place, axes) for place in range(chains.surfaces.shape[1])
    ]
    acting = turned.copy()
    turned[:, :, 1:-1], acting[:, :, 1:-1], is_same = contact_points(
        turned[:, :, 0], turned[:, :, -1], cylinders, chains.order
    )
    is_between = (bodies[:, 1:] != bodies[:, :-1])[:, None]
    segments = np.diff(turned, axis=2)
    rates = np.diff(_velocities(acting, turns, centers, axes), axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        changes = (segments * rates).sum(axis=3) / np.sqrt((segments**2).sum(axis=3))
    return np.where(is_between, changes.imag, 0.0).sum(axis=2) / TURN, is_same


def _velocities(points: Array, turns: BoolArray, centers: FloatArray, axes: FloatArray) -> Array:
    """Return velocities per angle about axes, (n, n_axes, 3), shape (n, n_axes, n_points, 3).

    Of points, (n, n_axes or 1, n_points, 3), that turn or not, (n, n_points).
    """
    moving = np.cross(axes[:, :, None], points - centers[:, None, None])
    return np.where(turns[:, None, :, None], moving, 0.0)


def _turned_cylinders(
    paths: TurnedPaths, surfaces: WrapSurfaces, chains: _Chains, place: int, axes: FloatArray
) -> Cylinders:
    """Return the cylinders at one place of the chains, turned with their bodies."""
    f, on = chains.frames, chains.surfaces[:, place]
    bodies = surfaces.bodies[on]
    rotations = paths.rotations[f, bodies]
    origins = np.einsum("nij,nj->ni", rotations, surfaces.origins[on]) + paths.origins[f, bodies]
    rotations = rotations @ surfaces.rotations[on]
    # the frame's unit points move too
    points = np.concatenate([origins[:, None], origins[:, None] + np.swapaxes(rotations, 1, 2)], axis=1)
    turns = np.repeat(paths.is_distal[bodies][:, None], 4, axis=1)
    moving = _velocities(points[:, None], turns, paths.centers[f], axes)
    turning = np.swapaxes(moving[:, :, 1:] - moving[:, :, :1], 2, 3)
    contacts = f[:, None], chains.paths[:, None], chains.points[:, 2 * place + 1 : 2 * place + 3]
    return Cylinders(
        rotations=rotations[:, None] + 1j * TURN * turning,
        origins=origins[:, None] + 1j * TURN * moving[:, :, 0],
        radii=surfaces.radii[on, None],
        is_constrained=surfaces.is_constrained[on, None],
        is_alone=surfaces.is_alone[on],
        touched=paths.points[contacts],
        acting=paths.acting[contacts],
    )
