"""Stiffness laws inside problems: the formulas in NumPy, optima by a root finder, nonlinear rows."""

from __future__ import annotations

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem
from helpers import central_difference, two_antagonists, with_motion, with_trajectory
from muscle_models.classes import slope
from muscle_models.mixed_muscles import mixed_problem
from scipy.optimize import brentq

import scso_nlp as scso
from problems.random_hessian.lifted_stability import LiftedStability
from scso_nlp import CoordinateStability, HessianStability
from scso_nlp.muscle_models.compliant_tendon import CompliantTendon
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.muscle_classes import curves_of
from scso_nlp.muscle_models.stiffness_law import FiberStiffness, ProportionalStiffness, ShortRangeStiffness
from scso_nlp.trajectory import CoordinateCurvature
from scso_nlp.transcription.describe import describe
from scso_nlp.transcription.piece import evaluate

LAWS = [ShortRangeStiffness(), ShortRangeStiffness(constant=10.0), FiberStiffness()]
MODELS = [scso.NoPhysiology(), scso.RigidTendon(convention="physical"), CompliantTendon()]


def with_flat_curvature(problem):
    """Give a problem of mixed muscles curvature of no size and a load that any muscle makes up for."""
    trajectory = problem.motion.trajectory
    shape = (trajectory.n_frames, len(trajectory.coordinates))
    curvature = CoordinateCurvature(
        coordinates=trajectory.coordinates,
        path_curvature=np.zeros((*shape, shape[1], len(trajectory.muscles))),
        load_stiffness=np.zeros((*shape, shape[1])),
        passive_stiffness=np.zeros((*shape, shape[1])),
        asymmetry=np.zeros((shape[0], len(trajectory.muscles))),
        is_uncertain=np.zeros((shape[0], len(trajectory.muscles)), dtype=bool),
    )
    return with_trajectory(problem, curvature=curvature)


def fibers(problem, state):
    """Fiber length and cosine: from a compliant model's unknowns, or with a tendon of slack length."""
    muscles, length = problem.motion.muscles, problem.motion.trajectory.muscle_tendon_length
    along = length - muscles.tendon_slack_length
    for m, muscle in enumerate(muscles.muscles):
        label = f"{muscle}_fiber"
        if label in state:
            along[:, m] = state[label]
    width = muscles.optimal_fiber_length * np.sin(muscles.pennation_angle_at_optimal)
    fiber = np.hypot(along, width)
    return fiber, along / fiber


