"""Constants of muscles and actuators, as OpenSim uses them after its own finalize step."""

from __future__ import annotations

from typing import Any

import numpy as np
import opensim as osim

from scso_nlp.exceptions import DataError
from scso_nlp.opensim.worker.motion import Note
from scso_nlp.validation import FloatArray

#: At most this many muscles are named in one note.
NAMED_MUSCLES = 8
#: Scalar properties of a muscle that shape its curves, for whichever class has them.
CURVE_PROPERTIES = (
    "FmaxTendonStrain",
    "FmaxMuscleStrain",
    "KshapeActive",
    "KshapePassive",
    "Af",
    "Flen",
    "fv_linear_extrap_threshold",
    "fiber_damping",
    "active_force_width_scale",
    "passive_fiber_strain_at_one_norm_force",
    "tendon_strain_at_one_norm_force",
    "ignore_passive_fiber_force",
    "ignore_tendon_compliance",
    "maximum_pennation_angle",
    "default_activation",
    "minimum_activation",
)
#: Curve objects of a Millard muscle: prefix of the keys and the method that returns the curve.
CURVE_OBJECTS = {
    "active_force_length_curve": "getActiveForceLengthCurve",
    "force_velocity_curve": "getForceVelocityCurve",
    "fiber_force_length_curve": "getFiberForceLengthCurve",
    "tendon_force_length_curve": "getTendonForceLengthCurve",
}
#: Splines of a RigidTendonMuscle; their points become ``<property>.x<i>`` and ``<property>.y<i>``.
SPLINES = ("active_force_length_curve", "passive_force_length_curve", "force_velocity_curve")
#: Values that OpenSim chooses itself where the optional property is empty.
CURVE_VALUES_IN_USE = {
    "stiffness_at_low_force": "getStiffnessAtLowForceInUse",
    "stiffness_at_one_norm_force": "getStiffnessAtOneNormForceInUse",
    "norm_force_at_toe_end": "getNormForceAtToeEndInUse",
    "curviness": "getCurvinessInUse",
}


def muscle_parameters(muscles: list[osim.Muscle]) -> dict[str, list[Any]]:
    """Return the fields of :class:`scso_nlp.MuscleParameters`, one value per muscle."""
    return {
        "muscles": [muscle.getName() for muscle in muscles],
        "muscle_class": [muscle.getConcreteClassName() for muscle in muscles],
        "max_isometric_force": [float(muscle.getMaxIsometricForce()) for muscle in muscles],
        "optimal_fiber_length": [float(muscle.getOptimalFiberLength()) for muscle in muscles],
        "tendon_slack_length": [float(muscle.getTendonSlackLength()) for muscle in muscles],
        "pennation_angle_at_optimal": [
            float(muscle.getPennationAngleAtOptimalFiberLength()) for muscle in muscles
        ],
        "max_contraction_velocity": [float(muscle.getMaxContractionVelocity()) for muscle in muscles],
        "min_activation": [float(muscle.getMinControl()) for muscle in muscles],
        "max_activation": [float(muscle.getMaxControl()) for muscle in muscles],
        "activation_time_constant": [_time_constant(muscle, "activation") for muscle in muscles],
        "deactivation_time_constant": [_time_constant(muscle, "deactivation") for muscle in muscles],
        "curve_parameters": [_curve_parameters(muscle) for muscle in muscles],
    }


def active_force_capacities(muscles: list[osim.Muscle], state: osim.State) -> FloatArray:
    """Return the force of OpenSim's static optimization at full activation, shape (n_muscles,) [N].

    Raises
    ------
    DataError
        OpenSim's number is not finite.
    """
    capacities = np.array([muscle.calcInextensibleTendonActiveFiberForce(state, 1.0) for muscle in muscles])
    for muscle, capacity in zip(muscles, capacities, strict=True):
        if not np.isfinite(capacity):
            raise DataError(
                f"OpenSim's active force of {muscle.getName()!r} ({muscle.getConcreteClassName()}) is "
                f"{capacity} at t = {state.getTime():.9g} s, expected a finite number: check its parameters "
                f"in the model (max_contraction_velocity is {muscle.getMaxContractionVelocity():g} 1/s)"
            )
    return capacities


