"""Result files: OpenSim's formats, whole or not at all, nothing that looks like a result after a failure."""

import builtins
import concurrent.futures
import contextlib
import errno
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from solution_by_hand import solution_by_hand, write

from scso_nlp.exceptions import DataError
from scso_nlp.report import results
from scso_nlp.report.contents import RESULT_FILES
from scso_nlp.report.folder import claimed, settle
from scso_nlp.report.record import RunRecord
from scso_nlp.report.results import write_solution
from scso_nlp.solution import Solution


def declared(solution: Solution, *, is_result: bool = True) -> set[str]:
    """Names of the files that a solution alone is written to; without results if there are none."""
    found = [file for file in RESULT_FILES if not file.of_baseline and (is_result or not file.is_result)]
    found = [file.name for file in found if file.content(solution) is not None]
    names = {name.format(name="antagonists", analysis="StaticOptimization") for name in found}
    return names | {"report.json"}


#: Files without stability rows, with them, and of a run that failed.
PLAIN = declared(solution_by_hand(stability=False))
STABLE = declared(solution_by_hand())
ALWAYS = declared(solution_by_hand(), is_result=False)
FIGURES = {f"antagonists_{what}.{kind}" for what in ("activations", "moments") for kind in ("png", "pdf")}
STABLE_FIGURES = FIGURES | {
    f"antagonists_{what}.{kind}" for what in ("stability", "contributions") for kind in ("png", "pdf")
}


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_solved_motion_leaves_every_file_and_nothing_else(tmp_path):
    written = write_solution(solution_by_hand(), tmp_path / "results")
    assert files(tmp_path / "results") == STABLE | STABLE_FIGURES
    assert {path.name for path in written} == files(tmp_path / "results")
    assert files(tmp_path) == {"results"}


def test_a_failed_frame_leaves_a_status_and_a_report_only(tmp_path):
    write_solution(solution_by_hand(failed=(1, 3)), tmp_path / "results")
    assert files(tmp_path / "results") == ALWAYS


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_failed_run_leaves_earlier_results_and_stands_beside_them(tmp_path, caplog):
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    (folder / "notes.txt").write_text("mine")
    before = content(folder)
    for keep_failed in (True, False):
        written = write(solution_by_hand(failed=(1,)), folder, keep_failed=keep_failed)
        assert content(folder) == before
        assert {path.parent for path in written} == {folder / "failed"}
        assert "because it failed: earlier results in" in caplog.text
    assert files(folder / "failed") == ALWAYS
    write(solution_by_hand(tonus=0.1), folder)
    assert files(folder) == STABLE | {"notes.txt"}
    assert content(folder) != before


def test_results_with_gaps_are_replaced_by_their_like_but_not_by_none(tmp_path):
    folder = tmp_path / "results"
    write(solution_by_hand(failed=(1, 2)), folder)
    write(solution_by_hand(failed=(1,)), folder, keep_failed=True)
    write(solution_by_hand(failed=(1, 3)), folder, keep_failed=True)
    before = content(folder)
    assert json.loads(before["report.json"])["status_counts"] == {"SOLVED": 3, "INFEASIBLE": 2}
    write(solution_by_hand(failed=(1,)), folder)
    assert content(folder) == before
    assert files(folder / "failed") == ALWAYS


def test_a_failed_run_leaves_results_that_have_no_report(tmp_path):
    """Such as OpenSim's own, which have the same names."""
    folder = tmp_path / "results"
    write(solution_by_hand(), folder)
    (folder / "report.json").unlink()
    write(solution_by_hand(failed=(1,)), folder)
    assert files(folder) > PLAIN - ALWAYS


def test_results_of_another_name_stay(tmp_path):
    folder = tmp_path / "results"
    write(solution_by_hand(name="antagonists_2"), folder)
    write(solution_by_hand(), folder)
    assert "antagonists_2_StaticOptimization_force.sto" in files(folder)


def test_results_of_other_inputs_stay_unless_they_may_be_overwritten(tmp_path):
    folder = tmp_path / "results"
    mine, other = (RunRecord(inputs={file: 64 * file[0]}) for file in ("a.osim", "b.osim"))
    write(solution_by_hand(), folder, record=mine)
    before = content(folder)
    for _ in range(2):
        written = write(solution_by_hand(tonus=0.1), folder, record=other, overwrite=False)
        assert {path.parent for path in written} == {tmp_path / "results_2"}
        assert content(folder) == before
    write(solution_by_hand(tonus=0.1), folder, record=mine, overwrite=False)
    assert content(folder) != before
    assert files(tmp_path) == {"results", "results_2"}


