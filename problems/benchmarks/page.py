"""From measurements to words: the table, the page docs/benchmarks.md and the paragraph of README."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from problems.benchmarks.cases import CASES
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
#: README's paragraph, up to the next empty line.
PARAGRAPH = re.compile(r"^Speed\b.*(\n.+)*", re.MULTILINE)
#: Of so many motions, the longest, and in lines of this width.
_MOST_MOTIONS, _WIDTH = 2, 120
_TEMPLATE = Path(__file__).with_name("page.md")
_OPENSIM, _RUN, _TRAJECTORY = "OpenSim", "scso run", "trajectory-wide"
_OTHERS = ("frame by frame", "DAQP", "PIQP", "Clarabel", "HiGHS", "SciPy SLSQP")
_KINDS = ("SO", "SCSO", "full")


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


def beside_opensim(rows: Sequence[Measurement]) -> list[list[str]]:
    """Compare whole runs with OpenSim's static optimization of the same frames, or of a part of them."""
    found = []
    for case, some in _by_case(rows).items():
        theirs = _static_optimization(some)
        if theirs is None:
            continue
        runs = {row["what"]: row for row in some if row["by"] == _RUN}
        cells = [case, str(theirs["frames"]), f"{1e3 * _cpu(theirs):.3g}"]
        for kind in _KINDS:
            run = runs.get(f"whole run, {kind}")
            cells.append("" if run is None else f"{_cpu(theirs) / _wall(run):.3g}")
        start = runs.get("start-up, SO")
        found.append([*cells, "" if start is None else f"{start['seconds']:.2f}"])
    return found


def beside_libraries(rows: Sequence[Measurement]) -> list[list[str]]:
    """Compare trajectory-wide solving with everybody else on the same question, in processor time a frame."""
    found = []
    for case, some in _by_case(rows).items():
        answers = {(r["what"], r["power"], r["by"]): r for r in some if r.get("kept")}
        for (what, power, by), ours in answers.items():
            if by != _TRAJECTORY:
                continue
            others = [answers.get((what, power, name)) for name in _OTHERS]
            like = what.replace(_KINDS[1], _KINDS[0], 1).replace(_KINDS[2], _KINDS[0], 1)
            others += [answers.get((what, 2.0, "DAQP")), answers.get((like, power, _TRAJECTORY))]
            cells = [case, what, f"{float(power):g}", f"{1e3 * _cpu(ours):.3g}"]
            ratios = [_ratio(ours, other) for other in others]
            if any(ratios):
                found.append(cells + ratios)
    return found


def _ratio(row: Measurement, other: Measurement | None) -> str:
    if other is None or other is row:
        return ""
    lost = other["frames"] - other["kept"]
    return f"{_cpu(row) / _cpu(other):.3g}" + (f" ({lost} lost)" if lost else "")


def _by_case(rows: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    found: dict[str, list[Measurement]] = {}
    for row in rows:
        if row.get("frames") and "cpu_seconds" in row:
            found.setdefault(row["case"], []).append(row)
    return found


def _static_optimization(rows: Sequence[Measurement]) -> Measurement | None:
    what = f"{_OPENSIM}'s StaticOptimization"
    return next((row for row in rows if (row["by"], row["what"]) == (_OPENSIM, what)), None)


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
        cases=markdown_table(["case", "about", "s", "CPU s"], _cases(result)),
        facts=facts,
        opensim=markdown_table(
            ["case", "OpenSim's frames", "ms a frame", *_KINDS, "start-up [s]"], beside_opensim(rows)
        ),
        libraries=markdown_table(
            ["case", "what", "p", "CPU ms/frame", *_OTHERS, "DAQP at p = 2", "SO, ours"],
            beside_libraries(rows),
        ),
        slopes=markdown_table(
            ["what", "frames", "slope of CPU s", "ms/frame", "slope of MB", "kB/frame"], slopes(rows)
        ),
        table=table(rows),
    )
    _write(folder / "docs" / "benchmarks.md", text)
    readme = (folder / "README.md").read_text(encoding="utf-8")
    _write(folder / "README.md", PARAGRAPH.sub(lambda _: paragraph(result), readme, count=1))


def paragraph(result: dict[str, Any]) -> str:
    """Say in a few lines what README says about speed."""
    facts = result["facts"]
    motions = []
    for case, rows in _by_case(result["rows"]).items():
        runs = {row["what"]: row for row in rows if row["by"] == _RUN}
        if "whole run, SO" not in runs:
            continue
        frames = runs["whole run, SO"]["frames"]
        theirs = _static_optimization(rows)
        part = "" if theirs is None or theirs["frames"] >= frames else f" ({theirs['frames']:,} of them)"
        ours = [_seconds(runs.get(f"whole run, {kind}")) for kind in _KINDS]
        motions.append(
            (
                frames,
                f"{case}, {frames:,} frames: {', '.join([_seconds(theirs, 'cpu_seconds') + part, *ours])}",
            )
        )
    longest = sorted(motions)[-_MOST_MOTIONS:]
    text = (
        f"Speed: seconds of whole runs, figures apart ({facts['cores']} cores, {result['date']}): OpenSim's "
        "static optimization (of the processor: it uses one core), ours, with stability of knees and ankles, "
        "with their whole Hessian. "
        f"{'; '.join(words for _, words in longest)}. More: `docs/benchmarks.md`."
    )
    return textwrap.fill(text, _WIDTH, break_on_hyphens=False, break_long_words=False)


def _wall(row: Measurement) -> float:
    return row["seconds"] / row["frames"]


def _cpu(row: Measurement) -> float:
    return row["cpu_seconds"] / row["frames"]


def _cases(result: dict[str, Any]) -> list[list[str]]:
    about = {case.name: case.about for case in CASES}
    spent = result["seconds"]
    return [[name, about[name], *(f"{v:.0f}" for v in both.values())] for name, both in spent.items()]


def _seconds(row: Measurement | None, which: str = "seconds") -> str:
    return "–" if row is None else f"{row[which]:.1f}"


def _write(path: Path, text: str) -> None:
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
