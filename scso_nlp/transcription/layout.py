"""Where each unknown stands, and the symbols that stand for one frame's unknowns and data.

The only place where arrays (frames first) and columns of symbols (one frame each) meet.
"""

from __future__ import annotations

import contextlib
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError, ProblemError, ScsoError
from scso_nlp.frame import Frame, MuscleState, VariableSpec, as_number
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.validation import FloatArray, IntArray

#: What own terms are told that treat symbols like numbers.
ABOUT_SYMBOLS = (
    "a frame holds symbols, not numbers: casadi.if_else, casadi.fmax and casadi.sqrt work on them, if, max "
    "and math.sqrt do not"
)
#: How errors of CasADi begin.
_PLACE_IN_CASADI = re.compile(r"^\S*casadi/\S*: ")

#: All frames, as an index.
ALL = slice(None)


@dataclass(frozen=True, kw_only=True)
class Block:
    """Consecutive unknowns of one frame: where they stand, their bounds, guess and scale."""

    owner: str
    spec: VariableSpec
    start: int

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.spec.labels)

    @property
    def columns(self) -> slice:
        """Where they stand among the unknowns of a frame."""
        return slice(self.start, self.start + self.size)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """All unknowns of one frame, in order."""

    blocks: tuple[Block, ...]

    @property
    def size(self) -> int:
        """Number of unknowns of one frame."""
        return sum(block.size for block in self.blocks)

    def extended(self, owner: str, spec: VariableSpec, n_frames: int) -> Layout:
        """Add unknowns at the end."""
        _check_spec(owner, spec, n_frames)
        sizes = {b.spec.name: b.size for b in self.blocks if b.owner == PROBLEM}
        if spec.follows and sizes.get(spec.follows) != len(spec.labels):
            raise ProblemError(
                f"the {len(spec.labels)} unknowns {spec.name!r} of {owner} follow {spec.follows!r}, expected "
                f"one of {sizes} with as many unknowns"
            )
        return Layout(blocks=(*self.blocks, Block(owner=owner, spec=spec, start=self.size)))

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each unknown."""
        return tuple(label for block in self.blocks for label in block.spec.labels)

    @property
    def scale(self) -> FloatArray:
        """Scale of each unknown, shape (size,)."""
        return np.concatenate(
            [np.broadcast_to(b.spec.scale, (b.size,)) for b in self.blocks] or [np.zeros(0)]
        )

    def rows(self, what: str, n_frames: int, frames: slice = ALL) -> FloatArray:
        """Collect ``"lower"``, ``"upper"`` or ``"guess"`` of the given frames, shape (n, size)."""
        parts = [np.broadcast_to(getattr(b.spec, what), (n_frames, b.size))[frames] for b in self.blocks]
        return np.concatenate([np.zeros((len(range(n_frames)[frames]), 0)), *parts], axis=1)

    def split(self, unknowns: FloatArray) -> dict[tuple[str, str], FloatArray]:
        """Cut unknowns (n_frames, size) into arrays by owner and name."""
        return {(b.owner, b.spec.name): np.ascontiguousarray(unknowns[:, b.columns]) for b in self.blocks}

    def followed(self, unknowns: FloatArray) -> FloatArray:
        """Give unknowns (n_frames, size) that follow others the values of these, within their bounds."""
        unknowns, scale = unknowns.copy(), self.scale
        for b in self.blocks:
            for other in self.blocks:
                if other.owner == PROBLEM and other.spec.name == b.spec.follows:
                    values = unknowns[:, other.columns] * scale[other.columns]
                    unknowns[:, b.columns] = np.clip(values, b.spec.lower, b.spec.upper) / scale[b.columns]
        return unknowns

    def join(self, parts: Mapping[tuple[str, str], FloatArray], default: FloatArray) -> FloatArray:
        """Put arrays by owner and name back into unknowns; what is absent comes from `default`."""
        unknowns = np.array(default, dtype=float)
        for b in self.blocks:
            part = parts.get((b.owner, b.spec.name))
            if part is not None and part.shape == (len(unknowns), b.size):
                unknowns[:, b.columns] = part
        return unknowns


#: Owner of the unknowns and data that every problem has.
PROBLEM = "problem"


def make_layout(problem: MuscleForceProblem) -> Layout:
    """Order the unknowns: activations, controls, then those of the muscle model and of each term."""
    motion = problem.motion
    muscles, actuators = motion.muscles, motion.actuators
    guess = np.clip(0.1, muscles.min_activation, muscles.max_activation)
    wanted = [
        (
            PROBLEM,
            VariableSpec(
                name="activation",
                labels=muscles.muscles,
                lower=muscles.min_activation,
                upper=muscles.max_activation,
                guess=guess,
            ),
        ),
        (
            PROBLEM,
            VariableSpec(
                name="control",
                labels=actuators.actuators,
                lower=actuators.min_control,
                upper=actuators.max_control,
                guess=np.clip(0.0, actuators.min_control, actuators.max_control),
            ),
        ),
    ]
    for term in problem.terms:
        with named_faults(term.name):
            specs = term.variables(motion)
        if specs and term.name in {t.name for t in problem.observed}:
            raise ProblemError(f"{term.name} has unknowns of its own and cannot be observed")
        wanted += [(term.name, spec) for spec in specs]
    layout = Layout(blocks=())
    for owner, spec in wanted:
        layout = layout.extended(owner, spec, motion.n_frames)
    return layout


def _check_spec(owner: str, spec: VariableSpec, n_frames: int) -> None:
    """Refuse bounds, guesses and scales that fit no frame or no number."""
    n, where = len(spec.labels), f"of the unknowns {spec.name!r} of {owner}"
    for what in ("lower", "upper", "guess", "scale"):
        shape = np.shape(getattr(spec, what))
        if shape not in ((), (n,), *(((n_frames, n),) if what != "scale" else ())):
            raise ProblemError(
                f"{what} {where} has shape {shape}, expected () or ({n},) or ({n_frames}, {n})"
            )
    for what, bad in (
        ("lower", ~(np.asarray(spec.lower) <= np.asarray(spec.upper))),
        ("guess", ~np.isfinite(spec.guess)),
        ("scale", ~(np.asarray(spec.scale) > 0) | np.isinf(spec.scale)),
    ):
        if np.any(bad):
            rule = {"lower": "not above upper", "guess": "finite", "scale": "positive and finite"}[what]
            raise ProblemError(f"{what} {where} is {getattr(spec, what)}, expected numbers that are {rule}")


class Constants:
    """Constants that terms ask for: numbers, but symbols where they have one of the given names."""

    def __init__(self, differentiated: Set[str] = frozenset()) -> None:
        self.differentiated = differentiated
        self.symbols: dict[tuple[str, str], ca.SX] = {}
        self.values: dict[tuple[str, str], FloatArray] = {}

    def of(self, owner: str) -> Callable[[str, Any], Any]:
        """Make what a term asks for its constants, see :class:`Frame`."""

        def constant(name: str, values: Any) -> Any:
            if name not in self.differentiated:
                return as_number(name, values)
            key = (owner, name)
            if key not in self.symbols:
                self.values[key] = np.ravel(np.asarray(values, dtype=float))
                self.symbols[key] = ca.SX.sym(name, self.values[key].size)
            return self.symbols[key]

        return constant

    def arrays(self, n_frames: int) -> dict[tuple[str, str], FloatArray]:
        """Numbers for the symbols, frames first."""
        return {key: np.broadcast_to(values, (n_frames, values.size)) for key, values in self.values.items()}


@dataclass(frozen=True, kw_only=True)
class Given:
    """Numbers of every frame, and the symbols that stand for them.

    Attributes
    ----------
    key : (owner, name)
        Of the array.
    symbol : ca.SX, shape (n_entries, 1)
    entries : ndarray of int, shape (n_entries,), or None
        Which of a frame's numbers these are, in the array's order; None: all.
    offset : int
        How many frames after that of an expression: 1 for the later one of a pair.
    """

    key: tuple[str, str]
    symbol: ca.SX
    entries: IntArray | None = None
    offset: int = 0

    def numbers(self, arrays: Mapping[tuple[str, str], FloatArray], frames: IntArray | slice) -> FloatArray:
        """Take the numbers of some frames, shape (n, n_entries)."""
        array = arrays[self.key][frames]
        by_frame = array.reshape(len(array), math.prod(array.shape[1:]))
        return by_frame if self.entries is None else by_frame[:, self.entries]


@dataclass(frozen=True, kw_only=True)
class FrameSymbols:
    """Symbols of one frame and the numbers that go into them.

    Attributes
    ----------
    layout : Layout
    unknowns : ca.SX, shape (size, 1)
        The solver's unknowns: each is the physical one divided by its scale.
    given : tuple of Given
    seen : mapping of (owner, name) to ca.SX
        What terms see of them: zero where a matrix is zero in all frames. A muscle crosses few coordinates.
    constants : Constants
        The same for all frames.
    """

    layout: Layout
    unknowns: ca.SX
    given: tuple[Given, ...]
    seen: Mapping[tuple[str, str], ca.SX]
    constants: Constants = field(default_factory=Constants)

    def frame(self, problem: MuscleForceProblem) -> Frame:
        """Make the frame that the muscle model has completed."""
        bare = self._bare()
        state = problem.muscle_model.state(self._for(problem.muscle_model.name, bare), problem.motion)
        return replace(bare, muscle=state)

    def for_term(self, name: str, frame: Frame) -> Frame:
        """Give a frame the unknowns and data of one term."""
        return self._for(name, frame)

    def _physical(self, block: Block) -> ca.SX:
        if not block.size:
            return ca.SX(0, 1)
        scale = ca.DM(np.broadcast_to(block.spec.scale, (block.size,)).astype(float))
        physical = self.unknowns[block.columns] * scale
        lower, upper = (np.asarray(b, dtype=float) for b in (block.spec.lower, block.spec.upper))
        if lower.ndim < 2 and upper.ndim < 2:
            # A fixed unknown is a number: a power below 2 has no second derivative at a fixed zero.
            for i in np.flatnonzero(np.broadcast_to(lower == upper, (block.size,))):
                physical[int(i)] = float(np.broadcast_to(lower, (block.size,))[i])
        return physical

    def _bare(self) -> Frame:
        by_name = {b.spec.name: self._physical(b) for b in self.layout.blocks if b.owner == PROBLEM}
        given = {name: symbol for (owner, name), symbol in self.seen.items() if owner == PROBLEM}
        nothing = MuscleState(tendon_force=ca.SX(0, 1), passive_force=ca.SX(0, 1))
        return Frame(**by_name, **given, muscle=nothing)

    def _for(self, owner: str, frame: Frame) -> Frame:
        variables = {b.spec.name: self._physical(b) for b in self.layout.blocks if b.owner == owner}
        data = {name: symbol for (own, name), symbol in self.seen.items() if own == owner}
        return replace(frame, variables=variables, data=data, constant=self.constants.of(owner))


def make_symbols(
    layout: Layout, arrays: Mapping[tuple[str, str], FloatArray], constants: Constants, offset: int = 0
) -> FrameSymbols:
    """Create the symbols of one frame, or of the one after it, for the given data arrays (frames first)."""
    suffix = "_next" * offset
    given, seen = [], {}
    for key, array in arrays.items():
        n_rows, n_columns = _shape(array)
        matrix, entries = ca.SX.zeros(n_rows, n_columns), None
        if array.ndim == 3 and "moment_arms" not in constants.differentiated:
            entries = np.flatnonzero((array != 0).any(axis=0))
        row, column = np.divmod(np.arange(n_rows * n_columns) if entries is None else entries, n_columns)
        symbol = ca.SX.sym(f"{key[1]}{suffix}", row.size)
        matrix[(column * n_rows + row).tolist()] = symbol
        given.append(Given(key=key, symbol=symbol, entries=entries, offset=offset))
        seen[key] = matrix
    unknowns = ca.SX.sym(f"x{suffix}", layout.size)
    return FrameSymbols(layout=layout, unknowns=unknowns, given=tuple(given), seen=seen, constants=constants)


@contextlib.contextmanager
def named_faults(who: str) -> Iterator[None]:
    """Say whose code it was that failed; errors of this package say what is wrong themselves.

    Raises
    ------
    ProblemError
        What the term's own code raised, with its cause.
    """
    try:
        yield
    except ScsoError:
        raise
    except Exception as error:
        said = textwrap.shorten(_PLACE_IN_CASADI.sub("", str(error)), 160)
        hint = f"; {ABOUT_SYMBOLS}" if "asadi" in str(error) else ""
        raise ProblemError(f"{who} raised {type(error).__name__}: {said or 'no words'}{hint}") from error


def collect_data(problem: MuscleForceProblem) -> dict[tuple[str, str], FloatArray]:
    """All given arrays of a problem by owner and name, frames first."""
    motion = problem.motion
    trajectory = motion.trajectory
    arrays: dict[tuple[str, str], FloatArray] = {
        (PROBLEM, name): getattr(trajectory, name)
        for name in (
            "moment_arms",
            "actuator_generalized_forces",
            "generalized_forces",
            "muscle_tendon_length",
            "muscle_tendon_velocity",
        )
    }
    for term in problem.terms:
        with named_faults(term.name):
            given = {name: np.asarray(values, dtype=float) for name, values in term.data(motion).items()}
        for name, array in given.items():
            if array.ndim == 0 or array.shape[0] != trajectory.n_frames:
                raise DataError(
                    f"data {name!r} of {term.name} has shape {array.shape}, expected "
                    f"{trajectory.n_frames} frames first"
                )
            if not np.isfinite(array).all():
                frame = int(np.argwhere(~np.isfinite(array))[0][0])
                raise DataError(
                    f"data {name!r} of {term.name} is not finite at frame {frame} "
                    f"(t = {trajectory.time[frame]:g} s)"
                )
            arrays[(term.name, name)] = array
    return arrays


def _shape(array: FloatArray) -> tuple[int, int]:
    inner = array.shape[1:]
    if len(inner) > 2:
        raise DataError(f"per-frame data of shape {inner} has more than two axes")
    return (*inner, 1, 1)[:2] if inner else (1, 1)