def test_what_fails_in_a_figure_costs_that_figure_alone(tmp_path, monkeypatch, caplog):
    def broken(*_, **__):
        raise ValueError("no such\nglyph")

    monkeypatch.setattr("scso_nlp.figures.plot_moments", broken)
    written = write_solution(solution_by_hand(stability=False), tmp_path / "results")
    left = PLAIN | {"antagonists_activations.png", "antagonists_activations.pdf"}
    assert files(tmp_path / "results") == {path.name for path in written} == left
    assert "the figure antagonists_moments is left out: no such glyph" in caplog.text
    report = json.loads((tmp_path / "results" / "report.json").read_text())
    assert set(report["files_sha256"]) == left - {"report.json"}


def test_the_report_is_there_before_figures_and_says_in_the_end_how_long_they_took(tmp_path, monkeypatch):
    folder, before = tmp_path / "results", {}

    def slow(*_, **__):
        before.update(json.loads((folder / "report.json").read_text()))
        time.sleep(0.2)

    monkeypatch.setattr("scso_nlp.figures.plot_moments", slow)
    write_solution(solution_by_hand(stability=False), folder)
    report = json.loads((folder / "report.json").read_text())
    assert list(before["seconds"]) == ["build", "solve", "writing"]
    assert {Path(name).suffix for name in before["files_sha256"]} == {".sto", ".xml"}
    assert report["seconds"].pop("figures") > 0.2
    assert report["seconds"] == before["seconds"]


def test_dollars_in_names_are_dollars_in_figures(tmp_path, caplog):
    """Between two of them matplotlib would read mathematics, of which not every text is one."""
    solution = solution_by_hand(name="$_$", sides=("$_$", "back_$\\$"))
    written = write_solution(solution, tmp_path / "results")
    assert caplog.text == ""
    assert {path.name for path in written if path.suffix == ".png"} == {
        f"$_$_{what}.png" for what in ("activations", "moments", "stability", "contributions")
    }


@pytest.mark.parametrize("broken", ["_force.sto", "_controls.xml", "_status.sto", "report.json"])
@pytest.mark.parametrize("exists", [False, True])
def test_a_full_disk_leaves_what_was_there_before(tmp_path, monkeypatch, broken, exists):
    folder = tmp_path / "results"
    if exists:
        write(solution_by_hand(tonus=0.1), folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()} if exists else {}
    real = open

    def full(file, mode="r", *arguments, **options):
        name = os.fspath(file) if isinstance(file, (str, os.PathLike)) else ""
        if broken in name and ("w" in mode or "x" in mode):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(file, mode, *arguments, **options)

    monkeypatch.setattr(builtins, "open", full)
    monkeypatch.setattr(io, "open", full)
    with pytest.raises(DataError, match="No space left"):
        write_solution(solution_by_hand(), folder)
    monkeypatch.undo()
    assert files(tmp_path) == ({"results"} if exists else set())
    if exists:
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("step", range(11))
def test_a_move_that_is_interrupted_is_taken_back(tmp_path, monkeypatch, step):
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    before = content(folder)
    real = os.replace
    steps = iter(range(1000))

    def interrupted(source, target):
        # only the last steps count, out of the temporary folder and before it into another
        moves = folder in (Path(target).parent, Path(source).parent)
        if moves and next(steps) == step:
            raise KeyboardInterrupt
        real(source, target)

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(solution_by_hand(tonus=0.1), folder)
    monkeypatch.undo()
    assert content(folder) == before
    assert files(tmp_path) == {"results"}


#: Ends the process at its n-th step of moving files, as kill -9 does.
KILLED = """
import os, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from solution_by_hand import solution_by_hand
from scso_nlp.report.record import RunRecord
from scso_nlp.report.results import write_solution
real, left = os.replace, [{step}]
def killed(source, target):
    if {folder!r} in (str(Path(target).parent), str(Path(source).parent)):
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), 9)
    real(source, target)
os.replace = killed
write_solution(solution_by_hand(tonus=0.1, stability=False), {folder!r}, figures=False)
"""


#: Steps of moving the earlier files away, with the new ones in their place.
AWAY = len(STABLE | STABLE_FIGURES)
ALL_STEPS = AWAY + len(PLAIN)


