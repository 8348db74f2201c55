"""The multibody tree: joints written either way, and components that stand outside the model's sets."""

import re
from collections.abc import Iterable

import numpy as np
import pytest
import tiny_model
from scipy.optimize import brentq
from tiny_model import Tiny, write_motion

from scso_nlp.opensim.engine import load_motion
from scso_nlp.trajectory import MotionTrajectory

pytestmark = pytest.mark.opensim

AXES = tuple((joint, axis) for joint in ("shoulder", "elbow", "sliding") for axis in "xyz")
#: The coordinate of each joint of the small case.
COORDINATES = {"shoulder": "shoulder_flexion", "elbow": "elbow_flexion", "sliding": "slide"}


def _load(tiny: Tiny) -> MotionTrajectory:
    """Load everything that depends on the tree, but for a few frames."""
    return load_motion(
        tiny.setup,
        lowpass_cutoff_frequency=-1,
        step_interval=10,
        stability_axes=AXES,
        curvature_coordinates=("all",),
    ).trajectory


def _turn_round(tiny: Tiny, reversed_joints: Iterable[str]) -> None:
    """Write joints from their distal body to the other, and their coordinates with the other sign."""
    text, actuators = tiny.model.read_text(), tiny.actuators.read_text()
    time = np.linspace(0.0, 1.0, 101)
    elbow = 0.6 + 0.4 * np.sin(2 * np.pi * time)
    columns = {
        "shoulder_flexion": 0.3 * np.cos(2 * np.pi * time),
        "elbow_flexion": elbow,
        "slide": tiny_model.SLIDE_PER_RADIAN * elbow,
    }
    for joint in reversed_joints:
        usual = r"(Joint name=\"{}\">)<socket_parent_frame>from(.*?)<socket_child_frame>to<"
        other = r"\1<socket_parent_frame>to\2<socket_child_frame>from<"
        text, found = re.subn(usual.format(joint), other, text)
        assert found == 1
        columns[COORDINATES[joint]] = -columns[COORDINATES[joint]]
        if joint == "shoulder":
            text = text.replace("<rest_length>0.1<", "<rest_length>-0.1<")
        else:
            text = re.sub(r"<coefficients>(-?)", lambda sign: "<coefficients>" + "-" * (not sign[1]), text)
        if joint == "elbow":
            actuators = actuators.replace("<optimal_force>4<", "<optimal_force>-4<")
    tiny.model.write_text(text)
    tiny.actuators.write_text(actuators)
    write_motion(tiny.moving, time, columns)


@pytest.mark.parametrize(
    "reversed_joints", [("shoulder",), ("elbow",), ("sliding",), ("shoulder", "elbow", "sliding")]
)
def test_a_joint_written_towards_ground_is_the_mirror_image_of_the_usual_one(
    tiny: Tiny, reversed_joints: tuple[str, ...]
) -> None:
    usual = _load(tiny)
    _turn_round(tiny, reversed_joints)
    turned = _load(tiny)
    assert turned.coordinates == usual.coordinates == ("shoulder_flexion", "elbow_flexion")
    sign = np.array([-1.0 if joint in reversed_joints else 1.0 for joint in ("shoulder", "elbow")])
    close = {"rtol": 0, "atol": 1e-9}
    np.testing.assert_allclose(turned.moment_arms, sign[:, None] * usual.moment_arms, **close)
    for name in ("generalized_forces", "passive_generalized_forces"):
        np.testing.assert_allclose(getattr(turned, name), sign * getattr(usual, name), **close)
    before, after = usual.curvature, turned.curvature
    assert before is not None
    assert after is not None
    assert np.abs(before.load_stiffness).min() > 1e-3
    both = np.outer(sign, sign)
    np.testing.assert_allclose(after.path_curvature, both[..., None] * before.path_curvature, **close)
    # differences of some 10 N·m over 4e-5 rad
    for name in ("load_stiffness", "passive_stiffness"):
        np.testing.assert_allclose(
            getattr(after, name), both * getattr(before, name), rtol=0, atol=1e-8, err_msg=name
        )
    assert usual.skeleton is not None
    assert turned.skeleton is not None
    for name in ("joint_centers", "joint_axes", "body_parents", "joint_children", "virtual_moment_arms"):
        np.testing.assert_allclose(
            getattr(turned.skeleton, name), getattr(usual.skeleton, name), **close, err_msg=name
        )
    # differences of some centimetres over 2e-4 rad, behind a wrap that OpenSim finds to 1e-12
    np.testing.assert_allclose(
        turned.skeleton.virtual_curvature, usual.skeleton.virtual_curvature, rtol=0, atol=1e-8
    )


