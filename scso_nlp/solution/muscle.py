"""One muscle of a solution, for people who think of muscles and not of columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.trajectory import time_text
from scso_nlp.validation import FloatArray


@dataclass(frozen=True, kw_only=True)
@checked
class MuscleResult:
    """One muscle over time; NaN in frames that are not solved.

    Attributes
    ----------
    name : str
    time : ndarray, shape (n_frames,) [s]
    activation : ndarray, shape (n_frames,) [-]
    tendon_force : ndarray, shape (n_frames,) [N]
    muscle_tendon_length : ndarray, shape (n_frames,) [m]
    excitation : ndarray, shape (n_frames,) [-], or None
        Known with :class:`~scso_nlp.ActivationDynamics`.
    fiber_length, tendon_strain : ndarray, shape (n_frames,) [m], [-], or None
        Known with :class:`~scso_nlp.CompliantTendon`.
    """

    name: str
    time: FloatArray
    activation: FloatArray
    tendon_force: FloatArray
    muscle_tendon_length: FloatArray
    excitation: FloatArray | None = None
    fiber_length: FloatArray | None = None
    tendon_strain: FloatArray | None = None

    def __repr__(self) -> str:
        text = f"{self.name}: {len(self.time)} frames"
        if not np.isfinite(self.activation).any():
            return f"{text}, none solved"
        strongest = int(np.nanargmax(self.tendon_force))
        return (
            f"{text}, activation {np.nanmin(self.activation):.4g} to {np.nanmax(self.activation):.4g}, "
            f"tendon force up to {self.tendon_force[strongest]:.4g} N at t = "
            f"{time_text(self.time[strongest])} s"
        )
