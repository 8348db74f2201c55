"""What figures draw: named columns over the frames, and which of them are worth a panel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.figures.frames import FEW_FRAMES
from scso_nlp.figures.sides import Sided, paired
from scso_nlp.figures.style import SeriesStyle
from scso_nlp.validation import FloatArray, matches, read_only, unique_names

#: Panels of a figure that nobody has chosen names for.
MOST_PANELS = 12


@dataclass(frozen=True, kw_only=True)
class Series:
    """Named columns over the frames: what a figure draws in one color.

    Attributes
    ----------
    label : str
        For the legend.
    time : ndarray, shape (n_frames,) [s]
        Increasing.
    names : tuple of str
        Of muscles, stability rows, coordinates or columns.
    values : ndarray, shape (n_frames, n_names) [unit]
        NaN leaves a frame blank.
    units : tuple of str
        One per name; one for all by default.
    level : ndarray, shape (n_names,) [unit], optional
        What is below is unstable.
    highest : ndarray, shape (n_names,) [unit], optional
        What reaches it is saturated.
    are_tasks : bool
        Frames are tasks of their own, not moments of a movement.
    look : SeriesStyle, optional
        By its place in the figure by default.

    Raises
    ------
    DataError
        Arrays that do not fit each other.
    """

    label: str
    time: FloatArray
    names: tuple[str, ...]
    values: FloatArray
    units: tuple[str, ...]
    level: FloatArray | None = None
    highest: FloatArray | None = None
    are_tasks: bool = False
    look: SeriesStyle | None = None

    def __post_init__(self) -> None:
        names = unique_names("column", self.names)
        object.__setattr__(self, "names", names)
        units = tuple(self.units) * len(names) if len(self.units) == 1 else tuple(self.units)
        if len(units) != len(names):
            raise DataError(
                f"{len(units)} units for {len(names)} columns of {self.label!r}, expected one each"
            )
        object.__setattr__(self, "units", units)
        time = read_only("time", self.time, (-1,), "n_frames")
        if len(time) == 0 or (np.diff(time) <= 0).any():
            raise DataError(f"the times of {self.label!r} must increase, and be one at least")
        object.__setattr__(self, "time", time)
        for what, shape, axes in (
            ("values", (len(time), len(names)), "n_frames, n_names"),
            ("level", (len(names),), "n_names"),
            ("highest", (len(names),), "n_names"),
        ):
            given = getattr(self, what)
            if given is not None:
                kept = read_only(f"{what} of {self.label!r}", given, shape, axes, finite=False)
                object.__setattr__(self, what, kept)

    def column(self, name: str) -> FloatArray:
        """Values of a name, shape (n_frames,) [unit]; NaN where it is not there."""
        if name not in self.names:
            return np.full(len(self.time), np.nan)
        return self.values[:, self.names.index(name)]

    @property
    def are_few(self) -> bool:
        """True where frames are few enough to get a marker each."""
        return len(self.time) <= FEW_FRAMES

    def only(self, names: Sequence[str]) -> Series:
        """Keep some columns."""
        at = [self.names.index(name) for name in names]
        level, highest = (None if bound is None else bound[at] for bound in (self.level, self.highest))
        units = tuple(self.units[i] for i in at)
        return replace(
            self, names=tuple(names), values=self.values[:, at], units=units, level=level, highest=highest
        )

    def bound(self, what: str, name: str) -> float:
        """Give the ``"level"`` or ``"highest"`` of a name [unit]; NaN where there is none."""
        bounds = getattr(self, what)
        return float("nan") if bounds is None or name not in self.names else bounds[self.names.index(name)]


def all_names(series: Sequence[Series]) -> tuple[str, ...]:
    """Names of all series, each once."""
    return tuple(dict.fromkeys(name for each in series for name in each.names))


def chosen(kind: str, patterns: str, series: Sequence[Series]) -> tuple[Sided, ...]:
    """Find the names that patterns fit.

    Parameters
    ----------
    kind : str
        What the names are of, for the message.
    patterns : str
        Separated by commas, as for :func:`~scso_nlp.validation.matches`.
    series : sequence of Series

    Returns
    -------
    tuple of Sided
        In the order of the patterns; both sides in one where both are chosen.

    Raises
    ------
    NameMismatchError
        A pattern fits no name; the closest are suggested.
    """
    names = all_names(series)
    wanted = [pattern.strip() for pattern in patterns.split(",") if pattern.strip()]
    if not wanted:
        raise NameMismatchError(f"no {kind} is named in {patterns!r}, expected names or patterns with commas")
    found = dict.fromkeys(names[i] for pattern in wanted for i in matches(kind, pattern, names))
    pairs = paired(names)
    order = [next(pair for pair in pairs if name in pair.members.values()) for name in found]
    shown = dict.fromkeys(
        (pair.title, tuple((side, name) for side, name in pair.members.items() if name in found))
        for pair in order
    )
    return tuple(
        Sided(title=title, members=dict(members))
        if len(members) == 2
        else Sided(title=members[0][1], members={"": members[0][1]})
        for title, members in shown
    )


def most_telling(series: Sequence[Series], most: int = MOST_PANELS) -> tuple[Sided, ...]:
    """Choose what differs most between series, or is largest in one, the first first.

    Parameters
    ----------
    series : sequence of Series
    most : int

    Returns
    -------
    tuple of Sided
        At most so many, by the root mean square over the frames of the difference from the first series; of
        a single one, of its values. Names with a level come by their least margin, the least stable first.
    """
    pairs = paired(all_names(series))
    if len(pairs) <= most:
        return pairs
    worth = {name: _worth(series, name) for name in all_names(series)}
    return tuple(sorted(pairs, key=lambda pair: -max(worth[n] for n in pair.members.values()))[:most])


def _worth(series: Sequence[Series], name: str) -> float:
    """How much a name tells; -inf where nothing is known."""
    first, *others = series
    if first.level is not None:
        margins = [_extreme(each.column(name) - each.bound("level", name)) for each in series]
        return -min(margins)
    values = first.column(name)
    differences = [np.interp(first.time, each.time, each.column(name)) - values for each in others]
    return max(_size(difference) for difference in differences or [values])


def _size(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else -np.inf


def _extreme(margin: FloatArray) -> float:
    known = margin[np.isfinite(margin)]
    return float(known.min()) if known.size else np.inf
