"""Workers that are started before their job is known."""

import subprocess
import tempfile
from pathlib import Path

import pytest
from tiny_model import Tiny

from scso_nlp.cli.run import _most_workers
from scso_nlp.exceptions import DataError, EngineError
from scso_nlp.opensim import workers
from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.workers import MOST_WAITING, number_of_cores, some_workers, started_early

pytestmark = pytest.mark.opensim


@pytest.fixture
def started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[str]]:
    """Processes in the order in which they are started, with a folder for temporary files of their own."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    found, start = [], workers._start

    def remembered(folder: Path, part: int) -> subprocess.Popen[str]:
        found.append(start(folder, part))
        return found[-1]

    monkeypatch.setattr(workers, "_start", remembered)
    return found


def assert_nothing_left(started: list[subprocess.Popen[str]]) -> None:
    assert all(process.poll() is not None for process in started)
    assert all(process.stdin.closed and process.stdout.closed for process in started)
    assert list(Path(tempfile.gettempdir()).glob(f"{workers.TEMPORARY}*")) == []


@pytest.mark.parametrize("n_needed", [1, 2, 3])
def test_those_that_wait_do_the_job_and_as_many_as_it_needs(
    tiny: Tiny, started: list[subprocess.Popen[str]], n_needed: int
) -> None:
    with started_early(2):
        early = list(started)
        assert [process.poll() for process in early] == [None, None]
        assert load_motion(tiny.setup, processes=n_needed).n_frames == 71
        assert_nothing_left(started)
    assert started[:2] == early
    assert len(started) == max(n_needed, 2)


def test_the_next_job_has_workers_of_its_own(tiny: Tiny, started: list[subprocess.Popen[str]]) -> None:
    with started_early(1):
        assert load_motion(tiny.setup, processes=1).n_frames == 71
        assert load_motion(tiny.setup, processes=1).n_frames == 71
    assert len(started) == 2
    assert_nothing_left(started)


def test_those_without_a_job_are_ended(started: list[subprocess.Popen[str]]) -> None:
    with started_early(99):
        assert len(started) == MOST_WAITING
        with pytest.raises(DataError, match="does not exist"):
            load_motion("nowhere.xml")
    assert_nothing_left(started)
    with some_workers() as others:
        assert others.processes == []


def test_without_room_for_them_the_job_says_so(
    tiny: Tiny, started: list[subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tiny.folder / "nowhere"))
    with started_early(1):
        assert started == []
        with pytest.raises(EngineError, match="cannot be given their work: No such file or directory"):
            load_motion(tiny.setup)


def test_one_that_died_while_it_waited_is_told_by_its_number(
    tiny: Tiny, started: list[subprocess.Popen[str]]
) -> None:
    with started_early(2):
        started[1].kill()
        started[1].wait()
        with pytest.raises(
            EngineError, match=r"worker 2 of 2 was ended by SIGKILL .* before its first frame"
        ):
            load_motion(tiny.setup, processes=2)
    assert_nothing_left(started)


def test_the_command_line_starts_as_many_as_may_be_needed(tmp_path: Path) -> None:
    setup, nothing = tmp_path / "setup.xml", {"cache": None, "processes": None}
    assert _most_workers(setup, nothing) == 0
    setup.touch()
    assert _most_workers(setup, nothing) == number_of_cores()
    assert _most_workers(setup, nothing | {"processes": "1"}) == 1
    assert _most_workers(setup, nothing | {"processes": "one"}) == number_of_cores()
    assert _most_workers(setup, nothing | {"cache": "here"}) == 0
