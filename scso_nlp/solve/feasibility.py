"""What a frame cannot keep: rows out of reach, proven by linear programs, and rows that an iterate misses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linprog

from scso_nlp.solution import MatrixResult, RowResult, Shortfall
from scso_nlp.stability.hessian import describe_turn
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.validation import FloatArray

#: A row or bound may be missed by this much of its scale before a frame counts as infeasible [-].
FEASIBILITY_TOLERANCE = 1e-6


def worst_rows(
    program: FrameProgram,
    rows: Mapping[str, RowResult],
    matrices: Mapping[str, MatrixResult],
    frame: int,
    most: int = 3,
) -> list[Shortfall]:
    """Find the rows that the last iterate of a failed frame misses most, over their scales.

    Parameters
    ----------
    program : FrameProgram
    rows : mapping of str to RowResult
    matrices : mapping of str to MatrixResult
        Both as judged.
    frame : int
    most : int
        How many to name.

    Returns
    -------
    list of Shortfall
        Worst first.
    """
    found: list[tuple[float, Shortfall]] = []
    scales = {block.term: block.scale for block in (*program.rows.blocks, *program.pair_rows.blocks)}

    def add(term: str, row: str, amount: float, unit: str) -> None:
        if amount / scales[term] > FEASIBILITY_TOLERANCE:
            shortfall = Shortfall(
                frame=frame,
                time=float(program.time[frame]),
                constraint=term,
                row=row,
                amount=amount,
                unit=unit,
                proven=False,
            )
            found.append((amount / scales[term], shortfall))

    for name, row in rows.items():
        if not row.is_observed:
            for label, unit, amount in zip(
                row.names, row.unit, np.nan_to_num(row.violation[frame]), strict=True
            ):
                add(name, label, float(amount), unit)
    for name, matrix in matrices.items():
        if not matrix.is_observed:
            turn = describe_turn(matrix.names, matrix.mode[frame])
            add(name, turn, float(np.nan_to_num(matrix.violation[frame])), matrix.unit)
    return [shortfall for _, shortfall in sorted(found, key=lambda entry: -entry[0])[:most]]


def out_of_reach(program: FrameProgram) -> list[Shortfall]:
    """Rows that no unknowns within their bounds can reach, each taken alone.

    Interval arithmetic over the affine rows: cheap, necessary, not sufficient; :func:`infeasible_rows`
    is the exact test of all rows together.
    """
    affine, (lower, upper) = program.split.affine, program.bounds()
    n = len(affine.values)
    low_x, high_x = lower[:, affine.column], upper[:, affine.column]
    used = affine.values != 0  # a zero entry has no part in its row, even where the bound is infinite
    at_low, at_high = (
        np.multiply(affine.values, bound, where=used, out=np.zeros_like(affine.values))
        for bound in (low_x, high_x)
    )
    least, most = np.minimum(at_low, at_high), np.maximum(at_low, at_high)
    n_rows = int(affine.rows.max(initial=-1)) + 1
    sums = [np.zeros((n, n_rows)), np.zeros((n, n_rows))]
    for part, total in zip((least, most), sums, strict=True):
        np.add.at(total, (np.arange(n)[:, None], affine.row[None, :]), part)
    row_lower, row_upper = program.rows.lower, program.rows.upper
    found = []
    for i, r in enumerate(affine.rows):
        constant = affine.constant[:, i]
        short = np.maximum(
            row_lower[r] - (sums[1][:, r] + constant), (sums[0][:, r] + constant) - row_upper[r]
        )
        for k in np.flatnonzero(short > FEASIBILITY_TOLERANCE):
            wants_more = bool(row_lower[r] > sums[1][k, r] + constant[k])
            found.append((float(short[k]), _shortfall(program, int(k), int(r), float(short[k]), wants_more)))
    return [s for _, s in sorted(found, key=lambda entry: -entry[0])]


def infeasible_rows(program: FrameProgram, frame: int) -> list[Shortfall]:
    """Find the least total violation of the affine rows of one frame by a linear program.

    Returns
    -------
    list of Shortfall
        Empty if all rows can be kept together; otherwise the rows that the best compromise misses.
    """
    lower, upper = (bound[frame] for bound in program.bounds())
    matrix, row_lower, row_upper = _affine_rows(program, frame)
    n_rows, n_x = matrix.shape
    eye = np.eye(n_rows)
    above, below = np.isfinite(row_lower), np.isfinite(row_upper)
    a_ub = np.vstack([np.hstack([-matrix, -eye, 0 * eye])[above], np.hstack([matrix, 0 * eye, -eye])[below]])
    b_ub = np.concatenate([-row_lower[above], row_upper[below]])
    cost = np.concatenate([np.zeros(n_x), np.ones(2 * n_rows)])
    limits = [*zip(lower, upper, strict=True), *[(0.0, np.inf)] * (2 * n_rows)]
    result = linprog(cost, A_ub=a_ub, b_ub=b_ub, bounds=limits, method="highs")
    if not result.success or result.fun <= FEASIBILITY_TOLERANCE:
        return []
    short, excess = result.x[n_x : n_x + n_rows], result.x[n_x + n_rows :]
    order = np.argsort(-np.maximum(short, excess))
    return [
        _shortfall(
            program,
            frame,
            int(program.split.affine.rows[i]),
            float(max(short[i], excess[i])),
            short[i] > excess[i],
        )
        for i in order
        if max(short[i], excess[i]) > FEASIBILITY_TOLERANCE
    ]


def least_effort(program: FrameProgram, frame: int) -> FloatArray | None:
    """Keep the affine rows of one frame with the least largest unknown, by a linear program.

    The optimum of a sum of powers p of n unknowns has at most :math:`n^{1/p}` times this largest unknown,
    so it gives the frame's scale.

    Returns
    -------
    ndarray or None, shape (n_unknowns,)
        Scaled; None where there is none, or where the program has rows that are not affine.
    """
    if program.split.nonlinear:
        return None
    lower, upper = (bound[frame] for bound in program.bounds())
    used = ~program.split.affine.is_empty[frame]
    matrix, row_lower, row_upper = (rows[used] for rows in _affine_rows(program, frame))
    size = np.abs(matrix).max(axis=1, initial=0.0)
    matrix, row_lower, row_upper = matrix / size[:, None], row_lower / size, row_upper / size
    eye, one = np.eye(lower.size), np.ones((lower.size, 1))
    nothing = np.zeros((len(matrix), 1))
    a_ub = np.vstack(
        [
            np.hstack([-matrix, nothing])[np.isfinite(row_lower)],
            np.hstack([matrix, nothing])[np.isfinite(row_upper)],
            np.hstack([eye, -one]),
            np.hstack([-eye, -one]),
        ]
    )
    b_ub = np.concatenate(
        [-row_lower[np.isfinite(row_lower)], row_upper[np.isfinite(row_upper)], np.zeros(2 * lower.size)]
    )
    limits = [*zip(lower, upper, strict=True), (0.0, np.inf)]
    result = linprog(
        np.append(np.zeros(lower.size), 1.0), A_ub=a_ub, b_ub=b_ub, bounds=limits, method="highs"
    )
    return np.clip(result.x[:-1], lower, upper) if result.success else None


def _affine_rows(program: FrameProgram, frame: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matrix (n_rows, n_unknowns) and bounds (n_rows,) of the affine rows of a frame, less constants."""
    affine = program.split.affine.frames(np.array([frame]))
    lower, upper = (
        bound[affine.rows] - affine.constant[0] for bound in (program.rows.lower, program.rows.upper)
    )
    return affine.dense(program.layout.size)[0], lower, upper


def _shortfall(program: FrameProgram, frame: int, row: int, amount: float, wants_more: bool) -> Shortfall:
    affine, labels = program.split.affine, program.layout.labels
    block, place = program.rows.find(row)
    here = affine.row == row
    gain = affine.values[frame, here] * (1.0 if wants_more else -1.0)
    best = [labels[affine.column[here][i]] for i in np.argsort(-gain)[:3] if gain[i] > 0]
    return Shortfall(
        frame=frame,
        time=float(program.time[frame]),
        constraint=block.term,
        row=block.label(frame, place),
        amount=amount * block.scale,
        unit=block.unit[place],
        proven=True,
        helpers=tuple(best),
    )
