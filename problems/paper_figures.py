"""The two simulations of Akhavanfar et al. (2019) beside what the paper prints, with figures.

Run ``python -m problems.paper_figures [folder]`` from the project's root; it needs no download. The geometry
is a reconstruction that was fitted to the paper's findings, so that agreement validates nothing. What is
worth reading are the disagreements and the sensitivity to q.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from problems.fetch import motion_cache
from problems.outputs import markdown_table, write_table
from problems.spine_load_height.problem import TASKS as LOAD_TASKS
from problems.spine_load_height.problem import make_problem as load_height
from problems.spine_postures.problem import TASKS as POSTURES
from problems.spine_postures.problem import make_problem as postures
from scso_nlp import JointStability, MuscleForceProblem, Solution, solve_framewise
from scso_nlp.contributions import row_contributions
from scso_nlp.emg import Comparison, EmgMap, MotionResult, MuscleGroup, compare, result_of
from scso_nlp.emg.metrics import activity_ratio
from scso_nlp.examples import example_folder
from scso_nlp.figures import (
    HorizontalAxis,
    plot_contributions,
    plot_muscle_lines,
    plot_sweep,
    plot_task_bars,
    save_figure,
)
from scso_nlp.figures.grid import add_legend, draw_curve, panel_grid
from scso_nlp.figures.style import LEAST_TEXT, QUIET, series_style
from scso_nlp.opensim.engine import load_motion
from scso_nlp.stability.hessian import hessian_terms
from scso_nlp.validation import FloatArray

#: Stiffness gains of the paper, by name of the method.
METHODS = {"SO": None, "SCSO q = 5": 5.0, "SCSO q = 3": 3.0}
#: Gains of the sweep [-]; the paper names 0.5 to 42 as the range in the literature.
SWEEP = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 13.0, 17.0, 25.0, 42.0)
#: Price of missing stability where a task has no answer with hard rows [objective per N·m/rad].
SOFT = 1.0
#: Muscle groups of the spine model, by the start of their muscles' names.
GROUPS = ("ES", "RA", "EO", "IO")
#: Mean absolute difference from EMG in the paper [% of maximum], Akhavanfar et al. (2019), Table 2:
#: SO, q = 5, q = 3 by tasks and group.
PAPER_DIFFERENCE = {
    ("symmetric", "ES"): (17.2, 13.0, 6.1),
    ("symmetric", "RA"): (3.7, 3.5, 2.6),
    ("symmetric", "EO"): (8.7, 4.3, 1.1),
    ("symmetric", "IO"): (8.4, 9.5, 10.2),
    ("asymmetric, right side", "ES"): (13.6, 10.9, 9.1),
    ("asymmetric, right side", "RA"): (3.8, 4.6, 9.8),
    ("asymmetric, right side", "EO"): (14.6, 5.9, 6.1),
    ("asymmetric, right side", "IO"): (9.0, 5.4, 2.2),
    ("asymmetric, left side", "ES"): (22.3, 15.7, 7.3),
    ("asymmetric, left side", "RA"): (3.9, 2.1, 12.7),
    ("asymmetric, left side", "EO"): (4.8, 4.8, 4.8),
    ("asymmetric, left side", "IO"): (15.8, 9.7, 17.4),
}
#: How often the groups of tasks count in the table's overall means: symmetric tasks have two equal sides.
TASK_WEIGHTS = {"symmetric": 2, "asymmetric, right side": 1, "asymmetric, left side": 1}
#: Overall means of the table [% of maximum]: SO, q = 5, q = 3.
PAPER_MEANS = (10.2, 7.5, 6.8)
#: Root mean squared difference of the abdominal over back ratio from EMG [-] in the paper's simulation 2, by
#: mass of the load [kg]: SO, q = 5. Same source.
PAPER_RATIO = {4.5: (0.30, 0.03), 9.0: (0.26, 0.03)}
#: The paper: above this gain SCSO equals SO in simulation 2 [-].
PAPER_CRITICAL_GAIN = 13.0
#: Both numbers of the paper that are compared are rounded to one digit behind the point [%].
ROUNDING = 2 * 0.05
_SIDES = {
    "symmetric": (slice(0, 4), ("_R", "_L")),
    "asymmetric, right side": (slice(4, 8), ("_R",)),
    "asymmetric, left side": (slice(4, 8), ("_L",)),
}


@dataclass(frozen=True, kw_only=True)
class Tasks:
    """One simulation, solved by every method.

    Attributes
    ----------
    name : str
    example : str
        The embedded example behind it.
    tasks : tuple of str
        One per frame.
    problem : MuscleForceProblem
        With stability rows.
    solutions : mapping of str to Solution
        By method.
    """

    name: str
    example: str
    tasks: tuple[str, ...]
    problem: MuscleForceProblem
    solutions: Mapping[str, Solution]

    def group(self, method: str, start: str, sides: Sequence[str] = ("_R", "_L")) -> FloatArray:
        """Mean activation of a group on the sides named, shape (n_tasks, n_sides) [%]."""
        muscles = self.problem.motion.trajectory.muscles
        columns = [
            [m for m, name in enumerate(muscles) if name.startswith(start) and name.endswith(side)]
            for side in sides
        ]
        activation = self.solutions[method].activation
        return 100 * np.column_stack([activation[:, chosen].mean(axis=1) for chosen in columns])


def solve_simulations() -> tuple[Tasks, Tasks]:
    """Solve both simulations by static optimization and with the paper's two gains.

    Returns
    -------
    postures, load_height : Tasks
    """
    return (
        _solve("simulation 1: postures", "spine-postures", POSTURES, postures()),
        _solve("simulation 2: height of a load", "spine-load-height", LOAD_TASKS, load_height()),
    )


def with_gain(problem: MuscleForceProblem, q: float | None, soft: float | None = None) -> MuscleForceProblem:
    """Give the stability rows another gain, or take them away.

    Parameters
    ----------
    problem : MuscleForceProblem
    q : float or None [-]
        None: no stability rows.
    soft : float, optional [objective per N·m/rad]

    Returns
    -------
    MuscleForceProblem
    """
    if q is None:
        return problem.without_stability()
    terms = tuple(
        replace(term, q=q, soft=soft) if isinstance(term, JointStability) else term
        for term in problem.constraints
    )
    return replace(problem, constraints=terms)


def _solve(name: str, example: str, tasks: tuple[str, ...], problem: MuscleForceProblem) -> Tasks:
    solutions = {method: solve_framewise(with_gain(problem, q)) for method, q in METHODS.items()}
    return Tasks(name=name, example=example, tasks=tasks, problem=problem, solutions=solutions)


@dataclass(frozen=True, kw_only=True)
class DifferenceRow:
    """What our activations allow the difference from the paper's EMG to be, for one group of tasks.

    Attributes
    ----------
    tasks, group, method : str
    change : float [%]
        Mean absolute change of activation from SO, here.
    low, high : float [%]
        The difference from EMG cannot be outside, whatever the EMG was.
    paper : float [%]
    """

    tasks: str
    group: str
    method: str
    change: float
    low: float
    high: float
    paper: float

    @property
    def is_possible(self) -> bool:
        """Tell if the paper's number could have come from activations like ours."""
        return self.low - ROUNDING <= self.paper <= self.high + ROUNDING


