"""Which turns decide when a Hessian must stay positive semi-definite: a small conic solver in NumPy.

Every frame is a quadratic program with one matrix inequality. All frames take their interior-point
steps together as batched arrays. The answer is used only to choose rows: the turns in the null space
of the Hessian at the optimum, with which the rows alone reproduce the matrix inequality.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.validation import BoolArray, FloatArray

#: Interior-point iterations; 15 to 25 are usual.
_MAX_ITERATIONS = 60

#: Relative residuals and gap at which a frame is done.
_TOLERANCE = 1e-10

#: Steps go this far towards the boundary.
_STEP = 0.98


@dataclass(frozen=True, kw_only=True)
class MatrixProgram:
    r"""Quadratic programs with one matrix inequality each, one per frame.

    .. math:: \min \tfrac12 x^T Q x + g^T x \;\text{s.t.}\; A x = b,\; l \le x \le u,\;
              K + \sum_i x_i G_i \succeq 0

    Attributes
    ----------
    quadratic : ndarray, shape (n_frames, n, n)
    linear : ndarray, shape (n_frames, n)
    equations : ndarray, shape (n_frames, n_equations, n)
    targets : ndarray, shape (n_frames, n_equations)
    lower, upper : ndarray, shape (n_frames, n)
        Infinite where there is no bound.
    matrices : ndarray, shape (n_frames, n, size, size)
        Symmetric.
    constant : ndarray, shape (n_frames, size, size)
        Symmetric.
    """

    quadratic: FloatArray
    linear: FloatArray
    equations: FloatArray
    targets: FloatArray
    lower: FloatArray
    upper: FloatArray
    matrices: FloatArray
    constant: FloatArray


@dataclass(frozen=True, kw_only=True)
class MatrixProgramAnswer:
    """Optimum of each frame.

    Attributes
    ----------
    x : ndarray, shape (n_frames, n)
    multiplier : ndarray, shape (n_frames, size, size)
        Of the matrix inequality; its range is the null space of the matrix at the optimum.
    is_solved : ndarray of bool, shape (n_frames,)
    iterations : int
    """

    x: FloatArray
    multiplier: FloatArray
    is_solved: BoolArray
    iterations: int


def solve_matrix_programs(program: MatrixProgram) -> MatrixProgramAnswer:
    """Solve all frames by a primal-dual interior-point method.

    Parameters
    ----------
    program : MatrixProgram

    Returns
    -------
    MatrixProgramAnswer

    Notes
    -----
    Search direction of Helmberg, Rendl, Vanderbei and Wolkowicz with Mehrotra's predictor and corrector.

    References
    ----------
    Helmberg et al. (1996), SIAM J Optim 6:342-361; Mehrotra (1992), SIAM J Optim 2:575-601.
    """
    n_frames, n = program.linear.shape
    size = program.constant.shape[1]
    n_equations = program.targets.shape[1]
    flat = program.matrices.reshape(n_frames, n, size * size)
    has_low, has_high = np.isfinite(program.lower), np.isfinite(program.upper)
    low, high = np.where(has_low, program.lower, 0.0), np.where(has_high, program.upper, 0.0)
    both = has_low & has_high
    x = np.where(both, (low + high) / 2, np.where(has_low, low + 1.0, np.where(has_high, high - 1.0, 0.0)))
    eye = np.eye(size)
    # Scale the matrix inequality so that its slack and multiplier start at one.
    scale = np.maximum(np.abs(program.constant).max(axis=(1, 2)), np.abs(flat).max(axis=(1, 2)))
    scale = np.where(scale > 0, scale, 1.0)
    flat = flat / scale[:, None, None]
    constant = program.constant / scale[:, None, None]
    slack = np.broadcast_to(eye, (n_frames, size, size)).copy()
    dual = slack.copy()
    s_low, s_high = (
        np.where(has_low, np.maximum(x - low, 1e-2), 1.0),
        np.where(has_high, np.maximum(high - x, 1e-2), 1.0),
    )
    z_low, z_high = has_low.astype(float), has_high.astype(float)
    y = np.zeros((n_frames, n_equations))
    count = has_low.sum(axis=1) + has_high.sum(axis=1) + size
    done = np.zeros(n_frames, dtype=bool)
    size_of_linear = 1.0 + np.abs(program.linear).max(axis=1)
    size_of_target = 1.0 + np.abs(program.targets).max(axis=1, initial=0.0)
    iteration = 0
    for iteration in range(_MAX_ITERATIONS):
        matrix = constant + (flat.transpose(0, 2, 1) @ x[:, :, None]).reshape(n_frames, size, size)
        r_dual = -(
            (program.quadratic @ x[:, :, None])[:, :, 0]
            + program.linear
            - (program.equations.transpose(0, 2, 1) @ y[:, :, None])[:, :, 0]
            - (flat @ dual.reshape(n_frames, -1, 1))[:, :, 0]
            - z_low
            + z_high
        )
        r_equations = program.targets - (program.equations @ x[:, :, None])[:, :, 0]
        r_slack = matrix - slack
        r_low = np.where(has_low, x - low - s_low, 0.0)
        r_high = np.where(has_high, high - x - s_high, 0.0)
        gap = (
            np.einsum("kij,kij->k", slack, dual)
            + np.where(has_low, s_low * z_low, 0.0).sum(axis=1)
            + np.where(has_high, s_high * z_high, 0.0).sum(axis=1)
        )
        mu = gap / count
        done = (
            (np.abs(r_dual).max(axis=1) <= _TOLERANCE * size_of_linear)
            & (np.abs(r_equations).max(axis=1, initial=0.0) <= _TOLERANCE * size_of_target)
            & (np.abs(r_slack).max(axis=(1, 2)) <= _TOLERANCE)
            & (mu <= _TOLERANCE)
        )
        if done.all() or not np.isfinite(mu).all():
            break
        inverse = np.linalg.inv(slack)
        inverse = (inverse + inverse.transpose(0, 2, 1)) / 2
        # M_ij = tr(G_i Z G_j S^-1)
        cube = flat.reshape(n_frames, n, size, size)
        product = dual[:, None] @ cube @ inverse[:, None]
        schur = flat @ product.transpose(0, 1, 3, 2).reshape(n_frames, n, -1).transpose(0, 2, 1)
        schur = (schur + schur.transpose(0, 2, 1)) / 2
        ratio_low = np.where(has_low, z_low / s_low, 0.0)
        ratio_high = np.where(has_high, z_high / s_high, 0.0)
        kkt = np.zeros((n_frames, n + n_equations, n + n_equations))
        kkt[:, :n, :n] = program.quadratic + schur
        kkt[:, np.arange(n), np.arange(n)] += ratio_low + ratio_high + 1e-12
        kkt[:, :n, n:] = -program.equations.transpose(0, 2, 1)
        kkt[:, n:, :n] = program.equations
        kkt[:, np.arange(n, n + n_equations), np.arange(n, n + n_equations)] += 1e-12

        def direction(c_matrix, c_low, c_high):  # type: ignore[no-untyped-def]
            """Solve for a step; c_* are the wanted complementarity products."""
            # dZ = c S^-1 - Z - sym(Z dS S^-1), dS = G dx + r_slack
            fixed = c_matrix @ inverse - dual - dual @ r_slack @ inverse
            fixed = (fixed + fixed.transpose(0, 2, 1)) / 2
            right = r_dual + (flat @ fixed.reshape(n_frames, -1, 1))[:, :, 0]
            right = right + np.where(has_low, (c_low - z_low * r_low) / s_low - z_low, 0.0)
            right = right - np.where(has_high, (c_high - z_high * r_high) / s_high - z_high, 0.0)
            step = np.linalg.solve(kkt, np.concatenate([right, r_equations], axis=1)[:, :, None])[:, :, 0]
            dx, dy = step[:, :n], step[:, n:]
            d_matrix = (flat.transpose(0, 2, 1) @ dx[:, :, None]).reshape(n_frames, size, size)
            d_slack = d_matrix + r_slack
            moved = dual @ d_matrix @ inverse
            d_dual = fixed - (moved + moved.transpose(0, 2, 1)) / 2
            ds_low, ds_high = np.where(has_low, dx + r_low, 0.0), np.where(has_high, -dx + r_high, 0.0)
            dz_low = np.where(has_low, (c_low - z_low * ds_low) / s_low - z_low, 0.0)
            dz_high = np.where(has_high, (c_high - z_high * ds_high) / s_high - z_high, 0.0)
            return dx, dy, d_slack, d_dual, ds_low, ds_high, dz_low, dz_high

        zero = np.zeros((n_frames, 1))
        predicted = direction(np.zeros((n_frames, 1, 1)) * eye, zero, zero)
        primal = np.minimum(
            _to_boundary(slack, predicted[2]), _linear_boundary((s_low, s_high), predicted[4:6])
        )
        dual_step = np.minimum(
            _to_boundary(dual, predicted[3]), _linear_boundary((z_low, z_high), predicted[6:8])
        )
        primal, dual_step = np.minimum(primal, 1.0), np.minimum(dual_step, 1.0)
        after = (
            np.einsum(
                "kij,kij->k",
                slack + primal[:, None, None] * predicted[2],
                dual + dual_step[:, None, None] * predicted[3],
            )
            + np.where(
                has_low,
                (s_low + primal[:, None] * predicted[4]) * (z_low + dual_step[:, None] * predicted[6]),
                0.0,
            ).sum(axis=1)
            + np.where(
                has_high,
                (s_high + primal[:, None] * predicted[5]) * (z_high + dual_step[:, None] * predicted[7]),
                0.0,
            ).sum(axis=1)
        )
        center = np.clip((after / np.maximum(gap, 1e-300)) ** 3, 1e-4, 0.8) * mu
        c_matrix = center[:, None, None] * eye - predicted[3] @ predicted[2]
        corrected = direction(
            c_matrix,
            center[:, None] - predicted[4] * predicted[6],
            center[:, None] - predicted[5] * predicted[7],
        )
        primal = np.minimum(
            _to_boundary(slack, corrected[2]), _linear_boundary((s_low, s_high), corrected[4:6])
        )
        dual_step = np.minimum(
            _to_boundary(dual, corrected[3]), _linear_boundary((z_low, z_high), corrected[6:8])
        )
        primal, dual_step = np.minimum(_STEP * primal, 1.0), np.minimum(_STEP * dual_step, 1.0)
        primal = np.where(done, 0.0, primal)
        dual_step = np.where(done, 0.0, dual_step)
        # With a quadratic objective primal and dual residuals share x: one step length keeps both falling.
        together = np.minimum(primal, dual_step)
        x = x + together[:, None] * corrected[0]
        y = y + together[:, None] * corrected[1]
        slack = slack + together[:, None, None] * corrected[2]
        dual = dual + together[:, None, None] * corrected[3]
        s_low, s_high = s_low + together[:, None] * corrected[4], s_high + together[:, None] * corrected[5]
        z_low, z_high = z_low + together[:, None] * corrected[6], z_high + together[:, None] * corrected[7]
    return MatrixProgramAnswer(
        x=x, multiplier=dual / scale[:, None, None], is_solved=done, iterations=iteration
    )


def critical_turns(multiplier: FloatArray, share: float = 1e-6) -> FloatArray:
    """Pick the eigenvectors of the multipliers that carry weight, with their sums and differences.

    Parameters
    ----------
    multiplier : ndarray, shape (n_frames, size, size)
        Of the matrix inequality; positive semi-definite.
    share : float [-]
        Least eigenvalue over the largest one of the frame.

    Returns
    -------
    ndarray, shape (n_frames, n_turns, size)
        Unit vectors; zeros where a frame has fewer.

    Notes
    -----
    The sums and differences pin the products of two turns to zero where the turns alone are pinned.
    """
    values, vectors = np.linalg.eigh(multiplier)
    values, vectors = values[:, ::-1], vectors[:, :, ::-1].transpose(0, 2, 1)
    heavy = (values > share * values[:, :1]) & (values > 0)
    most = int(heavy.sum(axis=1).max(initial=0))
    turns = np.where(heavy[:, :most, None], vectors[:, :most], 0.0)
    parts = [turns]
    for i in range(most):
        for j in range(i):
            both = heavy[:, i, None] & heavy[:, j, None]
            for sign in (1.0, -1.0):
                combined = (turns[:, i] + sign * turns[:, j]) / np.sqrt(2.0)
                parts.append(np.where(both, combined, 0.0)[:, None])
    return np.concatenate(parts, axis=1)


def _to_boundary(matrix: FloatArray, step: FloatArray) -> FloatArray:
    """Longest step that keeps positive definite matrices so, shape (n_frames,)."""
    try:
        factor = np.linalg.inv(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        return np.zeros(len(matrix))
    least = np.linalg.eigvalsh(factor @ step @ factor.transpose(0, 2, 1))[:, 0]
    return np.where(least < 0, -1.0 / np.minimum(least, -1e-300), np.inf)


def _linear_boundary(values: tuple[FloatArray, ...], steps: tuple[FloatArray, ...]) -> FloatArray:
    """Longest step that keeps positive numbers so, shape (n_frames,)."""
    longest = np.full(len(values[0]), np.inf)
    for value, step in zip(values, steps, strict=True):
        ratio = np.where(step < 0, value / np.maximum(-step, 1e-300), np.inf)
        longest = np.minimum(longest, ratio.min(axis=1, initial=np.inf))
    return longest
