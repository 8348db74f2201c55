"""Classes that are modelled, columns of muscles, and data that no muscle can have."""

import casadi as ca
import numpy as np
import pytest
from muscle_models.classes import (
    ALL,
    ELASTIC,
    AtDefaults,
    degroote2016,
    millard2012,
    name_of,
    rigid_tendon_muscle,
    thelen2003,
)
from muscle_models.mixed_muscles import muscle_parameters

from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.equilibrium import equilibrium_residual, solve_equilibrium
from scso_nlp.muscle_models.force import rigid_tendon_force
from scso_nlp.muscle_models.hill_muscle import HillMuscle, pack, repeat_over_frames, unpack
from scso_nlp.muscle_models.muscle_classes import MUSCLE_CLASSES, curves_of, muscle_groups
from scso_nlp.muscle_models.pennation import clamped_rigid_tendon_fiber, rigid_tendon_fiber


def parameters(classes, **changes):
    return muscle_parameters(classes, ({},) * len(classes), **changes)


@pytest.mark.parametrize(
    ("opensim_class", "nearest"),
    [
        ("Millard2012AccelerationMuscle", "Millard2012EquilibriumMuscle"),
        ("Thelen2003Muscle_Deprecated", "Thelen2003Muscle"),
        ("MeyerFregly2016Muscle", "DeGrooteFregly2016Muscle"),
    ],
)
def test_a_class_without_a_model_is_refused_by_name_with_the_nearest_one(opensim_class, nearest):
    with pytest.raises(DataError, match=rf"'soleus' is a {opensim_class}.*closest: {nearest}"):
        curves_of(opensim_class, "soleus")
    with pytest.raises(DataError, match=rf"'m2' is a {opensim_class}"):
        muscle_groups(parameters(["Thelen2003Muscle", opensim_class]))


def test_every_class_is_found_under_opensims_own_name():
    expected = {
        "Thelen2003Muscle": thelen2003,
        "Millard2012EquilibriumMuscle": millard2012,
        "DeGrooteFregly2016Muscle": degroote2016,
        "RigidTendonMuscle": rigid_tendon_muscle,
    }
    assert {name: type(curves_of(name)) for name in MUSCLE_CLASSES} == {
        name: type(curves) for name, curves in expected.items()
    }


def test_muscles_of_mixed_classes_are_sorted_and_evaluated_like_one_by_one():
    classes = ["Thelen2003Muscle", "Millard2012EquilibriumMuscle", "RigidTendonMuscle", "Thelen2003Muscle",
               "DeGrooteFregly2016Muscle", "Millard2012EquilibriumMuscle"]  # fmt: skip
    data = parameters(
        classes,
        curve_parameters=tuple({"Flen": 1.8} if i == 3 else {} for i in range(6)),
    )
    rng = np.random.default_rng(0)
    length, velocity = rng.uniform(0.28, 0.32, (4, 6)), rng.uniform(-0.3, 0.3, (4, 6))
    found = np.full((4, 6), np.nan)
    for positions, muscle in muscle_groups(data):
        columns = repeat_over_frames(muscle, 4)
        found[:, positions] = on_arrays(
            lambda x, v, columns=columns: rigid_tendon_force(columns, 0.7, x, v),
            length[:, positions],
            velocity[:, positions],
        )
    for m, opensim_class in enumerate(classes):
        module = MUSCLE_CLASSES[opensim_class]
        single = HillMuscle(
            curves=module,
            max_isometric_force=data.max_isometric_force[m],
            optimal_fiber_length=data.optimal_fiber_length[m],
            tendon_slack_length=data.tendon_slack_length[m],
            pennation_angle_at_optimal=data.pennation_angle_at_optimal[m],
            max_contraction_velocity=data.max_contraction_velocity[m],
            curve_parameters=module.check_curve_parameters("m", data.curve_parameters[m]),
        )
        for k in range(4):
            expected = float(rigid_tendon_force(single, 0.7, length[k, m], velocity[k, m]))
            assert found[k, m] == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("module", ALL, ids=name_of)
def test_float_dm_sx_and_mx_agree(module):
    muscle = HillMuscle(curves=module, pennation_angle_at_optimal=0.2)
    points = np.array([[0.3, 0.31, 0.05], [0.9, 0.29, -0.2], [0.6, 0.33, 0.4]])
    dm = ca.DM(rigid_tendon_force(muscle, *(ca.DM(c) for c in points.T))).full()[:, 0]
    for symbol in (ca.SX.sym, ca.MX.sym):
        x = [symbol(name, 3) for name in "alv"]
        function = ca.Function("f", x, [rigid_tendon_force(muscle, *x)])
        np.testing.assert_allclose(function(*points.T).full()[:, 0], dm, rtol=1e-15)
    for row, value in zip(points, dm, strict=True):
        assert float(rigid_tendon_force(muscle, *map(float, row))) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("module", ELASTIC, ids=name_of)
