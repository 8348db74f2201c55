"""Time, memory and worth of the answers of this package and of others, case by case, as one table.

Usage: python -m problems.benchmarks [--quick] [--cases a,b] [--peers x,y] [--output FILE] [--pages]

Each case runs in a process of its own. Results are written after every measurement; a run with the same
output goes on with the cases that it has not finished. Nothing is asserted about time. Exit code 1: the
process of a case broke.
"""

from __future__ import annotations

import argparse
import datetime
import json
import logging
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from problems.benchmarks.cases import CASES
from problems.benchmarks.measuring import MOCO, OPENSIM, ROOT, facts, measure, processor_seconds
from problems.benchmarks.page import table, write_pages
from problems.benchmarks.peers import PEERS
from scso_nlp.files import write_whole

MEASURED = Path(__file__).parent / "measured"
_NAMES = {case.name: case for case in CASES}
_PEERS = (*(peer.name for peer in PEERS), OPENSIM, MOCO)


def main(words: list[str] | None = None) -> int:
    """Measure what is asked for, print the table and write the result."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=_among(_NAMES), help=f"among {', '.join(_NAMES)}")
    parser.add_argument("--peers", type=_among(_PEERS), help=f"among {', '.join(_PEERS)}, or none")
    parser.add_argument("--quick", action="store_true", help="p = 2, small sizes, few frames for OpenSim")
    default = os.environ.get("SCSO_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of the third-party data")
    parser.add_argument("--output", type=Path, help="result file; by default measured/<date>.json")
    parser.add_argument(
        "--pages", action="store_true", help="write page and README from --output, or the latest"
    )
    parser.add_argument("--one", choices=_NAMES, help=argparse.SUPPRESS)
    chosen = parser.parse_args(words)
    if chosen.one:
        _measure_one(chosen)
        return 0
    if chosen.pages:
        dated = sorted(path for path in MEASURED.glob("*.json") if "quick" not in path.name)
        if chosen.output is None and not dated:
            parser.error(f"there is no result in {MEASURED}: measure first, or name one with --output")
        source = chosen.output or dated[-1]
        write_pages(json.loads(source.read_text(encoding="utf-8")), source.name, ROOT)
        return 0
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    output = chosen.output or MEASURED / f"{today}{'_quick' if chosen.quick else ''}.json"
    result = _begun(output, today, chosen.quick)
    for name in chosen.cases or _NAMES:
        if name not in result["seconds"]:
            _run_case(name, chosen, result, output)
    print(table(result["rows"]))
    return int(any(name not in result["seconds"] for name in chosen.cases or _NAMES))


def _begun(output: Path, today: str, quick: bool) -> dict[str, Any]:
    """Read what an earlier run has finished, or begin."""
    new = {"date": today, "quick": quick, "facts": facts(), "seconds": {}, "rows": []}
    if not output.is_file():
        output.parent.mkdir(parents=True, exist_ok=True)
        return new
    old = json.loads(output.read_text(encoding="utf-8"))
    if (old["facts"], old["quick"]) != (new["facts"], quick):
        raise SystemExit(
            f"{output} was measured elsewhere, with other versions or otherwise quick: give another --output"
        )
    old["rows"] = [row for row in old["rows"] if row["case"] in old["seconds"]]
    return old


def _run_case(name: str, chosen: argparse.Namespace, result: dict[str, Any], output: Path) -> None:
    """Measure one case in a process of its own; write every measurement as it comes."""
    started, used = time.perf_counter(), processor_seconds()
    command = [sys.executable, "-m", "problems.benchmarks", "--one", name]
    command += ["--data", str(chosen.data.resolve())]
    command += ["--quick"] if chosen.quick else []
    command += [] if chosen.peers is None else ["--peers", ",".join(chosen.peers) or "none"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        for line in process.stdout:
            result["rows"].append(json.loads(line))
            _write(result, output)
            print(table(result["rows"][-1:]).splitlines()[-1], flush=True)
    if process.returncode:
        note = f"the process of this case ended with {process.returncode}"
        result["rows"].append({"case": name, "what": "all", "by": "", "note": note})
    else:
        seconds = time.perf_counter() - started, processor_seconds() - used
        result["seconds"][name] = dict(zip(("wall", "processor"), np.round(seconds, 1).tolist(), strict=True))
    _write(result, output)


def _measure_one(chosen: argparse.Namespace) -> None:
    """Print one line of JSON per measurement; what libraries print goes elsewhere, warnings nowhere."""
    logging.disable(logging.WARNING)
    case = _NAMES[chosen.one].quick() if chosen.quick else _NAMES[chosen.one]
    lines = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    peers = None if chosen.peers is None else frozenset(chosen.peers)
    for row in measure(case, chosen.data.resolve(), peers):
        finite = {k: v for k, v in row.items() if not isinstance(v, float) or math.isfinite(v)}
        if math.isinf(row.get("power", 0.0)):
            finite["power"] = "inf"
        print(json.dumps(finite, allow_nan=False), file=lines, flush=True)


def _write(result: dict[str, Any], output: Path) -> None:
    with write_whole(output) as temporary:
        temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def _among(names: Any) -> Any:
    def read(text: str) -> list[str]:
        words = [] if text == "none" else text.split(",")
        for word in words:
            if word not in names:
                raise argparse.ArgumentTypeError(f"unknown {word!r}, expected some of {', '.join(names)}")
        return words

    return read


if __name__ == "__main__":
    sys.exit(main())
