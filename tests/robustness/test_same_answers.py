"""The fast path against IPOPT alone: optima found frame by frame and confirmed, and cold starts at 1e-10.

Seeded and few by default; ``SCSO_ROBUSTNESS=1026 pytest tests/robustness/test_same_answers.py -s`` tries more
and prints a table.
"""

from __future__ import annotations

import collections
import os

import numpy as np
import pytest
from helpers import unknowns
from random_kinds import Frame, problem_of

import scso_nlp as scso

#: How many problems are tried, over all kinds.
NUMBER = int(os.environ.get("SCSO_ROBUSTNESS", "171"))
COLD = scso.SolverOptions(presolve=False, tolerance=1e-10)
#: Where the cold start itself is not near enough to its optimum to compare activations.
COLDER = scso.SolverOptions(presolve=False, tolerance=1e-13)
#: Largest share by which a frame's objective may be above that of a cold start [-].
IN_OBJECTIVE = 1e-8
#: Largest difference in activations and controls at exponents 2 and 3, where they are unique [-].
IN_ACTIVATION = 1e-6
UNIQUE = (2.0, 3.0)


def compared(seed):
    """Exponent, outcome, share by which the objective is above and difference of unknowns of each frame."""
    _, exponent, problem, _ = problem_of(seed)
    fast = scso.solve_trajectory(problem, on_failure="return")
    found = _frames(problem, fast, COLD)
    if exponent in UNIQUE and any(apart > IN_ACTIVATION for _, _, apart in found):
        found = [
            (f"{outcome}, at 1e-13", above, apart) for outcome, above, apart in _frames(problem, fast, COLDER)
        ]
    return [(exponent, *frame) for frame in found]


def _frames(problem, fast, options):
    cold = scso.solve_trajectory(problem, options=options, on_failure="return")
    return [_frame(problem, fast, cold, k) for k in range(len(fast.frame_status))]


def _frame(problem, fast, cold, k):
    if not fast.frame_status[k].is_solved:
        return ("lost" if cold.frame_status[k].is_solved else "not solved by either"), 0.0, 0.0
    if not cold.frame_status[k].is_solved:
        return "solved by the fast path only", 0.0, 0.0
    frame = Frame.of(problem, k)
    x = [unknowns(solution, k) for solution in (fast, cold)]
    rows = [solution.rows.get("JointStability") for solution in (fast, cold)]
    cost = [frame.cost(x, np.zeros(0) if r is None else r.missed[k]) for x, r in zip(x, rows, strict=True)]
    above = cost[0] / cost[1] - 1 if cost[1] > 0 else float(cost[0] > 0)
    outcome = "the cold start is above" if above < -IN_OBJECTIVE else "the same"
    return outcome, above, float(np.abs(x[0] - x[1]).max())


@pytest.mark.parametrize("part", range(3))
def test_the_fast_path_gives_the_answers_of_a_cold_start(part):
    found = [frame for seed in range(part, NUMBER, 3) for frame in compared(seed)]
    if NUMBER > 1000:
        for (exponent, outcome), n in sorted(collections.Counter(entry[:2] for entry in found).items()):
            own = [entry for entry in found if entry[:2] == (exponent, outcome)]
            above, apart = max(entry[2] for entry in own), max(entry[3] for entry in own)
            print(f"p = {exponent:<5} {n:5d} {outcome:34s} above {above:8.1e}, unknowns {apart:.1e}")
    assert not [entry for entry in found if entry[1].startswith("lost")]
    assert max(entry[2] for entry in found) <= IN_OBJECTIVE
    unique = [entry[3] for entry in found if entry[0] in UNIQUE]
    assert len(unique) > 0.1 * len(found)
    assert max(unique) <= IN_ACTIVATION


@pytest.mark.parametrize(
    "seed", [pytest.param(490, id="a reserve costs a hundred powers of ten less than muscles")]
)
def test_problems_that_once_were_lost(seed):
    """Found by a thousand random problems."""
    assert {outcome for _, outcome, *_ in compared(seed)} <= {"the same", "the cold start is above"}
