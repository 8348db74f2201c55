"""Least squares over gains and levels with exact derivatives, and what comes out for data left out."""

from __future__ import annotations

import fnmatch
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import least_squares

from scso_nlp.arguments import checked
from scso_nlp.calibration.measured import MeasuredStiffness, MeasuredTrial
from scso_nlp.constraints.stability_constraint import STABILITY_SCALE, StabilityConstraint
from scso_nlp.exceptions import ProblemError
from scso_nlp.messages import STAGES
from scso_nlp.muscle_models.stiffness_law import PUBLISHED_GAINS, ProportionalStiffness
from scso_nlp.problem import MuscleForceProblem
from scso_nlp.sensitivities import Parameter, Sensitivity, sensitivity
from scso_nlp.solution import Solution
from scso_nlp.solver import SolverOptions, solve_trajectory
from scso_nlp.validation import BoolArray, FloatArray, matches, positions

if TYPE_CHECKING:
    import pandas as pd

#: The search begins at the best of so many gains, evenly spread over log q, and the problems' own.
_STARTS = 5
#: Steps of log q, or of levels over their scale, below which the search ends [-].
_STEP = 1e-4
#: So does a change of the error by less than this share [-].
_GAIN = 1e-6
#: Residuals that change by less per unit of log q or scaled level do not depend on the parameter [-].
_FLAT = 1e-9