def stiffness_by_hand(problem, law, activation, force, state):
    """Fiber along the tendon and tendon in series; the curves are the package's, the rest is written out."""
    muscles = problem.motion.muscles
    fiber, cosine = fibers(problem, state)
    result = np.zeros(force.shape)
    for m, opensim_class in enumerate(muscles.muscle_class):
        curves = curves_of(opensim_class)
        shape = curves.check_curve_parameters(muscles.muscles[m], muscles.curve_parameters[m])
        strength, optimal = muscles.max_isometric_force[m], muscles.optimal_fiber_length[m]
        if isinstance(law, ShortRangeStiffness):
            along_fiber = law.constant * force[:, m] / cosine[:, m] / optimal
        else:
            speed = problem.motion.trajectory.muscle_tendon_velocity[:, m] * cosine[:, m]
            speed = speed / (optimal * muscles.max_contraction_velocity[m])
            multiplier = on_arrays(
                lambda v, a, c=curves, s=shape: c.force_velocity(v, s, a), speed, activation[:, m]
            )
            step = 1e-6
            active, passive = (
                (
                    on_arrays(lambda x, f=f, s=shape: f(x, s), fiber[:, m] / optimal + step)
                    - on_arrays(lambda x, f=f, s=shape: f(x, s), fiber[:, m] / optimal - step)
                )
                / (2 * step)
                for f in (curves.active_force_length, curves.passive_force_length)
            )
            along_fiber = strength / optimal * (activation[:, m] * multiplier * active + passive)
        square = cosine[:, m] ** 2
        along = along_fiber * square + force[:, m] / cosine[:, m] / fiber[:, m] * (1 - square)
        if not curves.HAS_ELASTIC_TENDON:
            result[:, m] = along
            continue
        slack = muscles.tendon_slack_length[m]
        stretch = on_arrays(
            lambda f, c=curves, s=shape: c.inverse_tendon_force_length(f, s), force[:, m] / strength
        )
        tendon = (
            strength
            / slack
            * on_arrays(slope(lambda x, c=curves, s=shape: c.tendon_force_length(x, s)), stretch)
        )
        result[:, m] = along * tendon / np.where(along * tendon == 0, 1.0, along + tendon)
    return result


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_every_law_is_its_formula_with_every_muscle_model_and_class(rng, model, law):
    problem = with_flat_curvature(mixed_problem(rng, model))
    rows = CoordinateStability(stiffness=law, level=-1e4)
    problem = dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
    solution = scso.solve_trajectory(problem)
    labels = {}
    for name, values in solution.variables.items():
        if name.endswith("fiber_length_along_tendon"):
            spec = model.variables(problem.motion)[0]
            labels = dict(zip(spec.labels, values.T, strict=True))
    expected = stiffness_by_hand(problem, law, solution.activation, solution.tendon_force, labels)
    found = solution.quantities["CoordinateStability.muscle_stiffness"]
    # central differences of the curves are good to 1e-7 of their largest slope
    scale = 1e-6 * problem.motion.muscles.max_isometric_force / problem.motion.muscles.optimal_fiber_length
    pulls = solution.tendon_force > 0  # damping lets fast fibers push a little; that has no short range
    assert pulls.mean() > 0.9
    assert (np.abs(found - expected) <= scale + 1e-6 * np.abs(expected))[pulls].all()


