"""Which rows stand where joints or axes are not named: of a skeleton by hand, and of models by OpenSim."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from helpers import two_antagonists
from tiny_model import write_tiny

import scso_nlp as scso
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.opensim.description import describe_model
from scso_nlp.opensim.engine import load_motion
from scso_nlp.stability.rows import left_out, select_rows

UNTURNED, UNCROSSED = "no free coordinate turns it", "no muscle crosses the joint"


def three_joints(*obstacles: str) -> scso.Skeleton:
    """The skeleton of the two antagonists with its joint three times: base, hinge, ball."""
    one = two_antagonists(5.0).motion.trajectory.skeleton
    return dataclasses.replace(
        one,
        joints=("base", "hinge", "ball"),
        joint_children=[*one.joint_children] * 3,
        joint_centers=one.joint_centers.repeat(3, axis=1),
        joint_axes=one.joint_axes.repeat(3, axis=1),
        joint_obstacles=obstacles,
    )


@pytest.fixture
def known() -> scso.Skeleton:
    return three_joints(*[UNCROSSED] * 3, UNTURNED, UNTURNED, "", "", "", "")


@pytest.mark.parametrize(
    ("joints", "axes", "expected"),
    [
        (None, None, ["hinge_z", "ball_x", "ball_y", "ball_z"]),
        (None, ("z", "x"), ["hinge_z", "ball_z", "ball_x"]),
        (("ball", "hinge"), None, ["ball_x", "ball_y", "ball_z", "hinge_z"]),
        # what is named is kept
        (("base", "hinge"), ("x",), ["base_x", "hinge_x"]),
    ],
)
def test_rows_that_are_not_named_are_those_that_muscles_can_make_stable(known, joints, axes, expected):
    rows, joint, axis = select_rows(known, joints, axes)
    assert list(rows) == expected
    assert [f"{known.joints[j]}_{'xyz'[a]}" for j, a in zip(joint, axis, strict=True)] == expected


def test_all_rows_stand_where_nothing_is_known_of_the_joints():
    assert len(select_rows(three_joints(), None, None)[0]) == 9
    assert left_out(three_joints(), None, None) == ""


@pytest.mark.parametrize(
    ("joints", "axes", "expected"),
    [
        (None, None, f"{UNCROSSED}: base; {UNTURNED}: x and y of hinge"),
        (None, ("z",), f"{UNCROSSED}: base"),
        (("hinge", "ball"), None, f"{UNTURNED}: x and y of hinge"),
        (("base",), ("x",), ""),
    ],
)
def test_what_is_left_out_is_told_by_reason_axes_and_joints(known, joints, axes, expected):
    assert left_out(known, joints, axes) == expected


def test_a_named_joint_without_such_an_axis_is_refused_with_the_remedy(known):
    with pytest.raises(
        DataError, match=rf"no axis of base stable \({UNCROSSED}: base\): leave it out, or name"
    ):
        select_rows(known, ("hinge", "base"), None)
    with pytest.raises(DataError, match=rf"can make no joint axis stable.*{UNTURNED}"):
        select_rows(three_joints(*[UNTURNED] * 9), None, None)


def test_as_many_obstacles_as_axes_are_expected():
    with pytest.raises(
        DataError, match="joint_obstacles has 2 entries, expected none or three for each of 3"
    ):
        three_joints("", "")


def test_a_level_of_a_row_that_is_left_out_says_why(known):
    plain = two_antagonists(5.0)
    trajectory = dataclasses.replace(plain.motion.trajectory, skeleton=known)
    motion = dataclasses.replace(plain.motion, trajectory=trajectory)
    stability = scso.JointStability(level={"hinge_x": 1.0})
    problem = dataclasses.replace(plain, motion=motion, constraints=(plain.constraints[0], stability))
    with pytest.raises(NameMismatchError, match=r"unknown stability row 'hinge_x'.*are left out unless"):
        scso.solve_trajectory(problem)


def rows_of(setup: Path) -> tuple[str, ...]:
    """Rows of JointStability() in Python, which must be those that a description of the model promises."""
    motion = load_motion(setup, final_time=0.12, lowpass_cutoff_frequency=None)
    rows = scso.JointStability().row_names(motion)
    axes = describe_model(setup.parent / "tiny.osim").axes
    assert list(rows) == [axis.row for axis in axes if axis.can_be_stable]
    return rows


@pytest.mark.opensim
@pytest.mark.parametrize(
    ("lock", "expected"), [("", ("shoulder_z", "elbow_z")), ("shoulder_flexion", ("elbow_z",))]
)
def test_of_a_model_only_axes_of_free_coordinates_at_joints_that_muscles_cross(tmp_path, lock, expected):
    tiny = write_tiny(tmp_path)
    text = tiny.model.read_text(encoding="utf-8")
    start = f'<Coordinate name="{lock}">'
    tiny.model.write_text(text.replace(start, f"{start}<locked>true</locked>"), encoding="utf-8")
    assert rows_of(tiny.setup) == expected
