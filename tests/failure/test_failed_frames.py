"""Frames without an answer: which status, which words, and nothing that looks like a result."""

from __future__ import annotations

import dataclasses
import math
import re

import casadi as ca
import numpy as np
import pytest
from coupled_terms import CappedEffort, RateLimit, Smoothness
from helpers import (
    elbow,
    motion,
    muscle_parameters,
    random_problem,
    two_antagonists,
    with_motion,
    with_trajectory,
)

import scso_nlp as scso
from scso_nlp import Status

SOLVERS = (scso.solve_trajectory, scso.solve_framewise)
both_solvers = pytest.mark.parametrize("solve", SOLVERS)


def problem_of(arms, moments, *, strength=1000.0, objectives=None, **changes):
    trajectory = motion(arms, moments)
    return scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscle_parameters(trajectory.muscles, strength)),
        muscle_model=scso.NoPhysiology(),
        objectives=objectives or (scso.ActivationEffort(),),
        **changes,
    )


def with_columns(problem, columns, **bounds):
    """The problem with actuators of the given columns (n_frames, n_coordinates, n_actuators)."""
    columns = np.asarray(columns, dtype=float)
    names = tuple(f"reserve{i + 1}" for i in range(columns.shape[2]))
    actuators = scso.ActuatorParameters(
        actuators=names,
        optimal_force=np.ones(len(names)),
        min_control=np.full(len(names), bounds.get("lower", -np.inf)),
        max_control=np.full(len(names), bounds.get("upper", np.inf)),
    )
    trajectory = dataclasses.replace(
        problem.motion.trajectory, actuators=names, actuator_generalized_forces=columns
    )
    return with_motion(problem, trajectory=trajectory, actuators=actuators)


@both_solvers
def test_a_moment_out_of_reach_is_named_with_time_amount_and_helpers(solve):
    # Full activation of all three muscles gives 145 + 60 + 20 = 225 N·m.
    problem = elbow([60.0, 300.0, 60.0])
    with pytest.raises(scso.SolveFailed) as failure:
        solve(problem)
    assert str(failure.value).splitlines()[0] == (
        "1 of 3 frames failed (infeasible): t = 0.01 s; worst: MomentEquilibrium[q1] short by 75 N·m at "
        "t = 0.01 s (beyond reach at any activation); would help if they were stronger: m1, m2, m3"
    )


@both_solvers
def test_the_failure_carries_the_other_frames_and_no_number_for_the_failed_one(solve):
    with pytest.raises(scso.SolveFailed) as failure:
        solve(elbow([60.0, 300.0, 60.0]))
    solution = failure.value.solution
    assert solution.frame_status == (Status.SOLVED, Status.INFEASIBLE, Status.SOLVED)
    assert solution.status is Status.INFEASIBLE
    np.testing.assert_allclose(solution.activation[[0, 2], 0], 0.347652, atol=1e-6)
    for array in (solution.activation, solution.tendon_force, solution.rows["MomentEquilibrium"].value):
        assert np.isnan(array[1]).all()
    # The closed form at p = 2 costs M² / sum c² in each solved frame; the failed one has no share.
    cost = 60.0**2 / (145.0**2 + 60.0**2 + 20.0**2)
    assert solution.objective == pytest.approx(2 * cost, rel=1e-6)
    assert max(solution.violation.values()) < 1e-6


@both_solvers
def test_returning_instead_of_raising_gives_the_same_solution(solve):
    solution = solve(elbow([60.0, 300.0]), on_failure="return")
    assert solution.is_solved.tolist() == [True, False]
    assert solution.summary().startswith("1 of 2 frames failed (infeasible): t = 0.01 s")


