"""Plans: what a path holds, by which settings, and what is wrong with it before anything runs."""

import pytest

import scso_nlp as scso
from scso_nlp.studies import Plan, plan


def named(found: Plan) -> list[str]:
    return [trial.folder for trial in found.trials]


def test_plain_folders_are_subjects_and_trials(lab):
    found = plan(lab)
    assert named(found) == ["S1/hold/off", "S1/lift/off", "S2/hold/off"]
    assert repr(found) == (
        f"2 subjects, 3 trials, 1 condition: 3 runs from {lab} (setup files of AnalyzeTool, or scso.toml)"
    )
    assert found.name == "lab"
    assert [trial.settings.setup for trial in found.trials] == [
        lab / "S1/hold/setup.xml",
        lab / "S1/lift/setup.xml",
        lab / "S2/hold/setup.xml",
    ]


def test_several_setups_of_a_folder_are_as_many_trials(lab):
    (lab / "S1/hold/fast.xml").write_bytes((lab / "S1/hold/setup.xml").read_bytes())
    assert named(plan(lab))[:2] == ["S1/hold_fast/off", "S1/hold_setup/off"]


@pytest.mark.parametrize(
    ("start", "names"),
    [
        ("S1", ["hold/setup/off", "lift/setup/off"]),
        ("S1/hold", ["hold/setup/off"]),
        ("*/hold/setup.xml", ["S1/hold/off", "S2/hold/off"]),
        ("S2/hold/setup.xml", ["hold/setup/off"]),
        ("**/*.xml", None),
    ],
)
def test_a_folder_a_pattern_or_a_file_may_be_named(lab, start, names):
    if names is None:
        # external_loads.xml is no setup: its trials cannot be run, the others can
        problems = [trial.problem for trial in plan(str(lab / start)).trials]
        assert [bool(problem) for problem in problems] == [True, False] * 3
        assert "holds ExternalLoads, expected an AnalyzeTool setup" in problems[0]
    else:
        assert named(plan(str(lab / start))) == names


def test_setups_may_be_named_one_by_one(lab):
    assert named(plan([lab / "S1/hold/setup.xml", lab / "S2/hold/setup.xml"])) == [
        "S1/hold/off",
        "S2/hold/off",
    ]


def test_settings_of_study_person_and_trial_are_inherited_and_the_deeper_wins(lab):
    (lab / "scso.toml").write_text('exponent = 3.0\nstability = "potvin-brown"\naxes = ["z"]\nq = 20\n')
    (lab / "S1/scso.toml").write_text("exponent = 4.0\n")
    (lab / "S1/lift/scso.toml").write_text('stability = "full"\nevents = [0, 2, 4]\n')
    hold, lift, other = plan(lab).trials
    assert [trial.settings.exponent for trial in (hold, lift, other)] == [4.0, 4.0, 3.0]
    assert [trial.condition for trial in (hold, lift, other)] == ["potvin-brown", "full", "potvin-brown"]
    # axes has no effect on the whole Hessian, q has
    assert "axes" not in lift.given
    assert lift.given["q"] == 20
    assert (lift.events, hold.events) == ((0.0, 2.0, 4.0), None)


def test_paths_in_a_settings_file_are_relative_to_it_and_settings_of_the_call_win(lab):
    (lab / "scso.toml").write_text('model = "other.osim"\nfinal_time = 4\n')
    (lab / "other.osim").write_bytes((lab / "S1/hold/elbow.osim").read_bytes())
    found = plan(lab, final_time=2.0)
    assert {trial.settings.motion.model for trial in found.trials} == {lab / "other.osim"}
    assert {trial.settings.motion.final_time for trial in found.trials} == {2.0}


def test_a_folder_may_have_a_settings_file_in_place_of_a_setup(lab):
    (lab / "S2/hold/setup.xml").unlink()
    (lab / "S2/hold/scso.toml").write_text('model = "elbow.osim"\ncoordinates = "motion.mot"\n')
    assert named(plan(lab))[-1] == "S2/hold/off"


