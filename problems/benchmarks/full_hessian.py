"""The cost of the whole Hessian, against plain static optimization and its Cholesky factor as unknowns.

Usage: python -m problems.benchmarks.full_hessian [coordinates muscles frames]    (10 60 100)

One run of random motions whose loads topple the joints unless muscles stiffen them in every direction.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import scso_nlp as scso
from problems.random_hessian.lifted_stability import LiftedStability
from problems.random_hessian.problem import make_problem


def main() -> None:
    """Solve the three forms one after the other and print the ratios."""
    sizes = [int(word) for word in sys.argv[1:4]] or [10, 60, 100]
    problem = make_problem(*sizes)
    plain = replace(problem, constraints=(scso.MomentEquilibrium(),))
    forms = {
        "plain static optimization": plain,
        "whole Hessian": problem,
        "Cholesky factor as unknowns": replace(plain, constraints=(*plain.constraints, LiftedStability())),
    }
    seconds: dict[str, float] = {}
    for name, form in forms.items():
        started = time.perf_counter()
        solution = scso.solve_trajectory(form, on_failure="return")
        seconds[name] = time.perf_counter() - started
        report = solution.report
        print(
            f"{name:30s} {seconds[name]:8.2f} s   (build {report.build_seconds:.2f} s, solve "
            f"{report.solve_seconds:.2f} s, {report.iterations} iterations, {report.rounds} rounds)   "
            f"objective {solution.objective:.9g}   {int(solution.is_solved.sum())} frames solved"
        )
    whole = seconds["whole Hessian"]
    print(f"whole Hessian / plain: {whole / seconds['plain static optimization']:.1f}")
    print(f"Cholesky / whole Hessian: {seconds['Cholesky factor as unknowns'] / whole:.1f}")


if __name__ == "__main__":
    main()
