"""Runs that are stopped at random moments: what was there stays, what is new is whole, nothing else is left.

Seeded and few by default; ``SCSO_STOPS=40 pytest tests/robustness/test_stops.py -s`` tries so many of each
and prints what became of them.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from scso_nlp.examples import example_folder

pytestmark = [
    pytest.mark.opensim,
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds processes in /proc"),
]

#: How many moments are tried of each kind.
NUMBER = int(os.environ.get("SCSO_STOPS", "1"))
#: What becomes of a run that was not stopped in time.
FINISHED = "finished before"
SCSO = str(Path(sys.executable).with_name("scso"))
RUN = ["run", "setup.xml", "--output", "results", "--processes", "2", "--exponent", "3"]
SHELL = [SCSO, *RUN]

#: The same in Python; ends with 130 if it was interrupted.
SCRIPT = """
import sys
try:
    import scso_nlp as scso
    motion = scso.load_motion("setup.xml", processes=2)
    problem = scso.static_optimization(motion, muscle_model=scso.NoPhysiology(), exponent=3.0)
    scso.write_solution(scso.solve_trajectory(problem), "results")
except KeyboardInterrupt:
    sys.exit(130)
"""
PYTHON = [sys.executable, "-c", SCRIPT]

#: The command, with a worker's silence ended after two seconds.
IMPATIENT = """
import sys
import scso_nlp.opensim.crew as crew, scso_nlp.opensim.workers as workers
crew.SILENCE, crew.TICK, crew.PATIENCE, workers.PATIENCE = 2.0, 0.2, 0.5, 0.5
from scso_nlp.cli import app
app(sys.argv[1:])
"""


class Trial:
    """A folder with a setup and earlier results, and a temporary folder of its own."""

    def __init__(self, folder: Path, example: Path) -> None:
        self.folder = Path(shutil.copytree(example, folder / "trial"))
        self.temporary = folder / "temporary"
        self.temporary.mkdir()
        self.before = self.results()

    def start(
        self, command: list[str], prepare: Callable[[], object] = lambda: None
    ) -> subprocess.Popen[str]:
        """Start a command in a process group of its own, with the signals as a terminal leaves them."""

        def as_from_a_terminal() -> None:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.SIG_DFL)
            prepare()

        return subprocess.Popen(
            command,
            cwd=self.folder,
            env=os.environ | {"TMPDIR": str(self.temporary), "MPLBACKEND": "agg"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=as_from_a_terminal,
        )

    def results(self) -> dict[str, bytes]:
        folder = self.folder / "results"
        return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    def workers(self) -> list[int]:
        """Processes that work in the temporary folder."""
        found = []
        for path in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                is_zombie = "\nState:\tZ" in (path / "status").read_text()
                if not is_zombie and f"{self.temporary}/scso_".encode() in (path / "cmdline").read_bytes():
                    found.append(int(path.name))
        return sorted(found)

    def what_is_wrong(self) -> str:
        """Say what stands half or is left behind, empty if nothing."""
        if self.workers():
            return "a worker is left"
        if left := sorted(path.name for path in self.temporary.iterdir()):
            return f"temporary files are left: {left}"
        if {path.name for path in self.folder.iterdir()} != {path.name for path in INPUTS.iterdir()} | {
            "results"
        }:
            return "something is left beside the results"
        return self.what_is_wrong_with_the_results()

    def what_is_wrong_with_the_results(self) -> str:
        found = self.results()
        if found == self.before:
            return ""
        if hidden := [name for name in found if Path(name).name.startswith(".") or "/." in name]:
            return f"hidden files are left: {hidden}"
        if "report.json" not in found:
            return "results without a report"
        report = json.loads(found.pop("report.json"))
        if report["objective"]["terms"] == json.loads(self.before["report.json"])["objective"]["terms"]:
            return "an earlier report with other files"
        for name, digest in report["files_sha256"].items():
            if hashlib.sha256(found.pop(name)).hexdigest() != digest:
                return f"{name} is not of this report"
        # figures come after the report
        ends = {".png": b"IEND\xaeB`\x82", ".pdf": b"%%EOF\n"}
        half = [name for name, text in found.items() if not text.endswith(ends.get(Path(name).suffix, b"\0"))]
        return f"neither of the report nor a whole figure: {half}" if half else ""


INPUTS = example_folder("spine-load-height")


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of an example with results of the exponent 2."""
    folder = Path(shutil.copytree(INPUTS, tmp_path_factory.mktemp("stops") / "example"))
    subprocess.run([*SHELL[:-1], "2"], cwd=folder, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def duration(example: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    """How long the commands take when nobody stops them [s]."""
    found = {}
    for name, command in (("shell", SHELL), ("python", PYTHON)):
        trial = Trial(tmp_path_factory.mktemp(name), example)
        started = time.monotonic()
        process = trial.start(command)
        assert process.communicate()[1] == ""
        found[name] = time.monotonic() - started
        assert process.returncode == 0
        assert trial.what_is_wrong() == ""
        assert trial.results() != trial.before
    return found


@pytest.fixture
def trial(tmp_path: Path, example: Path) -> Iterator[Trial]:
    yield Trial(tmp_path, example)
    shutil.rmtree(tmp_path)


def moments(kind: str) -> list[float]:
    """Random moments of a kind, as shares of the longest."""
    seed = int.from_bytes(hashlib.sha256(kind.encode()).digest()[:4])
    return np.random.default_rng(seed).uniform(0.0, 1.0, NUMBER).tolist()


#: What becomes of a run whose interpreter is interrupted before it runs a line of anybody's: it says so and
#: ends with 1, whatever the program is.
NOT_YET_PYTHON = "Fatal Python error: init_import_site"


def as_a_shell_has_it(code: int) -> int:
    return 128 - code if code < 0 else code


SIGNALS = (("shell", "SIGINT"), ("shell", "SIGTERM"), ("shell", "SIGHUP"), ("python", "SIGINT"))


@pytest.mark.parametrize(
    ("way", "number", "whom", "moment"),
    [
        (way, number, whom, moment)
        for way, number in SIGNALS
        for whom in ("alone", "group")
        for moment in moments(f"{number} to {way}, {whom}")
    ],
)
def test_a_signal_at_any_moment(trial, duration, way, number, whom, moment):
    process = trial.start(SHELL if way == "shell" else PYTHON)
    time.sleep(moment * duration[way])
    (os.kill if whom == "alone" else os.killpg)(process.pid, signal.Signals[number])
    _, words = process.communicate(timeout=60)
    code = as_a_shell_has_it(process.returncode)
    assert trial.what_is_wrong() == "", words
    if code == 0 and trial.results() != trial.before:
        print(f"\n{FINISHED}")
    elif code == 1 and NOT_YET_PYTHON in words:
        print("\nbefore Python runs a line")
    else:
        print(f"\n{'earlier' if trial.results() == trial.before else 'new'} results")
        assert code == 128 + signal.Signals[number], words


def wait_for_end_of_workers(trial: Trial) -> None:
    until = time.monotonic() + 20
    while trial.workers() and time.monotonic() < until:
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("way", "moment"), [(way, m) for way in ("shell", "python") for m in moments(f"SIGKILL to {way}")]
)
def test_a_killed_program_leaves_no_worker_and_the_next_run_is_as_if_nothing_had_been(
    trial, duration, way, moment
):
    command = SHELL if way == "shell" else PYTHON
    process = trial.start(command)
    time.sleep(moment * duration[way])
    process.kill()
    process.communicate(timeout=60)
    wait_for_end_of_workers(trial)
    assert not trial.workers()
    print(f"\n{'left to the next run' if trial.what_is_wrong() else 'nothing left'}")
    after = trial.start(command)
    _, words = after.communicate(timeout=120)
    assert trial.what_is_wrong() == "", words
    assert (after.returncode, words) == (0, "")
    assert trial.results() != trial.before


def check_sentence(trial: Trial, process: subprocess.Popen[str], start: str, reason: str = "") -> None:
    """A program ends as if nothing had been, or with one sentence, and leaves nothing."""
    _, words = process.communicate(timeout=60)
    print(f"\n{'one sentence' if process.returncode else FINISHED}")
    assert trial.what_is_wrong() == "", words
    if process.returncode or words:
        assert process.returncode == 2, words
        assert words.startswith(start), words
        assert reason in words
        assert words.count("\n") == 1, words
        assert trial.results() == trial.before


@pytest.mark.parametrize(
    ("number", "moment"), [(n, m) for n in ("SIGKILL", "SIGSTOP") for m in moments(f"{n} to a worker")]
)
def test_a_worker_that_is_killed_or_stopped_ends_the_run_with_a_sentence(trial, number, moment):
    process = trial.start([sys.executable, "-c", IMPATIENT, *RUN])
    while process.poll() is None and not (workers := trial.workers()):
        time.sleep(0.01)
    time.sleep(moment)
    with contextlib.suppress(ProcessLookupError):
        os.kill(workers[-1], signal.Signals[number])
    reason = "was ended by SIGKILL" if number == "SIGKILL" else "got no further for 2 s"
    check_sentence(trial, process, "error: OpenSim worker ", reason)


@pytest.mark.parametrize("moment", moments("full disk"))
def test_a_disk_that_is_full_at_any_size_is_one_sentence(trial, moment):
    """No file may be longer than so many bytes: which one is cut off depends on it."""
    resource = pytest.importorskip("resource")
    size = int(1e5**moment)
    process = trial.start(
        [*SHELL, "--no-figures"], lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    )
    check_sentence(trial, process, "error: ")
