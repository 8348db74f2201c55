"""The affine rows and bounds of some frames as one system in numbers, for linear programs and for proofs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from scso_nlp.solution import InfeasibilityProof, Shortfall
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import frame_blocks
from scso_nlp.transcription.rows import AffineRows, RowBlock, RowTable
from scso_nlp.validation import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class AffineSystem:
    """Rows of one frame, or of neighbouring frames with those of their pairs.

    Attributes
    ----------
    program : FrameProgram
    frames : ndarray of int
    number : ndarray of int, shape (n_rows, 3)
        Is a row that of a pair (0 or 1), its frame, the later one of a pair, and its number there.
    matrix : sparse array, shape (n_rows, n_frames * n_unknowns)
        Of the scaled unknowns, frame after frame.
    row_lower, row_upper : ndarray, shape (n_rows,)
        Bounds less constants, scaled.
    size : ndarray, shape (n_rows,)
        What the entries of the largest row of its term add up to, see :func:`row_sizes`.
    lower, upper : ndarray, shape (n_frames * n_unknowns,)
    """

    program: FrameProgram
    frames: IntArray
    number: IntArray
    matrix: sp.csr_array
    row_lower: FloatArray
    row_upper: FloatArray
    size: FloatArray
    lower: FloatArray
    upper: FloatArray

    def proof(self, weight: FloatArray) -> InfeasibilityProof:
        """Write down the rows with a weight (n_rows,) as what may be a proof, in the rows' own units."""
        kept = np.flatnonzero(weight)
        kept = kept[np.argsort(-np.abs(weight[kept]) * self.size[kept])]
        blocks = [self._block(int(i)) for i in kept]
        scale = np.array([block.scale for block, _ in blocks])
        matrix = self.matrix[kept].toarray()
        used = np.flatnonzero((matrix != 0).any(axis=0))
        one = self.program.layout
        unit = np.tile(one.scale, self.frames.size)[used]
        frame, which = self.frames[used // one.size], used % one.size
        several = np.unique(self.number[kept, 1]).size > 1
        total = np.abs(weight[kept]) @ self.size[kept]
        return InfeasibilityProof(
            frame=int(self.number[kept[0], 1]),
            frames=tuple(int(k) for k in self.number[kept, 1]),
            time=float(self.program.time[self.number[kept[0], 1]]),
            constraints=tuple(block.term for block, _ in blocks),
            rows=tuple(
                block.label(int(k), place)
                for k, (block, place) in zip(self.number[kept, 1], blocks, strict=True)
            ),
            units=tuple(block.unit[place] for block, place in blocks),
            turns=tuple(
                np.zeros(0) if block.turns is None else block.turns[k, place]
                for k, (block, place) in zip(self.number[kept, 1], blocks, strict=True)
            ),
            multipliers=weight[kept] / scale / (total if total > 0 else 1.0),
            matrix=matrix[:, used] * scale[:, None] / unit,
            row_lower=self.row_lower[kept] * scale,
            row_upper=self.row_upper[kept] * scale,
            size=self.size[kept] * scale,
            unknowns=tuple(
                f"{one.labels[i]} at frame {k}" if several else one.labels[i]
                for k, i in zip(frame, which, strict=True)
            ),
            lower=self.lower[used] * unit,
            upper=self.upper[used] * unit,
        )

    def shortfall(self, row: int, amount: float, wants_more: bool) -> Shortfall:
        """Say by how much (scaled) a row is missed, and what would help."""
        block, place = self._block(row)
        frame = int(self.number[row, 1])
        one = self.program.layout
        gain = self.matrix[[row]].toarray()[0] * (1.0 if wants_more else -1.0)
        best = [one.labels[i % one.size] for i in np.argsort(-gain, kind="stable")[:3] if gain[i] > 0]
        return Shortfall(
            frame=frame,
            time=float(self.program.time[frame]),
            constraint=block.term,
            row=block.label(frame, place),
            amount=amount * block.scale,
            unit=block.unit[place],
            proven=True,
            helpers=tuple(best),
        )

    def _block(self, row: int) -> tuple[RowBlock, int]:
        is_pair, _, number = self.number[row]
        table = self.program.pair_rows if is_pair else self.program.rows
        return table.find(int(number))


def affine_system(program: FrameProgram, frames: IntArray) -> AffineSystem:
    """Collect the affine rows of some frames.

    Parameters
    ----------
    program : FrameProgram
    frames : ndarray of int
        One, or neighbours: then the rows of their pairs are among them.

    Returns
    -------
    AffineSystem
    """
    lower, upper = (bound[frames] for bound in program.bounds())
    size = program.layout.size
    parts = []
    for affine, table, here in (
        (program.split.affine, program.rows, frames),
        (program.split.affine_pairs, program.pair_rows, frames[:-1]),
    ):
        if not here.size or not affine.rows.size:
            continue
        some = affine.frames(here)
        number = np.stack(
            [
                np.full((here.size, affine.rows.size), int(affine.is_pair)),
                np.repeat(here[:, None] + affine.is_pair, affine.rows.size, axis=1),
                np.repeat(affine.rows[None], here.size, axis=0),
            ],
            axis=2,
        )
        parts.append(
            (
                number.reshape(-1, 3),
                sp.csr_array(some.matrix(some.values, size)),
                *((bound[affine.rows] - some.constant).ravel() for bound in (table.lower, table.upper)),
                row_sizes(some, table, lower, upper).ravel(),
            )
        )
    if not parts:
        none, n = np.zeros(0), lower.size
        parts = [(np.zeros((0, 3), dtype=np.int64), sp.csr_array((0, n)), none, none, none)]
    numbers, matrices, row_lower, row_upper, sizes = zip(*parts, strict=True)
    return AffineSystem(
        program=program,
        frames=frames,
        number=np.concatenate(numbers),
        matrix=sp.csr_array(sp.vstack(matrices, format="csr")),
        row_lower=np.concatenate(row_lower),
        row_upper=np.concatenate(row_upper),
        size=np.concatenate(sizes),
        lower=lower.ravel(),
        upper=upper.ravel(),
    )


def row_sizes(affine: AffineRows, table: RowTable, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Say what the entries of the largest row of each row's term add up to at the bounds of a frame.

    Parameters
    ----------
    affine : AffineRows
        Of some frames, or of the pairs of neighbours among them.
    table : RowTable
        That they are part of.
    lower, upper : ndarray, shape (n_frames, n_unknowns)
        Infinite ones do not count.

    Returns
    -------
    ndarray, shape (n_frames or n_pairs, n_affine_rows)
    """
    largest = np.maximum(*(np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (lower, upper)))
    if affine.is_pair:
        largest = np.hstack([largest[:-1], largest[1:]])
    own = np.zeros(affine.constant.shape)
    for part in frame_blocks(len(own)):
        own[part] = affine.by_row(np.abs(affine.values[part]) * largest[part, affine.column])
    bounds = [np.abs(bound[affine.rows] - affine.constant) for bound in (table.lower, table.upper)]
    own += np.maximum(*(np.where(np.isfinite(bound), bound, 0.0) for bound in bounds))
    terms = table.term[affine.rows]
    for term in set(terms):
        same = terms == term
        own[:, same] = own[:, same].max(axis=1, keepdims=True)
    return own
