"""The page about a study: what was asked, what became of every trial, in what conditions differ.

Its template is ``cohort.html`` beside those of other pages. It leads to a page of every trial, made as for
any results.
"""

from __future__ import annotations

import itertools
import logging
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from scso_nlp.emg.comparison import compare
from scso_nlp.emg.motion_result import read_results
from scso_nlp.exceptions import ScsoError
from scso_nlp.figures.saving import save_figure
from scso_nlp.files import absolute
from scso_nlp.messages import COUNTS
from scso_nlp.progress import stages_shown
from scso_nlp.report import story
from scso_nlp.report.folder import FAILED, failed_run, read_report
from scso_nlp.report.html import figure_address, render, write_page
from scso_nlp.report.page import write_failure, write_report
from scso_nlp.studies.bands import draw_bands
from scso_nlp.studies.events import GIVEN, GROUND_REACTION, NO_CYCLE, ON_GROUND, WHOLE_TRIAL
from scso_nlp.studies.record import TRIAL
from scso_nlp.studies.results import StudyTables
from scso_nlp.verdict import RESERVE_LIMIT, ROUNDING

if TYPE_CHECKING:
    import pandas as pd

#: A cycle is unusual if its duration is this far from the median [-]; so many are named.
UNUSUAL, MOST_NAMED = 0.15, 6
#: Names that stand for all that a quantity is of, in words.
_OF_ALL = {"muscles": "effort of muscles per frame", "all muscles": "mean activation of all muscles"}
_LOG = logging.getLogger("scso_nlp")

#: Page of a study, and of a trial in its folder.
PAGE = "report.html"
#: Formats of the figures beside the page.
FORMATS = ("pdf", "svg")
#: Muscles in the table of differences.
MOST_MUSCLES = 12
#: Tables of differences: quantity, statistic, heading, and what is to be known.
_SECTIONS = (
    ("activation", "mean", "Muscles that differ most", "Mean activation over the trial."),
    (
        "co-contraction",
        "index",
        "Co-contraction index",
        "Falconer and Winter (1985), of the moments of the model's tendon forces: 0 where muscles never "
        "oppose each other, 1 where both sides are always equal. Only coordinates in which it changes.",
    ),
    ("reaction", "peak", "Joint reactions", "Largest resultant force of each trial."),
)
#: How cycles were found, in words.
_RULES = {
    GIVEN: "Cycles of {} trials lie between the events that were given.",
    GROUND_REACTION: "Cycles of {} trials go from heel strike to heel strike of the same foot: where its "
    f"vertical load rises through {100 * ON_GROUND:g} % of body weight.",
    WHOLE_TRIAL: "Of {} trials the whole is one cycle.",
    NO_CYCLE: "{} trials have no whole cycle, or are tasks and no movement.",
}


def write_cohort(study: StudyTables, path: str | os.PathLike[str] | None = None) -> Path:
    """Write the page of a study, the pages of its trials, and its figures as files.

    Parameters
    ----------
    study : StudyTables
    path : path, optional
        The ``.html`` file; an existing one is replaced. ``report.html`` in the study's folder by default.

    Returns
    -------
    Path
        The page. Pages of trials that are newer than all results of their trial stay.

    Raises
    ------
    DataError
        A page or figure cannot be written.
    """
    path = study.folder / PAGE if path is None else absolute(path)
    with stages_shown():
        pages = dict(_trial_pages(study))
        figures = {}
        for name, caption, figure in draw_bands(study):
            COUNTS.info("drawing %s", name)
            save_figure(figure, study.folder, name, formats=FORMATS)
            figures[caption] = figure_address(figure)
    links = {
        trial: quote(os.path.relpath(page, path.parent).replace(os.sep, "/")) for trial, page in pages.items()
    }
    write_page(path, render("cohort.html", **_contents(study, links), figures=figures))
    return path


def _trial_pages(study: StudyTables) -> Iterator[tuple[tuple[str, str], Path]]:
    """Make the page of every trial that left anything; yield subject, trial and page."""
    order = {condition: i for i, condition in enumerate(study.conditions)}
    planned = zip(study.plan.trials, study.trials["state"], strict=True)
    for key, group in itertools.groupby(planned, lambda pair: (pair[0].subject, pair[0].trial)):
        solves = sorted(group, key=lambda pair: order[pair[0].condition])
        folders = [study.folder / trial.folder for trial, _ in solves]
        done, failed = (
            {trial.condition: study.folder / trial.folder for trial, state in solves if state == wanted}
            for wanted in ("done", "failed")
        )
        page = folders[0].parent / PAGE
        try:
            if _is_newer(page, [folder / TRIAL for folder in folders]):
                yield key, page
            elif done:
                COUNTS.info("drawing the page of %s, %s", *key)
                write_report(compare(read_results(list(done.values()), list(done))), page)
                yield key, page
            elif failed and (report := _failure(next(iter(failed.values())))):
                write_failure(report, next(iter(failed)), page)
                yield key, page
        except ScsoError as error:
            _LOG.warning("the page of %s is left out: %s", "/".join(key), error)


