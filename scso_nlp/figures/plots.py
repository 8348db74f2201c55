"""Figures as an attribute of a solution: ``solution.plot.activation()``."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure

from scso_nlp.contributions import row_contributions
from scso_nlp.figures.contributions import plot_contributions
from scso_nlp.figures.frames import HorizontalAxis
from scso_nlp.figures.joint_reactions import plot_joint_reactions
from scso_nlp.figures.solution import plot_activations, plot_forces, plot_moments, plot_stability
from scso_nlp.figures.style import TWO_COLUMNS
from scso_nlp.solution import Solution


@dataclass(frozen=True)
class SolutionPlots:
    """Figures of one solution, each a new :class:`matplotlib.figure.Figure`.

    Attributes
    ----------
    solution : Solution
    """

    solution: Solution

    def activation(
        self,
        *,
        muscles: str = "",
        baseline: Solution | None = None,
        horizontal: HorizontalAxis | None = None,
        width: float = TWO_COLUMNS,
    ) -> Figure:
        """Draw activations, as :func:`~scso_nlp.plot_activations`: ``muscles="gas*,soleus_*"``."""
        return plot_activations(
            self.solution, baseline=baseline, horizontal=horizontal, muscles=muscles, width=width
        )

    def force(
        self,
        *,
        muscles: str = "",
        baseline: Solution | None = None,
        horizontal: HorizontalAxis | None = None,
        width: float = TWO_COLUMNS,
    ) -> Figure:
        """Draw tendon forces; arguments are those of :meth:`activation`."""
        return plot_forces(
            self.solution, baseline=baseline, horizontal=horizontal, muscles=muscles, width=width
        )

    def moments(
        self,
        *,
        coordinates: str = "",
        horizontal: HorizontalAxis | None = None,
        width: float = TWO_COLUMNS,
    ) -> Figure:
        """Draw the moment balance of coordinates, as :func:`~scso_nlp.plot_moments`."""
        return plot_moments(self.solution, horizontal=horizontal, coordinates=coordinates, width=width)

    def stability(
        self,
        *,
        rows: str = "",
        baseline: Solution | None = None,
        horizontal: HorizontalAxis | None = None,
        width: float = TWO_COLUMNS,
    ) -> Figure:
        """Draw the stability of rows, as :func:`~scso_nlp.plot_stability`."""
        return plot_stability(self.solution, baseline=baseline, horizontal=horizontal, rows=rows, width=width)

    def joint_reactions(
        self,
        *,
        joints: str = "",
        baseline: Solution | None = None,
        horizontal: HorizontalAxis | None = None,
        width: float = TWO_COLUMNS,
    ) -> Figure:
        """Draw what joints carry in body weights, as :func:`~scso_nlp.plot_joint_reactions`."""
        return plot_joint_reactions(
            self.solution, baseline=baseline, horizontal=horizontal, joints=joints, width=width
        )

    def contributions(self) -> Figure:
        """Draw what each muscle adds to each stability row, as :func:`~scso_nlp.plot_contributions`."""
        return plot_contributions(row_contributions(self.solution))

    def __repr__(self) -> str:
        kinds = [name for name in dir(self) if not name.startswith("_") and name != "solution"]
        return f"figures of {self.solution.problem.motion.name}: {', '.join(kinds)}"
