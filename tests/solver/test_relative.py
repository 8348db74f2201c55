"""Where IPOPT starts coupled and curved programs: quadratic programs over all their frames.

Seeded and few by default; ``SCSO_ROBUSTNESS=300 pytest tests/solver/test_relative.py`` tries more.
"""

from __future__ import annotations

import dataclasses
import os

import casadi as ca
import numpy as np
import pytest
from coupled_terms import RateLimit, Smoothness, WeightedDrift
from helpers import random_problem

import scso_nlp as scso
from scso_nlp.solver.programs import starting_point
from scso_nlp.solver.relative import QuadraticPrograms
from scso_nlp.transcription.build import FrameScale, build_nlp
from scso_nlp.transcription.describe import describe

NUMBER = int(os.environ.get("SCSO_ROBUSTNESS", "24"))
COLD = scso.SolverOptions(presolve=False, tolerance=1e-12)
#: By how much a random motion's frames differ makes rates of up to some 40/s necessary.
FASTEST = (12.0, 40.0)


def with_terms(problem, *, objectives=(), constraints=()):
    return dataclasses.replace(
        problem,
        objectives=(*problem.objectives, *objectives),
        constraints=(*problem.constraints, *constraints),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cap(scso.FrameConstraint):
    """Sum of squared activations at most this large: a curved row, and convex."""

    most: float

    def rows(self, frame, motion):
        squares = ca.sumsqr(frame.activation)
        return scso.Rows(value=squares, lower=-np.inf, upper=self.most, names=("squares",), unit="-")


def capped(problem, share):
    """The problem with its sum of squared activations held below a share of what it would be at least."""
    free = scso.solve_framewise(problem, on_failure="return")
    most = share * (free.activation**2).sum(axis=1).min()
    return with_terms(problem, constraints=[Cap(most=most)])


#: Kinds of programs that are not frame by frame and affine, of a problem and random numbers.
KINDS = {
    "rate": lambda problem, rng: with_terms(problem, constraints=[RateLimit(fastest=rng.uniform(*FASTEST))]),
    "smooth": lambda problem, rng: with_terms(
        problem, objectives=[Smoothness(weight=np.exp(rng.uniform(-9, 0)))]
    ),
    "drift": lambda problem, rng: with_terms(problem, objectives=[WeightedDrift(weight=1e-2)]),
    "capped": lambda problem, rng: capped(problem, rng.uniform(1.0, 1.3)),
    "rate and capped": lambda problem, rng: with_terms(
        capped(problem, 1.3), constraints=[RateLimit(fastest=FASTEST[1])]
    ),
}


@pytest.mark.parametrize("exponent", [2.0, 3.0, 7.0])
@pytest.mark.parametrize("kind", KINDS)
def test_the_optimum_is_that_of_a_cold_start(kind, exponent):
    """All of these are convex, so that there is one optimum only; activations are unique."""
    solved = 0
    for seed in range(max(NUMBER // (3 * len(KINDS)), 1)):
        rng = np.random.default_rng(seed)
        drawn = random_problem(rng, n_frames=6, exponent=exponent, reserve=5.0)
        problem = KINDS[kind](drawn, rng)
        cold = scso.solve_trajectory(problem, options=COLD, on_failure="return")
        warm = scso.solve_trajectory(problem, on_failure="return")
        if not cold.is_solved.all():
            continue
        solved += 1
        assert warm.is_solved.all(), (seed, warm.summary())
        assert warm.objective == pytest.approx(cold.objective, rel=1e-8), seed
        if exponent < 7.0:
            np.testing.assert_allclose(warm.activation, cold.activation, atol=1e-6, err_msg=str(seed))
        if exponent == 2.0:
            assert warm.report.iterations <= 3 < cold.report.iterations, seed
    assert solved, "no problem of the kind can be solved"


def test_a_binding_rate_is_confirmed_without_an_iteration(rng):
    problem = random_problem(rng, n_frames=8, reserve=5.0)
    limited = with_terms(problem, constraints=[RateLimit(fastest=15.0)])
    solution = scso.solve_trajectory(limited)
    assert solution.report.iterations == 0
    assert (solution.rows["RateLimit"].multiplier[1:] > 1e-3).any(), "the limit is never reached"
    assert (solution.optimality.worst <= 1e-8).all()


@pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])
@pytest.mark.parametrize("law", [scso.ShortRangeStiffness(), scso.FiberStiffness()])
def test_curved_stability_rows_are_solved_as_from_a_cold_start(rng, solve, law):
    problem = random_problem(rng, n_frames=5, reserve=5.0, muscle_model=scso.RigidTendon())
    soft = scso.JointStability(stiffness=law, soft=1e-3)
    problem = dataclasses.replace(problem, constraints=(*problem.constraints[:1], soft))
    cold, warm = solve(problem, options=COLD, on_failure="return"), solve(problem, on_failure="return")
    assert [s.is_solved for s in warm.frame_status] == [s.is_solved for s in cold.frame_status]
    assert warm.objective == pytest.approx(cold.objective, rel=1e-8)
    if isinstance(law, scso.ShortRangeStiffness):  # convex with these tendons, as the other is not
        assert warm.report.iterations < cold.report.iterations


def test_rows_that_contradict_each_other_end_as_from_a_cold_start(rng):
    problem = with_terms(random_problem(rng, n_frames=4), constraints=[RateLimit(fastest=1e-3)])
    cold = scso.solve_trajectory(problem, options=COLD, on_failure="return")
    warm = scso.solve_trajectory(problem, on_failure="return")
    assert not warm.is_solved.any()
    assert warm.frame_status == cold.frame_status


def test_a_frame_that_cannot_be_solved_does_not_take_the_others_with_it(rng):
    """The cap is between the least efforts of two frames."""
    problem = random_problem(rng, n_frames=4)
    effort = (scso.solve_framewise(problem).activation ** 2).sum(axis=1)
    most = np.sort(effort)[-2:].mean()
    solution = scso.solve_trajectory(with_terms(problem, constraints=[Cap(most=most)]), on_failure="return")
    assert solution.is_solved.tolist() == (effort < most).tolist()


def test_curved_equations_are_left_to_ipopt(rng, monkeypatch):
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Circle(Cap):
        """The sum of squares is given."""

        def rows(self, frame, motion):
            return dataclasses.replace(super().rows(frame, motion), lower=self.most)

    def refuse(*_, **__):
        raise AssertionError("approached")

    problem = random_problem(rng, n_frames=3, reserve=5.0)
    monkeypatch.setattr(QuadraticPrograms, "follow", refuse)
    assert scso.solve_trajectory(with_terms(problem, constraints=[Circle(most=1.5)])).is_solved.all()
    with pytest.raises(AssertionError, match="approached"):
        scso.solve_trajectory(with_terms(problem, constraints=[Cap(most=1.5)]))


def test_steps_end_at_the_optimum_with_its_multipliers(rng):
    """The Lagrangian is stationary, multipliers of bounds included, in the solver's own numbers."""
    problem = capped(random_problem(rng, n_frames=3, reserve=5.0), 1.1)
    program = describe(problem)
    nlp, frames = build_nlp(program, 3), np.arange(3)
    scale = FrameScale.of_weights(program, np.ones(3))
    lower, upper = program.bounds()
    p = nlp.parameters(frames, scale)
    found = QuadraticPrograms(nlp).follow(
        x0=starting_point(program, None).ravel(),
        p=p,
        bounds=(lower.ravel(), upper.ravel()),
        row_bounds=nlp.row_bounds(frames, scale),
    )
    slope = np.asarray(nlp.derivatives["grad_f"](found.unknowns, p)[1]).ravel()
    value, jacobian = nlp.derivatives["jac_g"](found.unknowns, p)
    push = np.asarray(ca.mtimes(jacobian.T, found.rows)).ravel()
    np.testing.assert_allclose(slope + push + found.bounds, 0.0, atol=1e-5)
    least, most = nlp.row_bounds(frames, scale)
    assert (np.asarray(value).ravel() >= least - 1e-7).all()
    assert (np.asarray(value).ravel() <= most + 1e-7).all()
    assert np.abs(found.rows[-3:]).max() > 1e-3, "the cap does not bind"


def test_programs_that_are_not_convex_are_left_to_ipopt(rng):
    """A negative curvature of costs; rows that bend away, where the steps go or elsewhere."""

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Floor(scso.FrameConstraint):
        """A least sum of squares, which is no convex set, or a curve that is straight where one begins."""

        far: bool = False

        def rows(self, frame, motion):
            a = frame.activation
            value = ca.sum1(ca.fmax(a - 0.8, 0) ** 2) + ca.sum1(a) if self.far else ca.sumsqr(a)
            return scso.Rows(value=value, lower=0.5, upper=np.inf, names=("floor",), unit="-")

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Roughness(Smoothness):
        """Rewards change."""

        def value(self, previous, current, dt):
            return -1e-2 * super().value(previous, current, dt)

    problem = random_problem(rng, n_frames=3, reserve=5.0)
    for changed in (
        with_terms(problem, objectives=[Roughness()]),
        with_terms(problem, constraints=[Floor()]),
        with_terms(problem, constraints=[Floor(far=True)]),
    ):
        program = describe(changed)
        nlp, frames = build_nlp(program, 3), np.arange(3)
        scale = FrameScale.of_weights(program, np.ones(3))
        lower, upper = program.bounds()
        assert QuadraticPrograms(nlp).are_enough
        found = QuadraticPrograms(nlp).follow(
            x0=starting_point(program, None).ravel(),
            p=nlp.parameters(frames, scale),
            bounds=(lower.ravel(), upper.ravel()),
            row_bounds=nlp.row_bounds(frames, scale),
        )
        assert found is None, changed.constraints
        cold = scso.solve_trajectory(changed, options=COLD, on_failure="return")
        warm = scso.solve_trajectory(changed, on_failure="return")
        assert warm.frame_status == cold.frame_status
        assert warm.objective == pytest.approx(cold.objective, rel=1e-7)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Lag(scso.FramePairConstraint):
    """Unknowns of its own that activation runs after, on a curve."""

    follows: str = "activation"

    def variables(self, motion):
        names = tuple(f"{name}_wanted" for name in motion.muscles.muscles)
        return (scso.VariableSpec(name="wanted", labels=names, lower=0.0, upper=0.9, follows=self.follows),)

    def rows(self, previous, current, dt, motion):
        wanted = previous.variables["wanted"]
        rate = (wanted - previous.activation) * (1 + wanted)
        return scso.Rows(
            value=current.activation - previous.activation - 0.3 * rate,
            lower=-0.05,
            upper=0.05,
            names=motion.muscles.muscles,
            unit="-",
        )


def test_unknowns_that_follow_others_begin_where_these_are_without_coupling(rng):
    problem = with_terms(random_problem(rng, n_frames=5, reserve=5.0), constraints=[Lag()])
    layout = describe(problem).layout
    unknowns = rng.uniform(0.0, 1.2, (5, layout.size))
    followed = layout.split(layout.followed(unknowns))
    np.testing.assert_array_equal(
        followed["Lag", "wanted"], np.clip(followed["problem", "activation"], 0.0, 0.9)
    )
    np.testing.assert_array_equal(followed["problem", "activation"], unknowns[:, :10])
    cold = scso.solve_trajectory(problem, options=COLD)
    warm = scso.solve_trajectory(problem)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-8)
    np.testing.assert_allclose(warm.activation, cold.activation, atol=1e-6)


