"""Judge a result from the arrays that the user receives, and say what a failed frame lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import linprog

from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.solution import RowResult, Shortfall
from scso_nlp.transcription.build import AffineRows, FrameProgram, bounds_of_rows, evaluate
from scso_nlp.transcription.layout import ALL
from scso_nlp.validation import BoolArray, FloatArray

#: A row or bound may be missed by this much of its scale before a frame counts as infeasible [-].
FEASIBILITY_TOLERANCE = 1e-6


def row_results(
    program: FrameProgram, unknowns: FloatArray, multipliers: tuple[FloatArray, FloatArray]
) -> dict[str, RowResult]:
    """Evaluate all rows, unscaled, at physical unknowns (n_frames, size).

    Returns
    -------
    dict of str to RowResult
        By term name; a term's blocks are joined.
    """
    scaled = unknowns / program.layout.scale
    results: dict[str, RowResult] = {}
    start = [0, 0]
    for block, piece in zip(program.row_blocks, program.rows, strict=True):
        n = len(block.names)
        value = evaluate(piece, piece.function(), scaled, program.arrays)[0]
        raw = multipliers[block.is_pair][:, start[block.is_pair] : start[block.is_pair] + n] / block.scale
        start[block.is_pair] += n
        # An active lower bound has a negative multiplier in the solver's sign convention.
        multiplier = np.where(block.lower == block.upper, -raw, np.abs(raw))
        if block.is_pair:
            gap = np.full((1, n), np.nan)
            value, multiplier = np.vstack([gap, value]), np.vstack([gap, multiplier])
        new = RowResult(
            names=block.names,
            unit=block.unit,
            value=value,
            lower=block.lower,
            upper=block.upper,
            multiplier=multiplier,
        )
        results[block.term] = _joined(results[block.term], new) if block.term in results else new
    return results


def violations(
    program: FrameProgram, unknowns: FloatArray, rows: Mapping[str, RowResult], solved: BoolArray
) -> dict[str, float]:
    """Largest violation over the solved frames, by constraint name, in the row's own unit."""
    result = {name: 0.0 for name in rows} | {"bounds": 0.0}
    if not solved.any():
        return {name: float("nan") for name in result}
    for name, row in rows.items():
        result[name] = float(np.nanmax(_missing(row)[solved], initial=0.0))
    lower, upper = (program.layout.rows(what, len(unknowns)) for what in ("lower", "upper"))
    outside = np.maximum(lower - unknowns, unknowns - upper)[solved]
    result["bounds"] = float(outside.max(initial=0.0))
    return result


def scaled_violation(
    program: FrameProgram, rows: Mapping[str, RowResult], unknowns: FloatArray
) -> FloatArray:
    """Largest violation of each frame over the scale of its row, shape (n_frames,)."""
    scales = {block.term: block.scale for block in program.row_blocks}
    worst = np.zeros(len(unknowns))
    for name, row in rows.items():
        missing = np.nan_to_num(_missing(row)) / scales[name]
        worst = np.maximum(worst, missing.max(axis=1, initial=0.0))
    return worst


def worst_rows(
    program: FrameProgram, rows: Mapping[str, RowResult], frames: Sequence[int], per_frame: int = 3
) -> list[Shortfall]:
    """Rows that the last iterate of failed frames misses most."""
    scales = {block.term: block.scale for block in program.row_blocks}
    found: list[tuple[float, Shortfall]] = []
    for k in frames:
        here = []
        for name, row in rows.items():
            missing = np.nan_to_num(_missing(row)[k])
            for r in np.argsort(-missing)[:per_frame]:
                if missing[r] / scales[name] > FEASIBILITY_TOLERANCE:
                    shortfall = Shortfall(
                        frame=k,
                        time=float(program.problem.trajectory.time[k]),
                        constraint=name,
                        row=_row_label(program, name, k, int(r), row.names[r]),
                        amount=float(missing[r]),
                        unit=row.unit[r],
                        proven=False,
                    )
                    here.append((missing[r] / scales[name], shortfall))
        found += sorted(here, key=lambda entry: -entry[0])[:per_frame]
    return [s for _, s in sorted(found, key=lambda entry: -entry[0])]


