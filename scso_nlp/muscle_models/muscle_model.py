"""Abstract muscle model: what force an activation makes in a frame.

A new model is one file here, one line in ``muscle_models/__init__.py`` and one test.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING

from scso_nlp.transcription.frame import Frame, MuscleState, Rows, VariableSpec
from scso_nlp.validation import FloatArray

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem


class MuscleModel(abc.ABC):
    """From activations and path kinematics to tendon forces."""

    @property
    def name(self) -> str:
        """Name in reports."""
        return type(self).__name__

    def variables(self, problem: MuscleForceProblem) -> tuple[VariableSpec, ...]:
        """Name unknowns that the model adds to every frame; none by default."""
        return ()

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Give data per frame, each of shape (n_frames, …), for ``frame.data``; none by default."""
        return {}

    def notes(self, problem: MuscleForceProblem) -> tuple[str, ...]:
        """Say in sentences what a user should know of the choices made, once per solve; none by default."""
        return ()

    @abc.abstractmethod
    def state(self, frame: Frame, problem: MuscleForceProblem) -> MuscleState:
        """Tendon forces and what else the model knows; ``frame.muscle`` is not set yet."""

    def rows(self, frame: Frame, problem: MuscleForceProblem) -> Rows | None:
        """Rows that the model's unknowns must satisfy, e.g. fiber force = tendon force; none by default."""
        return None
