"""Studies on disk: what is written is read again, what is damaged or foreign is said."""

import json
from dataclasses import replace

import pytest

from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.studies.record import (
    STUDY,
    TRIAL,
    Outcome,
    Study,
    StudyTrial,
    outcomes,
    read_outcome,
    read_study,
    write_outcome,
    write_study,
)

ONE = StudyTrial(
    subject="S1", trial="walk", condition="q=5", folder="S1/walk/q=5", identity="ab", settings={"q": 5.0}
)
TWO = replace(ONE, condition="off", folder="S1/walk/off", identity="cd", settings={})
STUDY_OF_TWO = Study(name="two", source="/data/two", grid={"q": [5.0]}, trials=(ONE, TWO))
DONE = Outcome(
    identity="ab",
    subject="S1",
    trial="walk",
    condition="q=5",
    settings={"q": 5.0},
    state="done",
    sentence="solved",
    events=(0.5, 1.7),
    seconds={"solve": 0.25},
)


def test_what_is_written_is_read_again(tmp_path):
    write_study(tmp_path / "new", STUDY_OF_TWO)
    write_outcome(tmp_path / "new" / ONE.folder, DONE)
    assert read_study(tmp_path / "new") == STUDY_OF_TWO
    assert read_outcome(tmp_path / "new" / ONE.folder) == DONE
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == [STUDY, TRIAL]


def test_outcomes_stand_in_the_order_of_the_plan_and_only_where_they_are_of_it(tmp_path):
    write_study(tmp_path, STUDY_OF_TWO)
    write_outcome(tmp_path / ONE.folder, DONE)
    assert outcomes(tmp_path) == ((ONE, DONE), (TWO, None))
    write_outcome(tmp_path / ONE.folder, replace(DONE, identity="of other inputs"))
    assert outcomes(tmp_path) == ((ONE, None), (TWO, None))


def test_a_folder_without_a_study_is_said(tmp_path):
    with pytest.raises(DataError, match=r"holds no study: study.json is missing"):
        read_study(tmp_path)


@pytest.mark.parametrize(
    "text", ["{", "[]", "{}", '{"version": 1, "trials": 3}', '{"version": 1, "trials": [{"subject": 1}]}']
)
def test_a_damaged_study_is_said(tmp_path, text):
    (tmp_path / STUDY).write_text(text)
    with pytest.raises(FileFormatError, match=r"study.json is damaged"):
        read_study(tmp_path)


def test_a_later_version_is_refused_and_what_it_adds_is_not(tmp_path):
    write_study(tmp_path, STUDY_OF_TWO)
    values = json.loads((tmp_path / STUDY).read_text())
    (tmp_path / STUDY).write_text(json.dumps(values | {"lab": "ours"}))
    assert read_study(tmp_path) == STUDY_OF_TWO
    (tmp_path / STUDY).write_text(json.dumps(values | {"version": 2}))
    with pytest.raises(FileFormatError, match=r"has version 2, expected at most 1: update"):
        read_study(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", '{"identity": "ab"}', '{"state": "perhaps"}'])
def test_an_outcome_that_cannot_be_read_is_none(tmp_path, text):
    (tmp_path / TRIAL).write_text(text)
    assert read_outcome(tmp_path) is None