def test_packed_constants_come_back(module):
    muscle = HillMuscle(curves=module, optimal_fiber_length=ca.DM([0.1, 0.05]))
    again = unpack(module, pack(muscle))
    residual = [
        ca.DM(equilibrium_residual(m, ca.DM([0.09, 0.045]), 0.5, ca.DM([0.3, 0.25]))).full()
        for m in (muscle, again)
    ]
    np.testing.assert_array_equal(*residual)


def test_on_arrays_keeps_the_shape_and_broadcasts():
    x = np.linspace(0.5, 1.5, 12).reshape(3, 4)
    values = on_arrays(AtDefaults(thelen2003).active_force_length, x)
    assert values.shape == (3, 4)
    np.testing.assert_allclose(values, np.exp(-((x - 1.0) ** 2) / 0.45), rtol=1e-15)
    assert on_arrays(lambda a, b: a + b, np.zeros((3, 1)), np.arange(4.0)).shape == (3, 4)
    assert on_arrays(lambda a: 2.0, x).shape == (3, 4)


@pytest.mark.parametrize("module", ELASTIC, ids=name_of)
def test_equilibrium_on_trajectories_is_that_of_each_frame(module):
    muscle = HillMuscle(
        curves=module,
        max_isometric_force=ca.DM([500.0, 900.0]),
        optimal_fiber_length=ca.DM([0.06, 0.1]),
        pennation_angle_at_optimal=ca.DM([0.3, 0.0]),
    )
    rng = np.random.default_rng(3)
    a, length = rng.uniform(0.01, 1.0, (5, 2)), np.array([0.25, 0.29]) + rng.uniform(0.0, 0.04, (5, 2))
    state = solve_equilibrium(muscle, a, length)
    assert np.abs(state.residual).max() < 1e-13
    for m in range(2):
        single = HillMuscle(
            curves=module,
            max_isometric_force=(500.0, 900.0)[m],
            optimal_fiber_length=(0.06, 0.1)[m],
            pennation_angle_at_optimal=(0.3, 0.0)[m],
        )
        alone = solve_equilibrium(single, a[:, m], length[:, m])
        np.testing.assert_allclose(alone.tendon_force, state.tendon_force[:, m], rtol=1e-10)


@pytest.mark.parametrize("module", ELASTIC, ids=name_of)
def test_a_path_shorter_than_tendon_and_fiber_is_reported_and_pulls_nothing(module):
    state = solve_equilibrium(HillMuscle(curves=module), np.array([0.5, 0.5]), np.array([0.19, 0.3]))
    np.testing.assert_array_equal(state.is_at_lower_bound, [True, False])
    assert state.tendon_force[0] <= 0.0
    assert state.tendon_force[1] > 0.0


def test_a_fiber_that_damping_makes_push_leaves_the_tendon_slack():
    shape = degroote2016.check_curve_parameters("m", {"fiber_damping": 0.1})
    muscle = HillMuscle(curves=degroote2016, curve_parameters=shape)
    state = solve_equilibrium(muscle, np.array([0.01]), np.array([0.27]), np.array([-0.9]))
    assert state.is_slack[0]
    assert state.tendon_force[0] == pytest.approx(0.0, abs=1e-10)


def test_clamped_and_free_kinematics_agree_where_no_clamp_acts():
    muscle = HillMuscle(
        curves=millard2012,
        pennation_angle_at_optimal=0.3,
        curve_parameters=millard2012.DEFAULT_CURVE_PARAMETERS,
    )
    free, clamped = (f(muscle, 0.29, 0.1) for f in (rigid_tendon_fiber, clamped_rigid_tendon_fiber))
    for ours, theirs in zip(free, clamped, strict=True):
        assert float(ours) == pytest.approx(float(theirs), rel=1e-14)
    short = clamped_rigid_tendon_fiber(muscle, 0.15, 0.1)
    assert float(short.cos_pennation_angle) == pytest.approx(0.1)
    assert float(short.fiber_length) == pytest.approx(0.1 * np.sin(0.3) / np.sin(np.arccos(0.1)))
    parallel = HillMuscle(curves=thelen2003)
    assert float(clamped_rigid_tendon_fiber(parallel, 0.19, 0.1).fiber_length) == 0.0


def test_the_projection_of_the_fiber_obeys_pythagoras():
    muscle = HillMuscle(
        curves=thelen2003, optimal_fiber_length=0.05, pennation_angle_at_optimal=np.arcsin(0.6)
    )
    fiber = rigid_tendon_fiber(muscle, 0.24, 1.0)
    assert float(fiber.fiber_length) == pytest.approx(0.05)
    assert float(fiber.cos_pennation_angle) == pytest.approx(0.8)
    assert float(fiber.fiber_velocity) == pytest.approx(0.8)


