"""Expressions of one frame, or of two neighbouring frames, and their numbers in all frames."""

from __future__ import annotations

import functools
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.transcription.layout import Given
from scso_nlp.validation import FloatArray, IntArray

#: Who owns given numbers, and what they are called.
Key = tuple[str, str]

#: Frames evaluated together; more would leave the processor's cache.
_FRAMES_AT_ONCE = 128

#: Functions of more instructions or inputs are called frame by frame: to make one for many takes longer.
_MANY = 1000


@dataclass(frozen=True, kw_only=True)
class Piece:
    """An expression of one frame, or of two neighbours, with the symbols it may have.

    ``unknowns`` are one or two columns.
    """

    expression: ca.SX
    unknowns: tuple[ca.SX, ...]
    given: tuple[Given, ...]

    @property
    def is_pair(self) -> bool:
        """True if the piece looks at two neighbouring frames."""
        return len(self.unknowns) == 2

    @property
    def all_unknowns(self) -> ca.SX:
        """Unknowns of one frame, or of both."""
        return ca.vertcat(*self.unknowns)

    @functools.cached_property
    def data(self) -> tuple[Given, ...]:
        """What is given that the expression depends on."""
        return tuple(each for each in self.given if ca.depends_on(self.expression, each.symbol))

    def depends_on(self, keys: Container[Key]) -> bool:
        """Tell whether the expression depends on some of what is given."""
        return any(each.key in keys and ca.depends_on(self.expression, each.symbol) for each in self.given)

    def function(self, *outputs: ca.SX, more: tuple[ca.SX, ...] = ()) -> ca.Function:
        """Make a function of the unknowns, the data and more, with the expression or other outputs."""
        inputs = [*self.unknowns, *(each.symbol for each in self.data), *more]
        return ca.Function("piece", inputs, list(outputs) or [self.expression])

    def slope(self) -> ca.Function:
        """Make a function with the gradient of a scalar expression by all its unknowns."""
        return self._slope

    @functools.cached_property
    def _slope(self) -> ca.Function:
        return self.function(ca.densify(ca.gradient(self.expression, self.all_unknowns)))

    @functools.cached_property
    def curvature(self) -> Derivatives:
        """Gradient of a scalar expression, and entries of its Hessian, by all unknowns."""
        return second_order(self, self.all_unknowns)

    def values(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> FloatArray:
        """Evaluate the expression for all frames (or pairs), shape (n_frames, n_rows)."""
        return evaluate(self, self._value, unknowns, arrays)[0]

    @functools.cached_property
    def _value(self) -> ca.Function:
        return self.function()


@dataclass(frozen=True, kw_only=True)
class Derivatives:
    """Values and non-zero derivatives of a piece as one function, made once and evaluated at many points."""

    piece: Piece
    values: ca.SX
    entries: ca.SX
    function: ca.Function
    row: IntArray
    column: IntArray

    def at(self, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Values (n_frames, n_rows) and entries of the derivatives (n_frames, n_entries)."""
        value, entries = evaluate(self.piece, self.function, unknowns, arrays)
        return value, entries


def first_order(piece: Piece) -> Derivatives:
    """Value, and entries of the Jacobian by all unknowns."""
    return _derivatives(piece, piece.expression, jacobian_by_rows(piece.expression, piece.all_unknowns))


def jacobian_by_rows(expression: ca.SX, symbols: ca.SX) -> ca.SX:
    """Differentiate a column row by row.

    Together, a sweep over the graph of all rows is made for every colour of a dense matrix.
    """
    rows = [ca.jacobian(row, symbols) for row in ca.vertsplit(expression)]
    return ca.vertcat(*rows) if rows else ca.jacobian(expression, symbols)


def second_order(piece: Piece, x: ca.SX | None = None) -> Derivatives:
    """Gradient, and entries of the Hessian, by the only unknowns of a piece or by those given."""
    second, first = ca.hessian(piece.expression, piece.unknowns[0] if x is None else x)
    return _derivatives(piece, first, second)


def _derivatives(piece: Piece, value: ca.SX, matrix: ca.SX) -> Derivatives:
    row, column = (np.array(v, dtype=np.int64) for v in matrix.sparsity().get_triplet())
    entries = matrix.nz[:] if matrix.nnz() else ca.SX(0, 1)
    function = piece.function(ca.densify(value), entries)
    return Derivatives(piece=piece, values=value, entries=entries, function=function, row=row, column=column)


def curved(expression: ca.SX, unknowns: ca.SX) -> list[bool]:
    """Tell which rows of a column are not affine in the unknowns."""
    return list(ca.which_depends(expression, unknowns, 2, True))


def frame_blocks(n_frames: int) -> Iterator[slice]:
    """Cut frames into blocks that fit the processor's cache."""
    for start in range(0, n_frames, _FRAMES_AT_ONCE):
        yield slice(start, min(start + _FRAMES_AT_ONCE, n_frames))


@functools.lru_cache(maxsize=64)
def _mapped(function: ca.Function, n_frames: int) -> ca.Function:
    """Make one function of many frames; making it takes longer than calling it once."""
    return function.map(n_frames)


def evaluate(
    piece: Piece,
    function: ca.Function,
    unknowns: FloatArray,
    arrays: Mapping[Key, FloatArray],
) -> list[FloatArray]:
    """Evaluate a function of a piece for all frames (or pairs) at scaled unknowns (n_frames, size).

    Returns
    -------
    list of ndarray, shape (n_frames or n_frames - 1, n_output_nonzeros)
    """
    n = len(unknowns) - piece.is_pair
    one_by_one = max(function.n_instructions(), function.nnz_in()) > _MANY
    outputs = [np.empty((n, function.nnz_out(i))) for i in range(function.n_out())]
    for part in frame_blocks(n):
        given = [
            np.ascontiguousarray(array, dtype=float)
            for array in _numbers(piece, piece.data, unknowns, arrays, part)
        ]
        wanted = [array[part] for array in outputs]
        buffer, call = (function if one_by_one else _mapped(function, part.stop - part.start)).buffer()
        if one_by_one:
            for k in range(part.stop - part.start):
                _call(buffer, call, [array[k] for array in given], [array[k] for array in wanted])
        else:
            _call(buffer, call, given, wanted)
    return outputs


def _numbers(
    piece: Piece, data: Sequence[Given], unknowns: FloatArray, arrays: Mapping[Key, FloatArray], part: slice
) -> list[FloatArray]:
    """Take the unknowns of a piece and the data of some frames (or pairs), each of shape (n, n_entries)."""
    start, stop = part.start, part.stop
    own = [unknowns[start + side : stop + side] for side in range(len(piece.unknowns))]
    return own + [each.numbers(arrays, slice(start + each.offset, stop + each.offset)) for each in data]


@dataclass(frozen=True, kw_only=True)
class Seen:
    """All that pieces of a program with the same number of frames may see, at a point.

    Attributes
    ----------
    symbols : ca.SX, shape (n_symbols, 1)
    numbers : ndarray, shape (n_frames or n_frames - 1, n_symbols)
    """

    symbols: ca.SX
    numbers: FloatArray

    @classmethod
    def by(cls, piece: Piece, unknowns: FloatArray, arrays: Mapping[Key, FloatArray]) -> Seen:
        """Take what one of the pieces sees at scaled unknowns (n_frames, size)."""
        every = slice(0, len(unknowns) - piece.is_pair)
        return cls(
            symbols=ca.vertcat(*piece.unknowns, *(each.symbol for each in piece.given)),
            numbers=np.concatenate(_numbers(piece, piece.given, unknowns, arrays, every), axis=1),
        )

    def evaluate_once(
        self, outputs: Sequence[ca.SX], symbols: ca.SX | None = None, numbers: FloatArray | None = None
    ) -> list[FloatArray]:
        """Evaluate columns in all frames by a function that is of no more use; they may have more symbols.

        It has one input and one output: to find what outputs depend on, or to hand over arrays one by one,
        takes longer than to copy all.
        """
        inputs = [self.symbols] if symbols is None else [self.symbols, symbols]
        given = [self.numbers] if numbers is None else [self.numbers, np.ascontiguousarray(numbers)]
        if not outputs:
            return []
        width = [output.numel() for output in outputs]
        function = ca.Function("piece", inputs, [ca.densify(ca.veccat(*outputs))])
        values = np.empty((len(self.numbers), sum(width)))
        buffer, call = function.buffer()
        for k in range(len(values)):
            for i, array in enumerate(given):
                buffer.set_arg(i, array[k].data)
            buffer.set_res(0, values[k].data)
            call()
        return np.split(values, np.cumsum(width)[:-1], axis=1)


def _call(
    buffer: ca.FunctionBuffer, call: Callable[[], None], given: list[FloatArray], wanted: list[FloatArray]
) -> None:
    """Call a function; arrays are read and written where they are: to make a DM takes ten times as long."""
    for i, array in enumerate(given):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(wanted):
        buffer.set_res(i, array.data)
    call()