def test_unknowns_follow_as_many_others(rng):
    problem = with_terms(random_problem(rng, reserve=5.0), constraints=[Lag(follows="control")])
    with pytest.raises(
        scso.ProblemError,
        match=r"10 unknowns 'wanted' of Lag follow 'control', expected one of .*'control': 3",
    ):
        describe(problem)


@pytest.mark.parametrize("seed", range(3))
def test_muscles_beside_costly_reserves_are_at_their_optimum_too(seed):
    """What muscles still have to go must not be lost beside the cost of a residual that none can help."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, n_frames=8, n_muscles=20, exponent=3.0, reserve=1.0, stability=False)
    trajectory = problem.motion.trajectory
    moments, arms = trajectory.generalized_forces.copy(), trajectory.moment_arms.copy()
    moments[:, 0], arms[:, 0] = 400.0, 0.0
    trajectory = dataclasses.replace(trajectory, generalized_forces=moments, moment_arms=arms)
    problem = dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=trajectory))
    cold = scso.SolverOptions(presolve=False, tolerance=1e-12)
    for terms in ((), (scso.ActivationRate(),)):
        asked = dataclasses.replace(problem, constraints=(*problem.constraints, *terms))
        fast = scso.solve_trajectory(asked)
        exact = scso.solve_trajectory(asked, options=cold, on_failure="return")
        assert fast.objective > 1e6 * (fast.activation**3).sum()
        np.testing.assert_allclose(fast.activation, exact.activation, atol=1e-7)
        assert {status.name for status in fast.frame_status} == {"SOLVED"}
