"""OpenSim's convention: activation times the capacity of the frame; the physical one: the textbook's sum."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, random_problem, solve_qp, unknowns, with_motion, with_trajectory
from muscle_models.mixed_muscles import DE_GROOTE, MILLARD, RIGID, THELEN, mixed_problem, rigid_force

import scso_nlp as scso


def test_opensim_force_is_activation_times_the_capacity_of_the_frame(rng):
    problem = random_problem(rng, muscle_model=scso.RigidTendon(convention="opensim"))
    activation = rng.uniform(0, 1, (3, 10))
    force = evaluate_terms(problem, activation)[2]
    np.testing.assert_allclose(
        force, activation * problem.motion.trajectory.active_force_capacity, rtol=1e-15
    )


def test_a_muscle_without_capacity_in_a_frame_gives_no_force_there(rng):
    problem = random_problem(rng, muscle_model=scso.RigidTendon(), reserve=5.0, stability=False)
    capacity = problem.motion.trajectory.active_force_capacity.copy()
    capacity[1] = 0.0
    problem = with_trajectory(problem, active_force_capacity=capacity)
    for solve in (scso.solve_trajectory, scso.solve_framewise):
        solution = solve(problem)
        np.testing.assert_array_equal(solution.tendon_force[1], 0.0)
        np.testing.assert_allclose(
            solution.actuator_force[1], problem.motion.trajectory.generalized_forces[1], rtol=1e-9
        )


def test_an_unknown_convention_is_refused():
    with pytest.raises(scso.ProblemError, match="convention is 'hill', expected 'opensim'"):
        scso.RigidTendon(convention="hill")


# The physical convention ---------------------------------------------------------------------------


@pytest.mark.parametrize("passive_force", ["included", "left_out"])
def test_physical_force_of_mixed_classes_is_the_textbook_sum(rng, passive_force):
    problem = mixed_problem(rng, scso.RigidTendon(convention="physical", passive_force=passive_force))
    activation = rng.uniform(0.01, 1, (4, 8))
    force = evaluate_terms(problem, activation)[2]
    expected = rigid_force(problem, activation, passive=passive_force == "included")
    np.testing.assert_allclose(force, expected, rtol=1e-12, atol=1e-10)


def test_physical_force_of_a_thelen_muscle_is_not_affine_in_activation(rng):
    """At v = -0.2 the force at a = 0.1 is a quarter of a tenth of the force at full activation."""
    problem = mixed_problem(
        rng, scso.RigidTendon(convention="physical"), classes=(THELEN,), shapes=({},), n_frames=1
    )
    muscles = problem.motion.muscles
    trajectory = dataclasses.replace(
        problem.motion.trajectory,
        muscle_tendon_length=[[muscles.tendon_slack_length[0] + muscles.optimal_fiber_length[0]]],
        muscle_tendon_velocity=[
            [-0.2 * muscles.optimal_fiber_length[0] * muscles.max_contraction_velocity[0]]
        ],
    )
    problem = with_motion(problem, trajectory=trajectory)
    some, full = (evaluate_terms(problem, [[a]])[2][0, 0] for a in (0.1, 1.0))
    assert some / (0.1 * full) == pytest.approx(0.25, abs=0.005)


@pytest.mark.parametrize("convention", ["physical", "opensim"])
def test_both_solvers_solve_mixed_classes_alike(rng, convention):
    problem = mixed_problem(rng, scso.RigidTendon(convention=convention))
    options = scso.SolverOptions(tolerance=1e-11)
    whole, single = (
        solve(problem, options=options) for solve in (scso.solve_trajectory, scso.solve_framewise)
    )
    np.testing.assert_allclose(whole.activation, single.activation, atol=1e-6)
    if convention == "physical":
        np.testing.assert_allclose(
            whole.tendon_force, rigid_force(problem, whole.activation), rtol=1e-10, atol=1e-8
        )


def test_physical_forces_without_thelen_muscles_are_the_optimum_of_a_quadratic_program(rng):
    """Force is affine in activation: capacity and passive force are the NumPy formula's."""
    problem = mixed_problem(
        rng,
        scso.RigidTendon(convention="physical"),
        classes=(MILLARD, DE_GROOTE, RIGID, MILLARD, DE_GROOTE),
        shapes=({},) * 5,
    )
    solution = scso.solve_trajectory(problem)
    ones, zeros = np.ones((4, 5)), np.zeros((4, 5))
    passive = rigid_force(problem, zeros)
    active = rigid_force(problem, ones) - passive
    trajectory, muscles = problem.motion.trajectory, problem.motion.muscles
    for k in range(4):
        arms = trajectory.moment_arms[k]
        expected = solve_qp(
            2 * np.eye(7),
            np.zeros(7),
            np.hstack([arms * active[k], trajectory.actuator_generalized_forces[k]]),
            trajectory.generalized_forces[k] - arms @ passive[k],
            np.zeros((0, 7)),
            np.zeros(0),
            np.concatenate([muscles.min_activation, [-np.inf] * 2]),
            np.concatenate([muscles.max_activation, [np.inf] * 2]),
        )
        np.testing.assert_allclose(unknowns(solution, k), expected, atol=1e-4)


