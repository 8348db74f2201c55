"""Studies whose worker, scheduler or main process is killed at random moments, and that are run again.

Seeded and few by default; ``SCSO_STUDY_STOPS=5 pytest tests/robustness/test_studies_stopped.py -s`` tries so
many moments of each kind and prints what became of them.
"""

from __future__ import annotations

import collections
import contextlib
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from studies_run import Cluster, contents, lines_of, three_trials

from scso_nlp.studies.record import LOG, STUDY, TRIAL

pytest.importorskip("distributed", reason="needs Dask; pip install '.[studies]' brings it")
psutil = pytest.importorskip("psutil")
pytestmark = [
    pytest.mark.opensim,
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds processes in /proc"),
]

#: How many moments are tried of each kind.
NUMBER = int(os.environ.get("SCSO_STUDY_STOPS", "1"))
#: Trials times conditions.
N_RUNS = 6


def moments(kind: str) -> list[float]:
    """Random moments, in runs that have ended."""
    seed = int.from_bytes(hashlib.sha256(kind.encode()).digest()[:4])
    return np.random.default_rng(seed).uniform(0.0, N_RUNS - 1, NUMBER).tolist()


class Study:
    """A study of three trials by two conditions, run by the command."""

    def __init__(self, folder: Path, inputs: Path) -> None:
        self.inputs, self.output, self.temporary = inputs, folder / "study", folder / "temporary"
        self.temporary.mkdir(parents=True)

    def start(self, *options: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [
                *(sys.executable, "-m", "scso_nlp", "batch", str(self.inputs), "--output", str(self.output)),
                *("--stability", "off,potvin-brown", "--axes", "z", *options),
            ],
            env=os.environ | {"TMPDIR": str(self.temporary)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            # pytest may have been started with signals ignored
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def wait_until(self, moment: float, process: subprocess.Popen[str]) -> None:
        """Wait until the study is there and so many runs have ended, and for the rest of the moment."""
        n, rest = divmod(moment, 1.0)
        while process.poll() is None and not (
            (self.output / STUDY).exists() and len(list(self.output.glob(f"*/*/*/{TRIAL}"))) >= n
        ):
            time.sleep(0.01)
        time.sleep(rest / 2)

    def finish(self) -> str:
        """Run it again; say what is wrong, empty if nothing."""
        process = self.start("--workers", "2")
        said = process.communicate(timeout=300)
        return "" if process.returncode == 0 else f"exit code {process.returncode}\n{said}"

    def what_is_wrong(self, undisturbed: dict[str, object]) -> str:
        """Hold what is there against a study that nobody disturbed."""
        found = contents(self.output)
        if different := [name for name in found | undisturbed if found.get(name) != undisturbed.get(name)]:
            return f"different from an undisturbed study: {different}"
        done = collections.Counter(line[1] for line in lines_of(self.output) if line[3] == "done")
        if set(done.values()) != {1} or len(done) != N_RUNS:
            return f"not one line for every run in {LOG}: {done}"
        return ""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_trials(tmp_path_factory.mktemp("inputs") / "lab")


@pytest.fixture(scope="module")
def undisturbed(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    study = Study(tmp_path_factory.mktemp("undisturbed"), inputs)
    assert study.finish() == ""
    found = contents(study.output)
    assert study.what_is_wrong(found) == ""
    return found


def processes_of(study: Study) -> list[int]:
    """Processes that work in the temporary folder of a study."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            is_of_it = process.environ().get("TMPDIR") == str(study.temporary)
            if is_of_it and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
    return found


@pytest.fixture
def study(tmp_path: Path, inputs: Path) -> Iterator[Study]:
    yield Study(tmp_path, inputs)
    shutil.rmtree(tmp_path)


@pytest.mark.parametrize(
    ("number", "moment"),
    [(n, m) for n in ("SIGKILL", "SIGINT", "SIGTERM") for m in moments(f"{n} to the main process")],
)
def test_a_main_process_that_is_stopped_leaves_no_process_and_loses_nothing(
    study, undisturbed, number, moment
):
    process = study.start("--workers", "2")
    study.wait_until(moment, process)
    # as a terminal does, to all of them; SIGKILL to the one
    stop = os.kill if number == "SIGKILL" else os.killpg
    stop(process.pid, signal.Signals[number])
    _, words = process.communicate(timeout=120)
    print(f"\n{len(list(study.output.glob(f'*/*/*/{TRIAL}')))} done before")
    until = time.monotonic() + 30
    while (left := processes_of(study)) and time.monotonic() < until:
        time.sleep(0.1)
    assert not left, words
    assert process.returncode in ({"SIGKILL": -9, "SIGINT": 130, "SIGTERM": 143}[number], 0), words
    assert number == "SIGKILL" or "Traceback" not in words, words
    assert (study.finish() or study.what_is_wrong(undisturbed)) == "", words


@pytest.mark.parametrize(("k", "moment"), list(enumerate(moments("SIGKILL to a worker"))))
def test_a_worker_that_is_killed_costs_its_trial_a_second_start(study, undisturbed, k, moment):
    process = study.start("--workers", "2")
    study.wait_until(moment, process)
    children = psutil.Process(process.pid).children() if process.poll() is None else []
    workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    if workers:
        workers[k % len(workers)].kill()
    said = process.communicate(timeout=300)
    print(f"\n{'a worker killed' if workers else 'no worker there'}")
    assert process.returncode == 0, said
    assert study.what_is_wrong(undisturbed) == "", said


@pytest.mark.parametrize("moment", moments("SIGKILL to a scheduler"))
def test_a_scheduler_that_is_killed_ends_the_call_with_a_sentence(tmp_path, study, undisturbed, moment):
    with Cluster(tmp_path / "cluster") as cluster:
        process = study.start("--scheduler", cluster.address)
        study.wait_until(moment, process)
        cluster.scheduler.kill()
        _, words = process.communicate(timeout=300)
    print(f"\n{'one sentence' if process.returncode else 'finished before'}")
    if process.returncode:
        assert process.returncode == 2, words
        (said,) = (line for line in words.splitlines() if line.startswith("error: "))
        sentences = ("the Dask scheduler is gone, or somebody cancelled", "no Dask scheduler answers at")
        assert any(sentence in said for sentence in sentences)
    assert (study.finish() or study.what_is_wrong(undisturbed)) == "", words
