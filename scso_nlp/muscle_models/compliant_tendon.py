"""Force-length with an elastic tendon in quasi-static equilibrium: fiber length is an unknown."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.muscle_models.hill_muscle import equilibrium_residual, solve_equilibrium, tendon_force
from scso_nlp.muscle_models.muscle_classes import MuscleGroup, muscle_groups
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.muscle_models.pennation import fiber_length_of, fiber_width
from scso_nlp.transcription.frame import Frame, MuscleState, Rows, VariableSpec
from scso_nlp.validation import FloatArray

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem

_LOG = logging.getLogger("scso_nlp")

#: Activation at which the fibers of the starting point are in equilibrium [-].
_GUESS_ACTIVATION = 0.1

#: A fiber along the tendon is never shorter than this share of its optimal length [-].
_LEAST_FIBER = 0.02


@dataclass(frozen=True, kw_only=True)
class CompliantTendon(MuscleModel):
    r"""Fiber and tendon in equilibrium in every frame, with fiber length as an unknown.

    .. math:: F_0\left(a f_L f_V + f_P + \beta\tilde v\right)\cos\alpha
              = F_0 f_T\left((\ell^{MT} - \ell^M\cos\alpha)/\ell_s^T\right)

    The unknown is the fiber length along the tendon, :math:`\ell^M\cos\alpha`.

    Attributes
    ----------
    fiber_velocity : "zero" or "from_path"
        ``"zero"``: static fibers. ``"from_path"``: the tendon keeps its length in time, so the fiber
        takes the whole velocity of the path.

    Raises
    ------
    DataError
        A muscle class without curves or without an elastic tendon, a constant without meaning, or a
        path that is shorter than its shortest fiber.

    References
    ----------
    Millard et al. (2013), J Biomech Eng 135:021005; De Groote et al. (2016), Ann Biomed Eng 44:2922-2936.
    """

    fiber_velocity: Literal["zero", "from_path"] = "zero"

    def __post_init__(self) -> None:
        if self.fiber_velocity not in ("zero", "from_path"):
            raise ProblemError(f"fiber_velocity is {self.fiber_velocity!r}, expected 'zero' or 'from_path'")

    def variables(self, problem: MuscleForceProblem) -> tuple[VariableSpec, ...]:
        """Name the fiber lengths along the tendon [m], with their bounds and the starting point."""
        trajectory, muscles = problem.trajectory, problem.muscles
        length = trajectory.muscle_tendon_length
        lower = np.zeros(muscles.n_muscles)
        guess = np.zeros(length.shape)
        for group in _elastic_groups(problem):
            where = group.positions
            shortest = ca.DM(group.muscle.curves.min_fiber_length(group.muscle)).full().ravel()
            width = ca.DM(fiber_width(group.muscle)).full().ravel()
            bound = np.sqrt(np.maximum(shortest**2 - width**2, 0.0))
            lower[where] = np.maximum(bound, _LEAST_FIBER * muscles.optimal_fiber_length[where])
            at_rest = solve_equilibrium(
                group.muscle,
                np.full(length[:, where].shape, _GUESS_ACTIVATION),
                length[:, where],
                self._velocity(problem)[:, where],
            )
            guess[:, where] = at_rest.fiber_length_along_tendon
        too_short = length <= lower
        if too_short.any():
            frame, m = (int(i) for i in np.argwhere(too_short)[0])
            raise DataError(
                f"the path of {muscles.muscles[m]!r} is {length[frame, m]:g} m long at t = "
                f"{trajectory.time[frame]:g} s, shorter than its shortest fiber of {lower[m]:g} m"
            )
        guess = np.clip(guess, lower * (1 + 1e-6), length)
        return (
            VariableSpec(
                name="fiber_length_along_tendon",
                labels=tuple(f"{name}_fiber" for name in muscles.muscles),
                lower=np.broadcast_to(lower, length.shape),
                upper=length,
                guess=guess,
                scale=muscles.optimal_fiber_length,
            ),
        )

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Give the velocity that the fibers are to have, along the path, shape (n_frames, n_muscles) [m/s]."""
        return {"velocity": self._velocity(problem)}

    def _velocity(self, problem: MuscleForceProblem) -> FloatArray:
        velocity = problem.trajectory.muscle_tendon_velocity
        return np.zeros(velocity.shape) if self.fiber_velocity == "zero" else velocity

    def state(self, frame: Frame, problem: MuscleForceProblem) -> MuscleState:
        """Tendon force and fiber length of one frame."""
        n = problem.muscles.n_muscles
        force, passive, fiber_length, cosine = (ca.SX(n, 1) for _ in range(4))
        for group in _elastic_groups(problem):
            where = group.positions.tolist()
            muscle, curves = group.muscle, group.muscle.curves
            q = frame.variables["fiber_length_along_tendon"][where]
            fiber = fiber_length_of(q, fiber_width(muscle))
            fiber_length[where] = fiber
            cosine[where] = q / fiber
            force[where] = tendon_force(muscle, q, frame.muscle_tendon_length[where])
            passive[where] = (
                muscle.max_isometric_force
                * curves.passive_force_length(fiber / muscle.optimal_fiber_length, muscle.curve_parameters)
                * q
                / fiber
            )
        return MuscleState(
            tendon_force=force, passive_force=passive, fiber_length=fiber_length, cos_pennation_angle=cosine
        )

    def rows(self, frame: Frame, problem: MuscleForceProblem) -> Rows:
        """One row per muscle: fiber force along the tendon minus tendon force, over F0."""
        residual = ca.SX(problem.muscles.n_muscles, 1)
        for group in _elastic_groups(problem):
            where = group.positions.tolist()
            residual[where] = equilibrium_residual(
                group.muscle,
                frame.variables["fiber_length_along_tendon"][where],
                frame.activation[where],
                frame.muscle_tendon_length[where],
                frame.data["velocity"][where],
            )
        return Rows(value=residual, lower=0.0, upper=0.0, names=problem.muscles.muscles, unit="F0", scale=1.0)


def _elastic_groups(problem: MuscleForceProblem) -> tuple[MuscleGroup, ...]:
    groups = muscle_groups(problem.muscles)
    for group in groups:
        if not group.muscle.curves.HAS_ELASTIC_TENDON:
            name = problem.muscles.muscles[group.positions[0]]
            raise DataError(
                f"muscle {name!r} is a {group.muscle.curves.OPENSIM_CLASS}, which has no elastic tendon; "
                "use RigidTendon"
            )
    return groups