A, F, P, T = (
    f"{n}_curve."
    for n in ("active_force_length", "force_velocity", "fiber_force_length", "tendon_force_length")
)


@pytest.mark.parametrize(
    ("opensim_class", "given", "message"),
    [
        ("Thelen2003Muscle", {"KshapeActive": 0.0}, "KshapeActive is 0, must be greater than 0"),
        (
            "Thelen2003Muscle",
            {"FmaxTendonStrain": -0.04},
            "FmaxTendonStrain is -0.04, must be greater than 0",
        ),
        ("Thelen2003Muscle", {"Flen": 1.0}, "Flen is 1, must be greater than 1"),
        (
            "Thelen2003Muscle",
            {"fv_linear_extrap_threshold": 0.7},
            "greater than 1/Flen = 0.714286 for a monotone",
        ),
        ("Thelen2003Muscle", {"Af": np.nan}, "Af is nan, expected a finite number"),
        (
            "Thelen2003Muscle",
            {"KshapeActve": 0.5},
            r"no curve parameter 'KshapeActve' \(closest: KshapeActive",
        ),
        ("DeGrooteFregly2016Muscle", {"fiber_damping": -0.1}, "fiber_damping is -0.1, must be greater than"),
        ("DeGrooteFregly2016Muscle", {"active_force_width_scale": 0.0}, "must be greater than 0"),
        ("Millard2012EquilibriumMuscle", {"fiber_damping": -1.0}, "fiber_damping is -1"),
        (
            "Millard2012EquilibriumMuscle",
            {A + "transition_norm_fiber_length": 0.4},
            "min_norm_active_fiber_length",
        ),
        (
            "Millard2012EquilibriumMuscle",
            {A + "shallow_ascending_slope": 5.0},
            "is not monotone in its segment",
        ),
        ("Millard2012EquilibriumMuscle", {F + "isometric_slope": 0.9}, "isometric_slope is 0.9"),
        ("Millard2012EquilibriumMuscle", {F + "eccentric_slope_near_vmax": 0.6}, "not monotone"),
        ("Millard2012EquilibriumMuscle", {P + "stiffness_at_one_norm_force": 1.0}, "not monotone"),
        ("Millard2012EquilibriumMuscle", {T + "stiffness_at_one_norm_force": 5.0}, "not monotone"),
        ("Millard2012EquilibriumMuscle", {T + "curviness": 1.5}, "curviness is 1.5"),
        ("RigidTendonMuscle", {"force_velocity_curve.x0": -2.0}, "default splines only"),
    ],
)
def test_curve_parameters_without_a_meaning_are_refused_in_one_sentence(opensim_class, given, message):
    data = parameters([opensim_class], curve_parameters=(given,))
    with pytest.raises(DataError, match=message) as error:
        muscle_groups(data)
    assert "'m1'" in str(error.value)
    assert "\n" not in str(error.value)


def test_constants_without_a_meaning_are_refused_in_one_sentence():
    with pytest.raises(DataError, match=r"pennation_angle_at_optimal of 'm1' is 1\.6 rad"):
        muscle_groups(parameters(["Thelen2003Muscle"], pennation_angle_at_optimal=np.array([1.6])))
    with pytest.raises(DataError, match="tendon_slack_length of 'm1' is 0 m, must be positive"):
        muscle_groups(parameters(["Millard2012EquilibriumMuscle"], tendon_slack_length=np.zeros(1)))
    assert muscle_groups(parameters(["RigidTendonMuscle"], tendon_slack_length=np.zeros(1)))


def test_properties_that_are_no_curve_parameters_may_stand_beside_them():
    given = {"default_activation": 0.05, "ignore_tendon_compliance": 0.0, "minimum_fiber_length": 0.01}
    for module in MUSCLE_CLASSES.values():
        assert module.check_curve_parameters("m", given) == dict(module.DEFAULT_CURVE_PARAMETERS)


def test_the_rigid_class_has_no_tendon_curve():
    with pytest.raises(DataError, match="RigidTendonMuscle has no tendon curve"):
        solve_equilibrium(HillMuscle(curves=rigid_tendon_muscle), np.ones(1), np.full(1, 0.3))
    for refused in (
        rigid_tendon_muscle.tendon_force_length,
        rigid_tendon_muscle.inverse_tendon_force_length,
        rigid_tendon_muscle.tendon_slope_at_force,
    ):
        with pytest.raises(DataError, match="no tendon curve"):
            refused(1.0, {})


def test_passive_force_that_a_model_ignores_is_zero():
    shape = degroote2016.check_curve_parameters("m", {"ignore_passive_fiber_force": 1.0})
    assert float(degroote2016.passive_force_length(1.5, shape)) == 0.0
    assert float(degroote2016.passive_force_length_slope(1.5, shape)) == 0.0
