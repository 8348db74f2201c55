"""A Hill-type muscle as OpenSim parameterizes it: what its class gives, and its constants.

Here: the contract of a muscle class (:class:`HillCurves`) and the constants of muscles
(:class:`HillMuscle`). Not here: the classes, one file each (`thelen2003`, `millard2012`, `degroote2016`,
`rigid_tendon_muscle`; `muscle_classes` lists them); what follows from the curves (`pennation`, `force`,
`equilibrium`, `stiffness`); what a trajectory does with them.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar

import casadi as ca

from scso_nlp.muscle_models.curves import CurveParameters, Expression


class HillCurves(abc.ABC):
    """The curves of one OpenSim muscle class: what every class gives.

    A new class is one file with one final subclass, one line in
    :data:`~scso_nlp.muscle_models.muscle_classes.MUSCLE_CLASSES` and one table of OpenSim's own values in
    the tests. A subclass documents what is particular to it: formula, source, values, where OpenSim departs
    from the paper.

    All curves are normalized and elementwise and accept float, DM, SX and MX. They are twice differentiable
    but for the kinks that a class names. `parameters` are always complete, as
    :meth:`check_curve_parameters` returns them, by OpenSim property name.

    Attributes
    ----------
    OPENSIM_CLASS : str
        OpenSim's name of the class.
    DEFAULT_CURVE_PARAMETERS : mapping of str to float [mixed]
        OpenSim's default of every parameter of the curves, by property name.
    HAS_ELASTIC_TENDON : bool
        False if the tendon is rigid: then the three tendon curves raise.
    FORCE_VELOCITY_DEPENDS_ON_ACTIVATION : bool
        True if force is not affine in activation.
    """

    OPENSIM_CLASS: ClassVar[str]
    DEFAULT_CURVE_PARAMETERS: ClassVar[Mapping[str, float]]
    HAS_ELASTIC_TENDON: ClassVar[bool]
    FORCE_VELOCITY_DEPENDS_ON_ACTIVATION: ClassVar[bool]

    @abc.abstractmethod
    def check_curve_parameters(self, muscle: str, parameters: Mapping[str, float]) -> dict[str, float]:
        """Fill in defaults and refuse curve parameters without a meaning.

        Parameters
        ----------
        muscle : str
            Name, for messages.
        parameters : mapping of str to float [mixed]
            Effective values by OpenSim property name.

        Returns
        -------
        dict of str to float [mixed]
            All parameters of the class, in the order of :attr:`DEFAULT_CURVE_PARAMETERS`.

        Raises
        ------
        DataError
            One sentence: an unknown name (the closest one is suggested), a value that is not finite or out
            of range, or a curve that would not be monotone where it must be.
        """

    @abc.abstractmethod
    def active_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Active force over maximum isometric force at zero velocity and full activation.

        Parameters
        ----------
        normalized_fiber_length : float or DM or SX or MX, any shape [-]
            Fiber length over optimal fiber length.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            1 at optimal fiber length.
        """

    @abc.abstractmethod
    def active_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """First derivative of the active force-length curve, itself twice differentiable.

        Parameters
        ----------
        normalized_fiber_length : float or DM or SX or MX, any shape [-]
            Fiber length over optimal fiber length.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            Positive on the ascending limb.
        """

    @abc.abstractmethod
    def passive_force_length(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Passive fiber force over maximum isometric force.

        Parameters
        ----------
        normalized_fiber_length : float or DM or SX or MX, any shape [-]
            Fiber length over optimal fiber length.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            Rises when stretched.
        """

    @abc.abstractmethod
    def passive_force_length_slope(
        self, normalized_fiber_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """First derivative of the passive force-length curve, itself twice differentiable.

        Parameters
        ----------
        normalized_fiber_length : float or DM or SX or MX, any shape [-]
            Fiber length over optimal fiber length.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            Not negative.
        """

    @abc.abstractmethod
    def force_velocity(
        self, normalized_fiber_velocity: Expression, parameters: CurveParameters, activation: Expression = 1.0
    ) -> Expression:
        """Force multiplier at a fiber velocity.

        Parameters
        ----------
        normalized_fiber_velocity : float or DM or SX or MX, any shape [-]
            Fiber velocity over the maximum contraction velocity, lengthening positive.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.
        activation : float or DM or SX or MX, same shape [-]
            Used if :attr:`FORCE_VELOCITY_DEPENDS_ON_ACTIVATION`; 1 in OpenSim's static optimization.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            0 at -1 (at full activation), 1 at 0, more when lengthening.
        """

    @abc.abstractmethod
    def tendon_force_length(
        self, normalized_tendon_length: Expression, parameters: CurveParameters
    ) -> Expression:
        """Tendon force over maximum isometric force.

        Parameters
        ----------
        normalized_tendon_length : float or DM or SX or MX, any shape [-]
            Tendon length over slack length.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            0 at slack length.

        Raises
        ------
        DataError
            The class has no elastic tendon.
        """

    @abc.abstractmethod
    def inverse_tendon_force_length(
        self, normalized_force: Expression, parameters: CurveParameters
    ) -> Expression:
        """Tendon length over slack length at a tendon force.

        Parameters
        ----------
        normalized_force : float or DM or SX or MX, any shape [-]
            Tendon force over maximum isometric force.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            1 at zero force.

        Raises
        ------
        DataError
            The class has no elastic tendon.
        """

    @abc.abstractmethod
    def tendon_slope_at_force(self, normalized_force: Expression, parameters: CurveParameters) -> Expression:
        """Slope of the tendon curve as a function of tendon force.

        Parameters
        ----------
        normalized_force : float or DM or SX or MX, any shape [-]
            Tendon force over maximum isometric force, not negative.
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or DM or SX or MX, same shape [-]
            Positive; at zero force the slope of the stretched side.

        Raises
        ------
        DataError
            The class has no elastic tendon.
        """

    @abc.abstractmethod
    def fiber_damping(self, parameters: CurveParameters) -> Expression:
        """Damping coefficient of the fiber.

        Parameters
        ----------
        parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
            Shape parameters.

        Returns
        -------
        float or column, shape (n_muscles,) [-]
            Force over maximum isometric force per normalized velocity.
        """

    @abc.abstractmethod
    def min_fiber_length(self, muscle: HillMuscle) -> Expression:
        """Shortest fiber that the class allows.

        Parameters
        ----------
        muscle : HillMuscle
            Constants.

        Returns
        -------
        float or DM or SX or MX, shape (n_muscles,) [m]
            Length of the fiber, not of its projection on the tendon.
        """


@dataclass(frozen=True, kw_only=True)
class HillMuscle:
    """Constants of one muscle, or of several muscles of one class as columns.

    Attributes
    ----------
    curves : HillCurves
        Those of the muscle's class.
    max_isometric_force : float or column, shape (n_muscles,) [N]
    optimal_fiber_length : float or column, shape (n_muscles,) [m]
    tendon_slack_length : float or column, shape (n_muscles,) [m]
    pennation_angle_at_optimal : float or column, shape (n_muscles,) [rad]
    max_contraction_velocity : float or column, shape (n_muscles,) [1/s]
        In optimal fiber lengths per second.
    curve_parameters : mapping of str to float or column, shape (n_muscles,) [mixed]
        By OpenSim property name; OpenSim's defaults if empty.

    Notes
    -----
    Any entry may be a symbol, for example to find a tendon slack length or a curve shape: all
    functions of this folder are twice differentiable with respect to their parameters too.
    """

    curves: HillCurves
    max_isometric_force: Expression = 1000.0
    optimal_fiber_length: Expression = 0.1
    tendon_slack_length: Expression = 0.2
    pennation_angle_at_optimal: Expression = 0.0
    max_contraction_velocity: Expression = 10.0
    curve_parameters: CurveParameters = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.curve_parameters:
            object.__setattr__(self, "curve_parameters", dict(self.curves.DEFAULT_CURVE_PARAMETERS))


#: The numbers of a muscle, in the order of the packed vector; the curve parameters follow.
_CONSTANTS = tuple(f.name for f in fields(HillMuscle) if f.name not in ("curves", "curve_parameters"))


def pack(muscle: HillMuscle) -> Expression:
    """Stack all constants of a muscle, one row per constant and one column per muscle.

    Parameters
    ----------
    muscle : HillMuscle
        One muscle or a column of muscles.

    Returns
    -------
    DM or SX or MX, shape (n_constants, n_muscles) [mixed]
        What :func:`unpack` reads; the parameter input of a mapped function.
    """
    values = [getattr(muscle, name) for name in _CONSTANTS]
    values += [muscle.curve_parameters[name] for name in muscle.curves.DEFAULT_CURVE_PARAMETERS]
    columns: list[Expression] = [v if isinstance(v, (ca.SX, ca.MX)) else ca.DM(v) for v in values]
    n_muscles = max(c.numel() for c in columns)
    rows = [ca.repmat(c, 1, n_muscles) if c.numel() == 1 else ca.reshape(c, 1, n_muscles) for c in columns]
    return ca.densify(ca.vertcat(*rows))


def unpack(curves: HillCurves, packed: Expression) -> HillMuscle:
    """Read a muscle from a vector of constants.

    Parameters
    ----------
    curves : HillCurves
        Those of the class.
    packed : DM or SX or MX, shape (n_constants, n_muscles) [mixed]
        As :func:`pack` makes it.

    Returns
    -------
    HillMuscle
        With columns of shape (n_muscles, 1).
    """
    rows = [packed[i, :].T for i in range(packed.shape[0])]
    names = list(curves.DEFAULT_CURVE_PARAMETERS)
    n = len(_CONSTANTS)
    return HillMuscle(
        curves=curves,
        **dict(zip(_CONSTANTS, rows[:n], strict=True)),
        curve_parameters=dict(zip(names, rows[n:], strict=True)),
    )


def n_constants(curves: HillCurves) -> int:
    """Count the rows of :func:`pack` for a class."""
    return len(_CONSTANTS) + len(curves.DEFAULT_CURVE_PARAMETERS)


def repeat_over_frames(muscle: HillMuscle, n_frames: int) -> HillMuscle:
    """Repeat the columns once per frame, to meet arrays of shape (n_frames, n_muscles) unrolled.

    Parameters
    ----------
    muscle : HillMuscle
        With numbers or columns of shape (n_muscles,).
    n_frames : int
        How often.

    Returns
    -------
    HillMuscle
        With columns of shape (n_frames * n_muscles,), muscles running fastest.
    """

    def repeat(value: Expression) -> Expression:
        column = ca.DM(value)
        return value if column.numel() == 1 else ca.repmat(column, n_frames, 1)

    return replace(
        muscle,
        **{name: repeat(getattr(muscle, name)) for name in _CONSTANTS},
        curve_parameters={name: repeat(value) for name, value in muscle.curve_parameters.items()},
    )
