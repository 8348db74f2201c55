"""Exact derivatives of the built program with every muscle model: against differences of fourth order."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest
from helpers import with_trajectory
from muscle_models.mixed_muscles import CLASSES, DE_GROOTE, MILLARD, RIGID, SHAPES, THELEN, mixed_problem

import scso_nlp as scso
from scso_nlp.transcription.build import FrameScale, build_nlp
from scso_nlp.transcription.describe import describe

#: Step in scaled unknowns, activations and fiber lengths of about 1. Truncation h^4 f'''''/30 and rounding
#: 1e-16 f/h meet near it: Millard's quintic curves have large fifth derivatives.
STEP = 5e-5
#: Relative to the largest entry of the same row.
TOLERANCE = 2e-8


def differences(function, x):
    """Derivatives by central differences of fourth order, one column per unknown."""
    columns = []
    for i in range(x.size):
        moved = []
        for steps in (-2, -1, 1, 2):
            y = x.copy()
            y[i] += steps * STEP
            moved.append(np.asarray(function(y)))
        columns.append((moved[0] - 8 * moved[1] + 8 * moved[2] - moved[3]) / (12 * STEP))
    return np.array(columns).T


def assert_same(found, expected):
    size = np.maximum(np.abs(expected).max(axis=-1, keepdims=True), 1.0)
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=TOLERANCE)


def check(problem, activation, fibers=None, excitation=None, seed=0):
    """Gradient, Jacobian and Hessian of the Lagrangian at given activations and unknowns."""
    rng = np.random.default_rng(seed)
    program = describe(problem)
    n_frames = problem.motion.trajectory.n_frames
    nlp = build_nlp(program, n_frames)
    p = nlp.parameters(np.arange(n_frames), FrameScale.of_weights(program, np.ones(n_frames)))
    parts = {("problem", "activation"): activation, ("problem", "control"): rng.normal(size=(n_frames, 2))}
    if fibers is not None:
        parts["CompliantTendon", "fiber_length_along_tendon"] = fibers
    if excitation is not None:
        parts["ActivationDynamics", "excitation"] = excitation
    x = (program.layout.join(parts, program.layout.rows("guess", n_frames)) / program.layout.scale).ravel()
    lam = rng.normal(size=nlp.g.numel())
    values = ca.Function("v", [nlp.x, nlp.p], [nlp.f, nlp.g])

    def first(y):
        return (nlp.derivatives[name](y, p)[1].full() for name in ("grad_f", "jac_g"))

    def slope(y):
        gradient, jacobian = first(y)
        return gradient.ravel() + lam @ jacobian

    gradient, jacobian = first(x)
    assert_same(gradient.T, differences(lambda y: values(y, p)[0].full().ravel(), x))
    assert_same(jacobian, differences(lambda y: values(y, p)[1].full().ravel(), x))
    upper = nlp.derivatives["hess_lag"](x, p, 1.0, lam).full()
    assert_same(upper + np.triu(upper, 1).T, differences(slope, x))
    return nlp


def inside(problem, rng):
    """Activations and fibers away from bounds, from slack tendons and from the kinks of Thelen's curves.

    Thelen's passive curve bends at optimal length, his tendon curve at slack length and at 0.33 of F0, his
    force-velocity curve at rest: no second derivative exists there.
    """
    muscles = problem.motion.muscles
    elastic = [m for m, name in enumerate(muscles.muscle_class) if name != RIGID]
    activation = rng.uniform(0.2, 0.8, (problem.motion.trajectory.n_frames, muscles.n_muscles))
    strain = rng.choice([0.012, 0.02, 0.04, 0.05], activation.shape)
    length = problem.motion.trajectory.muscle_tendon_length
    fibers = length - (1 + strain) * muscles.tendon_slack_length
    optimal = muscles.optimal_fiber_length
    near = np.abs(np.hypot(fibers, optimal * np.sin(muscles.pennation_angle_at_optimal)) / optimal - 1) < 0.02
    return activation, np.where(near, fibers + 0.05 * optimal, fibers)[:, elastic]


@pytest.mark.parametrize("fiber_velocity", ["zero", "from_path"])
@pytest.mark.parametrize("name", [THELEN, MILLARD, DE_GROOTE])
def test_elastic_tendons_of_every_class(rng, name, fiber_velocity):
    problem = mixed_problem(
        rng,
        scso.CompliantTendon(fiber_velocity=fiber_velocity),
        classes=(name,) * 3,
        shapes=({},) * 3,
        n_frames=2,
    )
    nlp = check(problem, *inside(problem, rng))
    assert not nlp.rows_are_affine


def test_elastic_tendons_of_mixed_classes_with_a_fiber_at_rest(rng):
    problem = mixed_problem(
        rng,
        scso.CompliantTendon(fiber_velocity="from_path", short_fibers="silence"),
        n_frames=2,
    )
    length = problem.motion.trajectory.muscle_tendon_length.copy()
    length[1, 0] = 0.9 * problem.motion.muscles.tendon_slack_length[0]
    activation, fibers = inside(problem, rng)
    problem = with_trajectory(problem, muscle_tendon_length=length)
    check(problem, activation, fibers)


@pytest.mark.parametrize("classes", [(THELEN,) * 3, CLASSES])
def test_physical_rigid_tendons_with_activation_dependent_velocity(rng, classes):
    shapes = SHAPES if classes is CLASSES else ({}, {"Flen": 1.8, "Af": 0.3}, {})
    problem = mixed_problem(
        rng, scso.RigidTendon(convention="physical"), classes=classes, shapes=shapes, n_frames=2
    )
    nlp = check(problem, inside(problem, rng)[0])
    assert not nlp.rows_are_affine


def test_physical_rigid_tendons_without_thelen_muscles_stay_affine(rng):
    problem = mixed_problem(
        rng,
        scso.RigidTendon(convention="physical"),
        classes=(MILLARD, DE_GROOTE, RIGID),
        shapes=({},) * 3,
        n_frames=2,
    )
    assert check(problem, inside(problem, rng)[0]).rows_are_affine


def test_activation_dynamics_with_elastic_tendons(rng):
    problem = mixed_problem(
        rng, scso.CompliantTendon(), classes=(MILLARD, DE_GROOTE), shapes=({},) * 2, n_frames=3
    )
    time = np.array([0.0, 0.01, 0.04])
    problem = dataclasses.replace(
        problem,
        motion=dataclasses.replace(
            problem.motion, trajectory=dataclasses.replace(problem.motion.trajectory, time=time)
        ),
        constraints=(*problem.constraints, scso.ActivationDynamics(), scso.ActivationRate()),
    )
    activation, fibers = inside(problem, rng)
    check(problem, activation, fibers, rng.uniform(0.2, 0.8, activation.shape))
