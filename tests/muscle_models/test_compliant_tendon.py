"""Fiber and tendon in equilibrium in every frame, with mixed classes and on a walking motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, random_problem, stability_by_hand, with_motion, with_stability
from muscle_models.mixed_muscles import (
    CLASSES,
    DE_GROOTE,
    MILLARD,
    RIGID,
    THELEN,
    fiber_force,
    mixed_problem,
    rigid_force,
    tendon_force,
)

import scso_nlp as scso
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.equilibrium import solve_equilibrium
from scso_nlp.muscle_models.force import tendon_force as force_of_tendon
from scso_nlp.muscle_models.hill_muscle import repeat_over_frames
from scso_nlp.muscle_models.muscle_classes import muscle_groups
from scso_nlp.transcription.describe import describe

FIBERS = "CompliantTendon.fiber_length_along_tendon"
ELASTIC = [m for m, name in enumerate(CLASSES) if name != RIGID]
STIFF = [m for m, name in enumerate(CLASSES) if name == RIGID]
OPTIONS = scso.SolverOptions(tolerance=1e-11)

#: Of maximum isometric force: what is promised of the residual in every frame at default settings.
RESIDUAL = 1e-8

both_solvers = pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
any_velocity = pytest.mark.parametrize("fiber_velocity", ["zero", "from_path"])


def velocity_of(problem):
    velocity = problem.motion.trajectory.muscle_tendon_velocity
    return velocity if problem.muscle_model.fiber_velocity == "from_path" else np.zeros_like(velocity)


def along_tendon(problem, fibers):
    """All muscles' fibers along the tendon: those of rigid tendons are not unknowns."""
    result = problem.motion.trajectory.muscle_tendon_length - problem.motion.muscles.tendon_slack_length
    result[:, ELASTIC] = fibers
    return result


@any_velocity
def test_rows_and_forces_of_mixed_classes_are_the_textbook_sums(rng, fiber_velocity):
    problem = mixed_problem(rng, scso.CompliantTendon(fiber_velocity=fiber_velocity))
    muscles = problem.motion.muscles
    activation = rng.uniform(0.01, 1, (4, 8))
    fibers = muscles.optimal_fiber_length[ELASTIC] * rng.uniform(0.6, 1.2, (4, 6))
    given = rng.uniform(0, 500, (4, 6))
    owner = "CompliantTendon"
    _, rows, force = evaluate_terms(
        problem,
        activation,
        variables={(owner, "fiber_length_along_tendon"): fibers, (owner, "tendon_force"): given},
    )
    along = along_tendon(problem, fibers)
    pull, tension = (
        fiber_force(problem, along, velocity_of(problem), activation),
        tendon_force(problem, along),
    )
    np.testing.assert_allclose(force[:, ELASTIC], given, rtol=1e-12)
    np.testing.assert_allclose(force[:, STIFF], pull[:, STIFF], rtol=1e-12, atol=1e-10)
    strength = muscles.max_isometric_force[ELASTIC]
    balance, curve = (pull - tension)[:, ELASTIC] / strength, (tension[:, ELASTIC] - given) / strength
    np.testing.assert_allclose(rows[owner], np.hstack([balance, curve]), rtol=1e-11, atol=1e-12)


def test_fiber_lengths_and_tendon_strains_are_known_of_the_solution(rng):
    """Of all muscles; a rigid tendon keeps its slack length."""
    problem = mixed_problem(rng, scso.CompliantTendon())
    solution = scso.solve_trajectory(problem)
    muscles, length = problem.motion.muscles, problem.motion.trajectory.muscle_tendon_length
    along = along_tendon(problem, solution.variables[FIBERS])
    width = muscles.optimal_fiber_length * np.sin(muscles.pennation_angle_at_optimal)
    np.testing.assert_allclose(solution.fiber_length, np.hypot(along, width), rtol=1e-12)
    strain = (length - along - muscles.tendon_slack_length) / muscles.tendon_slack_length
    np.testing.assert_allclose(solution.tendon_strain, strain, rtol=0, atol=1e-12)
    assert (solution.tendon_strain[:, STIFF] == 0).all()
    assert (solution.tendon_strain[:, ELASTIC] > 0).any(axis=0).all()
    name = muscles.muscles[0]
    np.testing.assert_array_equal(solution[name].tendon_strain, solution.tendon_strain[:, 0])
    np.testing.assert_array_equal(solution.to_dataframe("fiber_length")[name], solution.fiber_length[:, 0])
    plain = scso.solve_trajectory(dataclasses.replace(problem, muscle_model=scso.NoPhysiology()))
    assert (plain.fiber_length, plain.tendon_strain) == (None, None)


