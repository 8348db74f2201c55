"""Exact derivatives of an optimum by what its problem was given."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.display import without_arrays
from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models.muscle_classes import DIFFERENTIABLE
from scso_nlp.sensitivities.conditions import Conditions
from scso_nlp.sensitivities.parameters import Parameter, changes_of, symbols_for
from scso_nlp.sensitivities.right_sides import RightSides, right_sides
from scso_nlp.solution import Solution
from scso_nlp.solver.described import program_of
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import describe
from scso_nlp.transcription.layout import PROBLEM
from scso_nlp.validation import BoolArray, FloatArray


class Regularity(enum.Enum):
    """Whether a frame has derivatives; the value is a sentence."""

    REGULAR = "the optimum changes smoothly"
    KINK = "a bound, row or turn is neither clearly active nor clearly inactive: both sides differ"
    SINGULAR = "the optimum or its multipliers are not unique to first order, or too far from what was solved"
    COUPLED = "another frame, which terms couple with this one, has no derivatives"
    NOT_SOLVED = "the frame was not solved"


@dataclass(frozen=True, kw_only=True)
@checked
class Sensitivity:
    """Derivatives of an optimum, per unit of each parameter; NaN in frames that are not regular.

    Attributes
    ----------
    solution : Solution
        What is differentiated.
    parameters : tuple of Parameter
    regularity : tuple of Regularity, one per frame
    activation : ndarray, shape (n_frames, n_parameters, n_muscles) [1/unit]
    control : ndarray, shape (n_frames, n_parameters, n_actuators) [1/unit]
    tendon_force : ndarray, shape (n_frames, n_parameters, n_muscles) [N/unit]
    variables : mapping of str to ndarray, shape (n_frames, n_parameters, n)
        As in the solution, by ``"<term>.<name>"``.
    row_value, row_multiplier : mapping of str to ndarray, shape (n_frames, n_parameters, n_rows)
        Of the rows and their multipliers, by constraint name; rows of a pair stand at its later frame. NaN
        for the multiplier of a row that is tight because bounds alone keep it: it is not unique.
    matrix_multiplier : mapping of str to ndarray, shape (n_frames, n_parameters, n, n)
        Of the multipliers of matrix inequalities, by constraint name.
    frame_objective : ndarray, shape (n_frames, n_parameters)
        What each frame adds to the derivative of the objective.

    Examples
    --------
    >>> change = scso.sensitivity(solution, ["generalized_forces", "max_isometric_force[biceps]"])
    >>> change.activation[1].round(6)
    array([[ 5.794e-03,  2.398e-03,  7.990e-04],
           [-8.300e-05,  8.500e-05, -1.100e-05]])
    """

    solution: Solution
    parameters: tuple[Parameter, ...]
    regularity: tuple[Regularity, ...]
    activation: FloatArray
    control: FloatArray
    tendon_force: FloatArray
    variables: Mapping[str, FloatArray]
    row_value: Mapping[str, FloatArray]
    row_multiplier: Mapping[str, FloatArray]
    matrix_multiplier: Mapping[str, FloatArray]
    frame_objective: FloatArray

    __repr__ = without_arrays

    @property
    def names(self) -> tuple[str, ...]:
        """What the parameters are called."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def is_regular(self) -> BoolArray:
        """Tell which frames have derivatives, shape (n_frames,)."""
        return np.array([found is Regularity.REGULAR for found in self.regularity])

    @property
    def objective(self) -> FloatArray:
        """Of the objective of all frames, shape (n_parameters,); NaN if some frame has no derivative."""
        return np.asarray(self.frame_objective.sum(axis=0))


@dataclass(frozen=True, kw_only=True)
@checked
class Gradient:
    """Derivatives of one number made of an optimum by many parameters.

    Attributes
    ----------
    parameters : tuple of Parameter
    regularity : tuple of Regularity, one per frame
    value : ndarray, shape (n_parameters,)
        Per unit of each parameter; NaN if a frame that counts has no derivatives.
    """

    parameters: tuple[Parameter, ...]
    regularity: tuple[Regularity, ...]
    value: FloatArray


