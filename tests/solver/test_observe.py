"""Stability that is kept, and stability that is only looked at."""

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem
from helpers import random_problem, stability_by_hand

import scso_nlp as scso
from problems.random_hessian.lifted_stability import LiftedStability
from scso_nlp import HessianStability
from scso_nlp.figures import plot_stability


@pytest.mark.parametrize("soft", [None, 0.01])
def test_the_whole_hessian_is_read_as_its_diagonal_and_its_smallest_eigenvalue(rng, soft):
    level = {"q1": 3.0, "q3": -2.0}
    problem = hessian_problem(rng, stability=HessianStability(level=level, soft=soft))
    solution = scso.solve_trajectory(problem)
    plain = scso.solve_trajectory(problem.without_stability())
    for run in (solution, plain):
        margin = run.stability
        assert margin is not None
        assert margin.rows == ("q1", "q2", "q3", "q4", "smallest_eigenvalue")
        assert margin.level.tolist() == [3, 0, -2, 0, 0]
        assert margin.mode_coordinates == problem.motion.trajectory.coordinates
        for k in range(problem.motion.trajectory.n_frames):
            force = run.tendon_force[k]
            stiffness = 5.0 * force / problem.motion.trajectory.muscle_tendon_length[k]
            hessian = hessian_by_hand(problem, k, force, stiffness)
            # the same numbers, added up in another order: rounding of terms of some 1e3 N·m/rad
            np.testing.assert_allclose(margin.stability[k, :4], np.diag(hessian), atol=1e-9)
            least = np.linalg.eigvalsh(hessian - np.diag([3.0, 0, -2.0, 0]))[0]
            assert margin.stability[k, 4] == pytest.approx(least, abs=1e-9)
            mode = margin.mode[k]
            assert mode @ (hessian - np.diag([3.0, 0, -2.0, 0])) @ mode == pytest.approx(least, abs=1e-9)
    panels = [panel.get_title(loc="left") for panel in plot_stability(solution, baseline=plain).axes]
    assert panels == ["q1", "q2", "q3", "q4", "smallest_eigenvalue"]


def test_observed_rows_are_evaluated_and_not_kept(rng):
    problem = random_problem(rng)
    plain, kept = scso.solve_trajectory(problem.without_stability()), scso.solve_trajectory(problem)
    rows = plain.rows["JointStability"]
    assert rows.is_observed
    assert np.isnan(rows.multiplier).all()
    stiffness, work = stability_by_hand(problem)
    np.testing.assert_allclose(
        rows.value, np.einsum("kum,km->ku", stiffness, plain.tendon_force) - work, rtol=1e-9, atol=1e-9
    )
    assert (rows.value < rows.lower).any(), "the rows are kept anyway: the test shows nothing"
    assert set(plain.violation) == {"MomentEquilibrium", "bounds"}
    assert set(plain.kept) == {"MomentEquilibrium"}
    assert set(kept.violation) == {"MomentEquilibrium", "JointStability", "bounds"}
    without = dataclasses.replace(problem.without_stability(), observed=())
    np.testing.assert_array_equal(plain.activation, scso.solve_trajectory(without).activation)


def test_a_solution_can_be_asked_for_other_rows_later(rng):
    problem = random_problem(rng)
    solution = scso.solve_trajectory(problem)
    stiffer = scso.JointStability(q=50.0, joints=("elbow",), label="stiffer")
    asked = scso.observe(solution, stiffer)
    assert set(asked.rows) == {"MomentEquilibrium", "JointStability", "stiffer"}
    stiffness, work = stability_by_hand(problem, q=50.0)
    expected = np.einsum("kum,km->ku", stiffness, solution.tendon_force) - work
    np.testing.assert_allclose(asked.rows["stiffer"].value, expected, rtol=1e-9, atol=1e-9)
    assert asked.stability.rows == (*solution.stability.rows, *(f"elbow_{axis}" for axis in "xyz"))
    np.testing.assert_array_equal(asked.activation, solution.activation)
    with pytest.raises(scso.NameMismatchError, match="JointStability is a constraint that the solution kept"):
        scso.observe(solution, scso.JointStability(q=50.0))


def test_a_term_with_unknowns_of_its_own_cannot_be_observed(rng):
    problem = dataclasses.replace(
        hessian_problem(rng), constraints=(scso.MomentEquilibrium(),), observed=(LiftedStability(),)
    )
    with pytest.raises(scso.ProblemError, match="LiftedStability has unknowns of its own"):
        scso.solve_trajectory(problem)
    with pytest.raises(
        scso.ProblemError, match=r"observed is .*, expected a sequence of objects of FrameConstraint"
    ):
        dataclasses.replace(problem, observed=(scso.ActivationRate(),))
