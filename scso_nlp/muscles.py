"""Constants of the muscles and of the other actuators of a model.

Time series are in :mod:`scso_nlp.trajectory`; what a muscle does with these constants is in
:mod:`scso_nlp.muscle_models`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.display import card, table, without_arrays
from scso_nlp.exceptions import DataError
from scso_nlp.validation import FloatArray, read_only, unique_names


@dataclass(frozen=True, kw_only=True)
@checked
class MuscleParameters:
    """Constants of every muscle, as OpenSim uses them after its own finalize step.

    Attributes
    ----------
    muscles : tuple of str
        Names, in the order of the model's force set.
    muscle_class : tuple of str
        OpenSim class of each muscle, e.g. ``"Millard2012EquilibriumMuscle"``.
    max_isometric_force : ndarray, shape (n_muscles,) [N]
    optimal_fiber_length : ndarray, shape (n_muscles,) [m]
    tendon_slack_length : ndarray, shape (n_muscles,) [m]
    pennation_angle_at_optimal : ndarray, shape (n_muscles,) [rad]
    max_contraction_velocity : ndarray, shape (n_muscles,) [1/s]
        In optimal fiber lengths per second. Zero in models of deprecated muscle classes; muscle models with
        force-velocity curves of their own refuse that.
    min_activation, max_activation : ndarray, shape (n_muscles,) [-]
        Bounds: OpenSim's ``min_control`` and ``max_control``.
    activation_time_constant, deactivation_time_constant : ndarray, shape (n_muscles,) [s]
    curve_parameters : tuple of mappings, one per muscle [mixed]
        Effective shape parameters of the muscle's curves by OpenSim property name.
    """

    muscles: tuple[str, ...]
    muscle_class: tuple[str, ...]
    max_isometric_force: FloatArray
    optimal_fiber_length: FloatArray
    tendon_slack_length: FloatArray
    pennation_angle_at_optimal: FloatArray
    max_contraction_velocity: FloatArray
    min_activation: FloatArray
    max_activation: FloatArray
    activation_time_constant: FloatArray
    deactivation_time_constant: FloatArray
    curve_parameters: tuple[Mapping[str, float], ...] = ()

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "muscles", unique_names("muscle", self.muscles))
        n = len(self.muscles)
        set_field(self, "muscle_class", tuple(self.muscle_class))
        curves = (
            tuple(MappingProxyType(dict(c)) for c in self.curve_parameters) or (MappingProxyType({}),) * n
        )
        set_field(self, "curve_parameters", curves)
        for name in ("muscle_class", "curve_parameters"):
            if len(getattr(self, name)) != n:
                raise DataError(
                    f"{name} has {len(getattr(self, name))} entries, expected one per muscle ({n})"
                )
        for name in (
            "max_isometric_force",
            "optimal_fiber_length",
            "tendon_slack_length",
            "pennation_angle_at_optimal",
            "max_contraction_velocity",
            "min_activation",
            "max_activation",
            "activation_time_constant",
            "deactivation_time_constant",
        ):
            set_field(self, name, read_only(name, getattr(self, name), (n,), "n_muscles"))
        for name in ("max_isometric_force", "optimal_fiber_length"):
            _refuse(self.muscles, name, getattr(self, name) <= 0, getattr(self, name), "must be positive")
        for name in ("tendon_slack_length", "max_contraction_velocity"):
            _refuse(self.muscles, name, getattr(self, name) < 0, getattr(self, name), "must not be negative")
        _refuse(
            self.muscles,
            "min_activation",
            self.min_activation > self.max_activation,
            self.min_activation,
            "must not exceed max_activation",
        )

    @property
    def n_muscles(self) -> int:
        """Number of muscles."""
        return len(self.muscles)

    def __repr__(self) -> str:
        kinds = {name: self.muscle_class.count(name) for name in dict.fromkeys(self.muscle_class)}
        return f"{self.n_muscles} muscles: " + ", ".join(f"{n} {kind}" for kind, n in kinds.items())

    def _repr_html_(self) -> str:
        head = ("muscle", "class", "max isometric force [N]", "optimal fiber length [m]",
                "tendon slack length [m]", "pennation angle at optimal [rad]")  # fmt: skip
        numbers = np.column_stack(
            [
                self.max_isometric_force,
                self.optimal_fiber_length,
                self.tendon_slack_length,
                self.pennation_angle_at_optimal,
            ]
        ).tolist()
        rows = [(*row[:2], *row[2]) for row in zip(self.muscles, self.muscle_class, numbers, strict=True)]
        return card(repr(self), table(head, rows))


@dataclass(frozen=True, kw_only=True)
@checked
class ActuatorParameters:
    """Reserve, residual and other scalar actuators that are not muscles.

    Attributes
    ----------
    actuators : tuple of str
        Names, in the order of the model's force set.
    optimal_force : ndarray, shape (n_actuators,) [N or N·m]
        Force at a control of one.
    min_control, max_control : ndarray, shape (n_actuators,) [-]
        Bounds; infinite where OpenSim has none.
    """

    actuators: tuple[str, ...] = ()
    optimal_force: FloatArray = field(default_factory=lambda: np.zeros(0))
    min_control: FloatArray = field(default_factory=lambda: np.zeros(0))
    max_control: FloatArray = field(default_factory=lambda: np.zeros(0))

    __repr__ = without_arrays

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "actuators", unique_names("actuator", self.actuators))
        n = len(self.actuators)
        for name, finite in (("optimal_force", True), ("min_control", False), ("max_control", False)):
            set_field(self, name, read_only(name, getattr(self, name), (n,), "n_actuators", finite=finite))
        unordered = ~(self.min_control <= self.max_control)
        _refuse(self.actuators, "min_control", unordered, self.min_control, "must not exceed max_control")

    @property
    def n_actuators(self) -> int:
        """Number of actuators."""
        return len(self.actuators)


def _refuse(names: tuple[str, ...], what: str, bad: np.ndarray, values: FloatArray, rule: str) -> None:
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        raise DataError(f"{what} of {names[first]!r} is {values[first]:g}, {rule}")
