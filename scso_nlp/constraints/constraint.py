"""Abstract constraints: rows of one frame, or of two neighbouring frames.

A new constraint is one file here, one line in ``constraints/__init__.py`` and one test.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING

import casadi as ca

from scso_nlp.transcription.frame import Frame, Rows, VariableSpec
from scso_nlp.validation import FloatArray

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem
    from scso_nlp.transcription.local_model import LocalModel


class Constraint:
    """What every constraint has: a name, and unknowns and data of its own if it asks for them."""

    @property
    def name(self) -> str:
        """Name in reports: the term's label if it has one, or the name of its class."""
        return getattr(self, "label", "") or type(self).__name__

    def variables(self, problem: MuscleForceProblem) -> tuple[VariableSpec, ...]:
        """Name unknowns that the term adds to every frame; none by default."""
        return ()

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Give data per frame, each of shape (n_frames, …), for ``frame.data``; none by default."""
        return {}

    def notes(self, problem: MuscleForceProblem) -> tuple[str, ...]:
        """Say in sentences what a user should know of the choices made, once per solve; none by default."""
        return ()


class FrameConstraint(Constraint, abc.ABC):
    """Rows that look at one frame."""

    @abc.abstractmethod
    def rows(self, frame: Frame, problem: MuscleForceProblem) -> Rows:
        """Rows of one frame; `problem` is for names and units only."""

    def penalty(self, frame: Frame) -> ca.SX | None:
        """Cost of what the constraint lets pass, a scalar; None by default."""
        return None

    def quantities(self, frame: Frame, problem: MuscleForceProblem) -> Mapping[str, ca.SX]:
        """Name columns to be evaluated at the solution, for ``solution.quantities``; none by default."""
        return {}

    def doubtful_frames(self, problem: MuscleForceProblem) -> tuple[int, ...]:
        """Name frames that the rows probably make infeasible, to be tested first; none by default."""
        return ()

    def row_label(self, problem: MuscleForceProblem, frame: int, row: int) -> str | None:
        """Say what a row is in one frame, for messages; None where its name says it all, by default."""
        return None

    def tighten(self, problem: MuscleForceProblem, near: LocalModel) -> FrameConstraint | None:
        """Return a constraint with more rows, or None if the rows suffice near a point; None by default.

        For constraints whose rows cannot all be written down beforehand. The solver asks once at the
        starting point, and after each solve.
        """
        return None


class FramePairConstraint(Constraint, abc.ABC):
    """Rows that look at two neighbouring frames; they couple the whole motion."""

    @abc.abstractmethod
    def rows(self, previous: Frame, current: Frame, dt: ca.SX, problem: MuscleForceProblem) -> Rows:
        """Rows of one pair of frames `dt` seconds apart; `problem` is for names and units only."""
