"""Lifting and walking beside EMG: solve, compare, write figures, tables and one HTML page.

Run ``python -m problems.emg_figures NAME [folder] [every n-th frame]`` from the project's root; NAME is
back_lifting, walking_3d or gait_lower_limb. The data are fetched on first use, see :mod:`problems.fetch`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from problems.back_lifting import problem as back_lifting
from problems.gait_lower_limb import problem as gait_lower_limb
from problems.outputs import markdown_table
from problems.walking_3d import problem as walking_3d
from scso_nlp import (
    HessianStability,
    JointStability,
    MuscleForceProblem,
    Solution,
    solve_framewise,
    write_solution,
)
from scso_nlp.contributions import row_contributions
from scso_nlp.emg import (
    Comparison,
    compare,
    format_number,
    read_emg,
    read_emg_map,
    result_of,
    write_comparison_csv,
)
from scso_nlp.exceptions import DataError
from scso_nlp.figures import (
    HorizontalAxis,
    percent_of_motion,
    plot_activity,
    plot_contributions,
    plot_mean_activity,
    plot_moments,
    plot_stability,
    save_figure,
)
from scso_nlp.report.page import write_report

#: Metrics that the Markdown page shows; the CSV file has all.
SHOWN = ("mean absolute difference", "Pearson r", "mean activity", "activity ratio")
#: Soft rows that miss less than this count as kept [N·m/rad].
KEPT = 1e-3


@dataclass(frozen=True, kw_only=True)
class Study:
    """One motion and the ways in which it is solved.

    Attributes
    ----------
    name : str
    problems : mapping of str to MuscleForceProblem
        By method; the first is plain static optimization.
    emg, emg_map : Path or None
    """

    name: str
    problems: Mapping[str, MuscleForceProblem]
    emg: Path | None
    emg_map: Path | None


def lifting_study(trial: str, step_interval: int = 1) -> Study:
    """Describe one lift: SO, the paper's rows with q = 5 and 3, and the whole Hessian with passive stiffness.

    Parameters
    ----------
    trial : str
    step_interval : int

    Returns
    -------
    Study
    """
    rows, matrix = back_lifting.passive_stiffness()
    all_axes = JointStability(q=5.0, joints=back_lifting.JOINTS, axes=("x", "y", "z"))
    terms = {
        "SCSO q = 5": all_axes,
        "SCSO q = 3": replace(all_axes, q=3.0),
        "SCSO q = 5, passive": replace(all_axes, passive_stiffness=rows),
        "full q = 5, passive": HessianStability(
            q=5.0, coordinates=back_lifting.COORDINATES, passive_stiffness=matrix
        ),
    }
    problem = back_lifting.make_problem(trial, step_interval=step_interval, prepare_for=tuple(terms.values()))
    plain = problem.without_stability()
    return Study(
        name=trial,
        problems={"SO": plain, **_with_each(plain, terms)},
        emg=back_lifting.emg_file(trial),
        emg_map=back_lifting.EMG_MAP,
    )


def walking_study(step_interval: int = 10) -> Study:
    """Describe the stride: SO, hard rows about the flexion axes with q = 40, soft rows about all with q = 5.

    Parameters
    ----------
    step_interval : int

    Returns
    -------
    Study
    """
    soft = walking_3d.make_problem(5.0, step_interval)
    return Study(
        name="walking_3d",
        problems=_hard_and_soft(soft, "SCSO q = 40, flexion", walking_3d.JOINTS),
        emg=walking_3d.emg_file(),
        emg_map=walking_3d.EMG_MAP,
    )


def gait_study(step_interval: int = 1) -> Study:
    """Describe the planar walk, without EMG: SO, hard rows with q = 40, soft rows with q = 5.

    Parameters
    ----------
    step_interval : int

    Returns
    -------
    Study
    """
    soft = gait_lower_limb.make_problem(5.0, step_interval)
    return Study(
        name="gait_lower_limb",
        problems=_hard_and_soft(soft, "SCSO q = 40", gait_lower_limb.JOINTS),
        emg=None,
        emg_map=None,
    )


#: The studies of every problem, by the problem's name.
STUDIES: dict[str, tuple[Callable[[int], Study], ...]] = {
    "back_lifting": tuple(
        lambda every, trial=trial: lifting_study(trial, every) for trial in back_lifting.TRIALS
    ),
    "walking_3d": (lambda every: walking_study(10 * every),),
    "gait_lower_limb": (gait_study,),
}


def _hard_and_soft(
    soft: MuscleForceProblem, hard: str, joints: tuple[str, ...]
) -> dict[str, MuscleForceProblem]:
    plain = soft.without_stability()
    flexion = JointStability(q=40.0, joints=joints, axes=("z",))
    return {"SO": plain, **_with_each(plain, {hard: flexion}), "SCSO q = 5, soft": soft}


def _with_each(
    plain: MuscleForceProblem, terms: Mapping[str, JointStability | HessianStability]
) -> dict[str, MuscleForceProblem]:
    return {method: replace(plain, constraints=(*plain.constraints, term)) for method, term in terms.items()}


def run_study(study: Study, folder: Path) -> Comparison:
    """Solve, compare, and write result folders, figures, ``comparison.csv``, ``README.md``, ``report.html``.

    Parameters
    ----------
    study : Study
    folder : Path
        Made if it is not there.

    Returns
    -------
    Comparison
    """
    folder.mkdir(parents=True, exist_ok=True)
    solutions = {
        method: solve_framewise(problem, on_failure="return") for method, problem in study.problems.items()
    }
    for method, solution in solutions.items():
        write_solution(solution, folder / _file_name(method), figures=False, keep_failed=True)
    comparison = compare(
        [result_of(solution, method) for method, solution in solutions.items()],
        emg=None if study.emg is None else read_emg(study.emg),
        emg_map=None if study.emg_map is None else read_emg_map(study.emg_map),
    )
    write_comparison_csv(comparison, folder / "comparison.csv")
    per_cent = HorizontalAxis(values=percent_of_motion(comparison.time), label="Motion [%]")
    figures = {
        "activity": plot_activity(comparison, horizontal=per_cent),
        "mean_activity": plot_mean_activity(comparison),
    }
    captions = {
        "Net, muscle and reserve moments of plain static optimization.": "moments",
        "Stability margins.": "stability",
        "Which muscle stabilizes which axis.": "which_muscle_stabilizes",
    }
    baseline, *others = solutions.values()
    figures["moments"] = plot_moments(baseline)
    first = next(s for s in others if any(isinstance(t, JointStability) for t in s.problem.constraints))
    figures["stability"] = plot_stability(first, baseline=baseline)
    figures["which_muscle_stabilizes"] = plot_contributions(row_contributions(first))
    for name, figure in figures.items():
        save_figure(figure, folder, name)
    more = {caption: figures[name] for caption, name in captions.items()}
    write_report(comparison, folder / "report.html", figures=more)
    (folder / "README.md").write_text(_summary(study, solutions, comparison), encoding="utf-8")
    return comparison


def _file_name(method: str) -> str:
    return re.sub(r"\W+", "_", method)


def _summary(study: Study, solutions: Mapping[str, Solution], comparison: Comparison) -> str:
    outcome = markdown_table(
        ("method", "frames solved", "largest reserve", "rows missed", "effort", "solve time [s]"),
        [
            (
                method,
                f"{int(solution.is_solved.sum())} of {len(solution.frame_status)}",
                _largest_reserve(solution),
                _missed(solution),
                f"{solution.objective_terms['ActivationEffort']:.4g}",
                f"{solution.report.solve_seconds + solution.report.build_seconds:.1f}",
            )
            for method, solution in solutions.items()
        ],
    )
    failures = "".join(
        f"- {method}: {solution.summary()}\n"
        for method, solution in solutions.items()
        if not solution.is_solved.all()
    )
    notes: list[str] = []
    parts = []
    for metric in SHOWN:
        found = [row for row in comparison.rows if row.metric == metric]
        if not found:
            continue
        notes += [row.note for row in found if row.note and row.note not in notes]
        columns = list(dict.fromkeys(row.result for row in found))
        cells = {(row.group, row.result): format_number(row, notes) for row in found}
        groups = list(dict.fromkeys(row.group for row in found))
        table = markdown_table(
            ("group", *columns), [(g, *(cells.get((g, c), "") for c in columns)) for g in groups]
        )
        parts.append(f"## {metric[0].upper()}{metric[1:]}\n\n{table}\n")
    legend = "".join(f"[{i + 1}] {note}  \n" for i, note in enumerate(notes))
    emg = "No EMG: nothing here says which answer is nearer to a person.\n" if study.emg is None else (
        "In brackets: 95 % intervals by the circular block bootstrap over the frames of this motion of one "
        "person.\n"
    )  # fmt: skip
    return (
        f"# {study.name}\n\n{outcome}\n{failures or 'Every frame is solved by every method.' + chr(10)}\n"
        f"{emg}\n{''.join(parts)}{legend}"
    )


def _largest_reserve(solution: Solution) -> str:
    if not solution.control.size:
        return "none"
    size = np.abs(np.where(solution.is_solved[:, None], solution.actuator_force, 0.0))
    frame, actuator = np.unravel_index(int(size.argmax()), size.shape)
    return f"{size[frame, actuator]:.1f} ({solution.problem.motion.trajectory.actuators[actuator]})"


def _missed(solution: Solution) -> str:
    """Say in how many frames soft rows miss their level, and by how much at most."""
    amounts = [values for name, values in solution.variables.items() if name.endswith(".missed")]
    if not amounts:
        return "-"
    missed = np.hstack(amounts)[solution.is_solved]
    frames = int((missed > KEPT).any(axis=1).sum())
    return f"{frames} frames, up to {missed.max():.0f} N·m/rad"


def main(arguments: list[str]) -> None:
    """Run the studies of one problem.

    Parameters
    ----------
    arguments : list of str
        Name, folder and interval, as on the command line.
    """
    if not arguments or arguments[0] not in STUDIES:
        sys.exit(f"usage: python -m problems.emg_figures {{{','.join(STUDIES)}}} [folder] [every n-th frame]")
    name = arguments[0]
    folder = Path(arguments[1]) if len(arguments) > 1 else Path("results") / name
    every = int(arguments[2]) if len(arguments) > 2 else 1
    try:
        for make in STUDIES[name]:
            study = make(every)
            where = folder / study.name if len(STUDIES[name]) > 1 else folder
            run_study(study, where)
            sys.stdout.write(
                f"{study.name}: results, figures, tables, README.md and report.html in {where}\n"
            )
    except DataError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main(sys.argv[1:])
