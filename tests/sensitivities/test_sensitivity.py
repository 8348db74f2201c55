"""Derivatives known on paper, the adjoint beside them, kinks that are flagged, and what is refused."""

from __future__ import annotations

import dataclasses
import gc
import pickle

import numpy as np
import pytest
from helpers import elbow, motion, muscle_parameters, random_problem, two_antagonists
from sensitivities.differences import changed, optimum, problem_of

import scso_nlp as scso
from scso_nlp import Regularity
from scso_nlp.exceptions import DataError, NameMismatchError, ProblemError
from scso_nlp.solver import described


def pair(moment, exponent, lower=0.0):
    """Two muscles at one joint that pull the same way."""
    trajectory = motion(np.array([[[0.05, 0.03]]]), [[moment]])
    muscles = muscle_parameters(trajectory.muscles, [1000.0, 1500.0], lower=lower)
    return scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscles),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=exponent),),
    )


@pytest.mark.parametrize("exponent", [1.2, 1.5, 2.0, 3.0, 10.0])
def test_two_muscles_at_one_joint_change_as_lagrange_says(exponent):
    """With b = 1/(p - 1) and s_m = r_m F_m: a_m = M s_m^b / sum s^(b + 1); all else by its derivatives."""
    moment, p = 30.0, exponent
    strength, b = np.array([50.0, 45.0]), 1 / (p - 1)
    total = (strength ** (b + 1)).sum()
    activation = moment * strength**b / total
    by_moment = strength**b / total
    # of s_1 = r_1 F_1: the numerator, and the sum below
    by_strength = -activation * (b + 1) * strength[0] ** b / total
    by_strength[0] += b * activation[0] / strength[0]
    log = np.log(strength)
    mean = (strength ** (b + 1) * log).sum() / total
    by_exponent = activation * (log - mean) * (-(b**2))
    names = ["generalized_forces", "max_isometric_force[m1]", "moment_arms[q1/m1]", "exponent"]
    change = scso.sensitivity(scso.solve_trajectory(pair(moment, p)), names)
    expected = [by_moment, by_strength * 0.05, by_strength * 1000.0, by_exponent]
    np.testing.assert_allclose(change.activation[0], expected, rtol=1e-7, atol=1e-12)
    # the optimum is M^p (sum s^(b + 1))^(1 - p), its multiplier the derivative by M
    least = moment**p * total ** (1 - p)
    np.testing.assert_allclose(change.objective[0], p * least / moment, rtol=1e-7)
    multiplier = change.row_multiplier["MomentEquilibrium"][0, 0, 0]
    np.testing.assert_allclose(multiplier, p * (p - 1) * least / moment**2, rtol=1e-7)


@pytest.mark.parametrize(("exponent", "put"), [(1.5, 0.0), (5.0, 0.01), (10.0, 0.01)])
def test_a_muscle_that_a_solver_left_at_the_wrong_bound_finds_its_optimum(exponent, put):
    """A weak muscle costs next to nothing at its bound, at which neither power has its optimum."""
    trajectory = motion(np.array([[[0.05, 0.03], [0.0, 0.0]]]), [[30.0, 1e-3]], actuator_columns=[[0], [1]])
    problem = pair(30.0, exponent, lower=put)
    problem = dataclasses.replace(
        problem,
        motion=scso.Motion(
            trajectory=trajectory,
            muscles=muscle_parameters(trajectory.muscles, [1000.0, 50.0], lower=put),
            actuators=scso.ActuatorParameters(
                actuators=trajectory.actuators, optimal_force=[1.0], min_control=[-1.0], max_control=[1.0]
            ),
        ),
        constraints=(scso.MomentEquilibrium(),),
    )
    solution = scso.solve_trajectory(problem)
    left = dataclasses.replace(solution, activation=np.array([[30.0 / 50.0, put]]))
    change = scso.sensitivity(left, ["generalized_forces[q1]", "generalized_forces[q2]"])
    strength, b = np.array([50.0, 1.5]), 1 / (exponent - 1)
    by_moment = strength**b / (strength ** (b + 1)).sum()
    np.testing.assert_allclose(change.activation[0], [by_moment, [0.0, 0.0]], rtol=1e-9)
    np.testing.assert_allclose(change.control[0], [[0.0], [1.0]], atol=1e-12)


