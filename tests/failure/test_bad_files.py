"""Files, paths and values that cannot be used, by command: one sentence and exit code 2, soon."""

from __future__ import annotations

import csv
import dataclasses
import errno
import mmap
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import elbow
from tiny_model import setup_text, write_tiny
from typer.testing import CliRunner

import scso_nlp as scso
from scso_nlp import files
from scso_nlp.cli import app
from scso_nlp.cli.exit_codes import BAD_INPUT, BUG
from scso_nlp.emg.comparison import Comparison, ComparisonRow, write_comparison_csv
from scso_nlp.examples import example_folder
from scso_nlp.opensim import crew
from scso_nlp.opensim.setup_xml import check_document, read_xml
from scso_nlp.settings import read_settings
from scso_nlp.solver import ipopt

LONG = "a" * 300
NINES = "9" * 400


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with the elbow example, and no OpenSim: whoever starts it has not checked first."""
    shutil.copytree(example_folder("elbow"), tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(crew, "extract", lambda *_: pytest.fail("OpenSim was started"))
    return tmp_path


def scso_says(*arguments: object) -> str:
    """Run a command that is to refuse its input, and return its sentence."""
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == BAD_INPUT, done.output
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, done.stderr
    return lines[0]


def settings(folder: Path, *lines: str) -> Path:
    """Write a settings file for the example, with full stability."""
    path = folder / "own.toml"
    path.write_text('setup = "setup.xml"\n' + "\n".join(lines) + "\n", encoding="utf-8")
    return path


# Paths --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", f"{LONG}.xml"),
        ("run", f"{LONG}.toml"),
        ("run", "setup.xml", "--model", f"{LONG}.osim"),
        ("run", "setup.xml", "--coordinates-file", f"{LONG}.mot"),
        ("run", "setup.xml", "--cache", LONG),
        ("run", "setup.xml", "--stability", "full", "--passive", f"{LONG}.toml"),
        ("run", "setup.xml", "--stability", "full", "--passive", f"{LONG}.csv"),
        ("reach", f"{LONG}.xml"),
        ("init", LONG),
        ("compare", LONG),
        ("report", LONG),
    ],
)
def test_names_that_are_too_long_for_the_system(folder, arguments):
    assert re.search("File name too long", scso_says(*arguments))


@pytest.mark.parametrize("option", ["--model", "--output", "--cache", "--coordinates-file"])
def test_the_home_of_nobody(folder, option):
    said = scso_says("run", "setup.xml", option, "~nosuchuser/x")
    assert "~nosuchuser/x: no user has this home folder; write ./~nosuchuser/x" in said


@pytest.mark.parametrize("key", ["setup", "model", "coordinates", "output", "cache", "passive"])
def test_a_zero_byte_in_a_path(folder, key):
    path = settings(folder, 'stability = "full"', f'{key} = "a\\u0000b"')
    if key == "setup":
        path.write_text(path.read_text().split("\n", 1)[1])
    assert "holds a zero byte, which no path can" in scso_says("run", path)


def test_a_zero_byte_in_python():
    for call in (
        lambda: scso.load_motion("a\0b"),
        lambda: scso.load_bundle("a\0b"),
        lambda: scso.save_bundle("a\0b", elbow([1.0]).motion),
        lambda: scso.write_solution(scso.solve_framewise(elbow([1.0])), "a\0b"),
        lambda: read_settings("a\0b.toml"),
    ):
        with pytest.raises(scso.DataError, match="holds a zero byte"):
            call()


@pytest.mark.parametrize("name", ["a\\u0000b", "a/b", "n" * 200])
def test_a_motions_name_that_no_file_can_start_with(folder, name):
    said = scso_says("run", settings(folder, f'name = "{name}"'))
    assert "the name 'a" in said or "has 200 letters, expected at most 100" in said


def forbidden(path: object) -> bool:
    return "secret" in str(path)


@pytest.fixture
def secret(folder, monkeypatch):
    """Make a folder that nobody, not even root, may enter, as far as Python can tell."""
    (folder / "secret").mkdir()

    def guarded(function):
        def call(path, *args, **kwargs):
            if isinstance(path, str | os.PathLike) and forbidden(path):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return function(path, *args, **kwargs)

        return call

    for module, name in ((os, "stat"), (os, "lstat"), (os, "mkdir"), (os, "listdir"), (os, "open")):
        monkeypatch.setattr(module, name, guarded(getattr(module, name)))
    monkeypatch.setattr("builtins.open", guarded(open))
    monkeypatch.setattr("io.open", guarded(open))
    return folder / "secret"


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "secret/setup.xml"),
        ("run", "secret/scso.toml"),
        ("run", "setup.xml", "--model", "secret/x.osim"),
        ("run", "setup.xml", "--coordinates-file", "secret/x.mot"),
        ("run", "setup.xml", "--cache", "secret/c"),
        ("run", "setup.xml", "--stability", "full", "--passive", "secret/x.toml"),
        ("init", "secret/a.toml"),
        ("compare", "secret/results"),
        ("report", "secret/results"),
    ],
)
def test_a_folder_that_must_not_be_entered(secret, arguments):
    assert re.search("Permission denied", scso_says(*arguments))


# Files that are none ------------------------------------------------------------------------------


@pytest.fixture
def endless(folder):
    """A pipe that nobody writes to, under every ending: whoever reads it waits for ever."""
    for ending in ("toml", "csv", "xml", "osim", "sto", "npz"):
        os.mkfifo(folder / f"endless.{ending}")
    return folder


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes have no names here")
@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "endless.toml"),
        ("run", "endless.xml"),
        ("run", "setup.xml", "--model", "endless.osim"),
        ("run", "setup.xml", "--coordinates-file", "endless.sto"),
        ("run", "setup.xml", "--external-loads", "endless.xml"),
        ("run", "setup.xml", "--actuators", "endless.xml"),
        ("run", "setup.xml", "--stability", "full", "--passive", "endless.toml"),
        ("run", "setup.xml", "--stability", "full", "--passive", "endless.csv"),
    ],
)
def test_pipes_are_not_waited_for(endless, arguments):
    assert re.search(r"endless\.\w+ is not a file", scso_says(*arguments))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes have no names here")
def test_pipes_are_not_waited_for_in_python(endless):
    for read in (
        lambda: scso.load_bundle("endless.npz"),
        lambda: files.read_toml("/dev/zero"),
        lambda: files.read_text("endless.csv"),
    ):
        with pytest.raises(scso.DataError, match="is not a file"):
            read()


def test_files_beyond_all_measure_are_refused_by_their_size(tmp_path):
    path = tmp_path / "large.toml"
    with open(path, "wb") as file:
        file.truncate(files.LARGEST_TOML + 1)  # takes no room on the disk
    with pytest.raises(scso.DataError, match=r"large\.toml has 17 MB, expected at most 17 MB"):
        files.read_toml(path)


# Contents -----------------------------------------------------------------------------------------


def test_an_encoding_that_is_not_known(folder):
    text = (folder / "setup.xml").read_text().replace('encoding="UTF-8"', 'encoding="x-klingon"')
    (folder / "klingon.xml").write_text(text)
    said = scso_says("run", "klingon.xml")
    assert "klingon.xml cannot be read: unknown encoding: x-klingon; save it in UTF-8" in said


def test_elements_nested_beyond_what_opensim_survives(folder):
    deep = "<a>" * 50_000 + "</a>" * 50_000
    model = (folder / "elbow.osim").read_text().replace("</Model>", deep + "</Model>")
    (folder / "deep.osim").write_text(model)
    said = scso_says("run", "setup.xml", "--model", "deep.osim")
    assert "deep.osim has elements nested more than 200 deep" in said


@pytest.mark.parametrize("opening", ["[", "{a="])
def test_values_nested_beyond_pythons_stack(folder, opening):
    (folder / "deep.toml").write_text("x = " + opening * 20_000)
    assert "nested too deeply" in scso_says("run", "deep.toml")


def test_comments_that_do_not_end_are_not_looked_for_again_and_again(tmp_path):
    path = tmp_path / "model.osim"
    path.write_text("<Model/>" + "<!--" * 300_000)
    with pytest.raises(scso.FileFormatError, match="not well-formed"):
        read_xml(path)


def test_comments_are_left_out_and_lines_counted(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text("<a><!-- one -- \n two --><b/><!----><!-->--><c/></a>")
    assert [child.tag for child in read_xml(path)] == ["b", "c"]
    path.write_text("<a><!-- one\n\n--><b></a>")
    with pytest.raises(scso.FileFormatError, match="line 3"):
        read_xml(path)


def test_names_of_cpp_as_tags_are_read(tmp_path, caplog):
    path = tmp_path / "a.osim"
    path.write_text('<Model><Own::Part name="p"><x>1</x></Own::Part><Own::Empty/></Model>')
    check_document(path, "Model")
    assert caplog.messages == []
    assert [child.tag for child in read_xml(path)] == ["Own__Part", "Own__Empty"]


def test_repeated_labels_are_counted_once(tmp_path):
    labels = ["a", "b"] * 50_000
    with pytest.raises(scso.DataError, match=r"found twice: a, b$"):
        scso.MuscleParameters(**dict.fromkeys((f.name for f in dataclasses.fields(scso.MuscleParameters)), ())
                              | {"muscles": labels})  # fmt: skip


@pytest.mark.parametrize(
    "key",
    ["max_iterations", "frames_per_program", "step_interval", "processes", "q", "level", "exponent", "soft",
     "tolerance", "initial_time", "lowpass_cutoff_frequency"],
)  # fmt: skip
def test_numbers_of_hundreds_of_digits(folder, key):
    said = scso_says("run", settings(folder, 'stability = "full"', f"{key} = {NINES}"))
    assert f"{key} is 9999" in said
    assert len(said) < 300


def test_numbers_of_thousands_of_digits(folder):
    assert "is not TOML" in scso_says("run", settings(folder, f"max_iterations = {'9' * 5000}"))
    said = scso_says("run", "setup.xml", "--max-iterations", "9" * 5000)
    assert "expected a whole number of at least 1, at most 2147483647" in said


def test_more_iterations_than_ipopt_can_count_to():
    with pytest.raises(scso.ProblemError, match=r"max_iterations is 9+, expected a whole number"):
        scso.SolverOptions(max_iterations=10**30 - 1)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("joints = []", "the list of joint names is empty"),
        ("axes = []", "the list of axis names is empty"),
        ('joints = ["elbow", "elbow"]', "joint names must be unique, found twice: elbow"),
        ('axes = ["w"]', "unknown axis 'w' (available: x, y, z)"),
        ('joints = ["elbw"]', "unknown joint 'elbw' (closest: elbow)"),
        ('level = { "elbow_w" = 1.0 }', "unknown stability row 'elbow_w' (closest: elbow_"),
        ('q = { "*" = 5.0, "biceqs" = 1.0 }', "unknown muscle 'biceqs' (closest: biceps"),
        ('passive = { "elbow_w" = 1.0 }', "unknown stability row 'elbow_w'"),
        ('weights = { "bice?s_x" = 1.0 }', "pattern 'bice?s_x' fits no muscle or actuator"),
        ('held_coordinates = ["elbow_flexio"]', "unknown coordinate of held_coordinates 'elbow_flexio'"),
        ("exponent = 0.5", "exponent is 0.5, expected a number of at least 1"),
        ("exponent = 2000.0", "exponent is 2000, expected at most 1000"),
        ("lowpass_cutoff_frequency = 0.0", "lowpass_cutoff_frequency is 0 Hz, expected a positive number"),
    ],
)
def test_names_and_numbers_are_refused_before_opensim_starts(folder, line, text):
    assert text in scso_says("run", settings(folder, 'stability = "potvin-brown"', line))


@pytest.mark.parametrize("method", ["diagonal", "full"])
@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("stability_coordinates = []", "the list of coordinate names is empty"),
        ('stability_coordinates = ["elbow"]', "unknown coordinate 'elbow' (closest: elbow_flexion"),
        ('level = { "elbow" = 1.0 }', "unknown stability row 'elbow' (closest: elbow_flexion"),
    ],
)
def test_names_of_coordinates_are_refused_before_opensim_starts(folder, method, line, text):
    assert text in scso_says("run", settings(folder, f'stability = "{method}"', line))


def test_one_row_in_two_directions_of_one_table(folder):
    (folder / "p.toml").write_text('[[lumbar]]\nlevels = 2\nflexion = ["a"]\nlateral = ["b", "a"]\n')
    said = scso_says("run", settings(folder, 'stability = "full"', 'passive = "p.toml"'))
    assert "'a' stands twice in one table [[lumbar]]" in said


@pytest.mark.parametrize(
    ("labels", "text"),
    [
        (("elbow_flexion", "elbow_flexion"), "the columns elbow_flexion, elbow_flexion are all of"),
        (
            ("/jointset/elbow/elbow_flexion/value", "elbow_flexion"),
            "are all of the coordinate 'elbow_flexion'",
        ),
    ],
)
def test_a_coordinate_with_two_columns(tmp_path, labels, text):
    tiny = write_tiny(tmp_path)
    lines = tiny.moving.read_text().replace("shoulder_flexion", labels[0]).replace("elbow_flexion", "@", 1)
    lines = lines.replace("@", "elbow_flexion").replace("\telbow_flexion\t", f"\t{labels[1]}\t", 1)
    tiny.moving.write_text(lines)
    with pytest.raises(scso.DataError, match=re.escape(text)):
        scso.load_motion(tiny.setup)


def test_columns_that_are_no_coordinates_may_repeat(tmp_path, monkeypatch):
    tiny = write_tiny(tmp_path)
    content = tiny.moving.read_text().splitlines()
    content[6:] = [f"{line}\t{'note' if k == 0 else 0.0}\t{'note' if k == 0 else 0.0}"
                   for k, line in enumerate(content[6:])]  # fmt: skip
    tiny.moving.write_text("\n".join(content) + "\n")
    monkeypatch.setattr(crew, "extract", lambda *_: (_ for _ in ()).throw(scso.EngineError("started")))
    with pytest.raises(scso.EngineError, match="started"):
        scso.load_motion(tiny.setup)


def test_a_filter_that_leaves_nothing_is_said(tmp_path, monkeypatch, caplog):
    tiny = write_tiny(tmp_path)
    tiny.setup.write_text(setup_text(lowpass_cutoff_frequency_for_coordinates="1e-3"))
    monkeypatch.setattr(crew, "extract", lambda *_: (_ for _ in ()).throw(scso.EngineError("started")))
    with pytest.raises(scso.EngineError):
        scso.load_motion(tiny.setup)
    assert "leaves next to nothing of the motion: its period is 1e+03 s" in caplog.text


# The system ---------------------------------------------------------------------------------------


@pytest.fixture
def full_disk(monkeypatch):
    """Let nothing be written any more."""

    def refuse(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", refuse)
    monkeypatch.setattr(os, "replace", refuse)


def test_a_full_disk_leaves_no_empty_settings_file(folder, full_disk):
    assert "a.toml cannot be written: No space left on device" in scso_says("init", "a.toml")
    assert not Path("a.toml").exists()


def test_a_full_disk_for_temporary_files(folder, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device", "/tmp/of/scso")

    monkeypatch.setattr(crew, "extract", refuse)
    assert "error: /tmp/of/scso: No space left on device" in scso_says("run", "setup.xml")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize("arguments", [("example",), ("init", "--reference")])
def test_output_to_a_full_disk(tmp_path, arguments):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "scso_nlp", *arguments],
            stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False,
        )  # fmt: skip
    assert done.returncode == BAD_INPUT
    assert done.stderr == "error: the output cannot be written: No space left on device\n"


def test_what_is_the_programs_own_fault_is_still_called_so(folder, monkeypatch):
    def fail(*_):
        raise OSError("no number")

    monkeypatch.setattr(crew, "extract", fail)
    assert CliRunner().invoke(app, ["run", "setup.xml"]).exit_code == BUG


def test_too_little_memory_for_the_solver_is_said_before_it_waits_for_ever(monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr(mmap, "mmap", refuse)
    ipopt._require_memory.cache_clear()
    with pytest.raises(scso.EngineError, match=r"needs 256 MB of memory.*ulimit -v"):
        scso.solve_framewise(elbow([60.0], exponent=3.0))


@pytest.mark.opensim
@pytest.mark.parametrize("first", ["import opensim", ""])
def test_opensims_library_in_casadis_way_is_said(first):
    environment = dict(os.environ)
    if not first:
        environment["LD_LIBRARY_PATH"] = str(Path(sysconfig.get_paths()["purelib"]) / "opensim")
    program = f"{first}\nimport scso_nlp\ntry: scso_nlp.solve_trajectory\n"
    program += "except scso_nlp.EngineError as error: print(error)"
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith("CasADi cannot be loaded, because OpenSim has a library of the same name")


# Files that are written ---------------------------------------------------------------------------


def comparison_of(*rows: ComparisonRow) -> Comparison:
    """Make a comparison of which the table alone is looked at."""
    comparison = Comparison.__new__(Comparison)
    object.__setattr__(comparison, "rows", rows)
    return comparison


@pytest.mark.parametrize("label", ["=1+1", "+a", "-a", "@a", "\t=1"])
def test_no_cell_of_a_table_begins_a_formula(tmp_path, label):
    row = ComparisonRow(
        result=label, group="g", metric="m", value=-1.5, low=np.nan, high=2.0, unit="-", note=""
    )
    write_comparison_csv(comparison_of(row), tmp_path / "c.csv")
    with open(tmp_path / "c.csv", newline="") as file:
        cells = list(csv.reader(file))[1]
    assert cells[0] == f"'{label}"
    assert cells[3:6] == ["-1.5", "", "2.0"]


def test_any_flipped_bit_of_a_bundle_is_found_or_changes_nothing(tmp_path):
    motion = elbow([60.0, 30.0]).motion
    path = tmp_path / "motion.npz"
    scso.save_bundle(path, motion)
    good = path.read_bytes()
    rng = np.random.default_rng(7)
    found = 0
    for place in rng.integers(len(good) * 8, size=200):
        bad = bytearray(good)
        bad[place // 8] ^= 1 << (place % 8)
        path.write_bytes(bad)
        try:
            read = scso.load_bundle(path)
        except scso.DataError:
            found += 1
        else:
            np.testing.assert_array_equal(read.trajectory.moment_arms, motion.trajectory.moment_arms)
            assert read.trajectory.muscles == motion.trajectory.muscles
            np.testing.assert_array_equal(
                read.trajectory.generalized_forces, motion.trajectory.generalized_forces
            )
    assert found > 100


# Own terms ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (
            lambda f: 1.0 if f.activation[0] > 0.5 else 2.0,
            "objective mine raised RuntimeError: Cannot compute",
        ),
        (lambda f: max(f.activation[0], f.activation[1]), "casadi.fmax and casadi.sqrt work on them"),
        (lambda f: f.no_such_field, "objective mine raised AttributeError: 'Frame' object has no"),
        (lambda f: [1][5], "objective mine raised IndexError: list index out of range"),
        (lambda f: float(f.activation[0]), "objective mine is nan in every frame"),
        (lambda f: f.activation, "objective mine returned shape (3, 1), expected one number per frame"),
        (lambda f: "x", "objective mine returned str, expected a CasADi expression"),
        (lambda f: None, "objective mine returned NoneType, expected a CasADi expression"),
    ],
)
def test_faults_of_an_own_objective_name_it(function, text):
    term = scso.FunctionObjective(function=function, label="mine")
    problem = dataclasses.replace(elbow([60.0, 30.0]), objectives=(scso.ActivationEffort(), term))
    with pytest.raises(scso.ProblemError, match=re.escape(text)):
        scso.solve_trajectory(problem)


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_an_objective_that_is_no_number_is_blamed_itself(solve):
    term = scso.FunctionObjective(function=lambda f: ca.log(-f.activation[0]), label="mine")
    problem = dataclasses.replace(elbow([60.0]), objectives=(scso.ActivationEffort(), term))
    with pytest.raises(
        scso.SolveFailed, match="objective mine, or its slope, is not a number at t = 0 s"
    ) as told:
        solve(problem)
    assert "MomentEquilibrium" not in str(told.value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Own(scso.FrameConstraint):
    """A constraint whose answer is given."""

    answer: object = None

    def rows(self, frame, motion):
        return self.answer(frame)


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (lambda f: 5, "Own returned int, expected Rows or MatrixRows"),
        (lambda f: f.activation, "Own returned SX, expected Rows or MatrixRows"),
        (lambda f: {}["x"], "constraint Own raised KeyError: 'x'"),
        (
            lambda f: scso.Rows(value="x", lower=0.0, upper=1.0, names=("a",)),
            "Rows: value is 'x', expected a CasADi",
        ),
    ],
)
def test_faults_of_an_own_constraint_name_it(answer, text):
    problem = dataclasses.replace(elbow([60.0]), constraints=(Own(answer=answer),))
    with pytest.raises(scso.ProblemError, match=re.escape(text)):
        scso.solve_trajectory(problem)


def test_masked_arrays_are_refused():
    masked = np.ma.masked_array([1450.0, 1200.0, 1000.0], mask=[False, True, False])
    muscles = elbow([60.0]).motion.muscles
    with pytest.raises(scso.DataError, match="max_isometric_force"):
        dataclasses.replace(muscles, max_isometric_force=masked)
    with pytest.raises(
        scso.ProblemError,
        match=r"q is an array of numbers of shape \(3,\) with masked entries, expected a number, ",
    ):
        scso.JointStability(q=masked)
