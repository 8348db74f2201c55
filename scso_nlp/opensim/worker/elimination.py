"""Which coordinates follow from the others by the model's constraints: linear algebra, no OpenSim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.exceptions import EngineError
from scso_nlp.validation import BoolArray, FloatArray, IntArray

#: A mobility whose elimination leaves more than this of a constraint row was a wrong choice [-].
ELIMINATION_TOLERANCE = 1e-6
#: Smallest pivot, relative to the largest, that counts as an independent constraint [-].
RANK_TOLERANCE = 1e-8


@dataclass(frozen=True)
class Elimination:
    """Dependent coordinates, the same in every worker and frame."""

    dependent: BoolArray  # (n_u,)

    @property
    def free(self) -> IntArray:
        """Indices of the free coordinates."""
        return np.flatnonzero(~self.dependent)

    @property
    def gone(self) -> IntArray:
        """Indices of the dependent coordinates."""
        return np.flatnonzero(self.dependent)

    def coupling(self, constraints: FloatArray, time: float) -> FloatArray:
        """Return du/du_free, shape (n_u, n_free), from the constraint matrix, shape (n_constraints, n_u)."""
        free = self.free
        coupling = np.zeros((len(self.dependent), len(free)))
        coupling[free, np.arange(len(free))] = 1.0
        if self.dependent.any():
            coupling[self.dependent] = self.remedy(constraints, constraints[:, ~self.dependent])
            left = np.abs(constraints @ coupling).max(initial=0.0)
            if left > ELIMINATION_TOLERANCE * max(np.abs(constraints).max(initial=0.0), 1e-300):
                raise EngineError(
                    "the coordinates chosen to close the model's loops do not determine it at "
                    f"t = {time:.9g} s: its constraints are singular there"
                )
        return coupling

    def remedy(self, constraints: FloatArray, error: FloatArray) -> FloatArray:
        """Return the change of the dependent coordinates that takes an error of the constraints away.

        Shapes (n_constraints, n_u) and (n_constraints, ...) give (n_dependent, ...).
        """
        change = np.linalg.lstsq(constraints[:, self.dependent], error, rcond=RANK_TOLERANCE)[0]
        return np.asarray(-change)


def choose_dependent(constraints: FloatArray, is_set_by_model: BoolArray) -> BoolArray:
    """Choose the coordinates to eliminate, shape (n_u,), from the constraints of one pose.

    Locked, prescribed and coupled coordinates first; closed loops (point constraints) then give up one
    coordinate per remaining independent constraint, the one that the constraints determine best.
    """
    dependent = is_set_by_model.copy()
    scale = np.abs(constraints).max(initial=0.0)
    # clear what the coordinates set by the model account for, by orthogonal projection of the rows
    basis, values, _ = np.linalg.svd(constraints[:, dependent], full_matrices=True)
    rank = int((values > RANK_TOLERANCE * max(scale, 1e-300)).sum())
    rest = basis[:, rank:].T @ constraints
    rest[:, dependent] = 0.0
    while rest.size and np.abs(rest).max() > RANK_TOLERANCE * scale:
        norms = np.linalg.norm(rest, axis=0)
        best = int(norms.argmax())
        direction = rest[:, best] / norms[best]
        rest = rest - np.outer(direction, direction @ rest)
        rest[:, best] = 0.0
        dependent[best] = True
    return dependent
