"""One self-contained HTML page about results of a motion: what was asked, what came out, how sure it is.

The page needs no network and runs no script: figures stand in it as data, the style is a few lines of CSS,
and everything that comes from files is escaped. It is plain enough for a phone and for a screen reader.
"""

from __future__ import annotations

import base64
import html
import io
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from scso_nlp.emg.comparison import Comparison, ComparisonRow, format_number
from scso_nlp.emg.motion_result import MotionResult
from scso_nlp.exceptions import DataError
from scso_nlp.figures.comparison import plot_activity, plot_mean_activity, plot_task_bars
from scso_nlp.figures.frames import FEW_FRAMES

#: A figure larger than this as a vector is embedded as pixels instead [bytes].
LARGEST_VECTOR = 400_000
#: More groups than this get no panels of their own in the report; the table has them all.
MOST_PANELS = 60
#: Entries of one list or mapping that are shown.
MOST_ENTRIES = 40

_STYLE = """
:root { color-scheme: light; --line: #d5d5d5; --quiet: #555; --bad: #9c2a00; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 70rem; padding: 1rem; color: #1a1a1a; background: #fff;
  font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: .5rem 0; }
h2 { font-size: 1.25rem; margin: 2rem 0 .5rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1.05rem; margin: 1.25rem 0 .25rem; }
p, figcaption { max-width: 46rem; }
.quiet, figcaption { color: var(--quiet); font-size: .9rem; text-align: left; }
.failed { color: var(--bad); font-weight: 600; }
nav ul { padding-left: 1.2rem; columns: 14rem; }
figure { margin: 1rem 0; }
figure img { max-width: max(100%, 36rem); height: auto; display: block; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .6rem .25rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); overflow-wrap: normal; }
td.number, th.number { text-align: right; white-space: nowrap; }
table.facts th { font-weight: 400; color: var(--quiet); min-width: 7rem; }
table.facts td { overflow-wrap: anywhere; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: .85rem; }
summary { cursor: pointer; padding: .3rem 0; }
@media print { details > * { display: block; } body { max-width: none; } }
"""

_ORDER = (
    "mean absolute difference",
    "RMSE",
    "Pearson r",
    "best lagged r",
    "lag of best r",
    "activity ratio",
    "common activity",
    "co-contraction",
    "mean activity",
    "peak activity",
    "smallest stability",
)
_MEANING = {
    "mean absolute difference": "Mean over frames of |prediction - EMG|, the paper's measure.",
    "RMSE": "Root mean squared difference from EMG.",
    "Pearson r": "Likeness of shape at no lag, whatever the level. Not defined where a muscle stays silent.",
    "best lagged r": "Pearson r at the lag of at most 0.2 s where it is largest.",
    "lag of best r": "Positive: the prediction comes later than EMG.",
    "activity ratio": "Mean activity of the first side over that of the second.",
    "common activity": "Falconer and Winter (1985): 0 never together, 1 always equal.",
    "co-contraction": "Rudolph et al. (2000): 0 one side silent, 2 both fully active.",
    "mean activity": "Mean activation over the frames used, and mean EMG envelope.",
    "peak activity": "Largest activation over the frames used, and largest EMG envelope.",
    "smallest stability": "Least stability of the row over the frames used. Rows that are all kept do "
    "not prove a joint stable in every direction.",
}


def write_report(
    comparison: Comparison,
    path: str | os.PathLike[str],
    *,
    figures: Mapping[str, Figure] | None = None,
    pictures: Iterable[str | os.PathLike[str]] = (),
) -> None:
    """Write the page.

    Parameters
    ----------
    comparison : Comparison
    path : path
        The ``.html`` file; an existing one is replaced.
    figures : mapping of str to Figure, optional
        More figures, by caption, below the standard ones.
    pictures : iterable of path
        PNG files to embed, e.g. those of the result folders.

    Raises
    ------
    DataError
        A picture that is no PNG file, or a page that cannot be written.
    """
    path = Path(path)
    text = render_report(comparison, figures=figures, pictures=pictures)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise DataError(f"{path} cannot be written: {error.strerror or error}") from None