@pytest.mark.parametrize("law", LAWS[::2], ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_rows_that_are_not_affine_are_found_and_have_exact_derivatives(rng, model, law):
    problem = with_flat_curvature(mixed_problem(rng, model, n_frames=2))
    rows = CoordinateStability(stiffness=law)
    problem = dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
    program = describe(problem)
    assert any(set(numbers) >= {2, 3} for _, numbers in program.split.nonlinear)
    piece = next(b.piece for b in program.rows.blocks if b.term == "CoordinateStability")
    x = program.layout.rows("guess", 2) / program.layout.scale
    (symbol,) = piece.unknowns
    hessian, gradient = ca.hessian(piece.expression[0], symbol)
    value, first, second = (
        piece.function(ca.vec(ca.densify(e))) for e in (piece.expression[0], gradient, hessian)
    )

    def at(function, point):
        points = np.vstack([point, x[1]])
        return evaluate(piece, function, points, program.arrays)[0][0]

    n = program.layout.size
    numeric = central_difference(lambda point: at(value, point), x[0], 1e-6)[0]
    exact = at(first, x[0])
    np.testing.assert_allclose(exact, numeric, rtol=1e-5, atol=1e-7 * np.abs(exact).max())
    curved = central_difference(lambda point: at(first, point), x[0], 1e-6)
    exact = at(second, x[0]).reshape(n, n)
    np.testing.assert_allclose(exact, curved, rtol=1e-4, atol=1e-6 * max(np.abs(exact).max(), 1e-6))


def test_co_contraction_with_short_range_stiffness_is_what_a_root_finder_says():
    """Two symmetric antagonists: the force difference is M / r, and their sum gives the stability."""
    moment, arm, strength = 5.0, 0.05, 2000.0
    problem = two_antagonists(moment, external_work=60.0, strength=strength)
    muscles = dataclasses.replace(
        problem.motion.muscles,
        tendon_slack_length=[0.1, 0.1],
        muscle_class=("DeGrooteFregly2016Muscle",) * 2,
        optimal_fiber_length=[0.1, 0.1],
    )
    law = ShortRangeStiffness()
    rows = scso.JointStability(stiffness=law, joints=("elbow",), axes=("z",))
    problem = dataclasses.replace(
        problem,
        motion=dataclasses.replace(problem.motion, muscles=muscles),
        constraints=(scso.MomentEquilibrium(), rows),
    )
    solution = scso.solve_trajectory(problem)

    def stability(least):
        total = 0.0
        for force in (least, least + moment / arm):
            fiber = 23.4 * force / 0.1
            c1, c2, c3 = 0.2, 1.0, 0.2  # OpenSim's tendon curve: c1 exp(kT (l - c2)) - c3
            k_t = math.log((1 + c3) / c1) / (1 + 0.049 - c2)
            tendon = strength / 0.1 * k_t * (force / strength + c3)
            stiffness = 1 / (1 / fiber + 1 / tendon) if force else 0.0
            # A·B = 0: the path's curvature is -r²/l
            total += force * -(arm**2) / 0.2 + stiffness * arm**2
        return total - 60.0

    expected = brentq(stability, 0.0, strength)
    np.testing.assert_allclose(solution.tendon_force[0], [expected + moment / arm, expected], rtol=1e-5)


def stiff_problem(rng, law, model=None, **options):
    """The random motion of the matrix inequality with fibers of one optimal length."""
    problem = hessian_problem(rng, **options)
    muscles = dataclasses.replace(
        problem.motion.muscles,
        tendon_slack_length=np.full(problem.motion.muscles.n_muscles, 0.1),
        muscle_class=("DeGrooteFregly2016Muscle", "Thelen2003Muscle")
        * (problem.motion.muscles.n_muscles // 2),
    )
    return dataclasses.replace(
        problem,
        motion=dataclasses.replace(problem.motion, muscles=muscles),
        muscle_model=model or problem.muscle_model,
        constraints=(scso.MomentEquilibrium(), HessianStability(stiffness=law, level=20.0)),
    )


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
@pytest.mark.parametrize("exponent", [2.0, 3.0])
def test_the_full_hessian_with_short_range_stiffness_is_stable_and_optimal(rng, solve, exponent):
    law = ShortRangeStiffness(constant=4.0)
    problem = stiff_problem(rng, law, n_frames=3, exponent=exponent, reserve=20.0)
    solution = solve(problem)
    check_stable(solution, 20.0)
    plain = scso.solve_trajectory(problem.without_stability())
    assert solution.objective > 1.02 * plain.objective
    level = CoordinateCurvature(
        **{
            name: getattr(problem.motion.trajectory.curvature, name)
            for name in ("coordinates", "path_curvature", "passive_stiffness", "asymmetry", "is_uncertain")
        },
        load_stiffness=problem.motion.trajectory.curvature.load_stiffness - 20.0 * np.eye(4),
    )
    lifted = dataclasses.replace(
        problem,
        motion=dataclasses.replace(
            problem.motion, trajectory=dataclasses.replace(problem.motion.trajectory, curvature=level)
        ),
        constraints=(scso.MomentEquilibrium(), LiftedStability(stiffness=law)),
    )
    assert solution.objective == pytest.approx(scso.solve_trajectory(lifted).objective, rel=1e-5)


def check_stable(solution, level):
    for k in range(solution.problem.motion.trajectory.n_frames):
        stiffness = solution.quantities["HessianStability.muscle_stiffness"][k]
        hessian = hessian_by_hand(solution.problem, k, solution.tendon_force[k], stiffness)
        assert np.linalg.eigvalsh(hessian)[0] > level - 1e-5


def test_the_full_hessian_is_stable_with_elastic_tendons(rng):
    problem = stiff_problem(
        rng, ShortRangeStiffness(constant=4.0), CompliantTendon(), n_frames=2, reserve=50.0
    )
    solution = scso.solve_trajectory(problem)
    check_stable(solution, 20.0)
    assert solution.objective > scso.solve_trajectory(problem.without_stability()).objective


def test_a_stiffer_law_never_costs_more(rng):
    costs = [
        scso.solve_trajectory(
            stiff_problem(np.random.default_rng(3), law, n_frames=2, reserve=20.0)
        ).objective
        for law in (
            ShortRangeStiffness(constant=3.0),
            ShortRangeStiffness(constant=6.0),
            ShortRangeStiffness(),
        )
    ]
    assert costs[0] >= costs[1] >= costs[2]


def test_proportional_stiffness_at_the_equivalent_gain_gives_the_same_rows(rng):
    """Without a tendon and without pennation γ F / l0 is q F / L with q = γ L / l0."""
    problem = stiff_problem(rng, ShortRangeStiffness())
    rigid = dataclasses.replace(
        problem.motion.muscles, muscle_class=("RigidTendonMuscle",) * problem.motion.muscles.n_muscles
    )
    problem = with_motion(problem, muscles=rigid)
    same = dataclasses.replace(
        problem,
        constraints=(
            scso.MomentEquilibrium(),
            HessianStability(stiffness=ProportionalStiffness(q=23.4 * 0.2 / 0.1), level=20.0),
        ),
    )
    np.testing.assert_allclose(
        scso.solve_trajectory(problem).activation, scso.solve_trajectory(same).activation, atol=1e-5
    )


@pytest.mark.parametrize("constant", [0.0, -1.0, math.nan, math.inf])
def test_a_constant_without_meaning_is_refused(constant):
    with pytest.raises(scso.ProblemError, match=r"constant is .* expected a positive number"):
        ShortRangeStiffness(constant=constant)


def test_a_muscle_class_without_curves_is_refused_by_name(rng):
    problem = hessian_problem(rng)
    muscles = dataclasses.replace(
        problem.motion.muscles, muscle_class=("Millard2012AccelerationMuscle",) * 16
    )
    with pytest.raises(scso.DataError, match="muscle 'm1' is a Millard2012AccelerationMuscle"):
        ShortRangeStiffness().data(dataclasses.replace(problem.motion, muscles=muscles))


def test_a_path_shorter_than_its_tendon_still_has_a_finite_stiffness(rng):
    problem = mixed_problem(rng, scso.NoPhysiology())
    short = dataclasses.replace(
        problem.motion.trajectory,
        muscle_tendon_length=np.full_like(problem.motion.trajectory.muscle_tendon_length, 0.1),
    )
    data = ShortRangeStiffness().data(dataclasses.replace(problem.motion, trajectory=short))
    assert (data["rigid_fiber_length"] >= 0.01 * problem.motion.muscles.optimal_fiber_length - 1e-15).all()
    assert (data["rigid_cos_pennation"] > 0.09).all()


# Falling ------------------------------------------------------------------------------------------


def test_falling_stiffness_has_half_its_gain_at_half_force():
    problem = two_antagonists(20.0, strength=2000.0)
    law = scso.FallingStiffness(q={"m1": 20.0, "m2": 10.0}, half_force=0.25)
    rows = scso.JointStability(stiffness=law, joints=("elbow",), axes=("z",))
    problem = dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
    solution = scso.solve_trajectory(problem)
    force = solution.tendon_force
    found = solution.quantities["JointStability.muscle_stiffness"]
    np.testing.assert_allclose(found, [20.0, 10.0] * force / 0.2 / (1 + force / 500.0), rtol=1e-9)
    # where that is the force itself, k = (q / 2) F / L
    at_half = dataclasses.replace(law, half_force=float(force[0, 0]) / 2000.0)
    seen = scso.observe(solution, dataclasses.replace(rows, stiffness=at_half, label="half"))
    assert seen.quantities["half.muscle_stiffness"][0, 0] == pytest.approx(10.0 * force[0, 0] / 0.2, rel=1e-9)


@pytest.mark.parametrize("level", [0.0, 30.0, 60.0])
def test_antagonists_with_falling_stiffness_are_those_of_a_root_finder(level):
    """r = 0.05 m, and external work of 30 N·m/rad less the curvature of straight muscles."""
    moment, q, half = 10.0, 20.0, 0.3
    problem = two_antagonists(moment, strength=2000.0)
    arguments = {"joints": ("elbow",), "axes": ("z",), "level": level}
    proportional = scso.JointStability(q=q, **arguments)
    falling = scso.JointStability(stiffness=scso.FallingStiffness(q=q, half_force=half), **arguments)
    # stability is affine in forces but for stiffness: curvature c per newton from the rows themselves
    data = proportional.stability_rows(problem.motion)
    c, load = data.curvature[0, 0], data.external_work[0, 0]

    def margin(antagonist):
        forces = np.array([antagonist + moment / 0.05, antagonist])
        stiffness = q * forces / 0.2 / (1 + forces / (half * 2000.0))
        return c @ forces + 0.05**2 * stiffness.sum() - load - level

    solution = scso.solve_trajectory(
        dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), falling))
    )
    expected = 0.0 if margin(0.0) >= 0 else brentq(margin, 0.0, 1800.0)
    assert (margin(0.0) < 0) == (level > 0)
    np.testing.assert_allclose(solution.tendon_force[0, 1], expected, atol=1e-4)
    assert solution.verdict.is_clean


