"""Figures of one solution: activations, moments and stability, beside those of a baseline."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import FEW_FRAMES, HorizontalAxis
from scso_nlp.figures.moments import folded
from scso_nlp.figures.quantity import of_how_many, plot_quantity, quantity_pages
from scso_nlp.figures.series import Series, chosen
from scso_nlp.figures.style import MARK, REQUIRED, RESULT, TWO_COLUMNS, SeriesStyle
from scso_nlp.solution import Solution
from scso_nlp.trajectory import require_same_motion
from scso_nlp.validation import FloatArray


@checked
def plot_activations(
    solution: Solution,
    *,
    baseline: Solution | None = None,
    horizontal: HorizontalAxis | None = None,
    muscles: str = "",
    width: float = TWO_COLUMNS,
) -> Figure:
    """Draw activations, left and right of a muscle in one panel.

    Parameters
    ----------
    solution : Solution
    baseline : Solution, optional
        Of the same motion, usually without stability rows; drawn behind.
    horizontal : HorizontalAxis, optional
        Time by default; the numbers of the tasks where there are few frames in which nothing moves.
    muscles : str
        Names or patterns, separated by commas; ``"*"`` for all. By default the twelve whose activation
        changes most from the baseline, or that are most active.
    width : float [mm]
        Of the figure on the page.

    Returns
    -------
    matplotlib.figure.Figure
        Frames that are not solved are left blank and shaded, saturated muscles are marked.

    Raises
    ------
    NameMismatchError
        The baseline has other muscles, or a pattern fits none.
    DataError
        The baseline has other frames, or the horizontal values are not one per frame.

    Examples
    --------
    >>> figure = scso.plot_activations(solution)
    >>> figure.savefig("activations.pdf")  # doctest: +SKIP
    """
    return _of_muscles(solution, baseline, "activation", "activations", muscles, width, horizontal)


@checked
def plot_forces(
    solution: Solution,
    *,
    baseline: Solution | None = None,
    horizontal: HorizontalAxis | None = None,
    muscles: str = "",
    width: float = TWO_COLUMNS,
) -> Figure:
    """Draw tendon forces, left and right of a muscle in one panel.

    Parameters
    ----------
    solution, baseline, horizontal, muscles, width
        As for :func:`plot_activations`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    NameMismatchError, DataError
        As for :func:`plot_activations`.
    """
    return _of_muscles(solution, baseline, "force", "tendon forces", muscles, width, horizontal)


@checked
def activation_pages(solution: Solution, *, baseline: Solution | None = None) -> tuple[Figure, ...]:
    """Draw all activations on pages: first the muscles that tell most, then all in the model's order.

    Parameters
    ----------
    solution : Solution
    baseline : Solution, optional
        As for :func:`plot_activations`.

    Returns
    -------
    tuple of matplotlib.figure.Figure
        One page alone where it has all muscles.

    Raises
    ------
    NameMismatchError, DataError
        As for :func:`plot_activations`.
    """
    heading = f"{solution.problem.motion.name}: activations"
    both = beside(solution, baseline, partial(series_of, quantity="activation"))
    return quantity_pages(both, heading=heading)


@checked
def plot_moments(
    solution: Solution,
    *,
    horizontal: HorizontalAxis | None = None,
    coordinates: str = "",
    width: float = TWO_COLUMNS,
) -> Figure:
    """Draw required, muscle and reserve moment of coordinates, left and right in one panel.

    The share of reserves and residuals (root mean square over that of the required moment) stands in each
    panel, the right side's first.

    Parameters
    ----------
    solution : Solution
    horizontal : HorizontalAxis, optional
        Time by default.
    coordinates : str
        Names or patterns, separated by commas; ``"*"`` for all. By default those at which muscles and
        reserves matter both; the others are told in sentences.
    width : float [mm]
        Of the figure on the page.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    NameMismatchError
        A pattern fits no coordinate.
    DataError
        The horizontal values are not one per frame.

    Examples
    --------
    >>> figure = scso.plot_moments(solution)
    """
    balance = solution.moment_balance
    look = {"required": REQUIRED, "muscles": SeriesStyle(color=RESULT.color, line="--"), "reserves": MARK}
    values = {"required": balance.required, "muscles": balance.muscles, "reserves": balance.actuators}
    if solution.control.shape[1] == 0:
        del values["reserves"]
    series = [
        table_series(solution, label, balance.coordinates, table, balance.unit, look=look[label])
        for label, table in values.items()
    ]
    panels, notes = folded(series[0], series[1])
    if coordinates:
        panels, notes = chosen("coordinate", coordinates, series), ()
    if "reserves" in values:
        shares = dict(zip(balance.coordinates, map(_percent, balance.actuator_share), strict=True))
        panels = tuple(
            replace(panel, note=f"reserves, RMS: {_by_side(panel.members, shares)}") for panel in panels
        )
    return plot_quantity(
        series, quantity="moment", panels=panels, notes=notes, width=width,
        heading=f"{solution.problem.motion.name}: moment balance", horizontal=horizontal,
    )  # fmt: skip


@checked
def plot_stability(
    solution: Solution,
    *,
    baseline: Solution | None = None,
    horizontal: HorizontalAxis | None = None,
    rows: str = "",
    width: float = TWO_COLUMNS,
) -> Figure:
    """Draw the stability of rows, left and right in one panel; what is below a row's level is shaded.

    Parameters
    ----------
    solution : Solution
        With stability rows.
    baseline : Solution, optional
        Of the same motion; drawn where it kept or observed the same rows, see
        :meth:`~scso_nlp.MuscleForceProblem.without_stability`.
    horizontal : HorizontalAxis, optional
        Time by default.
    rows : str
        Names or patterns, separated by commas; ``"*"`` for all. By default the twelve of least margin.
    width : float [mm]
        Of the figure on the page.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DataError
        No stability rows, or the horizontal values are not one per frame.
    NameMismatchError
        The baseline has other muscles, or a pattern fits no row.

    Examples
    --------
    >>> figure = scso.plot_stability(solution)
    """
    name = solution.problem.motion.name
    own = solution.stability
    if own is None:
        raise DataError(f"the solution of {name!r} has no stability rows, expected a stability constraint")
    label, baseline_label = role_labels(solution, baseline)
    series = [series_of(solution, "stability", label)]
    if baseline is not None:
        _require_same(solution, baseline)
        if baseline.stability is not None and baseline.stability.rows == own.rows:
            series.insert(0, series_of(baseline, "stability", baseline_label))
    return plot_quantity(
        series, quantity="stability", names=rows, width=width, heading=f"{name}: joint stability",
        horizontal=horizontal,
    )  # fmt: skip


def series_of(solution: Solution, quantity: str, label: str) -> Series:
    """Take from a solution what a figure draws.

    Parameters
    ----------
    solution : Solution
    quantity : str
        ``"activation"``, ``"force"`` or ``"stability"``.
    label : str
        For the legend.

    Returns
    -------
    Series

    Raises
    ------
    DataError
        Another quantity, or a solution without stability rows.
    """
    muscles = solution.problem.motion.muscles
    if quantity == "activation":
        return table_series(
            solution, label, muscles.muscles, solution.activation, ("-",), highest=muscles.max_activation
        )
    if quantity == "force":
        return table_series(solution, label, muscles.muscles, solution.tendon_force, ("N",))
    if quantity == "stability" and (margin := solution.stability) is not None:
        return table_series(solution, label, margin.rows, margin.stability, ("N·m/rad",), level=margin.level)
    raise DataError(f"the solution {label!r} has no {quantity}, expected activation, force or stability")


def _of_muscles(
    solution: Solution,
    baseline: Solution | None,
    quantity: str,
    plural: str,
    muscles: str,
    width: float,
    horizontal: HorizontalAxis | None,
) -> Figure:
    both = beside(solution, baseline, partial(series_of, quantity=quantity))
    heading = f"{solution.problem.motion.name}: {plural}{'' if muscles else of_how_many(both)}"
    return plot_quantity(
        both, quantity=quantity, names=muscles, width=width, heading=heading, horizontal=horizontal
    )


def beside(solution: Solution, baseline: Solution | None, take: Callable[..., Series]) -> list[Series]:
    """Take a series of a solution and, before it, one of its baseline; `take` gets the label by name."""
    label, baseline_label = role_labels(solution, baseline)
    found = [take(solution, label=label)]
    if baseline is not None:
        _require_same(solution, baseline)
        found.insert(0, take(baseline, label=baseline_label))
    return found


def table_series(
    solution: Solution,
    label: str,
    names: Sequence[str],
    values: FloatArray,
    units: Sequence[str],
    **more: Any,
) -> Series:
    """Make a series of a table; frames that are not solved are blank.

    Parameters
    ----------
    solution : Solution
    label, names, values, units, **more
        As for :class:`~scso_nlp.figures.Series`; what is `more`, too.

    Returns
    -------
    Series
    """
    trajectory = solution.problem.motion.trajectory
    return Series(
        label=label,
        time=trajectory.time,
        names=tuple(names),
        values=np.where(solution.is_solved[:, np.newaxis], values, np.nan),
        units=tuple(units),
        are_tasks=trajectory.is_at_rest and trajectory.n_frames <= FEW_FRAMES,
        **more,
    )


def _require_same(solution: Solution, baseline: Solution) -> None:
    runs = {"solution": solution, "baseline": baseline}
    require_same_motion({label: run.problem.motion.trajectory for label, run in runs.items()})


def role_labels(solution: Solution, baseline: Solution | None) -> tuple[str, str]:
    """Name both: by the stability rows that only one of them has, otherwise by their roles.

    Parameters
    ----------
    solution : Solution
    baseline : Solution or None

    Returns
    -------
    of the solution, of the baseline : str
    """
    own, other = (
        run is not None and any(term in run.problem.stability_terms for term in run.problem.constraints)
        for run in (solution, baseline)
    )
    if own == other:
        return "solution", "baseline"
    plain, stable = "static optimization", "with stability rows"
    return (stable, plain) if own else (plain, stable)


def _by_side(members: Mapping[str, str], shares: Mapping[str, str]) -> str:
    """Write the share of each side, which no line break parts from its side."""
    words = (f"{side} {shares[name]}".strip() for side, name in members.items())
    return ", ".join(text.replace(" ", "\u00a0") for text in words)


def _percent(share: float) -> str:
    """Two digits are enough for a share; a dash where there is none."""
    if not np.isfinite(share):
        return "-"
    return f"{100 * share:.0f} %" if share >= 0.0995 else f"{100 * share:.1f} %"
