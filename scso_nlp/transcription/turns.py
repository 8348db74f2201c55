r"""Matrix inequalities in numbers, and the rows :math:`v^T H v` of chosen turns v as part of a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.layout import Given
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
        weights = self.block.piece.values(unknowns, arrays)
        return self.block.filled(self._entries(weights, unknowns, arrays))

    def model(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """G and its derivatives by the unknowns, shapes (n_frames, n, n) and (n_frames, size, n, n)."""
        entries, slopes = self.triangle(unknowns, arrays)
        return self.block.filled(entries), self.block.filled(slopes.transpose(0, 2, 1))

    def triangle(
        self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Lower triangle of G and its derivatives, shapes (n_frames, n_entries) and (…, n_entries, size)."""
        weights, changes = self.derivatives.at(unknowns, arrays)
        slopes = self._by_unknowns(arrays[self.block.matrices], changes)
        if self.block.missed is not None:
            slopes[:, self._on_diagonal, self.block.missed] += self.block.scale
        return self._entries(weights, unknowns, arrays), slopes

    def along(
        self, turns: FloatArray, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Products v'Gv with turns (n_frames, n_turns, n), and derivatives (n_frames, n_turns, size)."""
        products = self.products(turns)
        weights, changes = self.derivatives.at(unknowns, arrays)
        entries = self._entries(weights, unknowns, arrays)
        slopes = self._by_unknowns(products @ arrays[self.block.matrices], changes)
        if self.block.missed is not None:
            slopes[:, :, self.block.missed] += self.block.scale * (turns * turns).sum(axis=2)
        return (products @ entries[:, :, None])[:, :, 0], slopes

    def products(self, turns: FloatArray, others: FloatArray | None = None) -> FloatArray:
        """By what each entry of a lower triangle counts in v'Gv, or v'Gw: (…, n_turns, n_entries)."""
        row, column = self.block.triangle
        others = turns if others is None else others
        one = turns[..., row] * others[..., column]
        return np.where(row == column, one, one + turns[..., column] * others[..., row])

    @property
    def _on_diagonal(self) -> IntArray:
        row, column = self.block.triangle
        return np.flatnonzero(row == column)

    def _by_unknowns(self, by_weights: FloatArray, changes: FloatArray) -> FloatArray:
        """Multiply (n_frames, m, n_weights) by the Jacobian of the weights: (n_frames, m, size)."""
        weight, unknown = self.derivatives.row, self.derivatives.column
        result = np.zeros((*by_weights.shape[:2], self.block.piece.unknowns[0].numel()))
        # unknowns stand in ascending order: the first weight of each, then the second, and so on
        rank = np.arange(unknown.size) - np.searchsorted(unknown, unknown)
        for i in range(int(rank.max(initial=-1)) + 1):
            here = np.flatnonzero(rank == i)
            result[:, :, unknown[here]] += by_weights[:, :, weight[here]] * changes[:, None, here]
        return result

    def _entries(
        self, weights: FloatArray, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]
    ) -> FloatArray:
        block = self.block
        entries = block.entries(weights, arrays)
        entries[:, self._on_diagonal] -= block.lower
        if block.missed is not None:
            entries[:, self._on_diagonal] += block.scale * unknowns[:, block.missed, None]
        return entries


def matrix_sizes(
    program: FrameProgram, model: MatrixModel, unknowns: FloatArray, frames: IntArray
) -> FloatArray:
    """Add up the largest entry of a matrix inequality at unknowns of some frames, signs aside."""
    sizes = np.zeros(frames.size)
    for start in range(0, frames.size, _FRAMES_AT_ONCE):
        part = slice(start, start + _FRAMES_AT_ONCE)
        here = unknowns[part]
        value, slopes = model.triangle(here, part_of(program, frames[part]))
        constant = value - (slopes @ here[:, :, None])[:, :, 0]
        each = np.abs(constant) + (np.abs(slopes) @ np.abs(here)[:, :, None])[:, :, 0]
        sizes[part] = each.max(axis=1)
    return sizes


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
        products = model.products(turns)
        new = {
            (block.term, "turned matrices"): products @ arrays[block.matrices] / block.scale,
            (block.term, "turned constant"): _turned_constant(model, arrays, turns),
        }
        arrays = {**arrays, **new}
        nonlinear = (_curved_turns(block, n_turns, tuple(new)), first + np.arange(n_turns))
        split = replace(split, nonlinear=(*split.nonlinear, nonlinear))
    return replace(program, rows=RowTable((*program.rows.blocks, rows)), arrays=arrays, split=split)


def _affine_turns(
    program: FrameProgram, model: MatrixModel, turns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Scaled coefficients (n_frames, n_turns, size) and constants (n_frames, n_turns) of the rows."""
    n_frames, n_turns = turns.shape[:2]
    dense, constant = np.zeros((n_frames, n_turns, program.layout.size)), np.zeros((n_frames, n_turns))
    for start in range(0, n_frames, _FRAMES_AT_ONCE):
        part = slice(start, start + _FRAMES_AT_ONCE)
        here, arrays = turns[part], part_of(program, np.arange(n_frames)[part])
        zero = np.zeros((len(here), program.layout.size))
        constant[part], dense[part] = model.along(here, zero, arrays)
    return dense / model.block.scale, constant / model.block.scale


def part_of(program: FrameProgram, frames: IntArray) -> dict[Key, FloatArray]:
    """Keep the data of some frames; data of pairs are left out."""
    return {key: array[frames] for key, array in program.arrays.items() if len(array) == program.time.size}


def _turned_constant(model: MatrixModel, arrays: Mapping[Key, FloatArray], turns: FloatArray) -> FloatArray:
    """Give what rows have besides their weights, scaled, (n_frames, n_turns); 1 for rows without a turn."""
    block = model.block
    own = (model.products(turns) @ arrays[block.constant][:, :, None])[:, :, 0] - (turns**2) @ block.lower
    return own / block.scale + (turns == 0).all(axis=2)


def _curved_turns(block: MatrixBlock, n_turns: int, keys: tuple[Key, ...]) -> Piece:
    """Write the rows down as expressions, divided by their scale, with the arrays of the given names."""
    piece = block.piece
    n_weights = piece.expression.numel()
    symbols = ca.SX.sym("matrices", n_turns * n_weights), ca.SX.sym("constant", n_turns)
    value = ca.reshape(symbols[0], n_weights, n_turns).T @ piece.expression + symbols[1]
    if block.missed is not None:
        value += piece.unknowns[0][block.missed]
    return replace(
        piece,
        expression=value,
        given=(*piece.given, *(Given(key=key, symbol=s) for key, s in zip(keys, symbols, strict=True))),
    )
