"""Terms that look at two frames, or are not affine: the package has no such term of its own yet."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

import scso_nlp as scso


@dataclass(frozen=True, kw_only=True)
class Smoothness(scso.FramePairObjective):
    """Squared rate of change of activation."""

    weight: float = 1.0

    def value(self, previous, current, dt):
        return ca.sumsqr(current.activation - previous.activation) / dt


@dataclass(frozen=True, kw_only=True)
class WeightedDrift(scso.FramePairObjective):
    """A pair cost that sees data of both frames: the earlier length and the later velocity."""

    weight: float = 1.0

    def value(self, previous, current, dt):
        earlier = ca.dot(previous.muscle_tendon_length, previous.activation**2)
        return earlier + dt * ca.dot(current.muscle_tendon_velocity, current.activation) ** 2


@dataclass(frozen=True, kw_only=True)
class RateLimit(scso.FramePairConstraint):
    """Activation changes at most this fast."""

    fastest: float = 1.0

    def rows(self, previous, current, dt, motion):
        return scso.Rows(
            value=(current.activation - previous.activation) / dt,
            lower=-self.fastest,
            upper=self.fastest,
            names=motion.muscles.muscles,
            unit="1/s",
            scale=2.0,
        )


@dataclass(frozen=True, kw_only=True)
class CappedEffort(scso.FrameConstraint):
    """Sum of squared activations at most this large, and a product of controls: rows that are curved."""

    most: float = 1.0

    def rows(self, frame, motion):
        return scso.Rows(
            value=ca.vertcat(ca.sumsqr(frame.activation), frame.activation[0] * frame.activation[1]),
            lower=-np.inf,
            upper=[self.most, 2.0],
            names=("squares", "product"),
            unit="-",
            scale=0.5,
        )


@dataclass(frozen=True, kw_only=True)
class CurvedPair(scso.FramePairConstraint):
    """A curved row of two frames."""

    def rows(self, previous, current, dt, motion):
        return scso.Rows(
            value=previous.activation[0] * current.activation[1] / dt,
            lower=-np.inf,
            upper=1e3,
            names=("product",),
            unit="1/s",
        )
