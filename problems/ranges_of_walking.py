"""How far activations of 80 muscles in walking may be from the optimum at 5 % more effort, in what time.

Run ``python -m problems.ranges_of_walking`` from the project's root. It prints a line of a table for static
optimization, for the soft rows that :mod:`problems.walking_3d` has, and for each kind of hard stability rows
about knees and ankles.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import scso_nlp as scso
from problems.walking_3d.problem import make_problem
from scso_nlp.constraints.stability_constraint import StabilityConstraint

#: Share by which the effort of each frame may rise [-].
EFFORT = 0.05
#: Gains of all muscles [-].
GAINS = (20.0, 30.0, 40.0)
#: With exponent 3, every so many frames are looked at.
STEP = 6
_JOINTS = ("walker_knee_r", "ankle_r", "walker_knee_l", "ankle_l")
_COORDINATES = ("knee_angle_r", "ankle_angle_r", "knee_angle_l", "ankle_angle_l")
ROWS = {
    "axes that a coordinate turns": scso.JointStability(joints=_JOINTS),
    "all axes": scso.JointStability(joints=_JOINTS, axes=("x", "y", "z")),
    "coordinates": scso.CoordinateStability(coordinates=_COORDINATES),
    "whole Hessian": scso.HessianStability(coordinates=_COORDINATES),
}
#: Rows that are looked at with exponent 3, too.
CUBED = ("axes that a coordinate turns", "whole Hessian")


def cases(problem: scso.MuscleForceProblem) -> Iterator[tuple[str, scso.MuscleForceProblem]]:
    """Go through exponents, rows and gains.

    Parameters
    ----------
    problem : MuscleForceProblem

    Yields
    ------
    name : str
    problem : MuscleForceProblem
    """
    balance = problem.constraints[0]

    def kept(*rows: StabilityConstraint) -> scso.MuscleForceProblem:
        return replace(problem, constraints=(balance, *rows))

    def cubed(case: scso.MuscleForceProblem) -> scso.MuscleForceProblem:
        some = case.frames(np.arange(0, case.motion.n_frames, STEP))
        return replace(some, objectives=(scso.ActivationEffort(exponent=3.0),))

    yield "none", kept()
    yield "soft rows about all axes of a knee and an ankle", problem
    for name, rows in ROWS.items():
        for q in GAINS:
            yield f"{name}, q = {q:g}", kept(replace(rows, q=q))
    yield "none, exponent 3", cubed(kept())
    for name in CUBED:
        yield f"{name}, q = {GAINS[1]:g}, exponent 3", cubed(kept(replace(ROWS[name], q=GAINS[1])))


def main() -> None:
    """Solve, find the ranges and print."""
    problem = make_problem(prepare_for=tuple(ROWS.values()))
    print("| rows | frames solved | ms per frame | largest gap, activations | rows [N·m/rad] | necessary |")
    for name, case in cases(problem):
        solution = scso.solve_trajectory(case, on_failure="return")
        start = time.process_time()
        found = scso.ranges(solution, effort=EFFORT)
        spent = 1000 * (time.process_time() - start) / solution.is_solved.sum()
        sides = (
            found.least_stability - found.certified_least_stability,
            found.certified_greatest_stability - found.greatest_stability,
        )
        gap = np.nanmax(np.maximum(*sides), initial=0.0)
        print(
            f"| {name} | {solution.is_solved.sum()} of {solution.is_solved.size} | {spent:.0f} "
            f"| {found.gap:.0e} | {gap:.0e} | {len(found.necessary())} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
