"""How fast studies are, what a trial costs besides its own work, and whether memory grows over many.

``python -m problems.studies_at_scale forty`` runs forty trials in this process and on clusters of
one and two workers; ``... thousand`` runs as many tiny problems and samples memory meanwhile. Both
print what they measured. Data are looked for where ``SCSO_SHARED_DATA`` says.
"""

from __future__ import annotations

import csv
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil

from scso_nlp.examples import example_folder
from scso_nlp.studies import Plan, plan, run
from scso_nlp.studies.running import _jobs
from scso_nlp.studies.work import solve_trial

DATA = Path(os.environ.get("SCSO_SHARED_DATA", "../shared/data")).resolve()
#: Setups with the ranges that are cut into windows [s], and how many windows of each.
CUT = {
    "gait10dof18musc/setup_static_optimization.xml": (0.5, 1.7, 10),
    "arm26/arm26_millard_Setup_StaticOptimization.xml": (0.0, 1.0, 5),
    "walking3d/setup_static_optimization.xml": (0.48, 1.61, 5),
}


def forty(folder: Path) -> Path:
    """Write a study file: windows of three motions, each again with another exponent."""
    rows = [("subject", "trial", "setup", "initial_time", "final_time", "exponent")]
    for setup, (start, end, n) in CUT.items():
        times = np.linspace(start, end, n + 1)
        subject = setup.split("/")[0]
        for exponent in (2, 3):
            for k in range(n):
                window = (f"{times[k]:.4f}", f"{times[k + 1]:.4f}")
                rows.append((subject, f"window{k}_p{exponent}", str(DATA / setup), *window, str(exponent)))
    return _written(folder / "forty.csv", rows)


def tiny(folder: Path, n: int) -> Plan:
    """Plan the embedded elbow ten times, by so many exponents that there are `n` runs."""
    setup = str(example_folder("elbow") / "setup.xml")
    rows = [("subject", "trial", "setup"), *(("S", f"trial{k}", setup) for k in range(10))]
    return plan(_written(folder / "tiny.csv", rows), grid={"exponent": np.linspace(2, 4, n // 10).tolist()})


def _written(path: Path, rows: list[tuple[str, ...]]) -> Path:
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    return path


def timed(do: Callable[[], object]) -> float:
    """Run something; give its wall time [s]."""
    started = time.perf_counter()
    do()
    return time.perf_counter() - started


def throughput(folder: Path) -> None:
    """Print times of forty trials: one process, one worker, two workers."""
    found = plan(forty(folder))
    n = len(found.trials)
    tasks = [job.task for job in _jobs(found, folder / "process")]
    alone = timed(lambda: [solve_trial(task) for task in tasks])
    print(f"{n} trials, one process: {alone:.1f} s", flush=True)
    for workers in (1, 2):
        seconds = timed(
            lambda w=workers: run(found, output=folder / f"workers{w}", workers=w, progress=False)
        )
        print(
            f"{workers} workers: {seconds:.1f} s, {alone / seconds:.2f} times as fast, "
            f"{workers * seconds / n - alone / n:+.3f} s of a worker's time per trial",
            flush=True,
        )


def memory(folder: Path, n: int) -> None:
    """Print the memory of this process and of the workers, over a study of many tiny runs."""
    found = tiny(folder, n)
    over = threading.Event()
    samples: list[tuple[int, list[int]]] = []

    def watch() -> None:
        me = psutil.Process()
        log = folder / "tiny" / "study.log"
        while not over.wait(2.0):
            ended = log.read_bytes().count(b"\n") if log.exists() else 0
            workers = [p for p in me.children() if "spawn_main" in " ".join(p.cmdline())]
            sizes = [process.memory_info().rss // 2**20 for process in (me, *workers)]
            samples.append((ended, sizes))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        seconds = timed(lambda: run(found, output=folder / "tiny", workers=2, progress=False))
    finally:
        over.set()
        watcher.join()
    print(f"{n} runs on 2 workers: {seconds:.1f} s, {seconds / n:.3f} s each")
    for mark in (0.1, 0.25, 0.5, 0.75, 0.98):
        ended, sizes = min(samples, key=lambda sample: abs(sample[0] - mark * n))
        print(f"after {ended} runs: this process {sizes[0]} MiB, workers {sizes[1:]} MiB")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        if sys.argv[1] == "forty":
            throughput(Path(temporary))
        else:
            memory(Path(temporary), int(sys.argv[2]) if len(sys.argv) > 2 else 1000)
