"""Random problems of all formulations, their numbers changed by hand, and differences of re-solved optima."""

from __future__ import annotations

import dataclasses

import numpy as np
from conic_oracle import SCALE, hessian_problem, highest_eigenvalue
from helpers import random_problem, with_motion, with_trajectory

import scso_nlp as scso
from scso_nlp.sensitivities.conditions import Conditions
from scso_nlp.solver.redundant import without_redundant_rows
from scso_nlp.transcription.describe import describe

EXPONENTS = (2.0, 1.2, 10.0, 3.0, 1.5, 5.0)
RESERVES = (None, 2.0, 50.0)
#: Steps as shares of the size of a parameter, tried one after the other.
STEPS = (1e-4, 1e-3, 1e-5, 1e-6)


def static(rng, exponent, reserve):
    """Static optimization."""
    return random_problem(rng, exponent=exponent, reserve=reserve, stability=False)


def opensim_capacities(rng, exponent, reserve):
    """Stability about joint axes with capacities as numbers."""
    return random_problem(rng, exponent=exponent, reserve=reserve, muscle_model=scso.RigidTendon())


def about_axes(rng, exponent, reserve):
    """Stability about joint axes."""
    return random_problem(rng, exponent=exponent, reserve=reserve)


def soft_axes(rng, exponent, reserve):
    """The same, missed at a price."""
    problem = about_axes(rng, exponent, reserve)
    balance, stability = problem.constraints
    soft = dataclasses.replace(stability, soft=float(np.exp(rng.uniform(np.log(1e-5), np.log(1e-1)))))
    return dataclasses.replace(problem, constraints=(balance, soft))


def along_coordinates(rng, exponent, reserve):
    """Stability along coordinates."""
    return _over_coordinates(rng, exponent, reserve, scso.CoordinateStability, None)


def whole_hessian(rng, exponent, reserve):
    """The whole Hessian."""
    return _over_coordinates(rng, exponent, reserve, scso.HessianStability, None)


def soft_hessian(rng, exponent, reserve):
    """The whole Hessian, missed at a price."""
    price = float(np.exp(rng.uniform(np.log(1e-5), np.log(1e-1))))
    return _over_coordinates(rng, exponent, reserve, scso.HessianStability, price)


def _over_coordinates(rng, exponent, reserve, kind, price):
    n, m = int(rng.integers(2, 5)), int(rng.integers(8, 16))
    problem = hessian_problem(
        rng, n_coordinates=n, n_muscles=m, n_frames=2, exponent=exponent, reserve=reserve
    )
    highest = min(highest_eigenvalue(problem, k) for k in range(2))
    level = float(highest - SCALE * np.exp(rng.uniform(np.log(1e-2), 0.0)))
    passive = {name: float(rng.uniform(0.0, 3.0)) for name in problem.motion.trajectory.coordinates}
    stability = kind(level=level, soft=price, passive_stiffness=passive)
    return dataclasses.replace(problem, constraints=(problem.constraints[0], stability))


def rate_limited(rng, exponent, reserve):
    """Coupled frames: bounds on rates of activation, with stability about joint axes or without."""
    problem = random_problem(
        rng, n_frames=5, exponent=exponent, reserve=reserve or 2.0, stability=bool(rng.integers(2))
    )
    moments = problem.motion.trajectory.generalized_forces * rng.uniform(0.2, 1.5, (5, 1))
    problem = with_trajectory(problem, generalized_forces=moments)
    constraints = tuple(dataclasses.replace(c, soft=1e-2) if isinstance(c, scso.JointStability) else c
                        for c in problem.constraints)  # fmt: skip
    return dataclasses.replace(problem, constraints=(*constraints, scso.ActivationRate()))


def rigid_tendons(rng, exponent, reserve):
    """Fibers with rigid tendons."""
    return _with_fibers(rng, exponent, reserve, scso.RigidTendon(convention="physical"))


def elastic_tendons(rng, exponent, reserve):
    """Fibers in equilibrium with elastic tendons."""
    return _with_fibers(rng, exponent, reserve, scso.CompliantTendon())


def short_range(rng, exponent, reserve):
    """Short-range stiffness: rows that are not affine."""
    problem = _with_fibers(rng, exponent, reserve, scso.RigidTendon(convention="physical"))
    stability = scso.JointStability(
        stiffness=scso.ShortRangeStiffness(), level=-30.0, soft=1e-2, joints=("elbow",)
    )
    return dataclasses.replace(problem, constraints=(problem.constraints[0], stability))


