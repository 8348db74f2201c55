"""Coordinates that leave the range to which the model clamps them, beside OpenSim's own assembly."""

import logging
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tiny_model import SLIDE_PER_RADIAN, Tiny, ask_opensim, setup_text, write_motion

from scso_nlp.io.storage import read_storage
from scso_nlp.methods import static_optimization
from scso_nlp.opensim.engine import load_motion
from scso_nlp.solver import solve_framewise

pytestmark = pytest.mark.opensim

TIME = np.linspace(0.0, 1.0, 51)
SHOULDER, ELBOW = 0.3 * np.cos(2 * np.pi * TIME), 0.6 + 0.4 * np.sin(2 * np.pi * TIME)
#: Without the slider's column, and with one that agrees to the last bit.
ALONE = {"shoulder_flexion": SHOULDER, "elbow_flexion": ELBOW}
AGREEING = ALONE | {"slide": SLIDE_PER_RADIAN * ELBOW}
LOWEST, HIGHEST = 0.3, 0.8
#: What OpenSim's assembly leaves open, most in the first row that it holds at a bound [rad] or [m].
ASSEMBLY = 1e-4


def clamp(coordinate: str, lowest: float, highest: float) -> Callable[[str], str]:
    """Clamp a coordinate of the small model."""
    tag = f'<Coordinate name="{coordinate}">'
    inside = (
        f"<default_value>{(lowest + highest) / 2}</default_value><range>{lowest} {highest}</range>"
        "<clamped>true</clamped>"
    )
    return lambda text: text.replace(tag, tag + inside)


CLAMPED_ELBOW = clamp("elbow_flexion", LOWEST, HIGHEST)


def not_enforced(text: str) -> str:
    return CLAMPED_ELBOW(text).replace(
        '<CoordinateCouplerConstraint name="coupling">',
        '<CoordinateCouplerConstraint name="coupling"><isEnforced>false</isEnforced>',
    )


def without_constraints(text: str) -> str:
    return re.sub("<ConstraintSet.*?</ConstraintSet>", "", CLAMPED_ELBOW(text), flags=re.DOTALL)


def write_case(
    tiny: Tiny, columns: dict[str, np.ndarray], change: Callable[[str], str], **settings: str
) -> Path:
    """Write the small case with other columns and another model; return the setup."""
    tiny.model.write_text(change(tiny.model.read_text()))
    write_motion(tiny.moving, TIME, columns)
    settings = {"external_loads_file": "", "lowpass_cutoff_frequency_for_coordinates": "-1"} | settings
    tiny.setup.write_text(setup_text(**settings))
    return tiny.setup


