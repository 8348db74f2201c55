"""OpenSim's own values of its muscle classes on grids, as columns, and the muscles that they belong to."""

from __future__ import annotations

import casadi as ca
import numpy as np
from muscle_models.classes import degroote2016, millard2012, rigid_tendon_muscle, thelen2003

from scso_nlp.muscle_models.hill_muscle import HillMuscle

ACTIVE, VELOCITY = "active_force_length_curve.", "force_velocity_curve."
PASSIVE, TENDON = "fiber_force_length_curve.", "tendon_force_length_curve."
ACTIVE_NAMES = [
    ACTIVE + name
    for name in (
        "min_norm_active_fiber_length",
        "transition_norm_fiber_length",
        "max_norm_active_fiber_length",
        "shallow_ascending_slope",
        "minimum_value",
    )
]
VELOCITY_NAMES = [
    VELOCITY + name
    for name in (
        "concentric_slope_at_vmax",
        "concentric_slope_near_vmax",
        "isometric_slope",
        "eccentric_slope_at_vmax",
        "eccentric_slope_near_vmax",
        "max_eccentric_velocity_force_multiplier",
        "concentric_curviness",
        "eccentric_curviness",
    )
]
PASSIVE_NAMES = [
    PASSIVE + name
    for name in (
        "strain_at_zero_force",
        "strain_at_one_norm_force",
        "stiffness_at_low_force",
        "stiffness_at_one_norm_force",
        "curviness",
    )
]
TENDON_NAMES = [
    TENDON + name
    for name in (
        "strain_at_one_norm_force",
        "stiffness_at_one_norm_force",
        "norm_force_at_toe_end",
        "curviness",
    )
]

THELEN_NAMES = [
    "FmaxTendonStrain",
    "FmaxMuscleStrain",
    "KshapeActive",
    "KshapePassive",
    "Af",
    "Flen",
    "fv_linear_extrap_threshold",
]
MILLARD_NAMES = [*ACTIVE_NAMES, *VELOCITY_NAMES, *PASSIVE_NAMES, *TENDON_NAMES, "fiber_damping"]

#: Curve parameters of the parameter sets that are not OpenSim's defaults.
CURVE_PARAMETERS = {
    ("thelen2003", "p2"): {
        "KshapeActive": 0.5,
        "KshapePassive": 4.0,
        "Af": 0.3,
        "Flen": 1.8,
        "FmaxTendonStrain": 0.033,
    },
    ("degroote2016", "p2"): {
        "fiber_damping": 0.01,
        "active_force_width_scale": 1.2,
        "tendon_strain_at_one_norm_force": 0.06,
        "passive_fiber_strain_at_one_norm_force": 0.5,
    },
    ("millard2012", "p2"): {
        "fiber_damping": 0.01,
        **dict(zip(ACTIVE_NAMES, (0.25, 0.77, 1.9, 0.75, 0.0), strict=True)),
        **dict(zip(PASSIVE_NAMES, (0.1937, 0.75, 0.2, 5.0, 0.75), strict=True)),
        **dict(zip(TENDON_NAMES, (0.1, 13.75, 2.0 / 3.0, 0.5), strict=True)),
    },
    # undamped with an elastic tendon: OpenSim raises these three
    ("millard2012", "p3"): {
        "fiber_damping": 0.0,
        ACTIVE + "minimum_value": 0.1,
        VELOCITY + "concentric_slope_at_vmax": 0.125,
        VELOCITY + "eccentric_slope_at_vmax": 0.075,
    },
}
#: With a rigid tendon the undamped muscle uses the curves of the damped one.
RIGID_CURVE_PARAMETERS = CURVE_PARAMETERS | {("millard2012", "p3"): {"fiber_damping": 0.0}}

#: The muscle class of every table: one line per class.
CLASSES = {
    "thelen2003": thelen2003,
    "millard2012": millard2012,
    "degroote2016": degroote2016,
    "rigidtendon": rigid_tendon_muscle,
}
CASES = [
    *(("thelen2003", f"p{i}") for i in range(3)),
    *(("millard2012", f"p{i}") for i in range(4)),
    *(("degroote2016", f"p{i}") for i in range(3)),
    *(("rigidtendon", f"p{i}") for i in range(2)),
]
ELASTIC_CASES = [case for case in CASES if case[0] != "rigidtendon"]
FIELDS = (
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "pennation_angle_at_optimal",
    "max_contraction_velocity",
)


def table(folder, case, kind):
    """Columns by name of one table of one parameter set; rows that OpenSim could not evaluate stay NaN."""
    name, parameter_set = case
    with np.load(folder / "muscle_curves" / f"reference_{name}.npz") as data:
        values = data[f"{parameter_set}_{kind}"]
        columns = data[f"{kind}_columns"]
    return {str(column): values[:, i] for i, column in enumerate(columns)}


def muscle(folder, case, *, rigid=False):
    """The muscle of one parameter set, with numbers as constants."""
    name, parameter_set = case
    with np.load(folder / "muscle_curves" / f"reference_{name}.npz") as data:
        constants = data[f"{parameter_set}_params"]
    curves = CLASSES[name]
    given = (RIGID_CURVE_PARAMETERS if rigid else CURVE_PARAMETERS).get(case, {})
    return HillMuscle(
        curves=curves,
        **dict(zip(FIELDS, map(float, constants), strict=True)),
        curve_parameters=curves.check_curve_parameters("table", given),
    )


def model_muscles(folder, name):
    """The muscles of a model as columns, and its table."""
    with np.load(folder / "muscle_curves" / f"reference_model_{name}.npz") as file:
        data = {key: file[key] for key in file.files}
    millard = "millard" in name
    curves = millard2012 if millard else thelen2003
    names = MILLARD_NAMES if millard else THELEN_NAMES
    shapes = [
        curves.check_curve_parameters(str(m), dict(zip(names, map(float, row), strict=True)))
        for m, row in zip(data["names"], data["extra"], strict=True)
    ]
    muscles = HillMuscle(
        curves=curves,
        **{field: ca.DM(data["params"][:, i]) for i, field in enumerate(FIELDS)},
        curve_parameters={key: ca.DM([s[key] for s in shapes]) for key in shapes[0]},
    )
    return muscles, data
