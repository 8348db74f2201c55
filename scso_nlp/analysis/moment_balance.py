"""Who produces the moment of each coordinate: muscles or reserves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.solution import Solution
from scso_nlp.validation import FloatArray

#: A coordinate whose required moment stays below this has no share [N·m or N].
NEGLIGIBLE_MOMENT = 1e-9


@dataclass(frozen=True, kw_only=True)
class MomentBalance:
    """Required, muscle and actuator moment of every coordinate.

    Attributes
    ----------
    coordinates : tuple of str
    unit : tuple of str
        ``"N·m"`` or ``"N"``, one per coordinate.
    required : ndarray, shape (n_frames, n_coordinates) [N·m or N]
        What muscles and actuators together must produce.
    muscles, actuators : ndarray, shape (n_frames, n_coordinates) [N·m or N]
        What they produce; NaN in frames that are not solved.
    """

    coordinates: tuple[str, ...]
    unit: tuple[str, ...]
    required: FloatArray
    muscles: FloatArray
    actuators: FloatArray

    @property
    def actuator_share(self) -> FloatArray:
        """Root mean square of the actuators' moment over that of the required one.

        Returns
        -------
        ndarray, shape (n_coordinates,) [-]
            Over the solved frames; NaN where nothing is required or no frame is solved.
        """
        solved = np.isfinite(self.muscles).all(axis=1)
        if not solved.any():
            return np.full(len(self.coordinates), np.nan)
        required = np.sqrt(np.mean(self.required[solved] ** 2, axis=0))
        actuators = np.sqrt(np.mean(self.actuators[solved] ** 2, axis=0))
        share = np.full(required.shape, np.nan)
        np.divide(actuators, required, out=share, where=required > NEGLIGIBLE_MOMENT)
        return share


def moment_balance(solution: Solution) -> MomentBalance:
    r"""Split the moment of each coordinate into what muscles and what actuators produce.

    .. math:: M = R F + A c

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    MomentBalance

    Notes
    -----
    Reserves and residuals are actuators; a large share means that the muscle forces do not explain the
    motion, whatever the solver's status.
    """
    trajectory = solution.problem.trajectory
    failed = ~solution.is_solved
    muscles = np.einsum("kcm,km->kc", trajectory.moment_arms, solution.tendon_force)
    actuators = np.einsum("kca,ka->kc", trajectory.actuator_generalized_forces, solution.control)
    muscles[failed] = np.nan
    actuators[failed] = np.nan
    return MomentBalance(
        coordinates=trajectory.coordinates,
        unit=tuple("N·m" if angle else "N" for angle in trajectory.is_rotational),
        required=trajectory.generalized_forces,
        muscles=muscles,
        actuators=actuators,
    )
