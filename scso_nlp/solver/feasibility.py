"""What a frame cannot keep: rows proven to contradict each other, and rows that an iterate misses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from scso_nlp.solution import InfeasibilityProof, MatrixResult, RowResult, Shortfall
from scso_nlp.solver.affine_system import affine_system, row_sizes
from scso_nlp.stability.hessian import describe_turn
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import frame_blocks
from scso_nlp.validation import FloatArray, IntArray

#: A row or bound may be missed by this much of its scale before a frame counts as infeasible [-].
FEASIBILITY_TOLERANCE = 1e-6

#: Residuals at which HiGHS stops, of rows divided by what their entries add up to: its least [-].
_HIGHS_TOLERANCE = 1e-10

#: Rows with less than this share of the largest part in a contradiction are left out where it may be [-].
_LEAST_PART = 1e-7


@dataclass(frozen=True, kw_only=True)
class Impossible:
    """Rows that contradict each other: the proof, and what the best compromise misses, worst first."""

    proof: InfeasibilityProof
    shortfalls: tuple[Shortfall, ...]


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


def out_of_reach(program: FrameProgram) -> dict[int, Impossible]:
    """Find frames with rows that no unknowns within their bounds can reach, each row taken alone.

    Interval arithmetic over the affine rows: cheap, necessary, not sufficient; :func:`contradiction` is the
    exact test of all rows together.

    Returns
    -------
    dict of int to Impossible
        By frame; the proof is that of the row which is missed by most of its size.
    """
    affine, (lower, upper) = program.split.affine, program.bounds()
    sums = [np.zeros(affine.constant.shape), np.zeros(affine.constant.shape)]
    for part in frame_blocks(len(lower)):
        values = affine.values[part]
        # a zero entry has no part in its row, even where the bound is infinite
        at_low, at_high = (
            np.multiply(values, bound[part, affine.column], where=values != 0, out=np.zeros_like(values))
            for bound in (lower, upper)
        )
        sums[0][part] = affine.by_row(np.minimum(at_low, at_high))
        sums[1][part] = affine.by_row(np.maximum(at_low, at_high))
    least, most = (bound[affine.rows] - affine.constant for bound in (program.rows.lower, program.rows.upper))
    below, above = least - sums[1], sums[0] - most
    short = np.maximum(below, above)
    size = row_sizes(affine, program.rows, lower, upper)
    share = short / np.where(size > 0, size, 1.0)
    found = {}
    for k in np.flatnonzero((share > InfeasibilityProof.PROVEN).any(axis=1)):
        system = affine_system(program, np.array([k]))
        worst = int(share[k].argmax())
        weight = np.zeros(affine.rows.size)
        weight[worst] = 1.0 if below[k, worst] > 0 else -1.0
        proof = system.proof(weight)
        if proof.holds:
            rows = np.flatnonzero(share[k] > InfeasibilityProof.PROVEN)
            found[int(k)] = Impossible(
                proof=proof,
                shortfalls=tuple(
                    system.shortfall(int(i), float(short[k, i]), below[k, i] > 0)
                    for i in rows[np.argsort(-short[k, rows])]
                ),
            )
    return found


def contradiction(program: FrameProgram, frames: IntArray) -> Impossible | None:
    """Find the least total violation of the affine rows of some frames by a linear program.

    Parameters
    ----------
    program : FrameProgram
    frames : ndarray of int
        One, or neighbours: then the rows of their pairs are looked at too.

    Returns
    -------
    Impossible or None
        None where all rows can be kept together, or where it is not proven that they cannot.

    Notes
    -----
    The dual solution are Farkas' multipliers. They are believed for what they give when multiplied out, see
    :attr:`InfeasibilityProof.margin`.
    """
    system = affine_system(program, frames)
    n_rows, n = system.matrix.shape
    size = np.where(system.size > 0, system.size, 1.0)
    matrix = sp.diags_array(1 / size) @ system.matrix
    low, high = system.row_lower / size, system.row_upper / size
    above, below = np.isfinite(low), np.isfinite(high)
    eye = sp.eye_array(n_rows, format="csr")
    nothing = sp.csr_array((n_rows, n_rows))
    answer = linprog(
        np.concatenate([np.zeros(n), size, size]) / size.max(initial=1e-300),
        A_ub=sp.vstack(
            [
                sp.hstack([-matrix, -eye, nothing], format="csr")[above],
                sp.hstack([matrix, nothing, -eye], format="csr")[below],
            ]
        ),
        b_ub=np.concatenate([-low[above], high[below]]),
        bounds=np.column_stack(
            [
                np.append(system.lower, np.zeros(2 * n_rows)),
                np.append(system.upper, np.full(2 * n_rows, np.inf)),
            ]
        ),
        method="highs",
        options={
            "primal_feasibility_tolerance": _HIGHS_TOLERANCE,
            "dual_feasibility_tolerance": _HIGHS_TOLERANCE,
        },
    )
    if not answer.success or answer.fun <= 0:
        return None
    weight = np.zeros(n_rows)
    prices = -answer.ineqlin.marginals
    weight[above] += np.maximum(prices[: above.sum()], 0)
    weight[below] -= np.maximum(prices[above.sum() :], 0)
    part = np.abs(weight)
    proof = system.proof(np.where(part > _LEAST_PART * part.max(), weight, 0) / size)
    if not proof.holds:
        proof = system.proof(weight / size)
    if not proof.holds:
        return None
    short, excess = (answer.x[n:] * np.tile(size, 2)).reshape(2, -1)
    miss = np.maximum(short, excess)
    return Impossible(
        proof=proof,
        shortfalls=tuple(
            system.shortfall(int(i), float(miss[i]), short[i] > excess[i])
            for i in np.argsort(-miss)
            if miss[i] > InfeasibilityProof.PROVEN * size[i]
        ),
    )


def least_effort(
    program: FrameProgram, frame: int, bounds: tuple[FloatArray, FloatArray]
) -> FloatArray | None:
    """Keep the affine rows of one frame with the least largest unknown, by a linear program.

    The optimum of a sum of powers p of n unknowns has at most :math:`n^{1/p}` times this largest unknown,
    so it gives the frame's scale.

    Parameters
    ----------
    program : FrameProgram
    frame : int
    bounds : pair of ndarray, shape (n_unknowns,)
        Of the scaled unknowns.

    Returns
    -------
    ndarray or None, shape (n_unknowns,)
        Scaled; None where there is none, or where the program has rows that are not affine.
    """
    if program.split.nonlinear:
        return None
    system = affine_system(program, np.array([frame]))
    used = ~program.split.affine.is_empty[frame]
    matrix = system.matrix.toarray()[used]
    size = np.abs(matrix).max(axis=1, initial=0.0)
    matrix, low, high = (matrix / size[:, None], system.row_lower[used] / size, system.row_upper[used] / size)
    above, below = np.isfinite(low), np.isfinite(high)
    # HiGHS's tolerances are absolute: rows and what they ask for are brought near one.
    unit = np.abs(np.concatenate([low[above], high[below]])).max(initial=0.0) or 1.0
    eye, one = np.eye(system.lower.size), np.ones((system.lower.size, 1))
    nothing = np.zeros((len(matrix), 1))
    result = linprog(
        np.append(np.zeros(system.lower.size), 1.0),
        A_ub=np.vstack(
            [
                np.hstack([-matrix, nothing])[above],
                np.hstack([matrix, nothing])[below],
                np.hstack([eye, -one]),
                np.hstack([-eye, -one]),
            ]
        ),
        b_ub=np.concatenate([-low[above] / unit, high[below] / unit, np.zeros(2 * system.lower.size)]),
        bounds=np.column_stack([np.append(bounds[0] / unit, 0.0), np.append(bounds[1] / unit, np.inf)]),
        method="highs",
    )
    return np.clip(unit * result.x[:-1], *bounds) if result.success else None
