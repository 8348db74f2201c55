"""``scso calibrate`` finds a gain, writes settings with it that ``scso run`` takes, and destroys nothing."""

from __future__ import annotations

import json
import shutil
import tomllib

import pytest
from typer.testing import CliRunner

import scso_nlp as scso
from scso_nlp.cli import app
from scso_nlp.examples import example_folder
from scso_nlp.settings import read_settings

pytestmark = pytest.mark.opensim
EXAMPLE = example_folder("spine-load-height")
#: Gain of the made up EMG.
TRUE = 8.0


def scso_(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Two trials of five tasks each, and EMG of their muscles at a known gain; OpenSim reads them once."""
    folder = tmp_path_factory.mktemp("trials")
    shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
    rows = scso.JointStability(q=TRUE)
    solution = scso.solve(folder / "setup.xml", stability=rows, cache=folder / "cache")
    table = solution.to_dataframe()
    table.columns = list(table.columns)
    table.to_csv(folder / "emg.csv")
    groups = "".join(f'[groups."{m}"]\nchannels = ["{m}"]\nmuscles = ["{m}"]\n' for m in table.columns)
    (folder / "map.toml").write_text("format = 1\n" + groups, encoding="utf-8")
    for name, first, last in (("light", 0.0, 4.0), ("heavy", 5.0, 9.0)):
        (folder / f"{name}.toml").write_text(
            f'setup = "setup.xml"\nname = "{name}"\nstability = "potvin-brown"\nsoft = 1.0\n'
            f'initial_time = {first}\nfinal_time = {last}\ncache = "cache"\n'
            'emg = "emg.csv"\nemg_map = "map.toml"\nemg_compare = "levels"\n',
            encoding="utf-8",
        )
    return folder


def test_a_known_gain_is_found_and_written_for_a_run(trials, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = scso_("calibrate", trials / "light.toml", trials / "heavy.toml")
    assert done.exit_code == 0, done.output
    assert "each left out once, 2 units" in done.stdout
    folder = tmp_path / "scso_results" / "calibration"
    found = json.loads((folder / "calibration.json").read_text(encoding="utf-8"))
    assert found["parameters"] == ["q"]
    assert found["units"] == ["light", "heavy"]
    assert found["value"] == [pytest.approx(TRUE, rel=1e-3)]
    given, _ = read_settings(folder / "heavy.toml")
    assert given.stability.q == pytest.approx(TRUE, rel=1e-3)
    assert given.emg.file == trials / "emg.csv"
    run = scso_("run", folder / "heavy.toml", "--no-figures", "--output", tmp_path / "run")
    assert run.exit_code == 0, run.output


def test_the_same_calibration_replaces_its_results_and_another_leaves_them(trials, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one = ("calibrate", trials / "light.toml", "--same-data")
    folder = tmp_path / "scso_results" / "calibration"
    for _ in range(2):
        done = scso_(*one)
        assert done.exit_code == 0, done.output
        assert "results of" not in done.stderr
        assert [path.name for path in folder.parent.iterdir()] == ["calibration"]
    before = (folder / "calibration.json").read_bytes()
    # a path of the options, bounds that stop short of 8, and groups are other questions
    other = scso_(*one, "--calibrated", "q[RA*,EO*]", "--calibration-bounds", "q[RA*,EO*]=1 5.5")
    assert other.exit_code == 0, other.output
    assert f"{folder} has results of another calibration, which stay; those of this run go to" in other.stderr
    assert (folder / "calibration.json").read_bytes() == before
    settings = tomllib.loads((folder.with_name("calibration_2") / "light.toml").read_text(encoding="utf-8"))
    assert list(settings["q"]) == ["*", "RA*", "EO*"]
    assert settings["q"]["RA*"] == pytest.approx(5.5)
    assert settings["calibration_bounds"] == {"q[RA*,EO*]": [1.0, 5.5]}
    assert "at its bound" in other.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--stability", "off"], "stability is off"),
        (["--emg-tracking", "1"], "activations are held to EMG"),
        (["--measured-stiffness", "100"], "one of the two"),
        ([], "there is one unit, 'light'"),
        (["--calibrated", "weights"], "weights cannot be calibrated"),
        (["--calibration-bounds", "q=9 2"], "bounds of q are 9 and 2, expected positive, finite numbers"),
        (["--calibration-bounds", "q=9"], "expected a table"),
    ],
)
def test_what_cannot_be_calibrated_is_one_sentence(trials, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    done = scso_("calibrate", trials / "light.toml", *options)
    assert done.exit_code == 2, done.output
    assert words in done.stderr
    assert not (tmp_path / "scso_results").exists()


def test_trials_of_one_name_are_refused(trials, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = scso_("calibrate", trials / "light.toml", trials / "light.toml")
    assert done.exit_code == 2
    assert "two trials are called 'light'" in done.stderr
