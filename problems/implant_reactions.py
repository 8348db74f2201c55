"""The force on the knee with the implant by OpenSim's JointReaction beside ours, at the same muscle forces.

Run ``python -m problems.implant_reactions`` from the project's root. It solves the trials as the scorecard
does and prints the table. OpenSim gets the motions with their coupled columns in radians, see SOURCE.md of
knee_implant.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from problems.benchmarks.reactions_against_opensim import opensims_reactions
from problems.benchmarks.setups import write_implant
from problems.fetch import KNEE_IMPLANT, fetch
from problems.knee_implant import problem as knee_implant
from problems.outputs import markdown_table
from problems.scorecard.running import SO
from problems.scorecard.sets import ON_LEGS, SETS
from scso_nlp import Solution, solve_trajectory
from scso_nlp.exceptions import DataError
from scso_nlp.validation import FloatArray

#: Static optimization, the method that null models are set beside, and the one that is nearest.
METHODS = (SO, ON_LEGS, "axes, falling q = 5")
HEADS = ("trial", "method", "frames", "root mean square difference [N]", "by OpenSim's JointReaction [N]",
         "largest contact force [N]", "forces apart by up to [N]")  # fmt: skip
#: Less than a step of the motions [s].
MARGIN = 1e-3


def opensims_force(trial: str, solution: Solution) -> FloatArray:
    """Let OpenSim say what the knee carries at the forces of a solution.

    Parameters
    ----------
    trial : str
    solution : Solution

    Returns
    -------
    ndarray, shape (n_frames,) [N]
    """
    motion = solution.problem.motion
    first, last = motion.trajectory.time[[0, -1]]
    span = {"start": first - MARGIN, "end": last + MARGIN}
    with tempfile.TemporaryDirectory() as folder:
        setup = write_implant(fetch(KNEE_IMPLANT), Path(folder), trial, "agreeing_", **span, step=1)
        found = opensims_reactions(setup, motion, solution.tendon_force, solution.control, 1)
    table = found["child", "ground"]
    columns = [
        i for i, label in enumerate(table.labels)
        if label.startswith(f"{knee_implant.KNEE}_on_") and label.endswith(("_fx", "_fy", "_fz"))
    ]  # fmt: skip
    return np.asarray(np.linalg.norm(table.values[:, columns], axis=1))


def row(trial: str, method: str, solution: Solution) -> tuple[object, ...]:
    """Lay out one answer: what the scorecard says of it, and what it would say with OpenSim's reactions."""
    ours = solution.joint_reactions([knee_implant.KNEE]).resultant[:, 0]
    theirs = opensims_force(trial, solution)
    time, measured = solution.problem.motion.trajectory.time, knee_implant.measured_force(trial)
    cycle = np.linspace(time[0], time[-1], len(measured))
    errors = [np.sqrt(np.mean((np.interp(cycle, time, f) - measured) ** 2)) for f in (ours, theirs)]
    shown = (f"{value:.1f}" for value in (*errors, theirs.max()))
    return (trial, method, len(time), *shown, f"{np.abs(ours - theirs).max():.1e}")


def rows() -> list[tuple[object, ...]]:
    """Solve trials by all methods, and let OpenSim check what they say of the knee."""
    the_set = next(each for each in SETS if each.name == "knee_implant")
    found = []
    for trial, part in zip(knee_implant.TRIALS, the_set.parts(), strict=True):
        for method in METHODS:
            terms = () if method == SO else (the_set.methods[method],)
            problem = replace(part.plain, constraints=(*part.plain.constraints, *terms))
            found.append(row(trial, method, solve_trajectory(problem)))
    return found


def main() -> None:
    """Print the table."""
    try:
        sys.stdout.write(markdown_table(HEADS, rows()))
    except DataError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
