"""Tendon forces of one motion under different muscle models, muscle by muscle: numbers and a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError
from scso_nlp.figures.frames import HorizontalAxis, horizontal_axis
from scso_nlp.figures.grid import add_legend, draw_curve, panel_grid
from scso_nlp.figures.style import series_style
from scso_nlp.solution import Solution
from scso_nlp.trajectory import require_same_motion
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


@checked
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
    NameMismatchError
        Other muscles.
    DataError
        Other frames, or no frame that both have solved.

    Examples
    --------
    >>> scso.tendon_force_difference(solution, solution).largest
    array([0., 0., 0.])
    """
    _require_same_motion({"reference": reference, "solution": solution})
    both = solution.is_solved & reference.is_solved
    if not both.any():
        raise DataError("no frame is solved in both solutions, expected at least one")
    difference = (solution.tendon_force - reference.tendon_force)[both]
    return TendonForceDifference(
        muscles=solution.problem.motion.trajectory.muscles,
        largest=np.abs(difference).max(axis=0),
        root_mean_square=np.sqrt((difference**2).mean(axis=0)),
    )


@checked
def plot_tendon_forces(
    solutions: Mapping[str, Solution], *, title: str | None = None, horizontal: HorizontalAxis | None = None
) -> Figure:
    """Draw the tendon force of every muscle over the motion, one panel each and one line per solution.

    Parameters
    ----------
    solutions : mapping of str to Solution
        By what the legend shall call them; the first is the reference of the differences in the panels'
        titles, the largest ones over the motion as a share of maximum isometric force.
    title : str, optional
        Name of the motion by default.
    horizontal : HorizontalAxis, optional
        Time by default.

    Returns
    -------
    matplotlib.figure.Figure
        Frames that are not solved are left blank.

    Raises
    ------
    NameMismatchError
        Solutions with different muscles.
    DataError
        No solution, other frames, no frame that two of them have solved, or horizontal values that are not
        one per frame.

    Examples
    --------
    >>> cubed = replace(problem, objectives=(scso.ActivationEffort(exponent=3.0),))
    >>> figure = scso.plot_tendon_forces({"p = 2": solution, "p = 3": scso.solve_trajectory(cubed)})
    """
    if not solutions:
        raise DataError("no solution to draw, expected at least one")
    _require_same_motion(solutions)
    reference, *others = solutions.values()
    motion = reference.problem.motion
    trajectory, strength = motion.trajectory, motion.muscles.max_isometric_force
    axis = horizontal_axis(trajectory.time, horizontal)
    titles = list(trajectory.muscles)
    if others:
        largest = np.max([tendon_force_difference(other, reference).largest for other in others], axis=0)
        shares = 100 * largest / strength
        titles = [f"{name}\nup to {s:.1f} % of F0 apart" for name, s in zip(titles, shares, strict=True)]
    figure, panels = panel_grid(
        titles,
        heading=f"{title or trajectory.name}: tendon force",
        x_label=axis.label,
        y_label="Tendon force [N]",
        horizontal=axis,
    )
    for m, panel in enumerate(panels):
        for i, (label, solution) in enumerate(solutions.items()):
            force = np.where(solution.is_solved, solution.tendon_force[:, m], np.nan)
            draw_curve(panel, axis.values, force, series_style(i), label=label)
        panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
    add_legend(figure)
    return figure


def _require_same_motion(solutions: Mapping[str, Solution]) -> None:
    require_same_motion({label: solution.problem.motion.trajectory for label, solution in solutions.items()})
