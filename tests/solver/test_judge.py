"""The gate against wrong answers: what a solver calls solved is held against its own numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import elbow, random_problem

import scso_nlp as scso
from scso_nlp.solution import SolveReport, Status
from scso_nlp.solver.judge import Outcome, judge
from scso_nlp.transcription.describe import describe

REPORT = SolveReport(
    solver="framewise", iterations=0, build_seconds=0.0, solve_seconds=0.0, options={}, versions={}
)


def judged(problem, activation, *, status=Status.SOLVED, control=None, like=None):
    """What becomes of activations that a solver calls solved, with the multipliers of a solution."""
    program = describe(problem)
    parts = {("problem", "activation"): np.atleast_2d(activation)}
    if control is not None:
        parts["problem", "control"] = control
    n = program.time.size
    unknowns = program.layout.join(parts, program.layout.rows("guess", n)) / program.layout.scale
    multipliers = np.zeros((n, len(program.rows))), np.zeros((n - 1, len(program.pair_rows)))
    if like is not None:
        for block, where in program.rows:
            multipliers[0][:, where] = -like.rows[block.term].multiplier * block.scale
    return judge(
        Outcome(program=program, unknowns=unknowns, multipliers=multipliers, status=(status,) * n), REPORT
    )


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        (0.9e-6, Status.SOLVED),
        (1.1e-6, Status.ACCEPTABLE),
        (0.9e-4, Status.ACCEPTABLE),
        (1.1e-4, Status.NUMERICAL_ERROR),
        (1.0, Status.NUMERICAL_ERROR),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_frame_is_called_what_its_rows_say_whatever_the_solver_said(missing, expected, sign):
    """One muscle more or less active changes the moment by 145 N·m per unit; the row's scale is 1 N·m."""
    problem = elbow([60.0])
    exact = scso.solve_framewise(problem, options=scso.SolverOptions(tolerance=1e-12))
    moved = exact.activation + sign * np.array([[missing / 145.0, 0.0, 0.0]])
    solution = judged(problem, moved, like=exact)
    assert solution.frame_status == (expected,)
    assert (
        solution.violation["MomentEquilibrium"] == pytest.approx(missing, rel=1e-3) or not expected.is_solved
    )
    (shortfall, *_) = solution.shortfalls or (None,)
    if expected is Status.NUMERICAL_ERROR:
        assert shortfall.row == "q1"
        assert shortfall.amount == pytest.approx(missing, rel=1e-3)
        assert not shortfall.proven


def test_a_stability_row_is_held_against_its_own_scale(rng):
    """Rows of 10 N·m/rad: a miss of 1.1e-3 is too much, of 0.9e-3 is not."""
    problem = random_problem(rng, n_frames=1)
    solution = scso.solve_framewise(problem, options=scso.SolverOptions(tolerance=1e-12))
    value = solution.rows["JointStability"].value[0]
    for missing, expected in ((0.9e-3, Status.ACCEPTABLE), (1.1e-3, Status.NUMERICAL_ERROR)):
        level = {f"elbow_{axis}": value[i] + (missing if i == 0 else -1.0) for i, axis in enumerate("xyz")}
        harder = dataclasses.replace(problem.constraints[1], level=level)
        asked = dataclasses.replace(problem, constraints=(problem.constraints[0], harder))
        assert judged(asked, solution.activation, like=solution).frame_status == (expected,)


def test_what_the_solver_called_infeasible_is_not_where_all_rows_can_be_kept(rng):
    problem = random_problem(rng, n_frames=1)
    solution = judged(problem, np.full((1, 10), 0.5), status=Status.INFEASIBLE)
    assert solution.frame_status == (Status.NUMERICAL_ERROR,)


# Optimality ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0, 10.0])
@pytest.mark.parametrize("reserve", [None, 5.0])
def test_an_optimum_meets_its_conditions(rng, exponent, reserve):
    problem = random_problem(rng, exponent=exponent, reserve=reserve)
    found = scso.solve_trajectory(problem, options=scso.SolverOptions(tolerance=1e-10)).optimality
    assert found.stationarity.shape == (3,)
    assert found.stationarity.max() < 1e-6
    assert found.complementarity.max() < 1e-6
    assert found.duality_gap.max() < 1e-5


