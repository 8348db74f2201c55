"""A problem with muscles of all four classes, and the forces of these classes in NumPy.

Thelen's and De Groote's curves are written out here; Millard's Bezier curves and the splines of
RigidTendonMuscle are the package's (tests of their own compare them with OpenSim), the sums are not.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from helpers import motion
from muscle_models.classes import AtDefaults, millard2012, rigid_tendon_muscle

import scso_nlp as scso
from scso_nlp.muscle_models.curves import on_arrays

THELEN, MILLARD, DE_GROOTE, RIGID = (
    "Thelen2003Muscle",
    "Millard2012EquilibriumMuscle",
    "DeGrooteFregly2016Muscle",
    "RigidTendonMuscle",
)
#: Out of order on purpose: columns of one class do not stand together.
CLASSES = (THELEN, MILLARD, DE_GROOTE, RIGID, MILLARD, THELEN, RIGID, DE_GROOTE)
#: Shapes other than OpenSim's defaults, for one muscle of a class.
SHAPES = ({}, {}, {"fiber_damping": 0.05}, {}, {"fiber_damping": 0.03}, {"Flen": 1.8, "Af": 0.3}, {}, {})


def muscle_parameters(classes=CLASSES, shapes=SHAPES, **changes):
    n = len(classes)
    values = {
        "muscles": tuple(f"m{i + 1}" for i in range(n)),
        "muscle_class": tuple(classes),
        "max_isometric_force": np.linspace(500.0, 1400.0, n),
        "optimal_fiber_length": np.linspace(0.07, 0.12, n),
        "tendon_slack_length": np.linspace(0.15, 0.25, n),
        "pennation_angle_at_optimal": np.linspace(0.0, 0.4, n),
        "max_contraction_velocity": np.linspace(8.0, 12.0, n),
        "min_activation": np.full(n, 0.01),
        "max_activation": np.ones(n),
        "activation_time_constant": np.linspace(0.01, 0.02, n),
        "deactivation_time_constant": np.linspace(0.04, 0.06, n),
        "curve_parameters": tuple(shapes),
    }
    return scso.MuscleParameters(**(values | changes))


def mixed_problem(
    rng, model, *, classes=CLASSES, shapes=SHAPES, n_frames=4, n_coordinates=2, reserve=20.0, **changes
):
    """Fibers of 0.75 to 1.25 optimal lengths with slack tendons, paths at up to 0.3 of the top speed."""
    muscles = muscle_parameters(classes, shapes, **changes)
    n = muscles.n_muscles
    shape = (n_frames, n)
    fastest = muscles.optimal_fiber_length * muscles.max_contraction_velocity
    fiber = muscles.optimal_fiber_length * rng.uniform(0.75, 1.25, shape)
    arms = rng.normal(0, 0.04, (n_frames, n_coordinates, n))
    force = muscles.max_isometric_force * rng.uniform(0.1, 0.4, shape)
    trajectory = dataclasses.replace(
        motion(
            arms,
            np.einsum("kcm,km->kc", arms, force),
            actuator_columns=reserve * np.eye(n_coordinates),
            capacity=muscles.max_isometric_force * rng.uniform(0.5, 1.0, shape),
        ),
        muscle_tendon_length=muscles.tendon_slack_length + fiber * np.cos(muscles.pennation_angle_at_optimal),
        muscle_tendon_velocity=fastest * rng.uniform(-0.3, 0.3, shape),
    )
    return scso.MuscleForceProblem(
        motion=scso.Motion(
            trajectory=trajectory,
            muscles=muscles,
            actuators=scso.ActuatorParameters(
                actuators=trajectory.actuators,
                optimal_force=np.full(n_coordinates, reserve),
                min_control=np.full(n_coordinates, -np.inf),
                max_control=np.full(n_coordinates, np.inf),
            ),
        ),
        muscle_model=model,
        objectives=(scso.ActivationEffort(exponent=2.0),),
    )


def _thelen_velocity(v, a, af=0.25, f_len=1.4, threshold=0.95):
    """Thelen's force-velocity relation, inverted: Af, Flen and the extrapolation beyond 95 % of Flen."""
    w = v / (0.25 + 0.75 * a)
    b = (2 + 2 / af) / (f_len - 1)
    at = (threshold * f_len - 1) / (b * f_len * (1 - threshold))
    slope = 1 / (
        1 / (b * f_len * (1 - threshold)) + (threshold * f_len - 1) * b / (b * f_len * (1 - threshold)) ** 2
    )
    return np.select(
        [w <= -1, w <= 0, w < at],
        [0 * w, (1 + w) / (1 - w / af), (1 + w * b * f_len) / (1 + w * b)],
        threshold * f_len + (w - at) * slope,
    )


