"""Muscles that no model can use: one clear sentence each, from problem to solve."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest
from helpers import with_motion
from muscle_models.mixed_muscles import DE_GROOTE, MILLARD, RIGID, THELEN, mixed_problem, muscle_parameters

import scso_nlp as scso

MODELS = (
    scso.RigidTendon(convention="physical"),
    scso.CompliantTendon(),
    scso.CompliantTendon(fiber_velocity="from_path"),
)
every_model = pytest.mark.parametrize("model", MODELS, ids=["rigid", "elastic", "elastic with velocity"])
both_solvers = pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])


def raises(text):
    return pytest.raises(scso.DataError, match=re.escape(text))


def problem_of(model, opensim_class, shape, **changes):
    rng = np.random.default_rng(1)
    return mixed_problem(rng, model, classes=(opensim_class,) * 2, shapes=({}, shape), **changes)


def is_one_sentence(error):
    text = str(error.value)
    assert "\n" not in text
    assert len(text) < 400
    assert ". " not in text


@both_solvers
@every_model
@pytest.mark.parametrize(
    ("opensim_class", "nearest"),
    [
        ("Millard2012AccelerationMuscle", "Millard2012EquilibriumMuscle"),
        ("Thelen2003Muscle_Deprecated", "Thelen2003Muscle"),
        ("MeyerFregly2016Muscle", "DeGrooteFregly2016Muscle"),
        ("RigidTendonMuscle2", "RigidTendonMuscle"),
    ],
)
def test_a_class_that_is_not_modelled_is_refused_by_name_with_the_nearest(
    solve, model, opensim_class, nearest
):
    problem = problem_of(model, MILLARD, {})
    muscles = dataclasses.replace(problem.motion.muscles, muscle_class=(MILLARD, opensim_class))
    with raises(f"muscle 'm2' is a {opensim_class}, which is not modelled (closest: {nearest}") as error:
        solve(with_motion(problem, muscles=muscles))
    is_one_sentence(error)


def test_opensims_own_capacity_needs_no_curves_of_ours():
    """The capacity is OpenSim's number: any class will do."""
    problem = problem_of(scso.RigidTendon(), MILLARD, {})
    muscles = dataclasses.replace(problem.motion.muscles, muscle_class=(MILLARD, "MeyerFregly2016Muscle"))
    assert scso.solve_trajectory(with_motion(problem, muscles=muscles)).is_solved.all()


BAD_CURVES = [
    (THELEN, {"FmaxTendonStrain": 0.0}, "FmaxTendonStrain is 0, must be greater than 0"),
    (THELEN, {"KshapeActive": -0.45}, "KshapeActive is -0.45, must be greater than 0"),
    (THELEN, {"Flen": 1.0}, "Flen is 1, must be greater than 1"),
    (THELEN, {"Flen": 1.04}, "must be greater than 1/Flen = 0.961538 for a monotone force-velocity curve"),
    (THELEN, {"Fmax": 1.8}, "Thelen2003Muscle has no curve parameter 'Fmax' (available: "),
    (THELEN, {"Af": math.nan}, "Af is nan, expected a finite number"),
    (MILLARD, {"fiber_damping": -0.1}, "fiber_damping is -0.1, must be greater than -"),
    (
        MILLARD,
        {"tendon_force_length_curve.strain_at_one_norm_force": 0.0},
        "tendon_force_length_curve.strain_at_one_norm_force is 0, must be greater than 0",
    ),
    (
        MILLARD,
        {"tendon_force_length_curve.stiffness_at_one_norm_force": 10.0},
        "tendon_force_length_curve is not monotone in its segment",
    ),
    (
        MILLARD,
        {"fiber_force_length_curve.stiffness_at_one_norm_force": 0.5},
        "fiber_force_length_curve is not monotone in its segment",
    ),
    (
        MILLARD,
        {"force_velocity_curve.max_eccentric_velocity_force_multiplier": 0.9},
        "max_eccentric_velocity_force_multiplier is 0.9, must be greater than 1",
    ),
    (DE_GROOTE, {"tendon_strain_at_one_norm_force": -0.049}, "is -0.049, must be greater than 0"),
    (DE_GROOTE, {"active_force_width_scale": 0.0}, "active_force_width_scale is 0, must be greater than 0"),
    (
        RIGID,
        {"force_velocity_curve.x0": -2.0},
        "is modelled with OpenSim's default splines only",
    ),
]  # fmt: skip


@every_model
@pytest.mark.parametrize(("opensim_class", "shape", "said"), BAD_CURVES)
def test_curve_parameters_without_a_meaning_are_refused_with_muscle_and_rule(
    model, opensim_class, shape, said
):
    with raises(said) as error:
        scso.solve_trajectory(problem_of(model, opensim_class, shape))
    assert "'m2'" in str(error.value)
    is_one_sentence(error)


