"""Left and right: names that differ by their side mark alone stand for the same thing on both sides."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

#: What a mark means; upper and lower case are one, marks stand between separators or at an end of the name.
_SIDES = {"r": "right", "right": "right", "l": "left", "left": "left"}
_MARK = re.compile(r"(?<![^_.\-/ ])(right|left|r|l)(?![^_.\-/ ])", re.IGNORECASE)
#: A capital at the end of a word is a mark, too: ``TrapeziusR``.
_CAPITAL = re.compile(r"(?<=[a-z0-9])([RL])$")


@dataclass(frozen=True, kw_only=True)
class Sided:
    """One thing that a figure gives a panel to.

    Attributes
    ----------
    title : str
        The name without its side mark where both sides are there, otherwise the name.
    members : mapping of str to str
        Names by ``"right"`` and ``"left"``; or one name by ``""``.
    note : str
        Second line of the title.
    """

    title: str
    members: dict[str, str]
    note: str = ""


def paired(names: Sequence[str]) -> tuple[Sided, ...]:
    """Bring left and right together, in the order in which the first of them comes.

    Parameters
    ----------
    names : sequence of str
        Of muscles, stability rows, coordinates or columns.

    Returns
    -------
    tuple of Sided
        Two names are a pair if they have the same marks but for the side, e.g. ``soleus_r`` and ``soleus_l``,
        ``R_TA`` and ``L_TA``, ``knee_r_on_tibia_r`` and ``knee_l_on_tibia_l``. Where only one side has marks
        in all of the names, as in models that were mirrored later, names without a mark are the other side.
    """
    marks = {name: _marked(name) for name in names}
    found_sides = {side for _, side in marks.values() if side}
    unmarked = {"left": "right", "right": "left"}[found_sides.pop()] if len(found_sides) == 1 else ""
    by_stem: dict[str, dict[str, str]] = {}
    for name, (stem, side) in marks.items():
        by_stem.setdefault(stem, {}).setdefault(side or unmarked, name)
    found: dict[str, Sided] = {}
    for name, (stem, _) in marks.items():
        title, members = name, {"": name}
        both: dict[str, str] = {side: by_stem[stem].get(side, "") for side in ("right", "left")}
        if all(both.values()) and name in both.values():
            title, members = stem, both
        found.setdefault(next(iter(members.values())), Sided(title=title, members=members))
    return tuple(found.values())


def _marked(name: str) -> tuple[str, str]:
    """Give a name without its marks, and their side; none where it has no marks or those of both sides."""
    pattern = _MARK if _MARK.search(name) else _CAPITAL
    sides = {_SIDES[mark.lower()] for mark in pattern.findall(name)}
    if len(sides) != 1:
        return name, ""
    stem = re.sub(r"([_.\-/ ])[_.\-/ ]+", r"\1", pattern.sub("", name)).strip("_.-/ ")
    return stem or name, sides.pop()
