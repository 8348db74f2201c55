"""Stopped at any moment: the first signal ends the run, nothing half-written stays, earlier results do."""

from __future__ import annotations

import concurrent.futures
import contextlib
import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from helpers import elbow

import scso_nlp as scso
import scso_nlp.solver.programs as programs
from scso_nlp.examples import example_folder
from scso_nlp.exceptions import EngineError
from scso_nlp.opensim import crew

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

#: Exit code of each signal by which a run is stopped.
SIGNALS = {} if os.name != "posix" else {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}

#: Lets IPOPT work on Rosenbrock's chain, which takes it a minute, and says when it begins.
SLOW_SOLVER = """
import casadi as ca, numpy as np
import scso_nlp.solver.programs as programs

class Slow:
    def __init__(self, nlp):
        x = ca.SX.sym("x", 20000)
        f = ca.sumsqr(10 * (x[1:] - x[:-1] ** 2)) + ca.sumsqr(1 - x[:-1])
        options = {"ipopt": {"print_level": 0, "sb": "yes", "max_iter": 100000}, "print_time": False}
        self.solver = ca.nlpsol("slow", "ipopt", {"x": x, "f": f}, options | {"error_on_fail": False})
        self.stats = self.solver.stats

    def __call__(self, **_):
        print("now", flush=True)
        return self.solver(x0=3 * np.random.default_rng(0).normal(size=20000))

programs.compile_ipopt = lambda nlp, options, **_: Slow(nlp)
"""

#: Lets the worker take a second for every frame, and says when it begins.
SLOW_WORKER = """
import scso_nlp.opensim.workers as workers
SLOW = '''
import time
from scso_nlp.opensim.worker.extraction import Extraction
fast = Extraction.frame
Extraction.frame = lambda self, row: (time.sleep(1), fast(self, row))[1]
'''
workers.PROGRAM = workers.PROGRAM.replace("sys.exit(main(", SLOW + "sys.exit(main(")
start = workers._start
def told(*arguments):
    process = start(*arguments)
    print("now", flush=True)
    return process
workers._start = told
"""

#: Says when three of the earlier files have left the folder, and holds up what follows.
SLOW_FILES = """
import time
from pathlib import Path
import scso_nlp.report.results as results
real = results.os.replace
left = []
def slow(source, target):
    real(source, target)
    left.extend([source] * (Path(source).parent.name == "results"))
    if len(left) == 3:
        print("now", flush=True)
    if len(left) >= 3:
        time.sleep(1)
results.os.replace = slow
"""

#: Says when a figure is drawn, and takes a minute for it.
SLOW_FIGURES = """
import time
import scso_nlp.figures as figures
def slow(*_, **options):
    print("now", flush=True)
    time.sleep(60)
figures.plot_moments = slow
"""

#: Runs a script with the signals as a terminal leaves them: nohup and background jobs ignore some.
AS_FROM_A_TERMINAL = """
import os, signal, sys
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)
os.execv(sys.executable, [sys.executable, "-c", sys.argv[1]])
"""


def command_line(arguments: str) -> str:
    return f"from scso_nlp.cli import app\napp({arguments.split()!r})\n"


COMMAND_LINE = command_line("run setup.xml --output results --processes 1")

#: Says when a figure for print is drawn, and takes a minute for it.
SLOW_PLOT = """
import time
import scso_nlp.figures.quantity as quantity
def slow(*_, **options):
    print("now", flush=True)
    time.sleep(60)
quantity.plot_quantity = slow
"""


