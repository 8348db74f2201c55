"""Times and units of motions: cut, read and checked as OpenSim means them."""

import logging
import math
import re
from pathlib import Path

import numpy as np
import pytest
from tiny_model import SLIDE_PER_RADIAN, Tiny, setup_text, write_motion

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.setup_xml import MotionInput, read_analyze_setup

pytestmark = pytest.mark.opensim

TIME = np.linspace(0.0, 1.0, 101)
#: Angles of low order, so that the spline's speeds are exact away from its natural ends.
SHOULDER, ELBOW = 0.2 + 0.3 * TIME - 0.2 * TIME**2, 0.5 + 0.4 * TIME**2
VALUES = {"shoulder_flexion": SHOULDER, "elbow_flexion": ELBOW, "slide": SLIDE_PER_RADIAN * ELBOW}
SPEEDS = {
    "shoulder_flexion_u": 0.3 - 0.4 * TIME,
    "elbow_flexion_u": 0.8 * TIME,
    "slide_u": SLIDE_PER_RADIAN * 0.8 * TIME,
}
MIDDLE = {"initial_time": 0.4, "final_time": 0.6, "processes": 1}


def in_degrees(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Angles in degrees; the slider stays in meters."""
    return {name: v if name.startswith("slide") else np.rad2deg(v) for name, v in columns.items()}


def write(path: Path, columns: dict[str, np.ndarray], header: str = "inDegrees=no\n") -> Path:
    write_motion(path, TIME, columns)
    path.write_text(path.read_text().replace("inDegrees=no\n", header))
    return path


def warnings_of(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


# Units of speeds ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "header", "told"),
    [
        ("u.sto", "inDegrees=yes\n", None),
        ("u.mot", "inDegrees=yes\n", None),
        ("u.sto", "inDegrees=no\n", True),
        ("u.sto", "", True),
    ],
)
def test_speeds_in_degrees_give_the_forces_of_speeds_in_radians(
    name: str, header: str, told: bool | None, tiny: Tiny
) -> None:
    motion = write(tiny.folder / "m.mot", in_degrees(VALUES), "inDegrees=yes\n")
    common = {"model": tiny.model, "coordinates": motion, **MIDDLE}
    radians = load_motion(speeds=write(tiny.folder / "radians.sto", SPEEDS), **common).trajectory
    degrees = load_motion(
        speeds=write(tiny.folder / name, in_degrees(SPEEDS), header), speeds_in_degrees=told, **common
    ).trajectory
    derived = load_motion(**common).trajectory
    at = slice(40, 61)
    np.testing.assert_allclose(
        degrees.coordinate_speeds, np.stack([0.3 - 0.4 * TIME[at], 0.8 * TIME[at]], axis=1), atol=1e-14
    )
    np.testing.assert_allclose(degrees.generalized_forces, radians.generalized_forces, atol=1e-12)
    np.testing.assert_allclose(degrees.generalized_forces, derived.generalized_forces, atol=1e-3)


def test_an_old_mot_of_speeds_is_in_degrees_as_one_of_coordinates(tiny: Tiny) -> None:
    motion = write(tiny.folder / "m.mot", VALUES)
    speeds = write(tiny.folder / "u.mot", in_degrees(SPEEDS), "")
    speeds.write_text(speeds.read_text().replace("version=1\n", ""))
    found = load_motion(model=tiny.model, coordinates=motion, speeds=speeds, **MIDDLE).trajectory
    np.testing.assert_allclose(found.coordinate_speeds[:, 1], 0.8 * TIME[40:61], atol=1e-14)


@pytest.mark.parametrize("header_is_wrong", ["speeds", "coordinates"])
def test_speeds_proven_to_be_in_another_unit_are_refused_until_told(
    header_is_wrong: str, tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    # without the slider's column, whose coupler would prove the same
    angles = {name: VALUES[name] for name in ("shoulder_flexion", "elbow_flexion")}
    if header_is_wrong == "speeds":
        motion, speeds = write(tiny.folder / "m.sto", angles), in_degrees(SPEEDS)
        times, mend = "57.3 times", {"speeds_in_degrees": True}
    else:
        motion, speeds = write(tiny.folder / "m.sto", in_degrees(angles)), SPEEDS
        times, mend = "1/57.3 of", {"in_degrees": True}
    given = write(tiny.folder / "u.sto", speeds)
    common = {"model": tiny.model, "coordinates": motion, "speeds": given, **MIDDLE}
    with pytest.raises(DataError) as failure:
        load_motion(**common)
    assert str(failure.value) == (
        f"{given}: read in radians per second, its speeds are {times} the derivative of the coordinates in "
        f"{motion}, read in radians, so one of the units is wrong: speeds_in_degrees = true reads the speeds "
        "the other way, in_degrees = true the coordinates; speeds_in_degrees = false takes them as they are"
    )
    mended = load_motion(**common, **mend).trajectory
    np.testing.assert_allclose(mended.coordinate_values[:, 1], ELBOW[40:61], atol=1e-12)
    np.testing.assert_allclose(mended.coordinate_speeds[:, 1], 0.8 * TIME[40:61], atol=1e-12)
    caplog.clear()
    as_told = load_motion(**common, speeds_in_degrees=False).trajectory
    assert any("taken so, as asked" in text for text in warnings_of(caplog))
    np.testing.assert_allclose(as_told.coordinate_speeds[:, 1], speeds["elbow_flexion_u"][40:61], atol=1e-12)


@pytest.mark.parametrize("factor", [1.0, 56.0, 58.6, -57.3, 0.0])
def test_speeds_that_differ_by_another_factor_are_taken(factor: float, tiny: Tiny) -> None:
    speeds = write(tiny.folder / "u.sto", {name: factor * v for name, v in SPEEDS.items()})
    motion = write(tiny.folder / "m.sto", VALUES)
    found = load_motion(model=tiny.model, coordinates=motion, speeds=speeds, **MIDDLE).trajectory
    np.testing.assert_allclose(found.coordinate_speeds[:, 1], factor * 0.8 * TIME[40:61], atol=1e-12)


# Units of coupled columns -------------------------------------------------------------------------


def test_a_coupled_translation_proves_the_unit_of_the_angles(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    right = load_motion(
        model=tiny.model, coordinates=write(tiny.folder / "right.sto", VALUES), **MIDDLE
    ).trajectory
    motion = write(tiny.folder / "m.sto", in_degrees(VALUES))
    common = {"model": tiny.model, "coordinates": motion, **MIDDLE}
    with pytest.raises(DataError) as failure:
        load_motion(**common)
    assert str(failure.value) == (
        f"{motion}: the column of 'slide' is 1/57.3 of what its coupler makes of 'elbow_flexion', read in "
        "radians, so the unit is wrong: in_degrees = true reads the angles the other way, in_degrees = false "
        "takes them as they are"
    )
    mended = load_motion(**common, in_degrees=True).trajectory
    np.testing.assert_allclose(mended.generalized_forces, right.generalized_forces, atol=1e-9)
    caplog.clear()
    as_told = load_motion(**common, in_degrees=False).trajectory
    assert any("taken so, as asked" in text for text in warnings_of(caplog))
    np.testing.assert_allclose(as_told.coordinate_values[:, 1], np.rad2deg(ELBOW[40:61]), atol=1e-9)


@pytest.mark.parametrize("factor", [180 / np.pi, np.pi / 180])
def test_a_coupled_angle_in_another_unit_than_its_partner_is_reported(
    factor: float, tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    """Only this column is wrong, so no unit of the whole file mends it."""
    tiny.model.write_text(tiny.model.read_text().replace("SliderJoint", "PinJoint"))
    motion = write(tiny.folder / "m.sto", VALUES | {"slide": factor * VALUES["slide"]})
    load_motion(model=tiny.model, coordinates=motion, keep_coupled_speeds=False, **MIDDLE)
    times = "57.3 times" if factor > 1 else "1/57.3 of"
    (message,) = (text for text in warnings_of(caplog) if "coupler makes of" in text)
    assert message == (
        f"{motion}: the column of 'slide' is {times} what its coupler makes of 'elbow_flexion': its unit is "
        "wrong; take the column out"
    )
    caplog.clear()
    load_motion(model=tiny.model, coordinates=motion, **MIDDLE)
    assert any(text.endswith(", or set keep_coupled_speeds = false") for text in warnings_of(caplog))


def test_a_coupled_column_that_agrees_is_not_worth_a_word(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    load_motion(model=tiny.model, coordinates=write(tiny.folder / "m.sto", VALUES), **MIDDLE)
    assert warnings_of(caplog) == []


# Time ranges --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("initial", "final", "rows", "taken"),
    [
        (0.8, 1.01, slice(80, 101), "0.8 to 1.01 s, 0.8 to 1 s is taken"),
        (0.9, 7.0, slice(90, 101), "0.9 to 7 s, 0.9 to 1 s is taken"),
        (-0.4, 0.1, slice(0, 11), "-0.4 to 0.1 s, 0 to 0.1 s is taken"),
        (-1.0, 2.0, slice(0, 101), "-1 to 2 s, 0 to 1 s is taken"),
        (-math.inf, math.inf, slice(0, 101), None),
        (0.75, math.inf, slice(75, 101), None),
        (-math.inf, 0.05, slice(0, 6), None),
        (None, None, slice(10, 81), None),  # the setup's own
        (0.0, 1.004, slice(0, 101), None),
    ],
)
def test_a_time_range_is_cut_to_the_motion(
    initial: float, final: float, rows: slice, taken: str | None, tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    found = load_motion(
        tiny.setup, initial_time=initial, final_time=final, lowpass_cutoff_frequency=-1, processes=1
    ).trajectory
    np.testing.assert_array_equal(found.time, TIME[rows])
    start = f"{tiny.moving} covers 0 to 1 s: of the time range asked for, "
    assert warnings_of(caplog) == ([] if taken is None else [start + taken])


def test_a_cut_range_of_a_filtered_motion_is_the_whole_motion(tiny: Tiny) -> None:
    """OpenSim would run on into what the filter mirrors at the ends."""
    whole = load_motion(tiny.setup, initial_time=-math.inf, final_time=math.inf, processes=1).trajectory
    cut = load_motion(tiny.setup, initial_time=-0.4, final_time=1.4, processes=1).trajectory
    np.testing.assert_array_equal(cut.time, whole.time)
    np.testing.assert_array_equal(cut.generalized_forces, whole.generalized_forces)


def test_a_setup_without_times_takes_the_first_second_as_opensim_does(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    t = np.linspace(-0.5, 0.25, 76)
    write_motion(tiny.moving, t, {"shoulder_flexion": 0.1 * t, "elbow_flexion": 0.2 + 0 * t})
    text = setup_text(external_loads_file="", lowpass_cutoff_frequency_for_coordinates="-1")
    for name, value in (("initial_time", "0.1"), ("final_time", "0.8")):
        text = text.replace(f"<{name}>{value}</{name}>", "")
    tiny.setup.write_text(text)
    with caplog.at_level(logging.INFO, "scso_nlp"):
        found = load_motion(read_analyze_setup(tiny.setup), processes=1).trajectory
    np.testing.assert_allclose(found.time, t[t > -0.005], atol=0)
    assert any("the range is 0 to 1 s, as OpenSim takes" in text for text in caplog.messages)
    assert warnings_of(caplog) == [
        f"{tiny.moving} covers -0.5 to 0.25 s: of the time range asked for, 0 to 1 s, 0 to 0.25 s is taken"
    ]


def test_infinite_times_are_the_whole_motion_in_setups_too(tiny: Tiny) -> None:
    tiny.setup.write_text(setup_text(initial_time="-Infinity", final_time="Inf"))
    motion = read_analyze_setup(tiny.setup).motion
    assert (motion.initial_time, motion.final_time) == (None, None)


@pytest.mark.parametrize(
    ("initial", "final"), [(2.0, 3.0), (-2.0, -1.0), (math.inf, math.inf), (-math.inf, -math.inf)]
)
def test_a_time_range_beside_the_motion_is_refused(initial: float, final: float, tiny: Tiny) -> None:
    with pytest.raises(DataError, match=r"is outside .*moving\.mot, which covers 0 to 1 s; give") as failure:
        load_motion(tiny.setup, initial_time=initial, final_time=final)
    assert "\n" not in str(failure.value)


def test_a_range_of_infinite_ends_equals_none() -> None:
    one = MotionInput(model="a", coordinates="b", initial_time=-math.inf, final_time=math.inf)  # type: ignore[arg-type]
    assert one == MotionInput(model="a", coordinates="b")  # type: ignore[arg-type]


# Rows that are nearly one -------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["end", "start", "middle"])
def test_rows_a_rounding_error_apart_are_one_row(
    where: str, tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    """The filter resamples to the smallest step, so OpenSim itself would not end."""
    expected = load_motion(tiny.setup, processes=1).trajectory
    lines = tiny.moving.read_text().splitlines()
    first = len(lines) - len(TIME)
    k = {"end": 100, "start": 0, "middle": 50}[where]
    time, rest = lines[first + k].split("\t", 1)
    lines[first + k : first + k + 1] = [f"{time}\t9\t9\t9", f"{float(time) + 3e-13!r}\t{rest}"]
    tiny.moving.write_text("\n".join(lines) + "\n")
    caplog.clear()
    found = load_motion(tiny.setup, processes=1).trajectory
    np.testing.assert_array_equal(found.time, expected.time)
    np.testing.assert_array_equal(found.generalized_forces, expected.generalized_forces)
    said = (
        f"1 row(s) have the time of the next row, first at t = {float(time)} s; the last of each time is kept"
    )
    assert any(text.endswith(said) for text in warnings_of(caplog))


def test_a_step_too_small_for_the_filter_is_refused(tiny: Tiny) -> None:
    t = np.sort(np.append(TIME, 0.5 + 1e-6))
    write_motion(tiny.moving, t, {"shoulder_flexion": 0.1 * t, "elbow_flexion": 0.2 * t})
    with pytest.raises(DataError) as failure:
        load_motion(tiny.setup, processes=1)
    assert str(failure.value) == (
        f"{tiny.moving}: the rows at t = 0.5 s are 1e-06 s apart, expected about the typical step of 0.01 s, "
        "because the low-pass filter resamples to the smallest step (2e+06 rows); take out one of them or "
        "switch the filter off"
    )
    assert load_motion(tiny.setup, lowpass_cutoff_frequency=-1, processes=1).trajectory.n_frames == 72


# Data of external loads ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\t", ","),
        ("nRows=101", "nRows=99999999999"),
        ("nRows=101\nnColumns=7\n", ""),
        ("\thand_vx", "\tunused\thand_vx"),
        ("inDegrees=no", "inDegrees=yes"),
    ],
)
def test_what_is_read_of_the_loads_is_what_opensim_is_given(old: str, new: str, tiny: Tiny) -> None:
    """OpenSim itself refuses commas and wrong counts, and stops without a word at NaN in an unused column."""
    expected = load_motion(tiny.setup, processes=1).trajectory.generalized_forces
    data = tiny.folder / "hand.mot"
    head, rows = data.read_text().replace(old, new).split("hand_pz\n")
    if "unused" in new:
        rows = re.sub(r"^(\S+)\t", r"\1\tnan\t", rows, flags=re.MULTILINE)
    data.write_text(f"{head}hand_pz\n{rows}")
    found = load_motion(tiny.setup, processes=1).trajectory.generalized_forces
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "hand_vx\thand_vy",
            "hand_vy\thand_vx",
            "takes the columns hand_vy, hand_vx, hand_vz .* as x, y and z",
        ),
        ("hand_vx\thand_vy", "hand_vx\thand_vx", "needs three columns that start with 'hand_v', found"),
        (
            "hand_vx\thand_vy",
            "hand_vx N\thand_vy",
            "'hand_vx N', .*; OpenSim splits labels at blanks, rename",
        ),
    ],
)
def test_columns_of_a_load_that_opensim_would_take_for_others_are_refused(
    old: str, new: str, message: str, tiny: Tiny
) -> None:
    data = tiny.folder / "hand.mot"
    data.write_text(data.read_text().replace(old, new))
    with pytest.raises(NameMismatchError, match=message):
        load_motion(tiny.setup)


def test_a_load_on_a_body_that_is_not_there_names_the_model(tiny: Tiny) -> None:
    loads = tiny.loads.read_text()
    tiny.loads.write_text(loads.replace("<point_expressed_in_body>lower", "<point_expressed_in_body>hand"))
    with pytest.raises(NameMismatchError, match=r"^tiny\.osim: an external load names the body 'hand'"):
        load_motion(tiny.setup, processes=1)


@pytest.mark.parametrize("name", ["moving.mot", "hand.mot"])
def test_a_table_of_times_alone_is_refused(name: str, tiny: Tiny) -> None:
    write_motion(tiny.folder / name, TIME, {})
    with pytest.raises(DataError, match=rf"{name} has no columns but time"):
        load_motion(tiny.setup)


# Millimetres --------------------------------------------------------------------------------------


def in_millimetres(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: 1000 * v if name.startswith("slide") else v for name, v in columns.items()}


def test_a_coupled_column_in_millimetres_is_refused_unless_its_speeds_are_not_used(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    motion = write(tiny.folder / "m.sto", in_millimetres(VALUES))
    common = {"model": tiny.model, "coordinates": motion, **MIDDLE}
    text = (
        f"{motion}: the column of 'slide' is 1000 times what its coupler makes of 'elbow_flexion': one is "
        "in millimetres, OpenSim reads metres"
    )
    with pytest.raises(DataError) as failure:
        load_motion(**common)
    assert str(failure.value).startswith(text)
    found = load_motion(**common, keep_coupled_speeds=False).trajectory
    assert text in warnings_of(caplog)
    true = load_motion(model=tiny.model, coordinates=write(tiny.folder / "t.sto", VALUES), **MIDDLE)
    np.testing.assert_allclose(found.generalized_forces, true.trajectory.generalized_forces, atol=1e-9)


@pytest.mark.parametrize("factor", [1.0, 1.02e3, 1e3])
def test_speeds_in_millimetres_are_refused_where_they_are_proven(tiny: Tiny, factor: float) -> None:
    speeds = write(tiny.folder / "u.sto", SPEEDS | {"slide_u": factor * SPEEDS["slide_u"]})
    motion = write(tiny.folder / "m.sto", VALUES)
    common = {"model": tiny.model, "coordinates": motion, "speeds": speeds, **MIDDLE}
    if factor != 1e3:
        load_motion(**common)
        return
    with pytest.raises(DataError, match="the speeds of slide are 1000 times the derivative"):
        load_motion(**common)


@pytest.mark.parametrize(("column", "name"), [("p", "points"), ("m", "torque"), ("", "")])
def test_loads_that_are_only_plausible_in_millimetres_are_reported(
    tiny: Tiny, caplog: pytest.LogCaptureFixture, column: str, name: str
) -> None:
    """A hand's load of 10 N with a moment of 0.5 N·m, on a body of 3.6 kg and 0.6 m."""
    vectors = {"v": (3.0, -10.0, 0.0), "p": (0.01, -0.2, 0.0), "m": (0.0, 0.0, 0.5)}
    columns = {
        f"hand_{kind}{axis}": np.full(101, value * (1000 if kind == column else 1))
        for kind, vector in vectors.items()
        for axis, value in zip("xyz", vector, strict=True)
    }
    write_motion(tiny.folder / "hand.mot", TIME, columns)
    text = tiny.loads.read_text()
    assert "<torque_identifier></torque_identifier>" in text
    tiny.loads.write_text(text.replace("<torque_identifier>", "<torque_identifier>hand_m"))
    load_motion(tiny.setup, processes=1)
    found = [text for text in warnings_of(caplog) if "divide" in text]
    if not column:
        assert found == []
        return
    (message,) = found
    expected = {
        "points": r"hand acts [\d.]+ m away from lower, .* are its points in millimetres",
        "torque": r"the torque of hand is up to 500 N·m, more than its force .* is it in N·mm",
    }[name]
    assert re.search(expected, message)


def floating(tiny: Tiny, *, is_reversed: bool) -> None:
    """Let the shoulder shift too."""
    text = tiny.model.read_text()
    joint = text[text.index('<PinJoint name="shoulder"') : text.index('<PinJoint name="elbow"')]
    changed = joint.replace("PinJoint", "PlanarJoint").replace(
        "</coordinates>", '<Coordinate name="shift_x"/><Coordinate name="shift_y"/></coordinates>'
    )
    if is_reversed:
        parents = "<socket_parent_frame>from</socket_parent_frame><socket_child_frame>to</socket_child_frame>"
        assert parents in changed
        changed = changed.replace(
            parents, parents.replace("from", "x").replace("to<", "from<").replace("x<", "to<")
        )
    tiny.model.write_text(text.replace(joint, changed))


@pytest.mark.parametrize("is_reversed", [False, True])
def test_a_base_floats_by_the_joint_that_turns_and_shifts_against_ground(
    tiny: Tiny, caplog: pytest.LogCaptureFixture, is_reversed: bool
) -> None:
    assert load_motion(tiny.setup, processes=1).trajectory.base_coordinates == ()
    floating(tiny, is_reversed=is_reversed)
    base = ("shoulder_flexion", "shift_x", "shift_y")
    height = {"shift_x": 0.5 * TIME, "shift_y": 0.9 + 0 * TIME}
    for factor in (1, 1000):
        motion = write(tiny.folder / "m.sto", VALUES | {n: factor * v for n, v in height.items()})
        caplog.clear()
        found = load_motion(model=tiny.model, coordinates=motion, **MIDDLE).trajectory
        assert found.base_coordinates == base
        said = [text for text in warnings_of(caplog) if "is it in millimetres?" in text]
        assert [text.split()[1] for text in said] == ([] if factor == 1 else ["shift_x", "shift_y"])
