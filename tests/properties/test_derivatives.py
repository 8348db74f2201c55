"""The program that IPOPT sees: values against NumPy, derivatives against finite differences."""

from __future__ import annotations

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from coupled_terms import CappedEffort, CurvedPair, RateLimit, Smoothness, WeightedDrift
from helpers import (
    central_difference,
    random_problem,
    stability_by_hand,
    with_joint_reactions,
    with_motion,
)

import scso_nlp as scso
from scso_nlp.transcription.build import FrameScale, build_nlp
from scso_nlp.transcription.describe import describe

#: Central differences with this step are good to about step² times a third derivative.
STEP = 1e-5
RELATIVE, ABSOLUTE = 1e-6, 1e-7


class Program:
    """The built program over some frames, with the derivatives that IPOPT is given, as NumPy functions."""

    def __init__(self, problem, frames, size=None):
        program = describe(problem)
        nlp = build_nlp(program, len(frames), is_scaled=size is not None)
        self.nlp = nlp
        self.frames = np.asarray(frames)
        self.weights = (
            np.linspace(0.5, 2.0, len(frames)) if not problem.coupled_terms else np.ones(len(frames))
        )
        weights = np.ones(program.time.size)
        weights[self.frames] = self.weights
        self.scale = FrameScale.of_weights(program, weights)
        if size is not None:
            self.scale = dataclasses.replace(self.scale, unknowns=np.full(program.time.size, size))
        self.p = nlp.parameters(self.frames, self.scale)
        self.values_of = ca.Function("v", [nlp.x, nlp.p], [nlp.f, nlp.g])

    def f(self, x):
        return float(self.values_of(x, self.p)[0])

    def g(self, x):
        return self.values_of(x, self.p)[1].full().ravel()

    def first(self, x):
        """Gradient and Jacobian; the values beside them are those of the program."""
        f, gradient = self.nlp.derivatives["grad_f"](x, self.p)
        g, jacobian = self.nlp.derivatives["jac_g"](x, self.p)
        assert float(f) == self.f(x)
        np.testing.assert_array_equal(g.full().ravel(), self.g(x))
        return gradient.full().ravel(), jacobian.full()

    def check(self, x, rng):
        gradient, jacobian = self.first(x)
        np.testing.assert_allclose(
            gradient, central_difference(self.f, x, STEP), rtol=RELATIVE, atol=ABSOLUTE
        )
        np.testing.assert_allclose(jacobian, central_difference(self.g, x, STEP), rtol=RELATIVE, atol=1e-6)
        lam = rng.normal(size=self.nlp.g.numel())

        def slope(y):
            gradient, jacobian = self.first(y)
            return 1.5 * gradient + lam @ jacobian

        upper = self.nlp.derivatives["hess_lag"](x, self.p, 1.5, lam).full()
        assert not np.tril(upper, -1).any()
        np.testing.assert_allclose(
            upper + np.triu(upper, 1).T, central_difference(slope, x, STEP), rtol=1e-5, atol=1e-5
        )


def interior(problem, n_frames, rng):
    """A random point well inside the bounds, controls of both signs."""
    program = describe(problem)
    x = rng.uniform(0.1, 0.9, (n_frames, program.layout.size))
    n = problem.motion.muscles.n_muscles
    x[:, n : n + problem.motion.actuators.n_actuators] = rng.uniform(0.2, 0.9) * rng.choice(
        [-1, 1], problem.motion.actuators.n_actuators
    )
    return x.ravel()


@pytest.mark.parametrize("frames", [[0], [2], [0, 1, 2], [0, 2]])
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 2.5, 3.0, 7.3, math.inf])
def test_effort_has_exact_first_and_second_derivatives(rng, exponent, frames):
    problem = random_problem(rng, n_frames=3, n_muscles=5, exponent=exponent, reserve=5.0)
    Program(problem, frames).check(interior(problem, len(frames), rng), rng)


@pytest.mark.parametrize("size", [1e-3, 20.0])
def test_derivatives_are_those_by_unknowns_on_their_own_scale(rng, size):
    problem = coupled(random_problem(rng, n_muscles=4, reserve=5.0)).without_coupling()
    for objectives in (problem.objectives, (*problem.objectives, lambda f: ca.sumsqr(ca.exp(f.activation)))):
        own = dataclasses.replace(problem, objectives=objectives)
        Program(own, [1], size).check(interior(own, 1, rng) / size, rng)


@pytest.mark.parametrize("frames", [[1], [0, 1, 2]])
def test_a_function_of_the_frame_has_exact_derivatives_for_nothing(rng, frames):
    def cost(frame):
        return ca.sum1(ca.exp(frame.activation)) + 1e-6 * ca.sumsqr(frame.muscle.tendon_force) * ca.sin(
            frame.activation[0]
        )

    problem = random_problem(rng, n_muscles=5, reserve=5.0, muscle_model=scso.RigidTendon())
    problem = dataclasses.replace(problem, objectives=(*problem.objectives, cost))
    Program(problem, frames).check(interior(problem, len(frames), rng), rng)


