"""The rules of PROTOCOL.md on plain arrays: what counts, by which unit, and what is said of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from scso_nlp.emg.metrics import is_constant
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: A row that is missed by less counts as kept [N·m/rad].
KEPT = 1e-3
#: Least share of frames with power, and with an answer [-].
LEAST_POWER, LEAST_SOLVED = 0.05, 0.9
#: Fewer units have no interval.
LEAST_UNITS = 3
#: Fewer frames of a group have no shape.
LEAST_CELLS = 8
#: Net moments below this share of the largest have no agonists [-].
NO_MOMENT = 0.05
#: Reserves above this share of the net moment are too large [-].
MOST_RESERVES = 0.1
#: Lags that are tried [s].
LAGS = np.arange(21) / 100
#: A prediction that changes by less, absolutely and of its value, does not change [-].
STEADY, STEADY_SHARE = 1e-3, 0.01
#: Differences below this share of the rival's error are rounding of solvers [-].
ROUNDING = 1e-6
#: Metrics of which one has to be better for a claim.
CLAIMS = ("antagonists", "contact force")


def power(margin: FloatArray) -> float:
    """Share of frames in which some row is not kept.

    Parameters
    ----------
    margin : ndarray, shape (n_frames, n_rows) [N·m/rad]
        At static optimization's answer.
    """
    return float((margin < -KEPT).any(axis=1).mean())


def kinds(arms: FloatArray, moments: FloatArray) -> IntArray:
    """Tell agonists (1) from antagonists (-1); 0 where there is hardly a moment or no arm.

    Parameters
    ----------
    arms, moments : ndarray, shape (n_frames, n_groups)
        Moment arm times strength of each group, and net moment at its coordinate.
    """
    found = np.sign(arms) * np.sign(moments)
    found[np.abs(moments) < NO_MOMENT * np.abs(moments).max(axis=0)] = 0
    return found.astype(int)


def bends(time: FloatArray, moment: FloatArray, least: float = 0.5) -> IntArray:
    """Find the bend that each frame belongs to.

    Parameters
    ----------
    time, moment : ndarray, shape (n_frames,) [s], [N·m]
    least : float [s]
        Shorter spans are none.

    Returns
    -------
    ndarray of int, shape (n_frames,)
    """
    high = np.concatenate([[0], (moment > (moment.min() + moment.max()) / 2).astype(int), [0]])
    first, last = np.flatnonzero(np.diff(high) == 1), np.flatnonzero(np.diff(high) == -1) - 1
    long = time[last] - time[first] >= least
    borders = (time[last[long][:-1]] + time[first[long][1:]]) / 2
    return np.searchsorted(borders, time, side="right")


def level_errors(predicted: FloatArray, measured: FloatArray, cells: BoolArray, unit: IntArray) -> FloatArray:
    """Mean absolute difference over the cells of each unit; NaN in units without any.

    Parameters
    ----------
    predicted, measured : ndarray, shape (n_frames, n_groups) [-]
    cells : ndarray of bool, shape (n_frames, n_groups)
    unit : ndarray of int, shape (n_frames,)
    """
    apart = np.where(cells, np.abs(predicted - measured), np.nan)
    found = [apart[unit == u] for u in range(unit.max() + 1)]
    return np.array([np.nanmean(a) if np.isfinite(a).any() else np.nan for a in found])


def shape_errors(predicted: FloatArray, measured: FloatArray, cells: BoolArray, unit: IntArray) -> FloatArray:
    """One minus r over a group's cells of each unit, averaged over groups; arguments of `level_errors`."""
    found = np.full((unit.max() + 1, cells.shape[1]), np.nan)
    for u in range(len(found)):
        for g in range(cells.shape[1]):
            here = cells[:, g] & (unit == u)
            if here.sum() < LEAST_CELLS or is_constant(measured[here, g]):
                continue
            silent = is_constant(predicted[here, g])
            found[u, g] = 1 - (0 if silent else np.corrcoef(predicted[here, g], measured[here, g])[0, 1])
    return np.array([np.nanmean(row) if np.isfinite(row).any() else np.nan for row in found])


