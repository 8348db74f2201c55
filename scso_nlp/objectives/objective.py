"""Abstract objectives: one frame, or two neighbouring frames.

A new objective is one file here, one line in ``objectives/__init__.py`` and one test.
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


class Objective(abc.ABC):
    """What every objective has: a weight, and unknowns and data of its own if it asks for them."""

    weight: float

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


class FrameObjective(Objective):
    """A cost that looks at one frame."""

    @abc.abstractmethod
    def value(self, frame: Frame) -> ca.SX:
        """Cost of one frame, a scalar, before the weight."""

    def rows(self, frame: Frame) -> Rows | None:
        """Rows that the term's own unknowns must satisfy; none by default."""
        return None

    def gentler(self) -> FrameObjective | None:
        """Return a nearby cost that is easier to minimise and gives a good start, or None."""
        return None


class FramePairObjective(Objective):
    """A cost that looks at two neighbouring frames; it couples the whole motion."""

    @abc.abstractmethod
    def value(self, previous: Frame, current: Frame, dt: ca.SX) -> ca.SX:
        """Cost of one pair of frames `dt` seconds apart, a scalar, before the weight."""
