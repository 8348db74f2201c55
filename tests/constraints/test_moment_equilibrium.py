"""Moment equilibrium against its sum in NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, evaluate_terms, random_problem, with_motion

import scso_nlp as scso


@pytest.mark.parametrize("model", [scso.NoPhysiology(), scso.RigidTendon()])
@pytest.mark.parametrize("reserve", [None, 5.0])
def test_rows_are_produced_less_required_forces(rng, model, reserve):
    problem = random_problem(rng, reserve=reserve, muscle_model=model, n_coordinates=4)
    n_actuators = problem.motion.actuators.n_actuators
    # Actuators need not act on one coordinate each, nor alike in every frame.
    trajectory = dataclasses.replace(
        problem.motion.trajectory, actuator_generalized_forces=rng.normal(size=(3, 4, n_actuators))
    )
    problem = with_motion(problem, trajectory=trajectory)
    activation, control = rng.uniform(0, 1, (3, 10)), rng.normal(size=(3, n_actuators))
    _, rows, force = evaluate_terms(problem, activation, control)
    expected = np.einsum("kcm,km->kc", trajectory.moment_arms, force)
    expected += np.einsum("kca,ka->kc", trajectory.actuator_generalized_forces, control)
    expected -= trajectory.generalized_forces
    np.testing.assert_allclose(rows["MomentEquilibrium"], expected, rtol=1e-10, atol=1e-10)


def test_rows_are_equations_named_by_coordinate_in_its_own_unit(rng):
    problem = random_problem(rng)
    trajectory = dataclasses.replace(problem.motion.trajectory, is_rotational=[True, False, True])
    solution = scso.solve_framewise(with_motion(problem, trajectory=trajectory))
    rows = solution.rows["MomentEquilibrium"]
    assert rows.names == ("q1", "q2", "q3")
    assert rows.unit == ("N·m", "N", "N·m")
    np.testing.assert_array_equal(rows.lower, 0.0)
    np.testing.assert_array_equal(rows.upper, 0.0)


# Passive elements of the model ------------------------------------------------------------------------


def with_spring(passive_elements, exponent=2.0):
    """The closed form of three muscles about one joint, and a spring that carries 4 of 10 N·m in frame 0."""
    problem = elbow([6.0, 9.0], exponent=exponent)
    trajectory = dataclasses.replace(problem.motion.trajectory, passive_generalized_forces=[[4.0], [-2.5]])
    return dataclasses.replace(
        problem,
        motion=dataclasses.replace(problem.motion, trajectory=trajectory),
        constraints=(scso.MomentEquilibrium(passive_elements=passive_elements),),
    )


@pytest.mark.parametrize(
    ("passive_elements", "carried"), [("taken_off", [6.0, 9.0]), ("left_in", [10.0, 6.5])]
)
@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
def test_passive_elements_carry_their_share_or_leave_it_to_the_muscles(solve, passive_elements, carried):
    """Least squares over one row: a = M c / |c|² with c = r F0, as long as no bound is reached."""
    solution = solve(with_spring(passive_elements), options=scso.SolverOptions(tolerance=1e-11))
    c = np.array([0.1, 0.05, 0.02]) * [1450.0, 1200.0, 1000.0]
    np.testing.assert_allclose(solution.activation, np.outer(carried, c) / (c @ c), atol=1e-7)
    np.testing.assert_allclose(solution.tendon_force @ [0.1, 0.05, 0.02], carried, rtol=1e-8)


@pytest.mark.parametrize("exponent", [2.0, 3.0])
@pytest.mark.parametrize(("choice", "words"), [("taken_off", "taken off"), ("left_in", "left in")])
def test_the_log_says_once_what_becomes_of_passive_elements(caplog, choice, words, exponent):
    with caplog.at_level("INFO", logger="scso_nlp"):
        scso.solve_trajectory(with_spring(choice, exponent))
    said = [record.message for record in caplog.records if "passive elements" in record.message]
    assert said == [
        f"tiny: generalized forces of passive elements are {words} the moment equilibrium (up to 4 N·m, q1)"
    ]


def test_a_model_without_passive_elements_says_nothing_about_them(caplog):
    with caplog.at_level("INFO", logger="scso_nlp"):
        solutions = [
            scso.solve_trajectory(
                dataclasses.replace(
                    elbow(5.0), constraints=(scso.MomentEquilibrium(passive_elements=choice),)
                )
            )
            for choice in ("taken_off", "left_in")
        ]
    assert "passive elements" not in caplog.text
    np.testing.assert_allclose(solutions[0].activation, solutions[1].activation, atol=1e-12)


def test_an_unknown_choice_of_passive_elements_is_refused():
    with pytest.raises(
        scso.ProblemError, match="passive_elements is 'off', expected 'taken_off' or 'left_in'"
    ):
        scso.MomentEquilibrium(passive_elements="off")
