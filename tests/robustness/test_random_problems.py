"""Random problems of every kind that has gone wrong: what is called solved is held against other bounds.

Seeded and few by default; ``SCSO_ROBUSTNESS=5400 pytest tests/robustness -s`` tries more and prints tables.
"""

from __future__ import annotations

import collections
import dataclasses
import os

import numpy as np
import pytest
from helpers import frame_arrays, random_problem, unknowns
from scipy.optimize import linprog

import scso_nlp as scso
from scso_nlp.exceptions import ScsoError
from scso_nlp.solution import Status

#: How many problems are tried, over all kinds.
NUMBER = int(os.environ.get("SCSO_ROBUSTNESS", "270"))
EXPONENTS = (1.0, 1.05, 1.5, 2.0, 3.0, 7.0, 20.0, 200.0, np.inf)
RESERVES = (None, 1.0, 50.0)
#: What is called solved costs at most this much more than the optimum, and misses its rows by this share [-].
PRECISION = 1e-6
#: HiGHS keeps rows and optimum to 1e-10 of numbers near one; what that is in the cost depends on prices.
PRECISION_OF_HIGHS = 1e-7


def drawn(rng, exponent, reserve, **changes):
    """A random problem without stability rows."""
    return random_problem(rng, exponent=exponent, reserve=reserve, stability=False, **changes)


def dependent(rows):
    """The last row of moments is a sum of the others, by factors of one's own."""

    def make(rng, exponent, reserve):
        return _with(drawn(rng, exponent, reserve), lambda array: np.concatenate(
            [array[:, :-1], np.einsum("i,ki...->k...", rows, array[:, :-1])[:, None]], axis=1
        ))  # fmt: skip

    return make


def noisy(share):
    """A row that follows from another up to rounding: of arms and of moments, each by itself."""

    def make(rng, exponent, reserve):
        problem = dependent([2.5, 0.0])(rng, exponent, reserve)

        def change(array):
            array = array.copy()
            array[:, -1] *= 1 + share * rng.uniform(-1, 1, array[:, -1].shape)
            return array

        return _with(problem, change)

    return make


def many_equations(rng, exponent, reserve):
    """Six equations for four muscles, that activations between 0.2 and 0.6 keep."""
    return drawn(rng, exponent, reserve, n_coordinates=6, n_muscles=4)


def moments(factor):
    """All moments times a number; zero is asked for too."""
    return lambda rng, exponent, reserve: with_moments(drawn(rng, exponent, reserve), factor)


def with_moments(problem, factor):
    trajectory = problem.motion.trajectory
    factor = np.asarray(factor, dtype=float).reshape(-1, 1)
    scaled = dataclasses.replace(trajectory, generalized_forces=trajectory.generalized_forces * factor)
    return dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=scaled))


def forces(factor):
    """All forces and moments times a number: another unit."""

    def make(rng, exponent, reserve):
        problem = drawn(rng, exponent, reserve)
        motion = problem.motion
        actuators = motion.actuators
        trajectory = dataclasses.replace(
            motion.trajectory,
            generalized_forces=motion.trajectory.generalized_forces * factor,
            actuator_generalized_forces=motion.trajectory.actuator_generalized_forces * factor,
        )
        muscles = dataclasses.replace(
            motion.muscles, max_isometric_force=motion.muscles.max_isometric_force * factor
        )
        actuators = dataclasses.replace(actuators, optimal_force=actuators.optimal_force * factor)
        changed = scso.Motion(trajectory=trajectory, muscles=muscles, actuators=actuators)
        return dataclasses.replace(problem, motion=changed)

    return make


def weighed(factor):
    """The objective times a number."""

    def make(rng, exponent, reserve):
        problem = drawn(rng, exponent, reserve)
        effort = dataclasses.replace(problem.objectives[0], weight=factor)
        return dataclasses.replace(problem, objectives=(effort,))

    return make


def levels(prices):
    """Stability rows that bind, hard or at a price between those given."""

    def make(rng, exponent, reserve):
        problem = random_problem(rng, exponent=exponent, reserve=reserve)
        if prices is None:
            return problem
        price = float(np.exp(rng.uniform(*np.log(prices))))
        balance, stability = problem.constraints
        return dataclasses.replace(problem, constraints=(balance, dataclasses.replace(stability, soft=price)))

    return make


