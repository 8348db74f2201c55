"""Where OpenSim lets a path touch cylinders, and how these contact points move when the path's ends do.

OpenSim's contact points are not those of the shortest path: they lie where tangents touch the cylinder's
circle, but their heights follow from a plane through both ends and an apex (one surface in the path's list),
or are shifted until path and helix are tangent to within 0.1 degrees (several). Several surfaces are visited
in rounds until the length changes by less than 0.5 mm. Points in ground are kept from the first round, so
segments point from one of these to the next, but forces act on the bodies where the last round has them. So
the derivative of OpenSim's rule is wanted, not the one of a shortest path. This is the rule of OpenSim 4.6
(WrapCylinder.cpp, GeometryPath.cpp), surfaces and sides known beforehand. All functions take complex arrays:
imaginary parts are derivatives (complex-step differentiation, Squire & Trapp 1998, SIAM Review 40:110-112),
exact to rounding; what is chosen is chosen by real parts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: OpenSim visits several surfaces at most so often.
MOST_ROUNDS = 8
#: Angle between path and helix that OpenSim lets pass [rad], and how often it shifts contact points at most.
TANGENCY, MOST_SHIFTS = math.radians(0.1), 100
#: Length of the pieces that OpenSim cuts a helix into [m].
PIECE = 0.002
#: Contact points are OpenSim's own if they lie no further from them [m].
SAME_POINT = 1e-10

#: What is left of vectors along the axis, and across it.
UP, LEVEL = np.array([0.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0])

#: Real, or complex with derivatives as imaginary parts.
Array = NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class WrapSurfaces:
    """The surfaces that the paths of a model may touch, one after the other in every path's list."""

    bodies: IntArray  # (n_surfaces,), which each is fixed to
    rotations: FloatArray  # (n_surfaces, 3, 3) [-], of their frames in these bodies, columns are axes
    origins: FloatArray  # (n_surfaces, 3) [m]
    radii: FloatArray  # (n_surfaces,) [m], of cylinders; nan for other surfaces
    is_constrained: BoolArray  # (n_surfaces,), to a quadrant
    is_alone: BoolArray  # (n_surfaces,), the only one in the list of its path
    places: IntArray  # (n_surfaces,), in this list


@dataclass(frozen=True, kw_only=True)
class Cylinders:
    """The cylinder that each of n paths touches; its axis is the z axis of its frame."""

    rotations: Array  # (n, n_turns, 3, 3) [-], of the frames in ground, columns are axes
    origins: Array  # (n, n_turns, 3) [m]
    radii: FloatArray  # (n, 1) [m]
    is_constrained: BoolArray  # (n, 1), to a quadrant
    is_alone: BoolArray  # (n,), the only surface in the list of its path
    touched: FloatArray  # (n, 2, 3) [m], OpenSim's contact points in ground
    acting: FloatArray  # (n, 2, 3) [m], and where its forces act

    def take(self, chosen: Array) -> Cylinders:
        """Return some of them."""
        return Cylinders(**{name: array[chosen] for name, array in vars(self).items()})


def contact_points(
    first: Array, last: Array, cylinders: Sequence[Cylinders], order: Sequence[int]
) -> tuple[Array, Array, BoolArray]:
    """Find the contact points of n paths that touch the same number of cylinders one after the other.

    Along the second axis of all arrays real parts are the same: imaginary parts are derivatives by as many
    turns.

    Parameters
    ----------
    first, last : ndarray, shape (n, n_turns, 3) [m]
        The points before and after the cylinders, in ground.
    cylinders : sequence of Cylinders
        In the order in which the paths touch them.
    order : sequence of int
        That in which OpenSim visits them: of the path's list.

    Returns
    -------
    ndarray, shape (n, n_turns, 2 n_cylinders, 3) [m]
        The contact points of the first round in ground: OpenSim keeps them for the rest of the pose.
    ndarray, shape (n, n_turns, 2 n_cylinders, 3) [m]
        Those of the last round, where its forces act.
    ndarray of bool, shape (n,)
        Whether both are OpenSim's; if not, its rule went another way and the points are worth nothing.
    """
    touched = np.concatenate([own.touched for own in cylinders], axis=1)
    acting = np.concatenate([own.acting for own in cylinders], axis=1)
    points: dict[int, tuple[Array, Array]] = {}
    _visit(points, first, last, cylinders, order)
    kept = _stacked(points)
    found, is_same = kept.copy(), np.zeros(len(first), dtype=bool)
    # the paths whose last round has not come yet
    left = np.flatnonzero(_distances(kept, touched) < SAME_POINT)
    points = _chosen(points, left)
    for rounds in range(MOST_ROUNDS):
        if rounds > 0:
            _visit(points, first[left], last[left], [own.take(left) for own in cylinders], order)
        now = _stacked(points)
        ends = _distances(now, acting[left]) < SAME_POINT
        found[left[ends]], is_same[left[ends]] = now[ends], True
        goes_on = ~ends & ~cylinders[0].is_alone[left]
        left, points = left[goes_on], _chosen(points, goes_on)
        if not left.size:
            break
    return kept, found, is_same


