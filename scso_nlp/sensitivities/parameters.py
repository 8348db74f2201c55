"""What a sensitivity may be asked for, and by which given numbers it reaches a program."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy.sparse as sp

from scso_nlp.arguments import checked
from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Term
from scso_nlp.muscle_models.muscle_classes import DIFFERENTIABLE
from scso_nlp.muscle_models.no_physiology import NoPhysiology
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.transcription.describe import FrameProgram
from scso_nlp.transcription.layout import PROBLEM, collect_data
from scso_nlp.transcription.piece import Key
from scso_nlp.validation import FloatArray, IntArray, matches

Quantity = Literal[
    "q",
    "level",
    "passive_stiffness",
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "generalized_forces",
    "moment_arms",
    "weights",
    "weight",
    "price",
    "exponent",
]

#: Quantities that expressions have as constants, zero moment arms among them: they are symbols where a
#: sensitivity to them is asked for.
_CONSTANTS = ("q", "exponent", "moment_arms", *DIFFERENTIABLE)
#: Moment arms enter data of terms as polynomials of at most the second degree: any step is exact [m].
_STEP = 0.1


@dataclass(frozen=True, kw_only=True)
@checked
class Parameter:
    """A number that a problem was given, or several that change together.

    Attributes
    ----------
    quantity : str
        ``"q"`` [-], ``"max_isometric_force"`` [N], ``"optimal_fiber_length"`` and ``"tendon_slack_length"``
        [m] of muscles; ``"level"`` and ``"passive_stiffness"`` [N·m/rad] of stability rows;
        ``"generalized_forces"`` [N·m or N] of coordinates; ``"moment_arms"`` [m] of ``"coordinate/muscle"``;
        ``"weights"`` [-] of muscles and actuators; ``"weight"`` of an objective, ``"price"`` of a constraint
        that may be missed and ``"exponent"`` [-] of an effort.
    of : str or sequence of str
        Names or patterns: all that fit change by the same amount. For the last three, names of terms.
    term : str
        Name of the one term whose numbers change, where several have such; all by default.
    frame : int or None
        The one frame in which they change (not for levels and what terms have once); all by default.
    relative : bool
        True to change each by the same share of itself: derivatives are per unit of that share.

    Raises
    ------
    ProblemError
        An unknown quantity.

    Examples
    --------
    >>> scso.Parameter(quantity="q", of="biceps").name
    'q[biceps]'
    """

    quantity: str
    of: str | Sequence[str] = "*"
    term: str = ""
    frame: int | None = None
    relative: bool = False

    def __post_init__(self) -> None:
        if self.quantity not in get_args(Quantity):
            raise ProblemError(
                f"quantity is {self.quantity!r}, expected one of {', '.join(get_args(Quantity))}"
            )
        object.__setattr__(self, "of", (self.of,) if isinstance(self.of, str) else tuple(self.of))

    @property
    def name(self) -> str:
        """What it is called: quantity, names in brackets unless it is all, term and frame."""
        inside = "" if self.of == ("*",) else f"[{','.join(self.of)}]"
        where = f" of {self.term}" if self.term else ""
        when = "" if self.frame is None else f" at frame {self.frame}"
        return f"{'relative ' if self.relative else ''}{self.quantity}{inside}{where}{when}"

    @classmethod
    def of_text(cls, text: str) -> Parameter:
        """Read ``"quantity"`` or ``"quantity[names, with or without patterns]"``."""
        quantity, bracket, inside = text.partition("[")
        if bracket and not inside.endswith("]"):
            raise ProblemError(f"parameter {text!r} has no closing bracket, expected e.g. 'q[soleus_*]'")
        names = [name.strip() for name in inside[:-1].split(",")] if bracket else ["*"]
        return cls(quantity=quantity, of=names)


def names_of(problem: MuscleForceProblem, quantity: str) -> tuple[str, ...]:
    """Name what a quantity is given for, e.g. all muscles, each once."""
    motion, trajectory = problem.motion, problem.motion.trajectory
    stability = [term for term in problem.constraints if isinstance(term, StabilityConstraint)]
    if quantity in ("level", "passive_stiffness"):
        return tuple(dict.fromkeys(row for term in stability for row in term.row_names(motion)))
    if quantity == "generalized_forces":
        return trajectory.coordinates
    if quantity == "moment_arms":
        return tuple(f"{c}/{m}" for c in trajectory.coordinates for m in trajectory.muscles)
    if quantity == "weights":
        return trajectory.muscles + trajectory.actuators
    if quantity in ("weight", "exponent"):
        return tuple(term.name for term in problem.objectives if hasattr(term, quantity))
    if quantity == "price":
        return tuple(term.name for term in stability if term.soft is not None)
    return trajectory.muscles


def symbols_for(parameters: Sequence[Parameter], problem: MuscleForceProblem) -> frozenset[str]:
    """Name the constants that have to be symbols.

    Raises
    ------
    ProblemError
        A term takes a number that depends on one of them as it is.
    """
    wanted = frozenset(p.quantity for p in parameters) & frozenset(_CONSTANTS)
    for term in problem.terms:
        hidden = sorted(wanted & set(term.unseen(problem.motion))) if wanted & set(DIFFERENTIABLE) else []
        if hidden:
            raise ProblemError(
                f"{term.name} does not see {hidden[0]}: it takes what depends on it as numbers; choose a "
                "muscle model with curves of its own (RigidTendon(convention='physical'), CompliantTendon "
                "without silent fibers), and weights by name"
            )
    return wanted


@dataclass(frozen=True, kw_only=True)
class Changes:
    """What parameters change of a program, per unit of each.

    Attributes
    ----------
    arrays : mapping of (owner, name) to sparse matrix, shape (n_frames * entries of a frame, n_parameters)
    lower : ndarray, shape (n_rows, n_parameters)
        Scaled lower bounds of the rows of a frame.
    levels : mapping of str to ndarray, shape (n, n_parameters) [N·m/rad]
        Levels of matrix inequalities, by term.
    costs : mapping of str to ndarray, shape (n_parameters,)
        Factors of objectives, by name.
    n_frames : int
    """

    arrays: dict[Key, sp.csr_matrix]
    lower: FloatArray
    levels: dict[str, FloatArray]
    costs: dict[str, FloatArray]
    n_frames: int

    @functools.cached_property
    def used(self) -> dict[Key, IntArray]:
        """Entries of a frame that some parameter changes, by array."""
        changed = {key: np.diff(change.indptr) > 0 for key, change in self.arrays.items()}
        return {
            key: np.flatnonzero(row.reshape(self.n_frames, -1).any(axis=0)) for key, row in changed.items()
        }


def changes_of(parameters: Sequence[Parameter], program: FrameProgram) -> Changes:
    """Say what each parameter changes.

    Parameters
    ----------
    parameters : sequence of Parameter
    program : FrameProgram
        Of the problem, with :func:`symbols_for` as symbols.

    Returns
    -------
    Changes

    Raises
    ------
    NameMismatchError
        Names that fit nothing.
    ProblemError
        A parameter that the problem has no number for, or whose number is none that could change.
    """
    found = _Collected(program, len(parameters))
    for i, parameter in enumerate(parameters):
        found.add(i, parameter)
    return Changes(
        arrays=found.sparse(),
        lower=found.lower,
        levels=found.levels,
        costs=found.costs,
        n_frames=program.time.size,
    )


class _Collected:
    def __init__(self, program: FrameProgram, n_parameters: int) -> None:
        self.program, self.problem, self.n = program, program.problem, n_parameters
        self.columns: dict[Key, dict[int, FloatArray]] = {}
        self.lower = np.zeros((len(program.rows), n_parameters))
        self.levels = {block.term: np.zeros((len(block.names), n_parameters)) for block in program.matrices}
        self.costs = {name: np.zeros(n_parameters) for name, _ in program.objectives}

    def sparse(self) -> dict[Key, sp.csr_matrix]:
        """Columns of all parameters by array, zero where one does not change it."""
        found = {}
        for key, columns in self.columns.items():
            places = {i: np.flatnonzero(column) for i, column in columns.items()}
            row = np.concatenate(list(places.values()))
            column = np.repeat(list(places), [where.size for where in places.values()])
            values = np.concatenate([columns[i][where] for i, where in places.items()])
            shape = (self.program.arrays[key].size, self.n)
            found[key] = sp.csr_matrix((values, (row, column)), shape=shape)
        return found

    def add(self, i: int, parameter: Parameter) -> None:
        """Collect what one parameter changes."""
        names = names_of(self.problem, parameter.quantity)
        if not names:
            raise ProblemError(f"the problem has no {parameter.quantity} that {parameter.name} could be")
        kind = f"name for {parameter.quantity}"
        chosen = np.zeros(len(names), dtype=bool)
        for pattern in parameter.of:
            chosen[matches(kind, pattern, names)] = True
        of = {"level": self._level, "passive_stiffness": self._passive, "moment_arms": self._arms}
        of |= dict.fromkeys(("weight", "price"), self._cost)
        seen = of.get(parameter.quantity, self._array)(i, parameter, dict(zip(names, chosen, strict=True)))
        if not seen:
            whose = f"term {parameter.term!r}" if parameter.term else "problem"
            raise ProblemError(
                f"no term of the {whose} has the number {parameter.name}; terms are "
                f"{', '.join(term.name for term in self.problem.terms)}"
            )

    def _change(self, i: int, parameter: Parameter, key: Key, direction: FloatArray) -> None:
        """Change an array by a direction (n_frames, …), times its values where the change is relative."""
        array = self.program.arrays[key]
        change = np.array(np.broadcast_to(direction, array.shape), dtype=float)
        if parameter.relative:
            change *= array
        if parameter.frame is not None:
            if not -len(change) <= parameter.frame < len(change):
                raise ProblemError(
                    f"frame of {parameter.name} is {parameter.frame}, expected one of {len(change)} frames"
                )
            only = np.zeros(len(change), dtype=bool)
            only[parameter.frame] = True
            change[~only] = 0.0
        columns = self.columns.setdefault(key, {})
        columns[i] = columns.get(i, 0.0) + change.ravel()

    def _is_meant(self, parameter: Parameter, term: str) -> bool:
        return parameter.term in ("", term)

    def _stability(
        self, parameter: Parameter, chosen: dict[str, bool]
    ) -> list[tuple[StabilityConstraint, FloatArray]]:
        """Stability constraints that are meant, and which of their rows change, shape (n_rows,)."""
        motion = self.problem.motion
        return [
            (term, np.array([chosen[row] for row in term.row_names(motion)], dtype=float))
            for term in self.problem.constraints
            if isinstance(term, StabilityConstraint) and self._is_meant(parameter, term.name)
        ]

    def _array(self, i: int, parameter: Parameter, chosen: dict[str, bool]) -> bool:
        direction = np.array(list(chosen.values()), dtype=float)
        name = parameter.quantity
        keys = [key for key in self.program.arrays if key[1] == name and self._is_meant(parameter, key[0])]
        if name == "exponent":
            keys = [key for key in keys if chosen.get(key[0])]
            without = [term for term, meant in chosen.items() if meant and (term, name) not in keys]
            if without and not parameter.term:
                raise ProblemError(f"the exponent of {without[0]} cannot be differentiated by")
            for key in keys:
                if not np.isfinite(self.program.arrays[key]).all():
                    raise ProblemError(f"the exponent of {key[0]} is infinite, which cannot change a little")
            direction = np.ones(1)
        if name == "weights":
            efforts = {term.name for term in self.problem.objectives}
            keys = [k for k in keys if k[0] in efforts and self.program.arrays[k].shape[1] == direction.size]
        for key in keys:
            self._change(i, parameter, key, direction)
        return bool(keys)

    def _level(self, i: int, parameter: Parameter, chosen: dict[str, bool]) -> bool:
        self._refuse_frame(parameter)
        meant = self._stability(parameter, chosen)
        for term, direction in meant:
            level = term.by_row(term.level, term.row_names(self.problem.motion))
            change = direction * (level if parameter.relative else 1.0)
            if term.name in self.levels:
                self.levels[term.name][:, i] += change
            for block, where in self.program.rows:
                if block.term == term.name:
                    self.lower[where, i] += change / block.scale
        return bool(meant)

    def _passive(self, i: int, parameter: Parameter, chosen: dict[str, bool]) -> bool:
        meant = self._stability(parameter, chosen)
        for term, direction in meant:
            change = direction
            if parameter.relative:
                change = change * term.by_row(term.passive_stiffness, term.row_names(self.problem.motion))
            absolute = replace(parameter, relative=False)
            if isinstance(term, HessianStability):
                (block,) = (b for b in self.program.matrices if b.term == term.name)
                row, column = block.triangle
                self._change(i, absolute, block.constant, np.where(row == column, change[row], 0.0))
            else:
                self._change(i, absolute, (term.name, "load"), -change)
        return bool(meant)

    def _arms(self, i: int, parameter: Parameter, chosen: dict[str, bool]) -> bool:
        arms = self.program.arrays[(PROBLEM, "moment_arms")]
        direction = np.array(list(chosen.values()), dtype=float).reshape(arms.shape[1:])
        step = _STEP * np.broadcast_to(direction, arms.shape) * (arms if parameter.relative else 1.0)
        above, below = (_given(self.problem, arms + sign * step) for sign in (1.0, -1.0))
        absolute = replace(parameter, relative=False)
        for key, high in above.items():
            if key in self.program.arrays and not np.array_equal(high, below[key]):
                self._change(i, absolute, key, (high - below[key]) / (2 * _STEP))
        return True

    def _cost(self, i: int, parameter: Parameter, chosen: dict[str, bool]) -> bool:
        self._refuse_frame(parameter)
        terms: list[Term] = [
            t for t in self.problem.terms if chosen.get(t.name) and self._is_meant(parameter, t.name)
        ]
        for term in terms:
            is_price = parameter.quantity == "price"
            name = f"{term.name}.missed" if is_price else term.name
            size = float(getattr(term, "soft" if is_price else "weight"))
            if size == 0:
                raise ProblemError(f"weight of {term.name} is 0: its cost is not in the problem")
            self.costs[name][i] += 1.0 if parameter.relative else 1.0 / size
        return bool(terms)

    def _refuse_frame(self, parameter: Parameter) -> None:
        if parameter.frame is not None:
            raise ProblemError(
                f"{parameter.name}: a {parameter.quantity} is one for all frames; leave the frame out"
            )


def _given(problem: MuscleForceProblem, moment_arms: FloatArray) -> dict[Key, FloatArray]:
    """Numbers that the constraints of a problem are given with other moment arms."""
    motion = replace(problem.motion, trajectory=replace(problem.motion.trajectory, moment_arms=moment_arms))
    problem = replace(problem, motion=motion, muscle_model=NoPhysiology())
    given = collect_data(problem)
    for term in problem.constraints:
        if isinstance(term, HessianStability):
            given[(term.name, "matrices of the inequality")] = term.terms(motion).triangles()[0]
    return given