@both_solvers
def test_a_stability_level_out_of_reach_is_named_with_what_is_missing(solve):
    # Each muscle gives at most GS·F, GS = 0.05 m per newton: (5 - 1)·0.05²/0.2, two muscles of 2000 N.
    most = 2 * 2000.0 * 0.05 - 30.0
    problem = two_antagonists(5.0, level=most + 10.0)
    solution = solve(problem, on_failure="return")
    (shortfall,) = solution.shortfalls
    assert (shortfall.constraint, shortfall.row, shortfall.unit) == ("JointStability", "elbow_z", "N·m/rad")
    assert shortfall.amount == pytest.approx(10.0, abs=1e-6)
    assert shortfall.proven
    assert set(shortfall.helpers) == {"m1", "m2"}
    assert "; would help if they were stronger or stiffer (larger q): m" in str(shortfall)


@both_solvers
def test_rows_that_are_reachable_alone_but_not_together_are_proven_infeasible(solve):
    # One muscle pulls both coordinates by the same arm: 10 and 20 N·m cannot both be had.
    problem = problem_of([[[0.05, 0.0], [0.05, 0.01]]] * 2, [[10.0, 20.0], [10.0, 11.0]])
    solution = solve(problem, on_failure="return")
    # The second muscle adds up to 10 N·m to the second coordinate: exactly enough in frame 0.
    assert solution.is_solved.all()
    problem = problem_of([[[0.05, 0.0], [0.05, 0.01]]] * 2, [[10.0, 22.0], [10.0, 11.0]])
    solution = solve(problem, on_failure="return")
    assert solution.frame_status == (Status.INFEASIBLE, Status.SOLVED)
    # The least total violation is 2 N·m, whichever of the two coordinates is given up.
    assert sum(s.amount for s in solution.shortfalls) == pytest.approx(2.0, abs=1e-6)
    assert all(s.proven and s.frame == 0 and s.constraint == "MomentEquilibrium" for s in solution.shortfalls)


@both_solvers
def test_stability_and_equilibrium_that_exclude_each_other_are_proven_infeasible(solve):
    # F1 - F2 = 95/0.05 N leaves F1 + F2 <= 2100 N: stability at most 0.05 · 2100 - 30 = 75 N·m/rad.
    solution = solve(two_antagonists(95.0, level=80.0), on_failure="return")
    assert solution.status is Status.INFEASIBLE
    (shortfall,) = solution.shortfalls
    assert shortfall.constraint == "JointStability"
    assert shortfall.amount == pytest.approx(5.0, abs=1e-6)
    assert shortfall.proven
    assert solve(two_antagonists(95.0, level=74.9)).status is Status.SOLVED


@both_solvers
def test_every_frame_infeasible_leaves_no_number_at_all(solve):
    solution = solve(elbow([300.0, -10.0]), on_failure="return")
    assert solution.frame_status == (Status.INFEASIBLE,) * 2
    assert np.isnan(solution.activation).all()
    assert solution.objective == 0.0
    assert all(math.isnan(value) for value in solution.violation.values())


@both_solvers
def test_bounded_reserves_that_are_too_weak_are_infeasible_and_named_as_helpers(solve):
    problem = with_columns(elbow([300.0]), [[[50.0]]], lower=-1.0, upper=1.0)
    solution = solve(problem, on_failure="return")
    (shortfall,) = solution.shortfalls
    assert shortfall.amount == pytest.approx(25.0, abs=1e-9)
    assert "reserve1" in shortfall.helpers


@both_solvers
def test_an_unbounded_reserve_without_leverage_in_a_frame_is_no_help_there(solve):
    """Zero times infinity: the reserve's column is zero in the second frame."""
    problem = with_columns(elbow([300.0, 300.0, 60.0]), [[[1.0]], [[0.0]], [[0.0]]])
    solution = solve(problem, on_failure="return")
    assert solution.is_solved.tolist() == [True, False, True]
    assert solution.shortfalls[0].amount == pytest.approx(75.0, abs=1e-9)


