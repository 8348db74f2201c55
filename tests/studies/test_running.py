"""Studies run: on this machine, on a cluster that others have started, again, and with what cannot be run."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from studies_run import Cluster, contents, lines_of, three_trials
from typer.testing import CliRunner

import scso_nlp as scso
from scso_nlp.cli import app
from scso_nlp.studies import outcomes, plan, read, run, write_tables
from scso_nlp.studies.record import TRIAL, read_study

pytest.importorskip("distributed", reason="needs Dask; pip install '.[studies]' brings it")
pytestmark = pytest.mark.opensim

#: Two conditions of every trial, of which the first needs less of the motion than the second.
GRID = {"stability": ["off", "potvin-brown"]}


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_trials(tmp_path_factory.mktemp("inputs") / "lab")


@pytest.fixture(scope="module")
def study(three: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run once by nobody disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed") / "study"
    result = run(plan(three, grid=GRID, axes=["z"]), output=folder, workers=2, progress=False)
    assert result.is_done
    assert (result.folder, result.n_new, len(result.outcomes)) == (folder, 6, 6)
    write_tables(read(folder))
    return folder


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a cluster that is there already."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=None,
    ) as running:
        yield running.scheduler_address


@pytest.fixture
def copy(study: Path, tmp_path: Path) -> Path:
    """The study at its own place in time: another folder with the same files."""
    return Path(shutil.copytree(study, tmp_path / "study"))


def test_every_run_has_the_files_of_scso_run_and_its_outcome(study, three, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for trial, outcome in outcomes(study):
        assert (outcome.state, outcome.identity) == ("done", trial.identity)
        assert outcome.sentence.startswith("7 of 7 frames solved")
        assert set(outcome.seconds) >= {"extraction", "build", "solve", "other"}
    done = CliRunner().invoke(
        app,
        [
            "run",
            str(three / "S1/lift/setup.xml"),
            "--stability",
            "potvin-brown",
            "--axes",
            "z",
            "--no-figures",
            "--output",
            "alone",
        ],
    )
    assert done.exit_code == 0, done.output
    alone, among = tmp_path / "alone", study / "S1/lift/potvin-brown"
    assert {p.name for p in among.iterdir()} == {p.name for p in alone.iterdir()} | {TRIAL}
    for path in alone.glob("*.sto"):
        assert (among / path.name).read_bytes() == path.read_bytes()


def test_conditions_share_the_extracted_motion(study):
    for folder in ("S1/hold", "S1/lift", "S2/hold"):
        assert len(list((study / folder).glob("*.npz"))) == 1


def test_every_run_has_one_line_in_the_log(study):
    lines = lines_of(study)
    assert sorted(line[1] for line in lines) == sorted(trial.folder for trial in read_study(study).trials)
    assert {line[3] for line in lines} == {"done"}


def test_what_is_done_is_left_and_what_changed_is_run_again(three, cluster, tmp_path):
    inputs = Path(shutil.copytree(three, tmp_path / "lab"))
    folder = tmp_path / "study"
    first = run(plan(inputs / "S1", grid=GRID, axes=["z"]), output=folder, scheduler=cluster)
    assert first.n_new == 4
    stamps = {p: p.stat().st_mtime_ns for p in folder.rglob(TRIAL)}
    again = run(plan(inputs / "S1", grid=GRID, axes=["z"]), output=folder, scheduler=cluster)
    assert (again.n_new, again.is_done) == (0, True)
    assert {p: p.stat().st_mtime_ns for p in folder.rglob(TRIAL)} == stamps
    # other loads in one trial, and all inputs in another place
    loads = (inputs / "S1/lift/loads.mot").read_text()
    (inputs / "S1/lift/loads.mot").write_text(loads.replace("\n6\t", "\n6.0\t"))
    moved = inputs.rename(tmp_path / "moved")
    changed = run(plan(moved / "S1", grid=GRID, axes=["z"]), output=folder, scheduler=cluster)
    assert (changed.n_new, changed.is_done) == (2, True)
    assert {line[1] for line in lines_of(folder)[4:]} == {"lift/setup/off", "lift/setup/potvin-brown"}
    more = plan(moved / "S1", grid={"stability": ["off", "potvin-brown", "diagonal"]}, axes=["z"])
    assert run(more, output=folder, scheduler=cluster).n_new == 2


def test_force_runs_what_is_done(copy, study, three, cluster):
    (copy / "S1/hold/off/elbow_moments.sto").unlink()
    again = plan(three, grid=GRID, axes=["z"])
    assert run(again, output=copy, scheduler=cluster).n_new == 0
    assert run(again, output=copy, scheduler=cluster, force=True).n_new == 6
    assert contents(copy) == contents(study)


def test_bad_input_among_good_is_told_and_the_rest_is_done(three, cluster, tmp_path):
    inputs = Path(shutil.copytree(three, tmp_path / "lab"))
    (inputs / "S1/hold/motion.mot").unlink()
    motion = (inputs / "S1/lift/motion.mot").read_text()
    (inputs / "S1/lift/motion.mot").write_text(motion.replace("\n3\t90", "\n3\tnan"))
    shutil.copytree(three / "S2/hold", inputs / "S2/weak")
    model = (inputs / "S2/weak/elbow.osim").read_text()
    (inputs / "S2/weak/elbow.osim").write_text(
        model.replace("<max_isometric_force>", "<max_isometric_force>0.001<!-- ").replace(
            "</max_isometric_force>", " --></max_isometric_force>"
        )
    )
    done = CliRunner().invoke(
        app,
        ["batch", str(inputs), "--output", str(tmp_path / "study"), "--scheduler", cluster],
        prog_name="scso",
    )
    assert done.exit_code == 1, done.output
    states = {trial.folder: outcome.state for trial, outcome in outcomes(tmp_path / "study")}
    assert states == {
        "S1/hold/off": "bad input",
        "S1/lift/off": "bad input",
        "S2/hold/off": "done",
        "S2/weak/off": "failed",
    }
    assert "S1/hold/off: bad input: " in done.output
    assert "coordinates_file 'motion.mot' does not exist" in done.output
    assert "S1/lift/off: bad input: " in done.output
    assert "S2/weak/off: failed: 7 of 7 frames failed (infeasible)" in done.output
    assert "2 bad input, 1 done, 1 failed" in done.output
    assert not (tmp_path / "study/S1/hold/off/report.json").exists()
    # put right, only these are run
    shutil.copy(three / "S1/hold/motion.mot", inputs / "S1/hold")
    again = run(plan(inputs), output=tmp_path / "study", scheduler=cluster)
    assert again.n_new == 3
    assert [outcome.state for outcome in again.outcomes] == ["done", "bad input", "done", "failed"]


def test_a_folder_that_holds_something_else_is_refused(three, tmp_path):
    with pytest.raises(scso.DataError, match="holds other files and no study: name another folder"):
        run(plan(three), output=three, workers=1)


def test_two_calls_on_one_folder_are_refused(three, study):
    pytest.importorskip("fcntl")
    from scso_nlp.files import lock

    descriptor = lock(study)
    try:
        with pytest.raises(scso.DataError, match=r"another scso batch works on .*: wait for it"):
            run(plan(three), output=study, workers=1)
    finally:
        os.close(descriptor)


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"workers": 0}, scso.DataError, "workers is 0, expected 1 or more"),
        ({"scheduler": "tcp://127.0.0.1:1", "workers": 2}, scso.DataError, "has its own: leave it out"),
        ({"scheduler": "nothing://at all"}, scso.EngineError, "no Dask scheduler answers at nothing"),
    ],
)
def test_a_cluster_that_is_none_is_said(three, tmp_path, options, kind, words):
    with pytest.raises(kind, match=words):
        run(plan(three), output=tmp_path / "study", **options)


def test_workers_with_another_version_are_refused(three, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("scso_nlp.studies.cluster.versions", lambda: {"scso_nlp": "9.9"})
    with pytest.raises(
        scso.EngineError, match=r"have scso_nlp .*, expected 9\.9 as here: give them the same"
    ):
        run(plan(three), output=tmp_path / "study", scheduler=cluster)


@pytest.mark.slow
def test_a_cluster_of_others_gives_the_same_bit_for_bit(study, three, tmp_path):
    with Cluster(tmp_path / "cluster") as cluster:
        done = CliRunner().invoke(
            app,
            [
                "batch",
                str(three),
                "--stability",
                "off,potvin-brown",
                "--axes",
                "z",
                "--output",
                str(tmp_path / "study"),
                "--scheduler",
                cluster.address,
            ],
            prog_name="scso",
        )
    assert done.exit_code == 0, done.output
    assert "6 done (6 run now)" in done.output
    assert contents(tmp_path / "study") == contents(study)
    assert "summary.parquet" in contents(study)