@both_solvers
@any_velocity
def test_the_solution_is_the_equilibrium_of_its_activations(rng, solve, fiber_velocity):
    problem = mixed_problem(rng, scso.CompliantTendon(fiber_velocity=fiber_velocity))
    solution = solve(problem)
    assert solution.status is scso.Status.SOLVED
    names = [problem.motion.muscles.muscles[m] for m in ELASTIC]
    assert solution.rows["CompliantTendon"].names == tuple(
        f"{name} {what}" for what in ("fiber", "tendon") for name in names
    )
    along = along_tendon(problem, solution.variables[FIBERS])
    residual = fiber_force(problem, along, velocity_of(problem), solution.activation)
    residual = (residual - tendon_force(problem, along))[:, ELASTIC]
    assert (np.abs(residual) < RESIDUAL * problem.motion.muscles.max_isometric_force[ELASTIC]).all()
    for where, muscle in muscle_groups(problem.motion.muscles):
        if muscle.curves.HAS_ELASTIC_TENDON:
            expected = solve_equilibrium(
                muscle,
                solution.activation[:, where],
                problem.motion.trajectory.muscle_tendon_length[:, where],
                velocity_of(problem)[:, where],
            )
            assert not expected.is_at_lower_bound.any()
            np.testing.assert_allclose(
                solution.tendon_force[:, where],
                expected.tendon_force,
                # a residual of 1e-8 F0 is divided by one plus the ratio of tendon to fiber stiffness
                atol=1e-7 * problem.motion.muscles.max_isometric_force.max(),
            )


@any_velocity
def test_both_solvers_agree_on_mixed_classes(rng, fiber_velocity):
    problem = mixed_problem(rng, scso.CompliantTendon(fiber_velocity=fiber_velocity))
    whole, single = (
        solve(problem, options=OPTIONS) for solve in (scso.solve_trajectory, scso.solve_framewise)
    )
    np.testing.assert_allclose(whole.activation, single.activation, atol=1e-6)
    np.testing.assert_allclose(whole.variables[FIBERS], single.variables[FIBERS], atol=1e-6)


@pytest.mark.parametrize("name", [THELEN, MILLARD, DE_GROOTE])
def test_a_stiff_tendon_comes_to_the_rigid_one(rng, name):
    """The tendon's strain at unit force goes down 100 times: so does the difference in fiber length."""
    strain = {
        THELEN: "FmaxTendonStrain",
        MILLARD: "tendon_force_length_curve.strain_at_one_norm_force",
        DE_GROOTE: "tendon_strain_at_one_norm_force",
    }[name]
    still = {"fiber_damping": 0.0} if name == MILLARD else {}
    difference = []
    for size in (0.05, 0.0005):
        shape = {strain: size, **still}
        if name == MILLARD:
            shape["tendon_force_length_curve.stiffness_at_one_norm_force"] = 1.375 / size
        problem = mixed_problem(
            np.random.default_rng(5), scso.CompliantTendon(), classes=(name,) * 4, shapes=(shape,) * 4
        )
        at_rest = dataclasses.replace(problem.motion.trajectory, muscle_tendon_velocity=np.zeros((4, 4)))
        rigid = dataclasses.replace(
            problem,
            motion=dataclasses.replace(problem.motion, trajectory=at_rest),
            muscle_model=scso.RigidTendon(convention="physical"),
        )
        force = scso.solve_trajectory(problem, options=OPTIONS).tendon_force
        difference.append(np.abs(force - scso.solve_trajectory(rigid, options=OPTIONS).tendon_force).max())
    assert difference[1] < 0.03 * difference[0]


def test_muscles_that_ignore_tendon_compliance_have_no_unknown(rng):
    shapes = ({}, {"ignore_tendon_compliance": 1.0}, {})
    problem = mixed_problem(
        rng, scso.CompliantTendon(fiber_velocity="from_path"), classes=(MILLARD,) * 3, shapes=shapes
    )
    solution = scso.solve_trajectory(problem, options=OPTIONS)
    assert solution.variables[FIBERS].shape == (4, 2)
    assert solution.rows["CompliantTendon"].names == ("m1 fiber", "m3 fiber", "m1 tendon", "m3 tendon")
    expected = rigid_force(problem, solution.activation)[:, 1]
    np.testing.assert_allclose(solution.tendon_force[:, 1], expected, rtol=1e-10)


def test_a_model_of_rigid_tendons_only_is_the_physical_rigid_tendon(rng):
    problem = mixed_problem(
        rng, scso.CompliantTendon(fiber_velocity="from_path"), classes=(RIGID,) * 5, shapes=({},) * 5
    )
    rigid = dataclasses.replace(problem, muscle_model=scso.RigidTendon(convention="physical"))
    found, expected = (scso.solve_trajectory(p, options=OPTIONS) for p in (problem, rigid))
    np.testing.assert_allclose(found.tendon_force, expected.tendon_force, atol=1e-6)
    assert found.variables == {}