@checked
def sensitivity(solution: Solution, parameters: Sequence[str | Parameter]) -> Sensitivity:
    r"""Differentiate an optimum by numbers that its problem was given, exactly and in all frames.

    The conditions of the optimum of the whole motion are factorised once, and solved with one right side for
    each parameter. Bounds, rows and turns that hold with a multiplier stay active, all others inactive.

    Parameters
    ----------
    solution : Solution
        Of any solver of this package.
    parameters : sequence of str or Parameter
        ``"q"``, ``"q[soleus_*]"`` and the like, or :class:`Parameter`.

    Returns
    -------
    Sensitivity
        With NaN and a reason in frames in which the optimum has no derivative: where a multiplier and its
        distance are both below 1e-7 of what they are made of, or where the conditions are singular.

    Raises
    ------
    ProblemError
        A quantity that is not there, or that a term takes as numbers.
    NameMismatchError
        Names that fit nothing.

    Notes
    -----
    Moment arms are those of the coordinates: rows about joint axes have their own, which stay. Lengths of
    fibers and tendons act through the muscle model; bounds of activations are no parameters.

    References
    ----------
    Fiacco (1976), Math Program 10:287-311; for matrix inequalities Shapiro (1997), Math Program 77:301-320.

    Examples
    --------
    >>> change = scso.sensitivity(solution, ["q", "exponent"])
    >>> change.names, bool(change.is_regular[1:].all()), change.tendon_force.shape
    (('q', 'exponent'), True, (7, 2, 3))
    """
    with one_thread():
        return _Differentiated(solution, parameters).forward()


@checked
def adjoint_sensitivity(
    solution: Solution,
    parameters: Sequence[str | Parameter],
    *,
    activation: FloatArray | None = None,
    tendon_force: FloatArray | None = None,
    control: FloatArray | None = None,
) -> Gradient:
    r"""Differentiate one number made of an optimum by many parameters: one solve for all of them.

    Parameters
    ----------
    solution : Solution
    parameters : sequence of str or Parameter
        As for :func:`sensitivity`.
    activation : ndarray, shape (n_frames, n_muscles), optional
        Derivatives of the number by activations.
    tendon_force : ndarray, shape (n_frames, n_muscles), optional [1/N]
        By tendon forces.
    control : ndarray, shape (n_frames, n_actuators), optional
        By controls.

    Returns
    -------
    Gradient

    Raises
    ------
    DataError
        Derivatives of another shape.
    ProblemError, NameMismatchError
        As for :func:`sensitivity`.

    Examples
    --------
    >>> goal = 2 * solution.activation  # of the sum of squares, which is the objective
    >>> found = scso.adjoint_sensitivity(solution, ["generalized_forces"], activation=goal)
    >>> bool(abs(found.value - scso.sensitivity(solution, ["generalized_forces"]).objective) < 1e-9)
    True
    """
    given = {"activation": activation, "tendon_force": tendon_force, "control": control}
    for name, values in given.items():
        expected = getattr(solution, name).shape
        if values is not None and np.shape(values) != expected:
            raise DataError(f"{name} has shape {np.shape(values)}, expected {expected}, as in the solution")
    with one_thread():
        return _Differentiated(solution, parameters).backward(
            {name: np.asarray(values, dtype=float) for name, values in given.items() if values is not None}
        )