@pytest.mark.skipif(os.name != "posix", reason="kill -9")
@pytest.mark.parametrize("step", [0, 1, AWAY // 2, AWAY, AWAY + 2, ALL_STEPS - 1, ALL_STEPS])
def test_a_run_that_is_killed_while_it_moves_files_leaves_one_result_whole(tmp_path, step):
    """The next run finds the earlier results, or the new ones, never something of both."""
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    (folder / "notes.txt").write_text("mine")
    before = content(folder)
    script = KILLED.format(tests=str(Path(__file__).parents[1]), step=step, folder=str(folder))
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True)
    assert done.returncode == (-9 if step < ALL_STEPS else 0), done.stderr
    with claimed(folder, lambda _: True):
        found = content(folder)
    if step < ALL_STEPS:
        assert found == before
    else:
        assert set(found) == PLAIN | {"notes.txt"}
    write(solution_by_hand(tonus=0.1), folder)
    assert files(folder) == STABLE | {"notes.txt"}
    assert files(tmp_path) == {"results"}


def test_taking_back_may_be_interrupted_too(tmp_path, monkeypatch):
    """At any of its steps; the next one goes on."""
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    before = content(folder)
    script = KILLED.format(tests=str(Path(__file__).parents[1]), step=ALL_STEPS - 2, folder=str(folder))
    subprocess.run([sys.executable, "-c", script], check=False)
    half = tmp_path / "half"
    os.replace(folder, half)
    real = os.replace
    for step in range(1000):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(half, folder)

        count = iter(range(1000))

        def interrupted(source, target, count=count, step=step):
            if next(count) == step:
                raise KeyboardInterrupt
            real(source, target)

        monkeypatch.setattr(os, "replace", interrupted)
        with contextlib.suppress(KeyboardInterrupt):
            settle(folder)
            break
        monkeypatch.undo()
        settle(folder)
        assert content(folder) == before
    assert step > 10
    assert content(folder) == before


def test_what_a_killed_run_was_writing_is_cleared_away(tmp_path):
    folder = tmp_path / "results"
    write(solution_by_hand(), folder)
    (folder / ".scso_new").mkdir()
    (folder / ".scso_new" / "half").write_text("0.1 0.")
    for name in ("report.json", "antagonists_moments.png"):
        (folder / f".{'0' * 32}.{name}").write_text("half")
    (folder / ".hidden").write_text("mine")
    write(solution_by_hand(tonus=0.1), folder)
    assert files(folder) == STABLE | {".hidden"}


def test_runs_that_write_into_one_folder_at_the_same_time_wait_for_each_other(tmp_path, monkeypatch, caplog):
    """What is there in the end is all of one run."""
    folder = tmp_path / "results"
    solutions = [solution_by_hand(tonus=tonus) for tonus in (0.0, 0.1, 0.2, 0.3)]
    expected = []
    for k, solution in enumerate(solutions):
        write(solution, tmp_path / f"alone_{k}")
        expected.append(content(tmp_path / f"alone_{k}"))
    inside, most = [], []
    put = results._put

    def watched(*arguments):
        inside.append(1)
        most.append(len(inside))
        put(*arguments)
        inside.pop()

    monkeypatch.setattr(results, "_put", watched)
    for _ in range(5):
        with concurrent.futures.ThreadPoolExecutor(len(solutions)) as pool:
            list(pool.map(lambda solution: write(solution, folder), solutions))
        found = content(folder)
        report = json.loads(found.pop("report.json"))
        assert found in [{n: c for n, c in each.items() if n != "report.json"} for each in expected]
        assert report["files_sha256"] == {n: hashlib.sha256(c).hexdigest() for n, c in found.items()}
    assert set(most) == {1}
    assert "is being written to by another run; waiting for it" in caplog.text


@pytest.mark.parametrize("name", ["../escape", "a/b", "", ".hidden", "a\nb", "a\\b"])
def test_a_name_that_leaves_the_folder_is_refused(tmp_path, name):
    with pytest.raises(DataError, match="cannot start a file name"):
        write(solution_by_hand(name=name), tmp_path / "results")
    with pytest.raises(DataError, match="cannot start a file name"):
        write(solution_by_hand(), tmp_path / "results", analysis_name=name)
    assert files(tmp_path) == set()


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "results").write_text("mine")
    with pytest.raises(DataError, match="is a file"):
        write(solution_by_hand(), tmp_path / "results")
    assert (tmp_path / "results").read_text() == "mine"