def render_report(
    comparison: Comparison,
    *,
    figures: Mapping[str, Figure] | None = None,
    pictures: Iterable[str | os.PathLike[str]] = (),
) -> str:
    """Make the page's text, see :func:`write_report`.

    Returns
    -------
    str
        HTML.
    """
    name = comparison.results[0].name
    standard = _standard_figures(comparison)
    sections = [
        ("results", "What was solved", _overview(comparison)),
        ("figures", "Figures", _figures({**standard, **(figures or {})}, pictures)),
        ("numbers", "Numbers", _numbers(comparison)),
        ("settings", "Settings and versions", "".join(_settings(result) for result in comparison.results)),
    ]
    contents = "".join(f'<li><a href="#{key}">{_text(title)}</a></li>' for key, title, _ in sections)
    body = "".join(
        f'<section id="{key}"><h2>{_text(title)}</h2>{content}</section>' for key, title, content in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        # nothing may be fetched or run, whatever a file has smuggled in
        '<meta http-equiv="Content-Security-Policy" '
        "content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">\n"
        '<link rel="icon" href="data:,">\n'
        f"<title>{_text(name)}: muscle forces</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f'<header><h1>{_text(name)}</h1></header>\n<nav aria-label="Contents"><ul>{contents}</ul></nav>\n'
        f"<main>{body}</main>\n</body>\n</html>\n"
    )


