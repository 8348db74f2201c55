"""From symbols of one frame to one nonlinear program over many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.transcription.derivatives import Entries, Mapped, derivative_functions
from scso_nlp.transcription.describe import FrameProgram, describe
from scso_nlp.transcription.layout import Given
from scso_nlp.transcription.piece import Piece, curved
from scso_nlp.transcription.rows import AffineRows, NonlinearRows, RowTable
from scso_nlp.transcription.turns import matrix_models, with_turns
from scso_nlp.validation import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class FrameScale:
    """What the numbers of each frame are multiplied by for the solver.

    Attributes
    ----------
    weight : ndarray, shape (n_frames,)
        Multiplies the objective.
    unknowns : ndarray, shape (n_frames,)
        Unknowns are those of the solver times this; 1 in a program of several frames. An objective that has
        a degree is that of the solver's unknowns, before its weight: its powers do not vanish.
    rows : ndarray, shape (n_frames, n_rows)
        Rows are those of the solver times this; 1 for rows that are not affine.
    """

    weight: FloatArray
    unknowns: FloatArray
    rows: FloatArray

    @classmethod
    def of_weights(cls, program: FrameProgram, weight: FloatArray) -> FrameScale:
        """Weigh objectives only."""
        n = program.time.size
        return cls(weight=weight, unknowns=np.ones(n), rows=np.ones((n, len(program.rows))))


@dataclass(frozen=True, kw_only=True)
class Nlp:
    """A nonlinear program over `n_frames` frames whose numbers are parameters.

    Parameters are, in order: values of the affine matrix (frame by frame), frame weights of the
    objective, scales of the unknowns if `is_scaled`, then the data of every nonlinear piece. The constants
    of the affine rows stand in the row bounds. Rows are, in order: affine rows frame by frame, affine pair
    rows, then every nonlinear piece frame by frame. With four frames, o a block of one frame and p of a
    pair, the Jacobian of g is::

                      x_1 x_2 x_3 x_4
        affine rows    o
                           o
                               o
                                   o
        affine pairs   p   p
                           p   p
                               p   p
        nonlinear      o               each piece of one frame, then
                           o           each piece of a pair,
                               o       like the affine ones
                                   o

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
    derivatives : mapping of str to ca.Function
        ``grad_f``, ``jac_g`` and ``hess_lag`` as CasADi's options call them.
    data : tuple of (Given, is_pair)
        Where the data parameters come from, in their order.
    objective_is_quadratic : bool
    is_scaled : bool
        True if the unknowns may have a scale by frame.
    """

    program: FrameProgram
    n_frames: int
    affine: tuple[AffineRows, ...]
    nonlinear: tuple[NonlinearRows, ...]
    f: ca.MX
    g: ca.MX
    x: ca.MX
    p: ca.MX
    derivatives: Mapping[str, ca.Function]
    data: tuple[tuple[Given, bool], ...]
    objective_is_quadratic: bool
    is_scaled: bool

    @property
    def rows_are_affine(self) -> bool:
        """True if no row is mapped as an expression."""
        return not self.nonlinear

    @property
    def groups(self) -> tuple[tuple[RowTable, IntArray, int], ...]:
        """Rows of g in their order: table, row numbers and how often they stand there."""
        parts = [(a.is_pair, a.rows) for a in self.affine]
        parts += [(piece.is_pair, rows) for piece, rows in self.nonlinear]
        tables = (self.program.rows, self.program.pair_rows)
        return tuple((tables[is_pair], rows, self.n_frames - is_pair) for is_pair, rows in parts)

    def parameters(self, frames: IntArray, scale: FrameScale) -> FloatArray:
        """Numbers for `n_frames` frames, shape (n_parameters,); pairs are neighbours in `frames`."""
        one, *pairs = self.affine
        factor = scale.unknowns[frames, None] / scale.rows[frames]
        parts = [(one.values[frames] * factor[:, one.row]).ravel()]
        parts += [pair.values[frames[:-1]].ravel() for pair in pairs]
        parts.append(scale.weight[frames])
        if self.is_scaled:
            parts.append(scale.unknowns[frames])
        for given, pair in self.data:
            which = frames[given.offset : given.offset + self.n_frames - pair]
            parts.append(given.numbers(self.program.arrays, which).ravel())
        return np.concatenate(parts)

    def row_bounds(self, frames: IntArray, scale: FrameScale) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of all rows of `n_frames` frames, shape (n_rows,)."""
        lower, upper = [np.zeros(0)], [np.zeros(0)]
        for i, (table, rows, n) in enumerate(self.groups):
            low, high = (np.tile(bound[rows], (n, 1)) for bound in (table.lower, table.upper))
            if i < len(self.affine):
                affine, which = self.affine[i], frames[:n]
                free = affine.is_empty[which]
                low = np.where(free, -np.inf, low - affine.constant[which])
                high = np.where(free, np.inf, high - affine.constant[which])
            if i == 0:
                low, high = (bound / scale.rows[np.ix_(which, rows)] for bound in (low, high))
            lower.append(low.ravel())
            upper.append(high.ravel())
        return np.concatenate(lower), np.concatenate(upper)

    def multipliers(
        self, lam_g: FloatArray, frames: IntArray, scale: FrameScale
    ) -> tuple[FloatArray, FloatArray]:
        """Sort row multipliers by frame, shapes (n_frames, rows) and (n_frames - 1, pair rows).

        They belong to the objective without weights. Frames that pairs couple have one weight.
        """
        one = np.zeros((self.n_frames, len(self.program.rows)))
        pair = np.zeros((self.n_frames - 1, len(self.program.pair_rows)))
        start = 0
        for table, rows, n in self.groups:
            target = one if table is self.program.rows else pair
            target[:, rows] = lam_g[start : start + n * rows.size].reshape(n, rows.size)
            start += n * rows.size
        weight = scale.weight[frames]
        # objectives that vanish among the doubles have weights near the largest of them
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return one / (weight[:, None] * scale.rows[frames]), pair / weight[0]

    def row_multipliers(self, one: FloatArray, frames: IntArray, scale: FrameScale) -> FloatArray:
        """Multipliers of g for the solver, of a program without pairs: the inverse of `multipliers`."""
        scaled = one[frames] * scale.weight[frames, None] * scale.rows[frames]
        return np.concatenate([np.zeros(0), *(scaled[:n, rows].ravel() for _, rows, n in self.groups)])


