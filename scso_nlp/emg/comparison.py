"""Put solutions of one motion side by side, and EMG beside them, as a table.

`compare` takes any number of results, from memory or from result folders, brings EMG to their frames and
gives one row per result, muscle group and metric. Nothing is ranked here: what agrees better is for
the reader to judge, with the intervals.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.emg import metrics
from scso_nlp.emg.activity import as_activity, group_means, refuse_large
from scso_nlp.emg.bootstrap import bootstrap_interval
from scso_nlp.emg.map import EmgMap, MuscleGroup
from scso_nlp.emg.motion_result import MotionResult
from scso_nlp.emg.signal import Emg, resample
from scso_nlp.exceptions import DataError
from scso_nlp.files import write_whole
from scso_nlp.trajectory import require_same_motion
from scso_nlp.validation import BoolArray, FloatArray, positions, unique_names

#: Longest lag looked for between prediction and EMG [s]: electromechanical delay is below 0.15 s,
#: Cavanagh and Komi (1979), Eur J Appl Physiol 42:159-163, and filters of both signals may add to it.
MAX_LAG = 0.2
#: Fewer frames are a handful of chosen tasks, of which an interval would tell nothing.
LEAST_FRAMES_FOR_INTERVAL = 16
#: What spreadsheets take for the beginning of a formula, which may do anything.
_FORMULA_SIGNS = ("=", "+", "-", "@", "\t", "\r")
#: How EMG is called in the column of results.
EMG_LABEL = "EMG"
#: How the mean over all groups is called in the column of groups.
ALL_GROUPS = "all groups"
#: Activations may be this much below zero by the solver's tolerance; such values count as zero [-].
NEGATIVE_ACTIVATION = 1e-4


@dataclass(frozen=True, kw_only=True)
@checked
class ComparisonRow:
    """One number of the table.

    Attributes
    ----------
    result : str
        Label of the result, or ``"EMG"``.
    group : str
        Muscle group, pair of groups or stability row.
    metric : str
    value : float [unit]
        NaN where the metric is not defined; `note` says why.
    low, high : float [unit]
        95 % bootstrap interval; NaN where there is none.
    unit : str
    note : str
    """

    result: str
    group: str
    metric: str
    value: float
    low: float = math.nan
    high: float = math.nan
    unit: str = "-"
    note: str = ""


@dataclass(frozen=True, kw_only=True)
@checked
class Comparison:
    """Results of one motion on common frames, with their table.

    Attributes
    ----------
    results : tuple of MotionResult
    groups : tuple of MuscleGroup
    time : ndarray, shape (n_frames,) [s]
    is_used : ndarray of bool, shape (n_frames,)
        Frames that every result has solved; the table is made from these.
    activity : mapping of str to ndarray, shape (n_frames, n_groups) [-]
        Mean activation of each group, by label of the result; NaN in frames that are not solved.
    emg : ndarray, shape (n_frames, n_groups) [-] or None
        Mean of the channels of each group; NaN for groups without channels.
    rows : tuple of ComparisonRow
    """

    results: tuple[MotionResult, ...]
    groups: tuple[MuscleGroup, ...]
    time: FloatArray
    is_used: BoolArray
    activity: Mapping[str, FloatArray]
    emg: FloatArray | None
    rows: tuple[ComparisonRow, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the results."""
        return tuple(result.label for result in self.results)

    @property
    def group_names(self) -> tuple[str, ...]:
        """Names of the groups."""
        return tuple(group.name for group in self.groups)

    def emg_of(self, group: int) -> FloatArray | None:
        """EMG of the group at a position, shape (n_frames,) [-]; None for a group without channels."""
        measured = None if self.emg is None else self.emg[:, group]
        return None if measured is None or np.isnan(measured).any() else measured


