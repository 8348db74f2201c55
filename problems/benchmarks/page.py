"""From measurements to words: the table, the page docs/benchmarks.md and the paragraph of README."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
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
_TEMPLATE = Path(__file__).with_name("page.md")
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
                found.append([case, row["what"], "OpenSim over ours, wall, per frame", f"{value:.0f}"])
        ours = [row for row in some if row["by"] == _TRAJECTORY and "kept" in row]
        for row in ours:
            peers = [r for r in some if (r["what"], r.get("power")) == (row["what"], row.get("power"))]
            what = f"{row['what']}, p = {row['power']}"
            for by in (_FRAMEWISE, "DAQP", "PIQP", "Clarabel"):
                for peer in (r for r in peers if r["by"] == by and r.get("kept")):
                    lost = peer["frames"] - peer["kept"]
                    words = f"ours, trajectory-wide, over {by}, CPU" + (
                        f" (loses {lost} frames)" if lost else ""
                    )
                    found.append([case, what, words, f"{_cpu(row) / _cpu(peer):.1f}"])
            floor = [r for r in some if r["what"] == row["what"] and r["by"] == "DAQP" and r["power"] == 2]
            if floor and row["power"] != 2:
                value = f"{_cpu(row) / _cpu(floor[0]):.1f}"
                found.append([case, what, "trajectory-wide over DAQP at p = 2", value])
        plain = [r for r in ours if r["what"].startswith("SO")]
        for row in (r for r in ours if r["what"].startswith("full")):
            like = row["what"].replace("full", "SO", 1)
            for base in (r for r in plain if (r["what"], r["power"]) == (like, row["power"])):
                what = f"{row['what']}, p = {row['power']}"
                found.append([case, what, "full over SO", f"{_cpu(row) / _cpu(base):.1f}"])
    return found


def write_pages(result: dict[str, Any], source: str, folder: Path) -> None:
    """Write docs/benchmarks.md and README's paragraph.

    Parameters
    ----------
    result : dict
        A result file as read.
    source : str
        Its name.
    folder : Path
        Of README.md and docs.
    """
    rows = result["rows"]
    facts = ", ".join(f"{name} {value}" for name, value in result["facts"].items())
    text = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        source=source,
        date=result["date"],
        facts=facts,
        ratios=markdown_table(["case", "what", "ratio", ""], ratios(rows)),
        slopes=markdown_table(
            ["what", "frames", "slope of CPU s", "ms/frame", "slope of MB", "kB/frame"], slopes(rows)
        ),
        table=table(rows),
    )
    _write(folder / "docs" / "benchmarks.md", text)
    readme = (folder / "README.md").read_text(encoding="utf-8")
    if BEGIN in readme:
        before, rest = readme.split(BEGIN)
        _, after = rest.split(END)
        _write(folder / "README.md", f"{before}{BEGIN}\n{paragraph(result)}{END}{after}")


def paragraph(result: dict[str, Any]) -> str:
    """Say in a few lines what README says about speed."""
    facts = result["facts"]
    machine = f"{facts['cores']} cores, {facts.get('processor', facts['machine'])}, {result['date']}"
    lines = []
    for case in dict.fromkeys(row["case"] for row in result["rows"]):
        rows = [row for row in result["rows"] if row["case"] == case and row.get("frames")]
        runs = {row["what"]: row for row in rows if row["by"] == _RUN}
        if "whole run, SO" not in runs:
            continue
        frames = runs["whole run, SO"]["frames"]
        theirs = [r for r in rows if r["by"] == _OPENSIM and r["what"].endswith("StaticOptimization")]
        opensim = "–"
        if theirs:
            some = theirs[0]["frames"]
            opensim = _seconds(theirs[0]) + (f" ({some} frames)" if some < frames else "")
        ours = [_seconds(runs.get(f"whole run, {kind}")) for kind in ("SO", "SCSO", "full")]
        lines.append([case, frames, opensim, *ours])
    heads = ["s", "frames", "OpenSim's SO", "SO", "with stability about joints", "whole Hessian"]
    return (
        f"\nSeconds of whole runs, figures apart ({machine}):\n\n{markdown_table(heads, lines)}\n"
        "Stages, library solvers on the same frames, and what every answer is worth: `docs/benchmarks.md`.\n"
    )


def _wall(row: Measurement) -> float:
    return row["seconds"] / row["frames"]


def _cpu(row: Measurement) -> float:
    return row["cpu_seconds"] / row["frames"]


def _seconds(row: Measurement | None) -> str:
    return "–" if row is None else f"{row['seconds']:.1f}"


def _write(path: Path, text: str) -> None:
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