def _is_newer(page: Path, records: Sequence[Path]) -> bool:
    if not page.is_file():
        return False
    written = page.stat().st_mtime_ns
    return all(record.stat().st_mtime_ns < written for record in records if record.is_file())


def _failure(folder: Path) -> dict[str, Any] | None:
    return read_report(folder / FAILED) or failed_run(folder)


def _contents(study: StudyTables, links: dict[tuple[str, str], str]) -> dict[str, Any]:
    """Give what the template names, but for the figures."""
    trials = study.trials
    states = trials["state"].value_counts(sort=False)
    return {
        "name": study.plan.name,
        "extent": str(study).splitlines()[0] + ".",
        "states": [f"{n} {state}" for state, n in states.items()],
        "source": study.plan.source,
        "grid": {key: ", ".join(map(str, values)) for key, values in study.plan.grid.items()},
        "asked": {condition: _asked(study, condition) for condition in study.conditions},
        "reference": study.reference,
        "conditions": [_standing(study, condition) for condition in study.conditions],
        "others": study.conditions[1:],
        "sections": list(_sections(study.differences, study.conditions[1:])),
        "about_intervals": _about_intervals(trials),
        "trials": _trials(study, links),
        "troubles": _troubles(trials),
        "notes": [*_about_events(trials), *_about_durations(study.cycles)],
        "reserve_limit": f"{100 * RESERVE_LIMIT:g}",
    }


def _asked(study: StudyTables, condition: str) -> tuple[str, ...]:
    """Say what a condition asks for, as the report of its first trial that is done does."""
    done = study.trials["state"].eq("done") & study.trials["condition"].eq(condition)
    if not done.any():
        return ()
    first = study.plan.trials[int(done.to_numpy().argmax())]
    report = read_report(study.folder / first.folder) or {}
    return tuple(sentence for sentence in story.asked(report) if not sentence.startswith("From "))


def _standing(study: StudyTables, condition: str) -> dict[str, str]:
    """Sum up the verdicts of one condition."""
    trials = study.trials[study.trials["condition"].eq(condition)]
    done = trials[trials["state"].eq("done")]
    means = study.statistics
    of_it = means[means["condition"].eq(condition) & means["statistic"].eq("mean")]
    frames = _sum(trials, "frames_all")
    return {
        "condition": condition,
        "done": f"{len(done)} of {len(trials)}",
        "usable": f"{_sum(trials, 'frames_usable')} of {frames}" if frames else "",
        "stable": _extreme(done, "frames_stable", min) and f"{_sum(trials, 'frames_stable')} of {frames}",
        "margin": _extreme(done, "margin_all_rows", min),
        "reserve": _extreme(done, "reserve_share_all_coordinates", max),
        "effort": _mean(of_it[of_it["quantity"].eq("effort") & of_it["name"].eq("muscles")]),
        "activation": _mean(of_it[of_it["quantity"].eq("activation") & of_it["name"].eq("all muscles")]),
    }


def _sum(trials: pd.DataFrame, column: str) -> int:
    return int(trials[column].sum()) if column in trials else 0


def _extreme(trials: pd.DataFrame, column: str, choose: Callable[[Any], float]) -> str:
    """Write the least or largest of what is known; nothing where nothing is."""
    known = trials[column].dropna() if column in trials else ()
    if not len(known):
        return ""
    extreme = choose(known)
    return f"{0.0 if abs(extreme) < ROUNDING else extreme:.4g}"


def _mean(found: pd.DataFrame) -> str:
    """Write mean and standard deviation over people."""
    if found.empty:
        return ""
    mean, sd = found["mean"].iloc[0], found["sd"].iloc[0]
    return f"{mean:.3g}" if math.isnan(sd) else f"{mean:.3g} ± {sd:.2g}"