def test_the_duality_gap_bounds_what_a_worse_point_costs_too_much(rng):
    """A feasible point that is not optimal, with the multipliers of the optimum: its cost less the gap is no
    more than the optimum's."""
    problem = random_problem(rng, n_frames=4, reserve=5.0, stability=False)
    best = scso.solve_framewise(problem, options=scso.SolverOptions(tolerance=1e-12))
    other = scso.solve_framewise(
        dataclasses.replace(problem, objectives=(scso.ActivationEffort(weights={"*": 1.0, "m1": 3.0}),))
    )
    unknowns = np.hstack([other.activation, other.control])
    outcome = Outcome(
        program=describe(problem),
        unknowns=unknowns,
        multipliers=(-best.rows["MomentEquilibrium"].multiplier, np.zeros((3, 0))),
        status=(Status.SOLVED,) * 4,
    )
    found = judge(outcome, REPORT)
    cost = [(s.activation**2).sum(axis=1) + (s.control**2).sum(axis=1) for s in (found, best)]
    excess = cost[0] - cost[1]
    assert (excess > 1e-6).any(), "the other point costs nothing: the test shows nothing"
    # relative to sum |x df/dx|; what stationarity lacks may be used by the controls, which have no bounds
    gap = found.optimality.duality_gap * 2 * cost[0]
    left = found.optimality.stationarity * np.abs(2 * unknowns).max(axis=1)
    assert (excess <= gap + left * np.abs(found.control - best.control).sum(axis=1) + 1e-9).all()


def test_coupled_frames_share_the_conditions_of_an_optimum(rng):
    problem = random_problem(rng, n_frames=5, reserve=5.0, stability=False)
    problem = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationRate()))
    solution = scso.solve_trajectory(problem, options=scso.SolverOptions(tolerance=1e-10))
    assert np.nanmax(solution.rows["ActivationRate"].multiplier) > 1e-4, (
        "no rate binds: the test shows nothing"
    )
    assert solution.optimality.stationarity.max() < 1e-6
    assert solution.optimality.complementarity.max() < 1e-6


def test_a_point_that_is_no_optimum_is_seen(rng):
    problem = random_problem(rng, reserve=5.0)
    solution = scso.solve_trajectory(problem)
    worse = judged(problem, solution.activation, control=solution.control)  # without multipliers
    assert worse.optimality.stationarity.min() > 1e-3 or worse.optimality.complementarity.min() > 1e-3


def test_a_frame_that_is_not_at_its_optimum_is_called_so(rng):
    """Between optimum and another point that keeps all rows, with the multipliers of the optimum."""
    problem = random_problem(rng, n_frames=1, reserve=5.0, stability=False)
    best = scso.solve_framewise(problem, options=scso.SolverOptions(tolerance=1e-12))
    weights = {"*": 1.0, "m1": 3.0}
    other = scso.solve_framewise(
        dataclasses.replace(problem, objectives=(scso.ActivationEffort(weights=weights),))
    )
    found = []
    for share in (0.0, 1e-8, 1e-5, 1.0):
        activation, control = (
            getattr(best, name) * (1 - share) + getattr(other, name) * share
            for name in ("activation", "control")
        )
        solution = judged(problem, activation, control=control, like=best)
        found.append((solution.status, float(solution.optimality.worst[0])))
    assert [status for status, _ in found] == [
        Status.SOLVED,
        Status.SOLVED,
        Status.ACCEPTABLE,
        Status.NOT_OPTIMAL,
    ], found


def test_curved_rows_have_no_duality_gap(rng):
    problem = random_problem(
        rng, n_frames=2, muscle_model=scso.CompliantTendon(), stability=False, reserve=50.0
    )
    path = problem.motion.trajectory.muscle_tendon_length.mean(axis=0)
    muscles = dataclasses.replace(
        problem.motion.muscles, tendon_slack_length=0.6 * path, optimal_fiber_length=0.4 * path
    )
    problem = dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, muscles=muscles))
    found = scso.solve_trajectory(problem, options=scso.SolverOptions(tolerance=1e-10)).optimality
    assert np.isnan(found.duality_gap).all()
    assert found.stationarity.max() < 1e-5
