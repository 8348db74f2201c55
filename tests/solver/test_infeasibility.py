"""INFEASIBLE is proven: its multipliers are multiplied out here, with the problem's own arrays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem, solve_full_frame
from coupled_terms import RateLimit
from helpers import elbow, frame_arrays, motion, muscle_parameters, random_problem, two_antagonists

import scso_nlp as scso
from scso_nlp import Status

SOLVERS = (scso.solve_trajectory, scso.solve_framewise)
both_solvers = pytest.mark.parametrize("solve", SOLVERS)


def one_muscle_for_two(asked, *, factor=1.0):
    """Both coordinates by the same arm, a second muscle for the second one: at most 10 N·m apart."""
    arms = [[[0.05, 0.0], [0.05, 0.01]]]
    trajectory = motion(arms, factor * np.array([[10.0, asked]]))
    muscles = muscle_parameters(trajectory.muscles, 1000.0 * factor)
    return scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscles),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(),),
    )


def moved(problem, moments):
    """The same problem with other moments."""
    trajectory = dataclasses.replace(problem.motion.trajectory, generalized_forces=moments)
    return dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=trajectory))


def contradicts(problem, k, proof):
    """Farkas' test of one frame with moment equilibrium and joint stability, by the problem's own arrays."""
    _, a, b, g, h, lower, upper = frame_arrays(problem, k)
    coordinates = problem.motion.trajectory.coordinates
    pull, asked = np.zeros(a.shape[1]), 0.0
    for name, row, y in zip(proof.constraints, proof.rows, proof.multipliers, strict=True):
        if name == "MomentEquilibrium":
            i = coordinates.index(row)
            pull, asked = pull + y * a[i], asked + y * b[i]
        else:
            assert y > 0, "a lower level is not exceeded from above"
            i = [f"elbow_{axis}" for axis in problem.constraints[1].axes or "xyz"].index(row)
            pull, asked = pull + y * g[i], asked + y * h[i]
    pull[np.abs(pull) < 1e-12 * np.abs(proof.multipliers).max() * np.abs(a).max()] = 0.0
    at = np.where(pull > 0, upper, np.where(pull < 0, lower, 0.0))
    return asked - pull @ at > 1e-9 * abs(asked)


@both_solvers
def test_rows_that_exclude_each_other_are_named_with_multipliers_that_prove_it(solve):
    problem = one_muscle_for_two(22.0)
    with pytest.raises(scso.SolveFailed) as failure:
        solve(problem)
    solution = failure.value.solution
    assert solution.status is Status.INFEASIBLE
    (proof,) = solution.infeasibility
    assert proof.holds
    assert set(proof.rows) == {"q1", "q2"}
    # y2 (50 a1 + 10 a2) - y1 50 a1 is at most 10 y2 for y1 = y2, and 12 are asked for
    assert proof.multipliers[0] == pytest.approx(-proof.multipliers[1], rel=1e-9)
    assert contradicts(problem, 0, proof)
    # 2 N·m of twice 50 + 10 + 22 N·m, the larger row of the term
    assert proof.margin == pytest.approx(2.0 / (2 * 82.0), rel=1e-9)
    *_, proven, advice = str(failure.value).splitlines()
    assert proven.startswith("  these rows cannot hold together at t = 0 s: MomentEquilibrium[q")
    assert advice.startswith(
        "  try actuators = RESERVES.xml: muscles and actuators cannot make the moments of q2"
    )


@both_solvers
def test_a_row_that_no_activation_reaches_is_its_own_proof(solve):
    solution = solve(elbow([60.0, 300.0]), on_failure="return")
    (proof,) = solution.infeasibility
    assert (proof.frame, proof.rows, proof.unknowns) == (1, ("q1",), ("m1", "m2", "m3"))
    assert proof.margin == pytest.approx(75.0 / 525.0)
    assert str(proof) == "this row cannot be kept at t = 0.01 s: MomentEquilibrium[q1]"


@both_solvers
def test_stability_and_equilibrium_that_exclude_each_other_are_proven_by_both(solve):
    problem = two_antagonists(95.0, level=80.0)
    (proof,) = solve(problem, on_failure="return").infeasibility
    assert set(proof.constraints) == {"MomentEquilibrium", "JointStability"}
    assert contradicts(problem, 0, proof)


def test_nothing_is_proven_of_what_can_be_kept(rng):
    assert scso.solve_trajectory(one_muscle_for_two(20.0)).infeasibility == ()
    assert scso.solve_trajectory(random_problem(rng)).infeasibility == ()


def test_multipliers_that_are_tampered_with_prove_nothing():
    (proof,) = scso.solve_trajectory(one_muscle_for_two(22.0), on_failure="return").infeasibility
    assert not dataclasses.replace(proof, multipliers=-proof.multipliers).holds
    assert not dataclasses.replace(proof, multipliers=np.abs(proof.multipliers)).holds
    assert not dataclasses.replace(proof, multipliers=0 * proof.multipliers).holds
    assert not dataclasses.replace(proof, upper=np.array([1.0, 1.3])).holds
    assert not dataclasses.replace(proof, upper=np.full(2, np.inf)).holds


@pytest.mark.parametrize("factor", [1e-9, 1.0, 1e9])
def test_units_of_force_do_not_change_what_is_infeasible(factor):
    for asked, expected in ((20.0, Status.SOLVED), (20.001, Status.INFEASIBLE)):
        solution = scso.solve_trajectory(one_muscle_for_two(asked, factor=factor), on_failure="return")
        assert solution.status is expected
    (proof,) = solution.infeasibility
    assert proof.margin == pytest.approx(0.001 / (2 * 80.001), rel=1e-5)


def test_equations_that_differ_by_rounding_are_not_infeasible(rng):
    """The last row is a sum of the others up to the last digits, whatever the unit."""
    problem = random_problem(rng, stability=False)
    for factor in (1e-9, 1.0, 1e9):
        trajectory = problem.motion.trajectory
        noise = 1 + 4e-16 * rng.integers(-8, 9, 3)
        changed = {}
        for name in ("moment_arms", "generalized_forces"):
            array = getattr(trajectory, name).copy()
            array[:, -1] = array[:, 0] - 2 * array[:, 1]
            changed[name] = array
        changed["generalized_forces"] = factor * changed["generalized_forces"]
        changed["generalized_forces"][:, -1] *= noise
        muscles = dataclasses.replace(
            problem.motion.muscles, max_isometric_force=factor * problem.motion.muscles.max_isometric_force
        )
        noisy = dataclasses.replace(
            problem,
            motion=scso.Motion(trajectory=dataclasses.replace(trajectory, **changed), muscles=muscles),
        )
        assert scso.solve_trajectory(noisy).status is Status.SOLVED


@pytest.mark.parametrize("reserve", [None, 20.0])
def test_random_contradictions_are_proven_from_the_problems_own_arrays(rng, reserve):
    """Levels a little above the best that equilibrium leaves; unbounded reserves must drop out of a proof."""
    proven = 0
    for _ in range(10):
        problem = random_problem(rng, n_frames=2, n_coordinates=2, reserve=reserve)
        best = scso.reachable_stability(problem)[0].highest
        level = {f"elbow_{axis}": float(best[:, i].min()) for i, axis in enumerate("xyz")}
        harder = dataclasses.replace(problem.constraints[1], level=level)
        asked = dataclasses.replace(problem, constraints=(problem.constraints[0], harder))
        solution = scso.solve_trajectory(asked, on_failure="return")
        for proof in solution.infeasibility:
            assert solution.frame_status[proof.frame] is Status.INFEASIBLE
            assert contradicts(asked, proof.frame, proof)
            proven += 1
        assert solution.frame_status.count(Status.INFEASIBLE) == len(solution.infeasibility)
    assert proven > 10


def test_a_rate_too_slow_for_the_motion_is_proven_by_rows_of_both_frames():
    """From 60 to 200 N·m takes 140/225 of full activation at least; 50 per second allow half of it."""
    problem = elbow([60.0, 200.0])
    slow = dataclasses.replace(problem, constraints=(*problem.constraints, RateLimit(fastest=50.0)))
    solution = scso.solve_trajectory(slow, on_failure="return")
    assert set(solution.frame_status) == {Status.INFEASIBLE}
    (proof,) = solution.infeasibility
    assert set(zip(proof.constraints, proof.frames, strict=True)) == {
        ("MomentEquilibrium", 0), ("MomentEquilibrium", 1), ("RateLimit", 1)
    }  # fmt: skip
    assert "m1 at frame 0" in proof.unknowns
    # 200 - 60 N·m less what half of full activation gives, 112.5 N·m: each N·m weighs the same
    y = proof.multipliers / proof.multipliers[list(proof.constraints).index("MomentEquilibrium")]
    scaled = np.where(proof.multipliers > 0, proof.row_lower, proof.row_upper) @ y
    assert abs(scaled) == pytest.approx(140.0 - 112.5, rel=1e-6)


@both_solvers
def test_a_hessian_out_of_reach_is_proven_by_a_positive_semidefinite_multiplier(rng, solve):
    """y'b + tr(Z K) against the most that activations within bounds can give, from the formula of H."""
    problem = hessian_problem(rng, n_frames=3)
    highest = scso.reachable_stability(problem)[0].highest[:, 0]
    level = float(np.median(highest)) + 0.5
    stability = dataclasses.replace(problem.constraints[1], level=level)
    asked = dataclasses.replace(problem, constraints=(problem.constraints[0], stability))
    solution = solve(asked, on_failure="return")
    assert {proof.frame for proof in solution.infeasibility} == set(np.flatnonzero(highest < level))
    trajectory, muscles = asked.motion.trajectory, asked.motion.muscles
    for k, status in enumerate(solution.frame_status):
        assert (solve_full_frame(asked, k, level=level) is None) == (status is Status.INFEASIBLE)
    for proof in solution.infeasibility:
        k, n = proof.frame, len(trajectory.coordinates)
        dual, y = np.zeros((n, n)), np.zeros(n)
        for name, row, turn, weight in zip(
            proof.constraints, proof.rows, proof.turns, proof.multipliers, strict=True
        ):
            if name == "HessianStability":
                assert weight > 0
                dual += weight * np.outer(turn, turn)
            else:
                y[trajectory.coordinates.index(row)] = weight
        nothing = np.zeros(muscles.n_muscles)
        constant = hessian_by_hand(asked, k, nothing, nothing)
        pull = np.zeros(muscles.n_muscles)
        for m in range(muscles.n_muscles):
            force = nothing.copy()
            force[m] = muscles.max_isometric_force[m]
            hessian = hessian_by_hand(asked, k, force, 5.0 * force / trajectory.muscle_tendon_length[k])
            pull[m] = np.sum(dual * (hessian - constant))
        pull += y @ (trajectory.moment_arms[k] * muscles.max_isometric_force)
        asked_for = y @ trajectory.generalized_forces[k] - np.sum(dual * (constant - level * np.eye(n)))
        # activations are between 0 and 1
        assert asked_for - np.maximum(pull, 0).sum() > 0


def test_a_proof_stands_in_the_report_in_words_and_numbers(tmp_path):
    import json

    solution = scso.solve_trajectory(one_muscle_for_two(22.0), on_failure="return")
    scso.write_solution(solution, tmp_path, figures=False)
    (written,) = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["infeasibility"]
    (proof,) = solution.infeasibility
    assert written["text"] == str(proof)
    assert [entry["row"] for entry in written["rows"]] == list(proof.rows)
    assert [entry["multiplier"] for entry in written["rows"]] == proof.multipliers.tolist()
    assert written["margin"] == proof.margin
