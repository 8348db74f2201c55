"""The choice of a muscle model on the command line and in settings files."""

import contextlib
import json

import pytest
from typer.testing import CliRunner

import scso_nlp as scso
from scso_nlp.cli import app
from scso_nlp.examples import example_folder
from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.run import describe
from scso_nlp.settings import RunSettings, read_settings

SETUP = example_folder("spine-load-height") / "setup.xml"

MODELS = {
    "opensim-rigid": scso.RigidTendon(),
    "physical-rigid": scso.RigidTendon(convention="physical"),
    "compliant": scso.CompliantTendon(),
    "none": scso.NoPhysiology(),
}


@pytest.mark.opensim
@pytest.mark.parametrize("name", MODELS)
def test_every_name_is_a_model(name):
    settings, _ = read_settings(SETUP, {"muscle_model": name})
    assert settings.muscle_model == name
    assert settings.muscle_physiology is (name != "none")
    assert describe(settings, scso.load_motion(SETUP)).muscle_model == MODELS[name]


@pytest.mark.parametrize(("physiology", "name"), [(True, "opensim-rigid"), (False, "none"), (None, "none")])
def test_the_short_form_still_chooses_between_opensims_two(physiology, name):
    """The setup of the example itself asks for no physiology."""
    assert read_settings(SETUP, {"muscle_physiology": physiology})[0].muscle_model == name


@pytest.mark.parametrize(("physiology", "name"), [(False, "compliant"), (True, "none")])
def test_two_settings_that_contradict_each_other_are_refused(physiology, name):
    with pytest.raises(ProblemError, match=f"muscle_model is '{name}' and muscle_physiology"):
        read_settings(SETUP, {"muscle_physiology": physiology, "muscle_model": name})
    assert read_settings(SETUP, {"muscle_physiology": not physiology, "muscle_model": name})


def test_an_option_wins_over_either_setting_of_the_file(tmp_path):
    file = tmp_path / "scso.toml"
    for text, changes, name in (
        ('muscle_model = "compliant"', {"muscle_physiology": False}, "none"),
        ("muscle_physiology = false", {"muscle_model": "compliant"}, "compliant"),
        ('muscle_model = "compliant"', {}, "compliant"),
    ):
        file.write_text(f"setup = '{SETUP}'\n{text}\n", encoding="utf-8")
        assert read_settings(file, changes)[0].muscle_model == name


def test_an_unknown_model_is_refused(tmp_path):
    with pytest.raises(
        DataError, match="muscle_model is 'hill', expected 'opensim-rigid' or 'physical-rigid'"
    ):
        read_settings(SETUP, {"muscle_model": "hill"})
    motion = read_settings(SETUP)[0].motion
    with pytest.raises(ProblemError, match="muscle_model is 'hill', expected one of opensim-rigid"):
        RunSettings(motion=motion, muscle_model="hill")


@pytest.mark.opensim
def test_a_run_with_elastic_tendons_writes_results_and_its_model_into_the_report(shared_data, tmp_path):
    setup = shared_data / "arm26" / "arm26_millard_Setup_StaticOptimization.xml"
    arguments = ["run", str(setup), "--muscle-model", "compliant", "--no-figures", "--output", "out"]
    with contextlib.chdir(tmp_path):
        done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert "compliant" in json.dumps(report)
    assert any(path.name.endswith("_force.sto") for path in (tmp_path / "out").iterdir())
