"""Settings files: every key is read, every mistake is one sentence."""

import contextlib
import math
import re
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from helpers import random_problem
from typer.main import get_command

import scso_nlp as scso
from scso_nlp import CoordinateStability, HessianStability, JointStability
from scso_nlp.cli import app
from scso_nlp.declared_settings import (
    COUNT,
    FLAG,
    MUSCLE_MODELS,
    NUMBER,
    NUMBER_OR_TABLE,
    SETTINGS,
    SOLVERS,
    STABILITY_METHODS,
    STIFFNESS_LAWS,
    reference,
    template,
)
from scso_nlp.examples import example_folder, example_names
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError, ProblemError
from scso_nlp.files import hashes
from scso_nlp.muscle_models.stiffness_law import FiberStiffness, ProportionalStiffness, ShortRangeStiffness
from scso_nlp.opensim.setup_xml import MotionInput
from scso_nlp.run import describe
from scso_nlp.settings import (
    CalibrationSettings,
    EmgSettings,
    OutputSettings,
    RunSettings,
    read_settings,
    record,
)
from scso_nlp.solver import SolverOptions

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
    assert settings.sources == hashes([SPINE / "setup.xml"])
    assert output.folder == SPINE / "scso_results" / "setup"


def test_the_template_is_accepted_once_the_setup_path_is_filled_in(tmp_path):
    text = template().replace('setup = "setup.xml"', f"setup = '{SPINE / 'setup.xml'}'")
    settings, _ = read_settings(settings_file(tmp_path, text))
    assert settings.stability == JointStability(q=5.0, level=0.0)


#: Every setting: words of its option, the same in a file, and what arrives. A new setting needs a line.
ARRIVES = {
    "setup": (str(SPINE / "setup.xml"), f"'{SPINE / 'setup.xml'}'", SPINE / "setup.xml"),
    "model": ("other.osim", '"other.osim"', Path("other.osim")),
    "coordinates": ("a.mot", '"a.mot"', Path("a.mot")),
    "states": ("a.sto", '"a.sto"', Path("a.sto")),
    "speeds": ("v.sto", '"v.sto"', Path("v.sto")),
    "external_loads": ("loads.xml", '"loads.xml"', Path("loads.xml")),
    "actuators": ("a.xml,b.xml", '["a.xml", "b.xml"]', (Path("a.xml"), Path("b.xml"))),
    "replace_force_set": (True, "true", True),
    "outside_force_set": ("a, b", '["a", "b"]', ("a", "b")),
    "name": ("trunk", '"trunk"', "trunk"),
    "initial_time": ("1", "1", 1.0),
    "final_time": ("4.5", "4.5", 4.5),
    "lowpass_cutoff_frequency": ("6", "6.0", 6.0),
    "step_interval": ("3", "3", 3),
    "in_degrees": (False, "false", False),
    "speeds_in_degrees": (True, "true", True),
    "held_coordinates": ("a, b", '["a", "b"]', ("a", "b")),
    "keep_coupled_speeds": (False, "false", False),
    "exponent": ("inf", "inf", math.inf),
    "muscle_physiology": (True, "true", True),
    "muscle_model": ("compliant", '"compliant"', "compliant"),
    "short_fibers": ("silence", '"silence"', "silence"),
    "weights": ("ES*=2,RA_*=.5", '{ "ES*" = 2, "RA_*" = 0.5 }', {"ES*": 2.0, "RA_*": 0.5}),
    "passive_elements": ("left_in", '"left_in"', "left_in"),
    "activation_rate": ("constant", '"constant"', "constant"),
    "activation_dynamics": (True, "true", True),
    "joint_reactions": ("knee_r, hip_r", '["knee_r", "hip_r"]', ("knee_r", "hip_r")),
    "joint_reaction_effort": ("a=.1, b_*=2", '{ "a" = 0.1, "b_*" = 2 }', {"a": 0.1, "b_*": 2.0}),
    "joint_reaction_limit": ("a=2500, b_*=3BW", '{ "a" = 2500, "b_*" = "3BW" }', {"a": 2500.0, "b_*": "3BW"}),
    "joint_reaction_cone": ("a=0 0 -1 .5", '{ "a" = [0, 0, -1, 0.5] }', {"a": [0.0, 0.0, -1.0, 0.5]}),
    "joint_reaction_soft": (".01", "0.01", 0.01),
    "stability": ("full", '"full"', "full"),
    "q": ("*=5, RA_*=1e1", '{ "*" = 5, "RA_*" = 10.0 }', {"*": 5.0, "RA_*": 10.0}),
    "level": ("3", "3", 3.0),
    "joints": ("lumbar_pelvis", '["lumbar_pelvis"]', ("lumbar_pelvis",)),
    "axes": ("x,z", '["x", "z"]', ("x", "z")),
    "moving_paths": ("frozen", '"frozen"', "frozen"),
    "stability_coordinates": ("a", '"a"', ("a",)),
    "stiffness": ("short-range", '"short-range"', "short-range"),
    "half_force": (".3", "0.3", 0.3),
    "tendon_compliance": ("4", "4", 4.0),
    "passive": ("a=5", '{ "a" = 5 }', {"a": 5.0}),
    "passive_factor": (".25", "0.25", 0.25),
    "soft": (".5", "0.5", 0.5),
    "emg": ("other.csv", '"other.csv"', Path("other.csv")),
    "emg_map": ("other.toml", '"other.toml"', Path("other.toml")),
    "raw_emg": (True, "true", True),
    "emg_offset": ("-.5", "-0.5", -0.5),
    "emg_tracking": ("3", "3", 3.0),
    "emg_bounds": (".1", "0.1", 0.1),
    "emg_compare": ("shapes", '"shapes"', "shapes"),
    "calibrated": ("q[RA*,ES*],level[a]", '["q[RA*,ES*]", "level[a]"]', ("q[RA*,ES*]", "level[a]")),
    "calibration_bounds": (
        "q[a,b]=1 9,level=0 5",
        '{ "q[a,b]" = [1.0, 9.0], "level" = [0.0, 5.0] }',
        {"q[a,b]": [1.0, 9.0], "level": [0.0, 5.0]},
    ),
    "measured_stiffness": ("14500", "14500", 14500.0),
    "stiffness_arms": ("a=.3,b=1", '{ "a" = 0.3, "b" = 1 }', {"a": 0.3, "b": 1.0}),
    "unit": ("person 1", '"person 1"', "person 1"),
    "same_data": (True, "true", True),
    "solver": ("framewise", '"framewise"', "framewise"),
    "tolerance": ("1e-6", "1e-6", 1e-6),
    "max_iterations": ("50", "50", 50),
    "frames_per_program": ("7", "7", 7),
    "presolve": (False, "false", False),
    "output": ("out", '"out"', Path("out")),
    "overwrite": (True, "true", True),
    "keep_failed": (True, "true", True),
    "figures": (False, "false", False),
    "processes": ("1", "1", 1),
    "cache": ("stored", '"stored"', Path("stored")),
}