@dataclass(frozen=True, kw_only=True)
@checked
class Calibration:
    """Gains and levels found, and how well they do on units that they were not found on.

    Attributes
    ----------
    parameters : tuple of Parameter
    value : ndarray, shape (n_parameters,) [- or N·m/rad]
        Found on all units: what to use.
    units : tuple of str
    value_without : ndarray, shape (n_units, n_parameters) [- or N·m/rad]
        Found without each unit; `value` where all data were for both.
    error : ndarray, shape (n_units,)
        Of each unit, with `value_without`.
    error_at_start : ndarray, shape (n_units,)
        With each parameter at the mean of the problems' own numbers, within its bounds; infinite where some
        frame has no answer there.
    error_of_plain : ndarray, shape (n_units,)
        Without stability rows; NaN where some frame has no answer, and for stiffness, which is of the rows.
    meaning : str
        What an error is.
    is_same_data : bool
        True if errors are of the data that the numbers were found on.
    is_flat : ndarray of bool, shape (n_parameters,)
        True where the error does not depend on the parameter at `value`: the data do not tell it.
    is_at_bound : ndarray of bool, shape (n_parameters,)
    n_frames, n_without_derivatives : int
        How many frames, and in how many the optimum at `value` has no derivative: there the search took it
        as not changing.

    Examples
    --------
    See :func:`scso_nlp.calibrate`.
    """

    parameters: tuple[Parameter, ...]
    value: FloatArray
    units: tuple[str, ...]
    value_without: FloatArray
    error: FloatArray
    error_at_start: FloatArray
    error_of_plain: FloatArray
    meaning: str
    is_same_data: bool
    is_flat: BoolArray
    is_at_bound: BoolArray
    n_frames: int
    n_without_derivatives: int

    @property
    def names(self) -> tuple[str, ...]:
        """What the parameters are called."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def standard_error(self) -> FloatArray:
        """Jackknife over units, shape (n_parameters,) [- or N·m/rad]; NaN where none was left out."""
        n = len(self.units)
        if self.is_same_data:
            return np.full(len(self.value), np.nan)
        return np.asarray(np.sqrt((n - 1) * self.value_without.var(axis=0)))

    def applied(self, problem: MuscleForceProblem) -> MuscleForceProblem:
        """Give a problem the numbers that were found."""
        return with_values(problem, self.parameters, self.value)

    def to_dataframe(self) -> pd.DataFrame:
        """Make a data frame of pandas, one row per unit: its errors, and what was found without it."""
        from scso_nlp.solution.tables import pandas

        columns = {"error": self.error, "at_start": self.error_at_start, "of_plain": self.error_of_plain}
        columns |= dict(zip(self.names, self.value_without.T, strict=True))
        return pandas().DataFrame(columns, index=pandas().Index(self.units, name="unit"))

    def __repr__(self) -> str:
        how = "found and tested on the same" if self.is_same_data else "each left out once,"
        lines = [f"Calibration of {', '.join(self.names)}"]
        told = zip(self.names, self.value, self.standard_error, self.is_flat, self.is_at_bound, strict=True)
        for name, value, spread, flat, bound in told:
            text = f"{name} = {value:.4g}" + ("" if math.isnan(spread) else f" ± {spread:.2g}")
            text += ", at its bound" if bound else ""
            lines.append(text + (", which the data do not tell: the error does not change" if flat else ""))
        mean = [np.mean(e) for e in (self.error, self.error_at_start, self.error_of_plain)]
        errors = f"{mean[0]:.4g}, {mean[1]:.4g} at the start"
        errors += "" if math.isnan(mean[2]) else f", {mean[2]:.4g} without stability rows"
        n = len(self.units)
        lines.append(f"{self.meaning}, {how} {n} unit{'s' if n > 1 else ''}: {errors}")
        if self.n_without_derivatives:
            lines.append(f"{self.n_without_derivatives} of {self.n_frames} frames have no derivative")
        return "\n  ".join(lines)


@checked
def calibrate(
    trials: Mapping[str, MeasuredTrial],
    parameters: Sequence[str | Parameter] = ("q",),
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    same_data: bool = False,
    options: SolverOptions | None = None,
) -> Calibration:
    r"""Find gains and levels at which optima are nearest to measurements, and test them on what is left out.

    .. math:: \min_\theta \sum_{trials} \sum_i \rho_i(x^*(\theta))^2

    with the residuals :math:`\rho` of each trial's measurement at its optimum :math:`x^*`, over
    :math:`\theta = \log q` and levels, by a trust region with the exact derivatives of :func:`sensitivity`.
    Every unit is left out once: numbers are found on the others, and its error is taken with these.

    Parameters
    ----------
    trials : mapping of str to MeasuredTrial
        By name.
    parameters : sequence of str or Parameter
        ``"q"``, ``"q[soleus_*,gas_*]"``, ``"level[ankle_angle_r]"``: all that fit get one number.
    bounds : mapping of str to (float, float), optional
        By parameter. By default gains stay within those published, 0.5 to 42, and levels are free.
    same_data : bool
        Find and test on the same data, without leaving anything out.
    options : SolverOptions, optional

    Returns
    -------
    Calibration

    Raises
    ------
    ProblemError
        No trial; one unit and not `same_data`; EMG and stiffness together; a parameter other than gains and
        levels, that the problem does not have, or that shares muscles with another; bounds that are none;
        frames without an answer at some value.
    NameMismatchError
        Names that fit nothing.
    DataError
        EMG that does not cover a motion, or has no shape.

    Notes
    -----
    The search begins at the best of five gains between the bounds and the problems' own numbers, each fold
    by its own units, and ends in a minimum near that. It takes frames without derivatives, see
    :class:`Regularity`, as not changing, and counts them. Rows that must be kept have no answer at gains that
    are too small: give them a price (``soft``).

    References
    ----------
    Branch, Coleman and Li (1999), SIAM J Sci Comput 21:1-23, as in SciPy's ``least_squares``; the jackknife:
    Efron (1982), The Jackknife, the Bootstrap and Other Resampling Plans, SIAM.

    Examples
    --------
    >>> stiff = scso.MeasuredStiffness(stiffness=300.0, arms={"elbow_z": 1.0})
    >>> one = scso.MeasuredTrial(problem=problem.frames(1, 2), measured=stiff)
    >>> found = scso.calibrate({"hold": one}, same_data=True)
    >>> float(stiff.of(scso.solve_trajectory(found.applied(one.problem)))[0].round(3))
    300.0
    """
    wanted = [parameters] if isinstance(parameters, str) else parameters
    chosen = tuple(Parameter.of_text(p) if isinstance(p, str) else p for p in wanted)
    _refuse(trials, chosen)
    whole = [_Trial(name, trial, chosen, options) for name, trial in trials.items()]
    search = _Search(chosen, _limits(chosen, bounds or {}))
    start = search.clipped(np.mean([each.start for each in whole], axis=0))
    units = tuple(dict.fromkeys(unit for each in whole for unit in each.frames))
    if len(units) < 2 and not same_data:
        raise ProblemError(
            f"there is one unit, {units[0]!r}, expected two at least to leave one out; same_data finds and "
            "tests on the same data"
        )
    starts = search.starts(start)
    tried = np.array(
        [_by_unit([each.errors_if_solved(values) for each in whole], units) for values in starts]
    )

    def best_start(used: BoolArray) -> FloatArray:
        return starts[int(np.argmin(tried[:, used].sum(axis=1)))]

    value = search.found(whole, best_start(np.ones(len(units), dtype=bool)))
    slope = np.concatenate([each.slopes(value) for each in whole])
    regular = np.concatenate([each.is_regular(value) for each in whole])
    without, error = np.tile(value, (len(units), 1)), _by_unit([each.errors(value) for each in whole], units)
    for i, unit in enumerate(units if not same_data else ()):
        STAGES.info("calibrating without %s, %d of %d", unit, i + 1, len(units))
        others = [part for each in whole if (part := each.only([u for u in units if u != unit]))]
        without[i] = search.found(others, best_start(np.arange(len(units)) != i))
        own = [part for each in whole if (part := each.only([unit]))]
        error[i] = _by_unit([each.errors(without[i]) for each in own], [unit])[0]
    return Calibration(
        parameters=chosen,
        value=value,
        units=units,
        value_without=without,
        error=error,
        error_at_start=tried[0],
        error_of_plain=_by_unit([each.errors_of_plain() for each in whole], units),
        meaning=whole[0].measured.meaning,
        is_same_data=same_data,
        is_flat=(np.linalg.norm(slope * search.scale(value), axis=0) <= _FLAT) & regular.any(),
        is_at_bound=search.is_at_bound(value),
        n_frames=regular.size,
        n_without_derivatives=int((~regular).sum()),
    )


def _by_unit(errors: Sequence[Mapping[str, float]], units: Sequence[str]) -> FloatArray:
    """Mean error over the trials of each unit, shape (n_units,)."""
    return np.array([np.mean([found[unit] for found in errors if unit in found]) for unit in units])


def with_values(
    problem: MuscleForceProblem, parameters: Sequence[Parameter], values: Sequence[float] | FloatArray
) -> MuscleForceProblem:
    """Give the stability constraints of a problem other gains and levels, kept or observed.

    Parameters
    ----------
    problem : MuscleForceProblem
    parameters : sequence of Parameter
    values : sequence of float [- or N·m/rad]

    Returns
    -------
    MuscleForceProblem
    """

    def changed(term: Any) -> Any:
        for parameter, value in zip(parameters, values, strict=True):
            if isinstance(term, StabilityConstraint) and parameter.term in ("", term.name):
                change = _with_gain if parameter.quantity == "q" else _with_level
                term = change(term, parameter.of, float(value), problem)
        return term

    return replace(
        problem,
        constraints=tuple(map(changed, problem.constraints)),
        observed=tuple(map(changed, problem.observed)),
    )


def _with_gain(
    term: StabilityConstraint, of: Sequence[str], value: float, problem: MuscleForceProblem
) -> StabilityConstraint:
    law: Any = term.stiffness_law
    if not hasattr(law, "q"):
        return term
    if isinstance(law.q, int | float | Mapping):
        gains = _overlaid(law.q, of, value)
    else:
        gains = _overlaid(dict(zip(problem.motion.muscles.muscles, law.q, strict=True)), of, value)
    if term.stiffness is None:
        return replace(term, q=gains)
    return replace(term, stiffness=replace(law, q=gains))


def _with_level(
    term: StabilityConstraint, of: Sequence[str], value: float, problem: MuscleForceProblem
) -> StabilityConstraint:
    rows = term.row_names(problem.motion)
    mine = [name for name in of if _chosen([name], rows)]
    return replace(term, level=_overlaid(term.level, mine, value)) if mine else term


def _overlaid(
    given: float | Mapping[str, float], of: Sequence[str], value: float
) -> float | dict[str, float]:
    """Lay one value for some names over what was given; later entries win."""
    if "*" in of:
        return value
    table = dict(given) if isinstance(given, Mapping) else {"*": float(given)}
    return {name: number for name, number in table.items() if name not in of} | dict.fromkeys(of, value)


def _chosen(of: Sequence[str], names: Sequence[str]) -> list[int]:
    """Positions of names that some name or pattern fits, maybe none."""
    fits = [name in of or any(fnmatch.fnmatchcase(name, pattern) for pattern in of) for name in names]
    return [i for i, is_meant in enumerate(fits) if is_meant]


def _own_values(trial: str, problem: MuscleForceProblem, parameters: Sequence[Parameter]) -> FloatArray:
    """Mean of the problem's own numbers that each parameter stands for, shape (n_parameters,)."""
    values = []
    taken: set[tuple[str, str, str]] = set()
    for parameter in parameters:
        own: list[float] = []
        known: list[str] = []
        for term in problem.constraints:
            if not isinstance(term, StabilityConstraint) or parameter.term not in ("", term.name):
                continue
            names, numbers = _numbers(term, parameter.quantity, problem)
            known += names
            for i in _chosen(parameter.of, names):
                own.append(numbers[i])
                if (parameter.quantity, term.name, names[i]) in taken:
                    raise ProblemError(f"{names[i]} stands in two parameters, one is {parameter.name}")
                taken.add((parameter.quantity, term.name, names[i]))
        if not known:
            raise ProblemError(f"trial {trial!r} keeps no stability constraint that has {parameter.name}")
        for pattern in parameter.of:
            matches(f"name for {parameter.quantity} in trial {trial!r}", pattern, known)
        values.append(np.mean(own))
    return np.array(values)


