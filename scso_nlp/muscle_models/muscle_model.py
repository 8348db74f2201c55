"""Abstract muscle model: what force an activation makes in a frame.

A new model is one file here, one line in ``scso_nlp/__init__.pyi`` and one test file.
"""

from __future__ import annotations

import abc

from scso_nlp.frame import Frame, MuscleState, Rows, Term
from scso_nlp.motion import Motion


class MuscleModel(Term, abc.ABC):
    """From activations and path kinematics to tendon forces."""

    @abc.abstractmethod
    def state(self, frame: Frame, motion: Motion) -> MuscleState:
        """Tendon forces and what else the model knows; ``frame.muscle`` is not set yet."""

    def rows(self, frame: Frame, motion: Motion) -> Rows | None:
        """Rows that the model's unknowns must satisfy, e.g. fiber force = tendon force; none by default."""
        return None