@pytest.mark.parametrize("model", [scso.NoPhysiology(), *MODELS[:2], scso.RigidTendon()])
def test_rows_with_falling_stiffness_are_concave_so_that_the_problem_is_convex(rng, model):
    """No direction in which a row curves upwards, at random points: the set that keeps all rows is convex."""
    problem = with_flat_curvature(mixed_problem(rng, model))
    rows = CoordinateStability(stiffness=scso.FallingStiffness(q=20.0, half_force=0.1))
    problem = dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
    program = describe(problem)
    piece = next(b.piece for b in program.rows.blocks if b.term == "CoordinateStability")
    (symbol,) = piece.unknowns
    n = program.layout.size
    for row in range(piece.expression.numel()):
        second = piece.function(ca.vec(ca.densify(ca.hessian(piece.expression[row], symbol)[0])))
        points = rng.uniform(0.01, 1.0, (len(problem.motion.trajectory.time), n))
        curved = evaluate(piece, second, points, program.arrays)[0].reshape(-1, n, n)
        largest = np.linalg.eigvalsh(curved)
        assert largest.max() <= 1e-9 * -largest.min()
        assert largest.min() < 0


@pytest.mark.parametrize("half_force", [0.0, -1.0, math.nan, math.inf])
def test_a_half_force_that_is_none_is_refused(half_force):
    with pytest.raises(scso.ProblemError, match="half_force is"):
        scso.FallingStiffness(half_force=half_force)


