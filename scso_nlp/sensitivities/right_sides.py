"""What a change of given numbers does to the conditions of an optimum while the unknowns stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.sensitivities.conditions import Conditions
from scso_nlp.sensitivities.parameters import Changes
from scso_nlp.sensitivities.turned import Turned
from scso_nlp.transcription.by_data import Slopes, by_data_and_unknowns, mixed_by_data
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import Piece, Seen, evaluate
from scso_nlp.transcription.rows import MatrixBlock
from scso_nlp.validation import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class RightSides:
    """Changes per unit of each parameter at fixed unknowns and multipliers.

    Attributes
    ----------
    lagrangian : ndarray, shape (n_frames * size, n_parameters)
        Of its gradient.
    rows : ndarray, shape (n_all_rows, n_parameters)
        Of rows less their active bounds; rows of matrices behind the others.
    values : ndarray, shape (n_rows, n_parameters)
        Of rows alone.
    objective : ndarray, shape (n_frames, n_parameters)
        Of the optimal objective: of the Lagrangian, by the frame that it stands in.
    matrices : tuple of ndarray, shape (n_frames, n_entries, n_parameters)
        Of the matrices less their levels.
    tendon_force : ndarray, shape (n_frames, n_muscles, n_parameters)
    tendon_force_slopes : (muscles, unknowns, entries)
        Derivatives of tendon forces by unknowns: entries (n_frames, n_entries) with the places of their
        muscles and unknowns.
    """

    lagrangian: FloatArray
    rows: FloatArray
    values: FloatArray
    objective: FloatArray
    matrices: tuple[FloatArray, ...]
    tendon_force: FloatArray
    tendon_force_slopes: tuple[IntArray, IntArray, FloatArray]


def right_sides(conditions: Conditions, program: FrameProgram, changes: Changes) -> RightSides:
    """Evaluate how the conditions change with the given numbers, exactly.

    Parameters
    ----------
    conditions : Conditions
        Settled.
    program : FrameProgram
        Of the same problem, with symbols for what changes.
    changes : Changes

    Returns
    -------
    RightSides
    """
    return _RightSides(conditions, program, changes).collected()


class _RightSides:
    def __init__(self, conditions: Conditions, program: FrameProgram, changes: Changes) -> None:
        self.conditions, self.changes = conditions, changes
        self.program, self.point = program, conditions.point
        self.n, self.size = conditions.n, conditions.size
        self.seen: dict[bool, Seen] = {}
        self.n_parameters = changes.lower.shape[1]
        self.lagrangian = np.zeros((self.n * self.size, self.n_parameters))
        self.objective = np.zeros((self.n, self.n_parameters))
        self.values = np.zeros((conditions.frame_of_row.size, self.n_parameters))

    def collected(self) -> RightSides:
        """Go through objectives, rows and matrices."""
        for name, piece in self.program.objectives:
            self._cost(piece, self.changes.costs[name])
        for is_pair, table in enumerate((self.program.rows, self.program.pair_rows)):
            for block, where in table:
                assert block.piece is not None
                if not block.piece.depends_on(self.changes.used):
                    continue
                piece = replace(block.piece, expression=block.piece.expression / block.scale)
                places = self.conditions.places(is_pair, np.arange(where.start, where.stop))
                self._add(self.values, piece, places, self.point.row[places])
        rows = self.values.copy()
        if self.changes.lower.any():
            places = self.conditions.places(0, np.arange(len(self.program.rows)))
            is_at_lower = np.isin(self.conditions.at_row[places], (-1, 2))
            rows[places] -= is_at_lower[:, :, None] * self.changes.lower
        first, n_rows = self.conditions.first, self.conditions.n_rows
        for is_pair in (0, 1):
            own = slice(first[is_pair], first[is_pair] + (self.n - is_pair) * n_rows[is_pair])
            counted = self.point.row[own, None] * rows[own]
            self.objective[is_pair:] += counted.reshape(
                self.n - is_pair, n_rows[is_pair], self.n_parameters
            ).sum(axis=1)
        of_matrices = [
            self._matrix(turned, block)
            for turned, block in zip(self.conditions.turned, self.program.matrices, strict=True)
        ]
        piece = self.program.tendon_force
        slopes, tendon_force_slopes = by_data_and_unknowns(piece, self.changes.used, self._seen(piece))
        n_muscles = piece.expression.numel()
        places = np.arange(self.n * n_muscles).reshape(self.n, n_muscles)
        tendon_force = np.zeros((places.size, self.n_parameters))
        _add_product(tendon_force, slopes, self.changes, places)
        return RightSides(
            lagrangian=self.lagrangian,
            rows=np.concatenate([rows, *(rows_of for _, rows_of in of_matrices)]),
            values=self.values,
            objective=self.objective,
            matrices=tuple(entries for entries, _ in of_matrices),
            tendon_force=tendon_force.reshape(self.n, n_muscles, -1),
            tendon_force_slopes=tendon_force_slopes,
        )

    def _seen(self, piece: Piece) -> Seen:
        """Give what all pieces of one frame, or all of two, see."""
        if piece.is_pair not in self.seen:
            self.seen[piece.is_pair] = Seen.by(piece, self.point.x, self.program.arrays)
        return self.seen[piece.is_pair]

    def _unknowns(self, piece: Piece) -> IntArray:
        """Places of the unknowns that each frame or pair of a piece sees."""
        n = self.n - piece.is_pair
        return np.arange(n)[:, None] * self.size + np.arange(self.size * len(piece.unknowns))

    def _cost(self, piece: Piece, factor: FloatArray) -> None:
        frames = np.arange(self.n - piece.is_pair)
        if piece.depends_on(self.changes.used):
            self._add(self.objective, piece, frames[:, None])
        if factor.any():
            arrays = self.program.arrays
            self.objective[frames] += piece.values(self.point.x, arrays) * factor
            slope = evaluate(piece, piece.slope(), self.point.x, arrays)[0]
            np.add.at(self.lagrangian, self._unknowns(piece).ravel(), slope.reshape(-1, 1) * factor)

    def _add(
        self, target: FloatArray, piece: Piece, places: IntArray, multipliers: FloatArray | None = None
    ) -> None:
        """Add what parameters change of a piece to places (n, n_rows) of a target, and of its gradient."""
        of_rows, of_gradient = mixed_by_data(piece, self.changes.used, self._seen(piece), multipliers)
        _add_product(target, of_rows, self.changes, places)
        _add_product(self.lagrangian, of_gradient, self.changes, self._unknowns(piece))

    def _matrix(self, turned: Turned, block: MatrixBlock) -> tuple[FloatArray, FloatArray]:
        """Change of a matrix less its levels, and of its rows; that of the Lagrangian is added."""
        model, arrays = turned.model, self.program.arrays
        weights, by_unknowns = model.derivatives.at(self.point.x, arrays)
        n_weights, matrices = weights.shape[1], arrays[block.matrices]
        keys = self.changes.used
        places = np.arange(self.n * n_weights).reshape(self.n, n_weights)
        of_rows, of_gradient = mixed_by_data(
            block.piece, keys, self._seen(block.piece), turned.by_weights(arrays)
        )
        of_weights = np.zeros((places.size, self.n_parameters))
        _add_product(of_weights, of_rows, self.changes, places)
        entries = matrices @ of_weights.reshape(self.n, n_weights, -1)
        counted = turned.weights
        if block.matrices in keys:
            change = self.changes.arrays[block.matrices].toarray().reshape(*matrices.shape, -1)
            entries += np.einsum("kewp,kw->kep", change, weights)
            pushed = np.einsum("kewp,ke->kwp", change, counted)
            row, column = model.derivatives.row, model.derivatives.column
            place = np.arange(self.n)[:, None] * self.size + column
            np.add.at(self.lagrangian, place, -pushed[:, row] * by_unknowns[:, :, None])
        if block.constant in keys:
            entries += self.changes.arrays[block.constant].toarray().reshape(*entries.shape)
        row, column = block.triangle
        entries -= np.where((row == column)[:, None], self.changes.levels[block.term][row], 0.0)
        of_gradient = [replace(slopes, values=-slopes.values) for slopes in of_gradient]
        _add_product(self.lagrangian, of_gradient, self.changes, self._unknowns(block.piece))
        bend = turned.bend @ turned.slopes
        self.lagrangian += (bend.transpose(0, 2, 1) @ (turned.bend @ entries)).reshape(
            len(self.lagrangian), -1
        )
        self.objective -= np.einsum("ke,kep->kp", counted, entries)
        return entries, (turned.rows @ entries).reshape(-1, self.n_parameters)


def _add_product(goal: FloatArray, slopes: Sequence[Slopes], changes: Changes, places: IntArray) -> None:
    """Multiply derivatives by arrays with what parameters change of these, and add that to a goal.

    Parameters
    ----------
    goal : ndarray, shape (n_frames * n_column or more, n_parameters), contiguous
    slopes : sequence of Slopes
        Of a column in all frames or pairs.
    changes : Changes
    places : ndarray of int, shape (n, n_column)
        Where its entries stand in the goal.
    """
    for found in slopes:
        change = changes.arrays[found.key]
        frame = np.arange(len(found.values))[:, None] + found.offset
        number = (frame * (change.shape[0] // changes.n_frames) + found.entry).ravel()
        first, count = change.indptr[number], np.diff(change.indptr)[number]
        own = np.repeat(np.arange(number.size), count)  # each number as often as there are parameters of it
        entry = np.arange(own.size) + np.repeat(first - np.cumsum(count) + count, count)
        where = places[:, found.row].ravel()[own] * goal.shape[1] + change.indices[entry]
        np.add.at(goal.reshape(-1), where, found.values.ravel()[own] * change.data[entry])
