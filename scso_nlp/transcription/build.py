"""From a problem to a nonlinear program over one frame or over many.

Terms stay symbolic for their author. Rows that are affine in the unknowns are found, evaluated as
numbers for every frame and become one constant sparse matrix; only what is truly nonlinear is mapped
over the frames as expressions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.objectives.objective import FramePairObjective
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.transcription.frame import Rows
from scso_nlp.transcription.layout import Layout, as_columns, collect_data, make_layout, make_symbols
from scso_nlp.validation import BoolArray, FloatArray, IntArray

Key = tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class RowBlock:
    """Rows of one term: what they are called and their bounds, divided by `scale` for the solver."""

    term: str
    names: tuple[str, ...]
    unit: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    scale: float
    is_pair: bool


@dataclass(frozen=True, kw_only=True)
class Piece:
    """An expression of one frame, or of two neighbours, with the symbols it needs.

    ``unknowns`` are one or two columns; ``data`` are (offset, key) pairs, offset 0 for the earlier and
    1 for the later frame (always 0 for one-frame pieces).
    """

    expression: ca.SX
    unknowns: tuple[ca.SX, ...]
    data: tuple[tuple[int, Key], ...]
    symbols: tuple[ca.SX, ...]

    @property
    def is_pair(self) -> bool:
        """True if the piece looks at two neighbouring frames."""
        return len(self.unknowns) == 2

    def function(self, *outputs: ca.SX) -> ca.Function:
        """Make a function of the unknowns and the data, with the expression or other outputs."""
        return ca.Function("piece", [*self.unknowns, *self.symbols], list(outputs) or [self.expression])

    def slope(self) -> ca.Function:
        """Make a function with the gradient of a scalar expression by all its unknowns."""
        return self.function(ca.densify(ca.gradient(self.expression, ca.vertcat(*self.unknowns))))


@dataclass(frozen=True, kw_only=True)
class FrameProgram:
    """A problem in symbols: one frame, and one pair of frames where terms couple them.

    Attributes
    ----------
    problem : MuscleForceProblem
    layout : Layout
    arrays : mapping of (owner, name) to ndarray, frames first
        Numbers for the data symbols; ``("problem", "dt")`` has one entry less than frames.
    objectives : tuple of (name, Piece)
        Weighted.
    row_blocks : tuple of RowBlock
        One-frame blocks first.
    rows : tuple of Piece
        One per block; unscaled.
    tendon_force : Piece
    quantities : mapping of str to Piece
        Columns that constraints want evaluated at the solution, by ``"<term>.<name>"``.
    """

    problem: MuscleForceProblem
    layout: Layout
    arrays: Mapping[Key, FloatArray]
    objectives: tuple[tuple[str, Piece], ...]
    row_blocks: tuple[RowBlock, ...]
    rows: tuple[Piece, ...]
    tendon_force: Piece
    quantities: Mapping[str, Piece]


_DT: Key = ("problem", "dt")

#: Frames evaluated together; more would leave the processor's cache.
_FRAMES_AT_ONCE = 128


def describe(problem: MuscleForceProblem) -> FrameProgram:
    """Ask every term for its expressions on the symbols of one frame or of two."""
    layout, arrays = make_layout(problem), collect_data(problem)
    now = make_symbols(problem, layout, arrays)
    frame = now.frame(problem)
    later = make_symbols(problem, layout, arrays, "_next")
    later_frame = later.frame(problem)
    dt = ca.SX.sym("dt")
    if problem.coupled_terms:
        arrays[_DT] = np.diff(problem.trajectory.time)

    def piece(expression: ca.SX, pair: bool) -> Piece:
        offsets = (now, later) if pair else (now,)
        wanted = [
            (offset, key, symbol)
            for offset, symbols in enumerate(offsets)
            for key, symbol in symbols.data.items()
            if ca.depends_on(expression, symbol)
        ]
        if pair and ca.depends_on(expression, dt):
            wanted.append((0, _DT, dt))
        return Piece(
            expression=expression,
            unknowns=tuple(s.unknowns for s in offsets),
            data=tuple((offset, key) for offset, key, _ in wanted),
            symbols=tuple(symbol for _, _, symbol in wanted),
        )

    objectives: list[tuple[str, Piece]] = []
    blocks: list[tuple[RowBlock, Piece]] = []
    quantities: dict[str, Piece] = {}

    def add_rows(name: str, rows: Rows | None, pair: bool = False) -> None:
        if rows is not None and ca.SX(rows.value).numel():
            blocks.append((_row_block(name, rows, pair), piece(ca.vec(ca.SX(rows.value)), pair)))

    model = problem.muscle_model
    add_rows(model.name, model.rows(now.for_term(model.name, frame), problem))
    for term in problem.objectives:
        own = now.for_term(term.name, frame)
        if isinstance(term, FramePairObjective):
            value = term.value(own, later.for_term(term.name, later_frame), dt)
        else:
            value = term.value(own)
            add_rows(term.name, term.rows(own))
        value = _scalar(term.name, value)
        if not np.isfinite(term.weight):
            raise ProblemError(f"weight of {term.name} is {term.weight:g}, expected a finite number")
        objectives.append((term.name, piece(term.weight * value, isinstance(term, FramePairObjective))))
    for constraint in problem.constraints:
        own = now.for_term(constraint.name, frame)
        if isinstance(constraint, FrameConstraint):
            add_rows(constraint.name, constraint.rows(own, problem))
            penalty = constraint.penalty(own)
            if penalty is not None:
                objectives.append((f"{constraint.name}.missed", piece(penalty, False)))
            for key, column in constraint.quantities(own, problem).items():
                quantities[f"{constraint.name}.{key}"] = piece(ca.densify(ca.SX(column)), False)
        else:
            other = later.for_term(constraint.name, later_frame)
            add_rows(constraint.name, constraint.rows(own, other, dt, problem), pair=True)
    blocks.sort(key=lambda entry: entry[0].is_pair)
    return FrameProgram(
        problem=problem,
        layout=layout,
        arrays=arrays,
        objectives=tuple(objectives),
        row_blocks=tuple(block for block, _ in blocks),
        rows=tuple(p for _, p in blocks),
        tendon_force=piece(ca.densify(frame.muscle.tendon_force), False),
        quantities=quantities,
    )


def _scalar(name: str, value: object) -> ca.SX:
    try:
        symbol = ca.SX(value)
    except (NotImplementedError, TypeError):
        raise ProblemError(
            f"objective {name} returned {type(value).__name__}, expected a CasADi expression"
        ) from None
    if symbol.numel() != 1:
        raise ProblemError(f"objective {name} returned shape {symbol.shape}, expected one number per frame")
    return symbol


def _row_block(name: str, rows: Rows, pair: bool) -> RowBlock:
    n = ca.SX(rows.value).numel()
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
    if not (rows.scale > 0 and np.isfinite(rows.scale)):
        raise ProblemError(f"scale of {name} is {rows.scale:g}, expected a positive number")
    return RowBlock(
        term=name, names=names, unit=unit, lower=lower, upper=upper, scale=rows.scale, is_pair=pair
    )


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
    if n == 0:
        return [np.zeros((0, function.nnz_out(i))) for i in range(function.n_out())]
    parts: list[list[FloatArray]] = []
    for start in range(0, n, _FRAMES_AT_ONCE):
        size = min(_FRAMES_AT_ONCE, n - start)
        columns = [ca.DM(unknowns[start + i : start + i + size].T) for i in range(len(piece.unknowns))]
        for (offset, key), symbol in zip(piece.data, piece.symbols, strict=True):
            numbers = ca.DM(as_columns(arrays[key][start + offset : start + offset + size]))
            columns.append(ca.reshape(numbers, symbol.size1(), symbol.size2() * size))
        outputs = function.map(size)(*columns)
        parts.append([out.full().T for out in (outputs if isinstance(outputs, tuple) else (outputs,))])
    return [np.concatenate(outputs) for outputs in zip(*parts, strict=True)]


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


@dataclass(frozen=True, kw_only=True)
class SplitRows:
    """All rows of a program: affine ones as numbers, nonlinear ones as expressions with their row numbers."""

    affine: AffineRows
    affine_pairs: AffineRows
    nonlinear: tuple[tuple[Piece, IntArray], ...]


def split_rows(program: FrameProgram) -> SplitRows:
    """Separate affine rows, evaluated for all frames, from nonlinear ones (divided by their scale)."""
    affine, curved = _split(program, pair=False)
    affine_pairs, curved_pairs = _split(program, pair=True)
    return SplitRows(affine=affine, affine_pairs=affine_pairs, nonlinear=(*curved, *curved_pairs))


def _split(program: FrameProgram, *, pair: bool) -> tuple[AffineRows, list[tuple[Piece, IntArray]]]:
    n_frames = program.problem.trajectory.n_frames
    n = max(n_frames - pair, 0)
    row_parts, column_parts, value_parts, constant_parts, numbers = [], [], [], [], []
    nonlinear: list[tuple[Piece, IntArray]] = []
    start = 0
    for block, piece in zip(program.row_blocks, program.rows, strict=True):
        if block.is_pair != pair:
            continue
        unknowns = ca.vertcat(*piece.unknowns)
        scaled = piece.expression / block.scale
        curved = np.array(ca.which_depends(scaled, unknowns, 2, True), dtype=bool)
        here = start + np.arange(curved.size)
        start += curved.size
        straight = np.flatnonzero(~curved)
        if straight.size:
            expression = scaled[straight.tolist()]
            jacobian = ca.jacobian(expression, unknowns)
            function = piece.function(
                ca.vertcat(*jacobian.nonzeros()) if jacobian.nnz() else ca.SX(0, 1), ca.densify(expression)
            )
            zero = np.zeros((n_frames, program.layout.size))
            values, constant = evaluate(piece, function, zero, program.arrays)
            _refuse_not_finite(program, block, straight, values, constant)
            row, column = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
            keep = np.abs(values).max(axis=0, initial=0.0) > 0
            row_parts.append(here[straight][row[keep]])
            column_parts.append(column[keep])
            value_parts.append(values[:, keep])
            constant_parts.append(constant)
            numbers.append(here[straight])
        if curved.any():
            which = np.flatnonzero(curved)
            nonlinear.append(
                (
                    Piece(
                        expression=scaled[which.tolist()],
                        unknowns=piece.unknowns,
                        data=piece.data,
                        symbols=piece.symbols,
                    ),
                    here[which],
                )
            )
    nothing = np.zeros(0, dtype=np.int64)
    row, rows = np.concatenate([nothing, *row_parts]), np.concatenate([nothing, *numbers])
    values = np.concatenate([np.zeros((n, 0)), *value_parts], axis=1)
    is_empty = np.ones((n, start), dtype=bool)
    for entry, r in enumerate(row):
        is_empty[:, r] &= values[:, entry] == 0
    return AffineRows(
        row=row,
        column=np.concatenate([nothing, *column_parts]),
        values=values,
        constant=np.concatenate([np.zeros((n, 0)), *constant_parts], axis=1),
        rows=rows,
        is_empty=is_empty[:, rows],
        is_pair=pair,
    ), nonlinear


def _refuse_not_finite(
    program: FrameProgram, block: RowBlock, rows: IntArray, values: FloatArray, constant: FloatArray
) -> None:
    """Refuse affine rows whose numbers are not finite: they would vanish from the matrix unseen."""
    broken = ~(np.isfinite(values).all(axis=1) & np.isfinite(constant).all(axis=1))
    if broken.any():
        k = int(np.flatnonzero(broken)[0])
        names = [block.names[r] for r in rows]
        wrong = [name for name, good in zip(names, np.isfinite(constant[k]), strict=True) if not good]
        raise DataError(
            f"the rows {block.term}[{', '.join(wrong or names)}] are not finite at frame {k} "
            f"(t = {program.problem.trajectory.time[k]:g} s); check the term's data"
        )


def affine_matrix(affine: AffineRows, values: FloatArray, size: int) -> sp.csc_matrix:
    """Assemble the rows of all frames: (n × rows per frame) by (n_frames × size), constant and sparse."""
    n, per_frame = len(values), affine.rows.size
    position = np.full(int(affine.rows.max(initial=-1)) + 1, -1)
    position[affine.rows] = np.arange(per_frame)
    frame = np.arange(n)[:, None]
    row = (frame * per_frame + position[affine.row]).ravel()
    column = (frame * size + affine.column).ravel()
    n_columns = (n + affine.is_pair) * size
    return sp.csc_matrix((values.ravel(), (row, column)), shape=(n * per_frame, n_columns))


def bounds_of_rows(program: FrameProgram, *, pair: bool) -> tuple[FloatArray, FloatArray]:
    """Scaled lower and upper bounds of all rows of one frame (or pair), in their numbering."""
    blocks = [b for b in program.row_blocks if b.is_pair == pair]
    nothing = np.zeros(0)
    return (
        np.concatenate([nothing, *(b.lower / b.scale for b in blocks)]),
        np.concatenate([nothing, *(b.upper / b.scale for b in blocks)]),
    )


@dataclass(frozen=True, kw_only=True)
class Nlp:
    """A nonlinear program over `n_frames` frames whose numbers are parameters.

    Parameters are, in order: values of the affine matrix (frame by frame), frame weights of the
    objective, then the data of every nonlinear piece. The constants of the affine rows stand in the
    row bounds. Rows are, in order: affine rows frame by frame, affine pair rows, then every nonlinear
    piece frame by frame.

    Attributes
    ----------
    program : FrameProgram
    n_frames : int
    affine : tuple of AffineRows
        Of one frame; of pairs, if there is more than one frame.
    nonlinear : tuple of (Piece, ndarray of int)
        Mapped expressions with their row numbers within a frame or pair.
    f, g, x, p : ca.MX
        Objective, rows, unknowns and parameters.
    data_keys : tuple of (offset, key, is_pair)
        Where the data parameters come from, in their order.
    objective_is_quadratic : bool
    """

    program: FrameProgram
    n_frames: int
    affine: tuple[AffineRows, ...]
    nonlinear: tuple[tuple[Piece, IntArray], ...]
    f: ca.MX
    g: ca.MX
    x: ca.MX
    p: ca.MX
    data_keys: tuple[tuple[int, Key, bool], ...]
    objective_is_quadratic: bool

    @property
    def rows_are_affine(self) -> bool:
        """True if no row is mapped as an expression."""
        return not self.nonlinear

    def parameters(self, frames: IntArray, frame_weights: FloatArray) -> FloatArray:
        """Numbers for `n_frames` frames, shape (n_parameters,); pairs are neighbours in `frames`."""
        parts = [a.values[frames[: len(frames) - a.is_pair]].ravel() for a in self.affine]
        parts.append(frame_weights)
        for offset, key, pair in self.data_keys:
            which = frames[offset : offset + self.n_frames - pair]
            parts.append(as_columns(self.program.arrays[key][which]).T.ravel())
        return np.concatenate(parts)

    def row_bounds(self, frames: IntArray) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of all rows of `n_frames` frames, shape (n_rows,)."""
        lower, upper = [np.zeros(0)], [np.zeros(0)]
        for a in self.affine:
            low, high = bounds_of_rows(self.program, pair=a.is_pair)
            which = frames[: len(frames) - a.is_pair]
            free = a.is_empty[which]
            lower.append(np.where(free, -np.inf, low[a.rows] - a.constant[which]).ravel())
            upper.append(np.where(free, np.inf, high[a.rows] - a.constant[which]).ravel())
        for piece, rows in self.nonlinear:
            low, high = bounds_of_rows(self.program, pair=piece.is_pair)
            n = self.n_frames - piece.is_pair
            lower.append(np.tile(low[rows], n))
            upper.append(np.tile(high[rows], n))
        return np.concatenate(lower), np.concatenate(upper)

    def multipliers(self, lam_g: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sort row multipliers by frame, shapes (n_frames, rows) and (n_frames - 1, pair rows)."""
        start = 0
        sizes = [(sum(len(b.names) for b in self.program.row_blocks if b.is_pair == pair)) for pair in (0, 1)]
        by_kind = [np.zeros((self.n_frames - pair, sizes[pair])) for pair in (0, 1)]
        groups = [(a.is_pair, a.rows) for a in self.affine] + [
            (p.is_pair, rows) for p, rows in self.nonlinear
        ]
        for pair, rows in groups:
            n = self.n_frames - pair
            by_kind[pair][:, rows] = lam_g[start : start + n * rows.size].reshape(n, rows.size)
            start += n * rows.size
        return by_kind[0], by_kind[1]


def build_nlp(program: FrameProgram, split: SplitRows, n_frames: int) -> Nlp:
    """Assemble the program over `n_frames` frames; numbers are parameters, so it is built once.

    Parameters
    ----------
    program : FrameProgram
    split : SplitRows
    n_frames : int
        1 for the frame-wise solve, all frames for the trajectory-wide one.

    Returns
    -------
    Nlp
    """
    size = program.layout.size
    x = ca.MX.sym("x", size * n_frames)
    by_frame = ca.reshape(x, size, n_frames)
    coupled = n_frames > 1
    affine = (split.affine, split.affine_pairs) if coupled else (split.affine,)
    nonlinear = tuple((piece, rows) for piece, rows in split.nonlinear if coupled or not piece.is_pair)
    parameters: list[ca.MX] = []
    rows: list[ca.MX] = []
    for part in affine:
        n = n_frames - part.is_pair
        entries = ca.MX.sym("entries", part.row.size * n)
        parameters.append(entries)
        pattern = affine_matrix(part, np.arange(1.0, part.row.size * n + 1).reshape(n, -1), size)
        order = (pattern.data - 1).astype(int).tolist()
        sparsity = ca.Sparsity(*pattern.shape, pattern.indptr.tolist(), pattern.indices.tolist())
        rows.append(
            ca.densify(ca.mtimes(ca.MX(sparsity, entries[order]), x))
            if order
            else ca.MX.zeros(part.rows.size * n, 1)
        )
    weights = ca.MX.sym("frame_weights", n_frames)
    parameters.append(weights)
    data_keys: list[tuple[int, Key, bool]] = []

    def mapped(piece: Piece) -> ca.MX:
        n = n_frames - piece.is_pair
        columns = [by_frame[:, i : i + n] for i in range(len(piece.unknowns))]
        for (offset, key), symbol in zip(piece.data, piece.symbols, strict=True):
            entry = ca.MX.sym(key[1], symbol.numel() * n)
            parameters.append(entry)
            data_keys.append((offset, key, piece.is_pair))
            columns.append(ca.reshape(entry, symbol.size1(), symbol.size2() * n))
        return piece.function().map(n)(*columns)

    objective = ca.MX(0)
    quadratic = True
    for _, piece in program.objectives:
        if piece.is_pair and n_frames == 1:
            continue
        values = ca.vec(mapped(piece))
        objective += weights[0] * ca.sum1(values) if piece.is_pair else ca.dot(weights, values)
        unknowns = ca.vertcat(*piece.unknowns)
        gradient = ca.gradient(piece.expression, unknowns)
        quadratic &= not any(ca.which_depends(gradient, unknowns, 2, True))
    rows += [ca.vec(mapped(piece)) for piece, _ in nonlinear]
    return Nlp(
        program=program,
        n_frames=n_frames,
        affine=affine,
        nonlinear=nonlinear,
        f=objective,
        g=ca.vertcat(*rows),
        x=x,
        p=ca.vertcat(*parameters),
        data_keys=tuple(data_keys),
        objective_is_quadratic=quadratic,
    )
