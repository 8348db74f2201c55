"""The left knee of a person with an instrumented implant: computed contact forces beside the measured one.

Run ``python -m problems.implant_figures [folder] [every n-th frame]`` from the project's root. It prints the
table and writes it with a figure. The data are fetched on first use, see :mod:`problems.fetch`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from problems.knee_implant import problem as knee_implant
from problems.outputs import markdown_table
from scso_nlp import JointReactionEffort, MuscleForceProblem, Solution, solve_framewise
from scso_nlp.exceptions import DataError
from scso_nlp.figures import HorizontalAxis, save_figure
from scso_nlp.figures.grid import add_legend, draw_curve, panel_grid
from scso_nlp.figures.style import REQUIRED, series_style
from scso_nlp.joint_reactions import required
from scso_nlp.validation import FloatArray

#: Weight of the knee's squared force in body weights, where that is a cost [-].
KNEE_WEIGHT = 1.0
#: Every per cent of the cycle.
CYCLE = np.linspace(0.0, 100.0, 101)


@dataclass(frozen=True, kw_only=True)
class Knee:
    """One trial.

    Attributes
    ----------
    trial : str
    measured : ndarray, shape (101,) [N]
    solutions : mapping of str to Solution
        By method.
    """

    trial: str
    measured: FloatArray
    solutions: Mapping[str, Solution]

    @property
    def body_weight(self) -> float:
        """Of the model [N]."""
        solution = next(iter(self.solutions.values()))
        return required(solution.problem.motion.trajectory.joint_reactions).body_weight

    def error(self, method: str) -> float:
        """Root mean square difference over the cycle [N]."""
        apart = knee_implant.contact_force(self.solutions[method]) - self.measured
        return float(np.sqrt(np.nanmean(apart**2)))


def methods(trial: str, step_interval: int = 1) -> dict[str, MuscleForceProblem]:
    """Describe a trial as static optimization, with stability rows, and with the knee's load as a cost.

    Parameters
    ----------
    trial : str
    step_interval : int

    Returns
    -------
    dict of str to MuscleForceProblem
    """
    stable = knee_implant.make_problem(trial, step_interval=step_interval)
    plain = stable.without_stability()
    load = JointReactionEffort(joints=(knee_implant.KNEE,), weight=KNEE_WEIGHT)
    return {
        "SO": plain,
        "SCSO q = 40": stable,
        "SO, knee force as a cost": replace(plain, objectives=(*plain.objectives, load)),
    }


def solve(trial: str, step_interval: int = 1) -> Knee:
    """Solve a trial by all methods.

    Parameters
    ----------
    trial : str
    step_interval : int

    Returns
    -------
    Knee
    """
    solutions = {
        method: solve_framewise(problem, on_failure="return")
        for method, problem in methods(trial, step_interval).items()
    }
    return Knee(trial=trial, measured=knee_implant.measured_force(trial), solutions=solutions)


def table(knees: list[Knee]) -> str:
    """Lay out peaks and differences from the measured force.

    Parameters
    ----------
    knees : list of Knee

    Returns
    -------
    str
        Markdown.
    """
    rows: list[tuple[object, ...]] = []
    for knee in knees:
        weight = knee.body_weight
        forces = {method: knee_implant.contact_force(found) for method, found in knee.solutions.items()}
        for method, force in {"measured": knee.measured, **forces}.items():
            peak, at = np.nanmax(force), CYCLE[np.nanargmax(force)]
            row = (knee.trial, method, f"{peak:.0f}, {peak / weight:.2f}", f"{at:.0f}")
            if method == "measured":
                rows.append((*row, "", "", ""))
                continue
            solution = knee.solutions[method]
            rows.append(
                (
                    *row,
                    f"{knee.error(method):.0f}, {knee.error(method) / weight:.2f}",
                    f"{np.nanmean(force - knee.measured):+.0f}",
                    f"{int(solution.is_solved.sum())} of {len(solution.is_solved)}",
                )
            )
    heads = ("trial", "method", "peak [N], [BW]", "at [%]", "RMSE [N], [BW]", "mean difference [N]", "solved")
    return markdown_table(heads, rows)


def draw(knees: list[Knee]) -> Figure:
    """Draw the forces over the cycle in body weights, one panel per trial.

    Parameters
    ----------
    knees : list of Knee

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, panels = panel_grid(
        [knee.trial for knee in knees],
        heading="Force between femur and tibia, left knee",
        x_label="Gait cycle [%]",
        y_label="Force [BW]",
        horizontal=HorizontalAxis(values=CYCLE, label=""),
    )
    for knee, panel in zip(knees, panels, strict=True):
        draw_curve(panel, CYCLE, knee.measured / knee.body_weight, REQUIRED, label="measured")
        for position, (method, solution) in enumerate(knee.solutions.items()):
            force = knee_implant.contact_force(solution) / knee.body_weight
            draw_curve(panel, CYCLE, force, series_style(position), label=method)
        panel.set_ylim(bottom=0)
    add_legend(figure)
    return figure


def main(arguments: list[str]) -> None:
    """Solve all trials, print the table, and write it with the figure.

    Parameters
    ----------
    arguments : list of str
        Folder and interval, as on the command line.
    """
    folder = Path(arguments[0]) if arguments else Path("results") / "knee_implant"
    every = int(arguments[1]) if len(arguments) > 1 else 1
    try:
        knees = [solve(trial, every) for trial in knee_implant.TRIALS]
    except DataError as error:
        sys.exit(f"error: {error}")
    text = table(knees)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "README.md").write_text(f"# knee_implant\n\n{text}", encoding="utf-8")
    save_figure(draw(knees), folder, "contact_force")
    sys.stdout.write(f"{text}\nfigure and table in {folder}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
