"""What a model holds, of models in which all of it is known by construction, and of OpenSim's own."""

import re
from pathlib import Path

import numpy as np
import pytest
import tiny_model
from tiny_model import Tiny, write_tiny

from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.opensim.description import JointAxis, ModelDescription, describe_model

pytestmark = pytest.mark.opensim

#: Both sides take the same moment arms from the same model [m].
TOLERANCE = 1e-12
#: The wrist turns about z by its angle, and by this share of it about an axis between x and y [-].
SHARE = 0.3


def _axis(name: str, direction: str, function: str, coordinate: str = "wrist_angle") -> str:
    return f"""<TransformAxis name="{name}"><coordinates>{coordinate}</coordinates><axis>{direction}</axis>
      {function}</TransformAxis>"""


def _linear(slope: float) -> str:
    return f"<LinearFunction><coefficients>{slope} 0</coefficients></LinearFunction>"


def with_hand(tiny: Tiny, coordinate: str = "") -> None:
    """Add a hand that no muscle reaches, on a wrist with oblique axes."""
    frames = tiny_model._frames("/bodyset/lower", "0 -0.25 0", "/bodyset/hand")
    zero = "<Constant><value>0</value></Constant>"
    axes = (
        _axis("rotation1", "0 0 1", _linear(1.0))
        + _axis("rotation2", "0.8 0.6 0", _linear(SHARE))
        + _axis("rotation3", "0 1 0", zero, "")
        + _axis("translation1", "1 0 0", zero, "")
        + _axis("translation2", "0 1 0", zero, "")
        + _axis("translation3", "0 0 1", zero, "")
    )
    wrist = f"""<CustomJoint name="wrist">{frames}<coordinates><Coordinate name="wrist_angle">{coordinate}
      </Coordinate></coordinates><SpatialTransform>{axes}</SpatialTransform></CustomJoint>"""
    text = tiny.model.read_text(encoding="utf-8")
    for name, new in (("BodySet", tiny_model._body("hand", 0.4, 0.05)), ("JointSet", wrist)):
        text = re.sub(rf"(\s*</objects></{name}>)", rf"{new}\1", text)
    tiny.model.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> ModelDescription:
    """The small model with a hand, described once."""
    tiny = write_tiny(tmp_path_factory.mktemp("plain"))
    with_hand(tiny)
    return describe_model(tiny.model)


def _rows(description: ModelDescription) -> dict[str, JointAxis]:
    return {axis.row: axis for axis in description.axes}


def test_rows_that_can_be_stable_are_those_that_a_free_coordinate_turns_and_a_muscle_pulls_about(
    plain: ModelDescription,
) -> None:
    rows = _rows(plain)
    assert [row for row, axis in rows.items() if axis.can_be_stable] == ["shoulder_z", "elbow_z"]
    assert rows["shoulder_z"].turned_by == pytest.approx({"shoulder_flexion": 1.0})
    assert rows["shoulder_x"].obstacle == "no free coordinate turns it"
    assert rows["wrist_z"].obstacle == "no muscle crosses the joint"
    # the slider does not turn, and its coordinate is coupled
    assert not any(rows[f"sliding_{axis}"].turned_by for axis in "xyz")
    assert list(rows["sliding_x"].moment_arms) == ["through_slider"]


def test_a_coordinate_turns_a_joint_along_its_own_axes_mainly_about_one(plain: ModelDescription) -> None:
    rows = _rows(plain)
    assert rows["wrist_z"].turned_by == pytest.approx({"wrist_angle": 1.0})
    # oblique: its component along y would not be zero
    assert rows["wrist_x"].follows == pytest.approx({"wrist_angle": SHARE})
    assert not rows["wrist_x"].turned_by
    assert not rows["wrist_y"].turned_by
    assert not rows["wrist_y"].follows


@pytest.mark.parametrize("state", ["locked", "prescribed"])
def test_coordinates_that_are_set_turn_nothing(tiny: Tiny, state: str) -> None:
    function = "<prescribed_function><Constant><value>0.1</value></Constant></prescribed_function>"
    with_hand(tiny, f"<{state}>true</{state}>" + (function if state == "prescribed" else ""))
    description = describe_model(tiny.model)
    assert not any(axis.turned_by or axis.follows for axis in description.axes if axis.joint == "wrist")
    states = {coordinate.name: coordinate.state for coordinate in description.coordinates}
    assert states == {
        "shoulder_flexion": "free",
        "elbow_flexion": "free",
        "slide": "coupled",
        "wrist_angle": state,
    }