def _with_fibers(rng, exponent, reserve, model):
    problem = random_problem(rng, n_frames=2, exponent=exponent, reserve=reserve or 2.0, stability=False)
    length = problem.motion.trajectory.muscle_tendon_length.mean(axis=0)
    muscles = dataclasses.replace(
        problem.motion.muscles,
        tendon_slack_length=length * rng.uniform(0.55, 0.62, length.size),
        optimal_fiber_length=length * rng.uniform(0.35, 0.42, length.size),
        pennation_angle_at_optimal=rng.uniform(0.0, 0.4, length.size),
        min_activation=np.full(length.size, 0.01),
        curve_parameters=(),
    )
    problem = with_motion(problem, muscles=muscles)
    problem = with_trajectory(
        problem, generalized_forces=0.5 * problem.motion.trajectory.generalized_forces,
        muscle_tendon_velocity=rng.normal(0, 0.05, problem.motion.trajectory.muscle_tendon_length.shape),
    )  # fmt: skip
    return dataclasses.replace(problem, muscle_model=model)


KINDS = (
    static,
    opensim_capacities,
    about_axes,
    soft_axes,
    along_coordinates,
    whole_hessian,
    soft_hessian,
    rate_limited,
    rigid_tendons,
    elastic_tendons,
    short_range,
)


