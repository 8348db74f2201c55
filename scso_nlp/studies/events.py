"""Where cycles begin and end: events that are given, or heel strikes found in the ground reaction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.constants import g as STANDARD_GRAVITY

from scso_nlp.figures.sides import paired
from scso_nlp.trajectory import Skeleton
from scso_nlp.validation import FloatArray

#: A foot is on the ground where it carries more than this share of body weight [-]: a convention. Thresholds
#: of 10 to 50 N are in use; a share also suits a child, and is above the noise of treadmills.
ON_GROUND = 0.05
#: A foot that is off or on the ground for less has not been lifted or set down: noise [s].
SHORTEST = 0.1
#: Rules by which events are found, and what stands in their place where there is no whole cycle.
GIVEN, GROUND_REACTION, WHOLE_TRIAL, NO_CYCLE = "given", "ground reaction", "whole trial", "no cycle"


@dataclass(frozen=True, kw_only=True)
class Events:
    """Times between which the cycles of a trial lie.

    Attributes
    ----------
    rule : str
        How they were found: :data:`GIVEN`, :data:`GROUND_REACTION` or :data:`WHOLE_TRIAL`.
    times : mapping of str to ndarray of shape (n_events,) [s]
        By foot, "right" and "left", where heel strikes were found; otherwise of all by "".
    """

    rule: str
    times: Mapping[str, FloatArray]

    def of(self, side: str) -> tuple[str, FloatArray]:
        """Choose whose events cut a curve.

        Parameters
        ----------
        side : str
            "right" or "left" where the name of the curve has such a mark, otherwise "".

        Returns
        -------
        foot : str
            The same side where that foot has loads; otherwise the right foot, or the left where it alone
            has.
        times : ndarray, shape (n_events,) [s]
            Fewer than two where there is no whole cycle.
        """
        foot = side if side in self.times else next(iter(self.times))
        return foot, self.times[foot]


def find_events(time: FloatArray, given: Sequence[float] | None, skeleton: Skeleton | None) -> Events:
    """Find the events of a trial by the first rule that applies.

    Given times are taken, those outside the motion left out. Otherwise heel strikes are looked for in the
    loads of the motion, see :func:`heel_strikes`; with two of one foot there is a cycle. Otherwise the whole
    trial is one.

    Parameters
    ----------
    time : ndarray, shape (n_frames,) [s]
    given : sequence of float or None [s]
    skeleton : Skeleton or None
        Of the motion at these frames, with its loads.

    Returns
    -------
    Events
    """
    if given:
        slack = 0.5 * (time[-1] - time[0]) / max(len(time) - 1, 1)
        times = np.unique([t for t in given if time[0] - slack <= t <= time[-1] + slack])
        return Events(rule=GIVEN, times={"": times})
    strikes = heel_strikes(time, skeleton) if skeleton is not None else {}
    if any(len(times) > 1 for times in strikes.values()):
        return Events(rule=GROUND_REACTION, times=strikes)
    return Events(rule=WHOLE_TRIAL, times={"": time[[0, -1]] if len(time) > 1 else time})


def heel_strikes(time: FloatArray, skeleton: Skeleton) -> dict[str, FloatArray]:
    """Find when each foot comes to the ground, from the loads that act on the bodies of either side.

    Parameters
    ----------
    time : ndarray, shape (n_frames,) [s]
    skeleton : Skeleton
        At these frames.

    Returns
    -------
    dict of str to ndarray of shape (n_strikes,) [s]
        By "right" and "left", the sides whose bodies have loads: times at which their sum against gravity
        rises through :data:`ON_GROUND` body weights, see :func:`contacts`.
    """
    pull = float(np.linalg.norm(skeleton.gravity))
    if not pull or not skeleton.load_names:
        return {}
    sides = {name: side for pair in paired(skeleton.bodies) for side, name in pair.members.items()}
    upwards = skeleton.load_forces @ (-skeleton.gravity / pull)
    threshold = ON_GROUND * STANDARD_GRAVITY * float(skeleton.body_masses.sum())
    found = {}
    for side in ("right", "left"):
        loads = [sides[skeleton.bodies[body]] == side for body in skeleton.load_bodies]
        if any(loads):
            found[side] = contacts(time, upwards[:, loads].sum(axis=1), threshold)
    return found


def contacts(time: FloatArray, force: FloatArray, threshold: float) -> FloatArray:
    """Find when a force rises through a threshold and stays.

    Parameters
    ----------
    time : ndarray, shape (n_frames,) [s]
    force : ndarray, shape (n_frames,) [N]
    threshold : float [N]

    Returns
    -------
    ndarray, shape (n_contacts,) [s]
        Between frames in straight lines. What is there from the first frame on has no beginning. First gaps,
        then contacts shorter than :data:`SHORTEST` are taken for noise.
    """
    is_on = force >= threshold
    before = np.flatnonzero(is_on[1:] != is_on[:-1])
    share = (threshold - force[before]) / (force[before + 1] - force[before])
    at = time[before] + share * (time[before + 1] - time[before])
    starts = [*([-np.inf] if is_on[0] else []), *at[~is_on[before]]]
    stops = [*at[is_on[before]], *([np.inf] if is_on[-1] else [])]
    spells: list[list[float]] = []
    for start, stop in zip(starts, stops, strict=True):
        if spells and start - spells[-1][1] < SHORTEST:
            spells[-1][1] = stop
        else:
            spells.append([start, stop])
    return np.array([start for start, stop in spells if start > -np.inf and stop - start >= SHORTEST])