def _sections(differences: pd.DataFrame, conditions: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Make the tables of differences: heading, what is to be known, lines."""
    of_all = differences["name"].isin(_OF_ALL)
    for quantity, statistic, heading, about in _SECTIONS:
        of_it = differences["quantity"].eq(quantity) & differences["statistic"].eq(statistic)
        lines = _lines(differences[of_it & ~of_all], conditions)
        lines = [line for line in lines if line["largest"] >= story.LEAST_CHANGE]
        if quantity == "activation" and of_it.any():
            yield {
                "heading": "Effort and activation",
                "about": "",
                "lines": _lines(differences[of_all], conditions, _OF_ALL),
            }
            lines = sorted(lines, key=lambda line: -line["largest"])[:MOST_MUSCLES]
        if lines:
            yield {"heading": heading, "about": about, "lines": lines}


def _lines(
    of_it: pd.DataFrame, conditions: Sequence[str], words: Mapping[str, str] = MappingProxyType({})
) -> list[dict[str, Any]]:
    """Make a line per name and unit: the mean of the reference, and the difference of every condition."""
    lines = []
    for (name, unit), rows in of_it.groupby(["name", "unit"], sort=False):
        cells = {row.condition: row for row in rows.itertuples()}
        lines.append(
            {
                "what": words.get(name, name) + ("" if unit == "-" else f" [{unit}]"),
                "before": f"{rows['reference_mean'].iloc[0]:.3g}",
                "cells": [_cell(cells.get(condition)) for condition in conditions],
                "largest": float(rows["mean"].abs().max()),
            }
        )
    return lines


def _cell(row: Any) -> dict[str, Any]:
    """Write a difference and its interval."""
    if row is None:
        return {"mean": "", "interval": "", "is_clear": False}
    mean, low, high = (0.0 if abs(x) < ROUNDING else x for x in (row.mean, row.low, row.high))
    return {
        "mean": f"{mean:+.3g}" if mean else "0",
        "interval": "" if math.isnan(low) else f"[{low:+.3g}, {high:+.3g}]",
        "is_clear": low > 0 or high < 0,
    }


def _about_intervals(trials: pd.DataFrame) -> str:
    people = trials.loc[trials["state"].eq("done"), "subject"].nunique()
    if people < 2:
        return "All results are of one person, who says nothing of others: there are no intervals."
    return (
        f"In brackets: 95 % intervals of the mean over {people} people, by Student's t of the means of each "
        "person's paired differences. Bold: zero is outside. Nothing is corrected for the number of lines."
    )


def _trials(study: StudyTables, links: dict[tuple[str, str], str]) -> list[dict[str, Any]]:
    """One line per trial, one cell per condition."""
    lines = []
    for (subject, trial), rows in study.trials.groupby(["subject", "trial"], sort=False):
        states = dict(zip(rows["condition"], rows["state"], strict=True))
        shown = [states.get(condition, "") for condition in study.conditions]
        link = links.get((subject, trial), "")
        lines.append({"subject": subject, "trial": trial, "link": link, "states": shown})
    return lines


def _troubles(trials: pd.DataFrame) -> list[dict[str, Any]]:
    """Gather why trials are not done, conditions of a trial with the same sentence in one."""
    told = trials[trials["state"].ne("done") & trials["sentence"].ne("")]
    same = told.groupby(["subject", "trial", "state", "sentence"], sort=False)["condition"]
    return same.agg(", ".join).reset_index().to_dict("records")


def _about_events(trials: pd.DataFrame) -> list[str]:
    """Say where cycles begin and end."""
    if "events" not in trials:
        return []
    of_trials = trials.dropna(subset="events").drop_duplicates(["subject", "trial"])
    counts = of_trials["events"].value_counts(sort=False)
    notes = [_RULES[rule].format(n) for rule, n in counts.items()]
    if len(counts.drop(NO_CYCLE, errors="ignore")) > 1:
        notes.append("Means over the cycle are over all of these: give events where that is not meant.")
    return notes


def _about_durations(cycles: pd.DataFrame) -> list[str]:
    """Name cycles that take much less or more time than is usual for their person and foot."""
    found = cycles[cycles["foot"] != ""].drop_duplicates(["subject", "trial", "foot", "cycle"])
    duration = found["stop"] - found["start"]
    usual = duration.groupby([found["subject"], found["foot"]]).transform("median")
    odd = found[(duration - usual).abs() > UNUSUAL * usual]
    if odd.empty:
        return []
    named = [
        f"{one.subject} {one.trial}, {one.foot} foot, {one.start:.4g} to {one.stop:.4g} s"
        for one in odd.head(MOST_NAMED).itertuples()
    ]
    more = f", and {len(odd) - MOST_NAMED} more" if len(odd) > MOST_NAMED else ""
    return [
        f"{len(odd)} of {len(found)} cycles take {100 * UNUSUAL:g} % less or more time than is usual for "
        f"their person and foot ({'; '.join(named)}{more}). They are in the means: if a foot stood on the "
        "wrong plate, give events."
    ]