def method_for(name):
    """Give a stability method that has a field for the setting."""
    if not SETTINGS[name].place.startswith(("stability.", "stiffness.")):
        return "off"
    return "potvin-brown" if name in ("joints", "axes", "moving_paths") else "full"


def beside(name, folder):
    """Write what a setting does not go without, and give the lines that name it."""
    lines = {"setup": f"'{SPINE / 'setup.xml'}'", "stability": f"'{method_for(name)}'"}
    needed = {
        "half_force": ("stiffness", '"falling"'),
        "tendon_compliance": ("stiffness", '"short-range"'),
        "joint_reaction_soft": ("joint_reaction_limit", '"3BW"'),
        "short_fibers": ("muscle_model", '"compliant"'),
    }
    lines |= [needed[name]] if name in needed else []
    if not SETTINGS[name].place.startswith("emg."):
        return lines
    rows = "".join(f"{k / 1000},{k % 7 / 7}\n" for k in range(1000))
    for file in ("emg.csv", "other.csv"):
        (folder / file).write_text("time,c\n" + rows)
    for file in ("map.toml", "other.toml"):
        (folder / file).write_text('format = 1\n[groups.a]\nchannels = ["c"]\nmuscles = ["RA_R"]\n')
    return lines | {"emg": '"emg.csv"', "emg_map": '"map.toml"', "emg_tracking": "1"}


RUN = get_command(app).commands["run"]
OPTIONS = {parameter.name: parameter for parameter in RUN.params}


def toml_file(folder, lines):
    """Write a settings file of lines by name."""
    return settings_file(folder, "\n".join(f"{name} = {text}" for name, text in lines.items()))


def from_folder(folder, value):
    """Put paths into a folder."""
    if isinstance(value, tuple):
        return tuple(from_folder(folder, item) for item in value)
    return folder / value if isinstance(value, Path) else value


def test_there_is_a_line_above_for_every_setting():
    assert list(ARRIVES) == list(SETTINGS)


