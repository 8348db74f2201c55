"""The multibody tree: joints written either way, and components that stand outside the model's sets."""

import re

import numpy as np
import pytest
import tiny_model
from tiny_model import Tiny

from scso_nlp.opensim.engine import load_motion
from scso_nlp.trajectory import MotionTrajectory

pytestmark = pytest.mark.opensim

AXES = tuple((joint, axis) for joint in ("shoulder", "elbow", "sliding") for axis in "xyz")


def _load(tiny: Tiny) -> MotionTrajectory:
    """Load everything that depends on the tree, but for a few frames."""
    return load_motion(
        tiny.setup,
        lowpass_cutoff_frequency=-1,
        step_interval=10,
        stability_axes=AXES,
        curvature_coordinates=("all",),
    ).trajectory


@pytest.mark.parametrize(
    "reversed_joints", [("shoulder",), ("elbow",), ("sliding",), ("shoulder", "elbow", "sliding")]
)
def test_a_joint_written_towards_ground_is_the_mirror_image_of_the_usual_one(
    tiny: Tiny, reversed_joints: tuple[str, ...]
) -> None:
    usual = _load(tiny)
    tiny_model.turn_round(tiny, reversed_joints)
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
    assert set(ours.joints) == set(theirs.joints) == set(tiny_model.COORDINATES)
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


def test_a_loop_of_joints_is_cut_as_opensim_cuts_it_and_weighs_every_body_once(tiny: Tiny) -> None:
    tiny_model.add_a_rocker(tiny)
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
