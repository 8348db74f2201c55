"""The full Hessian formulation against Clarabel's semidefinite optimum and a Cholesky-lifted program."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_problem, smallest_eigenvalue, solve_full_frame, with_forces
from coupled_terms import Smoothness
from helpers import with_motion

import scso_nlp as scso
from problems.random_hessian.lifted_stability import LiftedStability
from scso_nlp import CoordinateStability, HessianStability

#: What the formulation promises: objective relative to the conic optimum, and the smallest eigenvalue
#: over a meaningful rotational stiffness of 10 N·m/rad.
OBJECTIVE, EIGENVALUE = 1e-5, 1e-6 * 10.0

SOLVERS = [scso.solve_trajectory, scso.solve_framewise]

LEVEL = {"q1": 10.0, "q2": -5.0, "q3": 3.0, "q4": 0.0}


def with_stability(problem, stability):
    return dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), stability))


def check(solution, *, q=5.0, level=0.0, passive=0.0, soft=None):
    """Compare every frame with Clarabel; check the Hessian from the arrays that the user receives."""
    problem = solution.problem
    total = 0.0
    for k in range(problem.motion.trajectory.n_frames):
        x, objective, missed = solve_full_frame(problem, k, q=q, level=level, passive=passive, soft=soft)
        total += objective
        force, best = solution.tendon_force[k], x[: problem.motion.muscles.n_muscles]
        reached = smallest_eigenvalue(problem, k, force, q, level, passive)
        oracle = smallest_eigenvalue(
            problem, k, best * problem.motion.muscles.max_isometric_force, q, level, passive
        )
        gap = solution.variables["HessianStability.missed"][k, 0] if soft is not None else 0.0
        assert gap == pytest.approx(missed, abs=1e-3)
        assert reached + gap > -EIGENVALUE
        assert max(oracle + missed, 0.0) - EIGENVALUE < max(reached + gap, 0.0) + 1e-3
    assert solution.objective == pytest.approx(total, rel=OBJECTIVE)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("reserve", [None, 2.0])
def test_the_optimum_is_that_of_the_conic_solver(rng, solve, exponent, reserve):
    problem = hessian_problem(rng, exponent=exponent, reserve=reserve, n_frames=3)
    check(solve(problem))


@pytest.mark.parametrize("seed", range(6))
def test_many_random_motions_have_the_optimum_of_the_conic_solver(seed):
    rng = np.random.default_rng(seed)
    n = 2 + seed % 4
    problem = hessian_problem(rng, n_coordinates=n, n_muscles=4 * n + 4, n_frames=4)
    solution = scso.solve_trajectory(problem)
    check(solution)
    assert solution.report.rounds <= 3


@pytest.mark.parametrize("exponent", [1.0, np.inf])
def test_flat_objectives_end_positive_semidefinite_too(rng, exponent):
    """At exponents without curvature many activations are optimal, and rows must pick a stable one."""
    problem = hessian_problem(rng, exponent=exponent, n_frames=2)
    solution = scso.solve_trajectory(problem)
    for k in range(2):
        assert smallest_eigenvalue(problem, k, solution.tendon_force[k]) > -EIGENVALUE


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("q", [3.0, 10.0])
def test_levels_passive_stiffness_and_gain_stand_where_the_formula_has_them(rng, solve, q):
    matrix = np.array([[4.0, 1.0, 0, 0], [1.0, 3.0, 0.5, 0], [0, 0.5, 2.0, 0], [0, 0, 0, 1.0]])
    stability = HessianStability(
        q=q, level=LEVEL, passive_stiffness={"q1": 2.0, "q4": 5.0}, passive_matrix=matrix
    )
    problem = hessian_problem(rng, n_frames=3, reserve=20.0, n_muscles=24, stability=stability)
    level = np.array(list(LEVEL.values()))
    check(solve(problem), q=q, level=level, passive=matrix + np.diag([2.0, 0, 0, 5.0]))


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("soft", [0.002, 0.02, 10.0])
def test_soft_levels_are_missed_by_as_much_as_the_conic_solver_says(rng, solve, soft):
    problem = hessian_problem(rng, n_frames=3, stability=HessianStability(soft=soft, level=20.0))
    check(solve(problem), level=20.0, soft=soft)


def test_without_the_models_own_passive_stiffness_more_co_contraction_is_needed(rng):
    problem = hessian_problem(rng, n_frames=2)
    without = with_stability(problem, HessianStability(model_passive=False))
    assert scso.solve_trajectory(without).objective > scso.solve_trajectory(problem).objective


@pytest.mark.parametrize("solve", SOLVERS)
def test_frames_that_no_activation_stabilises_are_marked_infeasible(rng, solve):
    problem = hessian_problem(rng, n_frames=4)
    curvature = problem.motion.trajectory.curvature
    load = curvature.load_stiffness.copy()
    load[2] -= 1e5 * np.eye(4)
    trajectory = dataclasses.replace(
        problem.motion.trajectory, curvature=dataclasses.replace(curvature, load_stiffness=load)
    )
    broken = with_motion(problem, trajectory=trajectory)
    assert solve_full_frame(broken, 2) is None
    solution = solve(broken, on_failure="return")
    assert [s.is_solved for s in solution.frame_status] == [True, True, False, True]
    assert solution.frame_status[2] is scso.Status.INFEASIBLE
    for k in (0, 1, 3):
        assert smallest_eigenvalue(broken, k, solution.tendon_force[k]) > -EIGENVALUE
    with pytest.raises(
        scso.SolveFailed, match=r"1 of 4 frames failed \(infeasible\).*HessianStability\[.* q\d.*short by"
    ):
        solve(broken)


@pytest.mark.parametrize("exponent", [2.0, 3.0, np.inf])
@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_units_of_force_do_not_matter(rng, exponent, factor):
    """Neither to the optimum nor to what is out of reach."""
    problem = hessian_problem(rng, exponent=exponent, n_frames=2, reserve=2.0)
    one, other = (scso.solve_trajectory(p) for p in (problem, with_forces(problem, factor)))
    assert set(other.frame_status) == {scso.Status.SOLVED}
    assert other.objective == pytest.approx(one.objective, rel=1e-5)
    least = other.matrices["HessianStability"].smallest_eigenvalue
    assert least.min() > -1e-5 * factor
    highest = scso.reachable_stability(problem)[0].highest.max()
    level = HessianStability(level=factor * (highest + 0.1))
    solution = scso.solve_trajectory(with_stability(with_forces(problem, factor), level), on_failure="return")
    assert set(solution.frame_status) == {scso.Status.INFEASIBLE}
    assert all(proof.holds for proof in solution.infeasibility)


def test_a_motion_out_of_reach_is_proven_so_before_the_solver_is_called(rng):
    problem = hessian_problem(rng, n_frames=3, stability=HessianStability(level=500.0))
    solution = scso.solve_trajectory(problem, on_failure="return")
    assert set(solution.frame_status) == {scso.Status.INFEASIBLE}
    assert solution.report.iterations == 0
    assert all(s.proven and s.helpers for s in solution.shortfalls)


def test_coupled_frames_end_positive_semidefinite_at_no_more_cost_than_needed(rng):
    """With a cost on changes the turns of single frames are not those of the motion, until they are found."""
    problem = hessian_problem(rng, n_frames=4)
    coupled = dataclasses.replace(problem, objectives=(*problem.objectives, Smoothness(weight=0.01)))
    solution = scso.solve_trajectory(coupled)
    for k in range(4):
        assert smallest_eigenvalue(problem, k, solution.tendon_force[k]) > -EIGENVALUE
    lifted = scso.solve_trajectory(with_stability(coupled, LiftedStability()))
    assert solution.objective == pytest.approx(lifted.objective, rel=OBJECTIVE)


@pytest.mark.parametrize("exponent", [2.0, 3.0])
def test_the_lifted_form_has_the_same_optimum(rng, exponent):
    problem = hessian_problem(rng, n_coordinates=3, n_muscles=16, n_frames=3, exponent=exponent)
    lifted = scso.solve_trajectory(with_stability(problem, LiftedStability()))
    solution = scso.solve_trajectory(problem)
    assert solution.objective == pytest.approx(lifted.objective, rel=OBJECTIVE)
    np.testing.assert_allclose(solution.activation, lifted.activation, atol=2e-3)


@pytest.mark.parametrize("solve", SOLVERS)
def test_every_diagonal_row_may_hold_where_the_full_hessian_is_not_stable(rng, solve):
    """The diagonal is necessary, not sufficient; what the repair costs is not negative."""
    problem = hessian_problem(rng, n_frames=3)
    diagonal = solve(with_stability(problem, CoordinateStability()))
    full = solve(problem)
    rows = diagonal.rows["CoordinateStability"]
    assert rows.value.min() > -EIGENVALUE
    least = [smallest_eigenvalue(problem, k, diagonal.tendon_force[k]) for k in range(3)]
    assert max(least) < -10.0
    assert full.objective > 1.1 * diagonal.objective
    plain = solve(problem.without_stability())
    assert diagonal.objective > plain.objective