def difference_rows(simulation: Tasks) -> tuple[DifferenceRow, ...]:
    r"""Bound the mean absolute difference from EMG that cannot be computed without the EMG.

    With the paper's difference E of SO and the mean absolute change D from SO to SCSO, the triangle
    inequality leaves :math:`|E - D|` to :math:`E + D`. It needs that SO is the same here and there: true for
    RA and EO, which SO silences in both; unknown for ES and IO.

    Parameters
    ----------
    simulation : Tasks
        The postures.

    Returns
    -------
    tuple of DifferenceRow
    """
    rows = []
    for (tasks, group), paper in PAPER_DIFFERENCE.items():
        frames, sides = _SIDES[tasks]
        plain = simulation.group("SO", group, sides)[frames]
        for method, printed in zip(("SCSO q = 5", "SCSO q = 3"), paper[1:], strict=True):
            change = float(np.abs(simulation.group(method, group, sides)[frames] - plain).mean())
            rows.append(
                DifferenceRow(
                    tasks=tasks,
                    group=group,
                    method=method,
                    change=change,
                    low=abs(paper[0] - change),
                    high=paper[0] + change,
                    paper=printed,
                )
            )
    return tuple(rows)


def ratios(simulation: Tasks, method: str) -> FloatArray:
    """Mean abdominal over mean back activation of every task, shape (n_tasks,) [-].

    Parameters
    ----------
    simulation : Tasks
    method : str

    Returns
    -------
    ndarray
    """
    abdomen = np.mean([simulation.group(method, group) for group in ("RA", "EO", "IO")], axis=(0, 2))
    back = simulation.group(method, "ES").mean(axis=1)
    return np.array([activity_ratio(a[None], b[None]) for a, b in zip(abdomen, back, strict=True)])


