r"""Matrix inequalities of convex frames with affine rows, by cutting planes.

Any unit vector v gives a row :math:`v^T G(x)\, v \ge 0` that every point with :math:`G \succeq 0` keeps.
Frames are solved without such rows first. Where an eigenvalue is negative the rows of eigenvectors are added,
and the frame goes on from where it is (Kelley 1960, J Soc Indust Appl Math 8:703-712): what keeps the
inequality in the end is its optimum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.solver.convex_objective import ConvexObjective
from scso_nlp.solver.local_model import LocalModel
from scso_nlp.solver.presolve import FRAMES_AT_ONCE, Block, Start, presolve
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.turns import MatrixModel, matrix_sizes, part_of
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: An eigenvalue below zero by less than this share of its scale counts as kept [-].
EIGENVALUE_TOLERANCE = 1e-6
#: Least and largest share that this may be of what the entries of the matrix add up to [-].
_SHARES_OF_ENTRIES = (1e-11, 1e-8)

#: Most steps of a frame after its optimum without turns, and most turns that may hold together.
_MOST_STEPS, _MOST_HOLDING = 20, 6

#: Steps without the curvature of eigenvalues, and the least gap to others over the largest eigenvalue [-].
_STRAIGHT_STEPS, _LEAST_GAP = 3, 1e-9

#: A frame without new turns has arrived where its unknowns move by less than this much of the largest, and
#: one of two steps promises nothing: the active-set method rounds them differently [-].
_STILL = 1e-9

#: Frames take Newton's steps once no eigenvalue is below zero by more than so many times what it may be: rows
#: of the lowest eigenvectors then stand for all turns of which these leave no more than this of the square.
_NEARLY, _INSIDE = 100.0, 1e-3

#: Turns that hold are brought this near to the eigenvectors that they are for [rad].
_TURNED = 1e-9

#: Eigenvalues are brought to this share of what they may be below zero.
_SHARE_OF_TOLERANCE = 1e-4

#: Least share of the largest multiplier's eigenvalue with which a direction holds.
_LEAST_SHARE = 1e-3

#: Sides of the active-set programs are solved to this much of the frame's scale [-].
_TOLERANCE = 1e-12


@dataclass(frozen=True, kw_only=True)
class Cut:
    """What cutting planes have found.

    Attributes
    ----------
    start : Start
        Of the program with no turns; optimal in the frames that are found.
    turns : tuple of ndarray, shape (n_frames, n_turns, n) [-]
        Of each matrix: unit vectors of the rows that hold; zeros where a frame has fewer.
    multipliers : tuple of ndarray, shape (n_frames, n_turns)
        Of these rows.
    is_found : ndarray of bool, shape (n_frames,)
        Frames at the optimum with their matrix inequalities.
    """

    start: Start
    turns: tuple[FloatArray, ...]
    multipliers: tuple[FloatArray, ...]
    is_found: BoolArray


def cut(model: LocalModel, start: FloatArray, known: Start | None = None) -> Cut:
    """Solve frames with their matrix inequalities.

    Parameters
    ----------
    model : LocalModel
        Of a program whose frames are apart and whose rows and matrices are affine.
    start : ndarray, shape (n_frames, n_unknowns)
        Scaled.
    known : Start, optional
        Frames that are at their optimum without matrix inequalities.

    Returns
    -------
    Cut
    """
    program, n = model.program, len(start)
    every = np.arange(n)
    found = presolve(program, start, every, known)
    least = []
    for matrix in model.matrices:
        with one_thread():
            least.append(np.linalg.eigvalsh(matrix.value(found.unknowns, program.arrays))[:, 0])
    lowest = np.min(least, axis=0)
    allowed = [
        allowed_below_zero(program, matrix, found.unknowns, every, lowest) for matrix in model.matrices
    ]
    below = np.any([value < -most for value, most in zip(least, allowed, strict=True)], axis=0)
    below &= found.is_optimal
    is_found = found.is_optimal & ~below
    sizes = [len(matrix.block.names) for matrix in model.matrices]
    turns = [np.zeros((n, 0, size)) for size in sizes]
    multipliers = [np.zeros((n, 0)) for _ in sizes]
    objective, frames = ConvexObjective.of(program), np.flatnonzero(below)
    for part in np.array_split(frames, -(-frames.size // FRAMES_AT_ONCE)) if frames.size else ():
        cutting = _Cutting(model, objective, part, found, allowed)
        with one_thread():
            cutting.solve()
        good = ~cutting.is_lost & ~cutting.block.hides()
        is_found[part] = good
        found = cutting.start(found, good)
        for i, (new, weight) in enumerate(cutting.holding()):
            width = max(new.shape[1], turns[i].shape[1])
            turns[i] = np.pad(turns[i], ((0, 0), (0, width - turns[i].shape[1]), (0, 0)))
            multipliers[i] = np.pad(multipliers[i], ((0, 0), (0, width - multipliers[i].shape[1])))
            turns[i][part[good], : new.shape[1]] = new[good]
            multipliers[i][part[good], : new.shape[1]] = weight[good]
    return Cut(start=found, turns=tuple(turns), multipliers=tuple(multipliers), is_found=is_found)


class _Cutting:
    """Some frames that do not keep their matrix inequalities, on their way."""

    def __init__(
        self,
        model: LocalModel,
        objective: ConvexObjective,
        frames: IntArray,
        plain: Start,
        allowed: list[FloatArray],
    ) -> None:
        program = model.program
        self.matrices, self.affine = model.matrices, program.split.affine.rows
        self.block = Block(program, objective, frames, plain.unknowns[frames], _TOLERANCE)
        self.block.multipliers = plain.multipliers[np.ix_(frames, self.affine)]
        self.bent: dict[int, FloatArray] = {}
        self.frames, self.is_lost = frames, np.zeros(frames.size, dtype=bool)
        self.allowed = [most[frames] for most in allowed]
        self.least = [np.full(frames.size, -np.inf) for _ in allowed]
        self.angle = [np.full(frames.size, np.inf) for _ in allowed]
        arrays, zero = part_of(program, frames), np.zeros((frames.size, program.layout.size))
        self.parts = [matrix.triangle(zero, arrays) for matrix in self.matrices]
        self.turns = [np.zeros((frames.size, 0, len(matrix.block.names))) for matrix in self.matrices]
        self.places = [np.zeros(0, dtype=np.int64) for _ in self.matrices]

    def solve(self) -> None:
        """Add turns and take steps until no eigenvalue is negative."""
        going = np.zeros(self.frames.size, dtype=bool)
        for n_steps in range(_MOST_STEPS):
            self.bent.clear()
            new = self._add_turns(is_late=n_steps >= _STRAIGHT_STEPS)
            going = (going | new) & ~self.is_lost
            if not going.any():
                break
            before, was_near = self.block.unknowns.copy(), self.block.is_near
            going, lost = self.block.advance(going, n_steps, self.bent)
            moved = np.abs(self.block.unknowns - before).max(axis=1, initial=0.0)
            is_still = moved <= _STILL * np.abs(before).max(axis=1, initial=0.0)
            going &= new | ~(is_still & (was_near | self.block.is_near))
            going[list(self.bent)] = True
            self.is_lost |= lost
            going &= ~lost
        else:
            self.is_lost |= going | self._add_turns(is_late=False)
        self.block.settle()

    def start(self, plain: Start, which: BoolArray) -> Start:
        """Put what has been found in some frames into a start of all."""
        frames = self.frames[which]
        unknowns, multipliers = plain.unknowns.copy(), plain.multipliers.copy()
        reduced, confirmed = plain.reduced_cost.copy(), plain.is_confirmed.copy()
        unknowns[frames] = self.block.unknowns[which]
        multipliers[np.ix_(frames, self.affine)] = self.block.multipliers[which, : self.affine.size]
        reduced[frames] = self.block.reduced_cost()[which]
        confirmed[frames] = False
        return replace(
            plain,
            unknowns=unknowns,
            multipliers=multipliers,
            reduced_cost=reduced,
            is_confirmed=confirmed,
        )

    def _add_turns(self, *, is_late: bool) -> BoolArray:
        """Add rows where eigenvalues are negative or turn; tell in which frames, shape (n_frames,).

        Late or kept ones get the curvature of these eigenvalues for their next step, which is Newton's where
        eigenvalues are nearly kept.
        """
        new = np.zeros(self.frames.size, dtype=bool)
        for i, (matrix, (constant, slopes)) in enumerate(zip(self.matrices, self.parts, strict=True)):
            entries = constant + (slopes @ self.block.unknowns[:, :, None])[:, :, 0]
            values, vectors = np.linalg.eigh(matrix.block.filled(entries))
            negative = (values < -_SHARE_OF_TOLERANCE * self.allowed[i][:, None]).sum(axis=1)
            # near the end the active-set method's own tolerance is what is left
            stays = (values[:, 0] >= -self.allowed[i]) & (values[:, 0] < self.least[i] / 2)
            self.least[i] = values[:, 0]
            wanted = np.where(self.is_lost | stays, 0, negative)
            held = self._holding_directions(i)
            turned, is_near = self._turned(i, held, vectors), values[:, 0] >= -self.allowed[i]
            turns_on = is_near & ~self.is_lost & (turned > _TURNED) & (turned < self.angle[i] / 2)
            wanted = np.where(turns_on, np.maximum(wanted, 1), wanted)
            self.angle[i] = np.where(turns_on, turned, self.angle[i])
            if not wanted.any():
                continue
            wanted = np.where(wanted > 0, np.maximum(wanted, held), 0)
            self.is_lost |= wanted > _MOST_HOLDING
            wanted[self.is_lost] = 0
            bends = (wanted > 0) & (held > 0) & (is_late | is_near)
            for k in np.flatnonzero(bends):
                r = int(wanted[k])
                vectors[k, :, :r] = self._bend(i, int(k), r, values[k], vectors[k])
            turns = _turns_of(vectors, wanted, held > 0)
            is_newton = bends & (values[:, 0] >= -_NEARLY * self.allowed[i])
            self._drop_inside(i, vectors, np.where(is_newton, wanted, 0))
            products = matrix.products(turns) / matrix.block.scale
            first = self.block.matrix.shape[1]
            self.block.add_rows(products @ slopes, -(products @ constant[:, :, None])[:, :, 0])
            self.places[i] = np.append(self.places[i], np.arange(first, first + turns.shape[1]))
            self.turns[i] = np.concatenate([self.turns[i], turns], axis=1)
            new |= wanted > 0
        return new

    def _turned(self, i: int, held: IntArray, vectors: FloatArray) -> FloatArray:
        """Say by what angle turns that hold are off the lowest eigenvectors, shape (n_frames,)."""
        weight = np.abs(self.block.multipliers[:, self.places[i]])
        holds = weight > _LEAST_SHARE * weight.max(axis=1, initial=0.0, keepdims=True)
        others = np.abs(self.turns[i] @ vectors)
        beyond = np.arange(vectors.shape[2]) >= held[:, None, None]
        return np.where(holds[:, :, None] & beyond, others, 0.0).max(axis=(1, 2), initial=0.0)

    def _drop_inside(self, i: int, vectors: FloatArray, count: IntArray) -> None:
        """Drop the rows of turns that the first vectors almost span: those that come stand for them."""
        own = np.arange(vectors.shape[2]) < count[:, None, None]
        inside = np.where(own, (self.turns[i] @ vectors) ** 2, 0.0).sum(axis=2)
        frame, row = np.nonzero(inside > 1 - _INSIDE)
        self.block.used[frame, self.places[i][row]] = False
        self.block.multipliers[frame, self.places[i][row]] = 0.0

    def _bend(self, i: int, k: int, r: int, values: FloatArray, vectors: FloatArray) -> FloatArray:
        r"""Add the curvature of the r lowest eigenvalues of a frame, times what they hold.

        Gives the r vectors turned among themselves until each holds by itself, shape (n, r).

        .. math:: C_{xy} = 2 \sum_{aj} \frac{(b_a^T G_x v_j)\,(b_a^T G_y v_j)}{\lambda_j}, \quad
                  \sum_a b_a b_a^T = V_r V_r^T Z V_r V_r^T

        (Overton and Womersley 1995, SIAM J Matrix Anal Appl 16:697-718, with the held eigenvalues zero.)
        """
        matrix, slopes = self.matrices[i], self.parts[i][1][k]
        weight, turns = np.abs(self.block.multipliers[k, self.places[i]]), self.turns[i][k] @ vectors[:, :r]
        share, basis = np.linalg.eigh(turns.T @ (weight[:, None] * turns))
        turned = np.asarray(vectors[:, :r] @ basis)
        held = (turned * np.sqrt(np.maximum(share, 0.0))).T
        gap = np.maximum(values[r:], _LEAST_GAP * np.abs(values).max())
        others = vectors[:, r:].T / np.sqrt(gap)[:, None]
        mixed = matrix.products(held[:, None], others[None]).reshape(-1, len(slopes)) @ slopes
        curvature = 2 / matrix.block.scale * mixed.T @ mixed
        self.bent[k] = self.bent[k] + curvature if k in self.bent else curvature
        return turned

    def _holding_directions(self, i: int) -> IntArray:
        """Count the directions in which a matrix is held, shape (n_frames,)."""
        weight = np.abs(self.block.multipliers[:, self.places[i]])
        turns = self.turns[i]
        values = np.linalg.eigvalsh(turns.transpose(0, 2, 1) @ (weight[:, :, None] * turns))
        return np.asarray((values > np.maximum(_LEAST_SHARE * values[:, -1:], 0.0)).sum(axis=1))

    def holding(self) -> list[tuple[FloatArray, FloatArray]]:
        """Give the turns of each matrix that hold, and the multipliers of their rows."""
        found = []
        for place, turns in zip(self.places, self.turns, strict=True):
            weight = self.block.multipliers[:, place]
            order = np.argsort(weight == 0, axis=1, kind="stable")
            width = int((weight != 0).sum(axis=1).max(initial=0))
            order = order[:, :width]
            weight = np.take_along_axis(weight, order, axis=1)
            chosen = np.take_along_axis(turns, order[:, :, None], axis=1)
            found.append((np.where(weight[:, :, None] != 0, chosen, 0.0), weight))
        return found


def _turns_of(vectors: FloatArray, count: IntArray, with_sums: BoolArray) -> FloatArray:
    """Take the first eigenvectors of every frame and, if asked, their sums and differences."""
    count = np.minimum(count, vectors.shape[2])
    each = np.where(with_sums, count * count, count)
    turns = np.zeros((len(vectors), int(each.max(initial=0)), vectors.shape[1]))
    for number, r in {(int(m), int(r)) for m, r in zip(each, count, strict=True) if r}:
        frames = np.flatnonzero((count == r) & (each == number))
        mix = sums_and_differences(r)[:number]
        mix = mix / np.linalg.norm(mix, axis=1, keepdims=True)
        turns[frames, :number] = mix @ vectors[frames, :, :r].transpose(0, 2, 1)
    return turns


def allowed_below_zero(
    program: FrameProgram, matrix: MatrixModel, unknowns: FloatArray, frames: IntArray, least: FloatArray
) -> FloatArray:
    """Say how far the least eigenvalues of some frames may be below zero.

    Parameters
    ----------
    program : FrameProgram
    matrix : MatrixModel
    unknowns : ndarray, shape (n, n_unknowns)
        Scaled.
    frames : ndarray of int, shape (n,)
    least : ndarray, shape (n,) [unit of the matrix]
        Least eigenvalues.

    Returns
    -------
    ndarray, shape (n,) [unit of the matrix]
        Zero where the eigenvalue is not below zero.
    """
    allowed, below = np.zeros(frames.size), np.flatnonzero(least < 0)
    sizes = matrix_sizes(program, matrix, unknowns[below], frames[below])
    smallest, largest = _SHARES_OF_ENTRIES
    allowed[below] = np.clip(EIGENVALUE_TOLERANCE * matrix.block.scale, smallest * sizes, largest * sizes)
    return allowed


def sums_and_differences(r: int) -> FloatArray:
    """Rows e_i, e_i + e_j and e_i - e_j, r² of them."""
    one = np.eye(r)
    pairs = [(i, j, sign) for i in range(r) for j in range(i) for sign in (1.0, -1.0)]
    return np.vstack([one, *[(one[i] + sign * one[j])[None] for i, j, sign in pairs]])