def warnings_of(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize(
    ("columns", "change", "cutoff"),
    [
        pytest.param(ALONE, CLAMPED_ELBOW, "-1", id="held at the bound"),
        pytest.param(AGREEING, CLAMPED_ELBOW, "-1", id="where OpenSim gives up it keeps the column"),
        pytest.param(AGREEING, CLAMPED_ELBOW, "8", id="filtered, so padded"),
        pytest.param(AGREEING, clamp("shoulder_flexion", -0.1, 0.2), "-1", id="touched by no constraint"),
        pytest.param(AGREEING, clamp("slide", 0.006, 0.016), "-1", id="a coupled one pulls the other"),
        pytest.param(AGREEING, not_enforced, "-1", id="the constraint need not be enforced"),
        pytest.param(AGREEING, without_constraints, "-1", id="but there must be one"),
    ],
)
def test_a_clamped_coordinate_that_leaves_its_range_has_opensims_values(
    columns: dict[str, np.ndarray],
    change: Callable[[str], str],
    cutoff: str,
    tiny: Tiny,
    caplog: pytest.LogCaptureFixture,
) -> None:
    setup = write_case(tiny, columns, change, lowpass_cutoff_frequency_for_coordinates=cutoff)
    trajectory = load_motion(setup, processes=1).trajectory
    theirs = ask_opensim(tiny.folder, kind="assembled", setup=setup, coordinates=trajectory.coordinates)
    np.testing.assert_array_equal(trajectory.coordinate_values, theirs["values"])
    is_said = any("the values of OpenSim's assembly are taken" in text for text in caplog.messages)
    assert is_said == (change is not without_constraints)


def test_what_the_filter_resamples_is_assembled_with_opensims_own_bits(tiny: Tiny) -> None:
    """The optimizer enlarges rounding errors of its goals, and those of uneven steps pass a spline too."""
    setup = write_case(tiny, AGREEING, CLAMPED_ELBOW, lowpass_cutoff_frequency_for_coordinates="8")
    write_motion(tiny.moving, TIME + 0.004 * np.sin(40 * TIME), AGREEING)
    found = load_motion(setup, processes=1).trajectory
    theirs = ask_opensim(tiny.folder, kind="assembled", setup=setup, coordinates=found.coordinates)
    np.testing.assert_array_equal(found.coordinate_values, theirs["values"])
    assert np.abs(found.coordinate_values[:, 1] - HIGHEST).min() < ASSEMBLY


def test_states_are_assembled_as_they_are_analyzed(tiny: Tiny) -> None:
    setup = write_case(tiny, ALONE, CLAMPED_ELBOW, coordinates_file="", states_file="states.sto")
    states = {}
    for name, joint in (("shoulder_flexion", "shoulder"), ("elbow_flexion", "elbow")):
        states[f"/jointset/{joint}/{name}/value"] = ALONE[name]
        states[f"/jointset/{joint}/{name}/speed"] = np.gradient(ALONE[name], TIME)
    write_motion(tiny.folder / "states.sto", TIME, states)
    found = load_motion(setup, processes=1).trajectory
    theirs = ask_opensim(tiny.folder, kind="assembled", setup=setup, coordinates=found.coordinates)
    np.testing.assert_array_equal(found.coordinate_values, theirs["values"])
    assert np.abs(found.coordinate_values[:, 1] - HIGHEST).min() < ASSEMBLY


def test_what_a_states_file_leaves_out_has_its_default(tiny: Tiny, caplog: pytest.LogCaptureFixture) -> None:
    tag = '<Coordinate name="elbow_flexion">'
    tiny.model.write_text(tiny.model.read_text().replace(tag, f"{tag}<default_value>0.4</default_value>"))
    shoulder = "/jointset/shoulder/shoulder_flexion"
    states = {
        f"{shoulder}/value": SHOULDER,
        f"{shoulder}/speed": 0 * TIME,
        "/jointset/elbow/elbow_flexion/speed": 0,
    }
    write_motion(tiny.folder / "states.sto", TIME, states)
    with caplog.at_level(logging.INFO, "scso_nlp"):
        found = load_motion(
            model=tiny.model, states=tiny.folder / "states.sto", held_coordinates="elbow_flexion", processes=1
        ).trajectory
    assert any("held at its default value as asked" in text for text in caplog.messages)
    tiny.setup.write_text(
        setup_text(
            coordinates_file="",
            states_file="states.sto",
            initial_time="0",
            final_time="1",
            external_loads_file="",
        )
    )
    theirs = ask_opensim(tiny.folder, kind="assembled", setup=tiny.setup, coordinates=found.coordinates)[
        "values"
    ]
    np.testing.assert_allclose(found.coordinate_values, theirs, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.coordinate_values[:, 1], 0.4, rtol=0, atol=1e-8)


def test_what_assembly_changes_is_said_once(tiny: Tiny, caplog: pytest.LogCaptureFixture) -> None:
    setup = write_case(tiny, ALONE, CLAMPED_ELBOW)
    found = load_motion(setup, initial_time=0.1, final_time=0.5, processes=2).trajectory
    held = np.clip(ELBOW, LOWEST, HIGHEST)[5:26]
    np.testing.assert_allclose(found.coordinate_values[:, 1], held, rtol=0, atol=ASSEMBLY)
    count = int((ELBOW[5:26] > HIGHEST).sum())
    (text,) = (text for text in warnings_of(caplog) if "clamps" in text)
    assert text.startswith(
        f"{tiny.moving}: in {count} of 21 rows coordinates leave the ranges to which the model clamps them "
        "(elbow_flexion); the values of OpenSim's assembly are taken, which changes "
    )
    assert f"most 'elbow_flexion' by {ELBOW[5:26].max() - HIGHEST:.3g} rad at t = " in text
    assert text.endswith("; speeds stay those of the motion")
    # the elbow is held, its column's speed stays
    assert np.abs(found.coordinate_speeds[found.coordinate_values[:, 1] > HIGHEST - ASSEMBLY, 1]).max() > 1.0


def test_columns_that_contradict_their_coupler_do_not_pull_the_others(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    """OpenSim's assembly has no goal for coupled coordinates, so there is no compromise."""
    strong = 0.5
    setup = write_case(
        tiny,
        ALONE | {"slide": 0.3 - 0.5 * TIME},
        lambda text: text.replace(f"<coefficients>{SLIDE_PER_RADIAN} 0", f"<coefficients>{strong} 0"),
    )
    found = load_motion(setup, processes=1).trajectory
    names = (*found.coordinates, "slide")
    theirs = ask_opensim(tiny.folder, kind="assembled", setup=setup, coordinates=names)["values"]
    np.testing.assert_allclose(found.coordinate_values, theirs[:, :2], rtol=0, atol=1e-8)
    np.testing.assert_allclose(theirs[:, 2], strong * theirs[:, 1], rtol=0, atol=1e-8)
    apart = np.abs(0.3 - 0.5 * TIME - strong * ELBOW)[5:41]
    row = int(apart.argmax())
    (text,) = (text for text in warnings_of(caplog) if "ask for" in text)
    most = f"'slide' by {apart[row]:.3g} m at t = {TIME[5 + row]:.9g} s"
    assert text == (
        f"{tiny.moving}: in {(apart > 1e-3).sum()} of 36 rows the columns of slide are not what their "
        f"couplers ask for, most {most}: the couplers' values are taken, as in OpenSim"
    )


def prescribed(text: str) -> str:
    """Prescribe the slider: as its column says at no time, and faster and faster."""
    tag = '<Coordinate name="slide">'
    function = """<prescribed_function><PolynomialFunction><coefficients>0.1 0.2 0</coefficients>
        </PolynomialFunction></prescribed_function><prescribed>true</prescribed>"""
    return text.replace(tag, tag + function)


@pytest.mark.parametrize(
    ("columns", "change"),
    [
        pytest.param(ALONE, CLAMPED_ELBOW, id="held"),
        pytest.param(AGREEING, CLAMPED_ELBOW, id="held in some rows"),
        pytest.param(AGREEING, lambda text: prescribed(without_constraints(text)), id="prescribed"),
    ],
)
def test_static_optimization_in_assembled_poses_is_opensims(
    columns: dict[str, np.ndarray], change: Callable[[str], str], tiny: Tiny
) -> None:
    setup = write_case(tiny, columns, change)
    motion = load_motion(setup)
    ours = solve_framewise(static_optimization(motion))
    results = tiny.folder / "results"
    ask_opensim(tiny.folder, kind="static optimization", setup=setup, results=results, criterion=1e-9)
    theirs = read_storage(next(results.glob("*_activation.sto")))
    # both are optimal within 1e-6
    np.testing.assert_allclose(
        np.hstack([ours.activation, ours.control]),
        theirs.columns(motion.trajectory.muscles + motion.trajectory.actuators),
        rtol=0,
        atol=1e-4,
    )


@pytest.mark.parametrize("processes", [1, 2])
def test_everything_about_a_held_pose_is_that_of_a_motion_that_stands_there(
    processes: int, tiny: Tiny
) -> None:
    """Derivatives along coordinates and virtual rotations too: they start from the held pose."""
    options = {
        "keep_coupled_speeds": False,
        "stability_axes": (("elbow", "z"),),
        "curvature_coordinates": ("all",),
        "processes": processes,
    }
    setup = write_case(tiny, ALONE, CLAMPED_ELBOW)
    held = load_motion(setup, initial_time=0.15, final_time=0.35, **options).trajectory
    assert (np.abs(held.coordinate_values[:, 1] - HIGHEST) < ASSEMBLY).all()
    # dependent speeds follow the held coordinate's
    rate = -np.einsum("kcm,kc->km", held.moment_arms, held.coordinate_speeds)
    np.testing.assert_allclose(held.muscle_tendon_velocity, rate, rtol=0, atol=1e-12)
    values = {name: column.copy() for name, column in ALONE.items()}
    rows = np.isin(TIME, held.time)
    for name, column in zip(held.coordinates, held.coordinate_values.T, strict=True):
        values[name][rows] = column
    setup.write_text(setup.read_text().replace("moving.mot", "standing.mot"))
    write_motion(tiny.folder / "standing.mot", TIME, values)
    there = load_motion(setup, initial_time=0.15, final_time=0.35, **options).trajectory
    np.testing.assert_allclose(held.moment_arms, there.moment_arms, rtol=0, atol=1e-8)
    assert held.curvature is not None
    assert there.curvature is not None
    for one, other in (
        (held.curvature.path_curvature, there.curvature.path_curvature),
        (held.skeleton.virtual_moment_arms, there.skeleton.virtual_moment_arms),
        (held.skeleton.virtual_curvature, there.skeleton.virtual_curvature),
    ):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-7)


def test_derivatives_at_a_pose_that_assembly_left_open_keep_what_is_open(tiny: Tiny) -> None:
    """The same pose with the same derivatives, but no constraint open, by a coupler with an offset."""
    closed = tiny.model.read_text()
    setup = write_case(tiny, AGREEING, clamp("slide", 0.006, 0.016), initial_time="0.24", final_time="0.26")
    left_open = load_motion(setup, curvature_coordinates="all", processes=1).trajectory
    names = (*left_open.coordinates, "slide")
    shoulder, elbow, slide = ask_opensim(tiny.folder, kind="assembled", setup=setup, coordinates=names)[
        "values"
    ][1].tolist()
    offset = slide - SLIDE_PER_RADIAN * elbow
    assert abs(offset) > ASSEMBLY
    tiny.model.write_text(
        closed.replace(
            f"<coefficients>{SLIDE_PER_RADIAN} 0<", f"<coefficients>{SLIDE_PER_RADIAN} {offset!r}<"
        )
    )
    write_motion(tiny.moving, TIME, {"shoulder_flexion": shoulder, "elbow_flexion": elbow})
    there = load_motion(setup, curvature_coordinates="all", processes=1).trajectory
    np.testing.assert_allclose(left_open.coordinate_values[1], there.coordinate_values[1], rtol=0, atol=1e-12)
    assert left_open.curvature is not None
    assert there.curvature is not None
    np.testing.assert_allclose(left_open.moment_arms[1], there.moment_arms[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        left_open.curvature.path_curvature[1], there.curvature.path_curvature[1], rtol=0, atol=1e-8
    )
