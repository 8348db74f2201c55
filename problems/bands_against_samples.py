"""First-order bands of walking with 18 muscles, without and with stability rows, beside samples solved again.

Run ``python -m problems.bands_against_samples [samples]`` from the project's root. It prints how far apart
the two are and draws it into docs/theory/bands_against_samples.png.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import scso_nlp as scso
from problems.gait_lower_limb.problem import make_problem
from scso_nlp.figures import save_figure
from scso_nlp.validation import BoolArray, FloatArray

#: Standard deviations: share of every strength [-], every joint moment [N·m], share of the gain q [-].
STRENGTH, MOMENT, GAIN = 0.02, 0.5, 0.02
#: Title, gain q of hard stability rows about knees and ankles or none, and the share of these deviations.
CASES = (
    ("Static optimization", None, 1.0),
    ("Stability rows, q = 20", 20.0, 1.0),
    ("The same, a quarter of the spread", 20.0, 0.25),
)
#: First order holds in a frame where this share of the samples keeps the same muscles and rows at bounds.
SAME = 0.99
#: Bands narrower than this are of muscles that rest [-].
NARROW = 1e-6
#: Nearer than this to a bound is at it, of activations [-] and of levels [N·m/rad].
AT_BOUND, AT_LEVEL = 1e-6, 1e-5
_FIGURE = Path(__file__).parents[1] / "docs" / "theory"


def spreading(problem: scso.MuscleForceProblem) -> tuple[list[scso.Parameter], FloatArray, BoolArray]:
    """Parameters that spread, their standard deviations, and the coordinates that muscles move.

    Parameters
    ----------
    problem : MuscleForceProblem

    Returns
    -------
    parameters : list of Parameter
        Strengths by shares, moments, and of stability rows the gain by its share.
    deviation : ndarray, shape (n_parameters,)
    is_moved : ndarray of bool, shape (n_coordinates,)
    """
    trajectory = problem.motion.trajectory
    is_moved = (trajectory.moment_arms != 0).any(axis=(0, 2))
    moved = [name for name, moves in zip(trajectory.coordinates, is_moved, strict=True) if moves]
    parameters = [
        *(scso.Parameter(quantity="max_isometric_force", of=m, relative=True) for m in trajectory.muscles),
        *(scso.Parameter(quantity="generalized_forces", of=c) for c in moved),
    ]
    gain = [scso.Parameter(quantity="q", relative=True)] * len(problem.stability_terms)
    sizes = [len(trajectory.muscles), len(moved), len(gain)]
    return [*parameters, *gain], np.repeat([STRENGTH, MOMENT, GAIN], sizes), is_moved


def moved_by(
    problem: scso.MuscleForceProblem, draw: FloatArray, is_moved: BoolArray
) -> scso.MuscleForceProblem:
    """Change the numbers of a problem by one draw of all parameters.

    Parameters
    ----------
    problem : MuscleForceProblem
    draw : ndarray, shape (n_parameters,)
    is_moved : ndarray of bool, shape (n_coordinates,)

    Returns
    -------
    MuscleForceProblem
    """
    motion, trajectory = problem.motion, problem.motion.trajectory
    n, n_moved = len(trajectory.muscles), int(is_moved.sum())
    share, forces = 1 + draw[:n], trajectory.generalized_forces.copy()
    forces[:, is_moved] += draw[n : n + n_moved]
    rows = {
        term.name: replace(term, q=(1 + gain) * term.q)
        for term, gain in zip(problem.stability_terms, draw[n + n_moved :], strict=True)
    }
    trajectory = replace(
        trajectory, generalized_forces=forces, active_force_capacity=share * trajectory.active_force_capacity
    )
    muscles = replace(motion.muscles, max_isometric_force=share * motion.muscles.max_isometric_force)
    constraints = tuple(rows.get(term.name, term) for term in problem.constraints)
    motion = replace(motion, trajectory=trajectory, muscles=muscles)
    return replace(problem, motion=motion, constraints=constraints)


def at_bounds(solution: scso.Solution) -> BoolArray:
    """Tell which muscles rest, which are at their most, and which rows at their level.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    ndarray of bool, shape (n_frames, 2 n_muscles + n_rows)
    """
    muscles, activation = solution.problem.motion.muscles, solution.activation
    sides = [activation < muscles.min_activation + AT_BOUND, activation > muscles.max_activation - AT_BOUND]
    if solution.problem.stability_terms:
        sides.append(solution.stability.margin < AT_LEVEL)
    return np.hstack(sides)


def compare(problem: scso.MuscleForceProblem, share: float, n_samples: int, axes: Axes) -> None:
    """Solve, sample, print and draw.

    Parameters
    ----------
    problem : MuscleForceProblem
    share : float [-]
        Of the standard deviations.
    n_samples : int
    axes : matplotlib Axes
    """
    solution = scso.solve_trajectory(problem)
    parameters, deviation, is_moved = spreading(problem)
    deviation = share * deviation
    band = scso.bands(scso.sensitivity(solution, parameters), covariance=deviation**2)
    base, rng = at_bounds(solution), np.random.default_rng(0)
    found, same = [], np.zeros(len(base))
    for draw in rng.normal(0, deviation, (n_samples, deviation.size)):
        sample = scso.solve_trajectory(moved_by(problem, draw, is_moved))
        found.append(sample.activation)
        same += (at_bounds(sample) == base).all(axis=1) / n_samples
    spread, held = np.std(found, axis=0), same >= SAME
    for name, frames in (("same muscles and rows at bounds", held), ("bounds are reached or left", ~held)):
        first, again = (
            values[frames][band.activation[frames] > NARROW] for values in (band.activation, spread)
        )
        off = np.abs(again / first - 1)
        print(
            f"{axes.get_title()}, {name}: {frames.sum()} of {frames.size} frames, {first.size} activations, "
            f"samples over bands {(again / first).min():.3f} to {(again / first).max():.3f}, "
            f"{(off <= 0.05).mean():.1%} within 5 %",
            flush=True,
        )
        axes.plot(first, again, "o" if frames is held else "x", markersize=4, label=name)
    ends = np.array(axes.get_xlim())
    axes.fill_between(ends, 0.95 * ends, 1.05 * ends, color="0.8", zorder=0, label="within 5 %")
    axes.locator_params(nbins=4)


def main(n_samples: int) -> None:
    """Compare all cases.

    Parameters
    ----------
    n_samples : int
    """
    problem = make_problem(step_interval=6)
    (balance, rows) = problem.constraints
    figure = Figure(figsize=(9.6, 4.0), layout="constrained")
    panels = figure.subplots(1, len(CASES))
    for axes, (title, q, share) in zip(panels, CASES, strict=True):
        axes.set_title(title, fontsize="medium")
        hard = () if q is None else (replace(rows, q=q, soft=None),)
        compare(replace(problem, constraints=(balance, *hard)), share, n_samples, axes)
    panels[0].set_ylabel(f"Standard deviation of {n_samples} samples [-]")
    panels[1].set_xlabel("First-order band, one standard deviation [-]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save_figure(figure, _FIGURE, "bands_against_samples", formats=("png",))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
