"""Optima known on paper, through the public API and by both solvers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import elbow, motion, muscle_parameters, two_antagonists

import scso_nlp as scso

SOLVERS = (scso.solve_trajectory, scso.solve_framewise)

#: Activation [-]; looser where the optimum is flat (p = 1, 100).
TOLERANCE = {1.0: 1e-4, 100.0: 1e-4}

#: Printed values of the three-muscle elbow at 60 N·m, rounded to six digits.
ELBOW = {
    1.5: (0.385470, 0.066002, 0.007334),
    2.0: (0.347652, 0.143856, 0.047952),
    3.0: (0.314097, 0.202048, 0.116653),
    5.0: (0.292240, 0.234388, 0.178096),
    10.0: (0.278493, 0.252485, 0.223471),
    100.0: (0.267772, 0.265396, 0.262467),
    math.inf: (0.266667, 0.266667, 0.266667),
}


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("exponent", ELBOW)
def test_one_joint_shares_the_moment_as_the_printed_values_say(solve, exponent):
    solution = solve(elbow([60.0, 30.0], exponent=exponent))
    tolerance = max(TOLERANCE.get(exponent, 1e-6), 1e-6)
    np.testing.assert_allclose(solution.activation[0], ELBOW[exponent], atol=tolerance)
    # Below saturation everything is proportional to the moment.
    np.testing.assert_allclose(solution.activation[1], solution.activation[0] / 2, atol=tolerance)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("exponent", [1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 7.3, 20.0, 50.0, 100.0])
def test_one_joint_follows_the_lagrange_solution_at_any_exponent(solve, exponent):
    capacity = np.array([0.1, 0.05, 0.02]) * np.array([1450.0, 1200.0, 1000.0])
    expected = 60.0 * capacity ** (1 / (exponent - 1)) / np.sum(capacity ** (exponent / (exponent - 1)))
    activation = solve(elbow([60.0], exponent=exponent)).activation[0]
    np.testing.assert_allclose(activation, expected, atol=1e-6)


@pytest.mark.parametrize("solve", SOLVERS)
def test_exponent_one_uses_the_strongest_lever_alone(solve):
    activation = solve(elbow([60.0], exponent=1.0)).activation[0]
    np.testing.assert_allclose(activation, (60.0 / 145.0, 0.0, 0.0), atol=1e-4)


@pytest.mark.parametrize("solve", SOLVERS)
def test_a_saturated_muscle_leaves_the_rest_to_the_others(solve):
    activation = solve(elbow([200.0])).activation[0]
    np.testing.assert_allclose(activation, (1.0, 0.825, 0.275), atol=1e-6)


@pytest.mark.parametrize("solve", SOLVERS)
def test_many_coordinates_give_the_weighted_pseudo_inverse(solve, rng):
    n_frames, n_coordinates, n_muscles = 4, 3, 9
    arms = rng.normal(0, 0.05, (n_frames, n_coordinates, n_muscles))
    strength = rng.uniform(300, 2000, n_muscles)
    weights = rng.uniform(0.5, 3.0, n_muscles)
    # Moments that activations inside the bounds produce, so that the pseudo-inverse is the optimum.
    inside = rng.uniform(-0.02, 0.02, (n_frames, n_muscles))
    moments = np.einsum("kcm,m,km->kc", arms, strength, inside)
    trajectory = motion(arms, moments)
    names = trajectory.muscles
    problem = scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscle_parameters(names, strength, lower=-1.0)),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(weights=dict(zip(names, weights, strict=True))),),
    )
    solution = solve(problem)
    for k in range(n_frames):
        a = arms[k] * strength
        inverse = np.diag(1 / weights)
        expected = inverse @ a.T @ np.linalg.solve(a @ inverse @ a.T, moments[k])
        np.testing.assert_allclose(solution.activation[k], expected, atol=1e-6)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0, 10.0, 100.0, math.inf])
@pytest.mark.parametrize(("moment", "forces"), [(5.0, (350.0, 250.0)), (20.0, (500.0, 100.0))])
def test_two_antagonists_stiffen_a_joint_by_co_contraction_whatever_the_exponent(
    solve, exponent, moment, forces
):
    solution = solve(two_antagonists(moment, exponent=exponent))
    strength = solution.problem.motion.muscles.max_isometric_force
    # At p = 1 and above p = 100 the objective is flat; elsewhere the two rows fix both forces.
    tolerance = max(TOLERANCE.get(exponent, 1e-6), 1e-6) * strength.max()
    np.testing.assert_allclose(solution.tendon_force[0], forces, atol=tolerance)
    assert solution.rows["JointStability"].value[0, 0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("solve", SOLVERS)
def test_antagonists_stay_silent_where_the_agonist_alone_stiffens_enough(solve):
    problem = two_antagonists(60.0)
    solution = solve(problem)
    plain = solve(problem.without_stability())
    np.testing.assert_allclose(solution.activation, plain.activation, atol=2e-5)
    np.testing.assert_allclose(solution.tendon_force[0], (1200.0, 0.0), atol=0.1)
    assert solution.rows["JointStability"].multiplier[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_three_elbow_flexors_share_force_as_the_classical_criteria_say():
    """Forces of Crowninshield-type criteria: sum F², sum (F/PCSA)², sum (F/Mmax)³."""
    arms = np.array([0.049, 0.049, 0.023])
    area = np.array([12.5, 8.7, 19.7])
    strongest = np.array([575.0, 363.0, 896.0])
    cases = (
        (np.ones(3), 2.0, (184.7, 184.7, 86.1)),
        (area, 2.0, (201.7, 98.2, 235.2)),
        (strongest * arms, 3.0, (241.1, 120.9, 102.0)),
    )
    for size, exponent, expected in cases:
        # The printed forces of each case balance a moment of about 20 N·m, known to their own digits.
        moment = float(np.dot(arms, expected))
        problem = scso.MuscleForceProblem(
            motion=scso.Motion(
                trajectory=motion(arms[None, None, :], [[moment]]),
                muscles=muscle_parameters(("m1", "m2", "m3"), 1000.0 * size / size.max()),
            ),
            muscle_model=scso.NoPhysiology(),
            objectives=(scso.ActivationEffort(exponent=exponent),),
        )
        force = scso.solve_trajectory(problem).tendon_force[0]
        # The arms are printed to two digits, 0.023 m being known to 2 %.
        np.testing.assert_allclose(force, expected, rtol=0.02)