def stop(script: str, number: int, folder: Path) -> tuple[int, str, float]:
    """Run a script until it says `now`, send it a signal; return exit code, stderr and the delay [s]."""
    temporary = folder / "temporary"
    temporary.mkdir(exist_ok=True)
    process = subprocess.Popen(
        [sys.executable, "-c", AS_FROM_A_TERMINAL, script],
        cwd=folder,
        env=os.environ | {"TMPDIR": str(temporary), "MPLBACKEND": "agg"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        line = next((line for line in process.stdout if line == "now\n"), "")
        assert line, process.communicate()[1]
        time.sleep(0.3)
        started = time.monotonic()
        process.send_signal(number)
        _, words = process.communicate(timeout=100)
        delay = time.monotonic() - started
    finally:
        process.kill()
    assert list(temporary.iterdir()) == [], "temporary files were left behind"
    assert not workers(temporary), "a worker was left behind"
    return process.returncode, words, delay


def workers(temporary: Path) -> list[str]:
    """Processes that still work in a folder for temporary files."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(path.read_bytes().decode(errors="replace"))
        except OSError:
            continue
    return [line for line in lines if str(temporary) in line]


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A writable copy of an example, with results of a run."""
    folder = tmp_path_factory.mktemp("solved") / "spine"
    shutil.copytree(example_folder("spine-load-height"), folder)
    subprocess.run([sys.executable, "-c", COMMAND_LINE], cwd=folder, check=True, capture_output=True)
    return folder


@pytest.fixture
def spine(solved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved, tmp_path / "spine"))


@pytest.mark.opensim
@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("slow", [SLOW_WORKER, SLOW_SOLVER, SLOW_FILES], ids=["extraction", "solve", "files"])
def test_a_stopped_run_leaves_the_earlier_results_whole_and_nothing_else(spine, number, slow):
    before = content(spine)
    code, words, delay = stop(slow + COMMAND_LINE, number, spine)
    assert (code, words) == (SIGNALS[number], f"stopped{_by(number)}\n")
    assert content(spine) == before
    # 0.1 s was seen; Rosenbrock's chain would go on for a minute
    assert delay < 20


@pytest.mark.opensim
def test_results_are_safe_before_the_first_figure(spine):
    code, words, _ = stop(SLOW_FIGURES + COMMAND_LINE, signal.SIGINT, spine)
    assert (code, words) == (130, "stopped\n")
    left = set(content(spine / "results"))
    assert {f"spine_load_height_{what}" for what in ("status.sto", "activations.png")} < left
    assert {"report.json", "spine_load_height_StaticOptimization_force.sto"} < left
    assert not any("moments.p" in name or name.startswith(".") for name in left)


@pytest.mark.opensim
@pytest.mark.parametrize(
    ("command", "slow"),
    [
        ("info setup.xml", SLOW_WORKER),
        ("doctor setup.xml", SLOW_WORKER),
        ("init setup.xml new.toml", SLOW_WORKER),
        ("reach setup.xml --stability potvin-brown", SLOW_WORKER),
        ("plot results", SLOW_PLOT),
    ],
)
def test_other_commands_end_at_once_and_leave_nothing(spine, command, slow):
    before = content(spine)
    code, words, delay = stop(slow + command_line(command), signal.SIGINT, spine)
    assert code == 130
    assert words.splitlines()[-1] == "stopped"
    assert "Traceback" not in words
    assert content(spine) == before
    assert delay < 20


def _by(number: int) -> str:
    return "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"


PYTHON = """
import sys
sys.path.insert(0, {tests!r})
from helpers import elbow
import scso_nlp as scso
try:
    scso.{solve}(elbow([5.0, 10.0]), on_failure="return")
except KeyboardInterrupt:
    sys.exit(77)
"""


@pytest.mark.parametrize("solve", ["solve_trajectory", "solve_framewise"])
def test_the_first_interrupt_ends_a_solve_in_python(tmp_path, solve):
    """CasADi drops the exception; what IPOPT had found by then must not be taken for an answer."""
    script = SLOW_SOLVER + PYTHON.format(tests=str(Path(__file__).parents[1]), solve=solve)
    code, words, delay = stop(script, signal.SIGINT, tmp_path)
    assert (code, words) == (77, "")
    assert delay < 20


@pytest.mark.parametrize("raises", [False, True])
def test_handlers_of_ones_own_work_during_a_solve_and_stand_afterwards(monkeypatch, raises):
    seen = []

    def own(number, _):
        seen.append(number)
        if raises:
            raise TimeoutError("of one's own")

    compiled = programs.compile_ipopt

    def with_signal(nlp, options, **more):
        solver = compiled(nlp, options, **more)

        class Signalled:
            stats = staticmethod(solver.stats)

            def __call__(self, **numbers):
                answer = solver(**numbers)
                os.kill(os.getpid(), signal.SIGUSR1)
                return answer

        return Signalled()

    monkeypatch.setattr(programs, "compile_ipopt", with_signal)
    previous = signal.signal(signal.SIGUSR1, own)
    before = {number: signal.getsignal(number) for number in signal.valid_signals()}
    try:
        with pytest.raises(TimeoutError) if raises else contextlib.nullcontext():
            assert scso.solve_trajectory(elbow([5.0])).is_solved.all()
        assert seen == [signal.SIGUSR1]
        assert {number: signal.getsignal(number) for number in signal.valid_signals()} == before
    finally:
        signal.signal(signal.SIGUSR1, previous)


def test_a_solve_in_another_thread_is_as_good():
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        assert pool.submit(scso.solve_trajectory, elbow([5.0])).result().is_solved.all()


@pytest.mark.opensim
def test_no_room_for_temporary_files_is_one_sentence(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(crew, "write_job", full)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(EngineError, match=r"cannot be given their work: No space left on device \(.* TMPDIR"):
        scso.load_motion(example_folder("spine-load-height") / "setup.xml")
    assert list(tmp_path.iterdir()) == []