def test_terms_of_joint_reactions_have_exact_derivatives(rng):
    problem = with_joint_reactions(
        random_problem(rng, n_muscles=5, reserve=5.0, muscle_model=scso.RigidTendon()), rng
    )
    limit = scso.JointReactionLimit(largest=900.0, components={"knee_fy": 500.0})
    problem = dataclasses.replace(
        problem,
        objectives=(*problem.objectives, scso.JointReactionEffort()),
        constraints=(*problem.constraints, limit, scso.JointReactionCone(joints=["hip"])),
    )
    Program(problem, [0, 2]).check(interior(problem, 2, rng), rng)


def test_coupled_and_curved_terms_have_exact_derivatives(rng):
    problem = coupled(random_problem(rng, n_muscles=4, reserve=5.0))
    program = Program(problem, [0, 1, 2])
    assert not program.nlp.rows_are_affine
    program.check(interior(problem, 3, rng), rng)


def coupled(problem):
    problem = dataclasses.replace(
        problem,
        objectives=(*problem.objectives, Smoothness(weight=2.0), WeightedDrift(weight=0.5)),
        constraints=(*problem.constraints, CappedEffort(), RateLimit(), CurvedPair()),
    )
    time = np.array([0.0, 0.01, 0.04])
    velocity = np.random.default_rng(1).normal(size=problem.motion.trajectory.muscle_tendon_velocity.shape)
    trajectory = dataclasses.replace(problem.motion.trajectory, time=time, muscle_tendon_velocity=velocity)
    return with_motion(problem, trajectory=trajectory)


def test_the_program_has_the_values_that_its_terms_say(rng):
    """Objective and all rows, affine and curved, of frames and of pairs, against NumPy sums."""
    problem = coupled(random_problem(rng, n_muscles=4, reserve=5.0))
    trajectory, n_frames = problem.motion.trajectory, 3
    program = Program(problem, [0, 1, 2])
    x = interior(problem, n_frames, rng)
    unknowns = x.reshape(n_frames, -1)
    a, c = unknowns[:, :4], unknowns[:, 4:]
    dt = np.diff(trajectory.time)
    effort = (a**2).sum() + (c**2).sum()
    smooth = (np.diff(a, axis=0) ** 2).sum(axis=1) / dt
    drift = np.einsum("km,km->k", trajectory.muscle_tendon_length[:-1], a[:-1] ** 2) + dt * (
        np.einsum("km,km->k", trajectory.muscle_tendon_velocity[1:], a[1:]) ** 2
    )
    assert program.f(x) == pytest.approx(effort + 2.0 * smooth.sum() + 0.5 * drift.sum(), rel=1e-12)
    force = a * problem.motion.muscles.max_isometric_force
    equilibrium = np.einsum("kcm,km->kc", trajectory.moment_arms, force) + 5.0 * c
    equilibrium -= trajectory.generalized_forces
    stiffness, work = stability_by_hand(problem)
    stability = np.einsum("kum,km->ku", stiffness, force) - work
    lower, upper = program.nlp.row_bounds(program.frames, program.scale)
    g = program.g(x)
    # Affine rows lack their constants, which stand in the bounds: distances to a bound are comparable.
    affine = np.hstack([equilibrium, stability / 10.0])
    level = np.array([problem.constraints[1].level[f"elbow_{u}"] for u in "xyz"]) / 10.0
    expected = affine - np.concatenate([np.zeros(3), level])
    np.testing.assert_allclose((g - lower)[: affine.size], expected.ravel(), rtol=1e-9, atol=1e-9)
    rate = np.diff(a, axis=0) / dt[:, None] / 2.0
    at = affine.size
    np.testing.assert_allclose((upper - g)[at : at + rate.size], 0.5 - rate.ravel(), rtol=1e-9, atol=1e-9)
    at += rate.size
    squares = np.stack([(a**2).sum(axis=1), a[:, 0] * a[:, 1]], axis=1) / 0.5
    np.testing.assert_allclose(g[at : at + squares.size], squares.ravel(), rtol=1e-12)
    at += squares.size
    np.testing.assert_allclose(g[at:], a[:-1, 0] * a[1:, 1] / dt, rtol=1e-12)


def test_rows_that_curve_are_not_taken_for_affine_ones(rng):
    problem = random_problem(rng, n_muscles=4)

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Kinks(scso.FrameConstraint):
        def rows(self, frame, motion):
            a = frame.activation
            values = (ca.fabs(a[0] - 0.5), ca.fmax(a[0], a[1]), ca.if_else(a[0] > 0.5, a[0], 2 * a[1]), a[2])
            return scso.Rows(value=ca.vertcat(*values), lower=-9.0, upper=9.0, names=("f", "m", "i", "a"))

    program = describe(dataclasses.replace(problem, constraints=(Kinks(),)))
    split = program.split
    assert split.affine.rows.tolist() == [3]
    assert split.nonlinear[0][1].tolist() == [0, 1, 2]


def test_an_objective_is_called_quadratic_only_if_it_is(rng):
    for cost, quadratic in (
        (lambda f: ca.sumsqr(f.activation) + 3 * f.activation[0], True),
        (lambda f: ca.sum1(ca.fmax(f.activation - 0.1, 0.0) ** 2), False),
        (lambda f: ca.sum1(f.activation**3), False),
        (lambda f: ca.sum1(f.activation), True),
    ):
        problem = dataclasses.replace(random_problem(rng), objectives=(cost,))
        program = describe(problem)
        assert build_nlp(program, 2).objective_is_quadratic is quadratic
