"""From measurements to words: the table, the page docs/benchmarks.md and the paragraph of README."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from problems.outputs import markdown_table
from scso_nlp.files import write_whole

Measurement = dict[str, Any]
#: Columns: title, key, format.
COLUMNS = (
    ("case", "case", "{}"),
    ("what", "what", "{}"),
    ("p", "power", "{:g}"),
    ("by", "by", "{}"),
    ("frames", "frames", "{}"),
    ("s", "seconds", "{:.3g}"),
    ("CPU s", "cpu_seconds", "{:.3g}"),
    ("CPU ms/frame", "cpu_per_frame", "{:.3g}"),
    ("MB", "peak_mb", "{:.0f}"),
    ("kept", "kept", "{}"),
    ("equilibrium missed", "equilibrium", "{:.0e}"),
    ("stability missed", "stability", "{:.0e}"),
    ("objective above best", "objective", "{:.0e}"),
    ("note", "note", "{}"),
)
#: README's paragraph stands between these.
BEGIN, END = "<!-- speed: python -m problems.benchmarks --pages -->", "<!-- end of speed -->"
_PAGE, _README = (Path(__file__).parents[2] / part for part in ("docs/benchmarks.md", "README.md"))
_OPENSIM, _RUN, _TRAJECTORY, _FRAMEWISE = "OpenSim", "scso run", "trajectory-wide", "frame by frame"


def cells(row: Measurement) -> list[str]:
    """Lay out one measurement."""
    if row.get("frames") and "cpu_seconds" in row:
        row = {**row, "cpu_per_frame": 1e3 * row["cpu_seconds"] / row["frames"]}
    found = []
    for _, key, form in COLUMNS:
        value = row.get(key)
        found.append("" if value is None else form.format(math.inf if value == "inf" else value))
    return found


def table(rows: Iterable[Measurement]) -> str:
    """Lay out measurements as a Markdown table."""
    return markdown_table([title for title, _, _ in COLUMNS], [cells(row) for row in rows])


def slopes(rows: Sequence[Measurement]) -> list[list[str]]:
    """Fit time and memory of solving against frames on a log-log scale, by question."""
    found = []
    alone = [row for row in rows if row["case"] == "synthetic_frames" and "solving_mb" in row]
    for what in dict.fromkeys(row["what"] for row in alone):
        some = [row for row in alone if row["what"] == what]
        if len(some) < 3:
            continue
        frames = np.log([row["frames"] for row in some])
        cost = {key: np.array([row[key] for row in some]) for key in ("cpu_seconds", "solving_mb")}
        slope = {key: np.polyfit(frames, np.log(np.maximum(v, 1e-9)), 1)[0] for key, v in cost.items()}
        each = {key: np.polyfit(np.exp(frames), v, 1)[0] for key, v in cost.items()}
        found.append(
            [
                what.removesuffix(", alone"),
                f"{some[0]['frames']} to {some[-1]['frames']}",
                f"{slope['cpu_seconds']:.2f}",
                f"{1e3 * each['cpu_seconds']:.2f}",
                f"{slope['solving_mb']:.2f}",
                f"{1e3 * each['solving_mb']:.1f}",
            ]
        )
    return found


def ratios(rows: Sequence[Measurement]) -> list[list[str]]:
    """Compare, within each case: a whole run with OpenSim's, a trajectory with the best of the libraries."""
    found = []
    for case in dict.fromkeys(row["case"] for row in rows):
        some = [row for row in rows if row["case"] == case and row.get("frames") and "cpu_seconds" in row]
        theirs = [r for r in some if r["by"] == _OPENSIM and r["what"].endswith("StaticOptimization")]
        for row in some:
            if theirs and row["by"] == _RUN and row["what"].startswith("whole run"):
                value = _wall(theirs[0]) / _wall(row)
                found.append([case, row["what"], "OpenSim over ours, wall", f"{value:.0f}"])
        ours = [row for row in some if row["by"] == _TRAJECTORY and "kept" in row]
        for row in ours:
            peers = [r for r in some if (r["what"], r.get("power")) == (row["what"], row.get("power"))]
            what = f"{row['what']}, p = {row['power']}"
            for by in (_FRAMEWISE, "DAQP", "PIQP", "Clarabel"):
                for peer in (r for r in peers if r["by"] == by and r.get("kept")):
                    lost = peer["frames"] - peer["kept"]
                    words = f"ours, trajectory-wide, over {by}, CPU" + (f" (loses {lost} frames)" if lost else "")
                    found.append([case, what, words, f"{_cpu(row) / _cpu(peer):.1f}"])
            floor = [r for r in some if r["what"] == row["what"] and r["by"] == "DAQP" and r["power"] == 2]
            if floor and row["power"] != 2:
                value = f"{_cpu(row) / _cpu(floor[0]):.1f}"
                found.append([case, what, "ours, trajectory-wide, over DAQP at p = 2, CPU", value])
        plain = [r for r in ours if r["what"].startswith("SO")]
        for row in (r for r in ours if r["what"].startswith("full")):
            like = row["what"].replace("full", "SO", 1)
            for base in (r for r in plain if (r["what"], r["power"]) == (like, row["power"])):
                what = f"{row['what']}, p = {row['power']}"
                found.append([case, what, "full over SO, ours, CPU", f"{_cpu(row) / _cpu(base):.1f}"])
    return found


