"""Study files: one row a trial, a column for any setting, one sentence for what is wrong."""

import pytest
from typer.testing import CliRunner

import scso_nlp as scso
from scso_nlp.cli import app
from scso_nlp.studies import plan

TABLE = """subject,trial,setup,exponent,stability,axes,q,activation_dynamics,events
S1,hold,S1/hold/setup.xml,3,potvin-brown,"y,z",5,false,0;2.5;5
S1,lift,S1/lift/setup.xml,,,,,,
"""


def test_a_table_has_a_column_for_anything_a_setting_can_be(lab):
    (lab / "study.csv").write_text(TABLE)
    first, second = plan(lab / "study.csv").trials
    assert [first.folder, second.folder] == ["S1/hold/potvin-brown", "S1/lift/off"]
    assert first.given == {
        "setup": lab / "S1/hold/setup.xml",
        "exponent": 3.0,
        "stability": "potvin-brown",
        "axes": ("y", "z"),
        "q": 5.0,
        "activation_dynamics": False,
    }
    assert first.events == (0.0, 2.5, 5.0)
    assert second.given == {"setup": lab / "S1/lift/setup.xml"}
    assert plan(lab / "study.csv").name == "study"


def test_toml_has_settings_for_all_a_grid_and_a_table_for_each_trial(lab):
    (lab / "study.toml").write_text(
        'exponent = 3.0\n[grid]\nstability = ["off", "full"]\n'
        '[[trial]]\nsubject = "S1"\ntrial = "hold"\nsetup = "S1/hold/setup.xml"\n'
        '[[trial]]\nsubject = "S2"\ntrial = "hold"\nsetup = "S2/hold/setup.xml"\nexponent = 2.5\n'
    )
    found = plan(lab / "study.toml")
    assert [trial.folder for trial in found.trials] == [
        "S1/hold/off",
        "S1/hold/full",
        "S2/hold/off",
        "S2/hold/full",
    ]
    assert [trial.settings.exponent for trial in found.trials] == [3.0, 3.0, 2.5, 2.5]
    assert len(plan(lab / "study.toml", grid={"stability": ["off", "diagonal"]}).trials) == 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "begins with nothing, expected a line of different names, subject and trial among them"),
        ("subject,setup\nS1,a.xml\n", "begins with subject, setup, expected"),
        ("subject,trial,trial\n", "begins with subject, trial, trial, expected"),
        ("subject,trial\n", "names no trial"),
        ("subject,trial,q\nS1,a\n", "trial 1 has 2 cells, expected 3"),
        ("subject,trial,q\nS1,a,5\nS1,,5\n", "trial 2: trial is '', expected a name"),
        ("subject,trial,qq\nS1,a,5\n", "trial 1: unknown setting 'qq'"),
        ("subject,trial,q\nS1,a,five\n", "trial 1: q is 'five', expected a number"),
        (
            "subject,trial,events\nS1,a,1\n",
            "trial 1: events is .*expected a list of at least two rising",
        ),
        ("subject,trial,events\nS1,a,1;now\n", "trial 1: events is '1;now', expected times"),
        ("subject,trial,activation_dynamics\nS1,a,yes\n", "activation_dynamics is 'yes', expected true or"),
    ],
)
def test_a_table_that_is_none_is_said(tmp_path, text, words):
    (tmp_path / "study.csv").write_text(text)
    with pytest.raises(scso.DataError, match=words):
        plan(tmp_path / "study.csv")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "names no trial, expected tables"),
        ("trial = 3", "names no trial, expected tables"),
        ('grid = 3\n[[trial]]\nsubject = "a"\ntrial = "b"\n', "grid is 3, expected a table"),
        ("[[trial]]\nsubject = 3\n", "trial 1: subject is 3, expected a name"),
        ('[[trial]]\nsubject = "a"\ntrial = "b"\nqq = 3\n', "trial 1: unknown setting 'qq'"),
    ],
)
def test_toml_that_is_none_is_said(tmp_path, text, words):
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(scso.DataError, match=words):
        plan(tmp_path / "study.toml")


def test_a_dry_run_prints_what_would_be_run_and_what_is_missing(lab):
    (lab / "study.csv").write_text(TABLE)
    (lab / "S1/lift/motion.mot").unlink()
    done = CliRunner().invoke(
        app, ["batch", str(lab / "study.csv"), "--dry-run", "--formulation", "off,full"]
    )
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert "1 subject, 2 trials, 2 conditions: 4 runs, 2 of them with input that cannot be used" in lines[0]
    assert sum("elbow.osim   motion.mot   external_loads.xml" in line for line in lines) == 2
    assert "coordinates_file 'motion.mot' does not exist" in " ".join(done.output.split())
    assert not (lab / "scso_results").exists()
