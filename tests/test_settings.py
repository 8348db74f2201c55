"""Settings files: every key is read, every mistake is one sentence."""

import math
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from scso_nlp.constraints import CoordinateStability, HessianStability, JointStability
from scso_nlp.examples import example_folder, example_names
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError, ProblemError
from scso_nlp.muscle_models.stiffness_law import FiberStiffness, ShortRangeStiffness
from scso_nlp.opensim.setup_xml import MotionInput
from scso_nlp.settings import KEYS, read_settings, template

SPINE = example_folder("spine-load-height")


def settings_file(folder: Path, text: str) -> Path:
    path = folder / "scso.toml"
    path.write_text(text, encoding="utf-8")
    return path


def with_setup(folder: Path, text: str = "") -> Path:
    return settings_file(folder, f"setup = '{SPINE / 'setup.xml'}'\n{text}")


def test_a_plain_setup_file_is_static_optimization_as_the_setup_says():
    settings, output = read_settings(SPINE / "setup.xml")
    assert settings.stability is None
    assert settings.exponent == 2.0
    assert settings.muscle_physiology is False
    assert settings.motion.name == "spine_load_height"
    assert settings.analysis_name == "StaticOptimization"
    assert settings.sources == (SPINE / "setup.xml",)
    assert output.folder is None


def test_the_template_is_accepted_once_the_setup_path_is_filled_in(tmp_path):
    text = template().replace('setup = "setup.xml"', f"setup = '{SPINE / 'setup.xml'}'")
    settings, _ = read_settings(settings_file(tmp_path, text))
    assert settings.stability == JointStability(q=5.0, level=0.0)


def test_every_line_of_the_template_is_a_known_setting_with_a_readable_example():
    names = []
    for line in template().splitlines():
        content = line.removeprefix("# ")
        name, equals, _ = content.partition(" = ")
        if equals and name in KEYS:
            value = tomllib.loads(content)[name]
            KEYS[name].read(value)
            names.append(name)
    assert names == list(KEYS)


def test_every_property_of_a_motion_has_a_setting_but_those_the_run_fills_in_itself():
    filled_in = {"stability_axes", "curvature_coordinates"}
    assert {item.name for item in fields(MotionInput)} - KEYS.keys() == filled_in


def test_all_settings_arrive(tmp_path):
    path = with_setup(
        tmp_path,
        """
        name = "trunk"
        final_time = 4.0
        exponent = inf
        muscle_physiology = true
        weights = { "ES*" = 2.0 }
        stability = "potvin-brown"
        q = { "*" = 5, "RA_*" = 10.0 }
        level = { "lumbar_pelvis_z" = 3.0 }
        joints = ["lumbar_pelvis"]
        axes = ["z"]
        moving_paths = "frozen"
        solver = "framewise"
        tolerance = 1e-6
        max_iterations = 50
        output = "out"
        keep_failed = true
        figures = false
        processes = 1
        cache = "stored"
        """,
    )
    settings, output = read_settings(path)
    assert (settings.motion.name, settings.motion.final_time) == ("trunk", 4.0)
    assert settings.exponent == math.inf
    assert settings.muscle_physiology is True
    assert settings.weights == {"ES*": 2.0}
    assert settings.stability == JointStability(
        q={"*": 5.0, "RA_*": 10.0},
        level={"lumbar_pelvis_z": 3.0},
        joints=("lumbar_pelvis",),
        axes=("z",),
        moving_paths="frozen",
    )
    assert settings.solver == "framewise"
    assert (settings.options.tolerance, settings.options.max_iterations) == (1e-6, 50)
    assert (output.folder, output.cache) == (tmp_path / "out", tmp_path / "stored")
    assert (output.keep_failed, output.figures, output.processes) == (True, False, 1)
    assert settings.sources == (path, SPINE / "setup.xml")