@checked
def compare(
    results: Sequence[MotionResult],
    *,
    emg_map: EmgMap | None = None,
    emg: Emg | None = None,
    start_offset: float = 0.0,
    n_resamples: int = 1000,
    seed: int = 0,
) -> Comparison:
    """Compare results of one motion with each other and with EMG.

    Parameters
    ----------
    results : sequence of MotionResult
        With the same muscles at the same times, and labels of their own.
    emg_map : EmgMap, optional
        Muscle groups; every muscle is a group of its own without it. Needed with `emg`.
    emg : Emg, optional
        Envelope as a fraction of the maximum, or of the unit of the map's references.
    start_offset : float [s]
        Added to the EMG's time.
    n_resamples : int
        For the intervals; 0 for none.
    seed : int
        Of the resampling.

    Returns
    -------
    Comparison

    Raises
    ------
    DataError
        No result, different motions, no common solved frame, or EMG that does not cover the motion.
    NameMismatchError
        Different muscles, or names in the map that are not there.
    """
    results = tuple(results)
    time, used = _common_frames(results)
    muscles = results[0].muscles
    if emg is not None and emg_map is None:
        raise DataError("EMG needs a map file that says which channels belong to which muscles")
    if emg_map is None:
        groups = tuple(MuscleGroup(name=muscle, muscles=(muscle,)) for muscle in muscles)
    else:
        emg_map = emg_map.resolve(muscles, None if emg is None else emg.channels)
        groups = emg_map.groups
    activity = {result.label: _group_activity(result, groups) for result in results}
    measured = None if emg is None or emg_map is None else _group_emg(emg, emg_map, time, start_offset)

    sampling = _Resampling(n_resamples=n_resamples, seed=seed)
    rows: list[ComparisonRow] = []
    for result in results:
        rows.extend(_level_rows(result.label, groups, activity[result.label][used]))
        if measured is not None:
            rows.extend(
                _agreement_rows(
                    result.label, groups, activity[result.label][used], measured[used], time[used], sampling
                )
            )
        elif result is not results[0]:
            rows.extend(_change_rows(result.label, results[0].label, groups, activity, used))
    if measured is not None:
        rows.extend(_level_rows(EMG_LABEL, groups, measured[used]))
    if emg_map is not None:
        sources = dict(activity) if measured is None else {**activity, EMG_LABEL: measured}
        for label, series in sources.items():
            rows.extend(_pair_rows(label, emg_map, groups, series[used], sampling))
    for result in results:
        rows.extend(_stability_rows(result, used))
    return Comparison(
        results=results,
        groups=groups,
        time=time,
        is_used=used,
        activity=MappingProxyType(activity),
        emg=measured,
        rows=tuple(rows),
    )