def at_the_limit(share):
    """Moments in each frame as large as muscles can, times 1 + share; reserves would reach anything."""

    def make(rng, exponent, reserve):
        problem = drawn(rng, exponent, None)
        factor = []
        for k in range(problem.motion.n_frames):
            _, a, b, *_, lower, upper = frame_arrays(problem, k)
            size = np.abs(a).max()
            most = linprog(
                np.append(np.zeros(a.shape[1]), -1.0),
                A_eq=np.hstack([a, -b[:, None]]) / size,
                b_eq=np.zeros(len(b)),
                bounds=[*zip(lower, upper, strict=True), (0.0, None)],
                method="highs",
                options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
            )
            assert most.success, most.message
            factor.append(-most.fun * (1 + share))
        return with_moments(problem, factor)

    return make


def in_unit(problem, unit):
    """The same problem for activations and controls in another unit."""
    problem = with_moments(problem, 1 / unit)
    muscles, actuators = problem.motion.muscles, problem.motion.actuators
    muscles = dataclasses.replace(
        muscles, min_activation=muscles.min_activation / unit, max_activation=muscles.max_activation / unit
    )
    actuators = dataclasses.replace(
        actuators, min_control=actuators.min_control / unit, max_control=actuators.max_control / unit
    )
    motion = dataclasses.replace(problem.motion, muscles=muscles, actuators=actuators)
    return dataclasses.replace(problem, motion=motion)


def _with(problem, change):
    trajectory = problem.motion.trajectory
    rows = ("moment_arms", "generalized_forces", "actuator_generalized_forces")
    changed = dataclasses.replace(trajectory, **{name: change(getattr(trajectory, name)) for name in rows})
    return dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=changed))