def test_a_coupled_coordinate_turns_its_joint_with_what_it_is_coupled_to(tiny: Tiny) -> None:
    with_hand(tiny)
    text = tiny.model.read_text(encoding="utf-8")
    coupling = f"""<CoordinateCouplerConstraint name="grip"><coupled_coordinates_function>{_linear(0.5)}
      </coupled_coordinates_function><independent_coordinate_names>elbow_flexion</independent_coordinate_names>
      <dependent_coordinate_name>wrist_angle</dependent_coordinate_name></CoordinateCouplerConstraint>"""
    text = re.sub(r"(<ConstraintSet .*><objects>)", rf"\1{coupling}", text)
    tiny.model.write_text(text, encoding="utf-8")
    description = describe_model(tiny.model)
    wrist = _rows(description)["wrist_z"]
    assert wrist.turned_by == pytest.approx({"elbow_flexion": 0.5})
    assert wrist.by_constraint == ("elbow_flexion",)
    assert dict(description.constraints) == {
        "grip": "CoordinateCouplerConstraint",
        "coupling": "CoordinateCouplerConstraint",
    }


def test_moment_arms_are_those_of_the_default_pose(plain: ModelDescription) -> None:
    rows = _rows(plain)
    # from (0.02, 1.02) to (0.03, 0.9), turned about (0, 1): -dl/dθ = (b_x a_y - a_x b_y) / l
    arm = (0.03 * 0.02 - 0.02 * -0.1) / np.hypot(0.01, 0.12)
    assert rows["shoulder_z"].moment_arms["flexor"] == pytest.approx(arm, abs=TOLERANCE)
    assert abs(rows["elbow_z"].moment_arms["wrapped"]) == pytest.approx(tiny_model.CYLINDER_RADIUS, abs=1e-9)
    assert list(rows["shoulder_z"].moment_arms) == ["flexor", "through_slider"]
    muscles = [muscle.name for muscle in plain.muscles]
    assert muscles == ["flexor", "wrapped", "through_slider"]
    assert plain.switched_off == ("switched_off",)
    of_flexor = plain.moment_arms[:, muscles.index("flexor")]
    assert of_flexor[0] == pytest.approx(arm, abs=TOLERANCE)


def test_bodies_coordinates_and_actuators_are_those_of_the_files(tiny: Tiny) -> None:
    given = "<range>-0.5 1.2</range><clamped>true</clamped><default_value>0.25</default_value>"
    with_hand(tiny, given)
    description = describe_model(tiny.model, actuators=[tiny.actuators])
    assert description.body_masses == {"ground": 0, "upper": 2.0, "lower": 1.5, "slider": 0.1, "hand": 0.4}
    assert description.mass == pytest.approx(4.0)
    assert description.body_parents["hand"] == "lower"
    wrist = description.coordinates[-1]
    assert (wrist.range, wrist.default, wrist.is_clamped) == ((-0.5, 1.2), 0.25, True)
    assert (wrist.motion, wrist.unit, wrist.joint) == ("rotational", "rad", "wrist")
    (joint,) = [joint for joint in description.joints if joint.name == "wrist"]
    assert (joint.kind, joint.parent, joint.child) == ("CustomJoint", "lower", "hand")
    reserve, push = description.actuators
    assert (reserve.name, reserve.optimal_force, reserve.min_control) == ("elbow_reserve", 4.0, -np.inf)
    assert (push.kind, push.min_control, push.max_control) == ("PointActuator", -2.0, 3.0)
    # 5 N along x, 0.2 m below the elbow and 0.5 m below the shoulder
    free = [coordinate.name for coordinate in description.free]
    assert free == ["shoulder_flexion", "elbow_flexion", "wrist_angle"]
    np.testing.assert_allclose(description.actuator_forces, [[0, 2.5], [4, 1], [0, 0]], atol=1e-9)
    assert not any(coordinate.is_base for coordinate in description.coordinates)
    assert dict(description.other_forces) == {"ligament": "SpringGeneralizedForce"}


def test_a_model_without_muscles_is_described_too(tiny: Tiny) -> None:
    description = describe_model(tiny.model, replace_force_set=True)
    assert not description.muscles
    assert not description.actuators
    assert {axis.obstacle for axis in description.axes} == {"no muscle crosses the joint"}


def test_files_that_are_none_are_refused(tiny: Tiny, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nothing\.osim"):
        describe_model(tmp_path / "nothing.osim")
    with pytest.raises(FileFormatError, match="expected Model"):
        describe_model(tiny.actuators)


def test_rows_of_opensims_gait_model_are_the_sagittal_ones_of_its_legs(shared_data: Path) -> None:
    folder = shared_data / "gait10dof18musc"
    description = describe_model(folder / "gait10dof18musc_simbody.osim")
    rows = [axis.row for axis in description.axes if axis.can_be_stable]
    assert rows == [f"{joint}_{side}_z" for side in "rl" for joint in ("hip", "knee", "ankle")]
    floating = [coordinate.name for coordinate in description.coordinates if coordinate.is_base]
    assert floating == ["pelvis_tilt", "pelvis_tx", "pelvis_ty"]
    knee = next(joint for joint in description.joints if joint.name == "knee_r")
    assert set(knee.muscles) == {"hamstrings_r", "bifemsh_r", "rect_fem_r", "vasti_r", "gastroc_r"}