def build_nlp(program: FrameProgram, n_frames: int, *, is_scaled: bool = False) -> Nlp:
    """Assemble the program over `n_frames` frames; numbers are parameters, so it is built once.

    Parameters
    ----------
    program : FrameProgram
    n_frames : int
        1 for the frame-wise solve, all frames for the trajectory-wide one.
    is_scaled : bool
        Whether unknowns may have a scale by frame.

    Returns
    -------
    Nlp
    """
    size, split = program.layout.size, program.split
    x = ca.MX.sym("x", size * n_frames)
    own = by_frame = ca.reshape(x, size, n_frames)
    coupled = n_frames > 1
    affine = (split.affine, split.affine_pairs) if coupled else (split.affine,)
    nonlinear = tuple((piece, rows) for piece, rows in split.nonlinear if coupled or not piece.is_pair)
    parameters: list[ca.MX] = []
    straight: list[ca.MX] = []
    for part in affine:
        n = n_frames - part.is_pair
        entries = ca.MX.sym("entries", part.row.size * n)
        parameters.append(entries)
        row, column = part.places(n, size)
        straight.append(Entries(row=row, column=column, values=entries).matrix(part.rows.size * n, x.numel()))
    weights = ca.MX.sym("frame_weights", 1, n_frames)
    parameters.append(weights.T)
    sizes = None
    if is_scaled:
        sizes = ca.MX.sym("unknown_scales", 1, n_frames)
        parameters.append(sizes.T)
        by_frame = by_frame * ca.repmat(sizes, size, 1)
    data: list[tuple[Given, bool]] = []

    def mapped(piece: Piece, unknowns: ca.MX, scale: ca.MX | None) -> Mapped:
        n = n_frames - piece.is_pair
        columns = [unknowns[:, i : i + n] for i in range(len(piece.unknowns))]
        for given in piece.data:
            entry = ca.MX.sym(given.key[1], given.symbol.numel() * n)
            parameters.append(entry)
            data.append((given, piece.is_pair))
            columns.append(ca.reshape(entry, given.symbol.numel(), n))
        return Mapped(piece=piece, inputs=tuple(columns), scale=scale)

    seen = (by_frame, sizes) if program.degree is None else (own, None)
    costs = [
        (mapped(piece, *seen), weights[0] * ca.MX.ones(1, n_frames - 1) if piece.is_pair else weights)
        for _, piece in program.objectives
        if coupled or not piece.is_pair
    ]
    curves = [mapped(piece, by_frame, sizes) for piece, _ in nonlinear]
    f = sum((ca.dot(weight, cost.values) for cost, weight in costs), ca.MX(0))
    rows = [ca.densify(ca.mtimes(matrix, x)) for matrix in straight]
    g = ca.vertcat(*rows, *(ca.vec(curve.values) for curve in curves))
    p = ca.vertcat(*parameters)
    quadratic = not any(
        any(curved(ca.gradient(cost.piece.expression, cost.piece.all_unknowns), cost.piece.all_unknowns))
        for cost, _ in costs
    )
    return Nlp(
        program=program,
        n_frames=n_frames,
        affine=affine,
        nonlinear=nonlinear,
        f=f,
        g=g,
        x=x,
        p=p,
        derivatives=derivative_functions(
            x, p, f=f, g=g, size=size, costs=costs, affine=straight, nonlinear=curves
        ),
        data=tuple(data),
        objective_is_quadratic=quadratic,
        is_scaled=is_scaled,
    )


