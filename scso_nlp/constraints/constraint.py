"""Abstract constraints: rows of one frame, or of two neighbouring frames.

A new constraint is one file here, one line in ``scso_nlp/__init__.pyi`` and one test file.
"""

from __future__ import annotations

import abc
import math

import casadi as ca

from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, MatrixRows, Rows, Term
from scso_nlp.motion import Motion


class FrameConstraint(Term, abc.ABC):
    """Rows that look at one frame."""

    @abc.abstractmethod
    def rows(self, frame: Frame, motion: Motion) -> Rows | MatrixRows:
        """Rows of one frame, or one matrix inequality; `motion` is for names and units only."""


class FramePairConstraint(Term, abc.ABC):
    """Rows that look at two neighbouring frames; they couple the whole motion."""

    @abc.abstractmethod
    def rows(self, previous: Frame, current: Frame, dt: ca.SX, motion: Motion) -> Rows:
        """Rows of one pair of frames `dt` seconds apart; `motion` is for names and units only."""


def require_price(soft: float | None, per: str) -> None:
    """Refuse a price of missing rows that is not positive; `per` is what it is paid for."""
    if soft is not None and not (math.isfinite(soft) and soft > 0):
        raise ProblemError(f"soft is {soft:g}, expected a positive price per {per}, or no price")