@dataclass(frozen=True, kw_only=True)
class SweepPoint:
    """One gain of the sweep.

    Attributes
    ----------
    q : float [-]
    activation : ndarray, shape (n_tasks, n_muscles) [-]
    missed : ndarray, shape (n_tasks,) [N·m/rad]
        Stability that is missing in all rows together; 0 where the rows are kept.
    objective : ndarray, shape (n_tasks,) [-]
        Sum of squared activations.
    """

    q: float
    activation: FloatArray
    missed: FloatArray
    objective: FloatArray


def sweep(problem: MuscleForceProblem, gains: Sequence[float] = SWEEP) -> tuple[SweepPoint, ...]:
    """Solve for many gains, with soft rows in the tasks that have no answer with hard ones.

    Parameters
    ----------
    problem : MuscleForceProblem
    gains : sequence of float [-]

    Returns
    -------
    tuple of SweepPoint
    """
    points = []
    for q in gains:
        solution = solve_framewise(with_gain(problem, q), on_failure="return")
        activation, missed = solution.activation.copy(), np.zeros(len(solution.activation))
        failed = np.flatnonzero(~solution.is_solved)
        if failed.size:
            soft = solve_framewise(with_gain(problem.frames(failed.tolist()), q, SOFT))
            activation[failed] = soft.activation
            missed[failed] = soft.variables["JointStability.missed"].sum(axis=1)
        effort = (activation**2).sum(axis=1)
        points.append(SweepPoint(q=q, activation=activation, missed=missed, objective=effort))
    return tuple(points)


def critical_gain(problem: MuscleForceProblem, low: float = 0.5, high: float = 42.0) -> float:
    """Find the gain above which the stability rows change no task.

    The rows of plain static optimization become less violated as q grows, so the least q that keeps them all
    is found from the rows alone.

    Parameters
    ----------
    problem : MuscleForceProblem
    low, high : float [-]
        Where to look.

    Returns
    -------
    float [-]
        To 1e-6.
    """
    force = solve_framewise(problem.without_stability()).tendon_force
    term = next(term for term in problem.constraints if isinstance(term, JointStability))
    rows = term.stability_rows(problem.motion)
    stiffness = np.einsum("krm,km->kr", rows.moment_arms**2, force / rows.path_length)
    missing = rows.external_work - np.einsum("krm,km->kr", rows.curvature, force)
    needed = np.divide(missing, stiffness, out=np.full_like(missing, -np.inf), where=stiffness > 0)
    return float(np.clip(needed.max(), low, high))


def smallest_eigenvalues(simulation: Tasks) -> dict[str, FloatArray]:
    """Find the smallest eigenvalue of the full Hessian of every task.

    Parameters
    ----------
    simulation : Tasks

    Returns
    -------
    dict of str to ndarray, shape (n_tasks,) [N·m/rad]
        By method; SO with the stiffness of q = 5.
    """
    setup = example_folder(simulation.example) / "setup.xml"
    trajectory = load_motion(setup, curvature_coordinates="all", cache=motion_cache()).trajectory
    terms = hessian_terms(trajectory)
    found = {}
    for method, q in METHODS.items():
        force = simulation.solutions[method].tendon_force
        stiffness = (q or 5.0) * force / terms.path_length
        found[method] = np.linalg.eigvalsh(terms.hessian(force, stiffness))[:, 0]
    return found


