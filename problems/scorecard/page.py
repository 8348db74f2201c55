"""From measurements to docs/scorecard.md, .csv and .png, and README's paragraph. Verdicts are made here."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from problems.knee_implant.problem import TRIALS
from problems.outputs import markdown_table, write_table
from problems.scorecard import figure, rules
from problems.scorecard.running import NULLS, SO, Row, entry
from problems.scorecard.sets import SETS
from scso_nlp.figures import save_figure
from scso_nlp.files import write_whole

#: README's paragraph, up to the next empty line.
PARAGRAPH = re.compile(r"^Scorecard\b.*(\n.+)*", re.MULTILINE)
#: Columns of the CSV file.
COLUMNS = (
    "set", "kind", "unit", "method", "at the effort of", "power", "solved", "units",
    *(f"{metric}{what}" for metric in ("agonists", "antagonists", "contact force [N]")
      for what in ("", ", minus SO", ", low", ", high")),
    "effort", "reserves", "missed", "verdict", "note",
)  # fmt: skip
_METRICS = ("agonists", "antagonists", "contact force")
_WIDTH = 120
_TEMPLATE = Path(__file__).with_name("page.md")
#: Sets without a measurement of the very motion, and what they are about.
_PREDICTIONS = {
    "load height": "Tasks: 4.5 kg at 0, 0.2, 0.4, 0.6 and 0.8 m, then 9 kg; equal net moments each",
    "effort": "Tasks: 0.5, 1, 2, 3 and 4 times the moment",
}
_OWN = "axes, q = 5"
#: What `at_effort` says of a term that is too weak, and what that means where no strength is left to raise.
_TOO_WEAK = re.compile(
    r"effort is (\S+), but the term takes (\S+) at its strongest, ([^\s,:]+)"
    r"(?:: raise|, where it is missed at its price \(soft\): raise the price or lower) that"
)
_NOT_REACHED = r"short of the effort: \2 of \1 in one motion, at its greatest strength, \3"


def judged(name: str, measured: Mapping[str, Any]) -> Iterator[tuple[Row, str, str]]:
    """Give each row of a set with its verdict and a note.

    Parameters
    ----------
    name : str
        Of the set.
    measured : mapping
        The set's part of a result file.

    Yields
    ------
    row, verdict, note
    """
    rows: Sequence[Row] = measured["rows"]
    plain = next(row for row in rows if row["method"] == SO)
    for row in rows:
        given = _TOO_WEAK.sub(_NOT_REACHED, str(row.get("note", "")))
        if measured["kind"] in _PREDICTIONS:
            yield row, *_prediction(row, measured["kind"])
        elif measured["kind"] == "by construction":
            yield row, "by construction", given
        elif row is plain:
            yield row, "", ""
        else:
            beside = [r for r in rows if r.get("reference") == row["method"]]
            usable = [r for r in beside if r["solved"] >= rules.LEAST_SOLVED]
            nulls = {r["method"]: entry(r) for r in usable if {r["method"] for r in beside} == set(NULLS)}
            is_null = "reference" in row
            verdict, note = rules.verdict(entry(row), entry(plain), None if is_null else nulls)
            yield row, verdict, "; ".join(filter(None, (note, given)))


def _prediction(row: Row, kind: str) -> tuple[str, str]:
    note = str(row.get("note", ""))
    if row["solved"] < rules.LEAST_SOLVED or not row["errors"]:
        return "not solved", note
    if row["power"] < rules.LEAST_POWER:
        return "no power", note
    (values,) = row["errors"].values()
    if kind == "load height":
        half = len(values) // 2
        rises = all(rules.is_above(v[-1], v[0]) for v in (values[:half], values[half:]))
        note = "; ".join(filter(None, (note, "by construction" if row["method"] == _OWN else "")))
        return "as measured" if rises else "not as measured", note
    return "not as measured" if rules.is_above(values[0], values[-1]) else "as measured", note


def lines(name: str, measured: Mapping[str, Any]) -> list[list[object]]:
    """Lay a set out in the columns of the CSV file."""
    plain = next(row for row in measured["rows"] if row["method"] == SO)
    found = []
    for row, verdict, note in judged(name, measured):
        cells: list[object] = [
            name, measured["kind"], measured["unit"], row["method"], row.get("reference", ""),
            "" if row is plain else row["power"], row["solved"],
            max((int(np.isfinite(v).sum()) for v in row["errors"].values()), default=0),
        ]  # fmt: skip
        for metric in _METRICS:
            values = row["errors"].get(metric)
            if values is None or not np.isfinite(values).any():
                cells += [""] * 4
                continue
            apart = rules.interval(np.asarray(values) - np.asarray(plain["errors"][metric]))
            cells.append(float(np.nanmean(values)))
            cells += [""] * 3 if row is plain else ["" if math.isnan(v) else v for v in apart]
        cells += [row.get(key, "") for key in ("effort", "reserves", "missed")]
        found.append([*cells, verdict, note])
    return found


def set_table(name: str, measured: Mapping[str, Any]) -> str:
    """Lay a set out as a Markdown table."""
    weight = measured.get("body weight [N]")
    rows = []
    for line in lines(name, measured):
        cell = dict(zip(COLUMNS, line, strict=True))
        label = _label(str(cell["method"]), cell["at the effort of"])
        shown = [_with_interval(cell, m) for m in ("agonists", "antagonists")]
        shown.append(_with_interval(cell, "contact force [N]", weight))
        rows.append(
            [label, _number(cell["power"], "{:.0%}"), *shown, _number(cell["effort"]),
             _number(cell["reserves"], "{:.1%}"), _number(cell["missed"], "{:.0%}"),
             f"**{cell['verdict']}**" if cell["verdict"] else "", cell["note"]]
        )  # fmt: skip
    heads = ["method", "power", "agonists", "antagonists", "contact force [N], [BW]", "effort", "reserves",
             "missed", "verdict", "note"]  # fmt: skip
    used = [i for i in range(len(heads)) if i < 2 or any(row[i] for row in rows)]
    return markdown_table([heads[i] for i in used], [[row[i] for i in used] for row in rows])


def prediction_table(name: str, measured: Mapping[str, Any]) -> str:
    """Lay a prediction out as a Markdown table, task by task."""
    rows = []
    for row, verdict, note in judged(name, measured):
        values = next(iter(row["errors"].values()), [])
        label = _label(row["method"], row.get("reference", ""))
        shown = ", ".join(f"{v:.3f}" for v in values)
        power = "" if row["method"] == SO else f"{row['power']:.0%}"
        rows.append((label, power, shown, _number(row.get("effort", "")), f"**{verdict}**", note))
    metric = next(iter(measured["rows"][0]["errors"]))
    return markdown_table(("method", "power", f"{metric}, by task", "effort", "verdict", "note"), rows)


def _number(value: object, form: str = "{:.3g}") -> str:
    return form.format(value) if isinstance(value, int | float) and math.isfinite(value) else ""


def _with_interval(cell: Mapping[str, object], metric: str, weight: float | None = None) -> str:
    form = "{:.0f}" if "[N]" in metric else "{:.3f}"
    value, apart, low, high = (cell[f"{metric}{what}"] for what in ("", ", minus SO", ", low", ", high"))
    text = _number(value, form)
    if not text:
        return ""
    if weight:
        text += f", {value / weight:.2f}"  # type: ignore[operator]
    signed = form.replace(":", ":+")
    if apart != "":
        around = "" if low == "" else f"; {signed.format(low)} to {signed.format(high)}"
        text += f" ({signed.format(apart)}{around})"
    return text


def trial_table(measured: Mapping[str, Any]) -> str:
    """Lay out the errors of the contact force as a Markdown table, trial by trial."""
    weight = measured["body weight [N]"]
    rows = [
        (_label(row["method"], row.get("reference", "")), *(f"{v:.0f}, {v / weight:.2f}" for v in values))
        for row in measured["rows"]
        if (values := row["errors"].get("contact force"))
    ]
    return markdown_table(("root mean square difference [N], [BW]", *TRIALS), rows)


def _label(method: str, reference: object) -> str:
    return f"{method}, at the effort of {reference}" if reference else method


def not_run(name: str, measured: Mapping[str, Any]) -> list[str]:
    """List what PROTOCOL.md asks of a set and what was not run."""
    the_set = next(s for s in SETS if s.name == name)
    rows: Sequence[Row] = measured["rows"]
    done = {row["method"]: row for row in rows if "reference" not in row}
    beside = {row["method"] for row in rows if row.get("reference") == the_set.reference}
    reference = done.get(the_set.reference)
    has_power = reference is not None and reference["power"] >= rules.LEAST_POWER
    left = [f"{null} at the effort of {the_set.reference}" for null in NULLS if null not in beside]
    return [method for method in the_set.methods if method not in done] + (left if has_power else [])


def counts(result: Mapping[str, Any], *, nulls: bool = False) -> dict[str, int]:
    """Count verdicts over sets with a measurement, of methods with stability rows or of null models."""
    found: dict[str, int] = {}
    for name, measured in result["sets"].items():
        if measured["kind"] != "measured":
            continue
        for row, verdict, _ in judged(name, measured):
            if row["method"] != SO and ("reference" in row) == nulls:
                found[verdict] = found.get(verdict, 0) + 1
    return found


def paragraph(result: Mapping[str, Any]) -> str:
    """Say in three sentences what README says."""
    count = counts(result)
    total = sum(count.values())
    silent = ("no power", "too few units", "not solved", "undecided")
    without = [f"{count[word]} {word}" for word in silent if word in count]
    heights = _predicted(result, "load height")
    ramp = _predicted(result, "effort")
    better = [
        f"{name}, {row['method']}: rows missed in {row['missed']:.0%} of frames"
        for name, measured in result["sets"].items()
        for row, verdict, _ in judged(name, measured)
        if verdict == "better" and "reference" not in row
    ]
    beside = f" ({'; '.join(better)})" if better else ""
    text = (
        f"Scorecard (`docs/scorecard.md`, {result['date']}, rules written first): of {total} answers with "
        "stability rows (lifting, walking, running, a knee implant; one person each) nearer to EMG or "
        "contact force than static optimization and rules of equal effort: "
        f"{len(better)}{beside}; further: {count.get('worse', 0)}; no different: "
        f"{count.get('no difference', 0)}; {', '.join(without)}. "
        f"Flexors rise with load height in {heights} (fitted to that), antagonists are not more active at "
        f"low effort, as measured, in {ramp}. Load heights with oblique EMG, several people or measured "
        "joint stiffness may change it."
    )
    return textwrap.fill(text, _WIDTH, break_on_hyphens=False, break_long_words=False)


def _predicted(result: Mapping[str, Any], kind: str) -> str:
    found = [
        verdict
        for name, measured in result["sets"].items()
        if measured["kind"] == kind
        for row, verdict, _ in judged(name, measured)
        if row["method"] != SO and "reference" not in row
    ]
    return f"{found.count('as measured')} of {len(found)}"


def write_pages(result: Mapping[str, Any], folder: Path) -> None:
    """Write docs/scorecard.md with its figure, docs/scorecard.csv and README's paragraph.

    Parameters
    ----------
    result : mapping
        A result file as read.
    folder : Path
        Of README.md and docs.
    """
    tables = []
    for name, measured in result["sets"].items():
        about = [f"{key}: {value:.4g}" for key, value in measured.items() if isinstance(value, int | float)]
        lay_out = prediction_table if measured["kind"] in _PREDICTIONS else set_table
        unit = f"Unit: {measured['unit']}, n = {_units(measured)}"
        head = unit if _units(measured) else _PREDICTIONS.get(measured["kind"], "Nothing measured")
        left = ", ".join(not_run(name, measured))
        about += [f"not run: {left}"] if left else []
        tables.append(f"### {name}\n\n{'; '.join([head, *about])}.\n\n{lay_out(name, measured)}")
    count = [counts(result), counts(result, nulls=True)]
    words = ("better", "worse", "no difference", "no power", "too few units", "not solved", "undecided")
    heads = ("", *words)
    kinds = ("with stability rows", "null models at equal effort")
    summary = markdown_table(
        heads, [(kind, *(c.get(w, 0) for w in words)) for kind, c in zip(kinds, count, strict=True)]
    )
    everything = [line for name, measured in result["sets"].items() for line in lines(name, measured)]
    cells = [dict(zip(COLUMNS, line, strict=True)) for line in everything]
    shown = [cell for cell in cells if cell["kind"] == "measured"]
    weak = [c for c in shown if c["method"] == SO and c["reserves"] > rules.MOST_RESERVES]
    implant = result["sets"].get("knee_implant")
    text = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        date=result["date"],
        facts=", ".join(f"{name} {value}" for name, value in result["facts"].items()),
        conclusion=paragraph(result),
        summary=summary,
        counted=figure.counted(shown),
        weak=", ".join(f"{cell['set']} {cell['reserves']:.0%}" for cell in weak) or "none",
        trials=trial_table(implant) if implant else "Not run.",
        tables="\n".join(tables),
    )
    _write(folder / "docs" / "scorecard.md", text)
    write_table(folder / "docs" / "scorecard.csv", COLUMNS, everything)
    if shown:
        save_figure(figure.draw(shown), folder / "docs", "scorecard", formats=("png",))
    readme = (folder / "README.md").read_text(encoding="utf-8")
    _write(folder / "README.md", PARAGRAPH.sub(lambda _: paragraph(result), readme, count=1))


def _units(measured: Mapping[str, Any]) -> int:
    if measured["kind"] != "measured":
        return 0
    return max((int(np.isfinite(v).sum()) for v in measured["rows"][0]["errors"].values()), default=0)


def _write(path: Path, text: str) -> None:
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
