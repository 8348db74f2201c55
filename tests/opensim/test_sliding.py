"""Curvature of a path over a cylinder against geometry by hand: OpenSim is not needed."""

from dataclasses import replace

import numpy as np
import pytest

from scso_nlp.opensim.worker.sliding import TurnedPaths, sliding_curvature
from scso_nlp.opensim.worker.wrapping import SAME_POINT, WrapSurfaces

RADIUS = 0.03
START, END = np.array([0.1, 0.02, 0.0]), np.array([-0.08, 0.01, 0.0])
UP = np.array([[[0.0, 0.0, 1.0]]])


def touching(point: np.ndarray, side: float) -> np.ndarray:
    """Where a tangent from a point in the plane touches: at arccos(radius / distance) from it."""
    angle = np.arctan2(point[1], point[0]) + side * np.arccos(RADIUS / np.hypot(*point[:2]))
    return RADIUS * np.array([np.cos(angle), np.sin(angle), 0.0])


def over_a_cylinder(center: np.ndarray, end: np.ndarray = END) -> TurnedPaths:
    """A path in the plane z = 0 from ground over a cylinder fixed to ground to a body that turns."""
    points = np.stack([START, touching(START, 1.0), touching(end, -1.0), end])[None, None]
    return TurnedPaths(
        points=points,
        acting=points,
        bodies=np.array([[[0, 0, 0, 1]]]),
        surfaces=np.array([[[-1, 0, 0, -1]]]),
        rotations=np.broadcast_to(np.eye(3), (1, 2, 3, 3)),
        origins=np.zeros((1, 2, 3)),
        centers=center[None],
        is_distal=np.array([False, True]),
    )


CYLINDER = WrapSurfaces(
    bodies=np.array([0]),
    rotations=np.eye(3)[None],
    origins=np.zeros((1, 3)),
    radii=np.array([RADIUS]),
    is_constrained=np.array([False]),
    is_alone=np.array([True]),
    places=np.array([0]),
)


def test_a_path_wound_about_the_cylinder_it_touches_keeps_its_moment_arm() -> None:
    found, is_known = sliding_curvature(over_a_cylinder(np.zeros(3)), CYLINDER, UP)
    assert is_known.all()
    np.testing.assert_allclose(found, 0.0, atol=1e-15)


@pytest.mark.parametrize("is_alone", [True, False])
def test_about_a_parallel_axis_the_free_end_moves_as_an_involute(is_alone: bool) -> None:
    # Length grows as the end moves along the tangent e and stays as it moves along the involute, whose
    # radius of curvature is the free length: L'' = (v · n)² / free - e · arm, with v = z x arm.
    center = np.array([0.02, -0.04, 0.0])
    surfaces = replace(CYLINDER, is_alone=np.array([is_alone]))
    found, is_known = sliding_curvature(over_a_cylinder(center), surfaces, UP)
    tangent = END - touching(END, -1.0)
    free = np.linalg.norm(tangent)
    arm = END - center
    across = np.cross([0, 0, 1], tangent / free) @ np.cross([0, 0, 1], arm)
    assert is_known.all()
    np.testing.assert_allclose(found[0, 0, 0], across**2 / free - tangent / free @ arm, rtol=1e-13)


def test_a_turning_cylinder_is_a_turning_start_seen_from_it() -> None:
    center = np.array([0.02, -0.04, 0.0])
    paths = over_a_cylinder(center)
    with_end = replace(paths, bodies=np.array([[[0, 1, 1, 1]]]))
    alone, _ = sliding_curvature(with_end, replace(CYLINDER, bodies=np.array([1])), UP)
    with_start = replace(paths, bodies=np.array([[[1, 0, 0, 0]]]))
    other, _ = sliding_curvature(with_start, CYLINDER, UP)
    np.testing.assert_allclose(alone, other, rtol=1e-13)


def test_what_is_not_opensims_rule_is_not_known() -> None:
    paths = over_a_cylinder(np.array([0.02, -0.04, 0.0]))
    points = paths.points.copy()
    points[0, 0, 1, 2] += 10 * SAME_POINT
    for other, surfaces in (
        (replace(paths, points=points), CYLINDER),
        (replace(paths, acting=points), CYLINDER),
        (paths, replace(CYLINDER, radii=np.array([np.nan]))),
    ):
        _, is_known = sliding_curvature(other, surfaces, UP)
        assert not is_known.any()
    # a path whose body does not turn against its cylinder needs no rule
    found, is_known = sliding_curvature(
        replace(paths, points=points, bodies=np.zeros((1, 1, 4), dtype=int)), CYLINDER, UP
    )
    assert is_known.all()
    assert (found == 0).all()
