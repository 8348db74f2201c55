"""Moments of coordinates: required, of muscles, of reserves; what needs no panel is said in a sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scso_nlp.figures.series import MOST_PANELS, Series
from scso_nlp.figures.sides import Sided, paired
from scso_nlp.solution.rows import NEGLIGIBLE_MOMENT
from scso_nlp.validation import FloatArray, shown_names
from scso_nlp.verdict import RESERVE_LIMIT

#: Reserves below this share of what OpenSim advises get no panel [-].
TRIVIAL = 0.5
#: Muscles that carry less than this share of a peak moment do not move the coordinate [-].
_IDLE = 0.05


def folded(required: Series, *muscles: Series) -> tuple[tuple[Sided, ...], tuple[str, ...]]:
    """Find the coordinates that are worth a panel, and say what the others would show.

    Parameters
    ----------
    required : Series
        Moments that the motion asks for.
    *muscles : Series
        Those of muscles, one per result; the rest is carried by reserves.

    Returns
    -------
    panels : tuple of Sided
        Coordinates at which muscles and reserves matter both, on one side at least; where there are none,
        some of those that muscles move.
    notes : tuple of str
        Of the coordinates whose reserves carry little, and of those that no muscle moves.
    """
    names = required.names
    carried = {n: max(_peak(required.column(n) - each.column(n)) for each in muscles) for n in names}
    given = {name: max(_peak(each.column(name)) for each in muscles) for name in names}
    asked = {name: max(_peak(required.column(name)), NEGLIGIBLE_MOMENT) for name in names}
    trivial = [name for name in names if carried[name] <= TRIVIAL * RESERVE_LIMIT * asked[name]]
    idle = [n for n in names if n not in trivial and given[n] <= _IDLE * asked[n]]
    nothing = [name for name in names if asked[name] <= NEGLIGIBLE_MOMENT]
    panels = _worth(names, (*trivial, *idle)) or _worth(names, (*idle, *nothing))[:MOST_PANELS]
    drawn = {name for pair in panels for name in pair.members.values()}
    notes = []
    if told := trivial if drawn <= set(trivial) else [name for name in trivial if name not in drawn]:
        share = max(100 * carried[name] / asked[name] for name in told)
        shown = f"at most {share:.2g} %" if share > 0.1 else "less than 0.1 %"
        notes.append(f"Reserves carry {shown} of the peak moment of {shown_names(told)}.")
    if left_out := [name for name in idle if name not in drawn]:
        units = dict(zip(required.names, required.units, strict=True))
        worsts = [
            max((n for n in left_out if units[n] == unit), key=carried.__getitem__)
            for unit in dict.fromkeys(units[n] for n in left_out)
        ]
        most = " and ".join(f"{carried[name]:.3g} {units[name]} ({name})" for name in worsts)
        notes.append(f"Actuators alone move {shown_names(left_out)}, with at most {most}.")
    return panels, tuple(notes)


def _worth(names: Sequence[str], left_out: Sequence[str]) -> tuple[Sided, ...]:
    """Pair the names of which one side at least is not left out."""
    return tuple(pair for pair in paired(names) if not set(pair.members.values()) <= set(left_out))


def _peak(values: FloatArray) -> float:
    return float(np.nanmax(np.abs(values), initial=0.0))
