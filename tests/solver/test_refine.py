"""The conic solver that chooses rows, against Clarabel on random programs; and the turns it finds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_problem, solve_conic

from scso_nlp.solver.conic import MatrixProgram, solve_matrix_programs
from scso_nlp.solver.local_model import local_model
from scso_nlp.solver.refine import critical_turns
from scso_nlp.transcription.describe import describe

#: Both solvers stop at about 1e-10 of a unit problem; an unknown of a degenerate frame is known to about
#: the square root of that.
TOLERANCE_OF_X, TOLERANCE_OF_COST = 1e-4, 1e-8


def random_program(rng, n_frames=3, n=8, size=4, n_equations=2, n_rows=0, upper=1.0, pull=1.0):
    """Random frames that x = 0.4 solves; the inequality binds because x = 0 breaks it by `pull`."""
    matrices = rng.normal(size=(n_frames, n, size, size))
    matrices = matrices + matrices.transpose(0, 1, 3, 2)
    inside = rng.uniform(0.2, 0.6, (n_frames, n))
    shift = np.einsum("kiab,ki->kab", matrices, inside)
    margin = rng.uniform(0.0, 0.3, (n_frames, size))
    margin[:, : max(1, round(pull))] = 0.0
    basis = np.linalg.qr(rng.normal(size=(n_frames, size, size)))[0]
    constant = (basis * margin[:, None, :]) @ basis.transpose(0, 2, 1) - shift
    equations = rng.normal(size=(n_frames, n_equations, n))
    rows = rng.normal(size=(n_frames, n_rows, n))
    return MatrixProgram(
        quadratic=np.broadcast_to(2 * np.eye(n), (n_frames, n, n)),
        linear=np.zeros((n_frames, n)),
        equations=equations,
        targets=np.einsum("kei,ki->ke", equations, inside),
        rows=rows,
        least=np.einsum("kri,ki->kr", rows, inside) - 0.01,
        lower=np.zeros((n_frames, n)),
        upper=np.full((n_frames, n), upper),
        matrices=matrices,
        constant=(constant + constant.transpose(0, 2, 1)) / 2,
    )


def oracle(program, k, exponent=2.0):
    return solve_conic(
        exponent,
        program.linear.shape[1],
        program.linear[k],
        (program.equations[k], program.targets[k]),
        (program.lower[k], program.upper[k]),
        (program.matrices[k], program.constant[k]),
    )


def matrix_at(program, x):
    return program.constant + np.einsum("kiab,ki->kab", program.matrices, x)


@pytest.mark.parametrize("upper", [1.0, np.inf])
@pytest.mark.parametrize("n_equations", [0, 1, 3])
@pytest.mark.parametrize("size", [1, 2, 4, 6])
def test_every_frame_has_the_optimum_of_clarabel(rng, size, n_equations, upper):
    program = random_program(rng, n_frames=4, n=10, size=size, n_equations=n_equations, upper=upper)
    answer = solve_matrix_programs(program)
    assert answer.is_solved.all()
    for k in range(4):
        x, cost = oracle(program, k)
        assert np.sum(answer.x[k] ** 2) == pytest.approx(cost, rel=TOLERANCE_OF_COST, abs=TOLERANCE_OF_COST)
        np.testing.assert_allclose(answer.x[k], x, atol=TOLERANCE_OF_X)
    assert np.linalg.eigvalsh(matrix_at(program, answer.x)).min() > -1e-8


def test_unknowns_without_bounds_and_with_one_bound_are_met(rng):
    program = random_program(rng, n=9)
    lower, upper = program.lower.copy(), program.upper.copy()
    lower[:, :3], upper[:, :6] = -np.inf, np.inf
    lower[:, 6:8] = -np.inf
    program = dataclasses.replace(program, lower=lower, upper=upper)
    answer = solve_matrix_programs(program)
    assert answer.is_solved.all()
    for k in range(3):
        np.testing.assert_allclose(answer.x[k], oracle(program, k)[0], atol=TOLERANCE_OF_X)


@pytest.mark.parametrize("nullity", [1, 2, 3])
def test_the_multiplier_spans_the_null_space_of_the_matrix(nullity):
    """Of random frames some have one, two or three turns that decide; the multiplier has no others."""
    rng = np.random.default_rng(nullity)
    seen = 0
    for _ in range(10):
        program = random_program(rng, n_frames=8, n=10, size=5, n_equations=1, pull=nullity)
        answer = solve_matrix_programs(program)
        assert answer.is_solved.all()
        values = np.linalg.eigvalsh(answer.multiplier)
        rank = (values > 1e-5 * values[:, -1:]).sum(axis=1)
        matrix = matrix_at(program, answer.x)
        # complementarity: the product of matrix and multiplier vanishes
        np.testing.assert_allclose(matrix @ answer.multiplier, 0.0, atol=1e-4)
        seen += int((rank == nullity).sum())
    assert seen > 0


@pytest.mark.parametrize("pull", [1, 2, 3])
def test_rows_of_the_critical_turns_alone_have_the_same_optimum(rng, pull):
    """The point of it all: finitely many linear rows replace the matrix inequality."""
    program = random_program(rng, n_frames=5, n=10, size=5, n_equations=1, pull=pull)
    answer = solve_matrix_programs(program)
    turns = critical_turns(answer.multiplier)
    rows = np.einsum("kta,kiab,ktb->kti", turns, program.matrices, turns)
    least = -np.einsum("kta,kab,ktb->kt", turns, program.constant, turns)
    absent = (turns == 0).all(axis=2)
    linear = dataclasses.replace(
        program,
        rows=rows,
        least=np.where(absent, -np.inf, least),
        matrices=np.zeros_like(program.matrices[:, :, :1, :1]),
        constant=np.ones((5, 1, 1)),
    )
    by_rows = solve_matrix_programs(linear)
    assert by_rows.is_solved.all()
    np.testing.assert_allclose(
        np.sum(by_rows.x**2, axis=1), np.sum(answer.x**2, axis=1), rtol=1e-6, atol=1e-8
    )
    assert np.linalg.eigvalsh(matrix_at(program, by_rows.x)).min() > -1e-4


def test_linear_rows_equal_a_matrix_inequality_of_size_one(rng):
    program = random_program(rng, size=1, n_equations=1)
    as_row = dataclasses.replace(
        program,
        rows=program.matrices[:, :, 0, 0][:, None],
        least=-program.constant[:, :, 0],
        matrices=np.zeros_like(program.matrices),
        constant=np.ones_like(program.constant),
    )
    np.testing.assert_allclose(
        solve_matrix_programs(as_row).x, solve_matrix_programs(program).x, atol=TOLERANCE_OF_X
    )


def test_unknowns_with_equal_bounds_are_numbers(rng):
    program = random_program(rng, n=9)
    lower, upper = program.lower.copy(), program.upper.copy()
    lower[:, 4] = upper[:, 4] = 0.3
    lower[1, 2] = upper[1, 2] = 0.0
    program = dataclasses.replace(program, lower=lower, upper=upper)
    answer = solve_matrix_programs(program)
    for k in range(3):
        if answer.is_solved[k]:
            np.testing.assert_allclose(answer.x[k], oracle(program, k)[0], atol=TOLERANCE_OF_X)
        else:
            assert oracle(program, k)[0] is None
    assert answer.is_solved.any()
    np.testing.assert_allclose(answer.x[answer.is_solved, 4], 0.3, atol=1e-9)


@pytest.mark.filterwarnings("error")
def test_frames_without_a_solution_are_marked_and_leave_the_others_alone(rng):
    program = random_program(rng, n_frames=5)
    alone = solve_matrix_programs(program)
    constant, targets = program.constant.copy(), program.targets.copy()
    constant[1] -= 1e3 * np.eye(4)  # no x within bounds makes up for this
    targets[3] += 1e4
    answer = solve_matrix_programs(dataclasses.replace(program, constant=constant, targets=targets))
    assert answer.is_solved.tolist() == [True, False, True, False, True]
    assert np.isnan(answer.x[[1, 3]]).all()
    assert np.isnan(answer.multiplier[[1, 3]]).all()
    np.testing.assert_allclose(answer.x[[0, 2, 4]], alone.x[[0, 2, 4]], atol=1e-9)


@pytest.mark.filterwarnings("error")
def test_numbers_that_are_not_finite_spoil_their_own_frame_only(rng):
    program = random_program(rng, n_frames=3)
    constant = program.constant.copy()
    constant[1, 0, 0] = np.nan
    answer = solve_matrix_programs(dataclasses.replace(program, constant=constant))
    assert answer.is_solved.tolist() == [True, False, True]


@pytest.mark.parametrize("exponent", [1.5, 3.0])
def test_a_curved_cost_modelled_anew_at_every_step_has_the_optimum_of_clarabel(rng, exponent):
    program = random_program(rng, n_frames=4, n=10)

    def model(x, frames, _):
        second = exponent * (exponent - 1) * x ** (exponent - 2)
        return dataclasses.replace(
            program,
            quadratic=second[:, :, None] * np.eye(10),
            linear=exponent * x ** (exponent - 1) - second * x,
            **{
                name: getattr(program, name)[frames]
                for name in (
                    "equations", "targets", "rows", "least", "lower", "upper", "matrices", "constant"
                )
            },
        )  # fmt: skip

    answer = solve_matrix_programs(program, model)
    assert answer.is_solved.all()
    for k in range(4):
        cost = oracle(program, k, exponent)[1]
        assert np.sum(np.abs(answer.x[k]) ** exponent) == pytest.approx(cost, rel=1e-6)


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_turns_of_similar_weight_add_up_to_the_multiplier_and_pin_every_product(rng, size):
    """Rows with positive prices that span all symmetric matrices: the optimum of the matrix inequality."""
    basis = np.linalg.qr(rng.normal(size=(6, 6)))[0][:, :size]
    multiplier = (basis * rng.uniform(0.1, 10.0, size)) @ basis.T
    (turns,) = critical_turns(multiplier[None])
    assert len(turns) == size * (size + 1) // 2
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1.0, atol=1e-12)
    products = np.array([np.outer(turn, turn).ravel() for turn in turns])
    assert np.linalg.matrix_rank(products, tol=1e-8) == len(turns)
    price = np.linalg.lstsq(products.T, multiplier.ravel(), rcond=None)[0]
    np.testing.assert_allclose(products.T @ price, multiplier.ravel(), atol=1e-10)
    assert price.min() > 0


def test_turns_of_very_different_weight_are_eigenvectors_with_sums_and_differences():
    one, two = np.eye(3)[0], np.eye(3)[2]
    multiplier = np.stack(
        [np.outer(one, one), 1e5 * np.outer(one, one) + np.outer(two, two), np.zeros((3, 3))]
    )
    turns = critical_turns(multiplier)
    assert turns.shape == (3, 4, 3)
    np.testing.assert_allclose(np.abs(turns[0]), [one, 0 * one, 0 * one, 0 * one], atol=1e-15)
    np.testing.assert_allclose(np.abs(turns[1, :2]), [one, two], atol=1e-15)
    np.testing.assert_allclose(
        np.abs(turns[1, 2:]), np.array([one + two, one + two]) / np.sqrt(2), atol=1e-15
    )
    assert (turns[2] == 0).all()


def test_no_multiplier_means_no_turn():
    assert critical_turns(np.zeros((2, 3, 3))).shape == (2, 0, 3)


def test_the_same_rows_are_modelled_whichever_frames_are_asked_for(rng):
    """A coordinate that nothing moves in the second frame has a row of zeros there, not none."""
    problem = hessian_problem(rng, n_coordinates=2, n_frames=2, exponent=3.0)
    trajectory = problem.motion.trajectory
    arms, moments = trajectory.moment_arms.copy(), trajectory.generalized_forces.copy()
    arms[1, 1], moments[1, 1] = 0.0, 0.0
    trajectory = dataclasses.replace(trajectory, moment_arms=arms, generalized_forces=moments)
    problem = dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=trajectory))
    model = local_model(describe(problem))
    unknowns = np.full((2, model.program.layout.size), 0.3)
    both = model.rows(unknowns, np.array([0, 1]))
    for k in range(2):
        for alone, among in zip(model.rows(unknowns[[k]], np.array([k])), both, strict=True):
            np.testing.assert_array_equal(alone[0], among[k])


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_units_of_equations_and_rows_do_not_matter(rng, factor):
    program = random_program(rng, n_equations=2, n_rows=2)
    scaled = {name: factor * getattr(program, name) for name in ("equations", "targets", "rows", "least")}
    answers = [solve_matrix_programs(p) for p in (program, dataclasses.replace(program, **scaled))]
    assert all(answer.is_solved.all() for answer in answers)
    np.testing.assert_allclose(answers[1].x, answers[0].x, atol=TOLERANCE_OF_X)