@pytest.mark.parametrize("name", SETTINGS)
def test_every_setting_arrives_from_a_file_and_from_the_command_line(name, tmp_path, monkeypatch):
    """And what arrives is what ``report.json`` says."""
    monkeypatch.chdir(tmp_path)
    words, text, value = ARRIVES[name]
    lines = beside(name, tmp_path)
    plain = read_settings(toml_file(tmp_path, lines))
    by_option = read_settings(toml_file(tmp_path, lines), {name: words})
    by_file = read_settings(toml_file(tmp_path, lines | {name: text}))
    # the two files differ, and so do their hashes
    assert replace(by_option[0], sources=by_file[0].sources) == by_file[0]
    assert by_option[1] == by_file[1]
    sides = SETTINGS[name].spelling.split("/")
    typed = [sides[not words]] if isinstance(words, bool) else [sides[0], words]
    options = RUN.make_context("run", ["scso.toml", *typed]).params
    assert {key: value for key, value in options.items() if value is not None and key in SETTINGS} == {
        name: words
    }
    assert record(*by_file)[name] == from_folder(tmp_path, value)
    assert record(*plain)[name] != record(*by_file)[name] or name == "setup"


@pytest.mark.parametrize("name", SETTINGS)
def test_every_setting_is_an_option_a_line_of_the_template_and_an_entry_of_the_reference(name):
    setting = SETTINGS[name]
    option = OPTIONS[name]
    assert [*option.opts, *option.secondary_opts] == setting.spelling.split("/")
    assert option.help == setting.description
    assert option.default is None
    line = next(line for line in template().splitlines() if line.removeprefix("# ").startswith(f"{name} = "))
    read = setting.read(tomllib.loads(line.removeprefix("# "))[name], "the template", Path.cwd())
    assert read is not None
    assert line.startswith("# ") is not setting.is_filled_in
    entry = reference().split(f"\n### `{name}`\n")[1].split("\n#")[0]
    for word in (setting.help, setting.example, setting.unit, setting.default, *setting.spelling.split("/")):
        assert word in entry


def test_there_is_no_option_template_line_record_or_entry_without_a_setting():
    settings, output = read_settings(SPINE / "setup.xml")
    lines = [line.removeprefix("# ").split(" = ")[0] for line in template().splitlines() if " = " in line]
    assert [name for name in OPTIONS if name not in ("source", "verbose", "help")] == list(SETTINGS)
    assert [name for name in lines if name.isidentifier()] == list(SETTINGS)
    assert list(record(settings, output)) == list(SETTINGS)
    assert re.findall(r"\n### `(\w+)`\n", reference()) == list(SETTINGS)


def declared_defaults():
    """Give the defaults that are values and not words about something else."""
    found = {}
    for name, setting in SETTINGS.items():
        with contextlib.suppress(DataError):
            if setting.kind in (FLAG, NUMBER, COUNT, NUMBER_OR_TABLE) or "|" in setting.kind.words:
                value = {"true": True, "false": False}.get(setting.default, setting.default)
                found[name] = setting.read(value, "default", Path.cwd(), as_option=True)
    return {name: value for name, value in found.items() if not isinstance(value, Path)}


def test_every_default_that_is_a_value_is_the_one_in_effect():
    defaults = declared_defaults()
    assert {"stability", "q", "level", "solver", "tolerance", "figures", "moving_paths"} <= defaults.keys()
    for name, value in defaults.items():
        method = {} if name == "stability" else {"stability": method_for(name)}
        settings, output = read_settings(SPINE / "setup.xml", method)
        assert record(settings, output)[name] == value, name


def test_every_field_of_the_parts_of_a_run_is_a_setting_but_those_a_run_fills_in_itself():
    places = {setting.place for setting in SETTINGS.values()} | {"run.stability", "run.setup"}
    parts = {
        "run": RunSettings,
        "motion": MotionInput,
        "options": SolverOptions,
        "output": OutputSettings,
        "emg": EmgSettings,
        "calibration": CalibrationSettings,
        "stability": HessianStability,
    }
    missing = {
        f"{part}.{item.name}"
        for part, values in parts.items()
        for item in fields(values)
        if f"{part}.{item.name}" not in places
    }
    assert missing <= {
        *(
            "run.motion",
            "run.options",
            "run.emg",
            "run.calibration",
            "run.analysis_name",
            "run.sources",
            "run.notes",
        ),
        *("motion.stability_axes", "motion.curvature_coordinates", "motion.muscle_paths"),
        *("stability.passive_matrix", "stability.model_passive", "stability.label"),
        "options.ipopt",
    }