@every_model
@pytest.mark.parametrize("opensim_class", [THELEN, MILLARD, DE_GROOTE])
def test_a_tendon_without_length_and_a_pennation_of_a_right_angle_are_refused(model, opensim_class):
    problem = problem_of(model, opensim_class, {})
    for changes, said in (
        ({"tendon_slack_length": [0.2, 0.0]}, "tendon_slack_length of 'm2' is 0 m, must be positive"),
        (
            {"pennation_angle_at_optimal": [0.1, 1.6]},
            "pennation_angle_at_optimal of 'm2' is 1.6 rad, must be at least 0 and less than pi/2",
        ),
    ):
        with raises(said) as error:
            scso.solve_trajectory(
                with_motion(problem, muscles=dataclasses.replace(problem.motion.muscles, **changes))
            )
        is_one_sentence(error)


@pytest.mark.parametrize("value", [0.0, -1.0])
@pytest.mark.parametrize("what", ["max_isometric_force", "optimal_fiber_length"])
def test_constants_that_are_not_positive_never_reach_a_problem(what, value):
    with raises(f"{what} of 'm2' is {value:g}, must be positive"):
        muscle_parameters((MILLARD,) * 2, ({},) * 2, **{what: np.array([1.0, value])})
    with raises(f"{what} is nan at index (1,) of (n_muscles), expected a finite number"):
        muscle_parameters((MILLARD,) * 2, ({},) * 2, **{what: np.array([1.0, math.nan])})


def without_speed_limit(problem):
    """The same problem, its second muscle with a largest velocity of zero."""
    muscles = dataclasses.replace(problem.motion.muscles, max_contraction_velocity=[10.0, 0.0])
    return with_motion(problem, muscles=muscles)


@both_solvers
@every_model
@pytest.mark.parametrize("opensim_class", [THELEN, MILLARD, DE_GROOTE, RIGID])
def test_a_largest_velocity_of_zero_is_refused_by_models_with_curves(solve, model, opensim_class):
    said = f"max_contraction_velocity of 'm2' is 0 1/s, must be positive for the curves of {opensim_class}; "
    with raises(said) as error:
        solve(without_speed_limit(problem_of(model, opensim_class, {})))
    is_one_sentence(error)


@both_solvers
@pytest.mark.parametrize("model", [scso.RigidTendon(), scso.NoPhysiology()], ids=["opensim", "none"])
def test_a_largest_velocity_of_zero_does_not_matter_to_models_without_curves(solve, model):
    problem = problem_of(model, MILLARD, {})
    np.testing.assert_allclose(
        solve(without_speed_limit(problem)).activation, solve(problem).activation, atol=1e-12
    )


@pytest.mark.parametrize("value", [-1.0, math.nan])
def test_a_largest_velocity_below_zero_never_reaches_a_problem(value):
    with raises("max_contraction_velocity "):
        muscle_parameters((MILLARD,) * 2, ({},) * 2, max_contraction_velocity=np.array([1.0, value]))


@both_solvers
@every_model
@pytest.mark.parametrize("opensim_class", [THELEN, MILLARD, DE_GROOTE])
def test_a_slack_path_is_refused_with_muscle_time_and_remedy(solve, model, opensim_class):
    problem = problem_of(model, opensim_class, {})
    length = problem.motion.trajectory.muscle_tendon_length.copy()
    length[3, 1] = 0.8 * problem.motion.muscles.tendon_slack_length[1]
    trajectory = dataclasses.replace(problem.motion.trajectory, muscle_tendon_length=length)
    with raises("; check tendon_slack_length, or choose short_fibers='silence'") as error:
        solve(with_motion(problem, trajectory=trajectory))
    for part in ("'m2'", "at t = 0.03 s", "path", "too short"):
        assert part in str(error.value)
    is_one_sentence(error)


@every_model
def test_a_fiber_at_its_shortest_is_refused_although_the_tendon_could_be_taut(model):
    """Millard's active force ends at 0.4441 optimal lengths: below it OpenSim holds the fiber."""
    problem = problem_of(model, MILLARD, {}, pennation_angle_at_optimal=np.zeros(2))
    muscles, length = problem.motion.muscles, problem.motion.trajectory.muscle_tendon_length.copy()
    length[0, 1] = muscles.tendon_slack_length[1] + 0.43 * muscles.optimal_fiber_length[1]
    trajectory = dataclasses.replace(problem.motion.trajectory, muscle_tendon_length=length)
    with pytest.raises(scso.DataError, match=r"'m2'.* at t = 0 s.*shortest") as error:
        scso.solve_trajectory(with_motion(problem, trajectory=trajectory))
    is_one_sentence(error)
