"""Conditions of an optimum as equations: groups of rows that share no unknown beside one matrix of all."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from scso_nlp.sensitivities.equations import Linear, factorised

N_FRAMES, SIZE, N_ROWS = 4, 7, 3
FRAME = np.repeat(np.arange(N_FRAMES), N_ROWS)[:-1]


def equations(rng, nearness=1.0, bend=0.0):
    """A Hessian over six decades, and three rows a frame, of which two differ by a nearness.

    Unknowns beside each other bend the cost together by a share of what each does alone.
    """
    curvature = 10 ** rng.uniform(-3, 3, N_FRAMES * SIZE)
    blocks = rng.normal(size=(N_FRAMES, N_ROWS, SIZE))
    blocks[:, 1] = blocks[:, 0] + nearness * blocks[:, 1]
    blocks[-1, 2] = 0.0
    slopes = sp.block_diag(list(blocks), format="csr")[: N_FRAMES * N_ROWS - 1]  # the last frame has two
    beside = bend * np.sqrt(curvature[1:] * curvature[:-1])
    return (sp.diags(curvature) + sp.diags([beside, beside], [-1, 1])).tocsr(), slopes, curvature


def linear(hessian, slopes, curvature):
    nothing = np.zeros(0, dtype=np.int64)
    return Linear(
        free=nothing,
        rows=nothing,
        frame=np.append(np.repeat(np.arange(N_FRAMES), SIZE), FRAME),
        left=nothing,
        factors=factorised(hessian, slopes, curvature),
        slope=slopes,
    )


@pytest.mark.parametrize("width", [(), (5,)])
@pytest.mark.parametrize("nearness", [1.0, 1e-3, 1e-6])
@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_answers_meet_their_equations(rng, bend, nearness, width):
    """To rounding of what the equations add up, however near to dependent their rows are."""
    hessian, slopes, curvature = equations(rng, nearness, bend)
    found = linear(hessian, slopes, curvature)
    matrix = sp.bmat([[hessian, slopes.T], [slopes, None]], format="csr")
    right = rng.normal(size=(matrix.shape[0], *width))
    answer = found.solve(right)
    assert (np.abs(matrix @ answer - right) <= 1e-12 * (abs(matrix) @ np.abs(answer) + np.abs(right))).all()


def test_rows_of_a_diagonal_hessian_are_solved_in_groups_unless_nearly_dependent(rng):
    """What products of rows would lose in digits is kept by the equations of rows and unknowns."""
    by_rows, whole = (factorised(*equations(rng, bend=bend)) for bend in (0.0, 0.3))
    assert type(by_rows) is not type(whole)
    assert type(factorised(*equations(rng, 1e-6))) is type(whole)


def test_a_chain_of_many_rows_is_one_sparse_matrix(rng):
    """Rows of neighbours couple a whole motion: a full matrix of all its rows would fill the memory."""
    n = 300
    chain = sp.diags([np.ones(n), -np.ones(n)], [0, 1], shape=(n, n + 1), format="csr")
    curvature = 10 ** rng.uniform(-1, 1, n + 1)
    hessian = sp.diags(curvature).tocsr()
    long, short = factorised(hessian, chain, curvature), factorised(hessian, chain[:50], curvature)
    assert type(long) is type(factorised(*equations(rng, bend=0.3)))
    assert type(short) is not type(long)


def test_groups_are_rows_that_share_unknowns_of_whatever_size(rng):
    """Two legs and a row alone: what is apart in some frames is together in others."""
    legs = [rng.normal(size=(3, 5)), rng.normal(size=(3, 5)), rng.normal(size=(1, 2))]
    apart = sp.block_diag(legs, format="csr")
    joined = sp.vstack([apart, sp.csr_matrix(rng.normal(size=(1, 12)))])
    slopes = sp.block_diag([apart, joined, apart], format="csr")[rng.permutation(22)]
    curvature = 10 ** rng.uniform(-1, 1, slopes.shape[1])
    found = factorised(sp.diags(curvature).tocsr(), slopes, curvature)
    matrix = sp.bmat([[sp.diags(curvature), slopes.T], [slopes, None]]).toarray()
    right = rng.normal(size=(len(matrix), 2))
    answer = found.scale[:, None] * found.solve(found.scale[:, None] * right)
    np.testing.assert_allclose(answer, np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-9)


def test_an_answer_to_noise_tells_how_near_to_singular_a_frame_is(rng):
    near, far = (linear(*equations(rng, nearness)).answer_to_noise(N_FRAMES) for nearness in (1e-6, 1.0))
    assert near.max() > 1e10
    assert (far < 1e5).all()


def test_rows_of_frames_apart_may_stand_in_any_order(rng):
    """Those of matrices stand behind all others."""
    hessian, slopes, curvature = equations(rng)
    order = rng.permutation(FRAME.size)
    right = rng.normal(size=SIZE * N_FRAMES)
    first, second = (
        linear(hessian, slopes[rows], curvature).solve(np.append(right, np.zeros(rows.size)))
        for rows in (np.arange(FRAME.size), order)
    )
    np.testing.assert_allclose(second[: right.size], first[: right.size], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(second[right.size :], first[right.size :][order], rtol=1e-9, atol=1e-12)


def test_frames_without_active_rows_are_their_curvatures_alone(rng):
    hessian, slopes, curvature = equations(rng)
    alone = factorised(hessian, slopes[np.zeros(0, dtype=np.int64)], curvature)
    np.testing.assert_allclose(
        alone.scale**2 * alone.solve(np.ones(curvature.size)), 1 / curvature, rtol=1e-12
    )