def with_path(problem, k, m, length):
    lengths = problem.motion.trajectory.muscle_tendon_length.copy()
    lengths[k, m] = length
    trajectory = dataclasses.replace(problem.motion.trajectory, muscle_tendon_length=lengths)
    return with_motion(problem, trajectory=trajectory)


@pytest.mark.parametrize(("m", "name"), [(0, "m1"), (1, "m2"), (2, "m3"), (3, "m4")])
def test_a_path_too_short_for_its_tendon_is_refused_by_muscle_and_time_or_silenced(rng, caplog, m, name):
    problem = mixed_problem(rng, scso.RigidTendon(convention="physical"))
    problem = with_path(problem, 2, m, 0.9 * problem.motion.muscles.tendon_slack_length[m])
    said = rf"path of '{name}' is too short for a rigid tendon at t = 0.02 s.*short_fibers='silence'"
    for solve in (scso.solve_trajectory, scso.solve_framewise):
        with pytest.raises(scso.DataError, match=said):
            solve(problem)
    model = dataclasses.replace(problem.muscle_model, short_fibers="silence")
    with caplog.at_level("WARNING", logger="scso_nlp"):
        solution = scso.solve_trajectory(dataclasses.replace(problem, muscle_model=model))
    assert f"(muscles: {name}); they give no force there" in caplog.text
    assert solution.tendon_force[2, m] == 0.0
    others = np.arange(8) != m
    expected = rigid_force(problem, solution.activation)
    np.testing.assert_allclose(solution.tendon_force[:, others], expected[:, others], rtol=1e-9, atol=1e-7)


def test_the_log_says_what_becomes_of_passive_forces_and_which_fibers_can_push(rng, caplog):
    problem = mixed_problem(rng, scso.RigidTendon(convention="physical"))
    with caplog.at_level("INFO", logger="scso_nlp"):
        scso.solve_trajectory(problem)
    said = [record.message for record in caplog.records if "passive fiber force" in record.message]
    assert said == ["tiny: passive fiber force and damping are included"]
    least = rigid_force(problem, np.broadcast_to(problem.motion.muscles.min_activation, (4, 8)))
    pushing = [
        name for name, low in zip(problem.motion.muscles.muscles, least.min(axis=0), strict=True) if low < 0
    ]
    assert pushing, "no muscle of the example pushes"
    (warning,) = [record.message for record in caplog.records if "push" in record.message]
    assert set(pushing) <= set(warning.rsplit(": ", 1)[1].split(", "))


def test_a_negative_capacity_of_opensim_is_named(rng, caplog):
    problem = mixed_problem(rng, scso.RigidTendon())
    capacity = problem.motion.trajectory.active_force_capacity.copy()
    capacity[1, 2] = -85.0
    trajectory = dataclasses.replace(problem.motion.trajectory, active_force_capacity=capacity)
    scso.solve_trajectory(with_motion(problem, trajectory=trajectory))
    assert "can push by up to 85 N, where the model has no floor: m3" in caplog.text


def test_unknown_choices_are_refused():
    with pytest.raises(scso.ProblemError, match="passive_force is 'no', expected 'included' or 'left_out'"):
        scso.RigidTendon(passive_force="no")
    with pytest.raises(scso.ProblemError, match="short_fibers is 'no', expected 'refuse' or 'silence'"):
        scso.RigidTendon(short_fibers="no")
