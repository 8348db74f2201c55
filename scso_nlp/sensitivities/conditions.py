r"""The conditions of an optimum of a whole motion, and what they become with small changes.

With unknowns x, what is given d, active rows g and their multipliers :math:`\lambda`, the Lagrangian is
:math:`L = f + \lambda^T g - \langle\Lambda, G\rangle`. Where the same rows and bounds stay active,

.. math::
    \begin{pmatrix} \nabla_{xx} L + C & g_x^T \\ g_x & 0 \end{pmatrix}
    \begin{pmatrix} \dot x \\ \dot\lambda \end{pmatrix} =
    -\begin{pmatrix} \nabla_{xd} L + C_d \\ g_d \end{pmatrix} \dot d

with unknowns between their bounds only. A matrix G that is singular at the optimum, with the multiplier
:math:`\Lambda = Q \Psi Q^T` in its null space Q, gives the rows :math:`Q^T G Q = 0` and, because Q turns, the
curvature :math:`C_{ij} = 2 \langle\Lambda, G_i G^+ G_j\rangle` (Shapiro 1997, Math Program 77:301-320).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from scso_nlp.sensitivities.equations import (
    Linear,
    Part,
    dense_rows,
    diagonal,
    factorised,
    largest_of_rows,
    sparse,
    sparse_square,
    stacked,
)
from scso_nlp.sensitivities.kept_bounds import bounds_kept_by_rows
from scso_nlp.sensitivities.turned import Turned, turned_at
from scso_nlp.solution import Solution
from scso_nlp.solver.judge import unknowns_of
from scso_nlp.transcription.by_data import MULTIPLIERS, weighted
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.piece import first_order
from scso_nlp.transcription.turns import matrix_models
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: Multipliers and distances below this share of what they are made of are zero: the active set is not strict.
STRICT = 1e-7
#: A frame whose equations, scaled, answer a change of one by more than this is singular.
SINGULAR = 1e10
#: Newton's method has arrived when its step is below this much of the unknowns, or changes the equations by
#: less than this [-]; and its most steps.
_ARRIVED, _MOST_STEPS = 1e-9, 8
#: Most turns in which unknowns follow multipliers where Newton's method has not found a strict active set.
_MOST_TURNS = 12
#: An unknown nearer to a bound than this much of the frame's largest, or of one, is at it [-].
_AT_BOUND = 1e-9
#: One farther from it than this is not at it, whatever its multiplier: that of a tiny power is rounding [-].
_FAR = 0.1
_TINY = float(np.finfo(float).tiny)


@dataclass(kw_only=True)
class Point:
    """Unknowns (n_frames, size), multipliers of all rows in the solver's sign, and of the matrices."""

    x: FloatArray
    row: FloatArray
    matrices: list[FloatArray]