@dataclass(frozen=True, kw_only=True)
@checked
class Program:
    r"""A whole problem as one nonlinear program for any solver.

    .. math:: \min_x f(x, p) \;\text{s.t.}\; l_g \le g(x, p) \le u_g,\; l_x \le x \le u_x

    Attributes
    ----------
    x, p : ca.MX, shapes (n_unknowns, 1) and (n_parameters, 1)
        Scaled unknowns, frame after frame, and parameters.
    f, g : ca.MX, shapes (1, 1) and (n_rows, 1)
        Objective and scaled rows; :class:`Nlp` draws the blocks of the Jacobian of g.
    parameters : ndarray, shape (n_parameters,)
        Values of p.
    initial_guess, lower, upper : ndarray, shape (n_unknowns,)
        Of x.
    row_lower, row_upper : ndarray, shape (n_rows,)
        Of g.
    scale : ndarray, shape (n_unknowns,)
        An unknown in its own unit is x times its scale.
    unknown_names, row_names : tuple of str
        ``"<name> at frame <k>"`` and ``"<term>[<row>] at frame <k>"``; a row of a pair of frames stands at
        the later one.
    blocks : tuple of (str, int, str)
        Terms of g with their number of rows and what they are.
    """

    x: ca.MX
    p: ca.MX
    f: ca.MX
    g: ca.MX
    parameters: FloatArray
    initial_guess: FloatArray
    lower: FloatArray
    upper: FloatArray
    row_lower: FloatArray
    row_upper: FloatArray
    scale: FloatArray
    unknown_names: tuple[str, ...]
    row_names: tuple[str, ...]
    blocks: tuple[tuple[str, int, str], ...]

    def __str__(self) -> str:
        equations = int((self.row_lower == self.row_upper).sum())
        lines = [
            f"{self.x.numel()} unknowns, {self.g.numel()} rows ({equations} equations), "
            f"{self.p.numel()} parameters"
        ]
        width = max((len(name) for name, _, _ in self.blocks), default=0)
        lines += [f"  {name:<{width}}  {n:6d} rows, {kind}" for name, n, kind in self.blocks]
        return "\n".join(lines)


@checked
def build_program(problem: MuscleForceProblem) -> Program:
    """Write a problem down as one program over all its frames.

    Parameters
    ----------
    problem : MuscleForceProblem
        Of a matrix inequality the program has the rows of each direction alone, which are necessary, not
        sufficient: solvers of this package add the turns that decide.

    Returns
    -------
    Program

    Examples
    --------
    >>> program = scso.build_program(problem)
    >>> program.x.shape, program.g.shape, program.row_names[:2]
    ((21, 1), (14, 1), ...)
    """
    described = describe(problem)
    n = described.time.size
    models = matrix_models(described)
    alone = tuple(np.broadcast_to(np.eye(len(m.block.names)), (n, *[len(m.block.names)] * 2)) for m in models)
    described = with_turns(described, models, alone)
    nlp = build_nlp(described, n)
    frames = np.arange(n)
    lower, upper = described.bounds()
    scale = FrameScale.of_weights(described, np.ones(n))
    row_lower, row_upper = nlp.row_bounds(frames, scale)
    layout = described.layout
    row_names, blocks = [], []
    for i, (table, rows, times) in enumerate(nlp.groups):
        is_pair = table is described.pair_rows
        found = [table.find(int(r)) for r in rows]
        row_names += [
            f"{block.term}[{block.names[row]}] at frame {k + is_pair}"
            for k in range(times)
            for block, row in found
        ]
        kind = "affine" if i < len(nlp.affine) else "nonlinear"
        for term in dict.fromkeys(block.term for block, _ in found):
            count = sum(block.term == term for block, _ in found)
            blocks.append((term, count * times, f"{kind}, of {'two frames' if is_pair else 'one frame'}"))
    return Program(
        x=nlp.x,
        p=nlp.p,
        f=nlp.f,
        g=nlp.g,
        parameters=nlp.parameters(frames, scale),
        initial_guess=(layout.rows("guess", n) / layout.scale).ravel(),
        lower=lower.ravel(),
        upper=upper.ravel(),
        row_lower=row_lower,
        row_upper=row_upper,
        scale=np.tile(layout.scale, n),
        unknown_names=tuple(f"{label} at frame {k}" for k in range(n) for label in layout.labels),
        row_names=tuple(row_names),
        blocks=tuple(blocks),
    )
