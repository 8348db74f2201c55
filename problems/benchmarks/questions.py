"""What a benchmark asks, in plain arrays, and what an answer is worth: computed from nothing but these."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scso_nlp import ActivationEffort, HessianStability, MomentEquilibrium, MuscleForceProblem
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.muscle_models.stiffness_law import ProportionalStiffness
from scso_nlp.stability.hessian import hessian_terms
from scso_nlp.stability.rows import geometric_stability
from scso_nlp.validation import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Question:
    r"""Least effort of every frame: :math:`\min \sum |x|^p` with equations, rows, a matrix and bounds.

    The unknowns x are activations and controls, n of them.

    Attributes
    ----------
    equations : ndarray, shape (n_frames, n_coordinates, n) [N·m or N]
    moments : ndarray, shape (n_frames, n_coordinates) [N·m or N]
    rows : ndarray, shape (n_frames, n_rows, n) [N·m/rad]
    levels : ndarray, shape (n_frames, n_rows) [N·m/rad]
        Rows times unknowns are at least this.
    matrices : ndarray, shape (n_frames, k, k, n) [N·m/rad]
        Stability of k coordinates together; k is 0 without.
    constant : ndarray, shape (n_frames, k, k) [N·m/rad]
        With it the matrix is positive semi-definite.
    lower, upper : ndarray, shape (n,) [-]
    exponent : float
        p, infinite for min/max.
    capacity : ndarray, shape (n_frames, n_muscles) [N]
        Tendon force at full activation.
    """

    equations: FloatArray
    moments: FloatArray
    rows: FloatArray
    levels: FloatArray
    matrices: FloatArray
    constant: FloatArray
    lower: FloatArray
    upper: FloatArray
    exponent: float
    capacity: FloatArray

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.moments)

    def frames(self, selection: IntArray) -> Question:
        """Keep some frames."""
        names = ("equations", "moments", "rows", "levels", "matrices", "constant", "capacity")
        return replace(self, **{name: getattr(self, name)[selection] for name in names})

    def objective(self, x: FloatArray) -> FloatArray:
        """Effort of each frame of an answer (n_frames, n), shape (n_frames,)."""
        size = np.abs(x)
        return size.max(axis=1) if np.isinf(self.exponent) else (size**self.exponent).sum(axis=1)

    def missed(self, x: FloatArray, forces: FloatArray | None = None) -> dict[str, FloatArray]:
        """Tell by how much each frame of an answer misses what it has to keep.

        Parameters
        ----------
        x : ndarray, shape (n_frames, n) [-]
        forces : ndarray, shape (n_frames, n_muscles), optional [N]
            Tendon forces, where they are not capacity times activation.

        Returns
        -------
        dict of str to ndarray, shape (n_frames,)
            ``equilibrium`` [N·m or N], ``stability`` [N·m/rad] and ``bounds`` [-], none below zero.
        """
        bounds = np.maximum(self.lower - x, x - self.upper).max(axis=1)
        if forces is not None:
            without = np.where(forces == 0, 0.0, np.nan)  # no force is known of a muscle without capacity
            share = np.divide(forces, self.capacity, out=without, where=self.capacity != 0)
            x = np.concatenate([share, x[:, forces.shape[1] :]], axis=1)
        sums = np.einsum("kcn,kn->kc", self.equations, x) - self.moments
        short = self.levels - np.einsum("krn,kn->kr", self.rows, x)
        stability = short.max(axis=1, initial=0.0)
        if self.constant.shape[1]:
            matrix = np.einsum("kijn,kn->kij", self.matrices, x) + self.constant
            usable = np.isfinite(matrix).all(axis=(1, 2))
            least = np.linalg.eigvalsh(np.where(usable[:, None, None], matrix, 0.0))[:, 0]
            stability = np.maximum(stability, np.where(usable, -least, np.nan))
        equilibrium = np.abs(sums).max(axis=1)
        return {"equilibrium": equilibrium, "stability": stability, "bounds": np.maximum(bounds, 0.0)}


def ask(problem: MuscleForceProblem, capacity: FloatArray | None = None) -> Question:
    """Write static optimization, with or without stability, as arrays.

    Parameters
    ----------
    problem : MuscleForceProblem
        With one effort without weights, moment equilibrium and stability with stiffness q F / L; other
        terms are left out, and muscles are taken as OpenSim's static optimization takes them.
    capacity : ndarray, shape (n_frames, n_muscles), optional [N]
        By default the trajectory's, OpenSim's own.

    Returns
    -------
    Question
    """
    motion = problem.motion
    t, muscles, actuators = motion.trajectory, motion.muscles, motion.actuators
    capacity = t.active_force_capacity if capacity is None else capacity
    n_muscles = len(t.muscles)

    def of_unknowns(per_newton: FloatArray) -> FloatArray:
        """Turn (n_frames, ..., n_muscles) per newton into (n_frames, ..., n) per unknown."""
        middle = (1,) * (per_newton.ndim - 2)
        per_activation = per_newton * capacity.reshape(t.n_frames, *middle, -1)
        rest = np.zeros((*per_newton.shape[:-1], len(actuators.actuators)))
        return np.concatenate([per_activation, rest], axis=-1)

    equations = of_unknowns(t.moment_arms)
    equations[:, :, n_muscles:] = t.actuator_generalized_forces
    n = equations.shape[2]
    rows, levels = np.zeros((t.n_frames, 0, n)), np.zeros((t.n_frames, 0))
    matrices, constant = np.zeros((t.n_frames, 0, 0, n)), np.zeros((t.n_frames, 0, 0))
    for term in problem.constraints:
        if not isinstance(term, StabilityConstraint):
            assert isinstance(term, MomentEquilibrium) or type(term).__name__.startswith("Activation")
            continue
        assert isinstance(term.stiffness_law, ProportionalStiffness)
        assert term.soft is None
        gain = term.stiffness_law.gains(t.muscles)
        if isinstance(term, HessianStability):
            names = term.row_names(motion)
            terms = hessian_terms(t, names, model_passive=term.model_passive)
            arms, levels_ = terms.moment_arms, np.diag(term.by_row(term.level, names))
            per_length = (gain / terms.path_length)[:, None, None, :]
            matrices = of_unknowns(terms.curvature + arms[:, :, None] * arms[:, None] * per_length)
            passive = np.diag(term.by_row(term.passive_stiffness, names))
            constant = terms.constant + passive - levels_
        else:
            found = term.stability_rows(motion)
            passive = term.by_row(term.passive_stiffness, found.rows)
            rows = of_unknowns(geometric_stability(found, gain))
            levels = found.external_work - passive + term.by_row(term.level, found.rows)
    (effort,) = problem.objectives
    assert isinstance(effort, ActivationEffort)
    return Question(
        equations=equations,
        moments=t.generalized_forces,
        rows=rows,
        levels=levels,
        matrices=matrices,
        constant=constant,
        lower=np.concatenate([muscles.min_activation, actuators.min_control]),
        upper=np.concatenate([muscles.max_activation, actuators.max_control]),
        exponent=effort.exponent,
        capacity=capacity,
    )
