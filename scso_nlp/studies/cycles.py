"""Time series over per cent of a cycle: one curve for every cycle, name and quantity."""

from __future__ import annotations

from typing import NamedTuple

from scso_nlp.figures.cycles import PERCENT, over_cycle
from scso_nlp.figures.series import Series
from scso_nlp.figures.sides import paired
from scso_nlp.studies.events import Events
from scso_nlp.validation import FloatArray

#: Columns of a curve's values in tables, 0 to 100 % of the cycle.
POINTS = tuple(f"p{percent:.0f}" for percent in PERCENT)


class Curve(NamedTuple):
    """One quantity of one name over one cycle.

    Attributes
    ----------
    quantity, name, unit : str
    foot : str
        Whose heel strikes begin and end the cycle; empty where events were given, or for a whole trial.
    cycle : int
        Of this trial and foot, from one.
    start, stop : float [s]
    values : ndarray, shape (101,) [unit]
        NaN beside frames that are not solved.
    """

    quantity: str
    name: str
    unit: str
    foot: str
    cycle: int
    start: float
    stop: float
    values: FloatArray


def cut_curves(quantity: str, series: Series, events: Events) -> list[Curve]:
    """Cut a series into cycles, each over 101 points from 0 to 100 %.

    Parameters
    ----------
    quantity : str
    series : Series
    events : Events

    Returns
    -------
    list of Curve
        None of tasks, which are no movement, and of names whose foot has no whole cycle. Between frames and
        at the events values are interpolated in straight lines.
    """
    if series.are_tasks:
        return []
    sides = {name: side for pair in paired(series.names) for side, name in pair.members.items()}
    by_foot: dict[str, list[str]] = {}
    for name in series.names:
        by_foot.setdefault(events.of(sides[name])[0], []).append(name)
    found = []
    for foot, names in by_foot.items():
        times = events.times[foot].tolist()
        if len(times) < 2:
            continue
        (course,), _ = over_cycle([series.only(names)], times)
        for i, (name, unit) in enumerate(zip(names, course.series.units, strict=True)):
            found += [
                Curve(quantity, name, unit, foot, c + 1, times[c], times[c + 1], values)
                for c, values in enumerate(course.cycles[:, :, i])
            ]
    return found