def _overview(comparison: Comparison) -> str:
    head = ("result", "frames solved", "outcome", "time to solve")
    lines = []
    for result in comparison.results:
        solved = int(result.is_solved.sum())
        count = f"{solved} of {result.n_frames}"
        failed = ' class="failed"' if solved < result.n_frames else ""
        seconds = result.report.get("seconds")
        seconds = seconds.get("solve") if isinstance(seconds, Mapping) else result.report.get("solve_seconds")
        lines.append(
            f'<tr><th scope="row">{_text(result.label)}</th>'
            f"<td{failed}>{_text(count)}</td>"
            f"<td>{_text(result.report.get('summary', ''))}</td>"
            f"<td>{_text(f'{seconds:.3g} s' if isinstance(seconds, int | float) else '')}</td></tr>"
        )
    used, n_frames = int(comparison.is_used.sum()), len(comparison.time)
    first, last = float(comparison.time[0]), float(comparison.time[-1])
    note = f"{n_frames} frames over {last - first:.4g} s, from t = {first:.14g} s. "
    note += (
        "All frames are used below."
        if used == n_frames
        else f"Tables use the {used} frames that all results have solved."
    )
    note += (
        " Gray in figures is measured EMG."
        if comparison.emg is not None
        else " No EMG was given: nothing here says which result is nearer to a person."
    )
    columns = "".join(f'<th scope="col">{_text(cell)}</th>' for cell in head)
    return (
        f"<p>{_text(note)}</p>"
        '<div class="wide" tabindex="0" role="region" aria-label="What was solved"><table>'
        f"<thead><tr>{columns}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def _standard_figures(comparison: Comparison) -> dict[str, Figure]:
    if len(comparison.groups) > MOST_PANELS:
        return {}
    figures = {
        "Mean activation of every group. Whiskers on EMG: standard deviation over the frames.": (
            plot_mean_activity(comparison)
        )
    }
    if len(comparison.time) <= FEW_FRAMES:
        figures["Activation in every task, by its time."] = plot_task_bars(comparison)
    else:
        figures["Activation over the motion. Frames that are not solved are left blank."] = plot_activity(
            comparison
        )
    return figures


def _figures(figures: Mapping[str, Figure], pictures: Iterable[str | os.PathLike[str]]) -> str:
    parts = [_figure(caption, _figure_uri(figure)) for caption, figure in figures.items()]
    for picture in pictures:
        picture = Path(picture)
        try:
            content = picture.read_bytes()
        except OSError as error:
            raise DataError(f"{picture} cannot be read: {error.strerror or error}") from None
        if not content.startswith(b"\x89PNG\r\n\x1a\n"):
            raise DataError(f"{picture} is not a PNG file, expected one to embed")
        caption = f"{picture.parent.name}: {picture.stem.replace('_', ' ')}"
        parts.append(_figure(caption, _uri("image/png", content)))
    return "".join(parts) or "<p>Too many muscles for panels; give a map file with groups.</p>"


def _figure(caption: str, uri: str) -> str:
    return (
        f'<figure><div class="wide" tabindex="0" role="region" aria-label="{_text(caption)}">'
        f'<img src="{uri}" alt="{_text(caption)}"></div><figcaption>{_text(caption)}</figcaption></figure>'
    )


def _figure_uri(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    if buffer.tell() <= LARGEST_VECTOR:
        return _uri("image/svg+xml", buffer.getvalue())
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return _uri("image/png", buffer.getvalue())


def _uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _numbers(comparison: Comparison) -> str:
    """One table per metric: groups down, results across."""
    by_metric: dict[str, list[ComparisonRow]] = {}
    for row in comparison.rows:
        by_metric.setdefault(row.metric, []).append(row)
    order = sorted(by_metric, key=lambda m: _ORDER.index(m) if m in _ORDER else -1)
    parts = []
    if any(not math.isnan(row.low) for row in comparison.rows):
        parts.append(
            "<p>In brackets: 95 % intervals by the moving-block bootstrap over the frames of this motion. "
            "They speak of other stretches of this motion, not of other trials or other people.</p>"
        )
    for position, metric in enumerate(order):
        table = _metric_table(metric, by_metric[metric])
        is_open = " open" if position < 3 else ""
        parts.append(
            f"<details{is_open}><summary><strong>{_text(metric)}</strong></summary>{table}</details>"
        )
    return "".join(parts)


def _metric_table(metric: str, rows: Sequence[ComparisonRow]) -> str:
    columns = list(dict.fromkeys(row.result for row in rows))
    groups = list(dict.fromkeys(row.group for row in rows))
    found = {(row.group, row.result): row for row in rows}
    notes = list(dict.fromkeys(row.note for row in rows if row.note))
    unit = "" if rows[0].unit == "-" else f" [{rows[0].unit}]"
    head = "".join(f'<th scope="col" class="number">{_text(column)}</th>' for column in columns)
    body = []
    for group in groups:
        cells = []
        for column in columns:
            row = found.get((group, column))
            cells.append(f'<td class="number">{"" if row is None else _text(format_number(row, notes))}</td>')
        body.append(f'<tr><th scope="row">{_text(group)}</th>{"".join(cells)}</tr>')
    caption = _MEANING.get(metric, "") + unit
    footnotes = "".join(f'<p class="quiet">[{i + 1}] {_text(note)}</p>' for i, note in enumerate(notes))
    return (
        f'<p class="quiet">{_text(caption)}</p>'
        f'<div class="wide" tabindex="0" role="region" aria-label="{_text(metric)}"><table>'
        f'<thead><tr><th scope="col">group</th>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
        f"{footnotes}"
    )


def _settings(result: MotionResult) -> str:
    skip = {"frame_status", "summary", "files_sha256", "name"}
    facts = {key: value for key, value in result.report.items() if key not in skip}
    if not facts:
        return f"<h3>{_text(result.label)}</h3><p>No report was kept.</p>"
    rows = "".join(_fact_rows("", facts))
    return (
        f"<details><summary><strong>{_text(result.label)}</strong></summary>"
        f'<table class="facts"><tbody>{rows}</tbody></table></details>'
    )


def _fact_rows(prefix: str, facts: Mapping[str, Any]) -> Iterable[str]:
    for position, (key, value) in enumerate(facts.items()):
        if position == MOST_ENTRIES:
            yield _fact(f"{prefix}…", f"{len(facts) - MOST_ENTRIES} more")
            return
        label = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _fact_rows(f"{label}: ", value)
        elif isinstance(value, list | tuple):
            shown = [
                str(item["text"]) if isinstance(item, Mapping) and "text" in item else str(item)
                for item in value
            ]
            rest = f" … and {len(shown) - MOST_ENTRIES} more" if len(shown) > MOST_ENTRIES else ""
            yield _fact(label, "\n".join(shown[:MOST_ENTRIES]) + rest)
        elif value is not None:
            yield _fact(label, f"{value:.6g}" if isinstance(value, float) else str(value))


def _fact(label: str, value: str) -> str:
    content = _text(value).replace("\n", "<br>")
    return f'<tr><th scope="row">{_text(label.replace("_", " "))}</th><td>{content}</td></tr>'


def _text(value: object) -> str:
    """Escape anything for text and for quoted attributes; drop what HTML does not allow."""
    return html.escape(re.sub(r"[\x00-\x08\x0b-\x1f\x7f]", "", str(value)), quote=True)
