"""First-order bands of static optimization of walking with 18 muscles beside samples that are solved again.

Run ``python -m problems.bands_against_samples [samples]`` from the project's root. It prints how far apart
the two are and draws it into docs/theory/bands_against_samples.png.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import scso_nlp as scso
from problems.gait_lower_limb.problem import make_problem
from scso_nlp.figures import save_figure
from scso_nlp.validation import BoolArray, FloatArray

#: Standard deviations: share of every strength [-], every joint moment [N·m].
STRENGTH, MOMENT = 0.02, 0.5
#: First order holds in a frame where this share of the samples keeps the same muscles at their bounds.
SAME = 0.99
#: Bands narrower than this are of muscles that rest [-].
NARROW = 1e-6
#: Nearer than this to a bound is at it [-].
AT_BOUND = 1e-6
_FIGURE = Path(__file__).parents[1] / "docs" / "theory"


def spreading(problem: scso.MuscleForceProblem) -> tuple[list[scso.Parameter], FloatArray, BoolArray]:
    """Parameters that spread, their standard deviations, and the coordinates that muscles move.

    Parameters
    ----------
    problem : MuscleForceProblem

    Returns
    -------
    parameters : list of Parameter
        Strengths by shares, and moments.
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
    sizes = [len(trajectory.muscles), len(moved)]
    return parameters, np.repeat([STRENGTH, MOMENT], sizes), is_moved


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
    n = len(trajectory.muscles)
    share, forces = 1 + draw[:n], trajectory.generalized_forces.copy()
    forces[:, is_moved] += draw[n:]
    trajectory = replace(
        trajectory, generalized_forces=forces, active_force_capacity=share * trajectory.active_force_capacity
    )
    muscles = replace(motion.muscles, max_isometric_force=share * motion.muscles.max_isometric_force)
    return replace(problem, motion=replace(motion, trajectory=trajectory, muscles=muscles))


def at_bounds(solution: scso.Solution) -> BoolArray:
    """Tell which muscles rest, and which are at their most, shape (n_frames, 2 n_muscles).

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    ndarray of bool
    """
    muscles, activation = solution.problem.motion.muscles, solution.activation
    return np.hstack(
        [activation < muscles.min_activation + AT_BOUND, activation > muscles.max_activation - AT_BOUND]
    )


def main(n_samples: int) -> None:
    """Solve, sample, compare and draw.

    Parameters
    ----------
    n_samples : int
    """
    problem = make_problem(step_interval=6).without_stability()
    solution = scso.solve_trajectory(problem)
    parameters, deviation, is_moved = spreading(problem)
    band = scso.bands(scso.sensitivity(solution, parameters), covariance=deviation**2)
    base, rng = at_bounds(solution), np.random.default_rng(0)
    found, same = [], np.zeros(len(base))
    for draw in rng.normal(0, deviation, (n_samples, deviation.size)):
        sample = scso.solve_trajectory(moved_by(problem, draw, is_moved))
        found.append(sample.activation)
        same += (at_bounds(sample) == base).all(axis=1) / n_samples
    spread, held = np.std(found, axis=0), same >= SAME
    figure = Figure(figsize=(5.5, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, frames in (("same muscles at their bounds", held), ("muscles reach bounds, or leave", ~held)):
        first, again = (
            values[frames][band.activation[frames] > NARROW] for values in (band.activation, spread)
        )
        off = np.abs(again / first - 1)
        print(
            f"{name}: {frames.sum()} of {frames.size} frames, {first.size} activations, samples over "
            f"bands {(again / first).min():.3f} to {(again / first).max():.3f}, "
            f"{(off <= 0.05).mean():.1%} within 5 %"
        )
        axes.plot(first, again, "o" if frames is held else "x", markersize=4, label=name)
    ends = np.array(axes.get_xlim())
    axes.fill_between(ends, 0.95 * ends, 1.05 * ends, color="0.8", zorder=0, label="within 5 %")
    axes.set(
        xlabel="First-order band, one standard deviation [-]",
        ylabel=f"Standard deviation of {n_samples} samples [-]",
    )
    axes.legend()
    save_figure(figure, _FIGURE, "bands_against_samples", formats=("png",))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
