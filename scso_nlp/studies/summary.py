"""What one solve comes to: the numbers of the tidy table, from the files that the user receives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from scso_nlp.emg.metrics import common_activity
from scso_nlp.figures.series import Series
from scso_nlp.solution.rows import NEGLIGIBLE_MOMENT
from scso_nlp.trajectory import MotionTrajectory
from scso_nlp.validation import FloatArray
from scso_nlp.verdict import UNUSABLE, USABLE

#: How a series becomes one number, over the solved frames, each with the same weight.
STATISTICS: dict[str, Callable[[FloatArray], float]] = {
    "mean": lambda values: float(values.mean()),
    "peak": lambda values: float(np.abs(values).max()),
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
    "least": lambda values: float(values.min()),
}
#: Which of these belong to which quantity.
OF_SERIES = {
    "activation": ("mean", "peak"),
    "force": ("mean", "peak"),
    "moment": ("rms", "peak"),
    "reserve moment": ("rms", "peak"),
    "stability": ("mean", "least"),
    "margin": ("mean", "least"),
    "reaction": ("mean", "peak"),
}
#: Where extremes of a verdict stand in the table: quantity, name, statistic.
_EXTREMES = {
    "margin": ("margin", "all rows", "least"),
    "missed": ("missed level", "all rows", "peak"),
    "reserve": ("reserve share", "all coordinates", "peak"),
    "residual_force": ("residual", "force", "peak"),
    "residual_moment": ("residual", "moment", "peak"),
    "motor_force": ("motor", "force", "peak"),
    "motor_moment": ("motor", "moment", "peak"),
}


class Number(NamedTuple):
    """One row of the tidy table, without what it is of.

    Attributes
    ----------
    quantity, name, statistic : str
    value : float [unit]
    unit : str
    """

    quantity: str
    name: str
    statistic: str
    value: float
    unit: str


def verdict_numbers(report: Mapping[str, Any]) -> Iterator[Number]:
    """Take the verdict of one solve out of its report.

    Parameters
    ----------
    report : mapping
        As in ``report.json``, also of a run that failed.

    Yields
    ------
    Number
        Frames in all, by status, and with all rows stable; least margin; what reserves, residuals and motors
        carry at most; and the effort per solved frame, in all and by what it is paid for.
    """
    statuses, verdict = report["frame_status"], report["verdict"]
    yield Number("frames", "all", "count", len(statuses), "-")
    usable = sum(status in USABLE for status in statuses)
    yield Number("frames", "usable", "count", usable, "-")
    for status in (*USABLE, *UNUSABLE):
        yield Number("frames", status.lower().replace("_", " "), "count", statuses.count(status), "-")
    if verdict["frames_stable"] is not None:
        yield Number("frames", "stable", "count", verdict["frames_stable"], "-")
    for key, place in _EXTREMES.items():
        if verdict[key] is not None:
            yield Number(*place, verdict[key]["amount"], verdict[key]["unit"])
    if usable:
        paid = {what: amount / usable for what, amount in verdict["effort"].items()}
        yield Number("effort", "all", "mean", sum(paid.values()), "-")
        yield from (Number("effort", what, "mean", amount, "-") for what, amount in paid.items())


def series_numbers(series: Mapping[str, Series]) -> Iterator[Number]:
    """Sum up every series, name by name.

    Parameters
    ----------
    series : mapping of str to Series
        By quantity, one of :data:`OF_SERIES`; what is not solved is NaN.

    Yields
    ------
    Number
        Of activations also the mean over all muscles.
    """
    for quantity, each in series.items():
        for name, unit, values in zip(each.names, each.units, each.values.T, strict=True):
            known = values[np.isfinite(values)]
            if known.size:
                for statistic in OF_SERIES[quantity]:
                    yield Number(quantity, name, statistic, STATISTICS[statistic](known), unit)
    activation = series["activation"].values
    if activation.size and np.isfinite(activation).any():
        yield Number("activation", "all muscles", "mean", float(np.nanmean(activation)), "-")


def co_contraction_numbers(tendon_force: Series, trajectory: MotionTrajectory) -> Iterator[Number]:
    r"""Say how much muscles work against each other at every coordinate.

    Tendon forces :math:`F_m` make moments of both signs about a coordinate, by the sign of their moment arms
    :math:`r_m`:

    .. math:: M^+_k = \sum_m \max(r_{m,k}, 0)\, F_{m,k}, \quad M^-_k = \sum_m \max(-r_{m,k}, 0)\, F_{m,k}

    The antagonists are the side that makes less in a frame. The index is twice their moment over that of all:

    .. math:: \mathrm{CCI} = \frac{2 \sum_k \min(M^+_k, M^-_k)}{\sum_k (M^+_k + M^-_k)}

    Parameters
    ----------
    tendon_force : Series
        Of the muscles [N]; frames that are not solved are NaN, and left out.
    trajectory : MotionTrajectory
        Of the same frames and muscles.

    Yields
    ------
    Number
        "co-contraction", "index" of every coordinate that muscles act on, 0 to 1 [-]; and the "mean" moment
        of the antagonists, which grows with the effort [N·m, for translations N].

    References
    ----------
    Falconer and Winter (1985), Electromyogr Clin Neurophysiol 25:135-149: twice the antagonists' moment over
    the total moment. They took moments from EMG; here they are of the model's tendon forces, see
    :func:`~scso_nlp.emg.metrics.common_activity`.
    """
    positive, negative = opposing_moments(tendon_force, trajectory)
    known = np.isfinite(positive).all(axis=1)
    if not known.any():
        return
    for c, coordinate in enumerate(trajectory.coordinates):
        one, other = positive[known, c], negative[known, c]
        if max(one.max(), other.max()) > NEGLIGIBLE_MOMENT:
            unit = "N·m" if trajectory.is_rotational[c] else "N"
            yield Number("co-contraction", coordinate, "index", common_activity(one, other), "-")
            yield Number("co-contraction", coordinate, "mean", float(np.minimum(one, other).mean()), unit)


def opposing_moments(tendon_force: Series, trajectory: MotionTrajectory) -> tuple[FloatArray, FloatArray]:
    """Sum the moments of muscles about every coordinate by their sign.

    Parameters
    ----------
    tendon_force : Series
        [N]
    trajectory : MotionTrajectory
        Of the same frames and muscles.

    Returns
    -------
    positive, negative : ndarray, shape (n_frames, n_coordinates) [N·m or N]
        Both not negative; their difference is the moment of the muscles.
    """
    moments = trajectory.moment_arms * tendon_force.values[:, np.newaxis, :]
    return np.maximum(moments, 0.0).sum(axis=2), np.maximum(-moments, 0.0).sum(axis=2)