@pytest.mark.parametrize("factor", [0.0, 1.0, 4.0])
def test_more_compliant_tendons_are_softer_springs_in_series(rng, factor):
    problem = with_flat_curvature(mixed_problem(rng, scso.NoPhysiology()))
    rows = CoordinateStability(stiffness=ShortRangeStiffness(tendon_compliance=factor), level=-1e4)
    problem = dataclasses.replace(problem, constraints=(scso.MomentEquilibrium(), rows))
    solution = scso.solve_trajectory(problem)
    force, found = solution.tendon_force, solution.quantities["CoordinateStability.muscle_stiffness"]
    asis = stiffness_by_hand(problem, ShortRangeStiffness(), solution.activation, force, {})
    fiber, cosine = fibers(problem, {})
    muscles = problem.motion.muscles
    along = 23.4 * force / cosine / muscles.optimal_fiber_length * cosine**2 + force / cosine / fiber * (
        1 - cosine**2
    )
    elastic = [curves_of(name).HAS_ELASTIC_TENDON for name in muscles.muscle_class]
    with np.errstate(divide="ignore", invalid="ignore"):
        tendon_gives = np.where(elastic, 1 / asis - 1 / along, 0.0)  # compliance of the tendon as it is
        expected = 1 / (1 / along + factor * tendon_gives)
    np.testing.assert_allclose(found[force > 0], expected[force > 0], rtol=1e-6)


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_a_tendon_compliance_that_is_none_is_refused(value):
    with pytest.raises(scso.ProblemError, match="tendon_compliance is"):
        ShortRangeStiffness(tendon_compliance=value)
