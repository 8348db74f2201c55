"""How the problems of this folder read recorded motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from problems.fetch import DataSet, fetch, motion_cache
from scso_nlp import MuscleForceProblem, static_optimization
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import NameMismatchError
from scso_nlp.needs import HasNeeds
from scso_nlp.opensim.engine import load_motion


def folder_of(trial: str, trials: Sequence[str], data: DataSet) -> Path:
    """Fetch the data set of a trial.

    Parameters
    ----------
    trial : str
    trials : sequence of str
        Those of the data set that are used.
    data : DataSet

    Returns
    -------
    Path

    Raises
    ------
    NameMismatchError
        No such trial.
    DataError
        The data cannot be fetched.
    """
    if trial not in trials:
        raise NameMismatchError(f"unknown trial {trial!r}, expected one of {', '.join(trials)}")
    return fetch(data)


def stable_problem(
    stability: StabilityConstraint, *, prepare_for: Sequence[HasNeeds] = (), **motion: Any
) -> MuscleForceProblem:
    """Read a motion and describe static optimization of it with stability rows.

    Parameters
    ----------
    stability : StabilityConstraint
    prepare_for : sequence of terms
        Extract what these need, too.
    motion
        As for :func:`scso_nlp.load_motion`.

    Returns
    -------
    MuscleForceProblem
    """
    read = load_motion(prepare_for=[stability, *prepare_for], cache=motion_cache(), **motion)
    plain = static_optimization(read)
    return replace(plain, constraints=(*plain.constraints, stability))