def with_paths(problem, k, m, length, velocity=None):
    trajectory = problem.motion.trajectory
    lengths, velocities = trajectory.muscle_tendon_length.copy(), trajectory.muscle_tendon_velocity.copy()
    lengths[k, m] = length
    if velocity is not None:
        velocities[k, m] = velocity
    trajectory = dataclasses.replace(
        trajectory, muscle_tendon_length=lengths, muscle_tendon_velocity=velocities
    )
    return with_motion(problem, trajectory=trajectory)


def silenced(problem):
    model = dataclasses.replace(problem.muscle_model, short_fibers="silence")
    return dataclasses.replace(problem, muscle_model=model)


@both_solvers
@pytest.mark.parametrize("share", [0.95, 0.5, 0.01])
@pytest.mark.parametrize("m", [0, 1, 2])
def test_a_path_too_short_for_any_equilibrium_is_refused_by_name_or_rests(rng, caplog, solve, m, share):
    """Of Thelen, Millard and De Groote muscles; the slack tendon has no force, as in OpenSim."""
    problem = mixed_problem(rng, scso.CompliantTendon())
    problem = with_paths(problem, 1, m, share * problem.motion.muscles.tendon_slack_length[m])
    said = rf"'m{m + 1}' has no equilibrium at t = 0.01 s at any activation, because its path is too short"
    with pytest.raises(scso.DataError, match=said):
        solve(problem)
    solution = solve(silenced(problem))
    assert solution.status is scso.Status.SOLVED
    assert f"(muscles: m{m + 1}); activation does not change their force there" in caplog.text
    assert solution.tendon_force[1, m] == pytest.approx(0.0, abs=1e-5)
    # Nothing to gain: the muscle stays at its least activation.
    assert solution.activation[1, m] == pytest.approx(0.01, abs=1e-6)
    free = np.ones((4, 8), dtype=bool)
    free[1, m] = False
    along = along_tendon(problem, solution.variables[FIBERS])
    residual = fiber_force(problem, along, velocity_of(problem), solution.activation)
    residual = (residual - tendon_force(problem, along)) / problem.motion.muscles.max_isometric_force
    assert np.abs(residual[free & (np.array(CLASSES) != RIGID)]).max() < RESIDUAL


def test_a_short_path_of_a_rigid_tendon_among_elastic_ones_is_refused_or_silenced_too(rng, caplog):
    problem = mixed_problem(rng, scso.CompliantTendon())
    problem = with_paths(problem, 3, 6, 0.9 * problem.motion.muscles.tendon_slack_length[6])
    with pytest.raises(scso.DataError, match=r"path of 'm7' is too short for a rigid tendon at t = 0.03 s"):
        scso.solve_trajectory(problem)
    solution = scso.solve_trajectory(silenced(problem))
    assert "m7" in caplog.text
    assert solution.tendon_force[3, 6] == 0.0


def test_a_fiber_that_pushes_is_refused_by_name_or_has_no_force(rng, caplog):
    """A damped fiber that shortens as fast as it can has no active force, and damping slackens the tendon."""
    problem = mixed_problem(rng, scso.CompliantTendon(fiber_velocity="from_path"))
    muscles = problem.motion.muscles
    fastest = muscles.optimal_fiber_length[1] * muscles.max_contraction_velocity[1]
    length = muscles.tendon_slack_length[1] + 0.8 * muscles.optimal_fiber_length[1]
    problem = with_paths(problem, 2, 1, length, -1.2 * fastest)
    said = "'m2' has no equilibrium at t = 0.02 s at any activation, because its fiber shortens so fast"
    with pytest.raises(scso.DataError, match=said):
        scso.solve_trajectory(problem)
    solution = scso.solve_trajectory(silenced(problem))
    assert solution.tendon_force[2, 1] == pytest.approx(0.0, abs=1e-5)
    assert "m2" in caplog.text


def test_muscles_whose_tendon_would_go_slack_are_named_and_held_to_what_keeps_it_taut(rng, caplog):
    """Just taut, the active force along the tendon outweighs damping: a fL fV + fP = beta |v|."""
    problem = mixed_problem(rng, scso.CompliantTendon(fiber_velocity="from_path"))
    muscles = problem.motion.muscles
    fastest = muscles.optimal_fiber_length * muscles.max_contraction_velocity
    length = muscles.tendon_slack_length + 0.9 * muscles.optimal_fiber_length
    for m in (1, 2):
        problem = with_paths(problem, 2, m, length[m], -0.5 * fastest[m])
    # Moments that ask for nothing, so that every muscle wants to be at rest.
    trajectory = dataclasses.replace(problem.motion.trajectory, generalized_forces=np.zeros((4, 2)))
    problem = with_motion(problem, trajectory=trajectory)
    solution = scso.solve_trajectory(problem)
    assert "the tendons of m2, m5 are slack at the least activation" in caplog.text
    assert "the tendons of m3 are slack at the least activation" in caplog.text
    assert (solution.activation[2, [1, 2]] > 0.05).all()
    assert (solution.tendon_force[:, ELASTIC] > -1e-5).all()
    np.testing.assert_allclose(solution.tendon_force[2, [1, 2]], 0.0, atol=1e-3)
    along = along_tendon(problem, solution.variables[FIBERS])
    pull = fiber_force(problem, along, velocity_of(problem), solution.activation)
    np.testing.assert_allclose(pull[2, [1, 2]], 0.0, atol=1e-3)