def _thelen(length, velocity, a, shape):
    active = np.exp(-((length - 1) ** 2) / 0.45)
    passive = np.where(length > 1, np.expm1(5 * (length - 1) / 0.6) / np.expm1(5), 0)
    multiplier = _thelen_velocity(velocity, a, shape.get("Af", 0.25), shape.get("Flen", 1.4))
    return active * multiplier, passive, 0.0


def _thelen_tendon(stretch, shape):
    e, strain = 0.04, stretch - 1
    toe = 99 * e * np.exp(3) / (166 * np.exp(3) - 67)
    linear = 0.67 / (e - toe) * (strain - toe) + 0.33
    curved = 0.33 / np.expm1(3) * np.expm1(3 * np.minimum(strain, toe) / toe)
    return np.where(strain > toe, linear, np.maximum(curved, 0))


def _de_groote(length, velocity, a, shape):
    bumps = (
        (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
        (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
        (0.1, 1.0, 0.353553390593274, 0.0),
    )
    active = sum(b1 * np.exp(-0.5 * ((length - b2) / (b3 + b4 * length)) ** 2) for b1, b2, b3, b4 in bumps)
    d1, d2, d3, d4 = -0.3211346127989808, -8.149, -0.374, 0.8825327733249912
    t = d2 * velocity + d3
    multiplier = d1 * np.log(t + np.sqrt(t**2 + 1)) + d4
    offset = np.exp(4 * (0.2 - 1) / 0.6)
    passive = (np.exp(4 * (length - 1) / 0.6) - offset) / (np.exp(4) - offset)
    return active * multiplier, passive, shape.get("fiber_damping", 0.0)


def _de_groote_tendon(stretch, shape):
    stiffness = np.log((1 + 0.2) / 0.2) / (1 + 0.049 - 1)
    return 0.2 * np.exp(stiffness * (stretch - 1)) - 0.2


def _millard(length, velocity, a, shape):
    c = millard2012.check_curve_parameters("m", shape)
    active = on_arrays(lambda x: millard2012.active_force_length(x, c), length)
    multiplier = on_arrays(lambda x: millard2012.force_velocity(x, c), velocity)
    passive = on_arrays(lambda x: millard2012.passive_force_length(x, c), length)
    return active * multiplier, passive, shape.get("fiber_damping", 0.1)


def _millard_tendon(stretch, shape):
    c = millard2012.check_curve_parameters("m", shape)
    return on_arrays(lambda x: millard2012.tendon_force_length(x, c), stretch)


def _rigid(length, velocity, a, shape):
    curves = AtDefaults(rigid_tendon_muscle)
    active = on_arrays(curves.active_force_length, length)
    multiplier = on_arrays(curves.force_velocity, velocity)
    return active * multiplier, on_arrays(curves.passive_force_length, length), 0.0


_FIBERS = {THELEN: _thelen, MILLARD: _millard, DE_GROOTE: _de_groote, RIGID: _rigid}
_TENDONS = {THELEN: _thelen_tendon, MILLARD: _millard_tendon, DE_GROOTE: _de_groote_tendon}


def fiber_force(problem, along_tendon, velocity, activation, *, passive=True):
    """F0 (a fL fV + fP + beta v) cos(alpha) of every muscle and frame, one muscle after the other [N]."""
    muscles = problem.motion.muscles
    force = np.full(activation.shape, np.nan)
    for m, name in enumerate(muscles.muscle_class):
        optimal = muscles.optimal_fiber_length[m]
        height = optimal * np.sin(muscles.pennation_angle_at_optimal[m])
        fiber = np.hypot(along_tendon[:, m], height)
        cosine = along_tendon[:, m] / fiber
        speed = velocity[:, m] * cosine / (optimal * muscles.max_contraction_velocity[m])
        active, stretched, damping = _FIBERS[name](
            fiber / optimal, speed, activation[:, m], muscles.curve_parameters[m]
        )
        rest = passive * (stretched + damping * speed)
        force[:, m] = muscles.max_isometric_force[m] * (activation[:, m] * active + rest) * cosine
    return force


def rigid_force(problem, activation, *, passive=True):
    """Force of every muscle with a tendon of slack length [N]."""
    along = problem.motion.trajectory.muscle_tendon_length - problem.motion.muscles.tendon_slack_length
    return fiber_force(
        problem, along, problem.motion.trajectory.muscle_tendon_velocity, activation, passive=passive
    )


def tendon_force(problem, along_tendon):
    """F0 fT of every elastic tendon, NaN for the others [N]."""
    muscles = problem.motion.muscles
    force = np.full(along_tendon.shape, np.nan)
    for m, name in enumerate(muscles.muscle_class):
        if name in _TENDONS:
            length = problem.motion.trajectory.muscle_tendon_length[:, m] - along_tendon[:, m]
            stretch = length / muscles.tendon_slack_length[m]
            force[:, m] = muscles.max_isometric_force[m] * _TENDONS[name](
                stretch, muscles.curve_parameters[m]
            )
    return force
