"""Muscles beside actuators that cost many powers of ten more: at their own optimum, or it is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import motion, muscle_parameters, random_problem
from scipy.optimize import brentq

import scso_nlp as scso
from scso_nlp.solution import Status
from scso_nlp.solver.advice import next_steps
from scso_nlp.solver.judge import Outcome, judge
from scso_nlp.solver.presolve import balanced, presolve
from scso_nlp.solver.programs import starting_point
from scso_nlp.transcription.describe import describe

#: What the muscles of `weakly_held` give at full activation: at pelvis and hip, hip, knee, knee [N·m].
AT_PELVIS, AT_HIP, AGAINST, STRONG, WEAK = 0.5, 500.0, 200.0, 60.0, 15.0
PELVIS, HIP, KNEE = 207.0, 10.0, 30.0


def weakly_held(exponent, optimal_force=1.0):
    """A pelvis held by an actuator of 1 N·m, turned a little by a muscle of the hip; a knee beside it."""
    arms = np.array([[AT_PELVIS, 0.0, 0.0, 0.0], [AT_HIP, -AGAINST, 0.0, 0.0], [0.0, 0.0, STRONG, WEAK]])
    columns = np.zeros((3, 2))
    columns[0, 0], columns[1, 1] = optimal_force, 1.0
    trajectory = motion(arms[None] / 1000.0, [[PELVIS, HIP, KNEE]], actuator_columns=columns)
    actuators = scso.ActuatorParameters(
        actuators=trajectory.actuators,
        optimal_force=[optimal_force, 1.0],
        min_control=[-np.inf] * 2,
        max_control=[np.inf] * 2,
    )
    muscles = muscle_parameters(trajectory.muscles, [1000.0] * 4)
    return scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscles, actuators=actuators),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=exponent),),
        constraints=(scso.MomentEquilibrium(),),
    )


def by_hand(exponent):
    """Activations: of the hip where one equation balances, of its antagonist 1, of the knee in closed form.

    The first turns the pelvis as long as a N·m of its actuator is worth what the hip's actuator costs for it.
    """
    p = exponent - 1

    def unbalanced(a):
        pelvis, hip = PELVIS - AT_PELVIS * a, AT_HIP * a - AGAINST - HIP
        return AT_PELVIS * pelvis**p - AT_HIP * hip**p - a**p

    hip = brentq(unbalanced, (AGAINST + HIP) / AT_HIP, 1.0, xtol=1e-15, rtol=1e-14)
    share = (STRONG / WEAK) ** (1 / p)
    weak = KNEE / (STRONG * share + WEAK)
    return np.array([hip, 1.0, share * weak, weak])


def judged(problem, activation, like):
    """What is said of activations, with controls that keep the rows and the multipliers of a solution."""
    program = describe(problem)
    rows = program.split.affine.dense(program.layout.size)[0], program.split.affine.constant[0]
    control = np.linalg.lstsq(rows[0][:, 4:], -rows[1] - rows[0][:, :4] @ activation, rcond=None)[0]
    outcome = Outcome(
        program=program,
        unknowns=np.concatenate([activation, control])[None],
        multipliers=(-like.rows["MomentEquilibrium"].multiplier, np.zeros((0, 0))),
        status=(Status.SOLVED,),
    )
    return judge(outcome, like.report)


@pytest.mark.parametrize("exponent", [3.0, 5.0, 10.0])
@pytest.mark.parametrize("presolve", [True, False])
def test_a_weak_actuator_hides_no_muscle(exponent, presolve):
    """It costs 1e7 to 1e23, all muscles together about one."""
    solution = scso.solve_trajectory(
        weakly_held(exponent), options=scso.SolverOptions(presolve=presolve), on_failure="return"
    )
    assert solution.frame_status == (Status.SOLVED,)
    np.testing.assert_allclose(solution.activation[0], by_hand(exponent), rtol=1e-9)
    assert solution.optimality.imbalance[0] < 1e-6


def test_muscles_off_their_optimum_are_told_and_the_actuator_that_hides_them_is_named():
    """The knee's strong muscle is moved by a tenth, the weak one makes up: the cost in doubles is the same.

    By shares of the frame's cost and slope it would be solved.
    """
    problem = weakly_held(10.0)
    best = scso.solve_trajectory(problem)
    moved = best.activation[0] - [0.0, 0.0, 0.1, -0.1 * STRONG / WEAK]
    found = judged(problem, moved, best)
    of_frame = found.optimality.stationarity, found.optimality.duality_gap, found.optimality.feasibility
    assert np.max(of_frame) < 1e-12
    assert found.frame_status == (Status.NOT_OPTIMAL,)
    assert judged(problem, best.activation[0], best).frame_status == (Status.SOLVED,)
    (step,) = next_steps(found)
    assert str(step) == (
        "actuators = RESERVES.xml: reserve1 has a control of 206.7 at t = 0 s, whose cost hides what muscles "
        "cost: an optimal_force of 210 would bring it to one"
    )
    assert next_steps(best) == ()


@pytest.mark.parametrize("soft", [None, 0.02])
@pytest.mark.parametrize("exponent", [2.0, 2.5, 3.0])
def test_rows_with_one_side_and_their_misses_are_those_of_the_active_set_method(rng, exponent, soft):
    problem = random_problem(rng, n_frames=4, exponent=exponent, reserve=5.0)
    balance, stability = problem.constraints
    harder = {name: level + 2.0 for name, level in stability.level.items()}
    stability = dataclasses.replace(stability, level=harder, soft=soft)
    program = describe(dataclasses.replace(problem, constraints=(balance, stability)))
    other = presolve(program, starting_point(program, None), np.arange(4))
    assert other.is_optimal.all()
    assert (np.abs(other.multipliers[:, 3:]) > 1e-6).any(), "no row holds: the test shows nothing"
    found = balanced(program, np.arange(4))
    assert found.is_optimal.all()
    np.testing.assert_allclose(found.unknowns, other.unknowns, atol=1e-9)
    size = np.abs(other.multipliers).max()
    np.testing.assert_allclose(found.multipliers, other.multipliers, atol=1e-8 * size)
    np.testing.assert_allclose(found.reduced_cost, other.reduced_cost, atol=1e-8 * size)


def test_rows_that_contradict_each_other_have_no_optimum(rng):
    problem = random_problem(rng, n_frames=2)
    balance, stability = problem.constraints
    beyond = dataclasses.replace(stability, level=1e4)
    found = balanced(describe(dataclasses.replace(problem, constraints=(balance, beyond))), np.arange(2))
    assert not found.is_optimal.any()


@pytest.mark.parametrize("exponent", [1.0, np.inf])
def test_costs_that_are_no_powers_are_left_alone(rng, exponent):
    problem = random_problem(rng, n_frames=2, exponent=exponent, reserve=5.0)
    assert not balanced(describe(problem), np.arange(2)).is_optimal.any()


def test_coupled_frames_are_not_judged_by_their_unknowns(rng):
    problem = random_problem(rng, n_frames=3, reserve=5.0, stability=False)
    coupled = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationRate()))
    assert not balanced(describe(coupled), np.arange(3)).is_optimal.any()
    found = scso.solve_trajectory(coupled).optimality
    assert np.isnan(found.imbalance).all()
    assert np.isfinite(found.worst).all()