@both_solvers
def test_a_coordinate_that_nothing_moves_is_fine_without_a_moment_and_infeasible_with_one(solve):
    arms = [[[0.05, 0.03], [0.0, 0.0]]] * 2
    solution = solve(problem_of(arms, [[5.0, 0.0], [5.0, 3.0]]), on_failure="return")
    assert solution.frame_status == (Status.SOLVED, Status.INFEASIBLE)
    assert str(solution.shortfalls[0]) == (
        "MomentEquilibrium[q2] short by 3 N·m at t = 0.01 s (beyond reach at any activation)"
    )
    # Pseudo-inverse of one row of (50, 30) N·m.
    np.testing.assert_allclose(solution.activation[0], np.array([50.0, 30.0]) * 5 / 3400, atol=1e-6)


@both_solvers
def test_the_iteration_limit_is_a_status_and_keeps_the_last_iterate(solve):
    options = scso.SolverOptions(max_iterations=2, presolve=False)
    with pytest.raises(scso.SolveFailed, match=r"2 of 2 frames failed \(iteration limit\): t = 0, 0.01 s"):
        solve(elbow([60.0, 200.0], exponent=3.0), options=options)
    solution = solve(elbow([60.0, 200.0], exponent=3.0), options=options, on_failure="return")
    assert solution.status is Status.ITERATION_LIMIT
    assert np.isfinite(solution.activation).all()
    assert solution.objective == 0.0, "an unfinished frame must not look like a result"
    assert "raise max_iterations" in Status.ITERATION_LIMIT.value


@both_solvers
def test_a_looser_tolerance_than_asked_for_is_acceptable_and_says_so(solve):
    options = scso.SolverOptions(
        tolerance=1e-14,
        presolve=False,
        ipopt={"acceptable_tol": 1e-4, "acceptable_iter": 1, "acceptable_obj_change_tol": 1e20},
    )
    solution = solve(elbow([60.0], exponent=3.0), options=options)
    assert solution.status is Status.ACCEPTABLE
    assert "check the violations" in Status.ACCEPTABLE.value


@both_solvers
def test_a_cost_that_is_not_a_number_in_one_frame_fails_that_frame_alone(solve, capfd):
    def root_of_moment(frame):
        return ca.sumsqr(frame.activation) + ca.sqrt(frame.generalized_forces[0])

    problem = problem_of([[[0.05, -0.03]]] * 3, [[5.0], [-0.1], [6.0]], objectives=(root_of_moment,))
    solution = solve(problem, on_failure="return")
    assert solution.frame_status == (Status.SOLVED, Status.NUMERICAL_ERROR, Status.SOLVED)
    assert math.isfinite(solution.objective)
    assert "check the objective for NaN" in Status.NUMERICAL_ERROR.value
    # The solver's own warnings are for the log at DEBUG, not for the user's terminal.
    assert capfd.readouterr() == ("", "")


@both_solvers
def test_a_cost_that_is_never_a_number_fails_every_frame(solve):
    problem = problem_of(
        [[[0.05, 0.03]]] * 2, [[5.0], [6.0]], objectives=(lambda f: ca.log(-f.activation[0]),)
    )
    with pytest.raises(scso.SolveFailed, match=r"2 of 2 frames failed \(numerical error\)"):
        solve(problem)


def test_a_limit_that_only_curved_rows_break_is_reported_without_proof():
    # The equilibrium alone needs at least 60²/(145² + 60² + 20²) = 0.1438 of squared activation.
    problem = elbow([60.0])
    capped = dataclasses.replace(problem, constraints=(*problem.constraints, CappedEffort(most=0.1)))
    for solve in SOLVERS:
        solution = solve(capped, on_failure="return")
        assert solution.status is Status.LOCALLY_INFEASIBLE
        assert solution.infeasibility == ()
        assert not any(s.proven for s in solution.shortfalls)
        assert {s.constraint for s in solution.shortfalls} <= {"CappedEffort", "MomentEquilibrium"}


