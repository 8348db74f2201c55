"""What joints carry, in body weights."""

from __future__ import annotations

from matplotlib.figure import Figure

from scso_nlp.arguments import checked
from scso_nlp.figures.frames import HorizontalAxis
from scso_nlp.figures.quantity import plot_quantity
from scso_nlp.figures.series import Series
from scso_nlp.figures.solution import beside, table_series
from scso_nlp.figures.style import TWO_COLUMNS
from scso_nlp.solution import Solution


@checked
def plot_joint_reactions(
    solution: Solution,
    *,
    baseline: Solution | None = None,
    horizontal: HorizontalAxis | None = None,
    joints: str = "",
    width: float = TWO_COLUMNS,
) -> Figure:
    """Draw the length of joint forces in body weights, left and right in one panel.

    Parameters
    ----------
    solution : Solution
    baseline : Solution, optional
        Of the same motion, usually without stability rows; drawn behind.
    horizontal : HorizontalAxis, optional
        Time by default.
    joints : str
        Names or patterns, separated by commas; ``"*"`` for all. By default the twelve that tell most.
    width : float [mm]
        Of the figure on the page.

    Returns
    -------
    matplotlib.figure.Figure
        Frames that are not solved are left blank and shaded.

    Raises
    ------
    ProblemError
        The motion was read without joint reactions.
    NameMismatchError
        The baseline has other muscles, or a pattern fits no joint.
    DataError
        The baseline has other frames, or the horizontal values are not one per frame.

    Examples
    --------
    >>> elbow = scso.load_motion(example_folder("elbow") / "setup.xml", joint_reactions="all")
    >>> carried = scso.solve_trajectory(scso.static_optimization(elbow))
    >>> figure = scso.plot_joint_reactions(carried)
    """
    return plot_quantity(
        beside(solution, baseline, _series), quantity="reaction", names=joints, width=width,
        heading=f"{solution.problem.motion.name}: joint reactions", horizontal=horizontal,
    )  # fmt: skip


def _series(solution: Solution, label: str) -> Series:
    found = solution.joint_reactions()
    forces = found.resultant / found.body_weight
    return table_series(solution, label, found.joints, forces, ("BW",))