def test_antagonists_at_their_level_change_with_q_as_the_row_says():
    """Without a moment both have the same a, and 2 a F GS = EW + level; GS rises by r²/L per unit of q."""
    problem = two_antagonists(0.0, q=5.0, level=10.0)
    solution = scso.solve_trajectory(problem)
    change = scso.sensitivity(solution, ["q", "level", "passive_stiffness"])
    activation = solution.activation[0, 0]
    per_force = 40.0 / (2 * activation * 2000.0)  # stability of each newton, EW = 30 and level = 10 N·m/rad
    by_q = -activation * (0.05**2 / 0.2) / per_force
    by_level = activation / 40.0
    expected = [[by_q] * 2, [by_level] * 2, [-by_level] * 2]
    np.testing.assert_allclose(change.activation[0], expected, rtol=1e-8)
    np.testing.assert_allclose(change.row_value["JointStability"][0, :, 0], [0.0, 1.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("seed", [2, 5, 6, 7, 8])
def test_the_adjoint_says_the_same_as_all_right_sides(seed):
    rng, kind, _, problem = problem_of(seed + 22)
    solution = scso.solve_trajectory(problem)
    names = ["generalized_forces", "max_isometric_force[m*]", "weights[m1]", "moment_arms[*/m2]"]
    if kind == "whole_hessian":
        names = [name.replace("[m*]", "").replace("[m1]", "").replace("[*/m2]", "") for name in names]
    change = scso.sensitivity(solution, names)
    weights = {
        name: rng.normal(size=getattr(solution, name).shape) * change.is_regular[:, None]
        for name in ("activation", "tendon_force", "control")
    }
    found = scso.adjoint_sensitivity(solution, names, **weights)
    expected = sum(np.nansum(getattr(change, name) * w[:, None], axis=(0, 2)) for name, w in weights.items())
    assert found.regularity == change.regularity
    np.testing.assert_allclose(found.value, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_muscle_that_is_about_to_leave_its_bound_is_a_kink_and_has_no_derivative():
    """The bound of the first muscle is its free optimum: with less moment it holds, with more it does not."""
    free = scso.solve_trajectory(pair(30.0, 2.0)).activation[0]
    problem = pair(30.0, 2.0)
    muscles = dataclasses.replace(problem.motion.muscles, min_activation=[free[0], 0.0])
    at_kink = dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, muscles=muscles))
    change = scso.sensitivity(scso.solve_trajectory(at_kink), ["generalized_forces"])
    assert change.regularity == (Regularity.KINK,)
    assert np.isnan(change.activation).all()
    assert np.isnan(change.objective).all()
    weights = np.ones((1, 2))
    found = scso.adjoint_sensitivity(
        scso.solve_trajectory(at_kink), ["generalized_forces"], activation=weights
    )
    assert np.isnan(found.value).all()


def test_a_linear_cost_with_two_equal_muscles_is_singular():
    trajectory = motion(np.array([[[0.05, 0.05]]]), [[30.0]])
    problem = scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscle_parameters(trajectory.muscles, 1000.0)),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=1.0),),
    )
    change = scso.sensitivity(scso.solve_trajectory(problem), ["generalized_forces"])
    assert change.regularity[0] in (Regularity.SINGULAR, Regularity.KINK)
    assert np.isnan(change.activation).all()


