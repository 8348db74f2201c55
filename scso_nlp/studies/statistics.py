"""Means, spreads and paired differences: cycles within trials, trials within people; a person is one unit.

Cycles are averaged first, then the trials of each person, then people: somebody with many trials has no more
weight. Standard deviations are between people, with n - 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from scso_nlp.studies.cycles import POINTS
from scso_nlp.studies.tables import pandas

if TYPE_CHECKING:
    import pandas as pd

#: What a number of the tidy table is of, and a curve.
OF_NUMBER, OF_CURVE = ["quantity", "name", "statistic", "unit"], ["quantity", "name", "unit"]
#: Units that may vary, the largest first, and the columns that name one.
LEVELS = {"people": ["subject"], "trials": ["subject", "trial"], "cycles": ["subject", "trial", "cycle"]}
#: Share of such intervals that hold the true mean, if people's differences are normally distributed [-].
CONFIDENCE = 0.95


def mean_numbers(table: pd.DataFrame) -> pd.DataFrame:
    """Average every number over trials, then over people, condition by condition.

    Parameters
    ----------
    table : DataFrame
        The tidy table of a study.

    Returns
    -------
    DataFrame
        condition, quantity, name, statistic, unit; people and trials that have it; mean and sd over people,
        sd NaN of one person.
    """
    keys = ["condition", *OF_NUMBER]
    people = table.groupby([*keys, "subject"], sort=False)["value"].mean().reset_index()
    found = people.groupby(keys, sort=False)["value"].agg(people="count", mean="mean", sd="std")
    found.insert(1, "trials", table.groupby(keys, sort=False)["value"].count())
    return found.reset_index()


def paired_differences(table: pd.DataFrame, reference: str) -> pd.DataFrame:
    r"""Take every condition less the reference, within each trial, then by person.

    With :math:`d_i` the mean over the trials of person i, of n people, :math:`\bar d` and s their mean and
    standard deviation, the interval is

    .. math:: \bar d \pm t_{0.975,\,n-1}\, \frac{s}{\sqrt n}

    Parameters
    ----------
    table : DataFrame
        The tidy table of a study.
    reference : str
        One of its conditions.

    Returns
    -------
    DataFrame
        condition, reference, quantity, name, statistic, unit; people and trials that have both; mean of the
        reference over them, mean and sd of the difference over people; low and high, the 95 % interval of
        the mean, NaN of one person.

    References
    ----------
    Student (1908), Biometrika 6:1-25.
    """
    pairs = _pairs(table, reference)
    keys = ["condition", *OF_NUMBER]
    people = pairs.groupby([*keys, "subject"], sort=False)[["before", "change"]].mean().reset_index()
    grouped = people.groupby(keys, sort=False)
    found = grouped["change"].agg(people="count", mean="mean", sd="std")
    found.insert(1, "trials", pairs.groupby(keys, sort=False)["change"].count())
    found.insert(2, "reference_mean", grouped["before"].mean())
    n = found["people"].to_numpy()
    half = stats.t.ppf((1 + CONFIDENCE) / 2, np.maximum(n - 1, 1)) * found["sd"] / np.sqrt(n)
    found["low"], found["high"] = found["mean"] - half, found["mean"] + half
    found = found.reset_index()
    found.insert(1, "reference", reference)
    return found


def _pairs(table: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Put the reference's value of the same trial beside every value of the other conditions."""
    same = [*OF_NUMBER, "subject", "trial"]
    is_reference = table["condition"] == reference
    before = table.loc[is_reference, [*same, "value"]].rename(columns={"value": "before"})
    pairs = table[~is_reference].merge(before, on=same)
    return pairs.assign(change=pairs["value"] - pairs["before"])


def varying(cycles: pd.DataFrame) -> str:
    """Tell what bands are over: people, or the trials of one person, or the cycles of one trial."""
    counts = {word: len(cycles[columns].drop_duplicates()) for word, columns in LEVELS.items()}
    return next((word for word, n in counts.items() if n > 1), "cycles")


def mean_curves(cycles: pd.DataFrame) -> pd.DataFrame:
    """Average curves over cycles, trials and people, and give their spread.

    Parameters
    ----------
    cycles : DataFrame
        Of a study.

    Returns
    -------
    DataFrame
        condition, quantity, name, unit; n, how many, and over, what of, see :func:`varying`; measure, "mean"
        or "sd"; and its values from p0 to p100. sd is NaN where n is 1; a point of a cycle beside a frame
        that is not solved does not count.
    """
    over = varying(cycles)
    keys, points, curves = ["condition", *OF_CURVE], list(POINTS), cycles
    for columns in reversed(list(LEVELS.values())):
        if len(columns) >= len(LEVELS[over]):
            curves = curves.groupby([*keys, *columns], sort=False)[points].mean().reset_index()
    grouped = curves.groupby(keys, sort=False)
    about = grouped.size().rename("n").reset_index().assign(over=over)
    pd = pandas()
    return pd.concat(
        [
            pd.concat([about.assign(measure=measure), values.reset_index(drop=True)], axis=1)
            for measure, values in (("mean", grouped[points].mean()), ("sd", grouped[points].std()))
        ],
        ignore_index=True,
    )