def _visit(
    points: dict[int, tuple[Array, Array]],
    first: Array,
    last: Array,
    cylinders: Sequence[Cylinders],
    order: Sequence[int],
) -> None:
    """Do one round: put in both contact points, (n, n_turns, 3) each, by the cylinder's place on the path."""
    for place in order:
        before = next((points[i][1] for i in range(place - 1, -1, -1) if i in points), first)
        after = next((points[i][0] for i in range(place + 1, len(cylinders)) if i in points), last)
        points[place] = _touch(before, after, cylinders[place])


def _chosen(points: dict[int, tuple[Array, Array]], chosen: Array) -> dict[int, tuple[Array, Array]]:
    return {place: (one[chosen], other[chosen]) for place, (one, other) in points.items()}


def _stacked(points: dict[int, tuple[Array, Array]]) -> Array:
    return np.stack([point for place in sorted(points) for point in points[place]], axis=2)


def _distances(points: Array, others: FloatArray) -> FloatArray:
    distances: FloatArray = np.abs(points[:, 0].real - others).max(axis=(1, 2))
    return distances


def _touch(before: Array, after: Array, cylinders: Cylinders) -> tuple[Array, Array]:
    """Return both contact points of one cylinder, on the side on which OpenSim has them."""
    frames, origins, touched = cylinders.rotations, cylinders.origins, cylinders.touched[:, :1]
    p, q, r = (np.einsum("ntij,nti->ntj", frames, point - origins) for point in (before, after, touched))
    side = np.where(_cross(p, r).real < 0, -1.0, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        r, s = _contact(p, q, side, cylinders)
    one, other = (np.einsum("ntij,ntj->nti", frames, point) + origins for point in (r, s))
    return one, other


def _contact(p: Array, q: Array, side: FloatArray, cylinders: Cylinders) -> tuple[Array, Array]:
    """Return the contact points between p and q in the frame of the cylinder."""
    radius = cylinders.radii
    # touching circles: the contact is on one side of the first point and on the other of the last
    r, s = _tangent_point(p, side, radius), _tangent_point(q, -side, radius)
    others = _tangent_point(p, -side, radius), _tangent_point(q, side, radius)
    is_far = cylinders.is_constrained & (_between(r, s) > _between(*others))
    is_long = cylinders.is_constrained & (_dot(r - p + s - q, r + s).real < 0)
    apex = _apex(p, q, is_far, radius)
    normal = np.cross(p - apex, q - apex)
    for contact, own, other in ((r, p, q), (s, q, p)):
        height = p[..., 2] - _dot(normal, contact - p) / normal[..., 2]
        reach = np.abs(own[..., 2].real - other[..., 2].real)
        contact[..., 2] = np.where(np.abs((height - other[..., 2]).real) < reach, height, own[..., 2])
    shifted = np.flatnonzero(~cylinders.is_alone)
    if shifted.size:
        r[shifted, :, 2], s[shifted, :, 2] = _shift(
            r[shifted], s[shifted], p[shifted], q[shifted], radius[shifted], is_long[shifted]
        )
    return r, s


def _tangent_point(point: Array, side: FloatArray, radius: FloatArray) -> Array:
    """Return where a tangent from a point touches the circle, at the point's height."""
    square = _dot(point, point)
    along, across = radius**2 / square, side * radius * np.sqrt(square - radius**2) / square
    x, y, z = np.moveaxis(point, -1, 0)
    return np.stack([along * x - across * y, along * y + across * x, z], axis=-1)


def _apex(p: Array, q: Array, is_far: BoolArray, radius: FloatArray) -> Array:
    """Return the point of the cylinder that decides the plane of the contact points' heights."""
    first, second = np.sqrt(_dot(p, p)), np.sqrt(_dot(q, q))
    middle = p + (first / (first + second))[..., None] * (q - p)
    # of the plane through both ends and the axis point at this height, the horizontal direction
    a, b = p - middle * UP, q - middle * UP
    direction = (a * b[..., 2:] - b * a[..., 2:]) * LEVEL
    direction = direction / np.sqrt(_dot(direction, direction))[..., None]
    is_near = _dot(direction, middle).real >= 0
    outward = np.where(is_near != is_far, 1.0, -1.0) * radius
    return middle * UP + outward[..., None] * direction


def _shift(
    r: Array, s: Array, p: Array, q: Array, radius: FloatArray, is_long: BoolArray
) -> tuple[Array, Array]:
    """Return the heights of contact points r and s, shifted until path and helix are tangent.

    OpenSim cuts the helix into pieces: a contact point r is shifted towards the straight line from the path's
    point p to the next joint w of the pieces, by 1.5 times its distance. In these heights that is linear.
    """
    angle = np.where(_cross(r, s).real < 0, -1.0, 1.0) * _arccos(_dot(r, s) / radius**2)
    angle = np.where(is_long, angle - 2.0 * math.pi, angle)
    r_z, s_z, p_z, q_z = (point[..., 2] for point in (r, s, p, q))
    out = np.stack([r_z, s_z])
    left, lines = np.arange(len(r)), None
    for _ in range(MOST_SHIFTS):
        rise = s_z - r_z
        pieces = np.maximum(np.floor(np.hypot(radius * angle.real, rise.real)[:, 0] / PIECE), 1.0)
        if lines is None or (lines.pieces != pieces).any():
            lines = _Lines.to_joints(r, s, p, q, angle, pieces)
        w_z = r_z + lines.share * rise
        moves = lines.are_kinked(0, r_z - p_z, w_z - r_z)
        r_z = np.where(moves, r_z + 1.5 * (p_z + lines.reach[0] * (w_z - p_z) - r_z), r_z)
        # the joint before the last, seen from the first contact point, shifted already or not
        v_z = r_z + (1.0 - lines.share) * rise
        moves_last = lines.are_kinked(1, s_z - q_z, v_z - s_z)
        s_z = np.where(moves_last, s_z + 1.5 * (q_z + lines.reach[1] * (v_z - q_z) - s_z), s_z)
        out[:, left] = r_z, s_z
        goes_on = (moves | moves_last)[:, 0]
        if goes_on.all():
            continue
        if not goes_on.any():
            break
        left, lines = left[goes_on], lines.take(goes_on)
        r, s, p, q, angle, radius, r_z, s_z, p_z, q_z = (
            array[goes_on] for array in (r, s, p, q, angle, radius, r_z, s_z, p_z, q_z)
        )
    return out[0], out[1]


@dataclass(frozen=True, kw_only=True)
class _Lines:
    """Horizontal lengths of what decides the shifts: from the path's points to the first and last joints."""

    pieces: FloatArray  # (n,)
    share: FloatArray  # (n, 1) [-], of the helix, one piece
    reach: tuple[Array, Array]  # (n, n_turns) [-] each, where the contact point lies on the line
    tangents: tuple[FloatArray, FloatArray]  # (n,) [m] each, from the path's point to the contact point
    chords: FloatArray  # (n,) [m], of a piece

    @staticmethod
    def to_joints(r: Array, s: Array, p: Array, q: Array, angle: Array, pieces: FloatArray) -> _Lines:
        """Lay out the pieces of helices."""
        r, s, p, q = (point[..., :2] for point in (r, s, p, q))
        share = (1.0 / pieces)[:, None]
        joints = [_turned(r, angle * part) for part in (share, 1.0 - share)]
        ends = ((p, r), (q, s))
        lines = [joint - end for joint, (end, _) in zip(joints, ends, strict=True)]
        one, other = (
            _dot(contact - end, line) / _dot(line, line)
            for (end, contact), line in zip(ends, lines, strict=True)
        )
        own = [np.sqrt(_dot(contact - end, contact - end).real[:, 0]) for end, contact in ends]
        chord = (joints[0] - r)[:, 0].real
        return _Lines(
            pieces=pieces,
            share=share,
            reach=(one, other),
            tangents=(own[0], own[1]),
            chords=np.sqrt(_dot(chord, chord)),
        )

    def are_kinked(self, i: int, rise: Array, joint_rise: Array) -> BoolArray:
        """Tell whether path and helix differ in their angle to the axis, (n, 1), given how they rise."""
        angle = np.arctan2(self.tangents[i], rise[:, 0].real)
        own = np.arctan2(self.chords, joint_rise[:, 0].real)
        kinked: BoolArray = (np.abs(angle - own) > TANGENCY) & (self.pieces > 1)
        return kinked[:, None]

    def take(self, chosen: BoolArray) -> _Lines:
        """Return some of them."""
        return _Lines(
            pieces=self.pieces[chosen],
            share=self.share[chosen],
            reach=(self.reach[0][chosen], self.reach[1][chosen]),
            tangents=(self.tangents[0][chosen], self.tangents[1][chosen]),
            chords=self.chords[chosen],
        )


def _turned(vector: Array, angle: Array) -> Array:
    """Turn horizontal vectors about the axis."""
    c, d = np.cos(angle), np.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([c * x - d * y, c * y + d * x], axis=-1)


def _between(a: Array, b: Array) -> FloatArray:
    """Return the angle between horizontal parts [rad]."""
    angle: FloatArray = np.arctan2(np.abs(_cross(a, b).real), _dot(a, b).real)
    return angle


def _arccos(cosine: Array) -> Array:
    angle = np.arccos(cosine.real)
    return angle - 1j * cosine.imag / np.sin(angle) if np.iscomplexobj(cosine) else angle


def _dot(a: Array, b: Array) -> Array:
    """Return the scalar product of horizontal parts."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _cross(a: Array, b: Array) -> Array:
    """Return the height of the cross product."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
