"""From a problem to symbols: every term is asked once for its expressions of one frame or of two."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.constraints.constraint import FrameConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import MatrixRows, Rows, VariableSpec
from scso_nlp.objectives.objective import FrameObjective, FramePairObjective
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.transcription.layout import (
    ABOUT_SYMBOLS,
    Constants,
    Given,
    Layout,
    collect_data,
    make_layout,
    make_symbols,
    named_faults,
)
from scso_nlp.transcription.piece import Key, Piece, evaluate
from scso_nlp.transcription.rows import (
    MatrixBlock,
    RowBlock,
    RowTable,
    SplitRows,
    matrix_block,
    row_block,
    split_table,
)
from scso_nlp.validation import BoolArray, FloatArray

_DT: Key = ("problem", "dt")


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
        Weighted; prices of what constraints may miss are among them.
    rows, pair_rows : RowTable
        Of one frame; of a pair.
    matrices : tuple of MatrixBlock
        Matrix inequalities: rows are chosen for them while solving.
    observed : tuple of RowBlock or MatrixBlock
        What is evaluated at the solution but need not be kept.
    split : SplitRows
        `rows` and `pair_rows`, affine ones as numbers.
    tendon_force : Piece
    quantities : mapping of str to Piece
        Columns that terms want evaluated at the solution, by ``"<term>.<name>"``.
    """

    problem: MuscleForceProblem
    layout: Layout
    arrays: Mapping[Key, FloatArray]
    objectives: tuple[tuple[str, Piece], ...]
    rows: RowTable
    pair_rows: RowTable
    matrices: tuple[MatrixBlock, ...]
    observed: tuple[RowBlock | MatrixBlock, ...]
    split: SplitRows
    tendon_force: Piece
    quantities: Mapping[str, Piece]

    @property
    def time(self) -> FloatArray:
        """Times of all frames [s]."""
        return self.problem.motion.trajectory.time

    @property
    def is_coupled(self) -> bool:
        """True if some term couples frames."""
        return bool(self.problem.coupled_terms)

    def alone(self) -> FrameProgram:
        """Leave out what couples frames; unknowns and rows of one frame keep their places."""
        split = self.split
        return replace(
            self,
            problem=self.problem.without_coupling(),
            objectives=tuple(cost for cost in self.objectives if not cost[1].is_pair),
            pair_rows=RowTable(()),
            split=replace(split, nonlinear=tuple(part for part in split.nonlinear if not part[0].is_pair)),
        )

    def undefined(self, unknowns: FloatArray) -> dict[int, str]:
        """Find the frames whose cost, or the slope of it, is no number at scaled unknowns (n_frames, size).

        Returns
        -------
        dict of int to str
            By frame, the first objective of which this holds.
        """
        found: dict[int, str] = {}
        for name, piece in self.objectives:
            slope = ca.densify(ca.gradient(piece.expression, piece.all_unknowns))
            values = evaluate(piece, piece.function(piece.expression, slope), unknowns, self.arrays)
            wrong = np.isnan(np.concatenate(values, axis=1)).any(axis=1)
            found = {int(k): name for k in np.flatnonzero(wrong)} | found
        return found

    @property
    def degree(self) -> float | None:
        """Say d if unknowns s times as large cost s^d times as much, prices of misses included; else None."""
        terms = self.problem.objectives
        found = {term.degree if isinstance(term, FrameObjective) else None for term in terms}
        if len(self.objectives) > len(terms):  # the others are prices, by which misses are multiplied
            found.add(1.0)
        return found.pop() if len(found) == 1 else None

    @property
    def is_miss(self) -> BoolArray:
        """Tell which unknowns are what rows or matrices may be missed by, shape (n_unknowns,)."""
        found = np.zeros(self.layout.size, dtype=bool)
        for block in self.rows.blocks:
            if block.missed is not None:
                found[block.missed : block.missed + len(block.names)] = True
        for matrix in self.matrices:
            if matrix.missed is not None:
                found[matrix.missed] = True
        return found

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the scaled unknowns, shape (n_frames, size)."""
        n, scale = self.time.size, self.layout.scale
        return self.layout.rows("lower", n) / scale, self.layout.rows("upper", n) / scale


def describe(
    problem: MuscleForceProblem,
    differentiated: Set[str] = frozenset(),
    known: FrameProgram | None = None,
) -> FrameProgram:
    """Ask every term for its expressions on the symbols of one frame or of two.

    Constants with the names in `differentiated` are symbols too; their numbers are among the arrays. With
    ``"moment_arms"`` among them, those that are zero in all frames are symbols like all others. Data of terms
    need not be collected, nor rows be split again, if the problem has a `known` description without such
    symbols.
    """
    return _Description(problem, differentiated, known).program()


class _Description:
    """A description under way: unknowns for what may be missed are added as terms ask for them."""

    def __init__(
        self, problem: MuscleForceProblem, differentiated: Set[str], known: FrameProgram | None
    ) -> None:
        self.problem, self.constants, self.known = problem, Constants(differentiated), known
        self.layout = make_layout(problem)
        if known is None:
            self.arrays = collect_data(problem)
        else:
            self.arrays = {given.key: known.arrays[given.key] for given in known.tendon_force.given}
        self.now = self.later = make_symbols(self.layout, self.arrays, self.constants)
        if problem.coupled_terms:
            self.later = make_symbols(self.layout, self.arrays, self.constants, offset=1)
        self.unknowns = (self.now.unknowns, self.later.unknowns)
        self.dt = ca.SX.sym("dt")
        if problem.coupled_terms:
            self.arrays[_DT] = np.diff(problem.motion.trajectory.time)

    def program(self) -> FrameProgram:
        """Collect the expressions first, because all pieces share all unknowns."""
        problem, motion = self.problem, self.problem.motion
        frame = later_frame = self.now.frame(problem)
        if self.later is not self.now:
            later_frame = self.later.frame(problem)
        costs: list[tuple[str, ca.SX, bool]] = []
        answers: list[tuple[str, Rows | MatrixRows | None, bool]] = []
        model = problem.muscle_model
        answers.append((model.name, model.rows(self.now.for_term(model.name, frame), motion), False))
        for term in problem.objectives:
            own = self.now.for_term(term.name, frame)
            with named_faults(f"objective {term.name}"):
                if isinstance(term, FramePairObjective):
                    value = term.value(own, self.later.for_term(term.name, later_frame), self.dt)
                else:
                    value = term.value(own)
                    answers.append((term.name, _rows(term.name, term.rows(own)), False))
            scalar = _scalar(term.name, value)
            if not np.isfinite(term.weight):
                raise ProblemError(f"weight of {term.name} is {term.weight:g}, expected a finite number")
            costs.append((term.name, term.weight * scalar, isinstance(term, FramePairObjective)))
        for constraint in problem.constraints:
            own = self.now.for_term(constraint.name, frame)
            with named_faults(f"constraint {constraint.name}"):
                rows: object
                if isinstance(constraint, FrameConstraint):
                    rows = constraint.rows(own, motion)
                else:
                    other = self.later.for_term(constraint.name, later_frame)
                    rows = constraint.rows(own, other, self.dt, motion)
            is_pair = not isinstance(constraint, FrameConstraint)
            answers.append((constraint.name, _rows(constraint.name, rows), is_pair))
        observed = []
        for seen in problem.observed:
            with named_faults(f"constraint {seen.name}"):
                rows = seen.rows(self.now.for_term(seen.name, frame), motion)
            observed.append((seen.name, _rows(seen.name, rows)))
        self.arrays |= self.constants.arrays(motion.n_frames)
        missed = [self._may_be_missed(name, rows, is_pair, costs) for name, rows, is_pair in answers]

        blocks: list[RowBlock] = []
        matrices: list[MatrixBlock] = []
        for (name, rows, is_pair), (amount, position) in zip(answers, missed, strict=True):
            block = self._block(name, rows, is_pair, amount, position)
            if isinstance(block, MatrixBlock):
                matrices.append(block)
            elif block is not None:
                blocks.append(block)
        of_observed = [self._block(name, rows, False, None, None) for name, rows in observed]
        tables = [RowTable(tuple(b for b in blocks if b.is_pair == is_pair)) for is_pair in (False, True)]
        quantities = {
            f"{name}.{key}": self._piece(ca.densify(ca.SX(column)), False)
            for name, rows in (*((name, rows) for name, rows, _ in answers), *observed)
            if rows is not None
            for key, column in rows.quantities.items()
        }
        return FrameProgram(
            problem=problem,
            layout=self.layout,
            arrays=self.arrays,
            objectives=tuple((name, self._piece(cost, is_pair)) for name, cost, is_pair in costs),
            rows=tables[0],
            pair_rows=tables[1],
            matrices=tuple(matrices),
            observed=tuple(block for block in of_observed if block is not None),
            split=self._split(tables[0], tables[1]) if self.known is None else self.known.split,
            tendon_force=self._piece(ca.densify(frame.muscle.tendon_force), False),
            quantities=quantities,
        )

    def _piece(self, expression: ca.SX, is_pair: bool) -> Piece:
        given = [*self.now.given, *(self.later.given if is_pair else ())]
        given += [Given(key=key, symbol=symbol) for key, symbol in self.constants.symbols.items()]
        given += [Given(key=_DT, symbol=self.dt)] if is_pair else []
        return Piece(expression=expression, unknowns=self.unknowns[: 1 + is_pair], given=tuple(given))

    def _may_be_missed(
        self,
        name: str,
        rows: Rows | MatrixRows | None,
        is_pair: bool,
        costs: list[tuple[str, ca.SX, bool]],
    ) -> tuple[ca.SX | None, int | None]:
        """Add unknowns and their price where rows may be missed: one per row, one per matrix."""
        if rows is None or rows.price is None:
            return None, None
        if is_pair:
            raise ProblemError(f"{name} looks at two frames and cannot be missed at a price")
        alone = isinstance(rows, MatrixRows)
        labels = ("missed",) if alone else tuple(f"missed_{row}" for row in rows.names)
        position = self.layout.size
        self.layout = self.layout.extended(
            name,
            VariableSpec(name="missed", labels=labels, lower=0.0, guess=rows.scale, scale=rows.scale),
            self.problem.motion.n_frames,
        )
        now, later = (ca.SX.sym(f"missed{suffix}", len(labels)) for suffix in ("", "_next"))
        self.unknowns = (ca.vertcat(self.unknowns[0], now), ca.vertcat(self.unknowns[1], later))
        costs.append((f"{name}.missed", rows.price * ca.sum1(now * rows.scale), False))
        return now * rows.scale, position

    def _block(
        self,
        name: str,
        rows: Rows | MatrixRows | None,
        is_pair: bool,
        missed: ca.SX | None,
        position: int | None,
    ) -> RowBlock | MatrixBlock | None:
        if isinstance(rows, MatrixRows):
            weights = self._piece(ca.densify(ca.vec(ca.SX(rows.weights))), False)
            time = self.problem.motion.trajectory.time
            block, arrays = matrix_block(name, rows, piece=weights, missed=position, time=time)
            self.arrays |= arrays
            return block
        if rows is None or not ca.SX(rows.value).numel():
            return None
        value = ca.vec(ca.SX(rows.value))
        if missed is not None:
            value += missed
        return row_block(name, rows, is_pair=is_pair, piece=self._piece(value, is_pair), missed=position)

    def _split(self, rows: RowTable, pair_rows: RowTable) -> SplitRows:
        time = self.problem.motion.trajectory.time
        parts = [
            split_table(table, is_pair=is_pair, size=self.layout.size, arrays=self.arrays, time=time)
            for table, is_pair in ((rows, False), (pair_rows, True))
        ]
        return SplitRows(affine=parts[0][0], affine_pairs=parts[1][0], nonlinear=(*parts[0][1], *parts[1][1]))


def _rows(name: str, answer: object) -> Rows | MatrixRows | None:
    if answer is None or isinstance(answer, Rows | MatrixRows):
        return answer
    raise ProblemError(f"{name} returned {type(answer).__name__}, expected Rows or MatrixRows")


def _scalar(name: str, value: object) -> ca.SX:
    try:
        symbol = ca.SX(value)
    except (NotImplementedError, TypeError):
        raise ProblemError(
            f"objective {name} returned {type(value).__name__}, expected a CasADi expression"
        ) from None
    if symbol.numel() != 1:
        raise ProblemError(f"objective {name} returned shape {symbol.shape}, expected one number per frame")
    if symbol.is_constant() and np.isnan(float(symbol)):
        raise ProblemError(f"objective {name} is nan in every frame, expected a number; {ABOUT_SYMBOLS}")
    return symbol
