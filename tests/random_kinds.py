"""Random problems of every kind that has gone wrong, and one frame of them in plain numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
from helpers import frame_arrays, random_problem
from scipy.optimize import linprog

import scso_nlp as scso

EXPONENTS = (1.0, 1.05, 1.5, 2.0, 3.0, 7.0, 20.0, 200.0, np.inf)
RESERVES = (None, 1.0, 50.0)


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


def problem_of(seed):
    """Kind, exponent, problem, and by how much its solution is scaled as a guess, of a seed."""
    kind = list(KINDS)[seed % len(KINDS)]
    exponent = EXPONENTS[seed // len(KINDS) % len(EXPONENTS)]
    make, guess_factor = KINDS[kind]
    reserve = RESERVES[seed // (len(KINDS) * len(EXPONENTS)) % len(RESERVES)]
    return kind, exponent, make(np.random.default_rng(seed), exponent, reserve), guess_factor
