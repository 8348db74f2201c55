"""Conditions of an optimum as equations: frames apart from each other beside one matrix of all frames."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from scso_nlp.sensitivities.equations import Linear, factorised

N_FRAMES, SIZE, N_ROWS = 4, 7, 3


def equations(rng, nearness=1.0):
    """A diagonal Hessian over six decades, and three rows a frame, of which two differ by a nearness."""
    curvature = 10 ** rng.uniform(-3, 3, N_FRAMES * SIZE)
    blocks = rng.normal(size=(N_FRAMES, N_ROWS, SIZE))
    blocks[:, 1] = blocks[:, 0] + nearness * blocks[:, 1]
    blocks[-1, 2] = 0.0
    slopes = sp.block_diag(list(blocks), format="csr")[: N_FRAMES * N_ROWS - 1]  # the last frame has two
    return sp.diags(curvature).tocsr(), slopes, curvature


def linear(hessian, slopes, curvature, frame):
    nothing = np.zeros(0, dtype=np.int64)
    return Linear(
        free=nothing,
        rows=nothing,
        frame=np.append(np.repeat(np.arange(N_FRAMES), SIZE), np.repeat(np.arange(N_FRAMES), N_ROWS)[:-1]),
        left=nothing,
        factors=factorised(hessian, slopes, curvature, frame),
        slope=slopes,
    )


@pytest.mark.parametrize("width", [(), (5,)])
@pytest.mark.parametrize("nearness", [1.0, 1e-3, 1e-6])
@pytest.mark.parametrize("is_apart", [True, False])
def test_answers_meet_their_equations(rng, is_apart, nearness, width):
    """To rounding of what the equations add up, however near to dependent their rows are."""
    hessian, slopes, curvature = equations(rng, nearness)
    frame = np.repeat(np.arange(N_FRAMES), N_ROWS)[:-1]
    found = linear(hessian, slopes, curvature, frame if is_apart else None)
    matrix = sp.bmat([[hessian, slopes.T], [slopes, None]], format="csr")
    right = rng.normal(size=(matrix.shape[0], *width))
    answer = found.solve(right)
    assert (np.abs(matrix @ answer - right) <= 1e-12 * (abs(matrix) @ np.abs(answer) + np.abs(right))).all()


def test_frames_apart_are_solved_by_their_rows_unless_these_are_nearly_dependent(rng):
    """What products of rows would lose in digits is kept by the equations of rows and unknowns."""
    frame = np.repeat(np.arange(N_FRAMES), N_ROWS)[:-1]
    by_rows, whole = (
        factorised(*equations(rng, nearness), given) for nearness, given in ((1.0, frame), (1.0, None))
    )
    assert type(by_rows) is not type(whole)
    assert type(factorised(*equations(rng, 1e-6), frame)) is type(whole)
    hessian, slopes, curvature = equations(rng)
    turned = (hessian + sp.diags([np.full(len(curvature) - 1, 1e-4)] * 2, [-1, 1])).tocsr()
    assert type(factorised(turned, slopes, curvature, frame)) is type(whole)


def test_an_answer_to_noise_tells_how_near_to_singular_a_frame_is(rng):
    near, far = (
        linear(*equations(rng, nearness), np.repeat(np.arange(N_FRAMES), N_ROWS)[:-1]).answer_to_noise(
            N_FRAMES
        )
        for nearness in (1e-6, 1.0)
    )
    assert near.max() > 1e10
    assert (far < 1e5).all()


def test_rows_of_frames_apart_may_stand_in_any_order(rng):
    """Those of matrices stand behind all others."""
    hessian, slopes, curvature = equations(rng)
    frame = np.repeat(np.arange(N_FRAMES), N_ROWS)[:-1]
    order = rng.permutation(frame.size)
    right = rng.normal(size=SIZE * N_FRAMES)
    first, second = (
        linear(hessian, slopes[rows], curvature, frame[rows]).solve(np.append(right, np.zeros(rows.size)))
        for rows in (np.arange(frame.size), order)
    )
    np.testing.assert_allclose(second[: right.size], first[: right.size], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(second[right.size :], first[right.size :][order], rtol=1e-9, atol=1e-12)


def test_frames_without_active_rows_are_their_curvatures_alone(rng):
    hessian, slopes, curvature = equations(rng)
    nothing = np.zeros(0, dtype=np.int64)
    alone = factorised(hessian, slopes[nothing], curvature, nothing)
    np.testing.assert_allclose(
        alone.scale**2 * alone.solve(np.ones(curvature.size)), 1 / curvature, rtol=1e-12
    )
