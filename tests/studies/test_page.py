"""The page of a study: whole, self-contained, and leading to a page of every trial."""

import re
import shutil
from urllib.parse import unquote

import pytest
from studies.small_study import make_study
from typer.testing import CliRunner

from scso_nlp import studies
from scso_nlp.cli import app
from scso_nlp.examples import example_folder
from scso_nlp.studies.record import Outcome, read_outcome, write_outcome

pytestmark = pytest.mark.opensim

HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "study & more"
    setup = example_folder("spine-load-height") / "setup.xml"
    people = {("A 1", "lift #1"): (setup, {}), ("B", "lift"): (setup, {"final_time": 4.0})}
    make_study(folder, people, conditions={"off": {"stability": "off"}, "full": {"stability": "full"}})
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """With one failed trial, whose sentence is not to be trusted."""
    copy = shutil.copytree(made, tmp_path / "study")
    place = copy / "B" / "lift" / "full"
    outcome = vars(read_outcome(place)) | {"state": "failed", "sentence": HOSTILE}
    write_outcome(place, Outcome(**outcome))
    return copy


def text_of(page):
    return page.read_text(encoding="utf-8")


def test_the_page_says_what_was_asked_what_failed_and_what_differs(folder):
    text = text_of(studies.write_cohort(studies.read(folder)))
    assert "2 trials of 2 people by 2 conditions, 3 of 4 done." in text
    assert "HessianStability" in text
    assert '<td class="failed">failed</td>' in text
    assert HOSTILE not in text
    assert "B, lift, full: failed.</span> &lt;script&gt;" in text
    assert "There are no intervals" not in text
    assert "trials have no whole cycle" in text


def test_it_loads_nothing_and_leads_to_a_page_of_every_trial(folder):
    page = studies.write_cohort(studies.read(folder))
    links = re.findall(r'href="([^"#][^"]*)"', text_of(page))
    assert [link for link in links if link != "data:,"] == [
        "A%201/lift%20%231/report.html",
        "B/lift/report.html",
    ]
    for link in links[1:]:
        assert "What was asked, and what it is worth" in text_of(page.parent / unquote(link))
    assert re.findall(r'(?:src|href)="(?!#|data:)([^"]*)"', text_of(page)) == links[1:]


def test_links_are_relative_to_where_the_page_is(folder):
    elsewhere = folder.parent / "pages"
    elsewhere.mkdir()
    text = text_of(studies.write_cohort(studies.read(folder), elsewhere / "cohort.html"))
    assert 'href="../study/B/lift/report.html"' in text


def test_pages_of_trials_are_made_again_only_where_results_are_newer(folder):
    study = studies.read(folder)
    studies.write_cohort(study)
    pages = [folder / "A 1" / "lift #1" / "report.html", folder / "B" / "lift" / "report.html"]
    first = [page.stat().st_mtime_ns for page in pages]
    place = folder / "B" / "lift" / "off"
    write_outcome(place, read_outcome(place))
    studies.write_cohort(study)
    second = [page.stat().st_mtime_ns for page in pages]
    assert second[0] == first[0]
    assert second[1] > first[1]


def test_of_one_person_the_page_says_that_there_are_no_intervals(folder):
    for condition in ("off", "full"):
        (folder / "B" / "lift" / condition / "trial.json").unlink()
    text = text_of(studies.write_cohort(studies.read(folder)))
    assert "All results are of one person, who says nothing of others: there are no intervals." in text
    assert not re.search(r'<span class="quiet">\[', text)


def test_the_command_writes_tables_figures_and_pages(folder):
    done = CliRunner().invoke(app, ["report", str(folder)], prog_name="scso")
    assert done.exit_code == 0, done.output
    assert "2 trials of 2 people by 2 conditions, 3 of 4 done\n1 failed\n" in done.output
    for name in ("report.html", "trials.csv", "summary.parquet", "differences.csv", "B/lift/report.html"):
        assert (folder / name).is_file()


def test_labels_have_no_place_in_a_study(folder):
    done = CliRunner().invoke(app, ["report", str(folder), "--labels", "a,b"], prog_name="scso")
    assert done.exit_code == 2
    assert "is a study, in which labels and EMG have no place" in done.output


def test_one_condition_has_no_differences_and_nothing_done_has_a_page_too(tmp_path):
    setup = example_folder("elbow") / "setup.xml"
    make_study(tmp_path, {("A", "hold"): (setup, {})}, conditions={"off": {"stability": "off"}})
    study = studies.read(tmp_path)
    assert len(study.differences) == 0
    assert "Differences" not in text_of(studies.write_cohort(study))
    (tmp_path / "A" / "hold" / "off" / "trial.json").unlink()
    empty = studies.read(tmp_path)
    assert len(studies.write_tables(empty)) == 12
    assert "1 trial of 1 person by 1 condition, 0 of 1 done." in text_of(studies.write_cohort(empty))
