"""Calibrate q on strides and lifts beside EMG, each left out once: ``python -m problems.calibration``.

Sets, groups, lags and units are the scorecard's; names of sets as arguments choose among them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import scso_nlp as scso
from problems.scorecard import rules
from problems.scorecard.sets import SETS, Part, Set
from scso_nlp.calibration.calibrate import with_values
from scso_nlp.exceptions import NameMismatchError, ScsoError
from scso_nlp.validation import FloatArray

#: Sets with strides or bends.
NAMES = ("treadmill_walk", "treadmill_run", "lift_15kg", "lift_5kg")
#: Methods of the scorecard whose gain is calibrated, from 5.
METHODS = ("axes, q = 5", "coordinates, q = 5")


def left_out_errors(
    part: Part, problem: scso.MuscleForceProblem, found: scso.Calibration
) -> dict[str, FloatArray]:
    """Errors of the scorecard of each unit, by metric, with what was found without it."""
    solved = [
        part.errors(
            scso.solve_trajectory(with_values(problem, found.parameters, values), on_failure="return")
        )
        for values in found.value_without
    ]
    return {metric: np.array([errors[metric][u] for u, errors in enumerate(solved)]) for metric in solved[0]}


def lines(the_set: Set) -> Iterator[str]:
    """Calibrate every method on a set, one row of the table each."""
    (part,) = the_set.parts()
    assert part.emg is not None  # every set of NAMES has EMG and units
    assert part.unit is not None
    plain = part.errors(scso.solve_trajectory(part.plain, on_failure="return"))
    for method in METHODS:
        problem = replace(part.plain, constraints=(*part.plain.constraints, the_set.methods[method]))
        unit = [f"{the_set.unit} {u + 1}" for u in part.unit]
        trial = scso.MeasuredTrial(problem=problem, measured=part.emg, unit=unit)
        found = scso.calibrate({the_set.name: trial})
        cells = [the_set.name, method.partition(",")[0], f"{len(found.units)}"]
        spread = f" ± {found.standard_error[0]:.2g}"
        how = ", rows idle" if found.is_flat[0] else ", at its bound" if found.is_at_bound[0] else spread
        cells += [f"{found.value[0]:.3g}{how}"]
        cells += [f"{e.mean():.4f}" for e in (found.error, found.error_at_start, found.error_of_plain)]
        for metric, errors in left_out_errors(part, problem, found).items():
            mean, low, high = rules.interval(errors - plain[metric])
            is_same = np.allclose(errors, plain[metric], atol=5e-5)
            cells.append("none" if is_same else f"{mean:+.4f} ({low:+.4f} to {high:+.4f})")
        yield f"| {' | '.join(cells)} |"


def main(names: list[str]) -> None:
    """Print the table.

    Parameters
    ----------
    names : list of str
        Of sets; all of them if empty.
    """
    print("| set | rows | units | q | left out | q = 5 | SO | agonists - SO | antagonists - SO |")
    print("|---|---|---|---|---|---|---|---|---|")
    known = {the_set.name: the_set for the_set in SETS if the_set.name in NAMES}
    for name in names or NAMES:
        if name not in known:
            raise NameMismatchError(f"unknown set {name!r}, expected one of {', '.join(known)}")
        for line in lines(known[name]):
            print(line, flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except ScsoError as error:
        sys.exit(f"error: {error}")
