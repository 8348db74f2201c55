"""The fast path beside IPOPT's cold start at 1e-10, for the cases of the benchmarks, coupled ones included.

Usage: python -m problems.benchmarks.same_answers [--cases a,b] [--data FOLDER] [--frames N] [--output FILE]

Each question is asked about N frames spread evenly (default 60; coupled ones about the first N). Where
the two differ by more than 1e-6 in an activation, colder starts are tried: the optimum is unique, and a
barrier keeps IPOPT away from bounds whose multipliers are small. The nearest of them stands in the table.
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import scso_nlp as scso
from problems.benchmarks.cases import CASES, FULL, SCSO, SO, Case, synthetic
from problems.benchmarks.measuring import frames_of, recorded, spread
from problems.benchmarks.questions import ask
from problems.outputs import markdown_table
from scso_nlp.validation import FloatArray

HEADS = (
    *("case", "what", "p", "frames", "not solved"),
    *("activation apart", "control apart", "objective above", "cold start at"),
)
#: Tolerances of the cold starts: the later are asked where the first are not near enough to their optimum.
COLD = (1e-10, 1e-12, 1e-13)
#: Largest difference of activations where they are unique [-].
APART = 1e-6
_UNIQUE = (2.0, 3.0)


def main(words: list[str] | None = None) -> int:
    """Print the table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [case.name for case in CASES]
    parser.add_argument("--cases", type=lambda text: text.split(","), default=names, help=", ".join(names))
    default = os.environ.get("SCSO_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of the third-party data")
    parser.add_argument("--frames", type=int, default=60, help="of each question, about")
    parser.add_argument("--output", type=Path, help="write the table into this file too")
    chosen = parser.parse_args(words)
    unknown = set(chosen.cases) - set(names)
    if unknown:
        parser.error(f"unknown case {sorted(unknown)[0]!r}, expected some of {', '.join(names)}")
    os.environ.setdefault("SCSO_DATA", str(chosen.data.resolve()))
    rows, head = [], markdown_table(HEADS, [])
    print(head, end="", flush=True)
    for case in (case for case in CASES if case.name in chosen.cases):
        for what, power, problem in questions(case, chosen.data.resolve(), chosen.frames):
            rows.append((case.name, what, f"{power:g}", *compared(problem, power)))
            print(markdown_table(HEADS, rows[-1:])[len(head) :], end="", flush=True)
    if chosen.output is not None:
        chosen.output.write_text(markdown_table(HEADS, rows), encoding="utf-8")
    return 0


def questions(case: Case, data: Path, frames: int) -> Iterator[tuple[str, float, scso.MuscleForceProblem]]:
    """Describe each question of a case about some frames: what it is, its power, and the problem."""
    with tempfile.TemporaryDirectory() as scratch:
        for kind, powers in case.powers.items():
            for what, problem in _motions(case, kind, data, Path(scratch)):
                for power in powers:
                    effort = (scso.ActivationEffort(exponent=power),)
                    asked = replace(problem, objectives=effort)
                    yield what, power, frames_of(asked, spread(problem.motion.n_frames, frames))
                if case.coupled and kind in (SO, SCSO):
                    first = frames_of(problem, np.arange(min(frames, problem.motion.n_frames)))
                    terms = (*problem.constraints, scso.ActivationRate())
                    yield f"{what} + ActivationRate", 2.0, replace(first, constraints=terms)


def _motions(
    case: Case, kind: str, data: Path, scratch: Path
) -> Iterator[tuple[str, scso.MuscleForceProblem]]:
    if case.make is not None:
        problem = case.make()
        kept, rows, whole = problem.constraints
        yield kind, replace(problem, constraints={SO: (kept,), SCSO: (kept, rows), FULL: (kept, whole)}[kind])
    elif case.sizes:
        for n_coordinates, n_muscles, n_frames in case.sizes:
            what = f"{kind}, {n_coordinates} coordinates, {n_muscles} muscles, {n_frames} frames"
            yield what, synthetic(n_coordinates, n_muscles, n_frames, kind)
    else:
        assert case.setup is not None
        yield kind, case.problem(recorded(case, case.setup(data, scratch), kind), kind)


def compared(problem: scso.MuscleForceProblem, power: float) -> tuple[int, int, float, float, float, float]:
    """Frames, those that the fast path does not solve, differences, and the cold start's tolerance.

    Returns
    -------
    tuple
        Frames; how many of them the fast path lost; largest differences of activations and of controls, NaN
        where they are not unique; largest share by which the objective is above that of the cold start; the
        tolerance of this one.
    """
    fast = scso.solve_trajectory(problem, on_failure="return")
    question, found = ask(problem), []
    for tolerance in COLD:
        options = scso.SolverOptions(presolve=False, tolerance=tolerance)
        cold = scso.solve_trajectory(problem, options=options, on_failure="return")
        both = fast.is_solved & cold.is_solved
        apart = [
            float(np.abs(a - b)[both].max(initial=0.0)) if power in _UNIQUE else math.nan
            for a, b in ((fast.activation, cold.activation), (fast.control, cold.control))
        ]
        unknowns = [np.hstack([each.activation, each.control]) for each in (fast, cold)]
        cost: list[FloatArray] = [question.objective(x)[both] for x in unknowns]
        if problem.coupled_terms:
            cost = [each.sum(keepdims=True) for each in cost]
        above = np.max(cost[0] / cost[1] - 1, initial=-math.inf)
        found.append((*apart, float(above), tolerance))
        if not apart[0] > APART:
            break
    return len(both), int((~fast.is_solved).sum()), *min(found)


if __name__ == "__main__":
    raise SystemExit(main())