def _numbers(
    term: StabilityConstraint, quantity: str, problem: MuscleForceProblem
) -> tuple[tuple[str, ...], FloatArray]:
    """Names that a constraint has gains or levels for, and these."""
    if quantity == "level":
        rows = term.row_names(problem.motion)
        return rows, term.by_row(term.level, rows)
    muscles, gain = problem.motion.muscles.muscles, getattr(term.stiffness_law, "q", None)
    return ((), np.zeros(0)) if gain is None else (muscles, ProportionalStiffness(q=gain).gains(muscles))


def _refuse(trials: Mapping[str, MeasuredTrial], parameters: Sequence[Parameter]) -> None:
    """Raise where trials or parameters cannot be calibrated."""
    if not trials or not parameters:
        raise ProblemError(f"there is no {'parameter' if trials else 'trial'}, expected one at least")
    for parameter in parameters:
        if parameter.quantity not in ("q", "level") or parameter.frame is not None or parameter.relative:
            raise ProblemError(
                f"{parameter.name} cannot be calibrated, expected a gain q or a level of all frames"
            )
    if len(kinds := {trial.measured.meaning for trial in trials.values()}) > 1:
        raise ProblemError(f"trials have measured different things, expected one: {'; '.join(sorted(kinds))}")


def _limits(parameters: Sequence[Parameter], bounds: Mapping[str, tuple[float, float]]) -> FloatArray:
    """Least and largest value of each parameter, shape (2, n_parameters)."""
    positions("parameter of bounds", bounds, tuple(parameter.name for parameter in parameters))
    limits = []
    for parameter in parameters:
        is_gain = parameter.quantity == "q"
        low, high = bounds.get(parameter.name, PUBLISHED_GAINS if is_gain else (-math.inf, math.inf))
        if not low < high or (is_gain and not 0 < low < high < math.inf):
            raise ProblemError(
                f"bounds of {parameter.name} are {low:g} and {high:g}, expected "
                f"{'positive, finite numbers' if is_gain else 'numbers'}, the smaller first"
            )
        limits.append((low, high))
    return np.array(limits).T


