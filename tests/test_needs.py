"""What terms need of a motion, and that reading a motion obeys."""

import dataclasses
import inspect

import numpy as np
import pytest
from tiny_model import write_tiny

import scso_nlp as scso
from scso_nlp.needs import MotionNeeds, needs_of
from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.setup_xml import MotionInput, prepared_for


def test_each_kind_of_stability_says_what_it_needs():
    assert scso.JointStability(joints=["knee_r"], axes=["x", "z"]).needs == MotionNeeds(
        muscle_paths=True, stability_axes=(("knee_r", "x"), ("knee_r", "z"))
    )
    assert scso.JointStability(axes=["z"]).needs.stability_axes == (("all", "z"),)
    assert scso.JointStability(moving_paths="frozen").needs == MotionNeeds(muscle_paths=True)
    for kind in (scso.CoordinateStability, scso.HessianStability):
        assert kind(coordinates=["a", "b"]).needs == MotionNeeds(curvature_coordinates=("a", "b"))
        assert kind().needs == MotionNeeds(curvature_coordinates=("all",))
    for term in (scso.JointReactionCone, scso.JointReactionEffort):
        assert term(joints=["hip_*"]).needs == MotionNeeds(joint_reactions=("hip_*",))
        assert term().needs == MotionNeeds(joint_reactions=("all",))
    assert scso.JointReactionLimit(largest=1e3).needs == MotionNeeds(joint_reactions=("all",))
    for term in (scso.MomentEquilibrium(), scso.ActivationEffort(), scso.CompliantTendon()):
        assert term.needs == MotionNeeds()


def test_needs_unite_and_all_is_all():
    joint = scso.JointStability(joints=["knee_r"], axes=["z"])
    along = scso.CoordinateStability(coordinates=["a"])
    assert needs_of([joint, along, joint]) == MotionNeeds(
        muscle_paths=True, stability_axes=(("knee_r", "z"),), curvature_coordinates=("a",)
    )
    assert needs_of([along, scso.HessianStability()]).curvature_coordinates == ("all",)
    assert needs_of([]) == MotionNeeds()


@pytest.mark.parametrize("wrong", [scso.JointStability, "JointStability", None])
def test_what_is_no_term_is_refused(wrong):
    with pytest.raises(scso.ArgumentError, match=r"is no term, expected e\.g\. JointStability"):
        needs_of([wrong])


def test_every_need_is_a_field_of_a_motion_and_every_field_a_keyword_of_load_motion():
    fields = [field.name for field in dataclasses.fields(MotionInput)]
    assert {field.name for field in dataclasses.fields(MotionNeeds)} <= set(fields)
    own = {"setup", "prepare_for", "processes", "cache", "progress"}
    assert [name for name in inspect.signature(load_motion).parameters if name not in own] == fields


def test_a_description_keeps_what_it_asks_for_itself(tmp_path):
    motion = MotionInput(model=tmp_path / "a.osim", coordinates=tmp_path / "a.mot", curvature_coordinates="b")
    prepared = prepared_for(motion, [scso.CoordinateStability(coordinates=["a"])])
    assert set(prepared.curvature_coordinates) == {"a", "b"}
    assert not prepared.muscle_paths
    assert prepared_for(motion, [scso.JointStability()]).muscle_paths


@pytest.mark.opensim
def test_a_motion_that_is_prepared_for_terms_has_what_their_keywords_give(tmp_path):
    tiny = write_tiny(tmp_path)
    joint = scso.JointStability(joints=["elbow"], axes=["z"])
    along = scso.HessianStability(coordinates=["elbow_flexion"])
    prepared = load_motion(tiny.setup, step_interval=20, prepare_for=[joint, along]).trajectory
    told = load_motion(
        tiny.setup,
        step_interval=20,
        stability_axes=[("elbow", "z")],
        curvature_coordinates="elbow_flexion",
    ).trajectory
    assert prepared.skeleton.virtual_rows == told.skeleton.virtual_rows == ("elbow_z",)
    np.testing.assert_array_equal(prepared.skeleton.virtual_curvature, told.skeleton.virtual_curvature)
    np.testing.assert_array_equal(prepared.curvature.path_curvature, told.curvature.path_curvature)
    plain = load_motion(tiny.setup, step_interval=20, prepare_for=()).trajectory
    assert plain.curvature is None
    assert plain.skeleton.path_points.shape[2] == 0
    both = load_motion(tiny.setup, step_interval=20, prepare_for=(), muscle_paths=True).trajectory
    assert both.skeleton.path_points.shape[2] > 0
