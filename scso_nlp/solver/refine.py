r"""Matrix inequalities by rows: turns v with which :math:`v^T G\, v \ge 0` is what :math:`G \succeq 0` is.

Before the first solve, turns in the null space of the matrix at the optimum of the problem's quadratic
model; after each solve, eigenvectors of negative eigenvalues and the turns that decide there, until there are
none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.solution import Status
from scso_nlp.solver.conic import MatrixProgram, highest_eigenvalues, solve_matrix_programs
from scso_nlp.solver.cut import allowed_below_zero, cut, sums_and_differences
from scso_nlp.solver.judge import Outcome
from scso_nlp.solver.local_model import LocalModel, Quadratic
from scso_nlp.solver.presolve import Start, can_presolve
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.turns import MatrixModel
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Frames whose deciding turns are sought together; bounds the memory.
FRAMES_PER_BATCH = 64

#: Weights of the directions of a multiplier are similar if none is less than this share of the largest.
_SIMILAR_WEIGHT = 1e-4


@dataclass(frozen=True, kw_only=True)
class Turns:
    """Turns of every matrix inequality of a problem.

    Attributes
    ----------
    turns : tuple of ndarray, shape (n_frames, n_turns, n) [-]
        Unit vectors; zeros where a frame has fewer.
    doubtful : tuple of int
        Frames in which no matrix above its levels was found.
    """

    turns: tuple[FloatArray, ...] = ()
    doubtful: tuple[int, ...] = ()


def foreseen_turns(
    model: LocalModel, start: FloatArray, known: Start | None = None
) -> tuple[Turns, Start | None]:
    """Choose turns before the first solve: those that decide, or each direction alone where none are found.

    Parameters
    ----------
    model : LocalModel
    start : ndarray, shape (n_frames, n_unknowns)
        Scaled.
    known : Start, optional
        Frames that are at their optimum without matrix inequalities.

    Returns
    -------
    turns : Turns
    start : Start or None
        Frames that cutting planes have brought to their optimum, with multipliers of the program's rows, then
        of the turns.
    """
    every = np.arange(len(start))
    left, found_before = every, None
    if can_presolve(model.program) and all(matrix.is_affine for matrix in model.matrices):
        found_before = cut(model, start, known)
        left = np.flatnonzero(~found_before.is_found)
    chosen: list[FloatArray] = []
    multipliers: list[FloatArray] = []
    doubtful: set[int] = set()
    for i, matrix in enumerate(model.matrices):
        n = len(matrix.block.names)
        turns, found, beyond = _deciding_turns(model, matrix, start, left)
        lost = left[~found[left]]
        width = max(turns.shape[1], n if lost.size else 0)
        weight = np.zeros((len(start), width))
        if found_before is not None:
            width = max(width, found_before.turns[i].shape[1])
            weight = _padded(found_before.multipliers[i], width)
        padded = _padded(turns, width)
        if found_before is not None:
            padded += _padded(found_before.turns[i], width)
        if lost.size:
            padded[lost, :n] = np.eye(n)
        chosen.append(padded)
        multipliers.append(weight)
        doubtful.update(int(k) for k in beyond)
    found_with = None
    if found_before is not None:
        found_with = replace(
            found_before.start,
            multipliers=np.hstack([found_before.start.multipliers, *multipliers]),
            is_optimal=found_before.is_found,
        )
    return Turns(turns=tuple(chosen), doubtful=tuple(sorted(doubtful))), found_with


def _padded(values: FloatArray, width: int) -> FloatArray:
    """Fill the second axis up with zeros."""
    missing = [(0, 0)] * values.ndim
    missing[1] = (0, width - values.shape[1])
    return np.pad(values, missing)


def still_known(before: Turns, after: Turns, rows: FrameProgram, outcome: Outcome) -> Start:
    """Say what the next solve knows of frames that were solved and need no more turns.

    Parameters
    ----------
    before, after : Turns
    rows : FrameProgram
        With the turns of before.
    outcome : Outcome
        Of this program.

    Returns
    -------
    Start
    """
    known = Start.nowhere(rows, np.nan_to_num(outcome.unknowns))
    own = known.multipliers.shape[1] - sum(turns.shape[1] for turns in before.turns)
    parts = np.split(
        np.nan_to_num(outcome.multipliers[0]),
        np.cumsum([own, *(t.shape[1] for t in before.turns)])[:-1],
        axis=1,
    )
    solved = np.array([status is Status.SOLVED for status in outcome.status])
    for old, new in zip(before.turns, after.turns, strict=True):
        solved &= ~new[:, old.shape[1] :].any(axis=(1, 2))
    if outcome.unit is not None:
        solved &= outcome.unit == 1
    widened = [_padded(part, new.shape[1]) for part, new in zip(parts[1:], after.turns, strict=True)]
    return replace(known, multipliers=np.hstack([parts[0], *widened]), is_optimal=solved, is_confirmed=solved)


def more_turns(model: LocalModel, old: Turns, unknowns: FloatArray, usable: BoolArray) -> Turns | None:
    """Add what a solution does not withstand.

    Parameters
    ----------
    model : LocalModel
    old : Turns
    unknowns : ndarray, shape (n_frames, n_unknowns)
        Of the solution, scaled.
    usable : ndarray of bool, shape (n_frames,)
        Frames that are solved.

    Returns
    -------
    Turns or None
        None where every usable frame keeps its matrix inequalities.
    """
    turns, is_kept = list(old.turns), True
    for i, matrix in enumerate(model.matrices):
        value = matrix.value(unknowns, model.program.arrays)
        with one_thread():
            values, vectors = np.linalg.eigh(np.where(usable[:, None, None], value, 0.0))
        every = np.arange(len(unknowns))
        kept = allowed_below_zero(model.program, matrix, unknowns, every, values[:, 0])
        negative = values < -kept[:, None]
        if not negative.any():
            continue
        is_kept = False
        # Eigenvalues rise, so the negative ones come first.
        most = int(negative.sum(axis=1).max())
        unstable = np.where(negative[:, :most, None], vectors.transpose(0, 2, 1)[:, :most], 0.0)
        frames = np.flatnonzero(negative.any(axis=1))
        deciding, _, _ = _deciding_turns(model, matrix, unknowns, frames, model.coupling(unknowns))
        turns[i] = np.concatenate([turns[i], unstable, deciding], axis=1)
    return None if is_kept else Turns(turns=tuple(turns), doubtful=old.doubtful)


def _deciding_turns(
    model: LocalModel,
    matrix: MatrixModel,
    unknowns: FloatArray,
    frames: IntArray,
    coupling: Quadratic | None = None,
) -> tuple[FloatArray, BoolArray, IntArray]:
    """Find the null space of a matrix at the optimum, by a model of the problem without coupling.

    Where there is no optimum, the turns are those that are left unstable at the highest eigenvalue.

    Returns
    -------
    turns : ndarray, shape (n_frames, n_turns, n)
        Zeros where a frame has fewer, and in frames not asked for.
    found : ndarray of bool, shape (n_frames,)
    doubtful : ndarray of int
        Frames whose highest eigenvalue is negative.
    """
    n = len(matrix.block.names)
    found = np.zeros(len(unknowns), dtype=bool)
    multiplier = np.zeros((found.size, n, n))
    doubtful = [np.zeros(0, dtype=np.int64)]
    for part in np.array_split(frames, -(-frames.size // FRAMES_PER_BATCH)) if frames.size else ():
        start = unknowns[part]
        first = model.matrix_program(matrix, start, part, coupling)

        def near(
            here: FloatArray,
            which: IntArray,
            _: FloatArray | None = None,
            part: IntArray = part,
            first: MatrixProgram = first,
        ) -> MatrixProgram:
            return model.matrix_program(matrix, here, part[which], coupling, first.frames(which))

        with one_thread():
            if model.is_quadratic:
                answer = solve_matrix_programs(first)
            else:
                answer = solve_matrix_programs(first, near, start)
        multiplier[part] = np.where(answer.is_solved[:, None, None], answer.multiplier, 0.0)
        found[part] = answer.is_solved
        lost = np.flatnonzero(~answer.is_solved)
        if lost.size and model.is_quadratic:
            raised = near(start[lost], lost)
            with one_thread():
                best = highest_eigenvalues(raised)
            least = np.asarray(np.linalg.eigvalsh(raised.at(best.x)[best.is_solved])[:, 0])
            short = np.zeros(lost.size, dtype=bool)
            x, here = best.x[best.is_solved], part[lost[best.is_solved]]
            short[best.is_solved] = least < -allowed_below_zero(model.program, matrix, x, here, least)
            beyond = part[lost[short]]
            multiplier[beyond], found[beyond] = best.multiplier[short], True
            doubtful.append(beyond)
    with one_thread():
        return critical_turns(multiplier), found, np.concatenate(doubtful)


def critical_turns(multiplier: FloatArray, share: float = 1e-6) -> FloatArray:
    r"""Choose rows v'Hv that together hold as much as the matrix inequality does at the optimum.

    The multiplier Z is written as a sum :math:`\sum_i \lambda_i v_i v_i^T` with positive weights, so that the
    rows of the turns v have the same optimum as the inequality, and with as many turns as pin every product
    of two directions of Z's range to zero.

    Parameters
    ----------
    multiplier : ndarray, shape (n_frames, size, size)
        Of the matrix inequality; positive semi-definite.
    share : float [-]
        Least eigenvalue over the largest one of the frame.

    Returns
    -------
    ndarray, shape (n_frames, n_turns, size)
        Unit vectors; zeros where a frame has fewer.

    Notes
    -----
    With r directions of similar weight these are r (r + 1) / 2 turns, all active. Where weights differ by
    more than a factor of 10,000 they are the eigenvectors and their sums and differences, r² turns.
    """
    values, vectors = np.linalg.eigh(multiplier)
    values, vectors = values[:, ::-1], vectors[:, :, ::-1].transpose(0, 2, 1)
    rank = ((values > share * values[:, :1]) & (values > 0)).sum(axis=1)
    turns = np.zeros((len(rank), int((rank**2).max(initial=0)), values.shape[1]))
    for r in np.unique(rank[rank > 0]):
        similar = values[:, r - 1] > _SIMILAR_WEIGHT * values[:, 0]
        for frames, mix in (
            (np.flatnonzero((rank == r) & similar), _tight_frame(r)),
            (np.flatnonzero((rank == r) & ~similar), sums_and_differences(r)),
        ):
            weight = np.sqrt(values[frames, :r]) if mix.shape[0] < r * r else np.ones((frames.size, r))
            chosen = (mix * weight[:, None, :]) @ vectors[frames, :r]
            turns[frames, : len(mix)] = chosen / np.linalg.norm(chosen, axis=2, keepdims=True)
    used = (turns != 0).any(axis=(0, 2))
    return turns[:, : int(used.sum())]


def _tight_frame(r: int) -> FloatArray:
    """Rows u, r (r + 1) / 2 of them, whose products u u' add up to one and span all symmetric matrices."""
    pairs = [(i, j) for i in range(r) for j in range(i)]
    rows = np.vstack([np.eye(r), *[(np.eye(r)[i] + np.eye(r)[j])[None] for i, j in pairs]])
    values, vectors = np.linalg.eigh(rows.T @ rows)
    return rows @ (vectors / np.sqrt(values)) @ vectors.T