class _Search:
    """Least squares over log q and over levels as shares of their scale."""

    def __init__(self, parameters: Sequence[Parameter], limits: FloatArray) -> None:
        self.is_gain = np.array([parameter.quantity == "q" for parameter in parameters])
        self.limits = limits

    def inner(self, values: FloatArray) -> FloatArray:
        """Values as the search sees them."""
        log = np.log(np.where(self.is_gain, values, 1.0))
        return np.where(self.is_gain, log, values / STABILITY_SCALE)

    def outer(self, theta: FloatArray) -> FloatArray:
        """Values from what the search sees."""
        return np.where(self.is_gain, np.exp(np.where(self.is_gain, theta, 0.0)), theta * STABILITY_SCALE)

    def scale(self, values: FloatArray) -> FloatArray:
        """Change of the values per unit of what the search sees."""
        return np.where(self.is_gain, values, STABILITY_SCALE)

    def clipped(self, values: FloatArray) -> FloatArray:
        """Values within their bounds."""
        return np.asarray(np.clip(values, *self.limits))

    def starts(self, own: FloatArray) -> list[FloatArray]:
        """Values to begin with: the problems' own, and gains spread evenly between their bounds."""
        low, high = (self.inner(limit) for limit in self.limits)
        n = _STARTS if self.is_gain.any() else 0
        with np.errstate(invalid="ignore"):
            spread = [self.outer(low + (k + 0.5) / n * (high - low)) for k in range(n)]
        return [own, *(np.where(self.is_gain, values, own) for values in spread)]

    def is_at_bound(self, values: FloatArray) -> BoolArray:
        """Tell which values are at a bound to the accuracy of the search."""
        low, high = self.inner(self.limits[0]), self.inner(self.limits[1])
        found = self.inner(values)
        return np.asarray((found - low < 10 * _STEP) | (high - found < 10 * _STEP))

    def found(self, trials: Sequence[_Trial], start: FloatArray) -> FloatArray:
        """Values of least error on some trials."""

        def residuals(theta: FloatArray) -> FloatArray:
            return np.concatenate([trial.residuals(self.outer(theta)) for trial in trials])

        def slopes(theta: FloatArray) -> FloatArray:
            values = self.outer(theta)
            return np.concatenate([trial.slopes(values) for trial in trials]) * self.scale(values)

        bounds = (self.inner(self.limits[0]), self.inner(self.limits[1]))
        answer = least_squares(
            residuals, self.inner(start), slopes, bounds=bounds, xtol=_STEP, ftol=_GAIN, gtol=1e-12
        )
        return self.outer(answer.x)