@pytest.mark.parametrize("table", [MUSCLE_MODELS, STABILITY_METHODS, STIFFNESS_LAWS, SOLVERS])
def test_everything_that_settings_call_by_name_is_there(table):
    for name, named in table.items():
        assert callable(named.thing), name


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
    assert settings.sources == hashes([path, SPINE / "setup.xml"])


def test_terms_beside_stability_are_described_by_settings(tmp_path):
    text = """
        passive_elements = "left_in"
        activation_rate = "constant"
        activation_dynamics = true
        weights = "pcsa"
        exponent = 3
        muscle_model = "physical-rigid"
        short_fibers = "silence"
    """
    settings, _ = read_settings(with_setup(tmp_path, text))
    motion = random_problem(np.random.default_rng(5), n_frames=3, n_muscles=4, reserve=5.0).motion
    problem = describe(settings, motion)
    assert problem.muscle_model == scso.RigidTendon(convention="physical", short_fibers="silence")
    assert problem.objectives == (scso.ActivationEffort(exponent=3.0, weights="pcsa"),)
    assert problem.constraints == (
        scso.MomentEquilibrium(passive_elements="left_in"),
        scso.ActivationRate(bounds="constant"),
        scso.ActivationDynamics(),
    )
    assert read_settings(with_setup(tmp_path))[0].constraints == ()


def test_terms_of_joint_reactions_are_described_by_settings(tmp_path):
    by_name, _ = read_settings(
        SPINE / "setup.xml",
        {
            "joint_reaction_effort": "a=.1,b=2",
            "joint_reaction_limit": "a=3BW",
            "joint_reaction_cone": "a=0 0 -1 .5, b=0 1 0 1",
            "joint_reaction_soft": ".01",
        },
    )
    effort = scso.JointReactionEffort(joints=("a", "b"), weights={"a": 0.1, "b": 2.0})
    limit = scso.JointReactionLimit(joints=("a",), largest={"a": "3BW"}, soft=0.01)
    about_a = scso.JointReactionCone(joints=("a",), axis=(0, 0, -1), slope=0.5, label="JointReactionCone_a")
    about_b = scso.JointReactionCone(joints=("b",), axis=(0, 1, 0), slope=1.0, label="JointReactionCone_b")
    cones = [replace(cone, soft=0.01) for cone in (about_a, about_b)]
    assert by_name.terms == (effort, limit, *cones)
    of_all, _ = read_settings(with_setup(tmp_path, "joint_reaction_effort = 1\njoint_reaction_limit = '3BW'"))
    assert of_all.terms == (scso.JointReactionEffort(), scso.JointReactionLimit(largest="3BW"))
    motion = random_problem(np.random.default_rng(5), n_frames=3, n_muscles=4, reserve=5.0).motion
    problem = describe(of_all, motion)
    assert (problem.objectives[1:], problem.constraints[1:]) == (of_all.objectives, of_all.constraints)


@pytest.mark.parametrize("setting", ["activation_rate = 'first_order'", "activation_dynamics = true"])
def test_what_couples_frames_is_refused_frame_by_frame(tmp_path, setting):
    path = with_setup(tmp_path, f"{setting}\nsolver = 'framewise'")
    with pytest.raises(ProblemError, match=r"Activation(Rate|Dynamics) couples frames, expected solver"):
        read_settings(path)


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
        ("p.csv", "a,b\n1,2\n3\n", FileFormatError, "expected a line of coordinates, then"),
        ("p.csv", "a,b\n1,2\n", FileFormatError, "then for each of them a line of as many numbers"),
        ("p.csv", "a,b\n1,2\n3,1\n", DataError, r"is not symmetric: 2 at \(a, b\)"),
        ("p.csv", "a,a\n1,2\n2,1\n", DataError, "must be unique"),
        ("p.csv", "a\none\n", FileFormatError, "expected a line of coordinates"),
        ("p.toml", "a = 'stiff'", DataError, "expected lines of the form row = number"),
        ("p.toml", "[[lumbar]]\naxial = ['a']", DataError, r"tables \[\[lumbar\]\] with levels"),
        ("p.toml", "[[lumbar]]\nlevels = 2\nup = ['a']", DataError, "direction of 'a' is 'up'"),
        ("p.toml", "a = 1\n[[lumbar]]\nlevels = 2\naxial = 'a'", DataError, "a stands twice"),
        ("p.toml", "a = -1.0", ProblemError, "passive_stiffness of 'a' is -1"),
        ("none.toml", None, DataError, "does not exist"),
        ("none.csv", None, DataError, "does not exist"),
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
        ("exponent = 'two'", DataError, r"exponent is 'two', expected a number \(e.g. exponent = 2.0\)"),
        ("level = { a = 'low' }", DataError, "level is {'a': 'low'}, expected a number, or a table"),
        ("passive = { a = nan }", DataError, "passive is {'a': nan}, expected a table"),
        (
            "frames_per_program = 0",
            DataError,
            "frames_per_program is 0, expected a whole number of at least 1",
        ),
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
        ("joint_reaction_effort = -1", ProblemError, "weight is -1, expected a finite number"),
        (
            "joint_reaction_limit = '3'",
            ProblemError,
            "the limit of 'all joints' is '3', expected more than 1 N, or text such as '3BW'",
        ),
        (
            "joint_reaction_cone = { a = [0, 0, 1] }",
            DataError,
            r"is {'a': \[0, 0, 1\]}, expected a table { \"name\" = \[x, y, z, slope\]",
        ),
        ("short_fibers = 'silence'", ProblemError, "has no effect on the muscle model 'none'"),
        ("joint_reaction_soft = 1", ProblemError, "needs joint_reaction_limit or joint_reaction_cone"),
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
    with pytest.raises(DataError, match=r"missing\.toml does not exist"):
        read_settings(tmp_path / "missing.toml")