def test_every_trial_is_there_by_every_condition(lab):
    found = plan(lab / "S1", grid={"stability": ["off", "potvin-brown"], "q": [3, 5]}, axes=["z"])
    conditions = ["off", "potvin-brown_q=3", "potvin-brown_q=5"]
    assert [trial.condition for trial in found.trials] == 2 * conditions
    assert [trial.settings.stability is None for trial in found.trials[:3]] == [True, False, False]
    assert found.grid == {"stability": ["off", "potvin-brown"], "q": [3.0, 5.0]}


def test_one_value_in_a_grid_is_a_setting_of_all(lab):
    found = plan(lab / "S1", grid={"stability": ["potvin-brown"], "q": [3, 5]})
    assert [trial.condition for trial in found.trials] == 2 * ["q=3", "q=5"]


def test_what_is_wrong_with_one_trial_concerns_it_alone(lab):
    (lab / "S1/hold/motion.mot").unlink()
    (lab / "S1/lift/scso.toml").write_text("expnent = 3\n")
    hold, lift, other = plan(lab).trials
    assert "coordinates_file 'motion.mot' does not exist" in hold.problem
    assert "scso.toml: unknown setting 'expnent' (closest: exponent" in lift.problem
    assert other.problem == ""
    assert "2 of them with input that cannot be used" in repr(plan(lab))


def test_what_is_wrong_with_all_is_raised(lab):
    with pytest.raises(scso.DataError, match="q has no effect while stability is off"):
        plan(lab, grid={"q": [3, 5]})
    (lab / "scso.toml").write_text("expnent = 3\n")
    with pytest.raises(scso.DataError, match="unknown setting 'expnent'"):
        plan(lab)


def test_a_setting_that_is_not_known_is_raised(lab):
    with pytest.raises(scso.NameMismatchError, match="unknown setting 'qq'"):
        plan(lab, qq=3)


@pytest.mark.parametrize("name", ["output", "cache", "processes", "overwrite"])
def test_what_the_study_decides_cannot_be_set(lab, name):
    with pytest.raises(scso.ProblemError, match=f"{name} cannot be set for trials"):
        plan(lab, **{name: "x"})


def test_a_setting_in_the_grid_and_for_all_is_refused(lab):
    with pytest.raises(scso.ProblemError, match="q is in the grid and set for all"):
        plan(lab, grid={"q": [3, 5]}, q=4, stability="full")


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("nowhere", "does not exist, expected setup files, one folder or one study file"),
        ("*.nothing", "no file fits "),
        ("empty", "holds no trial: expected setup files of AnalyzeTool, or scso.toml, OpenCap sessions"),
    ],
)
def test_a_path_without_a_trial_is_said(tmp_path, path, words):
    (tmp_path / "empty").mkdir()
    with pytest.raises(scso.DataError, match=words):
        plan(str(tmp_path / path))


def test_results_and_hidden_folders_are_no_trials(lab):
    put = (lab / "scso_results/lab/S1/hold", lab / ".cache/S3/hold", lab / "old/S1/hold")
    for folder in put:
        folder.mkdir(parents=True)
        (folder / "setup.xml").write_bytes((lab / "S1/hold/setup.xml").read_bytes())
    (lab / "old/study.json").write_text("{}")
    assert named(plan(lab)) == ["S1/hold/off", "S1/lift/off", "S2/hold/off"]


def test_two_trials_of_one_folder_are_refused(tmp_path):
    table = "subject,trial,model,coordinates\nS1,a b,m.osim,x.mot\nS1,a_b,m.osim,y.mot\n"
    (tmp_path / "study.csv").write_text(table)
    with pytest.raises(scso.NameMismatchError, match="would both be S1/a_b/off"):
        plan(tmp_path / "study.csv")


def test_a_table_says_what_is_read_and_what_is_missing(lab):
    pytest.importorskip("pandas")
    (lab / "S1/hold/motion.mot").unlink()
    found = plan(lab, exponent=3.0)
    table = found.table()
    assert list(table["trial"]) == ["hold", "lift", "hold"]
    assert (table["exponent"] == 3.0).all()
    assert "does not exist" in table["missing"][0]
    assert [row[3:6] for row in found.rows()[1:]] == 2 * [("elbow.osim", "motion.mot", "external_loads.xml")]
