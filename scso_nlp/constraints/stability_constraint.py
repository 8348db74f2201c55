"""What all stability constraints have in common: the rotational stiffness of a joint has a least level.

The formulations differ only in the ways to turn that they look at: about joint axes
(:class:`JointStability`), along single coordinates (:class:`CoordinateStability`), or along any
combination of coordinates (:class:`HessianStability`).
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scso_nlp.constraints.constraint import FrameConstraint, require_price
from scso_nlp.exceptions import ProblemError
from scso_nlp.frame import Frame, MatrixRows, Rows
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.stiffness_law import ProportionalStiffness, StiffnessLaw
from scso_nlp.stability.buckling import buckling_factor
from scso_nlp.stability.rows import StabilityRows
from scso_nlp.validation import FloatArray, by_name

#: A meaningful difference of rotational stiffness [N·m/rad].
STABILITY_SCALE = 10.0


@dataclass(frozen=True, kw_only=True)
class StabilityConstraint(FrameConstraint):
    r"""Rotational stability along every chosen way to turn is at least `level`.   depends on: one frame.

    .. math:: S_i = \sum_m \left(F_m \frac{\partial^2\ell_m}{\partial\theta_i^2} + k_m r_{im}^2\right)
              + K_i - EW_i \ge \text{level}_i

    with the muscle stiffness k of the stiffness law, passive stiffness K and external work EW.

    Attributes
    ----------
    q : float, sequence of float, mapping of str to float, or None [-]
        Gain of :class:`ProportionalStiffness`, short for ``stiffness=ProportionalStiffness(q=q)``. None: 5.
    stiffness : StiffnessLaw or None
        Any other law, instead of `q`. None: :class:`ProportionalStiffness`.
    level : float or mapping of str to float [N·m/rad]
        Least stability, the same for all rows or by row name or pattern (rows not named get 0).
    passive_stiffness : mapping of str to float, or None [N·m/rad]
        Stiffness that tissue without activation adds to rows, by name or pattern.
    passive_factor : float [-]
        All passive stiffness, also the model's own, counts so much: published numbers are of other people's
        tissue, and 1/2 and 1/4 of them say how far an answer rests on them.
    soft : float or None [objective per N·m/rad]
        If given, a row may miss its level at this price; the amounts are in
        ``solution.variables["<name>.missed"]``.
    label : str
        Name in reports, needed where a problem has two constraints of one kind.

    Raises
    ------
    ProblemError
        A level, gain, passive stiffness or price that is not finite or negative where it must not be; both
        `q` and `stiffness`.
    NameMismatchError
        Unknown row or muscle.
    """

    q: float | Sequence[float] | Mapping[str, float] | None = None
    stiffness: StiffnessLaw | None = None
    level: float | Mapping[str, float] = 0.0
    passive_stiffness: Mapping[str, float] | None = None
    passive_factor: float = 1.0
    soft: float | None = None
    label: str = ""

    def __post_init__(self) -> None:
        if self.q is not None:
            ProportionalStiffness(q=self.q)
            if self.stiffness is not None:
                law = type(self.stiffness).__name__
                raise ProblemError(f"q has no effect where stiffness is {law}: leave one of them out")
        levels = self.level.values() if isinstance(self.level, Mapping) else [self.level]
        for value in levels:
            if not math.isfinite(value):
                raise ProblemError(f"level is {value:g} N·m/rad, expected a finite number")
        for name, value in (self.passive_stiffness or {}).items():
            if not (math.isfinite(value) and value >= 0):
                raise ProblemError(f"passive_stiffness of {name!r} is {value:g}, expected at least 0 N·m/rad")
        if not (math.isfinite(self.passive_factor) and self.passive_factor >= 0):
            raise ProblemError(f"passive_factor is {self.passive_factor:g}, expected a number of at least 0")
        require_price(self.soft, "N·m/rad")

    @property
    def stiffness_law(self) -> StiffnessLaw:
        """Law in use."""
        if self.stiffness is not None:
            return self.stiffness
        return ProportionalStiffness() if self.q is None else ProportionalStiffness(q=self.q)

    @abc.abstractmethod
    def row_names(self, motion: Motion) -> tuple[str, ...]:
        """Names of the rows: joint axes or coordinates."""

    @abc.abstractmethod
    def stability_rows(self, motion: Motion) -> StabilityRows:
        """Curvature, moment arms and external work of the rows, each taken alone."""

    def by_row(self, values: float | Mapping[str, float] | None, names: Sequence[str]) -> FloatArray:
        """Spread one value, or values by name or pattern, over rows; shape (n_rows,)."""
        if not isinstance(values, Mapping):
            return np.full(len(names), float(values or 0.0))
        return by_name("stability row", values, names, default=0.0)

    def passive_by_row(self, names: Sequence[str]) -> FloatArray:
        """Passive stiffness given for rows, times its factor; shape (n_rows,) [N·m/rad]."""
        return self.passive_factor * self.by_row(self.passive_stiffness, names)

    @abc.abstractmethod
    def passive_and_taken(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Give passive stiffness, and what loads take away; shape (n_frames, n_rows, n_rows) [N·m/rad]."""

    def passive_buckling(self, motion: Motion) -> FloatArray:
        """Factor of the loads at which passive tissue alone buckles, without any muscle.

        Parameters
        ----------
        motion : Motion

        Returns
        -------
        ndarray, shape (n_frames,) [-]
            Below 1, muscles are needed; see :func:`scso_nlp.stability.buckling_factor`.
        """
        return buckling_factor(*self.passive_and_taken(motion))

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give curvature and squared moment arms by row and muscle, and loads by row."""
        rows = self.stability_rows(motion)
        return {
            "curvature": rows.curvature,
            "squared_moment_arms": rows.moment_arms**2,
            "load": rows.external_work - self.passive_by_row(rows.rows),
            **self.stiffness_law.data(motion),
        }

    def rows(self, frame: Frame, motion: Motion) -> Rows | MatrixRows:
        """One row per way to turn, in N·m/rad; the stiffness of every muscle [N/m] beside them."""
        stiffness = self.stiffness_law.stiffness(frame, motion)
        names, data = self.row_names(motion), frame.data
        value = (
            data["curvature"] @ frame.muscle.tendon_force
            + data["squared_moment_arms"] @ stiffness
            - data["load"]
        )
        return Rows(
            value=value,
            lower=self.by_row(self.level, names),
            upper=np.inf,
            names=names,
            unit="N·m/rad",
            scale=STABILITY_SCALE,
            price=self.soft,
            quantities={"muscle_stiffness": stiffness},
        )