def notes_on_muscles(muscles: list[osim.Muscle]) -> list[Note]:
    """Name the muscles whose largest velocity is zero, which leaves a shortening fiber no active force."""
    names = [muscle.getName() for muscle in muscles if muscle.getMaxContractionVelocity() == 0]
    if not names:
        return []
    named = ", ".join(names[:NAMED_MUSCLES])
    more = f" and {len(names) - NAMED_MUSCLES} more" if len(names) > NAMED_MUSCLES else ""
    return [
        (
            "WARNING",
            f"max_contraction_velocity is 0 in {len(names)} muscle(s), {named}{more}: OpenSim gives them no "
            "active force while they shorten; set it in the model, or choose muscle_model = none",
        )
    ]


def actuator_parameters(actuators: list[osim.ScalarActuator]) -> dict[str, list[Any]]:
    """Return the fields of :class:`scso_nlp.ActuatorParameters`, one value per actuator."""
    return {
        "actuators": [actuator.getName() for actuator in actuators],
        "optimal_force": [float(actuator.getOptimalForce()) for actuator in actuators],
        "min_control": [float(actuator.getMinControl()) for actuator in actuators],
        "max_control": [float(actuator.getMaxControl()) for actuator in actuators],
    }


def _curve_parameters(muscle: osim.Muscle) -> dict[str, float]:
    parameters = {name: value for name in CURVE_PROPERTIES if (value := _number(muscle, name)) is not None}
    for kind in (osim.Millard2012EquilibriumMuscle, osim.Thelen2003Muscle):
        exact = kind.safeDownCast(muscle)
        if exact is not None and hasattr(exact, "getMinimumFiberLength"):
            parameters["minimum_fiber_length"] = float(exact.getMinimumFiberLength())
    if osim.RigidTendonMuscle.safeDownCast(muscle) is not None:
        for name in SPLINES:
            parameters |= _spline_points(muscle, name)
    millard = osim.Millard2012EquilibriumMuscle.safeDownCast(muscle)
    if millard is not None:
        for prefix, getter in CURVE_OBJECTS.items():
            parameters |= _curve_values(prefix, getattr(millard, getter)())
    return parameters


def _spline_points(muscle: osim.Muscle, name: str) -> dict[str, float]:
    spline = osim.SimmSpline.safeDownCast(muscle.getPropertyByName(name).getValueAsObject(0))
    if spline is None:
        return {f"{name}.other_function": 1.0}
    points = {}
    for i in range(spline.getSize()):
        points[f"{name}.x{i}"] = float(spline.getX(i))
        points[f"{name}.y{i}"] = float(spline.getY(i))
    return points


def _curve_values(prefix: str, curve: osim.Function) -> dict[str, float]:
    values = {}
    for i in range(curve.getNumProperties()):
        entry = curve.getPropertyByIndex(i)
        name = entry.getName()
        if entry.getTypeName() != "double":
            continue
        value = _number(curve, name)
        if value is None and name in CURVE_VALUES_IN_USE:
            value = float(getattr(curve, CURVE_VALUES_IN_USE[name])())
        if value is not None:
            values[f"{prefix}.{name}"] = value
    return values


def _time_constant(muscle: osim.Muscle, kind: str) -> float:
    return _number(muscle, f"{kind}_time_constant") or 0.0


def _number(owner: osim.Object, name: str) -> float | None:
    """Return a numeric property, None where there is none or it is empty."""
    if not owner.hasProperty(name):
        return None
    value = owner.getPropertyByName(name)
    if value.size() != 1:
        return None
    if value.getTypeName() == "bool":
        return float(osim.PropertyHelper.getValueBool(value))
    return float(osim.PropertyHelper.getValueDouble(value))
