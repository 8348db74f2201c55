"""Which EMG channels and which muscles belong together: groups, pairs of groups, the file that names them.

The map file, in TOML, says which channels and which muscles of the model form a group::

    format = 1

    [groups."rectus abdominis, right"]
    channels = ["rectabd_r"]
    muscles = ["rect_abd_r"]            # names, or patterns such as "IL_*_r"

    [mvc]                               # only for data that are not normalised: reference value per channel
    rectabd_r = 0.41

    [scale]                             # what a channel is multiplied by to stand for activation; 1 if not
    rectabd_r = 0.8

    [delay]                             # by how many seconds activation follows the channel; 0 if not
    rectabd_r = 0.04

    [pairs."abdomen over back"]         # for ratios and co-contraction
    numerator = ["rectus abdominis, right"]
    denominator = ["erector spinae, right"]
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.files import read_toml
from scso_nlp.text import shown
from scso_nlp.validation import matches, nearest, positions, unique_names

#: The version of the map file that this module reads.
MAP_FORMAT = 1
#: Tables of numbers by channel: what each is above, and what a message expects.
_BY_CHANNEL = {
    "mvc": (0.0, "a number above 0"),
    "scale": (0.0, "a number above 0"),
    "delay": (-math.inf, "a finite number of seconds"),
}


@dataclass(frozen=True, kw_only=True)
@checked
class MuscleGroup:
    """Muscles of the model, and the EMG channels over them.

    Attributes
    ----------
    name : str
    muscles : tuple of str
        Names; in an :class:`EmgMap` also patterns (``*``, ``?``, ``[...]``).
    channels : tuple of str
        May be empty: a group that is only looked at in the model.
    """

    name: str
    muscles: tuple[str, ...]
    channels: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
@checked
class GroupPair:
    """Two sets of groups that work against each other.

    Attributes
    ----------
    name : str
    numerator, denominator : tuple of str
        Names of groups.
    """

    name: str
    numerator: tuple[str, ...]
    denominator: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
@checked
class EmgMap:
    """Which channels and muscles belong together.

    Attributes
    ----------
    groups : tuple of MuscleGroup
    pairs : tuple of GroupPair
    mvc : mapping of str to float [unit of the channel]
        Reference value per channel.
    scale : mapping of str to float [-]
        What the channel, over its reference, is multiplied by; 1 where not named.
    delay : mapping of str to float [s]
        By how much activation follows the channel; 0 where not named.
    source : str
        The file, for messages.
    """

    groups: tuple[MuscleGroup, ...]
    pairs: tuple[GroupPair, ...] = ()
    mvc: Mapping[str, float] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    delay: Mapping[str, float] = field(default_factory=dict)
    source: str = "EMG map"

    def __post_init__(self) -> None:
        for table in _BY_CHANNEL:
            object.__setattr__(self, table, MappingProxyType(dict(getattr(self, table))))
        if not self.groups:
            raise DataError(f"{self.source} has no group, expected at least one")
        names = unique_names("group", (group.name for group in self.groups))
        unique_names("pair", (pair.name for pair in self.pairs))
        owner: dict[str, str] = {}
        for group in self.groups:
            if not group.muscles:
                raise DataError(f"{self.source}: group {group.name!r} has no muscles, expected at least one")
            _claim(owner, "channel", group.channels, group.name, self.source)
        for pair in self.pairs:
            positions(
                f"group of pair {pair.name!r} in {self.source}", (*pair.numerator, *pair.denominator), names
            )
            if not pair.numerator or not pair.denominator:
                raise DataError(f"{self.source}: pair {pair.name!r} needs a numerator and a denominator")
            both = sorted(set(pair.numerator) & set(pair.denominator))
            if both:
                raise DataError(f"{self.source}: pair {pair.name!r} has {both[0]!r} on both sides")
        for table, (least, expected) in _BY_CHANNEL.items():
            values = getattr(self, table)
            if values:
                positions(f"channel of [{table}] in {self.source}", values, tuple(owner))
            for channel, value in values.items():
                if not least < value < math.inf:
                    raise DataError(f"{self.source}: {table}.{channel} is {value:g}, expected {expected}")

    def resolve(self, muscles: Sequence[str], channels: Sequence[str] | None = None) -> EmgMap:
        """Replace patterns by the muscles of a model and check every name.

        Parameters
        ----------
        muscles : sequence of str
            Muscles of the model.
        channels : sequence of str, optional
            Channels of the EMG; not checked without it.

        Returns
        -------
        EmgMap
            With names only, in the model's order.

        Raises
        ------
        NameMismatchError
            A muscle or channel that is not there, or a pattern that fits nothing.
        DataError
            A muscle in two groups.
        """
        owner: dict[str, str] = {}
        groups = []
        for group in self.groups:
            where = f"in group {group.name!r} of {self.source}"
            chosen = {m for pattern in group.muscles for m in matches(f"muscle {where}", pattern, muscles)}
            names = tuple(muscles[m] for m in sorted(chosen))
            _claim(owner, "muscle", names, group.name, self.source)
            if channels is not None:
                positions(f"EMG channel {where}", group.channels, channels)
            groups.append(replace(group, muscles=names))
        return replace(self, groups=tuple(groups))


@checked
def read_emg_map(path: str | os.PathLike[str]) -> EmgMap:
    """Read a map file, see the top of this module for its form.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    EmgMap

    Raises
    ------
    DataError
        No such file, or a map that contradicts itself.
    FileFormatError
        Not TOML, an unknown key, or a value of the wrong kind.
    """
    path = Path(path)
    content = read_toml(path)
    _check_keys(path, "", content, ("format", "groups", "pairs", *_BY_CHANNEL))
    found = content.get("format", "missing")
    if found is True or found != MAP_FORMAT:
        raise FileFormatError(
            f"{path}: format is {shown(found)}, expected format = {MAP_FORMAT} as the first line"
        )
    groups = _entries(path, "groups", content, ("channels", "muscles"))
    pairs = _entries(path, "pairs", content, ("numerator", "denominator"))
    by_channel = {table: _numbers(path, table, content.get(table, {})) for table in _BY_CHANNEL}
    return EmgMap(
        groups=tuple(MuscleGroup(name=name, **lists) for name, lists in groups.items()),
        pairs=tuple(GroupPair(name=name, **lists) for name, lists in pairs.items()),
        **by_channel,
        source=str(path),
    )


@checked
def map_skeleton(muscles: Sequence[str], source: str = "the model") -> str:
    """Write a map file for a model, with a group for every muscle and no channels yet.

    Parameters
    ----------
    muscles : sequence of str
        Names, at least one. Those that differ in their digits only are parts of one muscle.
    source : str
        What to say of where they stand.

    Returns
    -------
    str
        TOML that :func:`read_emg_map` reads as it is.

    Raises
    ------
    DataError
        No muscle.

    Examples
    --------
    >>> from scso_nlp.emg.map import map_skeleton
    >>> print(map_skeleton(["glut_max1_r", "glut_max2_r", "soleus_r"]).partition("format")[2])
     = 1
    <BLANKLINE>
    [groups."glut_max_r"]
    channels = []
    muscles = ["glut_max1_r", "glut_max2_r"]
    <BLANKLINE>
    [groups."soleus_r"]
    channels = []
    muscles = ["soleus_r"]
    <BLANKLINE>
    """
    if not muscles:
        raise DataError(f"{source} has no muscle that an EMG map could name")
    groups: dict[str, list[str]] = {}
    for muscle in muscles:
        groups.setdefault(re.sub(r"\d+", "", muscle) or muscle, []).append(muscle)
    lines = [
        f"# Muscles of {source}: write the EMG channels over each group between its brackets, e.g.",
        '# channels = ["tibialis anterior R"], join or delete groups as you like, and give others names.',
        '# Muscles may be patterns, e.g. "glut_*_r"; a channel or a muscle stands in one group only.',
        f"format = {MAP_FORMAT}",
    ]
    for stem, members in groups.items():
        # JSON's strings and lists are TOML's
        name, names = (
            json.dumps(item, ensure_ascii=False) for item in (stem if members[1:] else members[0], members)
        )
        lines += ["", f"[groups.{name}]", "channels = []", f"muscles = {names}"]
    return "\n".join(lines) + "\n"


def _claim(owner: dict[str, str], kind: str, names: tuple[str, ...], group: str, source: str) -> None:
    """Note that names belong to a group, unless one belongs to another already."""
    for name in names:
        if name in owner:
            raise DataError(
                f"{source}: {kind} {name!r} is in two groups, {owner[name]!r} and {group!r}, expected one"
            )
        owner[name] = group


def _entries(
    path: Path, key: str, content: Mapping[str, object], lists: tuple[str, ...]
) -> dict[str, dict[str, tuple[str, ...]]]:
    """Read a table of tables, each with lists of names; a list that is not there is empty."""
    entries = {}
    for name, entry in _table(path, key, content.get(key, {})).items():
        where = f"{key}.{name!r}"
        table = _table(path, where, entry)
        _check_keys(path, where, table, lists)
        entries[name] = {item: _names(path, f"{where}.{item}", table.get(item, [])) for item in lists}
    return entries


def _numbers(path: Path, table: str, value: object) -> dict[str, float]:
    """Read a table of numbers by channel, as large as they must be."""
    least, expected = _BY_CHANNEL[table]
    for channel, number in _table(path, table, value).items():
        is_number = isinstance(number, int | float) and not isinstance(number, bool)
        if not (is_number and least < number <= sys.float_info.max):
            raise FileFormatError(f"{path}: {table}.{channel} is {shown(number)}, expected {expected}")
    return {channel: float(number) for channel, number in _table(path, table, value).items()}


def _table(path: Path, where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise FileFormatError(f"{path}: {where} is {shown(value)}, expected a table")
    return value


def _check_keys(path: Path, where: str, table: Mapping[str, object], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            place = f" in {where}" if where else ""
            raise FileFormatError(f"{path}: unknown key {key!r}{place} ({nearest(key, known)})")


def _names(path: Path, where: str, value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(item, str) and item for item in value):
        raise FileFormatError(f"{path}: {where} is {shown(value)}, expected a list of names")
    return unique_names(where, value)