def _outside_the_sets(tiny: Tiny, *moved: str) -> None:
    """Move components from their sets into the model itself."""
    text = tiny.model.read_text()
    components = []
    for name in moved:
        (found,) = re.findall(rf'<(\w+) name="{name}">', text)
        (component,) = re.findall(rf'<{found} name="{name}">.*?</{found}>', text, flags=re.DOTALL)
        text = text.replace(component, "")
        components.append(component)
    text = text.replace("<gravity>", f"<components>{''.join(components)}</components><gravity>")
    for name in moved:
        text = text.replace(f"/bodyset/{name}<", f"/{name}<")
    tiny.model.write_text(text)


@pytest.mark.parametrize(
    "moved",
    [("elbow",), ("slider",), ("slider", "sliding"), ("coupling",), ("ligament",), ("shoulder", "coupling")],
)
def test_components_mean_the_same_wherever_they_stand(tiny: Tiny, moved: tuple[str, ...]) -> None:
    within = _load(tiny)
    _outside_the_sets(tiny, *moved)
    outside = _load(tiny)
    assert within.skeleton is not None
    assert outside.skeleton is not None
    ours, theirs = outside.skeleton, within.skeleton
    assert set(ours.bodies) == set(theirs.bodies) == {"ground", "upper", "lower", "slider"}
    assert set(ours.joints) == set(theirs.joints) == set(COORDINATES)
    for name in ("moment_arms", "generalized_forces", "passive_generalized_forces"):
        np.testing.assert_allclose(getattr(outside, name), getattr(within, name), rtol=0, atol=1e-12)
    bodies = [ours.bodies.index(body) for body in theirs.bodies]
    joints = [ours.joints.index(joint) for joint in theirs.joints]
    np.testing.assert_array_equal(ours.body_masses[bodies], theirs.body_masses)
    centers = ours.body_mass_centers[:, bodies]
    np.testing.assert_allclose(centers, theirs.body_mass_centers, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.joint_axes[:, joints], theirs.joint_axes, rtol=0, atol=1e-12)
    for mine, other in zip(joints, range(len(joints)), strict=True):
        distal = ours.distal_bodies(mine)[bodies]
        np.testing.assert_array_equal(distal, theirs.distal_bodies(other))
    np.testing.assert_allclose(
        ours.virtual_moment_arms, theirs.virtual_moment_arms, rtol=0, atol=1e-12, equal_nan=True
    )
    assert outside.curvature is not None
    assert within.curvature is not None
    for name in ("path_curvature", "load_stiffness", "passive_stiffness"):
        # the same differences over 4e-5 rad, rounded in another order
        np.testing.assert_allclose(
            getattr(outside.curvature, name), getattr(within.curvature, name), rtol=0, atol=1e-9
        )


@pytest.mark.parametrize("path", ["lower", "bodyset/lower", "/bodyset/lower", "./bodyset/lower"])
def test_a_load_finds_its_body_by_name_and_by_path(tiny: Tiny, path: str) -> None:
    usual = load_motion(tiny.setup, step_interval=20).trajectory
    text = tiny.loads.read_text()
    tiny.loads.write_text(re.sub(r"_body>lower<", f"_body>{path}<", text))
    by_path = load_motion(tiny.setup, step_interval=20).trajectory
    np.testing.assert_array_equal(by_path.generalized_forces, usual.generalized_forces)
    assert usual.skeleton is not None
    assert by_path.skeleton is not None
    np.testing.assert_array_equal(by_path.skeleton.load_bodies, usual.skeleton.load_bodies)
    np.testing.assert_array_equal(by_path.skeleton.load_points, usual.skeleton.load_points)


