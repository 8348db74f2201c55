"""``scso.info``: a model and files in which all of it is known."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import tiny_model
from tiny_model import Tiny, setup_text, write_motion

from scso_nlp.exceptions import DataError
from scso_nlp.overview.info import ModelInfo, info
from scso_nlp.overview.model_tables import role_of

pytestmark = pytest.mark.opensim


def table(found: ModelInfo, title: str, **options: bool) -> list[tuple[str, ...]]:
    """Rows of the table whose title holds a word."""
    (one,) = [table for table in found.tables(**options) if title in table.title]
    return list(one.rows)


def notes(found: ModelInfo) -> str:
    """All sentences."""
    return "\n".join(note for table in found.tables() for note in table.notes)


def test_rows_that_can_be_made_stable_come_with_the_options_to_type(tiny_info: ModelInfo) -> None:
    assert tiny_info.stable_rows == ("shoulder_z", "elbow_z")
    assert "2 rows can be made stable by muscles:\n  --joints shoulder,elbow --axes z\n" in notes(tiny_info)
    rows = table(tiny_info, "Joints")
    assert rows[0] == ("shoulder", "ground → upper", "z", "shoulder_flexion", "2", "1 / 1", "shoulder_z")
    assert rows[2][0::6] == ("sliding", "none: no free coordinate turns it (coupled)")


def test_coordinates_have_their_course_and_what_pushes_them(tiny_info: ModelInfo) -> None:
    inputs = tiny_info.inputs
    assert inputs is not None
    # frames of 0.1 to 0.8 s: the elbow reaches 0.6 ± 0.4 rad
    np.testing.assert_allclose(inputs.columns["elbow_flexion"], (0.2, 1.0), atol=1e-12)
    np.testing.assert_allclose(
        inputs.columns["slide"], np.multiply(tiny_model.SLIDE_PER_RADIAN, (0.2, 1.0)), atol=1e-12
    )
    (elbow,) = [row for row in table(tiny_info, "Coordinates") if row[0] == "elbow_flexion"]
    assert elbow[4] == "11.5 to 57.3"
    assert elbow[6] == "4 + 1"
    (slide,) = [row for row in table(tiny_info, "Coordinates") if row[0] == "slide"]
    assert slide[1] == "coupled"
    assert slide[4] == "0.004 to 0.02"


def test_actuators_have_their_role_limits_and_file(tiny_info: ModelInfo) -> None:
    rows = table(tiny_info, "Reserves")
    assert rows[0] == ("reserve", "elbow_reserve", "Coordinate", "elbow_flexion 4 N·m", "any")
    assert rows[1][3:] == ("shoulder_flexion 2.5 N·m, elbow_flexion 1 N·m", "-2 to 3")
    assert tiny_info.files_of_actuators == {"elbow_reserve": "reserves.xml", "push": "reserves.xml"}
    assert role_of(tiny_info.description, 0) == "reserve"


def test_files_loads_and_times_are_told(tiny_info: ModelInfo) -> None:
    inputs = tiny_info.inputs
    assert inputs is not None
    assert (inputs.n_frames, inputs.initial_time, inputs.final_time, inputs.cutoff) == (71, 0.1, 0.8, 8.0)
    motion, loads = inputs.files
    assert (motion.path.name, motion.n_rows, motion.unit) == ("moving.mot", 101, "radians, by its header")
    assert loads.path.name == "hand.mot"
    (hand,) = inputs.loads
    # 3 N along x and 10 + t N down, at the last frame analyzed
    assert hand.peak_force == pytest.approx(np.hypot(3.0, 10.8))
    assert (hand.body, hand.point, hand.first, hand.last) == ("lower", "lower", 0.1, 0.8)
    assert not inputs.problem
    assert inputs.notes == ()
    assert "no unit is found wrong" in notes(tiny_info)


def test_every_muscle_has_a_row_only_where_asked(tiny_info: ModelInfo) -> None:
    assert table(tiny_info, "3 muscles") == [
        ("Millard2012EquilibriumMuscle", "3", "800 N flexor", "800 N flexor")
    ]
    flexor, wrapped, _ = table(tiny_info, "3 muscles", muscles=True)
    assert flexor[:3] == ("flexor", "Millard2012EquilibriumMuscle", "800")
    assert [part.split()[0] for part in flexor[3].split(", ")] == ["shoulder_z", "elbow_z"]
    arm = 1000 * tiny_model.CYLINDER_RADIUS
    assert wrapped[3] == f"elbow_z -{arm:.0f}"


def test_json_holds_all_of_it_and_html_every_table(tiny_info: ModelInfo) -> None:
    found = json.loads(tiny_info.to_json(), parse_constant=pytest.fail)
    assert found == tiny_info.to_dict()
    assert found["description"]["actuators"][0]["max_control"] == "inf"
    assert found["description"]["body_masses"]["upper"] == tiny_model.UPPER_MASS
    assert found["inputs"]["loads"][0]["name"] == "hand"
    titles = re.findall("<strong>(.*?)</strong>", tiny_info._repr_html_())
    assert titles == [table.title for table in tiny_info.tables()]
    assert len(repr(tiny_info)) < 150
    assert "elbow_z" in str(tiny_info)


def test_a_coupled_column_in_degrees_is_found(tiny: Tiny, tmp_path: Path) -> None:
    time = np.linspace(0.0, 1.0, 101)
    elbow = np.degrees(0.6 + 0.4 * np.sin(2 * np.pi * time))
    columns = {"shoulder_flexion": 0 * time, "elbow_flexion": elbow, "extra": time}
    columns["slide"] = np.radians(tiny_model.SLIDE_PER_RADIAN * elbow)
    wrong = write_motion(tmp_path / "wrong.mot", time, columns)
    setup = tiny.folder / "wrong.xml"
    setup.write_text(setup_text(coordinates_file=str(wrong)), encoding="utf-8")
    found = info(setup)
    assert found.inputs is not None
    assert found.inputs.left_out == ("extra",)
    assert "'slide' is 1/57.3 of what its coupler makes of 'elbow_flexion'" in found.inputs.problem
    assert "cannot be used: wrong.mot: the column" in notes(found)


def test_a_model_alone_needs_no_files_beside_it(tiny: Tiny) -> None:
    found = info(tiny.model)
    assert found.inputs is None
    assert found.stable_rows == ("shoulder_z", "elbow_z")


def test_what_is_not_there_or_no_model_is_refused(tiny: Tiny, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nothing\.osim"):
        info(tmp_path / "nothing.osim")
    with pytest.raises(DataError, match="expected an AnalyzeTool setup"):
        info(tiny.actuators)


def test_walking_says_what_its_column_of_the_patella_is(shared_data: Path) -> None:
    """The motion's columns of patellas are in degrees while its header says radians."""
    found = info(shared_data / "walking3d" / "setup_static_optimization.xml")
    assert found.inputs is not None
    assert found.inputs.missing == ("mtp_angle_r", "mtp_angle_l")
    assert "the column of 'knee_angle_r_beta' is 57.3 times what its coupler makes" in notes(found)
    assert "  --joints walker_knee_r,walker_knee_l --axes x\n" in notes(found)
    roles = {row[1]: row[0] for row in table(found, "Reserves")}
    assert roles["pelvis_tilt_reserve"] == "residual"
    assert roles["knee_angle_r_reserve"] == "reserve"
    assert roles["lumbar_ext"] == "motor"