class _Differentiated:
    """A solution with the settled conditions of its optimum, and what parameters change of them."""

    def __init__(self, solution: Solution, parameters: Sequence[str | Parameter]) -> None:
        wanted = [parameters] if isinstance(parameters, str) else parameters
        self.parameters = tuple(Parameter.of_text(p) if isinstance(p, str) else p for p in wanted)
        self.solution = solution
        self.program = program = program_of(solution)
        problem = replace(solution.problem, observed=())
        if symbols := symbols_for(self.parameters, problem):
            self.program = describe(problem, symbols, program)
        self.changes = changes_of(self.parameters, self.program)
        self.conditions = Conditions(program, solution)
        self.conditions.settle()
        self.right: RightSides = right_sides(self.conditions, self.program, self.changes)
        self._look_at_bounds_that_move()

    def _look_at_bounds_that_move(self) -> None:
        """Find what parameters move that only rests: unknowns without slope, bounds, rows kept by bounds."""
        conditions, layout = self.conditions, self.program.layout
        moving = np.zeros(conditions.size, dtype=bool)
        if any(parameter.quantity in DIFFERENTIABLE for parameter in self.parameters):
            for block in layout.blocks:
                moving[block.columns] = block.owner == self.program.problem.muscle_model.name
        held = (np.abs(conditions.at_bound) == 1) & np.tile(moving, conditions.n)
        disturbed = conditions.at_rest.copy()
        disturbed[disturbed] = (self.right.lagrangian[disturbed] != 0).any(axis=1)
        kink = (held | disturbed).reshape(conditions.n, -1).any(axis=1)
        rows = np.flatnonzero(conditions.implied)
        rows = rows[(self.right.values[rows] != 0).any(axis=1)]
        kink[conditions.frame_of_row[rows]] = True
        kink &= conditions.usable
        conditions.is_kink = conditions.is_kink | kink
        regular = conditions.is_regular & ~kink
        conditions.is_regular = regular & (not conditions.is_coupled or bool(regular.all()))

    @property
    def regularity(self) -> tuple[Regularity, ...]:
        """Say of each frame whether it has derivatives."""
        found, conditions = [], self.conditions
        for usable, regular, kink, singular in zip(
            conditions.usable, conditions.is_regular, conditions.is_kink, conditions.is_singular, strict=True
        ):
            if regular:
                found.append(Regularity.REGULAR)
            elif not usable:
                found.append(Regularity.NOT_SOLVED)
            elif singular:
                found.append(Regularity.SINGULAR)
            else:
                found.append(Regularity.KINK if kink else Regularity.COUPLED)
        return tuple(found)

    def forward(self) -> Sensitivity:
        """Solve with the right sides of all parameters."""
        conditions, program, n = self.conditions, self.program, self.conditions.n
        linear, right = conditions.linear, self.right
        both = np.concatenate([right.lagrangian[linear.free], right.rows[linear.rows]])
        np.negative(both, out=both)
        unknowns, multipliers = conditions.spread(linear.solve(both))
        by_frame = unknowns.reshape(n, conditions.size, -1)
        by_frame[~conditions.is_regular] = np.nan
        parts = {
            (b.owner, b.spec.name): _turned(by_frame[:, b.columns] * program.layout.scale[b.columns, None])
            for b in program.layout.blocks
        }
        values = conditions.slope @ unknowns + right.values
        own = len(values)
        row_value, row_multiplier = self._by_term(values, multipliers[:own], by_frame)
        matrices = {}
        for i, turned in enumerate(conditions.turned):
            n_all = turned.rows.shape[0] * turned.rows.shape[1]
            change = turned.slopes @ by_frame + right.matrices[i]
            matrices[turned.model.block.term] = self._blanked(
                np.stack(
                    [
                        turned.multiplier_change(rows, change[:, :, k])
                        for k, rows in enumerate(multipliers[own : own + n_all].T)
                    ],
                    axis=1,
                )
            )
            own += n_all
        return Sensitivity(
            solution=self.solution,
            parameters=self.parameters,
            regularity=self.regularity,
            activation=parts.pop((PROBLEM, "activation")),
            control=parts.pop((PROBLEM, "control")),
            tendon_force=_turned(self._tendon_force(by_frame)),
            variables={f"{owner}.{name}": values for (owner, name), values in parts.items()},
            row_value=row_value,
            row_multiplier=row_multiplier,
            matrix_multiplier=matrices,
            frame_objective=self._blanked(right.objective.copy()),
        )

    def backward(self, weights: Mapping[str, FloatArray]) -> Gradient:
        """Solve once with what the number depends on, and multiply by the right sides."""
        conditions, layout, n = self.conditions, self.program.layout, self.conditions.n
        weight = np.zeros((n, conditions.size))
        value = np.zeros(len(self.parameters))
        counts = np.zeros(n, dtype=bool)
        for name, given in weights.items():
            counts |= (given != 0).any(axis=1)
            if name == "tendon_force":
                row, column, entries = self.right.tendon_force_slopes
                for i, (m, j) in enumerate(zip(row, column, strict=True)):
                    weight[:, j] += given[:, m] * entries[:, i]
                value += np.einsum("kmp,km->p", self.right.tendon_force, given)
            else:
                for b in layout.blocks:
                    if (b.owner, b.spec.name) == (PROBLEM, name):
                        weight[:, b.columns] += given * layout.scale[b.columns]
        linear = conditions.linear
        right = np.concatenate([weight.ravel()[linear.free], np.zeros(linear.rows.size)])
        regular = (
            np.concatenate([self.right.lagrangian[linear.free], self.right.rows[linear.rows]])
            * conditions.is_regular[linear.frame][:, None]
        )
        value -= linear.solve(right) @ regular
        if (counts & ~conditions.is_regular).any():
            value[:] = np.nan
        return Gradient(parameters=self.parameters, regularity=self.regularity, value=value)

    def _tendon_force(self, change: FloatArray) -> FloatArray:
        """Change of tendon forces (n_frames, n_muscles, n_parameters) with that of the unknowns."""
        row, column, entries = self.right.tendon_force_slopes
        result = self.right.tendon_force.copy()
        if np.unique(row).size == row.size:  # one unknown a muscle
            result[:, row] += entries[:, :, None] * change[:, column]
            return result
        for i, (m, j) in enumerate(zip(row, column, strict=True)):
            result[:, m] += entries[:, i, None] * change[:, j]
        return result

    def _by_term(
        self, values: FloatArray, multipliers: FloatArray, by_frame: FloatArray
    ) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Sort changes of rows and of their multipliers by constraint, unscaled, as solutions have them."""
        conditions = self.conditions
        found: tuple[dict[str, list[FloatArray]], dict[str, list[FloatArray]]] = ({}, {})
        for is_pair, table in enumerate((self.program.rows, self.program.pair_rows)):
            for block, where in table:
                places = conditions.places(is_pair, np.arange(where.start, where.stop))
                value = block.scale * values[places]
                if block.missed is not None:
                    value -= block.scale * by_frame[:, block.missed : block.missed + len(block.names)]
                sign = np.where(conditions.at_row == 2, -1.0, conditions.at_row)[places] / block.scale
                multiplier = sign[:, :, None] * multipliers[places]
                multiplier[conditions.implied[places]] = np.nan
                for target, change in zip(found, (value, multiplier), strict=True):
                    gap = np.full((is_pair, *change.shape[1:]), np.nan)
                    whole = self._blanked(np.concatenate([gap, change]) if is_pair else change)
                    target.setdefault(block.term, []).append(_turned(whole))
        first, second = (
            {term: np.concatenate(parts, axis=2) for term, parts in each.items()} for each in found
        )
        return first, second

    def _blanked(self, values: FloatArray) -> FloatArray:
        """Take derivatives (n_frames, …) out of frames that have none."""
        values[~self.conditions.is_regular] = np.nan
        return values


def _turned(values: FloatArray) -> FloatArray:
    """Put parameters (n_frames, n, n_parameters) before what changes with them."""
    return values.transpose(0, 2, 1)