def test_what_a_setup_says_about_result_files_and_is_done_otherwise_is_noted_and_logged_once(
    tmp_path, caplog
):
    text = (SPINE / "setup.xml").read_text()
    for name in ("spine.osim", "motion.mot", "external_loads.xml", "loads.mot"):
        (tmp_path / name).write_bytes((SPINE / name).read_bytes())
    setup = tmp_path / "setup.xml"
    setup.write_text(text)
    directory = (
        f"the setup's results_directory {tmp_path / 'results'} is not used: OpenSim's own results there stay"
    )
    precision = "the setup's output_precision 16 is not used: results have all digits"
    with caplog.at_level("INFO", "scso_nlp"):
        settings, _ = read_settings(setup)
    assert settings.notes == (directory, precision)
    assert [record.message for record in caplog.records] == [f"{setup}: {note}" for note in settings.notes]
    # an option is the user's own word
    assert read_settings(setup, {"output": tmp_path / "mine"})[0].notes == (precision,)
    assert read_settings(setup, {"name": "other"})[0].notes == (directory, precision)
    ours = text.replace(">results<", ">scso_results/setup<")
    setup.write_text(ours.replace(">16<", ">8<"))
    assert read_settings(setup)[0].notes == ()
    setup.write_text(re.sub(r"<(results_directory|output_precision)>.*?</\1>", "", text))
    assert read_settings(setup)[0].notes == ()


def test_a_setup_is_not_taken_twice():
    with pytest.raises(ProblemError, match="is taken as a setup, but the options name another"):
        read_settings(SPINE / "setup.xml", {"setup": SPINE / "setup.xml"})


def test_settings_made_by_hand_are_recorded_too():
    """A law or a method of the user's own is called after its class."""

    class Soft(ProportionalStiffness):
        pass

    motion = read_settings(SPINE / "setup.xml")[0].motion
    stability = HessianStability(stiffness=Soft(q=2.0), coordinates=("a",), passive_matrix=[[3.0]])
    settings = RunSettings(motion=motion, stability=stability, options=SolverOptions(tolerance=1e-5))
    found = record(settings, OutputSettings(figures=False))
    expected = {
        "stability": "full",
        "stiffness": "Soft",
        "q": 2.0,
        "stability_coordinates": ("a",),
        "joints": None,
    }
    expected |= {"passive": [[3.0]], "tolerance": 1e-5, "figures": False, "setup": None, "output": None}
    assert {name: found[name] for name in expected} == expected
    assert record(RunSettings(motion=motion), OutputSettings())["stability"] == "off"


def test_numbers_paths_and_tables_of_any_kind_are_taken_from_python(tmp_path):
    changes = {
        "exponent": np.float64(3),
        "actuators": [Path("a.xml")],
        "weights": MappingProxyType({"ES*": 2}),
    }
    settings, _ = read_settings(SPINE / "setup.xml", changes)
    assert (settings.exponent, settings.weights) == (3.0, {"ES*": 2.0})
    assert settings.motion.actuators == (Path.cwd() / "a.xml",)
