"""What ten derivatives of a whole motion of 80 muscles cost beside its solve.

Run ``python -m problems.sensitivities_of_walking`` from the project's root; with ``1`` behind it, all 1,131
frames of the recording are taken in place of every tenth. It prints a line of a table for the problem as
:mod:`problems.walking_3d` has it, for static optimization, and for hard stability rows. All times are of the
processor, and every ratio is the median of pairs of a solve and the sensitivities right after it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

import scso_nlp as scso
from problems.walking_3d.problem import make_problem

#: How often each problem is solved and differentiated.
REPEATS = 7
#: How many numbers of one kind are differentiated by.
NUMBERS = 10
QUANTITIES = ("generalized_forces", "q", "max_isometric_force")
_Result = TypeVar("_Result")
_COORDINATES = ("knee_angle_r", "ankle_angle_r", "knee_angle_l", "ankle_angle_l")
HARD = scso.CoordinateStability(coordinates=_COORDINATES, q=40.0)


def cases(problem: scso.MuscleForceProblem) -> Iterator[tuple[str, scso.MuscleForceProblem]]:
    """Go through rows and exponents.

    Parameters
    ----------
    problem : MuscleForceProblem

    Yields
    ------
    name : str
    problem : MuscleForceProblem
    """
    balance = problem.constraints[0]
    yield "soft rows about all axes of a knee and an ankle, exponent 2", problem
    for exponent in (2.0, 3.0):
        effort = (scso.ActivationEffort(exponent=exponent),)
        for name, rows in (("no rows", ()), ("hard rows along four coordinates", (HARD,))):
            yield (
                f"{name}, exponent {exponent:g}",
                replace(problem, constraints=(balance, *rows), objectives=effort),
            )


def numbers(problem: scso.MuscleForceProblem, quantity: str) -> list[str]:
    """Name ten numbers of a kind, of one muscle or coordinate each; none where the problem has none.

    Parameters
    ----------
    problem : MuscleForceProblem
    quantity : str

    Returns
    -------
    list of str
    """
    if quantity == "q" and not problem.stability_terms:
        return []
    trajectory = problem.motion.trajectory
    names = trajectory.coordinates[-NUMBERS:] if quantity == "generalized_forces" else trajectory.muscles
    return [f"{quantity}[{name}]" for name in names[:NUMBERS]]


def timed(call: Callable[[], _Result]) -> tuple[float, _Result]:
    """Give the processor time of a call [s], and what it returns."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def line(name: str, problem: scso.MuscleForceProblem) -> str:
    """Solve and differentiate a problem several times, and write a line of the table."""
    wanted = {quantity: numbers(problem, quantity) for quantity in QUANTITIES}
    solves: list[float] = []
    ratios: dict[str, list[float]] = {quantity: [] for quantity in QUANTITIES}
    for _ in range(REPEATS):
        spent, solution = timed(lambda: scso.solve_trajectory(problem, on_failure="return"))
        solves.append(spent)
        for quantity, found in ratios.items():
            if wanted[quantity]:
                spent, change = timed(lambda q=quantity, s=solution: scso.sensitivity(s, wanted[q]))
                found.append(spent / solves[-1])
    cells = [
        name,
        f"{change.is_regular.sum()} of {change.is_regular.size}",
        f"{1000 * np.median(solves):.0f}",
    ]
    cells += [f"{np.median(found):.2f}" if found else "–" for found in ratios.values()]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    step_interval = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    problem = make_problem(step_interval=step_interval, prepare_for=(HARD,))
    print(f"| problem | regular frames | solve [ms] | {' | '.join(QUANTITIES)} |")
    for name, case in cases(problem):
        print(line(name, case), flush=True)


if __name__ == "__main__":
    main()
