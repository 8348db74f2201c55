"""The frozen rows: what they accept, refuse and compute."""

import numpy as np
import pytest

from scso_nlp.exceptions import DataError
from scso_nlp.stability import StabilityRows, geometric_stability, joint_stability


@pytest.fixture
def rows():
    rng = np.random.default_rng(3)
    return StabilityRows(
        rows=("waist_x", "waist_z"),
        muscles=("a", "b", "c"),
        curvature=rng.normal(size=(4, 2, 3)),
        moment_arms=rng.normal(size=(4, 2, 3)),
        path_length=rng.uniform(0.1, 0.4, (4, 3)),
        external_work=rng.normal(size=(4, 2)),
    )


def fields(original, **changes):
    names = ("rows", "muscles", "curvature", "moment_arms", "path_length", "external_work", "notes")
    return {name: getattr(original, name) for name in names} | changes


def test_equation_four_written_with_loops_gives_the_same(rows):
    q, force = np.array([5.0, 3.0, 0.0]), np.random.default_rng(1).uniform(0, 500, (4, 3))
    gs, stability = geometric_stability(rows, q), joint_stability(rows, force, q)
    for k in range(4):
        for r in range(2):
            total = -rows.external_work[k, r]
            for m in range(3):
                one = rows.curvature[k, r, m] + q[m] * rows.moment_arms[k, r, m] ** 2 / rows.path_length[k, m]
                assert gs[k, r, m] == pytest.approx(one, rel=1e-13)
                total += force[k, m] * one
            assert stability[k, r] == pytest.approx(total, rel=1e-12)


def test_one_q_stands_for_every_muscle(rows):
    np.testing.assert_array_equal(geometric_stability(rows, 5), geometric_stability(rows, [5.0] * 3))


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (-1.0, r"q of muscle 'a' is -1, must not be negative"),
        ([5, 5, -2], r"q of muscle 'c' is -2"),
        (np.nan, r"q is nan"),
        ([1.0, 2.0], r"q has shape \(2,\), expected \(3,\)"),
    ],
)
def test_an_unusable_q_is_refused(rows, q, message):
    with pytest.raises(DataError, match=message):
        geometric_stability(rows, q)


def test_forces_of_another_shape_are_refused(rows):
    with pytest.raises(DataError, match=r"tendon_force has shape \(3, 4\)"):
        joint_stability(rows, np.ones((3, 4)), 5.0)


def test_rows_refuse_wrong_shapes_values_and_names(rows):
    with pytest.raises(DataError, match=r"curvature has shape \(4, 3, 2\), expected \(4, 2, 3\)"):
        StabilityRows(**fields(rows, curvature=np.zeros((4, 3, 2))))
    with pytest.raises(DataError, match="moment_arms is nan"):
        StabilityRows(**fields(rows, moment_arms=np.full((4, 2, 3), np.nan)))
    with pytest.raises(DataError, match=r"external_work has shape \(4,\)"):
        StabilityRows(**fields(rows, external_work=np.zeros(4)))
    with pytest.raises(DataError, match="path_length of muscle 'a' is 0 m at frame 0"):
        StabilityRows(**fields(rows, path_length=np.zeros((4, 3))))
    with pytest.raises(DataError, match="row names must be unique"):
        StabilityRows(**fields(rows, rows=("waist_x", "waist_x")))


def test_rows_cannot_be_written_to(rows):
    with pytest.raises(ValueError, match="read-only"):
        rows.curvature[0, 0, 0] = 1.0


def test_some_frames_of_the_rows_are_the_rows_of_some_frames(rows):
    part = rows.frames(slice(1, 3))
    assert part.n_frames == 2
    np.testing.assert_array_equal(part.curvature, rows.curvature[1:3])
    np.testing.assert_array_equal(geometric_stability(part, 5.0), geometric_stability(rows, 5.0)[1:3])
    np.testing.assert_array_equal(rows.frames(np.array([3])).external_work, rows.external_work[[3]])