def write_pages(result: dict[str, Any], source: str) -> None:
    """Write docs/benchmarks.md and README's paragraph.

    Parameters
    ----------
    result : dict
        A result file as read.
    source : str
        Its name.
    """
    rows = result["rows"]
    facts = ", ".join(f"{name} {value}" for name, value in result["facts"].items())
    text = f"""# Benchmarks

Made by `python -m problems.benchmarks --pages` from `problems/benchmarks/results/{source}`, measured on
{result["date"]}: {facts}.

```sh
pip install ".[benchmark]"
python -m problems.benchmarks                       # all of it, or --quick, --cases, --peers
```

Whole runs are processes without figures: wall time, processor time of all their processes, memory of the largest.
Start-up is a whole run of one frame. Extraction, writing and figures are timed within one process; solving is from a
problem to a judged solution, presolve and build included. Libraries are called directly, frame by frame, with their
matrices laid out beforehand; DAQP at other powers than 2 by Newton's method on its programs, Clarabel by power cones,
min/max as linear programs. What takes less than a second is measured three times, and the median counts.

Every answer, ours and theirs, is judged by the same few lines of NumPy (`problems/benchmarks/questions.py`): *kept*
counts the frames that miss nothing by more than 1e-4 N·m, N or N·m/rad (bounds: 1e-6); *missed* is the largest, over
all frames; *objective above best* that of the worst kept frame, relative to the best answer that anybody has for it.
SciPy's SLSQP, HiGHS and Clarabel are asked about frames spread evenly over long motions.

## Ratios

{markdown_table(["case", "what", "ratio", ""], ratios(rows))}
## Slopes

Of time and memory of solving (beyond that of a process that has solved a short motion) against frames, fitted on a
log-log scale, and per frame.

{markdown_table(["what", "frames", "slope of CPU s", "ms/frame", "slope of MB", "kB/frame"], slopes(rows))}
## All measurements

{table(rows)}"""
    _write(_PAGE, text)
    readme = _README.read_text(encoding="utf-8")
    if BEGIN in readme:
        before, rest = readme.split(BEGIN)
        _, after = rest.split(END)
        _write(_README, f"{before}{BEGIN}\n{paragraph(result)}{END}{after}")


def paragraph(result: dict[str, Any]) -> str:
    """Say in a few lines what README says about speed."""
    by_case: dict[str, list[Measurement]] = {}
    for row in result["rows"]:
        by_case.setdefault(row["case"], []).append(row)
    processor = result["facts"].get("processor", result["facts"]["machine"])
    parts = [f"Time of whole runs without figures ({result['facts']['cores']} cores, {processor}, {result['date']}):\n"]
    lines = []
    for case, rows in by_case.items():
        runs = {row["what"]: row for row in rows if row["by"] == _RUN and row.get("frames")}
        if "whole run, SO" not in runs:
            continue
        theirs = [r for r in rows if r["by"] == _OPENSIM and r["what"].endswith("StaticOptimization")]
        seconds = [_seconds(runs.get(f"whole run, {kind}")) for kind in ("SO", "SCSO", "full")]
        opensim = "–"
        if theirs and "seconds" in theirs[0] and theirs[0].get("frames"):
            share = theirs[0]["frames"] < runs["whole run, SO"]["frames"]
            opensim = _seconds(theirs[0]) + (f" ({theirs[0]['frames']} frames)" if share else "")
        lines.append([case, runs["whole run, SO"]["frames"], opensim, *seconds])
    heads = ["motion", "frames", "OpenSim's SO [s]", "SO [s]", "stable about joints [s]", "whole Hessian [s]"]
    parts.append(markdown_table(heads, lines))
    parts.append("\nStages, library solvers on the same frames, and what every answer is worth: `docs/benchmarks.md`.\n")
    return "\n".join(parts[:2]) + parts[2]


def _wall(row: Measurement) -> float:
    return row["seconds"] / row["frames"]


def _cpu(row: Measurement) -> float:
    return row["cpu_seconds"] / row["frames"]


def _seconds(row: Measurement | None) -> str:
    return "–" if row is None else f"{row['seconds']:.1f}"


def _write(path: Path, text: str) -> None:
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