def write_paper_figures(folder: Path) -> None:
    """Solve everything and write figures, tables and ``README.md``.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    bent, lifted = solve_simulations()
    differences = difference_rows(bent)
    sweeps = {simulation.name: sweep(simulation.problem) for simulation in (bent, lifted)}
    eigenvalues = {simulation.name: smallest_eigenvalues(simulation) for simulation in (bent, lifted)}
    _write_tables(folder, (bent, lifted), differences, sweeps, eigenvalues)
    figures = {
        "figure_3_symmetric": task_figure(bent, "symmetric"),
        "figure_4_asymmetric_right": task_figure(bent, "asymmetric, right side"),
        "figure_5_asymmetric_left": task_figure(bent, "asymmetric, left side"),
        "figure_6_load_height": height_figure(lifted),
        "sweep_simulation_1": _sweep_figure(bent, sweeps[bent.name]),
        "sweep_simulation_2": _sweep_figure(lifted, sweeps[lifted.name]),
        "muscle_lines": _lines(lifted),
        "which_muscle_stabilizes": plot_contributions(row_contributions(lifted.solutions["SCSO q = 5"])),
    }
    for name, figure in figures.items():
        save_figure(figure, folder, name)
    text = _summary(bent, lifted, differences, sweeps, eigenvalues)
    (folder / "README.md").write_text(text, encoding="utf-8")


def _write_tables(
    folder: Path,
    simulations: Sequence[Tasks],
    differences: Sequence[DifferenceRow],
    sweeps: Mapping[str, Sequence[SweepPoint]],
    eigenvalues: Mapping[str, Mapping[str, FloatArray]],
) -> None:
    activations = [
        (simulation.name, task, method, muscle, float(value))
        for simulation in simulations
        for method, solution in simulation.solutions.items()
        for task, values in zip(simulation.tasks, solution.activation, strict=True)
        for muscle, value in zip(simulation.problem.motion.trajectory.muscles, values, strict=True)
    ]
    header = ("simulation", "task", "method", "muscle", "activation [-]")
    write_table(folder / "activations.csv", header, activations)
    header = ("tasks", "group", "method", "change from SO here [%]", "least difference [%]",
              "largest difference [%]", "the paper's difference [%]", "possible")  # fmt: skip
    rows = [
        (r.tasks, r.group, r.method, r.change, r.low, r.high, r.paper, r.is_possible) for r in differences
    ]
    write_table(folder / "differences.csv", header, rows)
    header = ("simulation", "task", "q [-]", "sum of squared activations [-]", "missed stability [N·m/rad]")
    points = [
        (simulation.name, task, point.q, float(point.objective[k]), float(point.missed[k]))
        for simulation in simulations
        for point in sweeps[simulation.name]
        for k, task in enumerate(simulation.tasks)
    ]
    write_table(folder / "sweep.csv", header, points)
    header = ("simulation", "task", "method", "smallest eigenvalue [N·m/rad]")
    smallest = [
        (simulation.name, task, method, float(value))
        for simulation in simulations
        for method, values in eigenvalues[simulation.name].items()
        for task, value in zip(simulation.tasks, values, strict=True)
    ]
    write_table(folder / "eigenvalues.csv", header, smallest)


def _groups(sides: Sequence[str]) -> EmgMap:
    """Muscle groups of the model, without EMG."""
    return EmgMap(
        groups=tuple(
            MuscleGroup(name=group, muscles=tuple(f"{group}*{side}" for side in sides)) for group in GROUPS
        )
    )


def _comparison(simulation: Tasks, tasks: str) -> Comparison:
    frames, sides = _SIDES[tasks]
    results = []
    for method, solution in simulation.solutions.items():
        whole = result_of(solution, method)
        results.append(
            MotionResult(
                label=method,
                name=f"Simulation 1, {tasks}",
                time=whole.time[frames],
                muscles=whole.muscles,
                activation=whole.activation[frames],
                is_solved=whole.is_solved[frames],
            )
        )
    return compare(results, emg_map=_groups(sides), n_resamples=0)


def task_figure(simulation: Tasks, tasks: str) -> Figure:
    """Draw activation per task and group, with the mean EMG that the paper's numbers imply.

    Parameters
    ----------
    simulation : Tasks
        The postures.
    tasks : str
        ``"symmetric"``, ``"asymmetric, right side"`` or ``"asymmetric, left side"``.

    Returns
    -------
    matplotlib.figure.Figure
    """
    frames, _ = _SIDES[tasks]
    figure = plot_task_bars(
        _comparison(simulation, tasks),
        [name.split()[0] for name in simulation.tasks[frames]],
        x_label="Flexion" + ("" if tasks == "symmetric" else ", with 10° of twist to the left"),
    )
    for panel, group in zip(figure.axes, GROUPS, strict=True):
        if group in ("RA", "EO"):
            implied = PAPER_DIFFERENCE[tasks, group][0] / 100
            panel.axhline(implied, color=QUIET, linewidth=1.2, linestyle=(0, (1, 1)))
            panel.annotate(
                "mean EMG, implied", (0.98, implied), xycoords=("axes fraction", "data"), xytext=(0, 2),
                textcoords="offset points", ha="right", fontsize=LEAST_TEXT, color=QUIET,
                bbox={"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 0.5},
            )  # fmt: skip
    return figure


def height_figure(simulation: Tasks) -> Figure:
    """Draw mean abdominal and back activation and their ratio over the height of the load.

    Parameters
    ----------
    simulation : Tasks
        Simulation 2.

    Returns
    -------
    matplotlib.figure.Figure
    """
    heights = np.array([float(task.split()[0]) for task in simulation.tasks[:5]])
    titles = ("abdomen [%]", "back [%]", "abdomen / back [-]")
    figure, panels = panel_grid(
        [f"{what}, {mass:g} kg" for mass in PAPER_RATIO for what in titles],
        heading="Simulation 2: height of a load",
        x_label="Height of the load above the lower joint [m]",
        y_label="Mean activation",
        horizontal=HorizontalAxis(values=heights, label=""),
    )
    for row in range(len(PAPER_RATIO)):
        frames = slice(5 * row, 5 * row + 5)
        for position, method in enumerate(simulation.solutions):
            abdomen = np.mean([simulation.group(method, g) for g in ("RA", "EO", "IO")], axis=(0, 2))
            back = simulation.group(method, "ES").mean(axis=1)
            for panel, values in zip(
                panels[3 * row : 3 * row + 3], (abdomen, back, ratios(simulation, method)), strict=True
            ):
                draw_curve(panel, heights, values[frames], series_style(position), label=method)
    for panel in panels:
        panel.set_ylim(bottom=0)
    add_legend(figure)
    return figure


def _sweep_figure(simulation: Tasks, points: Sequence[SweepPoint]) -> Figure:
    muscles, time = simulation.problem.motion.trajectory.muscles, simulation.problem.motion.trajectory.time
    activations = {"SO": simulation.solutions["SO"].activation}
    activations |= {f"q = {point.q:g}": point.activation for point in points}
    results = [
        MotionResult(
            label=label,
            name=simulation.name,
            time=time,
            muscles=muscles,
            activation=activation,
            is_solved=np.ones(len(time), dtype=bool),
        )
        for label, activation in activations.items()
    ]
    return plot_sweep(
        compare(results, emg_map=_groups(("",)), n_resamples=0),
        [point.q for point in points],
        reference="SO",
        infeasible=[bool(point.missed.any()) for point in points],
    )


def _lines(simulation: Tasks) -> Figure:
    skeleton = simulation.problem.motion.trajectory.skeleton
    assert skeleton is not None  # OpenSim's engine gives one
    frames = (0, 2, 4)
    return plot_muscle_lines(
        skeleton,
        simulation.solutions["SCSO q = 5"].activation,
        frames,
        titles=[simulation.tasks[k] for k in frames],
    )


def _summary(
    bent: Tasks,
    lifted: Tasks,
    differences: Sequence[DifferenceRow],
    sweeps: Mapping[str, Sequence[SweepPoint]],
    eigenvalues: Mapping[str, Mapping[str, FloatArray]],
) -> str:
    possible = {
        kind: sum(row.is_possible for row in differences if row.group in groups)
        for kind, groups in (("silent", ("RA", "EO")), ("active", ("ES", "IO")))
    }
    overall = [_overall(differences, method) for method in ("SCSO q = 5", "SCSO q = 3")]
    printed = [
        (
            row.tasks,
            row.group,
            row.method,
            f"{row.change:.1f}",
            f"{row.low:.1f} to {row.high:.1f}",
            f"{row.paper:.1f}",
            "yes" if row.is_possible else "**no**",
        )
        for row in differences
    ]
    header = ("tasks", "group", "method", "change from SO", "difference can be", "in the paper", "possible")
    table = markdown_table(header, printed)
    missing = "\n".join(
        f"- {name}: "
        + ", ".join(f"{p.q:g} ({int((p.missed > 0).sum())} tasks)" for p in points if p.missed.any())
        for name, points in sweeps.items()
    )
    values = [v for by_method in eigenvalues.values() for v in by_method.values()]
    negative, n_values = sum(int((v < 0).sum()) for v in values), sum(v.size for v in values)
    lowest = min(
        float(v.min())
        for by_method in eigenvalues.values()
        for method, v in by_method.items()
        if method != "SO"
    )
    critical = critical_gain(lifted.problem)
    (light, _), (heavy, _) = PAPER_RATIO.values()
    least_light, least_heavy = (_least_ratio_error(lifted, mass) for mass in PAPER_RATIO)
    return f"""# The paper's two simulations on the reconstructed spine