def test_stability_along_coordinates_is_described_likewise(tmp_path):
    text = """
        stability = "diagonal"
        stability_coordinates = ["knee_angle_r"]
        stiffness = "short-range"
        level = 2.0
        passive = { "knee_angle_r" = 5.0 }
        soft = 0.5
        keep_coupled_speeds = false
    """
    settings, _ = read_settings(with_setup(tmp_path, text))
    assert settings.stability == CoordinateStability(
        coordinates=("knee_angle_r",),
        stiffness=ShortRangeStiffness(),
        level=2.0,
        passive_stiffness={"knee_angle_r": 5.0},
        soft=0.5,
    )
    assert settings.motion.keep_coupled_speeds is False
    settings, _ = read_settings(with_setup(tmp_path, 'stability = "full"\nstiffness = "fiber"'))
    assert settings.stability == HessianStability(stiffness=FiberStiffness())


def test_passive_stiffness_comes_from_a_table_or_a_matrix(tmp_path):
    (tmp_path / "passive.toml").write_text("a = 3\nb = 4.5\n")
    (tmp_path / "passive.csv").write_text("a, b\n3, -1\n-1, 4.5\n")
    by_row, _ = read_settings(with_setup(tmp_path, "stability = 'diagonal'\npassive = 'passive.toml'"))
    assert by_row.stability.passive_stiffness == {"a": 3.0, "b": 4.5}
    (tmp_path / "lumbar.toml").write_text(
        "a = 3\n[[lumbar]]\nlevels = 3\naxial = 'y'\nflexion = ['z']\n"
        "[[lumbar]]\nlevels = 2\nlateral = ['x']\n"
    )
    published, _ = read_settings(with_setup(tmp_path, "stability = 'full'\npassive = 'lumbar.toml'"))
    # N·m/deg of one level, over the number of levels
    expected = {"a": 3.0, "y": math.degrees(8.4 / 3), "z": math.degrees(1.8 / 3), "x": math.degrees(2.3 / 2)}
    assert published.stability.passive_stiffness == pytest.approx(expected)
    text = "stability = 'full'\npassive = 'passive.csv'\n"
    coupled, _ = read_settings(with_setup(tmp_path, text))
    assert coupled.stability.coordinates == ("a", "b")
    assert coupled.stability.passive_matrix.tolist() == [[3, -1], [-1, 4.5]]
    text += 'stability_coordinates = ["b", "c", "a"]'
    coupled, _ = read_settings(with_setup(tmp_path, text))
    assert coupled.stability.passive_matrix.tolist() == [[4.5, 0, -1], [0, 0, 0], [-1, 0, 3]]


@pytest.mark.parametrize(
    ("name", "content", "error", "message"),
    [
        ("p.csv", "a,b\n1,2\n3\n", FileFormatError, "expected a line of coordinates, then lines of numbers"),
        ("p.csv", "a,b\n1,2\n", DataError, r"passive_matrix has shape \(1, 2\), expected \(2, 2\)"),
        ("p.csv", "a,b\n1,2\n3,1\n", DataError, r"is not symmetric: 2 at \(a, b\)"),
        ("p.csv", "a,a\n1,2\n2,1\n", DataError, "must be unique"),
        ("p.csv", "a\none\n", FileFormatError, "expected a line of coordinates"),
        ("p.toml", "a = 'stiff'", DataError, "expected lines of the form row = number"),
        ("p.toml", "[[lumbar]]\naxial = ['a']", DataError, r"tables \[\[lumbar\]\] with levels"),
        ("p.toml", "[[lumbar]]\nlevels = 2\nup = ['a']", DataError, "direction of 'a' is 'up'"),
        ("p.toml", "a = 1\n[[lumbar]]\nlevels = 2\naxial = 'a'", DataError, "a stands twice"),
        ("p.toml", "a = -1.0", ProblemError, "passive_stiffness of 'a' is -1"),
        ("none.toml", None, DataError, "cannot be read"),
        ("none.csv", None, DataError, "cannot be read"),
    ],
)
def test_a_mistake_in_the_passive_stiffness_is_one_sentence(tmp_path, name, content, error, message):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(error, match=message) as caught:
        read_settings(with_setup(tmp_path, f"stability = 'full'\npassive = '{name}'"))
    assert "\n" not in str(caught.value)


