"""Shares of rows and modes, stiffness as an equivalent gain, and the gain above which stability is free."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem
from helpers import random_problem, two_antagonists, with_motion, with_trajectory
from scipy.linalg import eigh

import scso_nlp as scso
from scso_nlp import CoordinateStability, HessianStability
from scso_nlp.contributions import equivalent_q, mode_contributions, row_contributions
from scso_nlp.examples import example_folder
from scso_nlp.muscle_models.stiffness_law import ProportionalStiffness, ShortRangeStiffness
from scso_nlp.solver.critical_gain import critical_q


def test_the_shares_of_joint_rows_add_up_to_the_rows_of_the_solution(rng):
    problem = random_problem(rng, n_frames=3, reserve=5.0)
    passive = dataclasses.replace(problem.constraints[1], passive_stiffness={"elbow_y": 3.0})
    problem = dataclasses.replace(problem, constraints=(problem.constraints[0], passive))
    solution = scso.solve_trajectory(problem)
    shares = row_contributions(solution)
    assert shares.constraint == "JointStability"
    np.testing.assert_allclose(shares.total, solution.rows["JointStability"].value, rtol=1e-9, atol=1e-9)


def test_a_muscles_share_is_what_the_row_loses_without_it(rng):
    problem = hessian_problem(rng, n_frames=2, stability=CoordinateStability())
    solution = scso.solve_trajectory(problem)
    shares = row_contributions(solution)
    length = problem.motion.trajectory.muscle_tendon_length
    for m in (0, 7):
        without = solution.tendon_force.copy()
        without[:, m] = 0.0
        for k in range(2):
            both = [
                np.diag(hessian_by_hand(problem, k, force, 5.0 * force / length[k]))
                for force in (solution.tendon_force[k], without[k])
            ]
            np.testing.assert_allclose(shares.of_muscles[k, :, m], both[0] - both[1], atol=1e-8)


def test_the_shares_of_the_least_stable_mode_add_up_to_the_smallest_eigenvalue(rng):
    problem = hessian_problem(rng, n_frames=3, stability=HessianStability(level={"q1": 2.0}))
    solution = scso.solve_trajectory(problem)
    shares = mode_contributions(solution)
    matrix = solution.matrices["HessianStability"]
    np.testing.assert_allclose(shares.total[:, 0], matrix.smallest_eigenvalue, atol=1e-8)
    assert shares.rows == ("smallest_eigenvalue",)


def test_each_coordinate_of_the_full_hessian_adds_up_too(rng):
    problem = hessian_problem(rng, n_frames=2, stability=HessianStability(passive_stiffness={"q2": 4.0}))
    solution = scso.solve_trajectory(problem)
    shares = row_contributions(solution)
    diagonal = np.einsum("kii->ki", solution.matrices["HessianStability"].value)
    np.testing.assert_allclose(shares.total, diagonal, atol=1e-8)


def test_what_plain_static_optimization_lacks_is_told_by_the_same_functions(rng):
    problem = hessian_problem(rng, n_frames=2)
    plain = scso.solve_trajectory(problem.without_stability())
    shares = mode_contributions(scso.observe(plain, HessianStability(q=3.0)))
    length = problem.motion.trajectory.muscle_tendon_length
    for k in range(2):
        force = plain.tendon_force[k]
        least = np.linalg.eigvalsh(hessian_by_hand(problem, k, force, 3.0 * force / length[k]))[0]
        assert shares.total[k, 0] == pytest.approx(least, abs=1e-8)
    assert shares.total.max() < 0
    bare = scso.solve_trajectory(dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(),)))
    with pytest.raises(scso.ProblemError, match="no HessianStability, kept or observed"):
        mode_contributions(bare)
    with pytest.raises(scso.ProblemError, match="no StabilityConstraint, kept or observed"):
        row_contributions(bare)
    with pytest.raises(scso.NameMismatchError, match="called 'mine', known: HessianStability"):
        row_contributions(plain, "mine")


def test_frames_that_are_not_solved_have_no_shares(rng):
    problem = random_problem(rng, n_frames=3)
    moments = problem.motion.trajectory.generalized_forces.copy()
    moments[1] = 1e4
    problem = with_trajectory(problem, generalized_forces=moments)
    solution = scso.solve_trajectory(problem, on_failure="return")
    shares = row_contributions(solution)
    assert np.isnan(shares.total).all(axis=1).tolist() == [False, True, False]
    assert np.isnan(equivalent_q(solution)).all(axis=1).tolist() == [False, True, False]
    assert np.isnan(critical_q(problem)).tolist() == [False, True, False]


def test_the_equivalent_gain_of_the_proportional_law_is_its_gain(rng):
    gains = rng.uniform(2, 12, 10)
    problem = random_problem(rng, n_frames=2, stability=False)
    rows = scso.JointStability(stiffness=ProportionalStiffness(q=gains), level=-1e4)
    problem = dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
    found = equivalent_q(scso.solve_trajectory(problem))
    assert np.isfinite(found).any()
    np.testing.assert_allclose(found, np.where(np.isnan(found), np.nan, gains))


def test_the_equivalent_gain_of_short_range_stiffness_is_that_of_two_springs(rng):
    """1/q = l0/(gamma L) + F/(kT L): muscles without pennation, force from any muscle model."""
    problem = hessian_problem(rng, n_frames=2)
    muscles = dataclasses.replace(
        problem.motion.muscles,
        tendon_slack_length=np.full(16, 0.1),
        muscle_class=("DeGrooteFregly2016Muscle",) * 16,
    )
    problem = with_motion(problem, muscles=muscles)
    plain = scso.solve_trajectory(problem.without_stability())
    asked = scso.observe(plain, CoordinateStability(stiffness=ShortRangeStiffness()))
    found = equivalent_q(asked, "CoordinateStability")
    force, strength = plain.tendon_force, muscles.max_isometric_force
    slope = np.log(1.2 / 0.2) / 0.049  # tendon curve 0.2 exp(kT (l - 1)) - 0.2, one at 4.9 % strain
    tendon = strength / 0.1 * slope * (force / strength + 0.2)
    expected = 1 / (0.1 / (23.4 * 0.2) + force / (tendon * 0.2))
    pulls = np.isfinite(found)
    assert pulls.any()
    np.testing.assert_allclose(found[pulls], expected[pulls], rtol=1e-6)
    assert (found[pulls] < 23.4 * 0.2 / 0.1).all()


def test_two_antagonists_need_co_contraction_below_the_gain_in_closed_form():
    """F = M/r on one side alone: S = F (q r² - r²)/L - 30, so q = 1 + 30 L r / (M r²)."""
    problem = two_antagonists(20.0)
    expected = 1 + 30.0 * 0.2 / (20.0 / 0.05 * 0.05**2)
    np.testing.assert_allclose(critical_q(problem), [expected], rtol=1e-6)


@pytest.mark.parametrize("rule", [CoordinateStability, HessianStability])
def test_below_the_critical_gain_stability_costs_and_above_it_nothing(rng, rule):
    problem = hessian_problem(rng, n_frames=3, stability=rule())
    critical = critical_q(problem)
    plain = scso.solve_framewise(problem.without_stability())
    np.testing.assert_allclose(critical_q(problem, plain), critical, rtol=1e-6)
    for k in range(3):
        assert 5.0 < critical[k] < np.inf
        for factor, is_free in ((0.98, False), (1.0001, True)):
            at = dataclasses.replace(
                problem, constraints=(scso.MomentEquilibrium(), rule(q=factor * critical[k]))
            ).frames(k, k + 1)
            moved = np.abs(scso.solve_trajectory(at).activation[0] - plain.activation[k]).max()
            assert (moved < 1e-4) == is_free


def test_the_critical_gain_of_the_full_hessian_is_a_generalized_eigenvalue(rng):
    """Where stiffness is definite the threshold is the largest root of det(A + q B)."""
    problem = hessian_problem(rng, n_frames=3)
    plain = scso.solve_trajectory(problem.without_stability())
    critical = critical_q(problem, plain)
    for k in range(3):
        force, length = plain.tendon_force[k], problem.motion.trajectory.muscle_tendon_length[k]
        without = hessian_by_hand(problem, k, force, 0 * force)
        gained = hessian_by_hand(problem, k, force, force / length) - without
        assert critical[k] == pytest.approx(eigh(-without, gained, eigvals_only=True)[-1], rel=1e-9)


def test_no_gain_helps_where_muscles_have_no_force_and_none_is_needed_where_nothing_topples(rng):
    problem = two_antagonists(0.0)
    assert np.isinf(critical_q(problem)).all()
    assert (critical_q(two_antagonists(5.0, external_work=-30.0)) == 0).all()
    with pytest.raises(scso.ProblemError, match="no stability constraint"):
        critical_q(dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(),)))


@pytest.mark.opensim
def test_the_spine_examples_have_the_critical_gains_of_an_independent_solver():
    """12.971 with 4.5 kg at 0.8 m and 4.49 with 9 kg at 0 m, of the reconstruction's own documentation."""
    motion = scso.load_motion(example_folder("spine-load-height") / "setup.xml")
    problem = scso.stability_constrained_static_optimization(motion, muscle_model=scso.NoPhysiology())
    critical = critical_q(problem)
    assert critical[4] == pytest.approx(12.971, abs=5e-4)
    assert critical[5] == pytest.approx(4.49, abs=5e-3)
    assert critical.max() == critical[4]