def test_a_coupled_motion_fails_as_a_whole_and_names_the_frame_at_fault():
    problem = elbow([60.0, 300.0, 60.0])
    coupled = dataclasses.replace(problem, objectives=(*problem.objectives, Smoothness()))
    solution = scso.solve_trajectory(coupled, on_failure="return")
    assert solution.frame_status == (Status.INFEASIBLE,) * 3
    assert np.isnan(solution.activation).all()
    assert {s.frame for s in solution.shortfalls} == {1}


def test_a_rate_that_is_too_slow_for_the_motion_is_infeasible():
    problem = elbow([60.0, 200.0])
    # From 60 to 200 N·m within 0.01 s takes 140/225 of full activation at least, 62 per second.
    slow = dataclasses.replace(problem, constraints=(*problem.constraints, RateLimit(fastest=50.0)))
    assert scso.solve_trajectory(slow, on_failure="return").status is Status.INFEASIBLE
    fast = dataclasses.replace(problem, constraints=(*problem.constraints, RateLimit(fastest=70.0)))
    assert scso.solve_trajectory(fast).status is Status.SOLVED


def test_the_worst_row_stands_first_whichever_way_it_was_found():
    """Frame 1 is short by 40 N·m alone, frame 0 by 400 N·m only when both rows are taken together."""
    arms = [[[0.05, 0.0], [0.05, 0.01]]] * 2
    problem = problem_of(arms, [[0.0, 600.0], [540.0, 540.0]], strength=[10000.0, 20000.0])
    solution = scso.solve_trajectory(problem, on_failure="return")
    assert solution.frame_status == (Status.INFEASIBLE,) * 2
    assert solution.shortfalls[0].frame == 0
    assert solution.shortfalls[0].amount == pytest.approx(400.0, abs=1e-3)


def test_the_message_of_many_failed_frames_names_five_times_and_every_row_once():
    problem = problem_of([[[0.05, 0.0], [0.0, 0.01]]] * 8, [[200.0, 30.0]] * 8)
    with pytest.raises(scso.SolveFailed) as failure:
        scso.solve_framewise(problem)
    lines = str(failure.value).splitlines()
    assert len(lines) == 3
    assert "8 of 8 frames failed (infeasible): t = 0, 0.01, 0.02, 0.03, 0.04, … s" in lines[0]
    assert "worst: MomentEquilibrium[q1] short by 150 N·m at t = 0" in lines[0]
    assert lines[1].startswith("  in 8 frames, at worst: MomentEquilibrium[q2] short by 20 N·m at t = ")
    assert lines[2].startswith("  try actuators = RESERVES.xml: ")


@pytest.mark.parametrize("status", list(Status))
def test_every_status_is_a_sentence(status):
    assert re.fullmatch(r"[A-Z].*\.", status.value)
    assert status.is_solved == (status in (Status.SOLVED, Status.STABILITY_MISSED, Status.ACCEPTABLE))


def test_random_infeasible_frames_are_told_from_feasible_ones_as_a_linear_program_does(rng):
    """Moments scaled up until some frames cannot be held: HiGHS on plain arrays is the judge."""
    from helpers import solve_lp_frame

    found = []
    for _ in range(6):
        problem = random_problem(rng, n_frames=4, n_muscles=6, n_coordinates=2)
        moments = problem.motion.trajectory.generalized_forces * rng.uniform(0.5, 3.0, (4, 1))
        problem = with_trajectory(problem, generalized_forces=moments)
        expected = []
        for k in range(4):
            try:
                solve_lp_frame(problem, k, 1.0)
                expected.append(Status.SOLVED)
            except AssertionError:
                expected.append(Status.INFEASIBLE)
        found += expected
        for solve in SOLVERS:
            assert solve(problem, on_failure="return").frame_status == tuple(expected)
    assert {Status.SOLVED, Status.INFEASIBLE} == set(found)
