"""The command line, from outside: exit codes, messages, files."""

import contextlib
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import scso_nlp.run
from scso_nlp.cli import app
from scso_nlp.declared_settings import SETTINGS, reference, template
from scso_nlp.emg import read_emg_map
from scso_nlp.examples import example_folder, example_names
from scso_nlp.io import read_storage

pytestmark = pytest.mark.opensim


def scso(*arguments, cwd):
    """Run in this process, which is faster; what must hold from outside goes through `from_outside`."""
    with contextlib.chdir(cwd):
        done = CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="scso")
    done.returncode = done.exit_code
    return done


def from_outside(*arguments, cwd):
    command = [sys.executable, "-m", "scso_nlp", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def spine(tmp_path) -> Path:
    """A writable copy of an example."""
    folder = tmp_path / "spine"
    shutil.copytree(example_folder("spine-load-height"), folder)
    return folder


def test_help_comes_fast_and_without_loading_solver_or_figures(tmp_path):
    started = time.perf_counter()
    done = from_outside("--help", cwd=tmp_path)
    elapsed = time.perf_counter() - started
    assert done.returncode == 0
    for command in ("run", "init", "example"):
        assert command in done.stdout
    # 0.2 s on an idle machine; the limit leaves room for a busy one
    assert elapsed < 5.0
    heavy = {"casadi", "scipy", "matplotlib", "opensim", "numpy", "pydantic"}
    check = f"import sys, scso_nlp.cli; print(sorted({heavy} & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"


def test_examples_are_listed_with_one_line_each(tmp_path):
    done = scso("example", cwd=tmp_path)
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(example_names())
    assert all(len(line) < 130 and len(line.split()) > 4 for line in lines)
    assert files(tmp_path) == set()


def test_an_example_runs_to_files_and_figures(tmp_path):
    done = from_outside("example", "spine-load-height", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "scso_results" / "spine-load-height"
    for part in ("static_optimization", "with_stability"):
        found = files(folder / part)
        assert "report.json" in found
        assert "spine_load_height_StaticOptimization_force.sto" in found
        assert "spine_load_height_activations.png" in found
    assert "spine_load_height_stability.sto" in files(folder / "with_stability")
    assert len([line for line in done.stdout.splitlines() if line.count("lumbar_pelvis_") == 2]) == 10


def test_a_run_tells_its_answer_before_files_and_figures_and_then_what_each_stage_took(spine, monkeypatch):
    write = scso_nlp.run.write_run

    def late(*arguments):
        typer.echo("now the files")
        return write(*arguments)

    monkeypatch.setattr("scso_nlp.run.write_run", late)
    done = scso("run", "setup.xml", "--stability", "potvin-brown", "--output", "results", cwd=spine)
    assert done.returncode == 0
    before, after = done.stdout.split("now the files\n")
    assert "all 10 frames solved" in before
    assert "least margin" in before
    seconds = json.loads((spine / "results" / "report.json").read_text())["seconds"]
    assert list(seconds) == ["extraction", "baseline", "build", "solve", "writing", "figures"]
    assert after.splitlines()[0] == "  " + ", ".join(f"{k} {v:.2f} s" for k, v in seconds.items())


def test_a_run_without_figures_imports_nothing_that_only_they_need(spine):
    heavy = {"matplotlib", "scipy.signal", "scipy.stats", "PIL"}
    check = f"""
import sys
from scso_nlp.cli import app
app(["run", "setup.xml", "--output", "results", *sys.argv[1:]], standalone_mode=False)
print(sorted({heavy} & set(sys.modules)))
"""
    for options, loaded in ((["--no-figures"], []), ([], ["PIL", "matplotlib"])):
        command = [sys.executable, "-c", check, *options]
        done = subprocess.run(command, cwd=spine, capture_output=True, text=True, check=True)
        assert done.stdout.splitlines()[-1] == str(loaded)


def test_a_plain_setup_file_gives_results_and_exit_code_0(spine):
    done = scso("run", spine / "setup.xml", "--no-figures", cwd=spine.parent)
    assert (done.returncode, done.stderr) == (0, "")
    # beside the setup file and by its name, wherever the command is given
    folder = spine / "scso_results" / "setup"
    assert (
        f"results in {folder}\n  the setup's results_directory {spine / 'results'} is not used" in done.stdout
    )
    assert files(folder) == {
        "spine_load_height_StaticOptimization_activation.sto",
        "spine_load_height_StaticOptimization_force.sto",
        "spine_load_height_StaticOptimization_controls.xml",
        "spine_load_height_moments.sto",
        "spine_load_height_status.sto",
        "report.json",
    }
    report = json.loads((folder / "report.json").read_text())
    assert set(report["inputs_sha256"]) == {
        str(spine / name)
        for name in ("setup.xml", "spine.osim", "motion.mot", "external_loads.xml", "loads.mot")
    }


def test_options_and_settings_file_give_the_same_numbers(spine):
    options = ("--stability", "potvin-brown", "--q", "3", "--joints", "lumbar_pelvis", "--axes", "x,z")
    by_options = scso("run", spine / "setup.xml", *options, "--no-figures", "--output", "a", cwd=spine)
    (spine / "mine.toml").write_text(
        'setup = "setup.xml"\nstability = "potvin-brown"\nq = 3\njoints = ["lumbar_pelvis"]\n'
        'axes = ["x", "z"]\nfigures = false\noutput = "b"\nsolver = "framewise"\n'
    )
    by_file = scso("run", "mine.toml", cwd=spine)
    assert (by_options.returncode, by_file.returncode) == (0, 0), by_options.stderr + by_file.stderr
    name = "spine_load_height_StaticOptimization_activation.sto"
    # the objective is known to 1e-8 and quadratic, so activations may differ by more; 2e-6 was seen
    np.testing.assert_allclose(
        read_storage(spine / "a" / name).values, read_storage(spine / "b" / name).values, rtol=0, atol=1e-5
    )
    assert (
        read_storage(spine / "a" / "spine_load_height_stability.sto").labels[4].startswith("lumbar_pelvis_z")
    )


def test_the_file_of_init_runs_once_its_path_is_filled_in(spine):
    (spine / "scso.toml").unlink()
    assert scso("init", cwd=spine).returncode == 0
    # the example's setup file has the name that the template takes
    assert (spine / "scso.toml").read_text() == template()
    run = scso("run", "scso.toml", "--no-figures", "--output", "results", cwd=spine)
    assert run.returncode == 0, run.stderr
    assert "spine_load_height_stability.sto" in files(spine / "results")


def test_the_files_of_an_example_can_be_had_and_run(tmp_path):
    assert scso("example", "elbow", "--copy", "mine", cwd=tmp_path).returncode == 0
    assert files(tmp_path / "mine") == {path.name for path in example_folder("elbow").iterdir()}
    again = scso("example", "elbow", "--copy", "mine", cwd=tmp_path)
    assert again.returncode == 2
    assert "exists already" in again.stderr
    assert scso("run", "mine/setup.xml", "--no-figures", cwd=tmp_path).returncode == 0


def test_init_writes_an_emg_map_of_a_model(spine):
    done = scso("init", "--emg-map", "spine.osim", cwd=spine)
    assert done.returncode == 0
    found = read_emg_map(spine / "emg_map.toml")
    muscles = [muscle for group in found.groups for muscle in group.muscles]
    assert len(muscles) == 12
    assert [group.muscles for group in found.groups if group.name == "ES_L"] == [("ES1_L", "ES2_L", "ES3_L")]
    wrong = scso("init", "other.toml", "--emg-map", "motion.mot", cwd=spine)
    assert wrong.returncode == 2
    assert "motion.mot" in wrong.stderr


def test_init_leaves_an_existing_file_alone(tmp_path):
    (tmp_path / "mine.toml").write_text("mine")
    done = scso("init", "mine.toml", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "error: mine.toml exists already, choose another name\n")
    assert (tmp_path / "mine.toml").read_text() == "mine"


def test_the_reference_page_is_printed_and_nothing_is_written(tmp_path):
    done = scso("init", "--reference", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, reference())
    assert files(tmp_path) == set()


def test_every_setting_is_in_the_report(spine):
    options = ("--stability", "full", "--coordinates", "lumbar_pelvis_flexion", "--frames-per-program", "3")
    done = scso("run", "setup.xml", *options, "--output", "results", "--no-figures", cwd=spine)
    assert done.returncode == 0, done.stderr
    report = json.loads((spine / "results" / "report.json").read_text())
    assert list(report["settings"]) == list(SETTINGS)
    told = {name: report["settings"][name] for name in ("stability", "q", "stiffness", "frames_per_program")}
    assert told == {"stability": "full", "q": 5.0, "stiffness": "proportional", "frames_per_program": 3}
    assert report["settings"]["output"] == str(spine / "results")
    assert "the setup's output_precision 16 is not used: results have all digits" in report["notes"]


def test_infeasible_frames_give_exit_code_1_and_nothing_that_looks_like_a_result(shared_data, tmp_path):
    setup = shared_data / "gait10dof18musc" / "setup_without_actuators.xml"
    done = scso("run", setup, "--output", "results", cwd=tmp_path)
    assert done.returncode == 1
    assert "73 of 73 frames failed (infeasible)" in done.stderr
    assert "MomentEquilibrium[pelvis_ty] short by" in done.stderr
    assert "  try --actuators RESERVES.xml: muscles and actuators cannot make the moments of" in done.stderr
    assert files(tmp_path) == {"results/report.json", "results/gait10dof18musc_weak_status.sto"}


def test_the_whole_hessian_is_kept_and_its_smallest_eigenvalue_and_mode_are_written(spine):
    """At level 0 every axis alone would be stable at a smaller cost."""
    tables, objectives = {}, {}
    for method in ("potvin-brown", "diagonal", "full"):
        done = scso("run", "setup.xml", "--stability", method, "--no-figures", "--output", method, cwd=spine)
        assert done.returncode == 0, done.stderr
        tables[method] = read_storage(spine / method / "spine_load_height_stability.sto")
        report = json.loads((spine / method / "report.json").read_text())
        objectives[method] = report["objective"]["total"]
        assert "array" not in str(report["problem"])
    # hinges and straight paths: the two rules per axis are the same, to the solver's tolerance
    assert objectives["diagonal"] == pytest.approx(objectives["potvin-brown"], rel=1e-6)
    assert objectives["full"] > 3 * objectives["diagonal"]
    full = tables["full"]
    # eigenvalues below their level by less than 1e-5 N·m/rad count as kept
    assert full.column("smallest_eigenvalue_stability").min() > -1e-5
    coordinates = [label.removeprefix("mode_") for label in full.labels if label.startswith("mode_")]
    assert len(coordinates) == 6
    modes = full.columns([f"mode_{name}" for name in coordinates])
    np.testing.assert_allclose(np.linalg.norm(modes, axis=1), 1, atol=1e-12)
    for name in coordinates:
        assert (full.column(f"{name}_margin") > 0).all()
        assert tables["diagonal"].column(f"{name}_margin").min() > -1e-5


def test_passive_stiffness_lowers_the_cost_and_a_price_lets_levels_be_missed(spine):
    (spine / "passive.toml").write_text("lumbar_pelvis_flexion = 30\nlumbar_pelvis_abduction_right = 30\n")
    cost = {}
    for name, options in {
        "alone": (),
        "helped": ("--passive", "passive.toml"),
        "coordinates": ("--coordinates", "lumbar_pelvis_flexion,lumbar_pelvis_abduction_right"),
        "missed": ("--soft", "1e-4"),
        "stiffer": ("--q", "9"),
    }.items():
        arguments = ("--stability", "full", *options, "--no-figures", "--output", name)
        done = scso("run", "setup.xml", *arguments, cwd=spine)
        report = json.loads((spine / name / "report.json").read_text())
        is_missed = "STABILITY_MISSED" in report["status_counts"]
        assert done.returncode == is_missed == (name == "missed"), done.stderr
        assert ("levels missed in" in done.stdout) == is_missed
        cost[name] = report["objective"]["terms"]["ActivationEffort"]
    assert max(cost["helped"], cost["coordinates"], cost["missed"], cost["stiffer"]) < 0.99 * cost["alone"]


def test_failed_frames_can_be_kept_and_the_exit_code_stays_1(spine):
    options = ("--stability", "potvin-brown", "--level", "1000", "--keep-failed", "--no-figures")
    done = scso("run", spine / "setup.xml", *options, "--output", "results", cwd=spine)
    assert done.returncode == 1
    assert "short by" in done.stderr
    assert "  try --level 0: at level 0 they have an answer\n  try --soft 1: " in done.stderr
    table = read_storage(spine / "results" / "spine_load_height_StaticOptimization_activation.sto")
    assert np.isnan(table.values).any(axis=1).any()


def test_two_trials_of_one_name_and_a_failed_run_lose_nothing(spine):
    """Every laboratory has trials whose AnalyzeTool has the same name."""
    other = spine.parent / "other"
    shutil.copytree(spine, other)
    edit(other / "motion.mot", "5\t0\t0", "5\t0.1\t0")
    first = spine.parent / "results"
    second = first.with_name("results_2")
    assert (
        scso("run", spine / "setup.xml", "--no-figures", "--output", "results", cwd=spine.parent).returncode
        == 0
    )
    before = {path: path.read_bytes() for path in first.iterdir()}
    done = scso("run", other / "setup.xml", "--no-figures", "--output", "results", cwd=spine.parent)
    assert (done.returncode, f"results in {second}\n" in done.stdout) == (0, True), done.stderr
    assert done.stderr == (
        f"scso: {first} has results of other inputs, which stay; those of this run go to {second}\n"
    )
    options = ("--stability", "potvin-brown", "--level", "1000")
    done = scso("run", spine / "setup.xml", "--no-figures", "--output", "results", *options, cwd=spine.parent)
    assert done.returncode == 1
    assert f"status and report, no results, in {first / 'failed'}\n" in done.stdout
    assert f"earlier results in {first} stay" in done.stderr
    assert {path: path.read_bytes() for path in first.iterdir() if path.is_file()} == before
    done = scso(
        "run", other / "setup.xml", "--no-figures", "--output", "results", "--overwrite", cwd=spine.parent
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert {path.name for path in first.iterdir()} == {path.name for path in before}
    assert (first / "report.json").read_bytes() != before[first / "report.json"]


def test_two_setup_files_in_one_folder_have_results_of_their_own(spine):
    """Though their AnalyzeTool has the same name; also where the folder may not be shared."""
    late = spine / "late.xml"
    late.write_text((spine / "setup.xml").read_text().replace("<initial_time>0<", "<initial_time>1<"))
    for setup in ("setup", "late"):
        done = scso("run", spine / f"{setup}.xml", "--no-figures", cwd=spine.parent)
        assert (done.returncode, done.stderr) == (0, "")
    reports = [
        json.loads((spine / "scso_results" / s / "report.json").read_text()) for s in ("setup", "late")
    ]
    assert reports[0]["name"] == reports[1]["name"]
    assert {path.name for path in (spine / "scso_results").iterdir()} == {"setup", "late"}


def test_where_results_cannot_go_is_said_before_the_motion_is_read(spine):
    (spine / "taken").write_text("a file")
    for output, taken in (("taken", "taken"), ("taken/below", "taken")):
        done = scso("run", spine / "setup.xml", "--output", output, cwd=spine)
        assert done.returncode == 2
        assert done.stderr == f"error: {spine / taken} is a file, expected a folder for the results\n"
    done = scso("run", spine / "setup.xml", "--output", "a" * 300, cwd=spine)
    assert done.returncode == 2
    assert done.stderr == f"error: results cannot be written to {spine / ('a' * 300)}: File name too long\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nothing.xml",), "nothing.xml does not exist"),
        (("setup.xml", "--exponent", "0.5"), "exponent is 0.5"),
        (("setup.xml", "--stability", "yes"), "stability is 'yes', expected 'off' or 'potvin-brown'"),
        (("setup.xml", "--q", "5"), "q has no effect while stability is off"),
        (("setup.xml", "--stability", "full", "--axes", "z"), "axes has no effect while stability is 'full'"),
        (("setup.xml", "--stability", "full", "--coordinates", "knee"), "unknown coordinate 'knee'"),
        (("setup.xml", "--stability", "diagonal", "--stiffness", "soft"), "stiffness is 'soft'"),
        (("setup.xml", "--stability", "diagonal", "--passive", "none.toml"), "none.toml does not exist"),
        (("setup.xml", "--stability", "full", "--soft", "-1"), "soft is -1, expected a positive price"),
        (("setup.xml", "--stability", "potvin-brown", "--q", "-1"), "q is -1"),
        (("setup.xml", "--stability", "potvin-brown", "--q", "five"), "q is 'five', expected a number"),
        (("setup.xml", "--stability", "potvin-brown", "--q", "RAA_R=5,*=3"), "RAA_R"),
        (("setup.xml", "--stability", "potvin-brown", "--joints", "lumbar_pelvic"), "lumbar_pelvic"),
        (("setup.xml", "--stability", "potvin-brown", "--axes", "w"), "'w'"),
        (("setup.xml", "--stability", "potvin-brown", "--level", "lumbar_z=5"), "lumbar_z"),
        (("setup.xml", "--solver", "fast"), "solver is 'fast'"),
        (("setup.xml", "--processes", "0"), "processes is 0"),
        (("setup.xml", "--exponent", "two"), "exponent is 'two', expected a number (--exponent NUMBER)"),
        (("setup.xml", "--weights", "ES*=heavy"), "weights is 'ES*=heavy', expected 'volume' or 'pcsa'"),
        (
            ("setup.xml", "--stability", "full", "--stiffness", "fiber", "--q", "5"),
            "q has no effect on fiber",
        ),
        (("setup.xml", "--setup", "setup.xml"), "is taken as a setup, but the options name another"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(spine, arguments, message):
    before = files(spine)
    done = scso("run", *arguments, cwd=spine)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "Traceback" not in done.stderr
    assert files(spine) == before


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("setup.xml", "</AnalyzeTool>", "", "setup.xml is not well-formed XML"),
        ("setup.xml", "<OpenSimDocument", '<!DOCTYPE a [<!ENTITY b "c">]>\n<OpenSimDocument', "XML entities"),
        (
            "setup.xml",
            "<initial_time>0</initial_time>\n\t\t<final_time>9<",
            "<initial_time>10</initial_time>\n\t\t<final_time>99<",
            "the time range 10 to 99 s is outside",
        ),
        ("setup.xml", "motion.mot", "walk.mot", "'walk.mot' does not exist"),
        ("motion.mot", "5\t0\t0", "5\tnan\t0", "lumbar_pelvis_flexion"),
        ("motion.mot", "lumbar_pelvis_flexion", "pelvis_flexion", "lumbar_pelvis_flexion"),
        ("setup.xml", "motion.mot", "walk\x7f.mot", r"walk\x7f.mot' does not exist"),
        ("external_loads.xml", "loads.mot", "forces.mot", "'forces.mot' does not exist"),
        ("spine.osim", "</Model>", "", "spine.osim"),
    ],
)
def test_unusable_files_are_one_sentence_and_exit_code_2(spine, name, old, new, message):
    edit(spine / name, old, new)
    before = files(spine)
    done = scso("run", "setup.xml", cwd=spine)
    assert done.returncode == 2, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert message in errors[0]
    assert "Traceback" not in done.stderr
    assert files(spine) == before