def test_muscles_that_fall_as_fast_as_they_may_towards_their_bound_have_derivatives():
    """They come nearer to it than numbers tell apart; a(k + 1)(1 + h) = a(k)(1 - h) with h = dt/2 tau."""
    moments = np.concatenate([np.full(4, 60.0), np.full(116, -5.0)])
    problem = elbow(moments, reserve=10.0)
    problem = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationRate()))
    change = scso.sensitivity(scso.solve_trajectory(problem), ["generalized_forces[q1]"])
    assert change.is_regular.all()
    assert 0 < np.abs(change.solution.activation[-1]).max() < 1e-9
    found, ratio = change.activation[:, 0], (1 - 0.125) / (1 + 0.125)
    assert (found[6] > 1e-4).all()
    np.testing.assert_allclose(found[7:], ratio * found[6:-1], rtol=1e-6)
    below, above = (
        optimum(changed(problem, change.parameters[0], h)).values["activation"] for h in (-1e-3, 1e-3)
    )
    np.testing.assert_allclose(found, (above - below) / 2e-3, rtol=1e-6, atol=1e-6 * found.max())


def test_a_frame_that_is_not_solved_is_told_and_the_others_have_their_derivatives():
    problem = elbow([60.0, 500.0, 30.0])
    solution = scso.solve_trajectory(problem, on_failure="return")
    change = scso.sensitivity(solution, ["generalized_forces"])
    assert [r.name for r in change.regularity] == ["REGULAR", "NOT_SOLVED", "REGULAR"]
    np.testing.assert_allclose(change.activation[0, 0] * 60.0, solution.activation[0])
    assert np.isnan(change.activation[1]).all()


