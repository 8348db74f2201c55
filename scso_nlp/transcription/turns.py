r"""Matrix inequalities in numbers, and the rows :math:`v^T H v` of chosen turns v as part of a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import Derivatives, Key, Piece, curved, first_order
from scso_nlp.transcription.rows import MatrixBlock, RowBlock, RowTable
from scso_nlp.validation import FloatArray, IntArray

#: Frames whose rows are computed together; bounds the memory.
_FRAMES_AT_ONCE = 64


@dataclass(frozen=True, kw_only=True)
class MatrixModel:
    """A matrix inequality as functions of the scaled unknowns: G = H - diag(lower) + missed 1."""

    block: MatrixBlock
    derivatives: Derivatives
    is_affine: bool

    def value(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> FloatArray:
        """G in every frame, shape (n_frames, n, n)."""
        return self._lowered(self.block.piece.values(unknowns, arrays), unknowns)

    def model(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """G and its derivatives by the unknowns, shapes (n_frames, n, n) and (n_frames, size, n, n)."""
        entries, slopes = self.derivatives.at(unknowns, arrays)
        n_frames, size = unknowns.shape
        triangle = np.zeros((n_frames, size, entries.shape[1]))
        triangle[:, self.derivatives.column, self.derivatives.row] = slopes
        matrices = self.block.filled(triangle)
        if self.block.missed is not None:
            matrices[:, self.block.missed] += self.block.scale * np.eye(len(self.block.names))
        return self._lowered(entries, unknowns), matrices

    def _lowered(self, entries: FloatArray, unknowns: FloatArray) -> FloatArray:
        block = self.block
        matrix = block.filled(entries) - np.diag(block.lower)
        if block.missed is not None:
            matrix += (block.scale * unknowns[:, block.missed])[:, None, None] * np.eye(len(block.names))
        return matrix


def entry_sizes(constant: FloatArray, matrices: FloatArray, unknowns: FloatArray) -> FloatArray:
    """Add up the largest entry of K + sum x_i G_i, signs aside, shape (n_frames,)."""
    parts = np.abs(constant) + np.einsum("kxij,kx->kij", np.abs(matrices), np.abs(unknowns))
    return np.asarray(parts.max(axis=(1, 2)))


def matrix_sizes(program: FrameProgram, model: MatrixModel, unknowns: FloatArray) -> FloatArray:
    """Add up the largest entry of a matrix inequality at unknowns, signs aside, shape (n_frames,)."""
    sizes = []
    for start in range(0, len(unknowns), _FRAMES_AT_ONCE):
        here = unknowns[start : start + _FRAMES_AT_ONCE]
        value, matrices = model.model(here, part_of(program, np.arange(start, start + len(here))))
        sizes.append(entry_sizes(value - np.einsum("kxij,kx->kij", matrices, here), matrices, here))
    return np.concatenate(sizes)


def matrix_models(program: FrameProgram) -> tuple[MatrixModel, ...]:
    """Make the functions of all matrix inequalities of a program."""
    return tuple(
        MatrixModel(
            block=block,
            derivatives=first_order(block.piece),
            is_affine=not any(curved(block.piece.expression, block.piece.all_unknowns)),
        )
        for block in program.matrices
    )


def with_turns(
    program: FrameProgram, models: tuple[MatrixModel, ...], turns: tuple[FloatArray, ...]
) -> FrameProgram:
    r"""Add rows :math:`v^T G\, v \ge 0` to a program; its own rows and its symbols stay.

    Parameters
    ----------
    program : FrameProgram
        As described.
    models : tuple of MatrixModel
        Of its matrix inequalities.
    turns : tuple of ndarray, shape (n_frames, n_turns, n) [-]
        Unit vectors v; zero where a frame has fewer.

    Returns
    -------
    FrameProgram
    """
    for model, chosen in zip(models, turns, strict=True):
        program = _with_turns_of(program, model, chosen)
    return program


def _with_turns_of(program: FrameProgram, model: MatrixModel, turns: FloatArray) -> FrameProgram:
    block, n_turns, first = model.block, turns.shape[1], len(program.rows)
    rows = RowBlock(
        term=block.term,
        names=tuple(f"turn_{i + 1}" for i in range(n_turns)),
        unit=(block.unit,) * n_turns,
        lower=np.zeros(n_turns),
        upper=np.full(n_turns, np.inf),
        scale=block.scale,
        directions=block.names,
        turns=turns,
    )
    arrays, split = program.arrays, program.split
    if model.is_affine:
        dense, constant = _affine_turns(program, model, turns)
        split = replace(split, affine=split.affine.with_rows(first, dense, constant))
    else:
        key = (block.term, "turns")
        arrays = {**arrays, key: turns}
        nonlinear = (_curved_turns(block, n_turns, key), first + np.arange(n_turns))
        split = replace(split, nonlinear=(*split.nonlinear, nonlinear))
    return replace(program, rows=RowTable((*program.rows.blocks, rows)), arrays=arrays, split=split)


def _affine_turns(
    program: FrameProgram, model: MatrixModel, turns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Scaled coefficients (n_frames, n_turns, size) and constants (n_frames, n_turns) of the rows."""
    n_frames, n_turns, n = turns.shape
    dense, constant = np.zeros((n_frames, n_turns, program.layout.size)), np.zeros((n_frames, n_turns))
    for start in range(0, n_frames, _FRAMES_AT_ONCE):
        part = slice(start, start + _FRAMES_AT_ONCE)
        arrays = part_of(program, np.arange(n_frames)[part])
        here = turns[part]
        value, matrices = model.model(np.zeros((len(here), program.layout.size)), arrays)
        constant[part] = np.einsum("kri,kij,krj->kr", here, value, here, optimize=True)
        products = (here[:, :, :, None] * here[:, :, None, :]).reshape(len(here), n_turns, n * n)
        dense[part] = products @ matrices.reshape(len(here), program.layout.size, n * n).transpose(0, 2, 1)
    return dense / model.block.scale, constant / model.block.scale


def part_of(program: FrameProgram, frames: IntArray) -> dict[Key, FloatArray]:
    """Keep the data of some frames; data of pairs are left out."""
    return {key: array[frames] for key, array in program.arrays.items() if len(array) == program.time.size}


def _curved_turns(block: MatrixBlock, n_turns: int, key: Key) -> Piece:
    """Write the rows down as expressions, divided by their scale; a row without a turn is kept by 1."""
    piece, n = block.piece, len(block.names)
    turns = ca.SX.sym("turns", n_turns, n)
    matrix = ca.tril2symm(ca.SX(ca.Sparsity.lower(n), ca.densify(piece.expression))) - ca.diag(
        ca.DM(block.lower)
    )
    if block.missed is not None:
        matrix += block.scale * piece.unknowns[0][block.missed] * ca.SX.eye(n)
    value = ca.sum2((turns @ matrix) * turns)
    absent = 1 - ca.sum2(turns * turns)
    return replace(
        piece,
        expression=value / block.scale + absent,
        data=(*piece.data, (0, key)),
        symbols=(*piece.symbols, turns),
    )
