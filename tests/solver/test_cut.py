"""Matrix inequalities of convex frames by cutting planes, against Clarabel frame by frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_problem, highest_eigenvalue, solve_full_frame

import scso_nlp as scso
from scso_nlp.sensitivities.conditions import Conditions
from scso_nlp.solver.cut import cut, sums_and_differences
from scso_nlp.solver.described import program_of
from scso_nlp.solver.local_model import local_model
from scso_nlp.solver.programs import starting_point
from scso_nlp.transcription.describe import describe


def started(problem):
    """What cutting planes find in all frames, and the model of the problem."""
    model = local_model(describe(problem))
    return cut(model, starting_point(model.program, None)), model


@pytest.mark.parametrize("exponent", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("n_coordinates", [1, 2, 4])
def test_frames_that_are_found_are_the_optimum_of_the_matrix_inequality(rng, exponent, n_coordinates):
    problem = hessian_problem(rng, n_coordinates=n_coordinates, n_frames=12, exponent=exponent, reserve=2.0)
    found, model = started(problem)
    assert found.is_found.mean() > 0.5
    matrix = model.matrices[0]
    least = np.linalg.eigvalsh(matrix.value(found.start.unknowns, model.program.arrays))[:, 0]
    assert (least[found.is_found] > -1e-4).all()
    assert np.abs(least[found.is_found]).min() < 1e-4  # some are held
    for k in np.flatnonzero(found.is_found)[:6]:
        _, best, _ = solve_full_frame(problem, k)
        effort = (np.abs(found.start.unknowns[k]) ** exponent).sum()
        assert effort == pytest.approx(best, rel=1e-7)


@pytest.mark.parametrize("exponent", [2.0, 3.0])
@pytest.mark.parametrize("price", [None, 0.01, 1.0])
def test_activations_are_those_to_which_newtons_method_goes_from_there(rng, price, exponent):
    """A turn that is off by little costs the square of that, but moves activations by as much."""
    problem = hessian_problem(rng, n_coordinates=4, n_frames=24, exponent=exponent, reserve=2.0)
    rule = scso.HessianStability(level=0.0 if price is None else 60.0, soft=price)
    problem = dataclasses.replace(problem, constraints=(problem.constraints[0], rule))
    solution = scso.solve_trajectory(problem, on_failure="return")
    conditions = Conditions(program_of(solution), solution)
    found = conditions.point.x.copy()
    conditions.settle()
    far = np.abs(conditions.point.x - found)[conditions.is_regular, :16].max(axis=1)
    assert far.size > 16
    assert np.median(far) < 1e-9
    assert far.max() < 1e-5


def test_turns_are_unit_vectors_that_push_and_frames_above_their_level_have_none(rng):
    problem = hessian_problem(rng, n_frames=10, reserve=2.0)
    found, _ = started(problem)
    turns, weight = found.turns[0], found.multipliers[0]
    length = np.linalg.norm(turns, axis=2)
    np.testing.assert_allclose(length[weight != 0], 1.0, rtol=1e-12)
    assert (length[weight == 0] == 0).all()
    assert (weight <= 0).all()  # the solver's sign of a lower bound
    low = dataclasses.replace(
        problem, constraints=(problem.constraints[0], scso.HessianStability(level=-1e6))
    )
    free, _ = started(low)
    assert free.is_found.all()
    assert free.turns[0].shape[1] == 0
    plain = scso.solve_trajectory(problem.without_stability())
    np.testing.assert_allclose(free.start.unknowns[:, :16], plain.activation, atol=1e-9)


def test_a_level_out_of_reach_is_not_found(rng):
    problem = hessian_problem(rng, n_frames=2, reserve=2.0)
    level = max(highest_eigenvalue(problem, k) for k in range(2)) + 10.0
    problem = dataclasses.replace(
        problem, constraints=(problem.constraints[0], scso.HessianStability(level=level))
    )
    found, _ = started(problem)
    assert not found.is_found.any()


def test_two_matrices_are_held_at_once(rng):
    """A Hessian over all coordinates, and over two of them at a level of its own, as each demands."""
    problem = hessian_problem(rng, n_frames=6, reserve=2.0)
    names = problem.motion.trajectory.coordinates
    second = scso.HessianStability(coordinates=names[:2], level=15.0, label="two")
    both = dataclasses.replace(problem, constraints=(*problem.constraints, second))
    found, model = started(both)
    assert found.is_found.any()
    for matrix in model.matrices:
        least = np.linalg.eigvalsh(matrix.value(found.start.unknowns, model.program.arrays))[:, 0]
        assert (least[found.is_found] > -1e-4).all()
    solution = scso.solve_trajectory(both)
    assert (solution.optimality.worst < 1e-6).all()
    for name, level in (("HessianStability", 0.0), ("two", 15.0)):
        assert (np.linalg.eigvalsh(solution.matrices[name].value)[:, 0] > level - 1e-4).all()


def test_sums_and_differences_pin_every_product():
    rows = sums_and_differences(3)
    products = np.array([np.outer(row, row).ravel() for row in rows])
    assert rows.shape == (9, 3)
    assert np.linalg.matrix_rank(products) == 6
