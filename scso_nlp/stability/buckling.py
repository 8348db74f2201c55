"""How much load passive tissue carries alone before it buckles."""

from __future__ import annotations

import numpy as np

from scso_nlp.validation import BoolArray, FloatArray

#: A stiffness below zero by less than this share of the matrix's entries is rounding [-].
_ROUNDING = 1e-13
#: Factors outside of these are zero and infinite [-].
_LEAST, _MOST = 1e-9, 1e9
#: Halvings of the factor's logarithm.
_HALVINGS = 70


def buckling_factor(passive: FloatArray, taken: FloatArray) -> FloatArray:
    r"""Find the factor of the loads at which passive stiffness alone is no longer stable.

    .. math:: \lambda = \max\{\lambda \ge 0 : K - \lambda E \succeq 0\}

    Parameters
    ----------
    passive : ndarray, shape (n_frames, n, n) [N·m/rad]
        K, positive semi-definite.
    taken : ndarray, shape (n_frames, n, n) [N·m/rad]
        E, what the loads take away.

    Returns
    -------
    ndarray, shape (n_frames,) [-]
        0 where loads of any size buckle it, infinite where none does.

    References
    ----------
    Bergmark (1989), Acta Orthop Scand 60 Suppl 230: loads grow together until the Hessian is singular.
    """
    size = np.abs(passive).sum(axis=(1, 2))
    size_taken = np.abs(taken).sum(axis=(1, 2))

    def is_stable(factor: FloatArray) -> BoolArray:
        least = np.linalg.eigvalsh(passive - factor[:, None, None] * taken)[:, 0]
        return np.asarray(least >= -_ROUNDING * (size + factor * size_taken))

    low, high = np.full(len(passive), _LEAST), np.full(len(passive), _MOST)
    never, always = ~is_stable(low), is_stable(high)
    for _ in range(_HALVINGS):
        middle = np.sqrt(low * high)
        stable = is_stable(middle)
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return np.where(never, 0.0, np.where(always, np.inf, low))