Akhavanfar, Brandon, Brown and Graham (2019), J Biomech, doi 10.1016/j.jbiomech.2019.05.007. Its attachment
table (Granata and Wilson 2001) is not public. Attachment points and strengths used here are a
reconstruction that was searched so that the signs and outcomes the paper prints hold. **Where the
numbers agree, that is by construction.**

## Mean absolute difference from EMG (the paper's Table 2)

The paper's EMG is not public, so this difference cannot be computed. It can be bounded: with the paper's
difference E of SO and the mean absolute change D of our activations from SO to SCSO, the difference of
SCSO lies between |E - D| and E + D, whatever the EMG was. For RA and EO this needs nothing else, because
SO silences both in the paper and here (so E is their mean EMG). For ES and IO it supposes that the
paper's SO was ours, so a "no" may as well mean that it was not. All in % of the maximum.

{table}
{possible["silent"]} of 12 of the paper's numbers for RA and EO, and {possible["active"]} of 12 for ES and IO,
could have come from activations like these; the others cannot. Over all muscles and tasks the difference can
be {overall[0]} with q = 5 (the paper: {PAPER_MEANS[1]}) and {overall[1]} with q = 3 (the paper:
{PAPER_MEANS[2]}); SO has {PAPER_MEANS[0]}.

## Simulation 2

