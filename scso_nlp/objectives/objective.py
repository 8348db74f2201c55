"""Abstract objectives: one frame, or two neighbouring frames.

A new objective is one file here, one line in ``scso_nlp/__init__.pyi`` and one test file.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping

import casadi as ca

from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, Rows, Term


class FrameObjective(Term, abc.ABC):
    """A cost that looks at one frame; `weight` multiplies it."""

    weight: float

    @property
    def degree(self) -> float | None:
        """Say d if unknowns that are all s times as large, s > 0, cost s^d times as much; else None."""
        return None

    @abc.abstractmethod
    def value(self, frame: Frame) -> ca.SX:
        """Cost of one frame, a scalar, before the weight."""

    def rows(self, frame: Frame) -> Rows | None:
        """Rows that the term's own unknowns must satisfy; none by default."""
        return None

    def gentler(self) -> FrameObjective | None:
        """Return a nearby cost that is easier to minimise and gives a good start, or None."""
        return None


class FramePairObjective(Term, abc.ABC):
    """A cost that looks at two neighbouring frames; it couples the whole motion; `weight` multiplies it."""

    weight: float

    @abc.abstractmethod
    def value(self, previous: Frame, current: Frame, dt: ca.SX) -> ca.SX:
        """Cost of one pair of frames `dt` seconds apart, a scalar, before the weight."""


def require_weights(weight: float, by_name: Mapping[str, float] | None = None) -> None:
    """Refuse weights, of a term and of what it sums, that are negative or not finite."""
    named = {f"weight of {name!r}": value for name, value in (by_name or {}).items()}
    for what, value in {**named, "weight": weight}.items():
        if not (math.isfinite(value) and value >= 0):
            raise ProblemError(f"{what} is {value:g}, expected a finite number of at least 0")
