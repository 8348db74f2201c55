"""Solve the sets by every method and its null models, and write down what PROTOCOL.md asks for."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import scso_nlp as scso
from problems.scorecard import rules
from problems.scorecard.sets import Part, Set
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import ScsoError
from scso_nlp.solver.judge import unknowns_of
from scso_nlp.transcription.describe import describe
from scso_nlp.validation import FloatArray

Row = dict[str, Any]
#: How plain static optimization is called.
SO = "SO"
#: Rules that know nothing of stability.
NULLS = ("activation floor", "shifted effort", "antagonist ratio", "random patterns")
#: Random patterns of each frame.
N_PATTERNS = 10
#: Rules without stability, and the largest strength that is tried.
Alternative = Callable[[float], Any]


def alternatives(coordinates: Sequence[str]) -> dict[str, tuple[Alternative, float]]:
    """Give the null models that have a strength, with the largest that is tried."""
    where = tuple(coordinates) or None
    return {
        "activation floor": (lambda s: scso.ActivationFloor(floor=s), 1.0),
        "shifted effort": (lambda s: scso.ShiftedEffort(shift=s), 1.0),
        "antagonist ratio": (
            lambda s: scso.AntagonistRatio(ratio=s, coordinates=where),
            0.999,
        ),
    }


def efforts(solution: scso.Solution) -> FloatArray:
    """Sum of squared activations of every frame."""
    return np.asarray((solution.activation**2).sum(axis=1))


def power_at(solution: scso.Solution, term: StabilityConstraint) -> float:
    """Share of solved frames in which an answer does not keep the rows of a constraint."""
    seen = scso.observe(solution, term)
    if term.name in seen.matrices:
        margin = seen.matrices[term.name].smallest_eigenvalue[:, None]
    else:
        margin = seen.rows[term.name].value - seen.rows[term.name].lower
    return rules.power(margin[solution.is_solved])


def missed(solution: scso.Solution) -> float:
    """Share of solved frames that miss a soft row."""
    found = [r.missed.reshape(len(r.missed), -1) for r in solution.kept.values()]
    return float((np.hstack(found)[solution.is_solved] > rules.KEPT).any(axis=1).mean()) if found else 0.0


def reserves(solution: scso.Solution, coordinates: Sequence[str]) -> float:
    """Largest share of reserves, over coordinates with rows; all if none are named."""
    balance = solution.moment_balance
    share = dict(zip(balance.coordinates, balance.actuator_share, strict=True))
    return float(np.nanmax([share[name] for name in coordinates or balance.coordinates]))


def row_of(
    the_set: Set, method: str, solved: Sequence[tuple[Part, scso.Solution]], power: float, **more: object
) -> Row:
    """Lay out one method on one set."""
    errors: dict[str, list[float]] = {}
    for part, solution in solved:
        for metric, values in part.errors(solution).items():
            errors.setdefault(metric, []).extend(float(v) for v in values)
    flags = np.concatenate([solution.is_solved for _, solution in solved])
    effort = np.concatenate([efforts(solution)[solution.is_solved] for _, solution in solved])
    return {
        "set": the_set.name,
        "method": method,
        "power": power,
        "solved": float(flags.mean()),
        "frames": int(flags.size),
        "effort": float(effort.mean()) if effort.size else float("nan"),
        "reserves": max(reserves(solution, the_set.coordinates) for _, solution in solved),
        "missed": max(missed(solution) for _, solution in solved),
        "errors": errors,
        **more,
    }


def random_rows(
    the_set: Set, reference: str, pairs: Sequence[tuple[Part, scso.Solution, scso.Solution]], power: float
) -> Row:
    """Average errors over random patterns at the reference's effort, frame by frame."""
    drawn = [_random_solutions(plain, wanted) for _, plain, wanted in pairs]
    rows = [
        row_of(
            the_set,
            NULLS[-1],
            [(pair[0], found[0][i]) for pair, found in zip(pairs, drawn, strict=True)],
            power,
        )
        for i in range(N_PATTERNS)
    ]
    mean = dict(rows[0], reference=reference, note="; ".join({n for _, n in drawn if n}))
    for key in ("effort", "reserves"):
        mean[key] = float(np.mean([row[key] for row in rows]))
    mean["errors"] = {
        metric: np.mean([row["errors"][metric] for row in rows], axis=0).tolist()
        for metric in rows[0]["errors"]
    }
    return mean


