"""Figures as an attribute of a solution: ``solution.plot.activation()``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict, Unpack

from matplotlib.figure import Figure

from scso_nlp.contributions import row_contributions
from scso_nlp.figures.contributions import plot_contributions
from scso_nlp.figures.frames import HorizontalAxis
from scso_nlp.figures.joint_reactions import plot_joint_reactions
from scso_nlp.figures.solution import plot_activations, plot_forces, plot_moments, plot_stability
from scso_nlp.solution import Solution


class DrawnAlone(TypedDict, total=False):
    """How any figure of a solution can be drawn: `horizontal` axis, and `width` on the page [mm]."""

    horizontal: HorizontalAxis | None
    width: float


class Drawn(DrawnAlone, total=False):
    """The same, with a `baseline` of the same motion behind."""

    baseline: Solution | None


@dataclass(frozen=True)
class SolutionPlots:
    """Figures of one solution, each a new :class:`matplotlib.figure.Figure`.

    Methods take, besides names or patterns of what is shown, all keywords of the function that they name:
    `baseline`, `horizontal` and `width`.

    Attributes
    ----------
    solution : Solution
    """

    solution: Solution

    def activation(self, *, muscles: str = "", **drawn: Unpack[Drawn]) -> Figure:
        """Draw activations, as :func:`~scso_nlp.plot_activations`: ``muscles="gas*,soleus_*"``."""
        return plot_activations(self.solution, muscles=muscles, **drawn)

    def force(self, *, muscles: str = "", **drawn: Unpack[Drawn]) -> Figure:
        """Draw tendon forces, as :func:`~scso_nlp.plot_forces`."""
        return plot_forces(self.solution, muscles=muscles, **drawn)

    def moments(self, *, coordinates: str = "", **drawn: Unpack[DrawnAlone]) -> Figure:
        """Draw the moment balance of coordinates, as :func:`~scso_nlp.plot_moments`."""
        return plot_moments(self.solution, coordinates=coordinates, **drawn)

    def stability(self, *, rows: str = "", **drawn: Unpack[Drawn]) -> Figure:
        """Draw the stability of rows, as :func:`~scso_nlp.plot_stability`."""
        return plot_stability(self.solution, rows=rows, **drawn)

    def joint_reactions(self, *, joints: str = "", **drawn: Unpack[Drawn]) -> Figure:
        """Draw what joints carry in body weights, as :func:`~scso_nlp.plot_joint_reactions`."""
        return plot_joint_reactions(self.solution, joints=joints, **drawn)

    def contributions(self) -> Figure:
        """Draw what each muscle adds to each stability row, as :func:`~scso_nlp.plot_contributions`."""
        return plot_contributions(row_contributions(self.solution))

    def __repr__(self) -> str:
        kinds = [name for name in dir(self) if not name.startswith("_") and name != "solution"]
        return f"figures of {self.solution.problem.motion.name}: {', '.join(kinds)}"
