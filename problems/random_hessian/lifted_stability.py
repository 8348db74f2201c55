"""Another way to a positive semi-definite Hessian, for comparison: its Cholesky factor as unknowns."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

import scso_nlp as scso
from scso_nlp.muscle_models.stiffness_law import ProportionalStiffness, StiffnessLaw


@dataclass(frozen=True, kw_only=True)
class LiftedStability(scso.FrameConstraint):
    """H = L Lᵀ with a lower triangular L as further unknowns: another way to the same optimum."""

    stiffness: StiffnessLaw = field(default_factory=ProportionalStiffness)

    def _pairs(self, motion):
        n = len(motion.trajectory.curvature.coordinates)
        return [(i, j) for i in range(n) for j in range(i + 1)]

    def variables(self, motion):
        """Name the entries of the factor."""
        pairs = self._pairs(motion)
        guess = np.array([5.0 if i == j else 0.0 for i, j in pairs])
        return (
            scso.VariableSpec(
                name="factor",
                labels=tuple(f"factor_{i}_{j}" for i, j in pairs),
                lower=np.where(guess > 0, 0.0, -np.inf),
                guess=guess,
                scale=5.0,
            ),
        )

    def data(self, motion):
        """Give curvature, products of moment arms and what is constant, by entry."""
        trajectory, pairs = motion.trajectory, self._pairs(motion)
        curvature = trajectory.curvature
        arms = trajectory.moment_arms
        constant = curvature.load_stiffness + curvature.passive_stiffness
        return {
            "curvature": np.stack([curvature.path_curvature[:, i, j] for i, j in pairs], axis=1),
            "arm_products": np.stack([arms[:, i] * arms[:, j] for i, j in pairs], axis=1),
            "constant": np.stack([constant[:, i, j] for i, j in pairs], axis=1),
            **self.stiffness.data(motion),
        }

    def rows(self, frame, motion):
        """One row per entry of the lower triangle: H less L Lᵀ, in N·m/rad."""
        pairs = self._pairs(motion)
        n = pairs[-1][0] + 1
        factor = ca.SX.zeros(n, n)
        for entry, (i, j) in enumerate(pairs):
            factor[i, j] = frame.variables["factor"][entry]
        product = factor @ factor.T
        square = ca.vertcat(*[product[i, j] for i, j in pairs])
        data = frame.data
        hessian = data["curvature"] @ frame.muscle.tendon_force + data["constant"]
        hessian += data["arm_products"] @ self.stiffness.stiffness(frame, motion)
        return scso.Rows(
            value=hessian - square,
            lower=0.0,
            upper=0.0,
            names=[f"entry_{i}_{j}" for i, j in pairs],
            unit="N·m/rad",
            scale=10.0,
        )