#: Kinds of problems: how a random one is made, and by how much its solution is scaled as a guess.
KINDS = {
    "as it is": (drawn, None),
    "multiple": (dependent([2.5, 0.0]), None),
    "sum": (dependent([1.0, 1.0]), None),
    "multiple, noise 1e-15": (noisy(1e-15), None),
    "multiple, noise 1e-12": (noisy(1e-12), None),
    "overdetermined": (many_equations, None),
    "zero moments": (moments(0.0), None),
    "moments x 1e-2": (moments(1e-2), None),
    "moments x 1e-4": (moments(1e-4), None),
    "forces x 1e-9": (forces(1e-9), None),
    "forces x 1e9": (forces(1e9), None),
    "weight x 1e-9": (weighed(1e-9), None),
    "weight x 1e9": (weighed(1e9), None),
    "guess x 1e3": (drawn, 1e3),
    "guess x 1e6": (drawn, 1e6),
    "hard levels": (levels(None), None),
    "soft levels": (levels((1e-5, 1e-1)), None),
    "barely feasible": (at_the_limit(-1e-4), None),
    "barely infeasible": (at_the_limit(1e-4), None),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame in plain numbers: min sum w |x|^p + price sum m, A x = b, G x + m >= h, bounds, m >= 0.

    The price is infinite where levels are hard.
    """

    weights: np.ndarray
    a: np.ndarray
    b: np.ndarray
    g: np.ndarray
    h: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    price: float
    exponent: float

    @classmethod
    def of(cls, problem, k):
        weights, a, b, g, h, lower, upper = frame_arrays(problem, k)
        soft = [term.soft for term in problem.constraints if isinstance(term, scso.JointStability)]
        effort = problem.objectives[0]
        price = soft[0] if soft and soft[0] is not None else np.inf
        return cls(weights=weights * effort.weight, a=a, b=b, g=g, h=h, lower=lower, upper=upper, price=price,
                   exponent=effort.exponent)  # fmt: skip

    def in_unit(self, unit):
        """The same for x in another unit, its cost divided by unit^p: powers do not vanish."""
        return dataclasses.replace(
            self, b=self.b / unit, h=self.h / unit, lower=self.lower / unit, upper=self.upper / unit,
            price=self.price * unit ** (1 - self.exponent) if np.isfinite(self.price) else np.inf,
        )  # fmt: skip

    def cost(self, x, missed):
        effort = self.weights * np.abs(x)
        flat = np.isinf(self.exponent)
        value = effort.max() if flat else (self.weights * np.abs(x) ** self.exponent).sum()
        return float(value + (self.price * missed.sum() if np.isfinite(self.price) else 0.0))

    def bound(self, y, z):
        """A lower bound of the cost for an exponent above 1 by Lagrange's dual, whatever y and z are.

        min over lower <= x <= upper of w |x|^p - c x, with c = A'y + G'z, is at the clipped root of
        w p |x|^(p-1) = |c|; misses cost nothing less as long as z is not above their price.
        """
        z = np.clip(z, 0.0, self.price)
        c = self.a.T @ y + self.g.T @ z
        root = np.sign(c) * (np.abs(c) / (self.weights * self.exponent)) ** (1 / (self.exponent - 1))
        x = np.clip(root, self.lower, self.upper)
        return float(y @ self.b + z @ self.h + (self.weights * np.abs(x) ** self.exponent - c * x).sum())

    def multipliers(self, x):
        """Multipliers that explain the slopes of all unknowns between their bounds, by least squares."""
        rows = np.vstack([self.a, self.g])
        slope = self.weights * self.exponent * np.sign(x) * np.abs(x) ** (self.exponent - 1)
        free = (x > self.lower + 1e-6) & (x < self.upper - 1e-6)
        found = np.linalg.lstsq(rows[:, free].T, slope[free], rcond=None)[0] if free.any() else 0 * rows[:, 0]
        return np.split(found, [len(self.b)])

    def least_by_linear_program(self):
        """Least cost at exponents 1 and infinity by HiGHS, on rows and unknowns near one."""
        size, least = np.abs(self.a).max(axis=1), np.abs(self.g).max(axis=1, initial=0.0)
        a, b, g, h = self.a / size[:, None], self.b / size, self.g / least[:, None], self.h / least
        unit = max(np.abs(b).max(initial=0.0), np.abs(h).max(initial=0.0)) or 1.0
        n, m = len(self.lower), len(h)
        largest = np.eye(n) if self.exponent == 1.0 else np.ones((n, 1))
        none = np.zeros((n, m))
        weights = np.diag(self.weights / self.weights.mean())
        price = self.price * least / self.weights.mean() if np.isfinite(self.price) else np.zeros(m)
        most = np.inf if np.isfinite(self.price) else 0.0
        result = linprog(
            np.concatenate([np.zeros(n), np.ones(largest.shape[1]), price]),
            A_ub=np.vstack([
                np.hstack([weights, -largest, none]),
                np.hstack([-weights, -largest, none]),
                np.hstack([-g, np.zeros((m, largest.shape[1])), -np.eye(m)]),
            ]),
            b_ub=np.concatenate([np.zeros(2 * n), -h / unit]),
            A_eq=np.hstack([a, np.zeros((len(b), largest.shape[1] + m))]),
            b_eq=b / unit,
            bounds=[
                *zip(self.lower / unit, self.upper / unit, strict=True),
                *[(0.0, None)] * largest.shape[1],
                *[(0.0, most)] * m,
            ],
            method="highs",
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )  # fmt: skip
        assert result.success, result.message
        return self.weights.mean() * unit * float(result.fun)


def verdicts(seed):
    """Kind, exponent and what becomes of each frame of one problem."""
    kind = list(KINDS)[seed % len(KINDS)]
    exponent = EXPONENTS[seed // len(KINDS) % len(EXPONENTS)]
    make, guess_factor = KINDS[kind]
    reserve = RESERVES[seed // (len(KINDS) * len(EXPONENTS)) % len(RESERVES)]
    problem, guess = make(np.random.default_rng(seed), exponent, reserve), None
    if guess_factor is not None:
        solution = scso.solve_trajectory(problem)
        guess = dataclasses.replace(
            solution, activation=solution.activation * guess_factor, control=solution.control * guess_factor
        )
    try:
        solution = scso.solve_trajectory(problem, initial_guess=guess, on_failure="return")
    except ScsoError as error:
        return [(kind, exponent, f"refused: {error}")] * problem.motion.n_frames
    return [(kind, exponent, _outcome(kind, problem, solution, k)) for k in range(len(solution.frame_status))]


def _outcome(kind, problem, solution, k):
    status = solution.frame_status[k]
    if status is Status.INFEASIBLE and kind == "barely infeasible":
        proven = any(proof.frame == k and proof.holds for proof in solution.infeasibility)
        return "right" if proven else "INFEASIBLE, but without proof"
    if status not in (Status.SOLVED, Status.STABILITY_MISSED):
        return status.name
    x, frame = unknowns(solution, k), Frame.of(problem, k)
    rows = solution.rows.get("JointStability")
    missed = np.zeros(0) if rows is None else rows.missed[k]
    size = np.abs(frame.a) @ np.abs(x) + np.abs(frame.b)
    wanted = np.abs(frame.g) @ np.abs(x) + np.abs(frame.h)
    if (
        (np.abs(frame.a @ x - frame.b) > PRECISION * size.max()).any()
        or (frame.g @ x + missed < frame.h - PRECISION * wanted.max(initial=0.0)).any()
        or (x < frame.lower).any()
        or (x > frame.upper).any()
    ):
        return "SOLVED, but rows or bounds are missed"
    p = frame.exponent
    if p in (1.0, np.inf):
        cost, least, slack = frame.cost(x, missed), frame.least_by_linear_program(), PRECISION_OF_HIGHS
    else:
        unit = (np.abs(x).max() or 1.0) if rows is None else 1.0
        own = frame.in_unit(unit)
        y = solution.rows["MomentEquilibrium"].multiplier[k]
        z = np.zeros(0) if rows is None else rows.multiplier[k]
        cost, slack = own.cost(x / unit, missed / unit), 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            given = own.bound(*(v * unit ** (1 - p) if unit ** (1 - p) < 1e200 else 0 * v for v in (y, z)))
        least = max(given, own.bound(*own.multipliers(x / unit)))
        if cost > least * (1 + PRECISION * p) and rows is None:
            # multipliers that vanish among the doubles do not where the optimum's largest unknown is one
            near_one = scso.solve_trajectory(in_unit(problem, unit), on_failure="return")
            least = max(least, own.bound(near_one.rows["MomentEquilibrium"].multiplier[k], z))
    # the size of the objective is sum |x df/dx|, p times its value
    if cost > least + (PRECISION * (p if np.isfinite(p) else 1.0) + slack) * abs(cost):
        return (
            f"SOLVED, but {cost / least - 1:.1e} above a bound" if least > 0 else "SOLVED, but above a bound"
        )
    return "right"


@pytest.mark.parametrize("part", range(6))
def test_what_is_called_solved_is_the_optimum(part):
    seeds = range(part, NUMBER, 6)
    found = [outcome for seed in seeds for outcome in verdicts(seed)]
    table = collections.Counter(found)
    if NUMBER > 1000:
        for (kind, exponent, outcome), n in sorted(table.items()):
            print(f"{kind:22s} p = {exponent:<5} {n:6d} {outcome}")
    wrong = {entry: n for entry, n in table.items() if entry[2].startswith("SOLVED")}
    assert not wrong, wrong
    infeasible = {entry: n for entry, n in table.items() if entry[2].startswith("INFEASIBLE")}
    assert not infeasible, f"all of these can be solved, or lack a proof: {infeasible}"
    lost = {entry: n for entry, n in table.items() if entry[2] != "right"}
    assert sum(lost.values()) <= 0.001 * len(found), lost


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_oracles_see_what_is_not_the_optimum_and_what_keeps_no_row(rng, exponent):
    """Answers of other weights, and for other moments, are not those of the problem."""
    problem = drawn(rng, exponent, 5.0)
    solution = scso.solve_trajectory(problem)
    assert [_outcome("as it is", problem, solution, k) for k in range(3)] == ["right"] * 3
    effort = scso.ActivationEffort(exponent=exponent, weights={"*": 1.0, "m[12]": 20.0, "reserve*": 0.5})
    others = (dataclasses.replace(problem, objectives=(effort,)), with_moments(problem, 1 + 1e-5))
    for other, expected in zip(others, ("above a bound", "rows or bounds are missed"), strict=True):
        wrong = scso.solve_trajectory(other)
        mixed = dataclasses.replace(solution, activation=wrong.activation, control=wrong.control)
        words = [_outcome("as it is", problem, mixed, k) for k in range(3)]
        # without curvature a vertex may be the optimum of other weights too
        assert sum(expected in word for word in words) >= (3 if exponent > 1.0 else 1), words
