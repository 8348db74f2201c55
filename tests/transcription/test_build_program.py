"""A problem as one program that any solver can take."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem
from helpers import random_problem

import scso_nlp as scso
from scso_nlp import HessianStability


def solve(program, plugin, options):
    """The optimum of a program by a solver of CasADi's, in the unknowns' own units."""
    solver = ca.nlpsol(
        "solver", plugin, {"x": program.x, "p": program.p, "f": program.f, "g": program.g}, options
    )
    answer = solver(
        x0=program.initial_guess,
        p=program.parameters,
        lbx=program.lower,
        ubx=program.upper,
        lbg=program.row_lower,
        ubg=program.row_upper,
    )
    assert solver.stats()["success"]
    return np.asarray(answer["x"]).ravel() * program.scale


@pytest.mark.parametrize("coupled", [False, True])
def test_another_solver_finds_the_same_optimum(rng, coupled):
    problem = random_problem(rng, n_frames=3, reserve=5.0)
    if coupled:
        constraints = (*problem.constraints, scso.ActivationRate())
        problem = scso.MuscleForceProblem(
            motion=problem.motion,
            muscle_model=problem.muscle_model,
            objectives=problem.objectives,
            constraints=constraints,
        )
    program = scso.build_program(problem)
    quiet = {"print_time": False, "print_header": False, "print_iteration": False, "print_status": False}
    found = solve(
        program,
        "sqpmethod",
        {**quiet, "qpsol": "daqp", "qpsol_options": {"print_time": False}, "tol_du": 1e-9, "tol_pr": 1e-9},
    )
    expected = scso.solve_trajectory(problem, options=scso.SolverOptions(tolerance=1e-10))
    unknowns = np.hstack([expected.activation, expected.control]).ravel()
    np.testing.assert_allclose(found, unknowns, atol=1e-6)


def test_every_unknown_and_row_has_a_name(rng):
    problem = random_problem(rng, n_frames=2, reserve=5.0)
    program = scso.build_program(problem)
    assert len(program.unknown_names) == program.x.numel() == 2 * 13
    assert len(program.row_names) == program.g.numel() == 2 * 6
    assert program.unknown_names[:2] == ("m1 at frame 0", "m2 at frame 0")
    assert program.row_names[0] == "MomentEquilibrium[q1] at frame 0"
    assert program.row_names[-1] == "JointStability[elbow_z] at frame 1"


def test_a_row_of_two_frames_stands_at_the_later_one(rng):
    problem = random_problem(rng, n_frames=2, stability=False)
    rate = scso.ActivationRate(bounds="constant")
    problem = scso.MuscleForceProblem(
        motion=problem.motion,
        muscle_model=problem.muscle_model,
        objectives=problem.objectives,
        constraints=(rate,),
    )
    assert scso.build_program(problem).row_names[0] == "ActivationRate[m1] at frame 1"


def test_its_print_shows_sizes_and_blocks(rng):
    """Parameters of a frame: 33 entries of moment equilibrium, 30 of stability, a weight of its own and 13 of
    muscles and reserves."""
    problem = random_problem(rng, n_frames=2, reserve=5.0)
    text = str(scso.build_program(problem)).splitlines()
    assert text[0] == "26 unknowns, 12 rows (6 equations), 154 parameters"
    assert text[1].split() == ["MomentEquilibrium", "6", "rows,", "affine,", "of", "one", "frame"]
    assert text[2].split() == ["JointStability", "6", "rows,", "affine,", "of", "one", "frame"]


def test_a_matrix_inequality_is_there_as_its_directions_alone(rng):
    problem = hessian_problem(rng, n_frames=2, stability=HessianStability(soft=0.1))
    program = scso.build_program(problem)
    names = [name for name in program.row_names if name.startswith("HessianStability")]
    assert names[:2] == ["HessianStability[turn_1] at frame 0", "HessianStability[turn_2] at frame 0"]
    assert len(names) == 2 * 4
    rows = ca.Function("g", [program.x, program.p], [program.g])(program.initial_guess, program.parameters)
    force = 0.1 * problem.motion.muscles.max_isometric_force
    for k in range(2):
        stiffness = 5.0 * force / problem.motion.trajectory.muscle_tendon_length[k]
        expected = np.diag(hessian_by_hand(problem, k, force, stiffness)) / 10.0 + 1.0
        at = [
            i for i, name in enumerate(program.row_names) if name.endswith(f"at frame {k}") and "turn" in name
        ]
        constant = program.row_lower[at]
        found = np.asarray(rows).ravel()[at]
        np.testing.assert_allclose(found - constant, expected, atol=1e-9)