def test_unknown_choices_are_refused():
    with pytest.raises(scso.ProblemError, match="fiber_velocity is 'fast', expected 'zero' or 'from_path'"):
        scso.CompliantTendon(fiber_velocity="fast")
    with pytest.raises(scso.ProblemError, match="short_fibers is 'no', expected 'refuse' or 'silence'"):
        scso.CompliantTendon(short_fibers="no")


# A walking motion -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walk(shared_data):
    setup = shared_data / "gait10dof18musc" / "setup_static_optimization.xml"
    return scso.load_motion(setup, step_interval=4)


@pytest.mark.opensim
@any_velocity
def test_fibers_are_in_equilibrium_in_every_frame_of_a_walk(walk, fiber_velocity):
    problem = scso.static_optimization(walk, muscle_model=scso.CompliantTendon(fiber_velocity=fiber_velocity))
    solutions = [solve(problem) for solve in (scso.solve_trajectory, scso.solve_framewise)]
    for solution in solutions:
        assert solution.is_solved.all()
        assert solution.violation["CompliantTendon"] < RESIDUAL
        (group,) = muscle_groups(problem.motion.muscles)
        columns = repeat_over_frames(group.muscle, problem.motion.trajectory.n_frames)
        force = on_arrays(
            lambda q, length, columns=columns: force_of_tendon(columns, q, length),
            solution.variables[FIBERS],
            problem.motion.trajectory.muscle_tendon_length,
        )
        strength = problem.motion.muscles.max_isometric_force
        np.testing.assert_allclose(solution.tendon_force / strength, force / strength, rtol=0, atol=RESIDUAL)
        expected = solve_equilibrium(
            group.muscle,
            solution.activation,
            problem.motion.trajectory.muscle_tendon_length,
            problem.motion.trajectory.muscle_tendon_velocity if fiber_velocity == "from_path" else 0.0,
        )
        error = (
            np.abs(solution.tendon_force - expected.tendon_force) / problem.motion.muscles.max_isometric_force
        )
        # Near slack tendons are soft: a residual of 1e-8 moves the fiber, and the force follows.
        assert error.max() < 1e-6


@pytest.mark.opensim
@any_velocity
def test_both_solvers_agree_on_a_walk_with_elastic_tendons(walk, fiber_velocity):
    problem = scso.static_optimization(walk, muscle_model=scso.CompliantTendon(fiber_velocity=fiber_velocity))
    whole, single = (
        solve(problem, options=OPTIONS) for solve in (scso.solve_trajectory, scso.solve_framewise)
    )
    np.testing.assert_allclose(whole.activation, single.activation, atol=1e-6)
    strength = problem.motion.muscles.max_isometric_force
    np.testing.assert_allclose(whole.tendon_force / strength, single.tendon_force / strength, atol=1e-6)


def test_stability_rows_of_elastic_tendons_are_affine_and_kept(rng):
    """The row is what helpers compute by hand from the tendon forces, and is no expression for the solver."""
    problem = random_problem(rng, n_frames=2, n_muscles=8, reserve=5.0, muscle_model=scso.CompliantTendon())
    path = problem.motion.trajectory.muscle_tendon_length.mean(axis=0)
    muscles = dataclasses.replace(
        problem.motion.muscles, tendon_slack_length=0.6 * path, optimal_fiber_length=0.4 * path
    )
    problem = with_stability(with_motion(problem, muscles=muscles), 20.0)
    split = describe(problem).split
    n_muscles = problem.motion.muscles.n_muscles
    assert sum(rows.size for _, rows in split.nonlinear) == 2 * n_muscles, "only the model's own rows"
    soft = dataclasses.replace(problem.constraints[1], soft=1.0)
    problem = dataclasses.replace(problem, constraints=(problem.constraints[0], soft))
    solution = scso.solve_trajectory(problem)
    stiffness, work = stability_by_hand(problem)
    reached = np.einsum("kum,km->ku", stiffness, solution.tendon_force) - work
    missed = solution.variables["JointStability.missed"]
    assert (reached + missed > 20.0 - 1e-5).all()
    at_price = missed > 1e-3
    np.testing.assert_allclose((reached + missed)[at_price], 20.0, atol=1e-4)