class Conditions:
    """Conditions of the optimum of a program: vectors of all unknowns and of all rows of all frames."""

    def __init__(self, program: FrameProgram, solution: Solution) -> None:
        self.program, self.models = program, matrix_models(program)
        self.n, self.size = program.time.size, program.layout.size
        self.costs = [piece.curvature for _, piece in program.objectives]
        self.curved = [
            (rows, first_order(piece), weighted(piece).curvature) for piece, rows in program.split.nonlinear
        ]
        self.bent = [
            None if model.is_affine else weighted(model.block.piece).curvature for model in self.models
        ]
        self.n_rows = (len(program.rows), len(program.pair_rows))
        n_pair = max(self.n - 1, 0)
        self.first = (0, self.n * self.n_rows[0])
        self.frame_of_row = np.concatenate(
            [np.repeat(np.arange(self.n), self.n_rows[0]), np.repeat(1 + np.arange(n_pair), self.n_rows[1])]
        )
        self._collect_rows(n_pair)
        self._take_slope(self.affine)
        self.bounds = tuple(bound.ravel() for bound in program.bounds())
        self.usable = solution.is_solved & np.isfinite(solution.activation).all(axis=1)
        self.point = self._point(solution)
        self.turned: list[Turned] = []
        self.at_bound: IntArray
        self.is_regular: BoolArray
        self._look(choose=True)

    @property
    def is_coupled(self) -> bool:
        """True if frames cannot be looked at one by one."""
        return self.program.is_coupled

    def places(self, is_pair: int, rows: IntArray) -> IntArray:
        """Places of rows of every frame, or pair, among all rows, shape (n, n_rows)."""
        frame = np.arange(max(self.n - is_pair, 0))[:, None]
        return np.asarray(self.first[is_pair] + frame * self.n_rows[is_pair] + rows)

    def _collect_rows(self, n_pair: int) -> None:
        program = self.program
        lower, upper, empty, affine_rows = [], [], [], []
        self.constant = np.zeros(self.frame_of_row.size)
        for is_pair, (table, affine, n) in enumerate(
            (
                (program.rows, program.split.affine, self.n),
                (program.pair_rows, program.split.affine_pairs, n_pair),
            )
        ):
            lower.append(np.tile(table.lower, n))
            upper.append(np.tile(table.upper, n))
            is_empty = np.zeros((n, len(table)), dtype=bool)
            is_empty[:, affine.rows] = affine.is_empty[:n]
            empty.append(is_empty.ravel())
            self.constant[self.places(is_pair, affine.rows)] = affine.constant[:n]
            affine_rows.append(affine.sparse(n, len(table), self.size))
        self.row_lower, self.row_upper = np.concatenate(lower), np.concatenate(upper)
        self.is_empty = np.concatenate(empty)
        self.affine = stacked(affine_rows)

    def _point(self, solution: Solution) -> Point:
        """Unknowns and judged multipliers of a solution, in the program's scale and the solver's sign."""
        program = self.program
        row = np.zeros(self.frame_of_row.size)
        x = np.clip(unknowns_of(program, solution).ravel(), *self.bounds)
        for is_pair, table in enumerate((program.rows, program.pair_rows)):
            taken: dict[str, int] = {}
            for block, where in table:
                begin = taken.get(block.term, 0)
                taken[block.term] = begin + len(block.names)
                result, own = solution.rows[block.term], slice(begin, taken[block.term])
                size = np.nan_to_num(result.multiplier[is_pair:, own]) * block.scale
                value = (result.value + result.missed)[is_pair:, own]
                at_upper = np.abs(value - block.upper) < np.abs(value - block.lower)
                sign = np.where((block.lower == block.upper) | ~at_upper, -1.0, 1.0)
                row[self.places(is_pair, np.arange(where.start, where.stop))] = sign * size
        row[self.is_empty] = 0.0
        matrices = [np.nan_to_num(solution.matrices[m.block.term].multiplier) for m in self.models]
        return Point(x=x.reshape(self.n, self.size), row=row, matrices=matrices)

    # ------------------------------------------------------------------------------------------ at a point

    def settle(self) -> None:
        """Take the active set of the solution, move to its exact optimum, and look whether it is strict.

        Afterwards `linear` has the factorised conditions, `is_regular` (n_frames,) tells which frames may be
        differentiated, and `is_kink` (n_frames,) where that fails for want of strict complementarity.
        """
        self._arrive()
        missed = self.usable & ~self.is_regular
        alone = not (self.is_coupled or self.curved or self.models)
        is_power = alone and self.program.degree is not None
        if missed.any() and is_power and self._follow_multipliers(missed):
            self._arrive()
        if self.is_coupled and not self.is_regular.all():
            self.is_regular = np.zeros(self.n, dtype=bool)

    def _arrive(self) -> None:
        """Take Newton's steps with the active set there is, and judge all frames."""
        self.is_singular, gone = np.zeros(self.n, dtype=bool), ~self.usable
        parts, is_settled = self._hessian(), False
        for _ in range(_MOST_STEPS):
            broken = self._broken_frames(parts)
            gone, self.is_singular = gone | broken, self.is_singular | broken
            self.linear = self._linear(parts, ~gone)
            answer = self.linear.answer_to_noise(self.n)
            bad = (answer > SINGULAR) & ~gone
            self.is_singular |= bad
            gone = gone | bad
            moved = self._step(self.linear.solve(-self.linear.left), ~gone)
            self._look(choose=False)
            before, parts = parts, self._hessian()
            is_settled = self._is_settled(before, parts)
            if is_settled or not (moved[~gone] > _ARRIVED).any():
                break
        if not is_settled:  # the equations are those of a point a little off, or of another basis
            self.is_singular |= ~gone & (moved > _ARRIVED)
            self.linear = self._linear(parts, ~gone)
        self.is_kink = self.usable & ~self.is_singular & ~self._is_strict()
        self.is_regular = self.usable & ~self.is_singular & ~self.is_kink

    def _follow_multipliers(self, missed: BoolArray) -> bool:
        """Let unknowns follow the multipliers of rows, from bounds and onto them; say if that led elsewhere.

        High powers leave small unknowns, and powers below 2 those at zero, far from their optimum as shares
        of themselves, where Newton's method by the unknowns is slow, or is stopped by the wrong bounds.
        """
        missed, bounds, found, is_elsewhere = missed.copy(), self.at_bound, self.linear, False
        for _ in range(_MOST_TURNS):
            before = self.point.x
            self.linear = self._linear(self._hessian(), missed)
            self._step(self.linear.solve(-self.linear.left), missed)
            self._place_by_multipliers(missed, before)
            self._look(choose=False)
            far = np.abs(self.point.x - before).max(axis=1, initial=0.0)
            missed &= far > _ARRIVED * np.abs(self.point.x).max(axis=1, initial=0.0)
            is_elsewhere |= bool(missed.any()) or not np.array_equal(bounds, self.at_bound)
            if not missed.any():
                break
        if not is_elsewhere:
            self.linear = found
        return is_elsewhere

    def _place_by_multipliers(self, missed: BoolArray, x: FloatArray) -> None:
        """Put unknowns where their cost, if it is a power, rises as their rows push, or onto their bounds."""
        lower, upper = (bound.reshape(self.n, self.size) for bound in self.bounds)
        push = -(self.slope.T @ self.point.row).reshape(x.shape)
        at = np.where(x == 0, np.clip(np.sign(push), lower, upper), x)
        rise, bend = np.zeros_like(x), np.zeros_like(x)
        for cost in self.costs:
            first, second = cost.at(at, self.program.arrays)
            rise += first
            own = cost.row == cost.column
            bend[:, cost.row[own]] += second[:, own]
        with np.errstate(all="ignore"):
            placed = at * np.sign(push * rise) * np.abs(push / rise) ** (rise / (at * bend))
        is_own = missed[:, None] & (lower < upper) & np.isfinite(placed)
        self.point.x = np.where(is_own, np.clip(placed, lower, upper), self.point.x)
        side = np.where(placed <= lower, -1, np.where(placed >= upper, 1, 0))
        self.at_bound = np.where(is_own, side, self.at_bound.reshape(x.shape)).ravel()

    def _is_settled(self, before: Sequence[Part], after: Sequence[Part]) -> bool:
        """Tell whether a step has left the equations as they were: always where they are linear."""
        entries = [(old[0], new[0]) for old, new in zip(before, after, strict=True)]
        entries += [(self.linear.slope.data, self.slope.data)]
        return not self.models and all(
            old.shape == new.shape
            and (np.array_equal(old, new) or np.allclose(old, new, rtol=_ARRIVED, atol=0.0, equal_nan=True))
            for old, new in entries
        )

    def _look(self, *, choose: bool) -> None:
        """Evaluate rows, slopes and matrices at the point; choose what is active, or keep it."""
        x, arrays = self.point.x, self.program.arrays
        self.value = self.affine @ x.ravel() + self.constant
        parts = []
        for rows, derivatives, _ in self.curved:
            is_pair = int(derivatives.piece.is_pair)
            value, entries = derivatives.at(x, arrays)
            self.value[self.places(is_pair, rows)] = value
            column = np.arange(len(value))[:, None] * self.size + derivatives.column
            parts.append((entries, self.places(is_pair, rows[derivatives.row]), column))
        if parts:
            self._take_slope(self.affine + sparse(parts, self.affine.shape))
        force = np.zeros((self.n, self.size))
        self.rise = np.zeros((self.n, self.size))
        self.cost = [cost.at(x, arrays) for cost in self.costs]
        for cost, (first, _) in zip(self.costs, self.cost, strict=True):
            for side, own in enumerate(np.split(first, len(cost.piece.unknowns), axis=1)):
                force[side : side + len(own)] += own
                self.rise[side : side + len(own)] += np.abs(own)
        force = force.ravel() + self.slope.T @ self.point.row
        self.rise = self.rise.ravel() + self.steepness.T @ np.abs(self.point.row)
        self.gradient = force
        size = self.rise.reshape(self.n, -1).max(axis=1, initial=0.0)
        self.largest = (
            np.full(self.n, size.max(initial=_TINY)) if self.is_coupled else np.maximum(size, _TINY)
        )
        before: list[BoolArray | None] = [None if choose else turned.active for turned in self.turned]
        self.turned = [
            turned_at(model, x, arrays, multiplier=multiplier, active=active, largest=self.largest)
            for model, multiplier, active in zip(
                self.models, self.point.matrices, before or [None] * len(self.models), strict=True
            )
        ]
        if choose and self._choose():
            self._look(choose=False)

    def _take_slope(self, slope: sp.csr_matrix) -> None:
        self.slope, self.steepness = slope, abs(slope)
        self.steepest = largest_of_rows(self.steepness)

    def _choose(self) -> bool:
        """Take bounds and rows whose multipliers outweigh distances as active; say if the point moved."""
        lower, upper = self.bounds
        x, frame = self.point.x.ravel(), np.repeat(np.arange(self.n), self.size)
        size = np.maximum(np.abs(self.point.x).max(axis=1, initial=0.0), 1.0)[frame]
        push = self.lagrangian / np.maximum(self.rise, _TINY)
        near_lower, near_upper = (x - lower) / size, (upper - x) / size
        self.at_bound = np.where(lower == upper, 2, 0)
        is_open = lower < upper
        for sign, near in ((-1, near_lower), (1, near_upper)):
            is_held = (-sign * push > near) & (near < _FAR)
            self.at_bound[is_open & (is_held | (near <= _AT_BOUND))] = sign
        self.at_rest = is_open & (self.rise == 0) & ((x == lower) | (x == upper))
        self.at_bound[self.at_rest] = 2
        keeper = bounds_kept_by_rows(self.program, (self.at_bound == 0).reshape(self.n, -1))
        keeper = keeper.reshape(2, -1)
        self.bounds = (np.where(keeper[0] < 0, lower, -np.inf), np.where(keeper[1] < 0, upper, np.inf))
        side, kept = np.nonzero((self.at_bound == [[-1], [1]]) & (keeper >= 0))
        self.at_bound[kept] = 0
        keeping = self.first[1] + (frame[kept] - 1) * self.n_rows[1] + keeper[side, kept]
        lam = self.point.row
        strength, near_lower, near_upper = self._strengths()
        self.at_row = np.where(self.row_lower == self.row_upper, 2, 0)
        is_open = (self.row_lower < self.row_upper) & ~self.is_empty
        self.at_row[is_open & (lam < 0) & (strength > near_lower)] = -1
        self.at_row[is_open & (lam > 0) & (strength > near_upper)] = 1
        keeping = keeping[self.at_row[keeping] == 0]
        self.at_row[keeping] = np.where(near_lower[keeping] < near_upper[keeping], -1, 1)
        # bounds keep rows without free unknowns; their multipliers, which are not unique, stay what they are
        self.is_implied = is_open & (self.steepness @ (self.at_bound == 0).astype(float) == 0)
        self.at_row[self.is_empty | self.is_implied] = 0
        # solvers leave unknowns a little off their bounds; multipliers that nothing holds are rounding
        lower, upper = self.bounds
        placed = np.where(self.at_bound == -1, lower, np.where(self.at_bound == 1, upper, x))
        self.point.x = placed.reshape(self.n, self.size)
        self.point.row = np.where((self.at_row == 0) & ~self.is_implied, 0.0, lam)
        return not (np.array_equal(placed, x) and np.array_equal(self.point.row, lam))

    @property
    def implied(self) -> BoolArray:
        """Tell which rows are met exactly because of bounds, without free unknowns, shape (n_rows,)."""
        if not self.is_implied.any():
            return self.is_implied
        _, near_lower, near_upper = self._strengths()
        return self.is_implied & (np.minimum(near_lower, near_upper) < STRICT)

    @property
    def lagrangian(self) -> FloatArray:
        """Gradient of the Lagrangian by all unknowns, bounds aside."""
        force = self.gradient.reshape(self.n, self.size).copy()
        for turned in self.turned:
            force -= np.einsum("ke,kes->ks", turned.weights, turned.slopes)
        return force.ravel()

    def _strengths(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Multipliers of rows over the largest slope, and distances to both bounds over the row's size."""
        x, value = np.abs(self.point.x.ravel()), self.value
        finite = [np.where(np.isfinite(b), np.abs(b), 0.0) for b in (self.row_lower, self.row_upper)]
        own = np.maximum(self.steepness @ x + np.abs(value) + np.maximum(*finite), _TINY)
        strength = np.abs(self.point.row) * self.steepest / self.largest[self.frame_of_row]
        return strength, (value - self.row_lower) / own, (self.row_upper - value) / own

    @np.errstate(invalid="ignore")  # in singular frames some are no numbers, which are not strict
    def _is_strict(self) -> BoolArray:
        """Tell in which frames no multiplier and no distance is near zero, shape (n_frames,)."""
        lower, upper = self.bounds
        x, frame = self.point.x.ravel(), np.repeat(np.arange(self.n), self.size)
        push = self.lagrangian / np.maximum(self.rise, _TINY)
        size = np.maximum(np.abs(self.point.x).max(axis=1, initial=0.0), _TINY)[frame]
        inside = np.minimum(x - lower, upper - x) / np.minimum(size, 1.0)
        margin = np.choose(self.at_bound + 1, [push, inside, -push, np.inf])
        strict = np.full(self.n, np.inf)
        np.minimum.at(strict, frame, margin)
        strength, near_lower, near_upper = self._strengths()
        lam = self.point.row
        strength = np.where(lam * self.at_row > 0, strength, -strength)
        nearest = np.minimum(near_lower, near_upper)
        margin = np.choose(self.at_row + 1, [strength, nearest, strength, np.inf])
        margin[self.is_empty | self.is_implied] = np.inf
        np.minimum.at(strict, self.frame_of_row, margin)
        for turned in self.turned:
            strict = np.minimum(strict, turned.margin.min(axis=1))
        return strict > STRICT

    # ----------------------------------------------------------------------------------------- equations

    def _hessian(self) -> list[Part]:
        """Entries, rows and columns of the Hessian of the Lagrangian."""
        x, arrays, parts = self.point.x, self.program.arrays, []

        def add(entries: FloatArray, row: IntArray, column: IntArray) -> None:
            frame = np.arange(len(entries))[:, None] * self.size
            parts.append((entries, frame + row, frame + column))

        for cost, (_, entries) in zip(self.costs, self.cost, strict=True):
            add(entries, cost.row, cost.column)
        for rows, derivatives, curvature in self.curved:
            lam = self.point.row[self.places(int(derivatives.piece.is_pair), rows)]
            add(curvature.at(x, {**arrays, MULTIPLIERS: lam})[1], curvature.row, curvature.column)
        for turned, bent in zip(self.turned, self.bent, strict=True):
            if bent is not None:
                of_weights = turned.by_weights(arrays)
                add(-bent.at(x, {**arrays, MULTIPLIERS: of_weights})[1], bent.row, bent.column)
            root = turned.bend @ turned.slopes
            row, column = (v.ravel() for v in np.indices((self.size, self.size)))
            add((root.transpose(0, 2, 1) @ root).reshape(self.n, -1), row, column)
        return parts

    def _broken_frames(self, parts: Sequence[Part]) -> BoolArray:
        """Tell in which frames the curvature by free unknowns is not finite: powers below 2 at zero."""
        broken = np.zeros(self.n, dtype=bool)
        free = self.at_bound == 0
        for entries, row, column in parts:
            wrong = ~np.isfinite(entries) & free[row] & free[column]
            frame = row[wrong] // self.size
            broken[frame] = True
        return broken

    def _linear(self, parts: Sequence[Part], alive: BoolArray) -> Linear:
        frame = np.repeat(np.arange(self.n), self.size)
        free = np.flatnonzero((self.at_bound == 0) & alive[frame])
        kept = [(np.where(np.isfinite(entries), entries, 0.0), row, column) for entries, row, column in parts]
        hessian = sparse_square(kept, frame.size, free)
        slopes, places, frames, left = [self.slope], [np.flatnonzero(self.at_row)], [self.frame_of_row], []
        bound = np.where(self.at_row == 1, self.row_upper, self.row_lower)
        left.append(np.where(self.at_row != 0, self.value - np.where(np.isfinite(bound), bound, 0.0), 0.0))
        start = self.frame_of_row.size
        for turned in self.turned:
            n_pairs = turned.rows.shape[1]
            rows = turned.rows @ turned.slopes
            slopes.append(dense_rows(rows))
            first, second = turned.pairs
            used = turned.active[:, first] & turned.active[:, second]
            places.append(start + np.flatnonzero(used))
            frames.append(np.repeat(np.arange(self.n), n_pairs))
            entries, _ = turned.model.triangle(self.point.x, self.program.arrays)
            left.append((turned.rows @ entries[:, :, None]).ravel())
            start += n_pairs * self.n
        every, frame_of = np.concatenate(places), np.concatenate(frames)
        rows = every[alive[frame_of[every]]]
        slope = stacked(slopes)
        active = slope[rows][:, free]
        curvature = diagonal(kept[: len(self.costs)], frame.size)[free]
        row_frame = frame_of[rows]
        return Linear(
            free=free,
            rows=rows,
            frame=np.concatenate([frame[free], row_frame]),
            left=np.concatenate([self.lagrangian[free], np.concatenate(left)[rows]]),
            factors=factorised(hessian, active, curvature),
            slope=slope,
        )

    def spread(self, found: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Put answers (n_equations, m) to their places among all unknowns and all rows; zero elsewhere."""
        unknowns = np.zeros((self.n * self.size, *found.shape[1:]))
        rows = np.zeros((self.linear.slope.shape[0], *found.shape[1:]))
        unknowns[self.linear.free], rows[self.linear.rows] = np.split(found, [self.linear.free.size])
        return unknowns, rows

    def _step(self, step: FloatArray, alive: BoolArray) -> FloatArray:
        """Move to the point that the equations say; give how far each frame has moved, shape (n_frames,)."""
        move, change = self.spread(np.nan_to_num(step))
        change_of_x = np.where(alive[:, None], move.reshape(self.n, self.size), 0.0)
        self.point.x = self.point.x + change_of_x
        size = np.maximum(np.abs(self.point.x).max(axis=1, initial=0.0), _TINY)
        far = np.abs(change_of_x).max(axis=1, initial=0.0) / size
        own = self.frame_of_row.size
        self.point.row = self.point.row + np.where(alive[self.frame_of_row], change[:own], 0.0)
        for i, turned in enumerate(self.turned):
            n_all = turned.rows.shape[0] * turned.rows.shape[1]
            entries = np.einsum("kes,ks->ke", turned.slopes, change_of_x)
            moved = turned.multiplier_change(change[own : own + n_all], entries)
            self.point.matrices[i] = turned.multiplier + moved
            own += n_all
        return np.asarray(far)
