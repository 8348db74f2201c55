"""The language of terms: what objectives, constraints and muscle models see, and how they answer.

A term sees the motion (names, units, arrays of all frames) and the symbols of one frame; never the problem,
the solver, a frame index or a scaling.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.motion import Motion
from scso_nlp.needs import MotionNeeds
from scso_nlp.validation import FloatArray


class Term:
    """What every term has: a name, and unknowns and data of its own if it asks for them."""

    @property
    def name(self) -> str:
        """Name in reports: the term's label if it has one, or the name of its class."""
        return getattr(self, "label", "") or type(self).__name__

    @property
    def needs(self) -> MotionNeeds:
        """What is to be computed of a motion for the term; nothing more by default."""
        return MotionNeeds()

    def variables(self, motion: Motion) -> tuple[VariableSpec, ...]:
        """Name unknowns that the term adds to every frame; none by default."""
        return ()

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give data per frame, each of shape (n_frames, …), for ``frame.data``; none by default."""
        return {}

    def unseen(self, motion: Motion) -> tuple[str, ...]:
        """Name constants of muscles that the term's data depend on without a symbol; none by default."""
        return ()

    def notes(self, motion: Motion) -> tuple[str, ...]:
        """Say in sentences what a user should know of the choices made, once per solve; none by default."""
        return ()


@dataclass(frozen=True, kw_only=True)
@checked
class VariableSpec:
    """Unknowns that a term or muscle model adds to every frame.

    Attributes
    ----------
    name : str
        Key in ``frame.variables`` of the term that asked for them.
    labels : tuple of str
        One name per unknown; their number is the number of unknowns.
    lower, upper, guess : float or ndarray, shape (n,) or (n_frames, n)
        Bounds and starting point.
    scale : float or ndarray, shape (n,)
        Size of a meaningful change; the solver sees the unknown divided by it.
    follows : "" or "activation" or "control"
        Unknowns of the problem, as many, that these are near to where frames are solved without coupling.
    """

    name: str
    labels: tuple[str, ...]
    lower: float | FloatArray = -np.inf
    upper: float | FloatArray = np.inf
    guess: float | FloatArray = 0.0
    scale: float | FloatArray = 1.0
    follows: Literal["", "activation", "control"] = ""


@dataclass(frozen=True, kw_only=True)
@checked
class MuscleState:
    """What the muscle model says of one frame; columns of shape (n_muscles, 1).

    Attributes
    ----------
    tendon_force : ca.SX [N]
        Tension that acts on the bones.
    passive_force : ca.SX [N]
        Share of `tendon_force` that does not depend on activation; zeros where there is none.
    fiber_length, cos_pennation_angle : ca.SX or None [m], [-]
        Known to models with a fiber.
    """

    tendon_force: ca.SX
    passive_force: ca.SX
    fiber_length: ca.SX | None = None
    cos_pennation_angle: ca.SX | None = None


def as_number(name: str, values: Any) -> ca.DM:
    """Give a constant as the numbers it has."""
    return ca.DM(values)


@dataclass(frozen=True, kw_only=True)
@checked
class Frame:
    """Symbols of one frame. Columns of shape (n, 1) unless a shape is given.

    Attributes
    ----------
    activation : ca.SX, shape (n_muscles, 1) [-]
        Unknown.
    control : ca.SX, shape (n_actuators, 1) [-]
        Unknown: controls of reserves and other actuators; force = control × optimal force.
    moment_arms : ca.SX, shape (n_coordinates, n_muscles) [m]
        Given.
    actuator_generalized_forces : ca.SX, shape (n_coordinates, n_actuators) [N·m or N]
        Given, per unit control.
    generalized_forces : ca.SX, shape (n_coordinates, 1) [N·m or N]
        Given: what muscles and actuators must produce.
    muscle_tendon_length, muscle_tendon_velocity : ca.SX, shape (n_muscles, 1) [m], [m/s]
        Given.
    muscle : MuscleState
        The muscle model's answer.
    variables : mapping of str to ca.SX
        Unknowns that this term asked for.
    data : mapping of str to ca.SX
        Per-frame data that this term asked for.
    constant : callable
        Takes the name and the values of a constant of the term, gives a column: these numbers, or a symbol
        that stands for them where a sensitivity to them is asked for.
    """

    activation: ca.SX
    control: ca.SX
    moment_arms: ca.SX
    actuator_generalized_forces: ca.SX
    generalized_forces: ca.SX
    muscle_tendon_length: ca.SX
    muscle_tendon_velocity: ca.SX
    muscle: MuscleState
    variables: Mapping[str, ca.SX] = field(default_factory=dict)
    data: Mapping[str, ca.SX] = field(default_factory=dict)
    constant: Callable[[str, Any], Any] = as_number


@dataclass(frozen=True, kw_only=True)
@checked
class Rows:
    """Inequalities or equations: ``lower <= value <= upper``, row by row.

    Attributes
    ----------
    value : ca.SX, shape (n_rows, 1)
    lower, upper : float or ndarray, shape (n_rows,)
    names : sequence of str
        One per row: a coordinate, a joint axis, a muscle.
    unit : str or sequence of str
        Unit of the rows, for reports.
    scale : float
        A meaningful residual in the row's unit; the solver sees the row divided by it.
    price : float or None [objective per unit]
        If given, `value` may fall below `lower` at this price per unit, each row by an amount of its own.
    quantities : mapping of str to ca.SX
        Columns to be evaluated at the solution, for ``solution.quantities["<term>.<name>"]``.
    """

    value: ca.SX
    lower: float | FloatArray
    upper: float | FloatArray
    names: Sequence[str]
    unit: str | Sequence[str] = ""
    scale: float = 1.0
    price: float | None = None
    quantities: Mapping[str, ca.SX] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
@checked
class MatrixRows:
    r"""A matrix inequality: :math:`H = K + \sum_j w_j M_j`, less its levels, is positive semi-definite.

    It stands for the rows :math:`v^T (H - \operatorname{diag}(\text{lower}))\, v \ge 0` of all v; the solver
    chooses those that decide. Symmetric matrices are given as lower triangles, column by column, with
    n (n + 1) / 2 entries.

    Attributes
    ----------
    weights : ca.SX, shape (n_weights,)
        w; all that depends on the unknowns.
    matrices : ndarray, shape (n_frames, n_entries, n_weights)
        M.
    constant : ndarray, shape (n_frames, n_entries)
        K.
    lower : float or ndarray, shape (n,)
    names : sequence of str
        What the n directions are called.
    unit : str
        Unit of the entries, for reports.
    scale : float
        A meaningful difference of an eigenvalue in this unit; the solver sees rows divided by it.
    price : float or None [objective per unit]
        If given, the smallest eigenvalue may be negative at this price per unit.
    quantities : mapping of str to ca.SX
        As for :class:`Rows`.
    """

    weights: ca.SX
    matrices: FloatArray
    constant: FloatArray
    lower: float | FloatArray
    names: Sequence[str]
    unit: str = ""
    scale: float = 1.0
    price: float | None = None
    quantities: Mapping[str, ca.SX] = field(default_factory=dict)
