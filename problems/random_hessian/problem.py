"""Random motions whose loads topple them unless muscles stiffen them, in every direction."""

from __future__ import annotations

import numpy as np

from scso_nlp import (
    ActivationEffort,
    ActuatorParameters,
    CoordinateCurvature,
    HessianStability,
    MomentEquilibrium,
    Motion,
    MotionTrajectory,
    MuscleForceProblem,
    MuscleParameters,
    NoPhysiology,
)

#: Length of every path [m], and the stiffness gain with which the motions are made [-].
LENGTH, GAIN = 0.2, 5.0


def make_problem(
    n_coordinates: int = 4,
    n_muscles: int = 16,
    n_frames: int = 4,
    *,
    seed: int | np.random.Generator = 0,
    reserve: float | None = None,
) -> MuscleForceProblem:
    """Describe a random motion with the whole Hessian over all its coordinates.

    Random activations between 0.1 and 0.5 solve it, with eigenvalues of 1 to 20 N·m/rad to spare.

    Parameters
    ----------
    n_coordinates, n_muscles, n_frames : int
    seed : int or numpy.random.Generator
    reserve : float, optional [N·m]
        Moment of a reserve per coordinate at a control of one; without it there are none.

    Returns
    -------
    MuscleForceProblem
    """
    rng = np.random.default_rng(seed)
    n, m = n_coordinates, n_muscles
    phase = np.linspace(0, 1, n_frames)
    arms = rng.normal(0, 0.04, (n, m)) + rng.normal(0, 0.01, (n, m)) * np.sin(6 * phase)[:, None, None]
    curvature = rng.normal(0, 0.03, (n, n, m))
    curvature = (curvature + curvature.transpose(1, 0, 2)) / 2
    curvature = curvature * (1 + 0.2 * np.cos(6 * phase))[:, None, None, None]
    strength = rng.uniform(300, 1500, m)
    force = strength * rng.uniform(0.1, 0.5, (n_frames, m))
    passive = np.diag(np.linspace(0.5, 2.0, n))
    per_newton = curvature + GAIN / LENGTH * arms[:, :, None] * arms[:, None]
    basis = np.linalg.qr(rng.normal(size=(n_frames, n, n)))[0]
    spare = (basis * rng.uniform(1.0, 20.0, (n_frames, 1, n))) @ basis.transpose(0, 2, 1)
    load = spare - passive - np.einsum("kijm,km->kij", per_newton, force)
    names = tuple(f"q{i + 1}" for i in range(n))
    actuators = tuple(f"reserve{i + 1}" for i in range(n)) if reserve is not None else ()
    columns = np.zeros((n, 0)) if reserve is None else reserve * np.eye(n)
    still = np.zeros((n_frames, n))
    trajectory = MotionTrajectory(
        name="random",
        muscles=tuple(f"m{i + 1}" for i in range(m)),
        actuators=actuators,
        coordinates=names,
        is_rotational=np.ones(n, dtype=bool),
        time=0.01 * np.arange(n_frames),
        coordinate_values=still,
        coordinate_speeds=still,
        muscle_tendon_length=np.full((n_frames, m), LENGTH),
        muscle_tendon_velocity=np.zeros((n_frames, m)),
        moment_arms=arms,
        actuator_generalized_forces=np.broadcast_to(columns, (n_frames, *columns.shape)),
        generalized_forces=np.einsum("kcm,km->kc", arms, force),
        passive_generalized_forces=still,
        active_force_capacity=np.ones((n_frames, m)),
        other_forces=np.zeros((n_frames, 0)),
        curvature=CoordinateCurvature(
            coordinates=names,
            path_curvature=curvature,
            load_stiffness=(load + load.transpose(0, 2, 1)) / 2,
            passive_stiffness=np.broadcast_to(passive, (n_frames, n, n)),
            asymmetry=np.zeros((n_frames, m)),
            is_uncertain=np.zeros((n_frames, m), dtype=bool),
        ),
    )
    unlimited = np.full(len(actuators), np.inf)
    motion = Motion(
        trajectory=trajectory,
        muscles=_muscles(trajectory.muscles, strength),
        actuators=ActuatorParameters(
            actuators=actuators,
            optimal_force=np.full(len(actuators), reserve or 0.0),
            min_control=-unlimited,
            max_control=unlimited,
        ),
    )
    return MuscleForceProblem(
        motion=motion,
        muscle_model=NoPhysiology(),
        objectives=(ActivationEffort(exponent=2.0),),
        constraints=(MomentEquilibrium(), HessianStability()),
    )


def _muscles(names: tuple[str, ...], strength: np.ndarray) -> MuscleParameters:
    one = np.ones(len(names))
    return MuscleParameters(
        muscles=names,
        muscle_class=("Millard2012EquilibriumMuscle",) * len(names),
        max_isometric_force=strength,
        optimal_fiber_length=0.1 * one,
        tendon_slack_length=0.2 * one,
        pennation_angle_at_optimal=0 * one,
        max_contraction_velocity=10 * one,
        min_activation=0 * one,
        max_activation=one,
        activation_time_constant=0.01 * one,
        deactivation_time_constant=0.04 * one,
    )