class _Trial:
    """A trial, or the frames of some of its units, at any values of the parameters."""

    def __init__(
        self,
        name: str,
        trial: MeasuredTrial,
        parameters: Sequence[Parameter],
        options: SolverOptions | None,
    ) -> None:
        self.name, self.trial, self.measured = name, trial, trial.measured
        self.parameters, self.options = parameters, options
        self.labels = np.array(
            [trial.unit or name] * trial.problem.motion.n_frames
            if isinstance(trial.unit, str)
            else trial.unit
        )
        units = dict.fromkeys(self.labels.tolist())
        self.frames = {unit: np.flatnonzero(self.labels == unit) for unit in units}
        self._last: tuple[bytes, Solution] | None = None
        self._change: tuple[bytes, Sensitivity] | None = None

    def only(self, units: Sequence[str]) -> _Trial | None:
        """Keep the frames of some units; None if there are none."""
        kept = np.isin(self.labels, units)
        if kept.all() or not kept.any():
            return self if kept.any() else None
        frames = np.flatnonzero(kept)
        part = replace(
            self.trial, problem=self.trial.problem.frames(frames), unit=self.labels[frames].tolist()
        )
        return _Trial(self.name, part, self.parameters, self.options)

    @property
    def start(self) -> FloatArray:
        """The problem's own numbers, shape (n_parameters,)."""
        return _own_values(self.name, self.trial.problem, self.parameters)

    @functools.cached_property
    def plain(self) -> Solution:
        """Without stability rows."""
        problem = self.trial.problem.without_stability()
        return solve_trajectory(problem, options=self.options, on_failure="return")

    def errors_of_plain(self) -> dict[str, float]:
        """Error of every unit without stability rows; NaN where it is not known."""
        if isinstance(self.measured, MeasuredStiffness):
            return dict.fromkeys(self.frames, math.nan)
        return self._errors(self.plain, math.nan)

    def errors(self, values: FloatArray) -> dict[str, float]:
        """Error of every unit."""
        return self._errors(self._solved(values), math.nan)

    def errors_if_solved(self, values: FloatArray) -> dict[str, float]:
        """Error of every unit, infinite where some frame of it has no answer."""
        return self._errors(self._solution(values), math.inf)

    def _errors(self, solution: Solution, otherwise: float) -> dict[str, float]:
        return {
            unit: float((self.measured.residuals(solution, frames) ** 2).sum())
            if solution.is_solved[frames].all()
            else otherwise
            for unit, frames in self.frames.items()
        }

    def residuals(self, values: FloatArray) -> FloatArray:
        """Residuals of all units, shape (n,)."""
        solution = self._solved(values)
        return np.concatenate(
            [self.measured.residuals(solution, frames).ravel() for frames in self.frames.values()]
        )

    def slopes(self, values: FloatArray) -> FloatArray:
        """Give the derivatives of the residuals by the values, shape (n, n_parameters)."""
        change = self._sensitivity(values)
        n = len(self.parameters)
        return np.concatenate(
            [self.measured.slopes(change, frames).reshape(-1, n) for frames in self.frames.values()]
        )

    def is_regular(self, values: FloatArray) -> BoolArray:
        """Tell which frames have derivatives, shape (n_frames,)."""
        return self._sensitivity(values).is_regular

    def _sensitivity(self, values: FloatArray) -> Sensitivity:
        if self._change is None or self._change[0] != values.tobytes():
            self._change = values.tobytes(), sensitivity(self._solved(values), self.parameters)
        return self._change[1]

    def _solved(self, values: FloatArray) -> Solution:
        solution = self._solution(values)
        if not solution.is_solved.all():
            at = ", ".join(f"{p.name} = {v:.4g}" for p, v in zip(self.parameters, values, strict=True))
            raise ProblemError(
                f"trial {self.name!r}: {(~solution.is_solved).sum()} of {solution.is_solved.size} frames "
                f"have no answer at {at}; give the rows a price (soft), or narrower bounds"
            )
        return solution

    def _solution(self, values: FloatArray) -> Solution:
        if self._last is None or self._last[0] != values.tobytes():
            solution = solve_trajectory(
                with_values(self.trial.problem, self.parameters, values),
                baseline=self.plain,
                options=self.options,
                on_failure="return",
            )
            self._last = values.tobytes(), solution
        return self._last[1]
