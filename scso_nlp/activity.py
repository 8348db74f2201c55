"""Activity of groups of muscles over time, as electromyography measures it, for terms that hold to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError
from scso_nlp.motion import Motion
from scso_nlp.validation import FloatArray, IntArray, matches, read_only, unique_names


@dataclass(frozen=True, kw_only=True)
@checked
class MuscleActivity:
    """Activity of groups of muscles over time, as a share of the largest.

    Attributes
    ----------
    groups : tuple of str
    muscles : tuple of tuple of str
        Of each group, by name or pattern.
    time : ndarray, shape (n_samples,) [s]
        Strictly increasing.
    values : ndarray, shape (n_samples, n_groups) [-]
    source : str
        Where it comes from, for messages.

    Raises
    ------
    DataError
        Wrong shapes, a number that is not finite, time that does not increase, a group without muscles.

    Examples
    --------
    >>> activity = scso.MuscleActivity(
    ...     groups=("flexors",), muscles=(("biceps", "brachialis"),), time=[0.0, 1.0], values=[[0.1], [0.3]]
    ... )
    >>> activity.groups
    ('flexors',)
    """

    groups: tuple[str, ...]
    muscles: tuple[tuple[str, ...], ...]
    time: FloatArray
    values: FloatArray
    source: str = "activity"

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "groups", unique_names(f"{self.source}: group", self.groups))
        set_field(self, "time", read_only(f"{self.source}: time", self.time, (-1,), "n_samples"))
        shape = (len(self.time), len(self.groups))
        values = read_only(f"{self.source}: values", self.values, shape, "n_samples, n_groups")
        set_field(self, "values", values)
        if not len(self.time) or (np.diff(self.time) <= 0).any():
            raise DataError(f"{self.source}: time must hold at least one sample and increase")
        if len(self.muscles) != len(self.groups) or not all(self.muscles):
            raise DataError(f"{self.source}: expected one list of muscles, not empty, for each group")

    def of(self, motion: Motion) -> tuple[IntArray, IntArray, FloatArray]:
        """Say what is known of the muscles of a motion.

        Parameters
        ----------
        motion : Motion

        Returns
        -------
        positions : ndarray of int, shape (n_measured,)
            Of the muscles that stand in a group, in the motion's order.
        groups : ndarray of int, shape (n_measured,)
            Their groups.
        activity : ndarray, shape (n_frames, n_measured) [-]
            That of their groups at the motion's times, by linear interpolation.

        Raises
        ------
        NameMismatchError
            A name or pattern that fits no muscle.
        DataError
            A muscle in two groups, or a frame that the activity does not cover.
        """
        names = motion.trajectory.muscles
        owner: dict[int, int] = {}
        for group, patterns in enumerate(self.muscles):
            where = f"muscle in group {self.groups[group]!r} of {self.source}"
            for muscle in {m for pattern in patterns for m in matches(where, pattern, names)}:
                if owner.setdefault(muscle, group) != group:
                    raise DataError(
                        f"{self.source}: muscle {names[muscle]!r} is in two groups, "
                        f"{self.groups[owner[muscle]]!r} and {self.groups[group]!r}, expected one"
                    )
        positions = np.array(sorted(owner))
        groups = np.array([owner[muscle] for muscle in positions])
        time, first, last = motion.trajectory.time, self.time[0], self.time[-1]
        # a time stamp may be rounded: half a sample outside is not outside
        slack = 0.5 * float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0
        if time[0] < first - slack or time[-1] > last + slack:
            raise DataError(
                f"{self.source} covers {float(first)} to {float(last)} s, the motion needs {float(time[0])} "
                f"to {float(time[-1])} s; cut the motion, or give the EMG an offset"
            )
        known = np.column_stack([np.interp(time, self.time, column) for column in self.values.T])
        return positions, groups, known[:, groups]
