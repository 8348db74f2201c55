"""Rows of a program: their names and bounds, and which of them are affine.

Affine rows are evaluated as numbers for every frame and become one constant sparse matrix; only what is
truly nonlinear is mapped over the frames as expressions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.frame import MatrixRows, Rows
from scso_nlp.stability.hessian import describe_turn
from scso_nlp.transcription.piece import Derivatives, Key, Piece, curved, first_order, frame_blocks
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Share of a row's entries that is rounding of its only one [-].
_ALONE = 1e-12


@dataclass(frozen=True, kw_only=True)
class RowBlock:
    """Rows of one term, divided by `scale` for the solver.

    Attributes
    ----------
    term : str
    names, unit : tuple of str
        One per row.
    lower, upper : ndarray, shape (n_rows,) [unit]
    scale : float
    is_pair : bool
        True for rows of two neighbouring frames.
    piece : Piece or None
        The rows, unscaled; None for rows v'Hv of a matrix inequality.
    missed : int or None
        Position of the first of the unknowns by which the rows may be missed, already added to `piece`.
    directions : tuple of str
        What the entries of a turn are called.
    turns : ndarray, shape (n_frames, n_rows, n_directions), or None [-]
        The turn v of each row v'Hv; zero where a frame has fewer.
    """

    term: str
    names: tuple[str, ...]
    unit: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    scale: float
    is_pair: bool = False
    piece: Piece | None = None
    missed: int | None = None
    directions: tuple[str, ...] = ()
    turns: FloatArray | None = None

    def label(self, frame: int, row: int) -> str:
        """Say what a row is in one frame."""
        return (
            self.names[row] if self.turns is None else describe_turn(self.directions, self.turns[frame, row])
        )


@dataclass(frozen=True, kw_only=True)
class MatrixBlock:
    """A matrix inequality of one term; `piece` has the weights of its matrices, unscaled.

    `matrices` and `constant` say where they are among the arrays of the program, lower triangles column by
    column; `missed` is the position of the unknown by which it may be missed, or None.
    """

    term: str
    names: tuple[str, ...]
    unit: str
    lower: FloatArray
    scale: float
    piece: Piece
    missed: int | None

    @property
    def matrices(self) -> Key:
        """Name of the array of matrices, shape (n_frames, n_entries, n_weights)."""
        return (self.term, "matrices of the inequality")

    @property
    def constant(self) -> Key:
        """Name of the array of what does not depend on the unknowns, shape (n_frames, n_entries)."""
        return (self.term, "constant of the inequality")

    @property
    def triangle(self) -> tuple[IntArray, IntArray]:
        """Row and column of each entry of the lower triangle."""
        column, row = np.triu_indices(len(self.names))
        return row, column

    def value(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> FloatArray:
        """H in every frame at scaled unknowns, shape (n_frames, n, n)."""
        return self.filled(self.entries(self.piece.values(unknowns, arrays), arrays))

    def entries(self, weights: FloatArray, arrays: Mapping[Key, FloatArray]) -> FloatArray:
        """Lower triangle of H for weights (n_frames, n_weights), shape (n_frames, n_entries)."""
        return (arrays[self.matrices] @ weights[:, :, None])[:, :, 0] + arrays[self.constant]

    def filled(self, entries: FloatArray) -> FloatArray:
        """Make symmetric matrices (…, n, n) of lower triangles (…, n_entries)."""
        n = len(self.names)
        row, column = self.triangle
        matrix = np.zeros((*entries.shape[:-1], n, n))
        matrix[..., row, column] = matrix[..., column, row] = entries
        return matrix


@dataclass(frozen=True)
class RowTable:
    """All rows of one frame, or of one pair of frames, block after block."""

    blocks: tuple[RowBlock, ...]

    def __len__(self) -> int:
        return sum(len(block.names) for block in self.blocks)

    def __iter__(self) -> Iterator[tuple[RowBlock, slice]]:
        """Give every block with the places of its rows."""
        start = 0
        for block in self.blocks:
            yield block, slice(start, start + len(block.names))
            start += len(block.names)

    @property
    def scale(self) -> FloatArray:
        """Scale of every row."""
        return self._joined([np.full(len(b.names), b.scale) for b in self.blocks])

    @property
    def lower(self) -> FloatArray:
        """Scaled lower bound of every row."""
        return self._joined([b.lower / b.scale for b in self.blocks])

    @property
    def upper(self) -> FloatArray:
        """Scaled upper bound of every row."""
        return self._joined([b.upper / b.scale for b in self.blocks])

    @property
    def term(self) -> np.ndarray:
        """Term of every row."""
        return np.array([block.term for block in self.blocks for _ in block.names], dtype=object)

    def find(self, row: int) -> tuple[RowBlock, int]:
        """Find the block of a row, and its place there."""
        for block, where in self:
            if row < where.stop:
                return block, row - where.start
        raise IndexError(row)

    @staticmethod
    def _joined(parts: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([np.zeros(0), *parts])


def row_block(name: str, rows: Rows, *, is_pair: bool, piece: Piece, missed: int | None) -> RowBlock:
    """Check what a term says of its rows.

    Raises
    ------
    ProblemError
        Names, units, bounds or scale that do not fit the rows.
    """
    n = piece.expression.numel()
    names = tuple(rows.names)
    unit = (rows.unit,) * n if isinstance(rows.unit, str) else tuple(rows.unit)
    if len(names) != n or len(unit) != n:
        raise ProblemError(f"{name} returned {n} rows, {len(names)} names and {len(unit)} units")
    for what, bound in (("lower", rows.lower), ("upper", rows.upper)):
        if np.shape(bound) not in ((), (1,), (n,)):
            raise ProblemError(
                f"{what} of {name} has shape {np.shape(bound)}, expected () or ({n},) = (n_rows,)"
            )
    lower, upper = (np.broadcast_to(np.asarray(b, float), (n,)) for b in (rows.lower, rows.upper))
    wrong = np.flatnonzero(~(lower <= upper))
    if wrong.size:
        i = int(wrong[0])
        raise ProblemError(
            f"bounds of {name}[{names[i]}] are {lower[i]:g} to {upper[i]:g}, expected lower <= upper"
        )
    _check_scale(name, rows.scale)
    return RowBlock(
        term=name,
        names=names,
        unit=unit,
        lower=lower,
        upper=upper,
        scale=rows.scale,
        is_pair=is_pair,
        piece=piece,
        missed=missed,
    )


def matrix_block(
    name: str, rows: MatrixRows, *, piece: Piece, missed: int | None, time: FloatArray
) -> tuple[MatrixBlock, dict[Key, FloatArray]]:
    """Check what a term says of its matrix inequality; give the arrays with its matrices, too.

    Raises
    ------
    ProblemError
        Names, levels, matrices or scale that do not fit each other.
    DataError
        Matrices that are not finite.
    """
    n = len(rows.names)
    matrices, constant = np.asarray(rows.matrices, dtype=float), np.asarray(rows.constant, dtype=float)
    shape = (time.size, n * (n + 1) // 2, piece.expression.numel())
    for what, array, expected in (("matrices", matrices, shape), ("constant", constant, shape[:2])):
        if array.shape != expected:
            raise ProblemError(f"{what} of {name} have shape {array.shape}, expected {expected}")
        broken = ~np.isfinite(array).reshape(time.size, -1).all(axis=1)
        if broken.any():
            k = int(np.flatnonzero(broken)[0])
            raise DataError(f"{what} of {name} are not finite at frame {k} (t = {time[k]:g} s)")
    if np.shape(rows.lower) not in ((), (n,)) or not np.isfinite(rows.lower).all():
        raise ProblemError(f"lower of {name} is {rows.lower}, expected one finite number or {n}")
    _check_scale(name, rows.scale)
    block = MatrixBlock(
        term=name,
        names=tuple(rows.names),
        unit=rows.unit,
        lower=np.broadcast_to(np.asarray(rows.lower, float), (n,)),
        scale=rows.scale,
        piece=piece,
        missed=missed,
    )
    return block, {block.matrices: matrices, block.constant: constant}


def _check_scale(name: str, scale: float) -> None:
    if not (scale > 0 and np.isfinite(scale)):
        raise ProblemError(f"scale of {name} is {scale:g}, expected a positive number")


@dataclass(frozen=True, kw_only=True)
class AffineRows:
    """Rows that are affine in the scaled unknowns, as numbers, divided by their scales.

    One frame's rows are ``values[k] x + constant[k]``; the pattern is that of the entries which are
    non-zero in some frame. `row` counts over all rows of a frame, block after block; pair rows have
    columns beyond the first frame's size. `is_empty` (n, n_rows) tells which rows have no unknown in a
    frame: they are kept or lost whatever the solver does.
    """

    row: IntArray
    column: IntArray
    values: FloatArray
    constant: FloatArray
    rows: IntArray
    is_empty: BoolArray
    is_pair: bool

    @property
    def place(self) -> IntArray:
        """Position of every row number among `rows`; -1 where it is not affine."""
        place = np.full(int(self.rows.max(initial=-1)) + 1, -1)
        place[self.rows] = np.arange(self.rows.size)
        return place

    def by_row(self, entries: FloatArray) -> FloatArray:
        """Add up the entries (n, n_entries) of every row, shape (n, n_rows)."""
        return _added(entries, self.place[self.row], self.rows.size)

    def determined(self, table: RowTable, size: int) -> BoolArray:
        """Tell which unknowns (n, size) an equation of their frame determines by itself.

        Such are controls of residuals where no muscle acts: what they cost is no choice.
        """
        place = self.place[self.row]
        is_equation = (table.lower == table.upper)[self.rows]
        total = self.by_row(np.abs(self.values))[:, place]
        alone = is_equation[place] & (self.values != 0) & (np.abs(self.values) >= (1 - _ALONE) * total)
        frame, entry = np.nonzero(alone)
        found = np.zeros((len(self.values), size), dtype=bool)
        found[frame, self.column[entry]] = True
        return found

    def frames(self, which: IntArray | slice) -> AffineRows:
        """Keep some frames."""
        return replace(
            self, values=self.values[which], constant=self.constant[which], is_empty=self.is_empty[which]
        )

    def dense(self, size: int) -> FloatArray:
        """Matrices of all frames, shape (n, n_rows, size)."""
        matrix = np.zeros((len(self.values), self.rows.size, size))
        matrix[:, self.place[self.row], self.column] = self.values
        return matrix

    def with_rows(self, first: int, dense: FloatArray, constant: FloatArray) -> AffineRows:
        """Append rows, numbered from `first`, given as matrices (n, n_new, size) and constants (n, n_new)."""
        row, column = np.nonzero((dense != 0).any(axis=0))
        n_new = dense.shape[1]
        return replace(
            self,
            row=np.concatenate([self.row, first + row]),
            column=np.concatenate([self.column, column]),
            values=np.concatenate([self.values, dense[:, row, column]], axis=1),
            constant=np.concatenate([self.constant, constant], axis=1),
            rows=np.concatenate([self.rows, first + np.arange(n_new)]),
            is_empty=np.concatenate([self.is_empty, (dense == 0).all(axis=2)], axis=1),
        )

    def matrix(self, values: FloatArray, size: int) -> sp.csc_matrix:
        """Assemble the rows of all frames: (n × rows per frame) by (n_frames × size), constant and sparse."""
        n = len(values)
        shape = (n * self.rows.size, (n + self.is_pair) * size)
        return sp.csc_matrix((values.ravel(), self.places(n, size)), shape=shape)

    def sparse(self, n: int, n_rows: int, size: int) -> sp.csr_matrix:
        """Assemble n frames or pairs with all `n_rows` rows of each, zero where they are not affine."""
        order = np.lexsort((self.column, self.row))
        lengths = np.tile(np.bincount(self.row, minlength=n_rows), n)
        column = np.arange(n)[:, None] * size + self.column[order]
        entries = (self.values[:n, order].ravel(), column.ravel(), np.append(0, np.cumsum(lengths)))
        return sp.csr_matrix(entries, shape=(n * n_rows, (n + self.is_pair) * size))

    def places(self, n: int, size: int) -> tuple[IntArray, IntArray]:
        """Row and column of every entry of the rows of n frames or pairs, frame after frame."""
        frame = np.arange(n)[:, None]
        row = frame * self.rows.size + self.place[self.row]
        return row.ravel(), (frame * size + self.column).ravel()


#: Nonlinear rows, divided by their scales, with their row numbers.
NonlinearRows = tuple[Piece, IntArray]


@dataclass(frozen=True, kw_only=True)
class SplitRows:
    """All rows of a program: affine ones as numbers, nonlinear ones as expressions with their row numbers."""

    affine: AffineRows
    affine_pairs: AffineRows
    nonlinear: tuple[NonlinearRows, ...]


def split_table(
    table: RowTable,
    *,
    is_pair: bool,
    size: int,
    arrays: Mapping[Key, FloatArray],
    time: FloatArray,
) -> tuple[AffineRows, list[NonlinearRows]]:
    """Separate affine rows, evaluated for all frames, from nonlinear ones (divided by their scale).

    Raises
    ------
    DataError
        Affine rows whose numbers are not finite: they would vanish from the matrix unseen.
    """
    n = max(time.size - is_pair, 0)
    row_parts, column_parts, value_parts, constant_parts, numbers = [], [], [], [], []
    nonlinear: list[NonlinearRows] = []
    for block, where in table:
        assert block.piece is not None
        scaled = replace(block.piece, expression=block.piece.expression / block.scale)
        is_curved = np.array(curved(scaled.expression, scaled.all_unknowns), dtype=bool)
        here = np.arange(where.start, where.stop)
        straight = np.flatnonzero(~is_curved)
        if straight.size:
            derivatives = first_order(replace(scaled, expression=scaled.expression[straight.tolist()]))
            constant, values, keep = _non_zero(block, straight, derivatives, size, arrays, time)
            row_parts.append(here[straight][derivatives.row[keep]])
            column_parts.append(derivatives.column[keep])
            value_parts.append(values)
            constant_parts.append(constant)
            numbers.append(here[straight])
        if is_curved.any():
            which = np.flatnonzero(is_curved)
            nonlinear.append((replace(scaled, expression=scaled.expression[which.tolist()]), here[which]))
    nothing = np.zeros(0, dtype=np.int64)
    row, column = np.concatenate([nothing, *row_parts]), np.concatenate([nothing, *column_parts])
    order = np.lexsort((row, column))  # as sparse matrices have them
    row, column, rows = row[order], column[order], np.concatenate([nothing, *numbers])
    values = np.concatenate([np.zeros((n, 0)), *value_parts], axis=1)
    if (order[1:] < order[:-1]).any():
        values = values[:, order]
    is_empty = np.ones((n, len(table)), dtype=bool)
    for part in frame_blocks(n):
        is_empty[part] = _added(values[part] != 0, row, len(table)) == 0
    affine = AffineRows(
        row=row,
        column=column,
        values=values,
        constant=np.concatenate([np.zeros((n, 0)), *constant_parts], axis=1),
        rows=rows,
        is_empty=is_empty[:, rows],
        is_pair=is_pair,
    )
    return affine, nonlinear


def _added(entries: np.ndarray, row: IntArray, n_rows: int) -> FloatArray:
    """Add up entries (n, n_entries) by their rows, shape (n, n_rows)."""
    chosen = sp.csr_array((np.ones(row.size), (row, np.arange(row.size))), shape=(n_rows, row.size))
    return np.asarray((chosen @ entries.T).T)


def _non_zero(
    block: RowBlock,
    rows: IntArray,
    derivatives: Derivatives,
    size: int,
    arrays: Mapping[Key, FloatArray],
    time: FloatArray,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Give constants, the entries that are not zero in all frames, and which these are.

    Most are zero: a muscle crosses few coordinates. So they are never all in memory.
    """
    is_pair = block.is_pair
    n, n_entries = max(time.size - is_pair, 0), derivatives.row.size
    constant, found, keep = np.zeros((n, rows.size)), [], np.zeros(n_entries, dtype=bool)
    for part in frame_blocks(n):
        seen = slice(part.start, part.stop + is_pair)
        own = {key: array[seen] for key, array in arrays.items()}
        constant[part], entries = derivatives.at(np.zeros((len(time[seen]), size)), own)
        _refuse_not_finite(block, rows, entries, constant[part], time, part.start)
        used = (entries != 0).any(axis=0)
        keep |= used
        found.append((part, used, entries[:, used]))
    values = np.zeros((n, int(keep.sum())))
    for part, used, entries in found:
        values[part, used[keep]] = entries
    return constant, values, keep


def _refuse_not_finite(
    block: RowBlock, rows: IntArray, values: FloatArray, constant: FloatArray, time: FloatArray, first: int
) -> None:
    broken = ~(np.isfinite(values).all(axis=1) & np.isfinite(constant).all(axis=1))
    if broken.any():
        k = int(np.flatnonzero(broken)[0])
        names = [block.names[r] for r in rows]
        wrong = [name for name, good in zip(names, np.isfinite(constant[k]), strict=True) if not good]
        raise DataError(
            f"the rows {block.term}[{', '.join(wrong or names)}] are not finite at frame {first + k} "
            f"(t = {time[first + k]:g} s); check the term's data"
        )