def at_effort_along(start: FloatArray, end: FloatArray, effort: float) -> FloatArray:
    """Go from one pattern towards another until it costs an effort, or to the end, whichever is first."""
    step = end - start
    a, b, c = float(step @ step), float(start @ step), float(start @ start) - effort
    if a == 0 or c >= 0:
        return start
    return np.asarray(start + min(1.0, (-b + np.sqrt(b * b - a * c)) / a) * step)


def _random_solutions(plain: scso.Solution, wanted: scso.Solution) -> tuple[list[scso.Solution], str]:
    target = efforts(wanted)
    activation = np.repeat(plain.activation[None], N_PATTERNS, axis=0)
    alone = short = 0
    for k in np.flatnonzero(plain.is_solved & wanted.is_solved):
        try:
            patterns = scso.random_patterns(plain, int(k), N_PATTERNS, seed=int(k))
        except ScsoError:
            alone += 1
            continue
        for i, pattern in enumerate(patterns):
            activation[i, k] = at_effort_along(plain.activation[k], pattern, target[k])
        short += bool((activation[:, k] ** 2).sum(axis=1).mean() < 0.99 * target[k])
    program = describe(plain.problem)
    found = []
    for chosen in activation:
        moved = replace(plain, activation=chosen)
        unknowns = unknowns_of(program, moved)
        found.append(replace(moved, tendon_force=program.tendon_force.values(unknowns, program.arrays)))
    note = f"{short} frames below the effort, {alone} with one pattern" if short or alone else ""
    return found, note


def null_rows(
    the_set: Set, reference: str, pairs: Sequence[tuple[Part, scso.Solution, scso.Solution]], power: float
) -> Iterator[Row]:
    """Solve every null model at the effort of a method, motion by motion."""
    for name, (make, strongest) in alternatives(the_set.coordinates).items():
        try:
            found = [
                scso.at_effort(
                    part.plain, float(efforts(wanted).sum()), make, strongest=strongest, tolerance=0.01
                )
                for part, _, wanted in pairs
            ]
        except ScsoError as error:
            yield {
                "set": the_set.name, "method": name, "reference": reference, "power": power,
                "note": str(error), "solved": 0.0, "errors": {},
            }  # fmt: skip
            continue
        yield row_of(
            the_set,
            name,
            [(pair[0], each.solution) for pair, each in zip(pairs, found, strict=True)],
            power,
            reference=reference,
            strength=[each.strength for each in found],
        )
    yield random_rows(the_set, reference, pairs, power)


def entry(row: Row) -> rules.Entry:
    """Take from a row what rules look at."""
    return rules.Entry(
        power=row["power"], solved=row["solved"], reserves=row.get("reserves", 0.0), errors=row["errors"]
    )


def run(the_set: Set, say: Callable[[str], object] = lambda _: None) -> tuple[list[Row], dict[str, Any]]:
    """Solve one set.

    Parameters
    ----------
    the_set : Set
    say : callable
        Told what is done.

    Returns
    -------
    rows : list of dict
    facts : dict
        Of the set: lag, cells, body weight.
    """
    parts = the_set.parts()
    plain = [scso.solve_trajectory(part.plain, on_failure="return") for part in parts]
    rows = [row_of(the_set, SO, list(zip(parts, plain, strict=True)), 1.0)]
    asked: list[tuple[str, float, list[tuple[Part, scso.Solution, scso.Solution]]]] = []
    for method, term in the_set.methods.items():
        began = time.perf_counter()
        pairs = []
        for part, so in zip(parts, plain, strict=True):
            problem = replace(part.plain, constraints=(*part.plain.constraints, term))
            pairs.append((part, so, scso.solve_trajectory(problem, baseline=so, on_failure="return")))
        power = float(np.mean([power_at(so, term) for _, so, _ in pairs]))
        rows.append(row_of(the_set, method, [(part, found) for part, _, found in pairs], power))
        rows[-1]["seconds"] = round(time.perf_counter() - began, 1)
        say(f"{the_set.name}, {method}: power {power:.2f}, {rows[-1]['seconds']} s")
        is_reference = method == the_set.reference and power >= rules.LEAST_POWER
        if is_reference or rules.verdict(entry(rows[-1]), entry(rows[0]))[0] == "better":
            asked.append((method, power, pairs))
    for method, power, pairs in asked:
        for row in null_rows(the_set, method, pairs, power):
            rows.append(row)
            say(f"{the_set.name}, {row['method']} at the effort of {method}")
    facts = {"unit": the_set.unit, "kind": the_set.kind}
    for part in parts:
        facts.update(part.facts)  # type: ignore[arg-type]
    return rows, facts
