"""Every sensitivity of random problems equals central differences of re-solved problems, or is flagged.

Seeded and few by default; ``SCSO_SENSITIVITY=10000 pytest tests/sensitivities -s`` tries more, and prints.
"""

from __future__ import annotations

import collections
import os

import numpy as np
import pytest
from sensitivities.differences import KINDS, differences, optimum, parameter_of, problem_of

import scso_nlp as scso
from scso_nlp.sensitivities import Regularity

#: How many problems are tried, over all kinds.
NUMBER = int(os.environ.get("SCSO_SENSITIVITY", "33"))
#: Largest difference from central differences, over the largest derivative of the frame [-].
PRECISION = 1e-6
#: Optima are refined to this much of their size: differences are known to this over the step [-].
ROUNDING = 2e-14


def outcomes(seed):
    """Kind, exponent, parameter and what becomes of each frame of one problem."""
    rng, kind, exponent, problem = problem_of(seed)
    solution = scso.solve_trajectory(problem, on_failure="return")
    if not solution.is_solved.all():
        return [(kind, exponent, "", "not solved")]
    parameter, size = parameter_of(rng, problem)
    change = scso.sensitivity(solution, [parameter])
    exact = {
        "activation": change.activation[:, 0],
        "tendon_force": change.tendon_force[:, 0],
        **{term: values[:, 0] for term, values in (change.row_multiplier | change.matrix_multiplier).items()},
    }
    flagged = {k: found.name for k, found in enumerate(change.regularity) if found is not Regularity.REGULAR}
    assert all(np.isnan(values[k]).all() for values in exact.values() for k in flagged)
    words = dict.fromkeys(
        set(range(len(change.regularity))) - set(flagged), "active set changes within every step"
    )
    objective = "flagged" if flagged else "unknown"
    base = optimum(problem) if words else None
    for h, same, slope in differences(problem, parameter, size, base) if words else ():
        if problem.coupled_terms:
            same = np.full(same.shape, same.all())
        for k in [k for k, word in words.items() if same[k] and word != "equal"]:
            worst = {name: _miss(values[k], slope, base, name, k, h) for name, values in exact.items()}
            bad = {name: f"{miss:.1e}" for name, miss in worst.items() if not miss <= 1.0}
            words[k] = f"WRONG in frame {k} of seed {seed} ({parameter.name}): {bad}" if bad else "equal"
        if not flagged and same.all() and objective != "equal":
            total, other = change.objective[0], slope["objective"]
            allowed = max(PRECISION * abs(total), 50 * ROUNDING * abs(base.values["objective"]) / h)
            objective = "equal" if abs(total - other) <= allowed else f"WRONG objective of seed {seed}"
        if all(word == "equal" for word in words.values()) and not objective.startswith("WRONG"):
            break
    words |= flagged
    if objective.startswith("WRONG"):
        words["objective"] = f"{objective} ({parameter.name})"
    return [(kind, exponent, parameter.quantity, word) for word in words.values()]


def _miss(exact, slope, base, name, k, h):
    """Difference of one frame over what is allowed."""
    other, values = slope[name], base.values[name]
    k -= len(base.active) - len(values)  # a pair's rows stand at its later frame
    if k < 0:
        return 0.0
    other, values = other[k], values[k]
    known = np.isfinite(exact)  # multipliers of rows that bounds keep are not unique
    largest = np.abs(other).max(initial=0.0)
    allowed = max(PRECISION * largest, 50 * ROUNDING * np.abs(values).max(initial=0.0) / h, 1e-300)
    return float(np.abs(exact - other)[known].max(initial=0.0) / allowed)


@pytest.mark.parametrize("part", range(len(KINDS)), ids=[kind.__name__ for kind in KINDS])
def test_sensitivities_equal_differences_or_are_flagged(part):
    seeds = range(part, NUMBER, len(KINDS))
    table = collections.Counter(outcome for seed in seeds for outcome in outcomes(seed))
    if NUMBER > 1000:
        for entry, n in sorted(table.items()):
            print(*entry, n)
    wrong = [entry for entry in table if "WRONG" in entry[3]]
    assert not wrong, wrong
    assert sum(n for entry, n in table.items() if entry[3] == "equal") >= 0.4 * sum(table.values()), table


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(92, id="curvatures span fourteen decades, and rows are nearly dependent"),
        pytest.param(170, id="rows of a matrix beside a diagonal Hessian"),
    ],
)
def test_problems_that_once_were_wrong_or_crashed(seed):
    """Found by ten thousand random problems."""
    words = {word for *_, word in outcomes(seed)}
    assert "equal" in words
    assert not [word for word in words if "WRONG" in word]
