"""What comes out of a study, against the files that it is read from."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from studies.small_study import make_study

import scso_nlp as scso
from scso_nlp import studies
from scso_nlp.examples import example_folder
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.io.storage import read_storage
from scso_nlp.studies.record import read_outcome, write_outcome

pytestmark = pytest.mark.opensim

SPINE = example_folder("spine-load-height") / "setup.xml"


@pytest.fixture(scope="module")
def spine(tmp_path_factory):
    """Two people, the second with the lighter load alone, three formulations each."""
    folder = tmp_path_factory.mktemp("spine")
    both = {("A", "lift"): (SPINE, {}), ("B", "lift"): (SPINE, {"final_time": 4.0})}
    make_study(folder, both, joint_reactions="all")
    return folder


@pytest.fixture
def copy(spine, tmp_path):
    return shutil.copytree(spine, tmp_path / "study")


@pytest.fixture(scope="module")
def found(spine):
    return studies.read(spine)


@pytest.fixture(scope="module")
def walking(shared_data, tmp_path_factory):
    """One person, one trial of one step more than a stride, with and without stability rows."""
    folder = tmp_path_factory.mktemp("walking")
    setup = shared_data / "gait10dof18musc" / "setup_static_optimization.xml"
    knees = {"stability": "diagonal", "stability_coordinates": "knee_angle_r,knee_angle_l", "q": 20.0}
    conditions = {"off": {"stability": "off"}, "diagonal": knees}
    make_study(folder, {("A", "walk"): (setup, {"step_interval": 2})}, conditions=conditions)
    return folder


def value(study, subject, condition, quantity, name, statistic, unit=None):
    wanted = {"subject": subject, "condition": condition, "quantity": quantity, "name": name}
    wanted |= {"statistic": statistic} | ({"unit": unit} if unit else {})
    (found,) = study.table.loc[(study.table[list(wanted)] == pd.Series(wanted)).all(axis=1), "value"]
    return found


def test_a_study_tells_itself_in_a_line(found):
    assert str(found) == "small: 2 trials of 2 people by 3 conditions, 6 of 6 done"
    assert found.conditions == ("off", "potvin-brown", "diagonal")
    assert "<table>" in found._repr_html_()


def test_numbers_are_those_of_the_result_files(found, spine):
    place = spine / "A" / "lift" / "potvin-brown"
    report = json.loads((place / "report.json").read_text(encoding="utf-8"))
    name = report["name"]
    activation = read_storage(place / f"{name}_StaticOptimization_activation.sto").column("ES1_R")
    force = read_storage(place / f"{name}_StaticOptimization_force.sto").column("ES1_R")
    stability = read_storage(place / f"{name}_stability.sto").column("lumbar_pelvis_x_margin")
    of_it = ("A", "potvin-brown")
    assert value(found, *of_it, "activation", "ES1_R", "mean", "-") == pytest.approx(activation.mean())
    assert value(found, *of_it, "activation", "ES1_R", "peak", "-") == pytest.approx(activation.max())
    assert value(found, *of_it, "force", "ES1_R", "peak", "N") == pytest.approx(force.max())
    assert value(found, *of_it, "margin", "lumbar_pelvis_x", "least") == pytest.approx(
        stability.min(), abs=1e-9
    )
    verdict = report["verdict"]
    assert value(found, *of_it, "frames", "stable", "count") == verdict["frames_stable"]
    assert value(found, *of_it, "effort", "muscles", "mean") == pytest.approx(
        verdict["effort"]["muscles"] / 10
    )
    peak = report["joint_reaction_peaks"]["lumbar_pelvis"]
    assert value(found, *of_it, "reaction force", "lumbar_pelvis", "peak", "N") == pytest.approx(
        peak["force"]
    )
    assert value(found, *of_it, "reaction", "lumbar_pelvis", "peak", "BW") == pytest.approx(
        peak["body_weights"]
    )


def test_opposing_moments_differ_by_the_moment_of_the_muscles(spine):
    """Of the moments file, for every coordinate and frame."""
    from scso_nlp.emg.motion_result import read_result
    from scso_nlp.report.series import every_series
    from scso_nlp.studies.summary import opposing_moments

    place = spine / "B" / "lift" / "diagonal"
    trajectory = scso.load_bundle(place.parent / "motion.npz").trajectory
    positive, negative = opposing_moments(every_series(place, read_result(place))["force"], trajectory)
    moments = read_storage(place / f"{trajectory.name}_moments.sto")
    of_muscles = moments.columns([f"{name}_moment_muscles" for name in trajectory.coordinates])
    np.testing.assert_allclose(positive - negative, of_muscles, atol=1e-6)


def test_stability_makes_the_trunk_muscles_oppose_each_other(found):
    flexion = [
        value(found, "A", c, "co-contraction", "lumbar_pelvis_flexion", "index") for c in found.conditions
    ]
    assert flexion[0] == pytest.approx(0.0, abs=1e-6)
    assert min(flexion[1:]) > 0.05


def test_differences_are_over_the_two_people(found):
    one = found.differences.query(
        "condition == 'diagonal' and quantity == 'effort' and name == 'muscles'"
    ).to_dict("records")[0]
    each = [
        value(found, subject, "diagonal", "effort", "muscles", "mean")
        - value(found, subject, "off", "effort", "muscles", "mean")
        for subject in "AB"
    ]
    assert one["mean"] == pytest.approx(np.mean(each))
    assert one["low"] < min(each)
    assert one["people"] == 2


def test_tasks_have_no_cycles(found):
    assert len(found.cycles) == 0
    assert set(found.trials["events"]) == {"no cycle"}


def test_tables_are_written_and_read_again(copy):
    study = studies.read(copy)
    files = studies.write_tables(study)
    assert {path.suffix for path in files} == {".csv", ".parquet"}
    pd.testing.assert_frame_equal(pd.read_parquet(copy / "summary.parquet"), study.table)
    pd.testing.assert_frame_equal(pd.read_csv(copy / "summary.csv"), study.table, rtol=1e-9)
    before = {path: path.read_bytes() for path in files}
    studies.write_tables(studies.read(copy))
    assert before == {path: path.read_bytes() for path in files}


def test_another_reference_is_taken_and_a_wrong_one_is_refused(spine):
    study = studies.read(spine, reference="diagonal")
    assert set(study.differences["condition"]) == {"off", "potvin-brown"}
    with pytest.raises(NameMismatchError, match="unknown condition 'diagnal'"):
        studies.read(spine, reference="diagnal")


def test_what_is_missing_failed_or_damaged_is_told_and_the_rest_is_there(copy):
    (copy / "A" / "lift" / "off" / "trial.json").unlink()
    outcome = read_outcome(copy / "A" / "lift" / "diagonal")
    bad = copy / "B" / "lift" / "diagonal"
    write_outcome(bad, scso.studies.Outcome(**{**vars(outcome), "subject": "B", "state": "bad input",
                                               "sentence": "model.osim does not exist"}))  # fmt: skip
    report = copy / "B" / "lift" / "off" / "report.json"
    report.write_text(report.read_text(encoding="utf-8")[:100], encoding="utf-8")
    study = studies.read(copy)
    states = study.trials.set_index(["subject", "condition"])
    assert states.loc[("A", "off"), "state"] == "not run"
    assert states.loc[("B", "diagonal"), "sentence"] == "model.osim does not exist"
    assert states.loc[("B", "off"), "state"] == "unreadable"
    assert "report.json is not JSON" in states.loc[("B", "off"), "sentence"]
    assert set(study.table["subject"] + " " + study.table["condition"]) == {
        "A potvin-brown", "A diagonal", "B potvin-brown",
    }  # fmt: skip
    assert str(study).splitlines() == [
        "small: 2 trials of 2 people by 3 conditions, 3 of 6 done",
        "1 not run",
        "1 unreadable",
        "1 bad input",
    ]
    assert len(study.differences) == 0


def test_a_report_without_what_it_should_hold_is_unreadable(copy):
    path = copy / "A" / "lift" / "off" / "report.json"
    report = json.loads(path.read_text(encoding="utf-8"))
    del report["verdict"]["effort"]
    path.write_text(json.dumps(report), encoding="utf-8")
    (told,) = studies.read(copy).trials.query("state == 'unreadable'")["sentence"]
    assert "report.json is damaged" in told


def test_a_motion_of_other_frames_is_not_taken(copy):
    bundle = copy / "A" / "lift" / "motion.npz"
    motion = scso.load_bundle(bundle)
    scso.save_bundle(bundle, motion.frames(0, 3))
    (*_, told) = studies.read(copy).trials.query("state == 'unreadable'")["sentence"]
    assert "has other frames or muscles than its results" in told


def test_without_the_motion_there_is_all_but_co_contraction(copy):
    (copy / "A" / "lift" / "motion.npz").unlink()
    table = studies.read(copy).table
    assert set(table.loc[table["quantity"] == "co-contraction", "subject"]) == {"B"}
    assert set(table.loc[table["quantity"] == "activation", "subject"]) == {"A", "B"}


def test_a_folder_without_a_study_is_refused(tmp_path):
    with pytest.raises(DataError, match="holds no study"):
        studies.read(tmp_path)


def test_the_whole_walk_is_one_cycle_where_no_foot_strikes_twice(walking):
    study = studies.read(walking)
    assert set(study.trials["events"]) == {"whole trial"}
    place = walking / "A" / "walk" / "off"
    table = read_storage(next(place.glob("*_activation.sto")))
    curve = study.cycles.query("condition == 'off' and quantity == 'activation' and name == 'soleus_r'").iloc[
        0
    ]
    assert (curve["start"], curve["stop"]) == (table.time[0], table.time[-1])
    at = table.time[0] + (table.time[-1] - table.time[0]) * 0.4
    assert curve["p40"] == pytest.approx(np.interp(at, table.time, table.column("soleus_r")))


def test_given_events_cut_the_walk(walking, tmp_path):
    folder = shutil.copytree(walking, tmp_path / "study")
    for condition in ("off", "diagonal"):
        place = folder / "A" / "walk" / condition
        outcome = read_outcome(place)
        write_outcome(place, scso.studies.Outcome(**{**vars(outcome), "events": (0.6, 0.9, 1.2)}))
    study = studies.read(folder)
    assert set(study.trials["events"]) == {"given"}
    assert set(study.trials["cycles"]) == {2}
    assert study.bands["over"].unique().tolist() == ["cycles"]
    assert np.isnan(study.differences["low"]).all()