def test_parameters_change_together_by_shares_and_in_one_frame(rng):
    problem = random_problem(rng, reserve=5.0)
    solution = scso.solve_trajectory(problem)
    strength = problem.motion.muscles.max_isometric_force
    each = scso.sensitivity(
        solution, [f"max_isometric_force[{name}]" for name in problem.motion.muscles.muscles]
    )
    share = scso.Parameter(quantity="max_isometric_force", relative=True)
    moments = [scso.Parameter(quantity="generalized_forces", frame=k) for k in range(3)]
    change = scso.sensitivity(solution, [share, "generalized_forces", *moments])
    assert change.names[0] == "relative max_isometric_force"
    assert change.names[2].endswith("at frame 0")
    expected = np.einsum("kpm,p->km", each.activation, strength)
    np.testing.assert_allclose(change.activation[:, 0], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(change.activation[1, 3], change.activation[1, 1])
    assert (change.activation[1, [2, 4]] == 0).all()


@pytest.mark.parametrize(
    ("parameter", "error", "words"),
    [
        ("stiffness", ProblemError, "quantity is 'stiffness', expected one of q, level"),
        ("q[", ProblemError, "no closing bracket"),
        ("q[soleus]", NameMismatchError, "soleus"),
        ("price", ProblemError, "the problem has no price"),
        ("optimal_fiber_length", ProblemError, "no term of the problem has the number optimal_fiber_length"),
        (scso.Parameter(quantity="q", term="MomentEquilibrium"), ProblemError, "no term of the term"),
        (scso.Parameter(quantity="level", frame=0), ProblemError, "leave the frame out"),
        (scso.Parameter(quantity="generalized_forces", frame=9), ProblemError, "expected one of 3 frames"),
    ],
)
def test_what_a_problem_does_not_have_is_refused(rng, parameter, error, words):
    solution = scso.solve_trajectory(random_problem(rng, reserve=5.0))
    with pytest.raises(error, match=words.replace("[", r"\[")):
        scso.sensitivity(solution, [parameter])


def test_what_a_muscle_model_takes_as_numbers_is_refused(rng):
    problem = random_problem(rng, reserve=5.0, muscle_model=scso.RigidTendon())
    solution = scso.solve_trajectory(problem)
    with pytest.raises(ProblemError, match="RigidTendon does not see tendon_slack_length"):
        scso.sensitivity(solution, ["tendon_slack_length"])
    heavy = dataclasses.replace(problem, objectives=(scso.ActivationEffort(weights="pcsa"),))
    with pytest.raises(ProblemError, match="ActivationEffort does not see max_isometric_force"):
        scso.sensitivity(scso.solve_trajectory(heavy), ["max_isometric_force"])
    with pytest.raises(DataError, match="activation has shape"):
        scso.adjoint_sensitivity(solution, ["q"], activation=np.ones((1, 2)))


@pytest.mark.parametrize("quantity", ["max_isometric_force", "q", "exponent"])
def test_laws_and_costs_with_constants_of_their_own_are_seen(rng, quantity):
    """A gain that falls with the share of F0, and a shifted effort of exponent 3."""
    law = scso.FallingStiffness(q=5.0)

    def problem_with(amount):
        q = {"*": 5.0, "m4": 5.0 + amount * (quantity == "q")}
        exponent = 3.0 + amount * (quantity == "exponent")
        effort = scso.ShiftedEffort(shift=0.1, exponent=exponent)
        stability = scso.JointStability(
            stiffness=dataclasses.replace(law, q=q), level=1e3, soft=1e-4, joints=("elbow",)
        )
        constraints = (scso.MomentEquilibrium(), stability)
        problem = dataclasses.replace(start, objectives=(effort,), constraints=constraints)
        if quantity != "max_isometric_force":
            return problem
        return changed(problem, scso.Parameter(quantity=quantity, of="m4"), 100 * amount)

    start = random_problem(rng, reserve=5.0, stability=False)
    of = "" if quantity == "exponent" else "[m4]"
    change = scso.sensitivity(scso.solve_trajectory(problem_with(0.0)), [f"{quantity}{of}"])
    assert change.is_regular.all()
    below, above = (optimum(problem_with(h)).values["tendon_force"] for h in (-1e-4, 1e-4))
    slope = (above - below) / (2e-2 if quantity == "max_isometric_force" else 2e-4)
    assert np.abs(slope).max() > 0
    np.testing.assert_allclose(change.tendon_force[:, 0], slope, atol=1e-6 * np.abs(slope).max())


def test_a_moment_arm_that_is_zero_in_all_frames_is_differentiated_by_too():
    """A reserve of 1 N·m takes what the muscle would turn a second joint by; at rest it costs nothing."""
    trajectory = motion(np.array([[[0.05, 0.03], [0.0, 0.0]]]), [[30.0, 0.0]], actuator_columns=[[0], [1]])
    problem = scso.MuscleForceProblem(
        motion=scso.Motion(
            trajectory=trajectory,
            muscles=muscle_parameters(trajectory.muscles, [1000.0, 1500.0], lower=0.0),
            actuators=scso.ActuatorParameters(
                actuators=trajectory.actuators, optimal_force=[1.0], min_control=[-9.0], max_control=[9.0]
            ),
        ),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(),),
    )
    solution = scso.solve_trajectory(problem)
    change = scso.sensitivity(solution, ["moment_arms[q2/m1]"])
    np.testing.assert_allclose(change.activation[0, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(change.control[0, 0], [-1000.0 * solution.activation[0, 0]], rtol=1e-9)


@pytest.mark.parametrize("names", [["generalized_forces"], ["q", "max_isometric_force[m1]", "moment_arms"]])
def test_a_solution_from_elsewhere_is_described_again(rng, names):
    """A copy has no description from solving beside it."""
    solution = scso.solve_trajectory(random_problem(rng))
    change, again = (
        scso.sensitivity(each, names) for each in (solution, pickle.loads(pickle.dumps(solution)))
    )
    for name in ("activation", "tendon_force", "frame_objective"):
        np.testing.assert_allclose(getattr(again, name), getattr(change, name), rtol=1e-9, atol=1e-12)


def test_descriptions_go_with_their_solutions(rng):
    kept = len(described._KEPT)
    solution = scso.solve_trajectory(random_problem(rng))
    assert len(described._KEPT) == kept + 1
    del solution
    gc.collect()
    assert len(described._KEPT) <= kept