def out_of_reach(program: FrameProgram, affine: AffineRows) -> list[Shortfall]:
    """Rows that no unknowns within their bounds can reach, each taken alone.

    Interval arithmetic over the affine rows: cheap, necessary, not sufficient; :func:`infeasible_rows`
    is the exact test of all rows together.
    """
    lower, upper = _scaled_bounds(program)
    n = len(affine.values)
    low_x, high_x = lower[:n, affine.column], upper[:n, affine.column]
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
    row_lower, row_upper = bounds_of_rows(program, pair=False)
    found = []
    for i, r in enumerate(affine.rows):
        constant = affine.constant[:, i]
        short = np.maximum(
            row_lower[r] - (sums[1][:, r] + constant), (sums[0][:, r] + constant) - row_upper[r]
        )
        for k in np.flatnonzero(short > FEASIBILITY_TOLERANCE):
            wants_more = bool(row_lower[r] > sums[1][k, r] + constant[k])
            found.append(
                (float(short[k]), _shortfall(program, affine, int(k), int(r), float(short[k]), wants_more))
            )
    return [s for _, s in sorted(found, key=lambda entry: -entry[0])]


def infeasible_rows(program: FrameProgram, affine: AffineRows, frame: int) -> list[Shortfall]:
    """Find the least total violation of the affine rows of one frame by a linear program.

    Returns
    -------
    list of Shortfall
        Empty if all rows can be kept together; otherwise the rows that the best compromise misses.
    """
    lower, upper = (b[0] for b in _scaled_bounds(program, slice(frame, frame + 1)))
    n_rows, n_x = affine.rows.size, program.layout.size
    position = np.full(int(affine.rows.max(initial=-1)) + 1, -1)
    position[affine.rows] = np.arange(n_rows)
    matrix = np.zeros((n_rows, n_x))
    matrix[position[affine.row], affine.column] = affine.values[frame]
    row_lower, row_upper = (
        b[affine.rows] - affine.constant[frame] for b in bounds_of_rows(program, pair=False)
    )
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
            program, affine, frame, int(affine.rows[i]), float(max(short[i], excess[i])), short[i] > excess[i]
        )
        for i in order
        if max(short[i], excess[i]) > FEASIBILITY_TOLERANCE
    ]


def _scaled_bounds(program: FrameProgram, frames: slice = ALL) -> tuple[FloatArray, FloatArray]:
    layout, n = program.layout, program.problem.trajectory.n_frames
    return layout.rows("lower", n, frames) / layout.scale, layout.rows("upper", n, frames) / layout.scale


def _shortfall(
    program: FrameProgram, affine: AffineRows, frame: int, row: int, amount: float, wants_more: bool
) -> Shortfall:
    blocks = [block for block in program.row_blocks if not block.is_pair]
    start = 0
    for block in blocks:
        if row < start + len(block.names):
            break
        start += len(block.names)
    labels = program.layout.labels
    here = affine.row == row
    gain = affine.values[frame, here] * (1.0 if wants_more else -1.0)
    best = [labels[affine.column[here][i]] for i in np.argsort(-gain)[:3] if gain[i] > 0]
    return Shortfall(
        frame=frame,
        time=float(program.problem.trajectory.time[frame]),
        constraint=block.term,
        row=_row_label(program, block.term, frame, row - start, block.names[row - start]),
        amount=amount * block.scale,
        unit=block.unit[row - start],
        proven=True,
        helpers=tuple(best),
    )


def _row_label(program: FrameProgram, term: str, frame: int, row: int, name: str) -> str:
    """Name a row in one frame: by its own words where the term has any."""
    for constraint in program.problem.constraints:
        if constraint.name == term and isinstance(constraint, FrameConstraint):
            return constraint.row_label(program.problem, frame, row) or name
    return name


def _missing(row: RowResult) -> FloatArray:
    return np.maximum(np.maximum(row.lower - row.value, row.value - row.upper), 0.0)


def _joined(first: RowResult, second: RowResult) -> RowResult:
    return RowResult(
        names=first.names + second.names,
        unit=first.unit + second.unit,
        value=np.hstack([first.value, second.value]),
        lower=np.concatenate([first.lower, second.lower]),
        upper=np.concatenate([first.upper, second.upper]),
        multiplier=np.hstack([first.multiplier, second.multiplier]),
    )