{_load_height_table(lifted)}
SO does not change with height, because the net moments do not. The stable answers rise with height. The
rows change nothing above q = {critical:.2f} (the paper: above {PAPER_CRITICAL_GAIN:g}); that was a target of
the reconstruction. The paper's errors of the ratio (SO {light:.2f} and {heavy:.2f}, q = 5 0.03 and 0.03) need
the EMG. If the paper's SO had our ratio, our q = 5 could not come nearer to its EMG than
{least_light:.2f} (4.5 kg) and {least_heavy:.2f} (9 kg): the ratio is **not** reproduced.

## Sensitivity to q, 0.5 to 42

Soft rows (price {SOFT:g} per N·m/rad) stand in where a task has no answer with hard rows; `sweep.csv` has
what is missed. Those points are hollow in the figures and are no predictions. Gains with such tasks:

{missing}

Effort falls as q rises and ends at that of SO (in simulation 2 from 13 on): whoever chooses q within the
range of the literature chooses the answer.

## What the rows do not say

The rows look at one joint axis at a time. The smallest eigenvalue of the full 6 x 6 Hessian is negative in
{negative} of {n_values} answers, down to {lowest:.0f} N·m/rad with stability rows: by that measure these
postures are not stable, with or without them. `eigenvalues.csv` has all.

## Files

`figure_3` to `figure_6`: the paper's comparisons from our runs, without its EMG (dotted: the mean EMG that
the paper's numbers imply). `sweep_*`, `muscle_lines`, `which_muscle_stabilizes`: figures that the paper does
not have. The CSV files hold all numbers.
"""


def _overall(differences: Sequence[DifferenceRow], method: str) -> str:
    rows = [row for row in differences if row.method == method]
    weights = [TASK_WEIGHTS[row.tasks] for row in rows]
    low = np.average([row.low for row in rows], weights=weights)
    high = np.average([row.high for row in rows], weights=weights)
    return f"{low:.1f} to {high:.1f}"


def _load_height_table(lifted: Tasks) -> str:
    rows = []
    for method in lifted.solutions:
        abdomen = np.mean([lifted.group(method, g) for g in ("RA", "EO", "IO")], axis=(0, 2))
        back = lifted.group(method, "ES").mean(axis=1)
        ratio = ratios(lifted, method)
        for first, mass in ((0, 4.5), (5, 9.0)):
            last = first + 4
            rows.append(
                (
                    method,
                    f"{mass:g}",
                    f"{abdomen[first]:.2f} to {abdomen[last]:.2f}",
                    f"{back[first]:.1f} to {back[last]:.1f}",
                    f"{ratio[first]:.2f} to {ratio[last]:.2f}",
                )
            )
    header = ("method", "load [kg]", "abdomen, 0 to 0.8 m [%]", "back, 0 to 0.8 m [%]", "abdomen / back [-]")
    return markdown_table(header, rows)


def _least_ratio_error(lifted: Tasks, mass: float) -> float:
    """Triangle inequality of the root mean squared difference, see :func:`difference_rows`."""
    frames = slice(0, 5) if mass == 4.5 else slice(5, 10)
    change = ratios(lifted, "SCSO q = 5")[frames] - ratios(lifted, "SO")[frames]
    return abs(PAPER_RATIO[mass][0] - float(np.sqrt(np.mean(change**2))))


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("results") / "paper"
    write_paper_figures(target)
    sys.stdout.write(f"figures, tables and README.md in {target}\n")
