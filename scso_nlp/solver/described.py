"""Problems in symbols: kept from solving for whoever asks more of a solution, described again for others."""

from __future__ import annotations

import weakref
from dataclasses import replace

from scso_nlp.solution import Solution
from scso_nlp.solver.redundant import without_redundant_rows
from scso_nlp.transcription.describe import FrameProgram, describe

#: Programs of solutions that are still there, by the solutions' identity. They can be neither copied nor sent
#: to another process, which solutions can: so they stand beside them.
_KEPT: dict[int, FrameProgram] = {}


def keep(solution: Solution, program: FrameProgram) -> None:
    """Keep the program of a solution for as long as the solution is there."""
    _KEPT[id(solution)] = program
    weakref.finalize(solution, _KEPT.pop, id(solution), None)


def program_of(solution: Solution) -> FrameProgram:
    """Give the program of a solution, without equations that follow from others.

    What its problem observed may be missing.
    """
    kept = _KEPT.get(id(solution))
    if kept is not None:
        return kept
    return without_redundant_rows(describe(replace(solution.problem, observed=())))
