"""Random problems of every kind that has gone wrong: what is called solved is held against other bounds.

Seeded and few by default; ``SCSO_ROBUSTNESS=5400 pytest tests/robustness -s`` tries more and prints tables.
"""

from __future__ import annotations

import collections
import dataclasses
import os

import numpy as np
import pytest
from helpers import unknowns
from random_kinds import EXPONENTS, Frame, drawn, in_unit, problem_of, with_moments

import scso_nlp as scso
from scso_nlp.exceptions import ScsoError
from scso_nlp.solution import Status

#: How many problems are tried, over all kinds.
NUMBER = int(os.environ.get("SCSO_ROBUSTNESS", "270"))
#: What is called solved costs at most this much more than the optimum, and misses its rows by this share [-].
PRECISION = 1e-6
#: HiGHS keeps rows and optimum to 1e-10 of numbers near one; what that is in the cost depends on prices.
PRECISION_OF_HIGHS = 1e-7


def verdicts(seed):
    """Kind, exponent and what becomes of each frame of one problem."""
    kind, exponent, problem, guess_factor = problem_of(seed)
    guess = None
    if guess_factor is not None:
        solution = scso.solve_trajectory(problem)
        guess = dataclasses.replace(
            solution, activation=solution.activation * guess_factor, control=solution.control * guess_factor
        )
    try:
        solution = scso.solve_trajectory(problem, initial_guess=guess, on_failure="return")
    except ScsoError as error:
        return [(kind, exponent, f"refused: {error}")] * problem.motion.n_frames
    return [(kind, exponent, _outcome(kind, problem, solution, k)) for k in range(len(solution.frame_status))]


def _outcome(kind, problem, solution, k):
    status = solution.frame_status[k]
    if status is Status.INFEASIBLE and kind == "barely infeasible":
        proven = any(proof.frame == k and proof.holds for proof in solution.infeasibility)
        return "right" if proven else "INFEASIBLE, but without proof"
    if status not in (Status.SOLVED, Status.STABILITY_MISSED):
        return status.name
    x, frame = unknowns(solution, k), Frame.of(problem, k)
    rows = solution.rows.get("JointStability")
    missed = np.zeros(0) if rows is None else rows.missed[k]
    size = np.abs(frame.a) @ np.abs(x) + np.abs(frame.b)
    wanted = np.abs(frame.g) @ np.abs(x) + np.abs(frame.h)
    if (
        (np.abs(frame.a @ x - frame.b) > PRECISION * size.max()).any()
        or (frame.g @ x + missed < frame.h - PRECISION * wanted.max(initial=0.0)).any()
        or (x < frame.lower).any()
        or (x > frame.upper).any()
    ):
        return "SOLVED, but rows or bounds are missed"
    p = frame.exponent
    if p in (1.0, np.inf):
        cost, least, slack = frame.cost(x, missed), frame.least_by_linear_program(), PRECISION_OF_HIGHS
    else:
        unit = (np.abs(x).max() or 1.0) if rows is None else 1.0
        own = frame.in_unit(unit)
        y = solution.rows["MomentEquilibrium"].multiplier[k]
        z = np.zeros(0) if rows is None else rows.multiplier[k]
        cost, slack = own.cost(x / unit, missed / unit), 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            given = own.bound(*(v * unit ** (1 - p) if unit ** (1 - p) < 1e200 else 0 * v for v in (y, z)))
        least = max(given, own.bound(*own.multipliers(x / unit)))
        if cost > least * (1 + PRECISION * p) and rows is None:
            # multipliers that vanish among the doubles do not where the optimum's largest unknown is one
            near_one = scso.solve_trajectory(in_unit(problem, unit), on_failure="return")
            least = max(least, own.bound(near_one.rows["MomentEquilibrium"].multiplier[k], z))
    # the size of the objective is sum |x df/dx|, p times its value
    if cost > least + (PRECISION * (p if np.isfinite(p) else 1.0) + slack) * abs(cost):
        return (
            f"SOLVED, but {cost / least - 1:.1e} above a bound" if least > 0 else "SOLVED, but above a bound"
        )
    return "right"


@pytest.mark.parametrize("part", range(6))
def test_what_is_called_solved_is_the_optimum(part):
    seeds = range(part, NUMBER, 6)
    found = [outcome for seed in seeds for outcome in verdicts(seed)]
    table = collections.Counter(found)
    if NUMBER > 1000:
        for (kind, exponent, outcome), n in sorted(table.items()):
            print(f"{kind:22s} p = {exponent:<5} {n:6d} {outcome}")
    wrong = {entry: n for entry, n in table.items() if entry[2].startswith("SOLVED")}
    assert not wrong, wrong
    infeasible = {entry: n for entry, n in table.items() if entry[2].startswith("INFEASIBLE")}
    assert not infeasible, f"all of these can be solved, or lack a proof: {infeasible}"
    lost = {entry: n for entry, n in table.items() if entry[2] != "right"}
    assert sum(lost.values()) <= 0.001 * len(found), lost


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_oracles_see_what_is_not_the_optimum_and_what_keeps_no_row(rng, exponent):
    """Answers of other weights, and for other moments, are not those of the problem."""
    problem = drawn(rng, exponent, 5.0)
    solution = scso.solve_trajectory(problem)
    assert [_outcome("as it is", problem, solution, k) for k in range(3)] == ["right"] * 3
    effort = scso.ActivationEffort(exponent=exponent, weights={"*": 1.0, "m[12]": 20.0, "reserve*": 0.5})
    others = (dataclasses.replace(problem, objectives=(effort,)), with_moments(problem, 1 + 1e-5))
    for other, expected in zip(others, ("above a bound", "rows or bounds are missed"), strict=True):
        wrong = scso.solve_trajectory(other)
        mixed = dataclasses.replace(solution, activation=wrong.activation, control=wrong.control)
        words = [_outcome("as it is", problem, mixed, k) for k in range(3)]
        # without curvature a vertex may be the optimum of other weights too
        assert sum(expected in word for word in words) >= (3 if exponent > 1.0 else 1), words