def test_a_motion_can_be_named_by_its_parts(tmp_path):
    (tmp_path / "model.osim").touch()
    path = settings_file(tmp_path, 'model = "model.osim"\ncoordinates = "a.mot"\nactuators = ["r.xml"]\n')
    settings, _ = read_settings(path)
    assert settings.motion.model == tmp_path / "model.osim"
    assert settings.motion.coordinates == tmp_path / "a.mot"
    assert settings.motion.actuators == (tmp_path / "r.xml",)
    # OpenSim's own defaults
    assert settings.muscle_physiology is True
    assert settings.exponent == 2.0


def test_options_win_over_the_file(tmp_path):
    path = with_setup(tmp_path, 'stability = "potvin-brown"\nq = 5.0\noutput = "a"\n')
    settings, output = read_settings(path, {"q": 3.0, "output": Path("b"), "exponent": None})
    assert settings.stability.q == 3.0
    assert output.folder == Path.cwd() / "b"
    settings, _ = read_settings(path, {"stability": "off"})
    assert settings.stability is None
    settings, _ = read_settings(path, {"stability": "full"})
    assert settings.stability == HessianStability(q=5.0)


@pytest.mark.parametrize("name", ["elbow", "spine-load-height", "spine-postures"])
def test_the_settings_of_every_example_are_read(name):
    assert name in example_names()
    settings, _ = read_settings(example_folder(name) / "scso.toml")
    assert settings.stability is not None
    first_line = (example_folder(name) / "scso.toml").read_text().splitlines()[0]
    assert first_line.startswith("# ")
    assert len(first_line) < 110


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("exponnent = 2", NameMismatchError, r"unknown setting 'exponnent' \(closest: exponent\)"),
        ("zzz = 2", NameMismatchError, "unknown setting 'zzz'"),
        ("exponent = 'two'", DataError, "exponent is 'two', expected a number"),
        ("exponent = nan", DataError, "exponent is nan, expected a number"),
        ("figures = 1", DataError, "figures is 1, expected true or false"),
        ("processes = 0", DataError, "processes is 0, expected a whole number of at least 1"),
        ("max_iterations = 1.5", DataError, "expected a whole number"),
        ("joints = [1]", DataError, "expected a list of names"),
        ("stability = 'on'", DataError, "expected 'off' or 'potvin-brown'"),
        ("weights = 'heavy'", DataError, "expected 'volume' or 'pcsa'"),
        ("q = 3", ProblemError, "q has no effect while stability is off"),
        ("stability = 'potvin-brown'\nq = -1", ProblemError, "q is -1"),
        (
            "stability = 'full'\njoints = ['knee_r']",
            ProblemError,
            "joints has no effect while stability is 'full', expected 'potvin-brown'",
        ),
        (
            "stability = 'potvin-brown'\nstability_coordinates = ['knee_angle_r']",
            ProblemError,
            "stability is 'potvin-brown', expected 'diagonal' or 'full'",
        ),
        (
            "stability = 'full'\nstiffness = 'fiber'\nq = 5",
            ProblemError,
            "q has no effect on fiber stiffness",
        ),
        ("stability = 'full'\nsoft = 0", ProblemError, "soft is 0, expected a positive price"),
        ("tolerance = 2.0", ProblemError, "tolerance is 2"),
        ("a = ", FileFormatError, "is not TOML"),
    ],
)
def test_a_mistake_in_the_file_is_one_sentence(tmp_path, text, error, message):
    with pytest.raises(error, match=message) as caught:
        read_settings(with_setup(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_stability_settings_may_stay_in_a_file_that_switches_stability_off(tmp_path):
    path = with_setup(tmp_path, 'stability = "off"\nq = 5.0\n')
    settings, _ = read_settings(path)
    assert settings.stability is None
    with pytest.raises(ProblemError, match="q has no effect"):
        read_settings(path, {"q": 3.0})


def test_a_file_without_a_motion_says_what_is_missing(tmp_path):
    with pytest.raises(DataError, match="names no motion, expected setup, or model and coordinates"):
        read_settings(settings_file(tmp_path, "exponent = 2"))
    with pytest.raises(DataError, match=r"missing\.toml cannot be read: No such file"):
        read_settings(tmp_path / "missing.toml")