def lag(time: FloatArray, able: FloatArray, emg_time: FloatArray, emg: FloatArray) -> float:
    """Find by how much EMG runs ahead of what its muscles can make of the net moment [s].

    Parameters
    ----------
    time, emg_time : ndarray, shape (n_frames,) and (n_samples,) [s]
    able, emg : ndarray, shape (n_frames, n_groups) and (n_samples, n_groups)
    """

    def agreement(shift: float) -> float:
        pairs = zip(able.T, (np.interp(time - shift, emg_time, e) for e in emg.T), strict=True)
        return float(
            np.mean([0 if is_constant(a) or is_constant(e) else np.corrcoef(a, e)[0, 1] for a, e in pairs])
        )

    return float(LAGS[np.argmax([agreement(shift) for shift in LAGS])])


def interval(differences: Sequence[float] | FloatArray) -> tuple[float, float, float]:
    """Mean of paired differences with its 95 % interval by Student; NaN for the interval of few units."""
    found = np.asarray(differences, dtype=float)
    found = found[np.isfinite(found)]
    if not len(found):
        return math.nan, math.nan, math.nan
    mean = float(found.mean())
    if len(found) < LEAST_UNITS:
        return mean, math.nan, math.nan
    half = float(t.ppf(0.975, len(found) - 1) * found.std(ddof=1) / math.sqrt(len(found)))
    return mean, mean - half, mean + half


def seen(errors: Sequence[float], rival: Sequence[float]) -> int:
    """Tell if errors are seen to be below (-1) or above (1) a rival's in the same units, or neither (0)."""
    beside = np.asarray(rival, dtype=float)
    _, low, high = interval(np.asarray(errors, dtype=float) - beside)
    least = ROUNDING * np.max(np.nan_to_num(beside), initial=0.0)
    return -1 if high < -least else 1 if low > least else 0


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One method on one set.

    Attributes
    ----------
    power, solved, reserves : float [-]
    errors : mapping of str to sequence of float
        By metric, one per unit.
    """

    power: float
    solved: float
    reserves: float
    errors: Mapping[str, Sequence[float]]


def verdict(entry: Entry, plain: Entry, nulls: Mapping[str, Entry] | None = None) -> tuple[str, str]:
    """Say what a method is worth beside static optimization.

    Parameters
    ----------
    entry, plain : Entry
        Of the method and of static optimization.
    nulls : mapping of str to Entry, optional
        Rules without stability at the method's effort, none where they were not all run; None for a method
        that is such a rule itself.

    Returns
    -------
    word, note : str
    """
    if entry.power < LEAST_POWER:
        return "no power", ""
    if entry.solved < LEAST_SOLVED:
        return "not solved", ""
    counted = {
        metric: np.isfinite(np.asarray(plain.errors[metric]) - np.asarray(errors)).sum()
        for metric, errors in entry.errors.items()
    }
    if max(counted.values(), default=0) < LEAST_UNITS:
        return "too few units", f"n = {max(counted.values(), default=0)}"
    signs = {metric: seen(errors, plain.errors[metric]) for metric, errors in entry.errors.items()}
    worse = [metric for metric, sign in signs.items() if sign > 0]
    if worse:
        return "worse", ", ".join(worse)
    claims = [metric for metric in CLAIMS if signs.get(metric, 0) < 0]
    if not claims:
        return "no difference", ""
    if entry.reserves > max(MOST_RESERVES, plain.reserves):
        return "no difference", "better than SO, with reserves"
    if nulls is not None and not nulls:
        return "undecided", "better than SO, null models not run"
    unbeaten = [
        name
        for name, null in (nulls or {}).items()
        if not any(seen(entry.errors[metric], null.errors[metric]) < 0 for metric in claims)
    ]
    if unbeaten:
        return "no difference", f"better than SO, not than {', '.join(unbeaten)}"
    return "better", ", ".join(claims)


def is_above(high: float, low: float) -> bool:
    """Tell if a prediction is higher at one task than at another by more than rounding."""
    return high - low > max(STEADY, STEADY_SHARE * abs(low))