def test_all_joints_are_asked_for_by_one_word(tiny: Tiny) -> None:
    every = _load(tiny).skeleton
    asked = tuple(("all", axis) for axis in "xyz")
    by_word = load_motion(
        tiny.setup, lowpass_cutoff_frequency=-1, step_interval=10, stability_axes=(*asked, ("elbow", "z"))
    ).trajectory.skeleton
    assert every is not None
    assert by_word is not None
    assert sorted(by_word.virtual_rows) == sorted(every.virtual_rows)
    rows = [by_word.virtual_rows.index(row) for row in every.virtual_rows]
    np.testing.assert_array_equal(by_word.virtual_curvature[:, rows], every.virtual_curvature)


def _with_a_rocker(tiny: Tiny) -> None:
    """Close a loop by joints: a rocker hangs on ground and on the end of the lower body."""

    def reach(shoulder: float, elbow: float) -> np.ndarray:
        both = shoulder + elbow
        end = tiny_model.UPPER_LENGTH * np.array([np.sin(shoulder), -np.cos(shoulder)])
        return end + 0.2 * np.array([np.sin(both), -np.cos(both)]) + [-0.3, -0.1]

    length = float(np.linalg.norm(reach(0.3, 0.7)))
    angle = float(np.arctan2(*reach(0.3, 0.7)[::-1]))
    pin = """<PinJoint name="{0}"><socket_parent_frame>from</socket_parent_frame>
      <socket_child_frame>to</socket_child_frame><coordinates><Coordinate name="{0}_angle">
      <default_value>{1}</default_value></Coordinate></coordinates><frames>
      <PhysicalOffsetFrame name="from"><socket_parent>{2}</socket_parent><translation>{3}</translation>
      </PhysicalOffsetFrame><PhysicalOffsetFrame name="to"><socket_parent>{4}</socket_parent>
      <translation>{5}</translation></PhysicalOffsetFrame></frames></PinJoint>"""
    joints = pin.format("rocking", angle, "/ground", "0.3 1.1 0", "/bodyset/rocker", "0 0 0")
    end = f"{length} 0 0"
    joints += pin.format("closing", 1.0 - angle, "/bodyset/rocker", end, "/bodyset/lower", "0 -0.2 0")
    body = """<Body name="rocker"><mass>0.5</mass><mass_center>0.1 0 0</mass_center>
      <inertia>0.01 0.002 0.01 0 0 0</inertia></Body>"""
    text = tiny.model.read_text()
    text = text.replace('<Body name="slider">', body + '<Body name="slider">')
    tiny.model.write_text(text.replace("<SliderJoint", joints + "<SliderJoint"))
    for name, step in (("before", -1e-3), ("middle", 0.0), ("after", 1e-3)):
        elbow = 0.7 + step
        shoulder = brentq(lambda s, e=elbow: np.linalg.norm(reach(s, e)) - length, 0.2, 0.4, xtol=1e-14)
        rocking = np.arctan2(*reach(shoulder, elbow)[::-1])
        columns = {
            "shoulder_flexion": shoulder,
            "elbow_flexion": elbow,
            "slide": tiny_model.SLIDE_PER_RADIAN * elbow,
            "rocking_angle": rocking,
            "closing_angle": shoulder + elbow - rocking,
        }
        still = {coordinate: np.array(value) for coordinate, value in columns.items()}
        write_motion(tiny.folder / f"{name}.mot", np.linspace(0, 0.1, 11), still)


def test_a_loop_of_joints_is_cut_as_opensim_cuts_it_and_weighs_every_body_once(tiny: Tiny) -> None:
    _with_a_rocker(tiny)
    before, middle, after = (
        load_motion(
            model=tiny.model,
            coordinates=tiny.folder / f"{name}.mot",
            final_time=0.0,
            curvature_coordinates="all",
        ).trajectory
        for name in ("before", "middle", "after")
    )
    skeleton, curvature = middle.skeleton, middle.curvature
    assert skeleton is not None
    assert curvature is not None
    assert skeleton.bodies == ("ground", "upper", "lower", "rocker", "slider")
    assert skeleton.body_parents.tolist() == [-1, 0, 1, 0, 1]
    assert len(middle.coordinates) == 1
    (slope,) = (after.generalized_forces - before.generalized_forces)[0]
    slope /= (after.coordinate_values - before.coordinate_values)[0, 0]
    # a secant over 2e-3 rad
    stiffness = curvature.load_stiffness[0, 0, 0] + curvature.passive_stiffness[0, 0, 0]
    assert stiffness == pytest.approx(slope, rel=1e-4)