@checked
def write_comparison_csv(comparison: Comparison, path: str | os.PathLike[str]) -> None:
    """Write the table, one line per number, numbers with all digits.

    Parameters
    ----------
    comparison : Comparison
    path : str or path-like
        An existing file is replaced.

    Raises
    ------
    DataError
        The file cannot be written.
    """
    names = ("result", "group", "metric", "value", "low", "high", "unit", "note")
    with write_whole(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in comparison.rows:
            cells = [getattr(row, name) for name in names]
            writer.writerow([_cell(value) for value in cells])


def _cell(value: object) -> object:
    """Leave NaN blank; text that spreadsheets would take for a formula begins with an apostrophe."""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(_FORMULA_SIGNS) else value
    return "" if isinstance(value, float) and math.isnan(value) else value


@checked
def format_comparison(comparison: Comparison) -> str:
    """Lay the table out as text: one line per group and metric, one column per result.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    str
        With the intervals in brackets and the notes below.
    """
    columns = list(dict.fromkeys(row.result for row in comparison.rows))
    cells: dict[tuple[str, str, str], dict[str, ComparisonRow]] = {}
    for row in comparison.rows:
        cells.setdefault((row.metric, row.group, row.unit), {})[row.result] = row
    lines = [("metric", "group", "unit", *columns)]
    notes: list[str] = []
    previous = ""
    for (metric, group, unit), by_result in cells.items():
        entries = []
        for column in columns:
            found = by_result.get(column)
            if found is not None and found.note and found.note not in notes:
                notes.append(found.note)
            entries.append("" if found is None else format_number(found, notes))
        lines.append(("" if metric == previous else metric, group, unit, *entries))
        previous = metric
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    text = [
        "  ".join(
            cell.ljust(width) if i < 3 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    ]
    text.insert(1, "  ".join("-" * width for width in widths))
    n_used, n_frames = int(comparison.is_used.sum()), len(comparison.is_used)
    text.append(f"\nFrom {n_used} of {n_frames} frames" + ("." if n_used == n_frames else ", solved by all."))
    if any(not math.isnan(row.low) for row in comparison.rows):
        text.append("In brackets: 95 % circular block bootstrap over the frames of this motion.")
    text.extend(f"[{i + 1}] {note}" for i, note in enumerate(notes))
    return "\n".join(text)


@checked
def format_number(row: ComparisonRow, notes: Sequence[str] = ()) -> str:
    """Write one number with its interval, or the number of the note that says why there is none.

    Parameters
    ----------
    row : ComparisonRow
    notes : sequence of str
        Notes in the order in which they are listed.

    Returns
    -------
    str
    """
    mark = f" [{notes.index(row.note) + 1}]" if row.note and row.note in notes else ""
    if math.isnan(row.value):
        return f"n/a{mark}"
    text = f"{row.value:z.3f}" if abs(row.value) < 100 else f"{row.value:.4g}"
    if not math.isnan(row.low):
        text += f" ({row.low:z.3f} to {row.high:z.3f})"
    return text + mark


@dataclass(frozen=True, kw_only=True)
class _Resampling:
    n_resamples: int
    seed: int


def _common_frames(results: tuple[MotionResult, ...]) -> tuple[FloatArray, BoolArray]:
    if not results:
        raise DataError("no result to compare, expected at least one")
    unique_names("result label", (result.label for result in results))
    if any(result.label == EMG_LABEL for result in results):
        raise DataError(f"{EMG_LABEL!r} is taken, give the result another label")
    require_same_motion({result.label: result for result in results})
    used = np.logical_and.reduce([result.is_solved for result in results])
    if not used.any():
        raise DataError("no frame is solved in all results, nothing can be compared")
    return results[0].time, used


def _group_activity(result: MotionResult, groups: Sequence[MuscleGroup]) -> FloatArray:
    solved = np.where(result.is_solved[:, None], result.activation, np.nan)
    low = float(np.nanmin(solved, initial=0.0))
    if low < -NEGATIVE_ACTIVATION:
        raise DataError(f"{result.label!r} has an activation of {low:g}, expected 0 or more")
    refuse_large(f"the activation of {result.label!r}", solved)
    solved = np.maximum(solved, 0.0)
    means = [solved[:, positions("muscle", group.muscles, result.muscles)].mean(axis=1) for group in groups]
    return np.array(means).reshape(len(groups), len(solved)).T


def _group_emg(emg: Emg, emg_map: EmgMap, time: FloatArray, start_offset: float) -> FloatArray:
    """Mean of the channels of each group at the frames, NaN for groups without channels."""
    emg = resample(as_activity(emg, emg_map), time, start_offset=start_offset)
    return group_means(emg, emg_map)


def _level_rows(label: str, groups: Sequence[MuscleGroup], series: FloatArray) -> list[ComparisonRow]:
    rows = []
    for metric, reduce in (("mean activity", np.mean), ("peak activity", np.max)):
        for group, column in zip(groups, series.T, strict=True):
            if not np.isnan(column).all():
                rows.append(
                    ComparisonRow(result=label, group=group.name, metric=metric, value=float(reduce(column)))
                )
    return rows


def _change_rows(
    label: str,
    reference: str,
    groups: Sequence[MuscleGroup],
    activity: Mapping[str, FloatArray],
    used: BoolArray,
) -> list[ComparisonRow]:
    return [
        ComparisonRow(
            result=label,
            group=group.name,
            metric=f"mean absolute difference from {reference}",
            value=metrics.mean_absolute_difference(activity[label][used, g], activity[reference][used, g]),
        )
        for g, group in enumerate(groups)
    ]


def _agreement_rows(
    label: str,
    groups: Sequence[MuscleGroup],
    predicted: FloatArray,
    measured: FloatArray,
    time: FloatArray,
    sampling: _Resampling,
) -> list[ComparisonRow]:
    rows = []
    pairs: tuple[tuple[str, Callable[[FloatArray, FloatArray], float]], ...] = (
        ("mean absolute difference", metrics.mean_absolute_difference),
        ("RMSE", metrics.root_mean_square_error),
        ("Pearson r", metrics.pearson_correlation),
    )
    with_emg = [g for g, group in enumerate(groups) if group.channels]
    for metric, function in pairs:
        for g in with_emg:
            rows.append(
                _row(label, groups[g].name, metric, function, predicted[:, g], measured[:, g], sampling)
            )
        if metric == "mean absolute difference":
            # every group counts once, as every muscle does in the paper
            differences = np.abs(predicted[:, with_emg] - measured[:, with_emg]).mean(axis=1)
            rows.append(
                _row(
                    label,
                    ALL_GROUPS,
                    metric,
                    function,
                    differences,
                    np.zeros_like(differences),
                    sampling,
                )
            )
    for g in with_emg:
        try:
            best = metrics.cross_correlation(predicted[:, g], measured[:, g], time, max_lag=MAX_LAG)
            found = (best.correlation, best.lag, "")
        except DataError as error:
            found = (math.nan, math.nan, str(error))
        for metric, value, unit in (("best lagged r", found[0], "-"), ("lag of best r", found[1], "s")):
            rows.append(
                ComparisonRow(
                    result=label, group=groups[g].name, metric=metric, value=value, unit=unit, note=found[2]
                )
            )
    return rows


def _pair_rows(
    label: str, emg_map: EmgMap, groups: Sequence[MuscleGroup], series: FloatArray, sampling: _Resampling
) -> list[ComparisonRow]:
    names = [group.name for group in groups]
    rows = []
    for metric, function in (
        ("activity ratio", metrics.activity_ratio),
        ("common activity", metrics.common_activity),
        ("co-contraction", metrics.co_contraction),
    ):
        for pair in emg_map.pairs:
            sides = [
                series[:, positions("group", side, names)].mean(axis=1)
                for side in (pair.numerator, pair.denominator)
            ]
            if not any(np.isnan(side).any() for side in sides):
                rows.append(_row(label, pair.name, metric, function, sides[0], sides[1], sampling))
    return rows


def _stability_rows(result: MotionResult, used: BoolArray) -> list[ComparisonRow]:
    assert result.stability is not None  # set by __post_init__
    rows = []
    for row, values in zip(result.stability_rows, result.stability[used].T, strict=True):
        if np.isfinite(values).any():
            rows.append(
                ComparisonRow(
                    result=result.label,
                    group=row,
                    metric="smallest stability",
                    value=float(np.nanmin(values)),
                    unit="N·m/rad",
                )
            )
    return rows


def _row(
    label: str,
    group: str,
    metric: str,
    function: Callable[[FloatArray, FloatArray], float],
    first: FloatArray,
    second: FloatArray,
    sampling: _Resampling,
) -> ComparisonRow:
    """Make one row; what is not defined becomes NaN with the reason."""
    try:
        value = function(first, second)
    except DataError as error:
        return ComparisonRow(result=label, group=group, metric=metric, value=math.nan, note=str(error))
    low = high = math.nan
    note = ""
    if sampling.n_resamples and len(first) >= LEAST_FRAMES_FOR_INTERVAL:
        try:
            interval = bootstrap_interval(
                function, first, second, n_resamples=sampling.n_resamples, seed=sampling.seed
            )
            low, high = interval.low, interval.high
        except DataError as error:
            note = str(error)
    return ComparisonRow(result=label, group=group, metric=metric, value=value, low=low, high=high, note=note)
