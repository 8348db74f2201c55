"""How fast studies are, what a trial costs besides its own work, and whether memory grows over many.

``python -m problems.studies_at_scale forty`` runs forty trials of less than a second in this process,
one after the other, in two processes, and on clusters of two workers and one; ``... long`` the same with
twelve trials that take some five seconds each. ``... thousand`` runs as many tiny problems, ``... hundreds``
twenty real ones by twenty exponents, or by so many that there are as many runs as asked, and sample memory
meanwhile. All print what they measured. Data are looked for where ``SCSO_SHARED_DATA`` says.
"""

from __future__ import annotations

import csv
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from scso_nlp.examples import example_folder
from scso_nlp.studies import Plan, plan, run
from scso_nlp.studies.record import Outcome
from scso_nlp.studies.running import _jobs
from scso_nlp.studies.work import Task, solve_trial

DATA = Path(os.environ.get("SCSO_SHARED_DATA", "../shared/data")).resolve()
#: Setups with the ranges that are cut into windows [s], and how many windows of each.
CUT = {
    "gait10dof18musc/setup_static_optimization.xml": (0.5, 1.7, 10),
    "arm26/arm26_millard_Setup_StaticOptimization.xml": (0.0, 1.0, 5),
    "walking3d/setup_static_optimization.xml": (0.48, 1.61, 5),
}
#: Columns of a study file.
WINDOW = ("subject", "trial", "setup", "initial_time", "final_time")


def _windows() -> Iterator[tuple[str, str, str, str, str]]:
    for setup, (start, end, n) in CUT.items():
        times = np.linspace(start, end, n + 1)
        for k in range(n):
            place = (setup.split("/")[0], f"window{k}", str(DATA / setup))
            yield (*place, f"{times[k]:.4f}", f"{times[k + 1]:.4f}")


def forty(folder: Path) -> Path:
    """Write a study file: windows of three motions, each again with another exponent."""
    rows = [(*WINDOW, "exponent")]
    for exponent in ("2", "3"):
        for subject, name, *window in _windows():
            rows.append((subject, f"{name}_p{exponent}", *window, exponent))
    return _written(folder / "forty.csv", rows)


def long(folder: Path) -> Path:
    """Write a study file: windows of walking; six are long for OpenSim, six (compliant tendons) for IPOPT."""
    rows = [(*WINDOW, "exponent", "q", "stability", "joints", "step_interval", "muscle_model")]
    setup = str(DATA / "walking3d/setup_static_optimization.xml")
    times = np.linspace(0.48, 1.23, 4)
    for exponent in (2, 3):
        for k in range(3):
            window = (f"{times[k]:.4f}", f"{times[k + 1]:.4f}", str(exponent), "40")
            for step, model in (("1", "opensim-rigid"), ("20", "compliant")):
                name = f"window{k}_p{exponent}_{model}"
                rows.append(("walking3d", name, setup, *window, "potvin-brown", "ankle_r", step, model))
    return _written(folder / "long.csv", rows)


def hundreds(folder: Path, n: int) -> Plan:
    """Plan the twenty windows of three motions, by so many exponents that there are `n` runs."""
    return _by_exponents(folder, [WINDOW, *_windows()], n)


def thousand(folder: Path, n: int) -> Plan:
    """Plan the embedded elbow ten times, by so many exponents that there are `n` runs."""
    setup = str(example_folder("elbow") / "setup.xml")
    return _by_exponents(folder, [WINDOW[:3], *(("S", f"trial{k}", setup) for k in range(10))], n)


def _by_exponents(folder: Path, rows: list[tuple[str, ...]], n: int) -> Plan:
    exponents = np.linspace(2, 4, n // (len(rows) - 1)).tolist()
    return plan(_written(folder / "many.csv", rows), grid={"exponent": exponents})


def _written(path: Path, rows: list[tuple[str, ...]]) -> Path:
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    return path


class Cost(NamedTuple):
    """Wall time, and processor time of this process and of those that it has started and seen end [s]."""

    wall: float
    processor: float

    def __str__(self) -> str:
        return f"{self.wall:.1f} s, {self.processor:.1f} s of processors"


def cost(do: Callable[[], object]) -> Cost:
    """Run something."""
    before = os.times()
    do()
    after = os.times()
    return Cost(after.elapsed - before.elapsed, sum(after[:4]) - sum(before[:4]))


def throughput(folder: Path, study: Path) -> None:
    """Print times of a study: one process; two beside each other; clusters of two workers and of one."""
    found = plan(study)
    n = len(found.trials)
    first, second = ([job.task for job in _jobs(found, folder / name)] for name in ("one", "two"))
    ends: list[Outcome] = []
    alone = cost(lambda: ends.extend(map(solve_trial, first)))
    stages = {stage: sum(end.seconds.get(stage, 0.0) for end in ends) for stage in ends[-1].seconds}
    told = ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in stages.items())
    print(f"{n} trials, one process: {alone}; {told}", flush=True)
    ways = {
        "two processes without Dask": lambda: _by_two(second),
        "a cluster of two": lambda: run(found, output=folder / "cluster2", workers=2, progress=False),
        "a cluster of one": lambda: run(found, output=folder / "cluster1", workers=1, progress=False),
    }
    for name, way in ways.items():
        taken = cost(way)
        more = (taken.processor - alone.processor) / n
        print(
            f"{name}: {taken}, {alone.wall / taken.wall:.2f} times as fast, {more:+.3f} s a trial", flush=True
        )


def _by_two(tasks: list[Task]) -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        list(pool.map(solve_trial, tasks))


def memory(folder: Path, found: Plan) -> None:
    """Print the memory of this process and of the workers, over a study of many runs."""
    n = len(found.trials)
    over = threading.Event()
    samples: list[tuple[int, list[int]]] = []

    def watch() -> None:
        me = psutil.Process()
        log = folder / "many" / "study.log"
        while not over.wait(2.0):
            ended = log.read_bytes().count(b"\n") if log.exists() else 0
            workers = [p for p in me.children() if "spawn_main" in " ".join(p.cmdline())]
            sizes = [process.memory_info().rss // 2**20 for process in (me, *workers)]
            samples.append((ended, sizes))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        taken = cost(lambda: run(found, output=folder / "many", workers=2, progress=False))
    finally:
        over.set()
        watcher.join()
    print(f"{n} runs on 2 workers: {taken}, {taken.processor / n:.3f} s each")
    for mark in (0.1, 0.25, 0.5, 0.75, 0.98):
        ended, sizes = min(samples, key=lambda sample: abs(sample[0] - mark * n))
        print(f"after {ended} runs: this process {sizes[0]} MiB, workers {sizes[1:]} MiB")


if __name__ == "__main__":
    name, *numbers = sys.argv[1:]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if name in ("forty", "long"):
            throughput(folder, {"forty": forty, "long": long}[name](folder))
        else:
            planned, usual = {"hundreds": (hundreds, 400), "thousand": (thousand, 1000)}[name]
            memory(folder, planned(folder, int(numbers[0]) if numbers else usual))
