"""Where frames begin if the same motion has been solved with fewer constraints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scso_nlp.solution import RowResult, Solution, Status
from scso_nlp.solver.judge import unknowns_of
from scso_nlp.solver.presolve import Start
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.rows import RowBlock
from scso_nlp.validation import BoolArray, FloatArray


def start_of_baseline(program: FrameProgram, baseline: Solution) -> tuple[Start, BoolArray]:
    """Take the optimum of a problem with fewer constraints as the start of one with more.

    Parameters
    ----------
    program : FrameProgram
        Without coupling, its rows affine.
    baseline : Solution
        Of the same motion and objective. Nothing of this is believed: who uses the start grades it.

    Returns
    -------
    start : Start
        Optimal where the baseline is solved and keeps all rows; nothing may be missed there.
    is_solved : ndarray of bool, shape (n_frames,)
        Frames that the baseline has solved: the others are where terms want to begin.
    """
    unknowns = np.clip(unknowns_of(program, baseline), *program.bounds())
    unknowns[:, program.is_miss] = 0.0
    solved = np.array([status is Status.SOLVED for status in baseline.frame_status])
    start = Start.nowhere(program, unknowns)
    multipliers = np.zeros_like(start.multipliers)
    for block, where in program.rows:
        multipliers[:, where] = _multipliers(block, baseline)
    affine, table = program.split.affine, program.rows
    matrix = affine.matrix(affine.values, program.layout.size)
    value = (matrix @ unknowns.ravel()).reshape(affine.constant.shape) + affine.constant
    # only rows that the baseline did not have: its own are kept to rounding
    is_new = np.array([term not in baseline.kept for term in table.term], dtype=bool)[affine.rows]
    inside = (value >= table.lower[affine.rows]) & (value <= table.upper[affine.rows])
    keeps = (inside | ~is_new).all(axis=1)
    return replace(
        start, multipliers=multipliers, is_optimal=solved & keeps, is_confirmed=solved & keeps
    ), solved


def _multipliers(block: RowBlock, baseline: Solution) -> FloatArray:
    """Multipliers of a block's rows in the solver's sign and scale, zero for rows without."""
    found = np.zeros((len(baseline.activation), len(block.names)))
    result = baseline.kept.get(block.term)
    if not isinstance(result, RowResult) or block.turns is not None:
        return found
    for i, name in enumerate(block.names):
        if name in result.names:
            j = result.names.index(name)
            nearer_lower = np.abs(result.value[:, j] - result.lower[j]) < np.abs(
                result.value[:, j] - result.upper[j]
            )
            is_equation = result.lower[j] == result.upper[j]
            sign = np.where(nearer_lower | is_equation, -1.0, 1.0)
            found[:, i] = sign * result.multiplier[:, j] * block.scale
    return np.nan_to_num(found)