def test_a_model_that_opensim_refuses_is_one_sentence_and_exit_code_2(shared_data, tmp_path):
    done = scso("run", shared_data / "arm26" / "arm26_Setup_StaticOptimization.xml", cwd=tmp_path)
    assert done.returncode == 2
    assert "OpenSim refused arm26.osim" in done.stderr
    assert "minimum_activation" in done.stderr
    assert files(tmp_path) == set()


@pytest.mark.parametrize(
    ("folder", "setup", "name"),
    [
        ("arm26", "arm26_millard_Setup_StaticOptimization.xml", "arm26_millard"),
        ("gait10dof18musc", "setup_static_optimization.xml", "gait10dof18musc"),
    ],
)
def test_a_plain_setup_file_answers_as_opensims_own_tool(shared_data, tmp_path, folder, setup, name):
    source = shared_data / folder / setup
    script = (
        "import sys, opensim; opensim.Logger.setLevelString('Off'); tool = opensim.AnalyzeTool(sys.argv[1]); "
        "tool.setResultsDir(sys.argv[2]); tool.run()"
    )
    subprocess.run([sys.executable, "-c", script, source, tmp_path / "opensim"], check=True, timeout=300)
    done = scso("run", source, "--no-figures", "--output", "ours", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for kind in ("activation", "force"):
        file = f"{name}_StaticOptimization_{kind}.sto"
        theirs, ours = read_storage(tmp_path / "opensim" / file), read_storage(tmp_path / "ours" / file)
        assert ours.name == theirs.name
        assert ours.labels == theirs.labels
        # the file holds times to the printed digits
        np.testing.assert_allclose(ours.time, theirs.time, rtol=0, atol=1e-8)
        if kind == "activation":
            # OpenSim's own optimizer stops up to 0.01 from the optimum of its problem
            np.testing.assert_allclose(ours.values, theirs.values, rtol=0, atol=0.01)
        else:
            loads = [i for i, label in enumerate(ours.labels) if label.startswith("calcn_")]
            np.testing.assert_allclose(ours.values[:, loads], theirs.values[:, loads], rtol=1e-6, atol=1e-5)


def test_a_misspelled_option_has_exit_code_2(tmp_path):
    done = scso("run", "setup.xml", "--stabilty", "off", cwd=tmp_path)
    assert done.returncode == 2
    assert "No such option" in done.stderr


def test_a_bug_shows_its_traceback_and_is_told_apart_from_a_failed_frame(spine):
    broken = "import scso_nlp.run as r\ndef f(*a): raise RuntimeError('broken')\nr.run = f\n"
    broken += "from scso_nlp.cli import app\napp(['run', 'setup.xml'])\n"
    done = subprocess.run(
        [sys.executable, "-c", broken], cwd=spine, capture_output=True, text=True, check=False
    )
    assert done.returncode == 3
    assert "RuntimeError: broken" in done.stderr
    assert "this is a bug" in done.stderr


def test_verbose_says_what_is_being_done(spine):
    quiet = scso("run", spine / "setup.xml", "--no-figures", cwd=spine)
    loud = scso("run", spine / "setup.xml", "--no-figures", "--verbose", cwd=spine)
    assert quiet.stderr == ""
    assert "iterations" in loud.stderr
