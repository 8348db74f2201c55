"""One run from settings to files: what is built and judged, and how often."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from dataclasses import replace

import pytest

import scso_nlp.run
import scso_nlp.solver.judge
import scso_nlp.solver.verbs
import scso_nlp.transcription.describe
from scso_nlp.examples import example_folder
from scso_nlp.exceptions import DataError
from scso_nlp.files import hashes
from scso_nlp.run import run, write_run
from scso_nlp.settings import OutputSettings, read_settings


@pytest.mark.opensim
def test_a_run_on_the_whole_hessian_builds_twice_and_judges_each_answer_once(tmp_path, monkeypatch):
    """The symbolic program of the baseline and of the run itself; writing files and figures asks for none."""
    calls = Counter()

    def counted(name, function):
        def call(*arguments, **options):
            calls[name] += 1
            return function(*arguments, **options)

        return call

    for name, places in {
        "describe": (scso_nlp.solver.verbs, scso_nlp.solver.judge),
        "judge": (scso_nlp.solver.verbs,),
    }.items():
        wrapped = counted(name, getattr(places[0], name))
        for place in places:
            monkeypatch.setattr(place, name, wrapped)
    source = example_folder("spine-load-height") / "scso.toml"
    settings, _ = read_settings(source, {"stability": "full", "q": 5.0})
    result = run(settings)
    assert result.is_solved
    assert result.baseline.stability.rows == result.solution.stability.rows
    assert dict(calls) == {"describe": 2, "judge": 2}
    write_run(result, OutputSettings(folder=tmp_path / "results"))
    assert dict(calls) == {"describe": 2, "judge": 2}, "writing must not ask the symbolic layer"


@pytest.fixture(scope="module")
def spine(tmp_path_factory):
    """A run of an embedded example, in a copy of its folder."""
    folder = tmp_path_factory.mktemp("spine") / "example"
    shutil.copytree(example_folder("spine-load-height"), folder)
    settings, _ = read_settings(folder / "setup.xml")
    return run(settings)


def with_inputs(result, changes):
    """The result of a run on other inputs: hashes by the names of files."""
    inputs = {
        path: next((value for name, value in changes.items() if path.endswith(name)), digest)
        for path, digest in result.record.inputs.items()
    }
    assert changes == {} or inputs != result.record.inputs
    return replace(result, record=replace(result.record, inputs=inputs))


def put(result, folder, **options):
    """Where the files of a run go, by the name of the folder."""
    written = write_run(result, OutputSettings(folder=folder, figures=False, **options))
    assert (written[-1].name, written[-1].is_file()) == ("report.json", True)
    return written[-1].parent.name


@pytest.mark.opensim
@pytest.mark.parametrize("name", ["spine.osim", "motion.mot", "external_loads.xml", "loads.mot"])
def test_results_of_other_inputs_stay_and_the_next_free_name_is_taken(tmp_path, spine, name, caplog):
    wanted = tmp_path / "results"
    other, third = (with_inputs(spine, {name: digest * 64}) for digest in "ab")
    assert put(spine, wanted) == "results"
    before = {path.name: path.read_bytes() for path in wanted.iterdir()}
    assert caplog.text == ""
    assert [put(result, wanted) for result in (other, third, other)] == [
        "results_2",
        "results_3",
        "results_2",
    ]
    assert f"{wanted} has results of other inputs, which stay" in caplog.text
    assert {path.name: path.read_bytes() for path in wanted.iterdir()} == before
    assert put(other, wanted, overwrite=True) == "results"
    report = json.loads((wanted / "report.json").read_text())
    assert "a" * 64 in report["inputs_sha256"].values()


@pytest.mark.opensim
def test_the_same_inputs_with_other_settings_or_elsewhere_replace_what_is_there(tmp_path, spine, caplog):
    wanted = tmp_path / "results"
    put(spine, wanted)
    assert put(with_inputs(spine, {"setup.xml": "a" * 64}), wanted) == "results"
    # the whole project in another place, run by a settings file
    inputs = {path.replace("example", "moved"): digest for path, digest in spine.record.inputs.items()}
    setup = spine.settings.setup.parents[1] / "moved" / "setup.xml"
    facts = replace(
        spine.record,
        inputs={str(setup.with_name("scso.toml")): "b" * 64, **inputs},
        settings={**spine.record.settings, "setup": setup},
    )
    assert (
        put(replace(spine, settings=replace(spine.settings, setup=setup), record=facts), wanted) == "results"
    )
    assert caplog.text == ""


@pytest.mark.opensim
def test_another_setup_file_on_the_same_data_is_another_trial(tmp_path, spine):
    wanted = tmp_path / "results"
    put(spine, wanted)
    setup = spine.settings.setup.with_name("late.xml")
    inputs = {path.replace("setup.xml", "late.xml"): digest for path, digest in spine.record.inputs.items()}
    facts = replace(spine.record, inputs=inputs, settings={**spine.record.settings, "setup": setup})
    assert (
        put(replace(spine, settings=replace(spine.settings, setup=setup), record=facts), wanted)
        == "results_2"
    )


@pytest.mark.opensim
def test_files_of_unknown_origin_with_the_same_names_stay(tmp_path, spine):
    """Such as OpenSim's own results; other files in the folder do no harm."""
    wanted = tmp_path / "results"
    wanted.mkdir()
    (wanted / "notes.txt").write_text("mine")
    assert put(spine, wanted) == "results"
    (wanted / "report.json").write_text("no report")
    (tmp_path / "results_2").write_text("a file")
    assert put(spine, wanted) == "results_3"
    assert (wanted / "report.json").read_text() == "no report"


@pytest.mark.opensim
@pytest.mark.parametrize("text", ["[]", '{"settings": null}', '{"name": 1}', "[" * 100000])
def test_a_report_of_another_program_stays(tmp_path, spine, text):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "report.json").write_text(text)
    assert put(spine, tmp_path / "results") == "results_2"
    assert (tmp_path / "results" / "report.json").read_text() == text


@pytest.mark.opensim
def test_a_folder_with_an_impossible_name_is_one_sentence(tmp_path, spine):
    with pytest.raises(DataError, match=r"results cannot be written to .*: File name too long"):
        put(spine, tmp_path / ("a" * 300))


@pytest.mark.opensim
def test_files_that_change_or_vanish_during_the_solve_cost_nothing(tmp_path, monkeypatch):
    """The report has the hashes of what was read."""
    folder = tmp_path / "example"
    shutil.copytree(example_folder("spine-load-height"), folder)
    settings, _ = read_settings(folder / "setup.xml")
    described = scso_nlp.run.describe
    names = ("setup.xml", "spine.osim", "motion.mot", "external_loads.xml", "loads.mot")
    read = hashes(folder / name for name in names)

    def gone(*arguments):
        (folder / "spine.osim").unlink()
        for name in ("setup.xml", "motion.mot"):
            (folder / name).write_text("something else")
        return described(*arguments)

    monkeypatch.setattr(scso_nlp.run, "describe", gone)
    result = run(settings)
    assert result.record.inputs == read
    assert put(result, tmp_path / "results") == "results"
