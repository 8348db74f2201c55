"""Studies that tests run: small ones, what they leave on disk, and clusters that others have started."""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Self

from scso_nlp.examples import example_folder
from scso_nlp.report.folder import REPORT
from scso_nlp.studies.record import LOG, STUDY, TRIAL, read_study

#: Of `report.json`: what another run of the same may tell otherwise.
TIMES = ("written", "seconds", "solver")


def contents(folder: Path) -> dict[str, object]:
    """All files of a study but the log, with nothing in them of times and of the study's own place."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.name in (REPORT, TRIAL):
            text = path.read_text(encoding="utf-8").replace(str(folder), "STUDY")
            found[name] = {key: v for key, v in json.loads(text).items() if key not in TIMES}
        elif path.is_file() and path.name not in (LOG, STUDY):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    found[STUDY] = read_study(folder)
    return found


def lines_of(folder: Path) -> list[list[str]]:
    return [line.split("\t") for line in (folder / LOG).read_text(encoding="utf-8").splitlines()]


def three_trials(folder: Path) -> Path:
    """Two people, one with two trials."""
    for place in ("S1/hold", "S1/lift", "S2/hold"):
        shutil.copytree(example_folder("elbow"), folder / place)
        (folder / place / "scso.toml").unlink()
    return folder


class Cluster:
    """A scheduler and workers, started by Dask's own commands in a folder; all end with the block."""

    def __init__(self, folder: Path, workers: int = 2) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.number = folder, workers

    def __enter__(self) -> Self:
        told = self.folder / "scheduler.json"
        self.scheduler = self._start(
            *("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"),
            *("--scheduler-file", str(told)),
        )
        self.workers = []
        try:
            until = time.monotonic() + 60
            # the file is there before what it says
            while not (text := told.read_text() if told.exists() else "") and time.monotonic() < until:
                time.sleep(0.1)
            self.address = json.loads(text)["address"]
            for _ in range(self.number):
                self.workers.append(
                    self._start(
                        *("worker", "--scheduler-file", str(told), "--nthreads", "1", "--no-dashboard"),
                        *("--local-directory", str(self.folder), "--death-timeout", "20"),
                    )
                )
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            process.send_signal(signal.SIGTERM)
        for process in (*self.workers, self.scheduler):
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *words],
            cwd=self.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