def problem_of(seed):
    """Generator of random numbers, kind, exponent and problem of a seed."""
    rng = np.random.default_rng([seed, 13])
    kind = KINDS[seed % len(KINDS)]
    exponent = EXPONENTS[seed // len(KINDS) % len(EXPONENTS)]
    reserve = RESERVES[seed // (len(KINDS) * len(EXPONENTS)) % len(RESERVES)]
    problem = kind(rng, exponent, reserve)
    constraints = tuple(
        dataclasses.replace(c, passive_stiffness={"*": 1.0}) if isinstance(c, scso.JointStability) else c
        for c in problem.constraints
    )
    return rng, kind.__name__, exponent, dataclasses.replace(problem, constraints=constraints)


def parameter_of(rng, problem):
    """A random parameter that the problem has, and the size of its numbers."""
    motion, trajectory = problem.motion, problem.motion.trajectory
    stability = [c for c in problem.constraints if hasattr(c, "soft")]
    muscle = str(rng.choice(motion.muscles.muscles))
    coordinate = str(rng.choice(trajectory.coordinates))
    choices = [
        ("max_isometric_force", muscle, 1000.0),
        ("generalized_forces", coordinate, 10.0),
        ("moment_arms", f"{coordinate}/{muscle}", 0.05),
        ("weights", muscle, 1.0),
        ("weight", "*", 1.0),
    ]
    if problem.objectives[0].exponent != 2.0 or not motion.actuators.n_actuators:
        choices.append(("exponent", "*", 1.0))  # below 2 signs of controls are unknowns
    model = problem.muscle_model
    if isinstance(model, scso.CompliantTendon) or getattr(model, "convention", "") == "physical":
        choices += 2 * [("optimal_fiber_length", muscle, 0.1), ("tendon_slack_length", muscle, 0.05)]
    if stability:
        row = str(rng.choice(stability[0].row_names(motion)))
        choices += 2 * [("level", row, 10.0), ("passive_stiffness", row, 10.0)]
        if stability[0].stiffness is None:
            choices += 3 * [("q", muscle, 5.0)]
        if stability[0].soft is not None:
            choices.append(("price", "*", stability[0].soft))
    quantity, of, size = choices[int(rng.integers(len(choices)))]
    return scso.Parameter(quantity=quantity, of=of), size


def changed(problem, parameter, amount):
    """The problem with one number changed by hand."""
    quantity, of = parameter.quantity, parameter.of[0]
    motion, trajectory = problem.motion, problem.motion.trajectory
    if quantity in ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length"):
        values = getattr(motion.muscles, quantity).copy()
        m = motion.muscles.muscles.index(of)
        values[m] += amount
        if quantity == "max_isometric_force" and isinstance(problem.muscle_model, scso.RigidTendon):
            capacity = trajectory.active_force_capacity.copy()
            capacity[:, m] *= values[m] / motion.muscles.max_isometric_force[m]
            problem = with_trajectory(problem, active_force_capacity=capacity)
        return with_motion(problem, muscles=dataclasses.replace(motion.muscles, **{quantity: values}))
    if quantity == "generalized_forces":
        values = trajectory.generalized_forces.copy()
        values[:, trajectory.coordinates.index(of)] += amount
        return with_trajectory(problem, generalized_forces=values)
    if quantity == "moment_arms":
        coordinate, muscle = of.split("/")
        values = trajectory.moment_arms.copy()
        values[:, trajectory.coordinates.index(coordinate), trajectory.muscles.index(muscle)] += amount
        return with_trajectory(problem, moment_arms=values)
    if quantity in ("weights", "weight", "exponent"):
        (effort,) = problem.objectives
        new = {
            "weights": {of: 1.0 + amount},
            "weight": effort.weight + amount,
            "exponent": effort.exponent + amount,
        }
        effort = dataclasses.replace(effort, **{quantity: new[quantity]})
        return dataclasses.replace(problem, objectives=(effort,))
    constraints = tuple(
        _changed_stability(c, motion, quantity, of, amount) if hasattr(c, "soft") else c
        for c in problem.constraints
    )
    return dataclasses.replace(problem, constraints=constraints)


def _changed_stability(constraint, motion, quantity, of, amount):
    rows = constraint.row_names(motion)
    if quantity == "price":
        return dataclasses.replace(constraint, soft=constraint.soft + amount)
    if quantity == "q":
        q = {name: 5.0 for name in motion.muscles.muscles}
        return dataclasses.replace(constraint, q=q | {of: 5.0 + amount})
    # passive stiffness may not be negative, so both start from what is there
    values = dict(zip(rows, constraint.by_row(getattr(constraint, quantity), rows).tolist(), strict=True))
    return dataclasses.replace(constraint, **{quantity: values | {of: values[of] + amount}})


@dataclasses.dataclass(frozen=True)
class Optimum:
    """A re-solved optimum, refined to rounding, and which bounds and rows are active in each frame."""

    values: dict
    active: np.ndarray


def optimum(problem):
    """Solve, and refine with Newton's method; None where that fails."""
    solution = scso.solve_trajectory(problem, on_failure="return")
    if not solution.is_solved.all():
        return None
    program = without_redundant_rows(describe(problem))
    conditions = Conditions(program, solution)
    conditions.settle()
    n, point = conditions.n, conditions.point
    parts = program.layout.split(point.x * program.layout.scale)
    values = {
        "activation": parts["problem", "activation"],
        "tendon_force": program.tendon_force.values(point.x, program.arrays),
        "objective": np.sum([p.values(point.x, program.arrays).sum() for _, p in program.objectives], axis=0),
    }
    signs = [conditions.at_bound.reshape(n, -1), conditions.at_row[: n * len(program.rows)].reshape(n, -1)]
    signs += [turned.active for turned in conditions.turned]
    pairs = conditions.at_row[n * len(program.rows) :].reshape(max(n - 1, 0), -1)
    if pairs.size:
        signs.append(np.vstack([np.zeros((1, pairs.shape[1])), pairs]))
    for is_pair, table in enumerate((program.rows, program.pair_rows)):
        for block, where in table:
            places = conditions.places(is_pair, np.arange(where.start, where.stop))
            sign = np.where(block.lower == block.upper, -1.0, np.sign(conditions.at_row[places]))
            values[block.term] = sign * point.row[places] / block.scale
    for model, matrix in zip(conditions.models, point.matrices, strict=True):
        values[model.block.term] = matrix
    return Optimum(values, np.hstack(signs))


def differences(problem, parameter, size, base):
    """Differences of re-solved optima, step by step: in which frames the active set stays, and the slopes."""
    for share in STEPS:
        h = share * size
        multiples = (-2, -1, 1, 2) if share > 1e-4 else (-1, 1)
        try:
            points = [optimum(changed(problem, parameter, k * h)) for k in multiples]
        except scso.ScsoError:
            continue
        if any(point is None for point in points):
            continue
        same = np.all([(point.active == base.active).all(axis=1) for point in points], axis=0)
        weight = {4: (1 / 12, -8 / 12, 8 / 12, -1 / 12), 2: (-0.5, 0.5)}[len(points)]
        slope = {
            name: sum(w * point.values[name] for w, point in zip(weight, points, strict=True)) / h
            for name in base.values
        }
        yield h, same, slope
