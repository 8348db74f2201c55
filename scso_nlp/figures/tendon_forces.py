"""Tendon forces of one motion under different muscle models, muscle by muscle: numbers and a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from scso_nlp.exceptions import DataError
from scso_nlp.figures import style
from scso_nlp.solution import Solution
from scso_nlp.validation import FloatArray


@dataclass(frozen=True, kw_only=True)
class TendonForceDifference:
    """How far the tendon forces of one solution are from another's.

    Attributes
    ----------
    muscles : tuple of str
    largest : ndarray, shape (n_muscles,) [N]
        Largest absolute difference over the frames that both have solved.
    root_mean_square : ndarray, shape (n_muscles,) [N]
        Over the same frames.
    """

    muscles: tuple[str, ...]
    largest: FloatArray
    root_mean_square: FloatArray


def tendon_force_difference(solution: Solution, reference: Solution) -> TendonForceDifference:
    """Compare the tendon forces of two solutions of one motion.

    Parameters
    ----------
    solution, reference : Solution

    Returns
    -------
    TendonForceDifference

    Raises
    ------
    DataError
        Other muscles or frames, or no frame that both have solved.
    """
    _same_motion({"solution": solution, "reference": reference})
    both = solution.is_solved & reference.is_solved
    if not both.any():
        raise DataError("no frame is solved in both solutions, expected at least one")
    difference = (solution.tendon_force - reference.tendon_force)[both]
    return TendonForceDifference(
        muscles=solution.problem.trajectory.muscles,
        largest=np.abs(difference).max(axis=0),
        root_mean_square=np.sqrt((difference**2).mean(axis=0)),
    )


def plot_tendon_forces(solutions: Mapping[str, Solution], *, title: str | None = None) -> Figure:
    """Draw the tendon force of every muscle over the motion, one panel each and one line per solution.

    Parameters
    ----------
    solutions : mapping of str to Solution
        By what the legend shall call them; the first is the reference of the differences in the panels'
        titles, the largest ones over the motion as a share of maximum isometric force.
    title : str, optional
        Name of the motion by default.

    Returns
    -------
    matplotlib.figure.Figure
        Frames that are not solved are left blank.

    Raises
    ------
    DataError
        No solution, or solutions of different motions.
    """
    if not solutions:
        raise DataError("no solution to draw, expected at least one")
    _same_motion(solutions)
    reference, *others = solutions.values()
    trajectory, strength = reference.problem.trajectory, reference.problem.muscles.max_isometric_force
    figure, panels = style.panel_grid(
        len(trajectory.muscles), title=f"{title or trajectory.name}: tendon force", share_y=False
    )
    time = trajectory.time - trajectory.time[0]
    differences = [tendon_force_difference(other, reference) for other in others]
    for m, (name, panel) in enumerate(zip(trajectory.muscles, panels, strict=True)):
        for i, (label, solution) in enumerate(solutions.items()):
            look = style.series_style(i)
            force = np.where(solution.is_solved, solution.tendon_force[:, m], np.nan)
            panel.plot(time, force, look.line, color=look.color, linewidth=1.4, label=label)
        shares = [100 * d.largest[m] / strength[m] for d in differences]
        apart = f"  (up to {max(shares):.1f} % of F0 apart)" if shares else ""
        panel.set_title(f"{name}{apart}", loc="left", fontsize=style.TEXT, pad=3)
        panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
        panel.set_xlim(0.0, float(time[-1]) if len(time) > 1 else None)
    style.label_figure(figure, panels, "Time [s]", "Tendon force [N]")
    return figure


def _same_motion(solutions: Mapping[str, Solution]) -> None:
    (first, reference), *others = solutions.items()
    expected = reference.problem.trajectory
    for label, solution in others:
        found = solution.problem.trajectory
        if found.muscles != expected.muscles or not np.array_equal(found.time, expected.time):
            raise DataError(f"{label} and {first} have other muscles or frames, expected one motion")
