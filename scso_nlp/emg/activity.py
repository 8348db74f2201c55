"""EMG as activity of muscle groups: what a map file makes of channels, for comparisons and for terms."""

from __future__ import annotations

import os

import numpy as np

from scso_nlp.activity import MuscleActivity
from scso_nlp.arguments import checked
from scso_nlp.emg.map import EmgMap, read_emg_map
from scso_nlp.emg.signal import (
    Emg,
    delayed,
    envelope,
    normalize_to_mvc,
    normalize_to_peak,
    read_emg,
    scaled,
    warn_outside_unit_range,
)
from scso_nlp.exceptions import DataError
from scso_nlp.validation import FloatArray, positions

#: Activity beyond this is none, not even of signals in microvolts without a reference [-].
LARGEST_ACTIVITY = 1e9


@checked
def activity_of(emg: Emg, emg_map: EmgMap, *, start_offset: float = 0.0) -> MuscleActivity:
    """Turn an envelope into the activity of muscle groups, for terms that hold activations to it.

    Parameters
    ----------
    emg : Emg
        Envelope, as a fraction of the maximum or in the unit of the map's references.
    emg_map : EmgMap
        Groups, and reference, scale and delay of the channels. The channels of a group are averaged; groups
        without channels are left out.
    start_offset : float [s]
        Added to the EMG's time.

    Returns
    -------
    MuscleActivity
        At the EMG's own times, without negative values.

    Raises
    ------
    NameMismatchError
        A channel that is not there.
    DataError
        No channel at all, or values that are no fractions of a maximum.

    Examples
    --------
    >>> emg = scso.emg.Emg(channels=("bic",), time=[0.0, 0.5, 1.0], values=[[0.1], [0.2], [0.1]])
    >>> flexors = scso.emg.MuscleGroup(name="flexors", muscles=("biceps",), channels=("bic",))
    >>> emg_map = scso.emg.EmgMap(groups=(flexors,), scale={"bic": 0.5}, delay={"bic": 0.04})
    >>> activity = scso.emg.activity_of(emg, emg_map)
    >>> activity.time, activity.values.T
    (array([0.04, 0.54, 1.04]), array([[0.05, 0.1 , 0.05]]))
    """
    emg = as_activity(emg, emg_map)
    measured = [g for g, group in enumerate(emg_map.groups) if group.channels]
    return MuscleActivity(
        groups=tuple(emg_map.groups[g].name for g in measured),
        muscles=tuple(emg_map.groups[g].muscles for g in measured),
        time=emg.time + start_offset,
        values=np.maximum(group_means(emg, emg_map)[:, measured], 0.0),
        source=emg.source,
    )


@checked
def read_envelope(
    path: str | os.PathLike[str], emg_map: EmgMap, *, is_raw: bool = False, by_peak: bool = False
) -> Emg:
    """Read the channels of a map as an envelope.

    Parameters
    ----------
    path : path
        As for :func:`read_emg`.
    emg_map : EmgMap
    is_raw : bool
        Band-pass, rectify and smooth first, see :func:`envelope`.
    by_peak : bool
        Divide each channel by its largest value.

    Returns
    -------
    Emg
        All channels where nothing is to be done to them, else those of the map.

    Raises
    ------
    NameMismatchError
        A channel that is not there.
    DataError
        A file that cannot be used, or references in the map beside `by_peak`.
    """
    if by_peak and emg_map.mvc:
        raise DataError(
            f"{emg_map.source} has references in [mvc], and channels divided by their peaks would be divided "
            "twice; choose one"
        )
    emg = read_emg(path)
    if is_raw or by_peak:
        # other channels, e.g. a silent reference, cannot be normalized
        emg = emg.select(channel for group in emg_map.groups for channel in group.channels)
    emg = envelope(emg) if is_raw else emg
    return normalize_to_peak(emg) if by_peak else emg


@checked
def read_activity(
    path: str | os.PathLike[str],
    emg_map: str | os.PathLike[str],
    *,
    is_raw: bool = False,
    start_offset: float = 0.0,
) -> MuscleActivity:
    """Read EMG and its map file as the activity of muscle groups.

    Parameters
    ----------
    path, emg_map : path
        As for :func:`read_emg` and :func:`read_emg_map`.
    is_raw : bool
        As for :func:`read_envelope`.
    start_offset : float [s]
        Added to the EMG's time.

    Returns
    -------
    MuscleActivity

    Raises
    ------
    NameMismatchError, DataError, FileFormatError
        As for :func:`activity_of` and the two readers.
    """
    groups = read_emg_map(emg_map)
    return activity_of(read_envelope(path, groups, is_raw=is_raw), groups, start_offset=start_offset)


def as_activity(emg: Emg, emg_map: EmgMap) -> Emg:
    """Keep the channels of a map, each over its reference, times its scale, and delayed.

    Raises
    ------
    NameMismatchError
        A channel that is not there.
    DataError
        No channel in any group, or values that are no fractions of a maximum.
    """
    used = [channel for group in emg_map.groups for channel in group.channels]
    if not used:
        raise DataError(f"{emg_map.source} names no EMG channel, expected at least one group with channels")
    emg = emg.select(used)
    if emg_map.mvc:
        emg = normalize_to_mvc(emg, emg_map.mvc)
    else:
        warn_outside_unit_range(emg)
    refuse_large(f"{emg.source}: the EMG over its references of {emg_map.source}", emg.values)
    return delayed(scaled(emg, emg_map.scale), emg_map.delay)


def group_means(emg: Emg, emg_map: EmgMap) -> FloatArray:
    """Mean of the channels of each group, shape (n_samples, n_groups); NaN for groups without channels."""
    columns = [
        emg.values[:, positions("EMG channel", group.channels, emg.channels)].mean(axis=1)
        if group.channels
        else np.full(len(emg.time), np.nan)
        for group in emg_map.groups
    ]
    return np.column_stack(columns)


def refuse_large(what: str, values: FloatArray) -> None:
    """Raise DataError if values cannot be fractions of a maximum."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if largest > LARGEST_ACTIVITY:
        raise DataError(f"{what} is up to {largest:g}, expected a fraction of the maximum")
