"""Published methods, each as a function that returns its problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from scso_nlp.arguments import checked
from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.constraints.moment_equilibrium import MomentEquilibrium
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.muscle_models.rigid_tendon import RigidTendon
from scso_nlp.objectives.activation_effort import ActivationEffort
from scso_nlp.problem import MuscleForceProblem


@checked
def static_optimization(
    motion: Motion,
    *,
    muscle_model: MuscleModel | None = None,
    exponent: float = 2.0,
    weights: str | Mapping[str, float] | None = None,
    passive_elements: Literal["taken_off", "left_in"] = "taken_off",
) -> MuscleForceProblem:
    """Describe static optimization as OpenSim defines it.

    Parameters
    ----------
    motion : Motion
    muscle_model : MuscleModel, optional
        ``RigidTendon(convention="opensim")`` by default.
    exponent : float [-]
        Power of the activations.
    weights : None, "volume", "pcsa" or mapping of str to float
        As for :class:`~scso_nlp.ActivationEffort`.
    passive_elements : "taken_off" or "left_in"
        As for :class:`~scso_nlp.MomentEquilibrium`.

    Returns
    -------
    MuscleForceProblem

    References
    ----------
    Crowninshield and Brand (1981), J Biomech 14:793-801.

    Examples
    --------
    >>> plain = scso.static_optimization(motion, muscle_model=scso.NoPhysiology())
    >>> scso.solve_trajectory(plain).activation[1].round(6)
    array([0.347652, 0.143856, 0.047952])
    """
    return MuscleForceProblem(
        motion=motion,
        muscle_model=muscle_model or RigidTendon(),
        objectives=(ActivationEffort(exponent=exponent, weights=weights),),
        constraints=(MomentEquilibrium(passive_elements=passive_elements),),
    )


@checked
def stability_constrained_static_optimization(
    motion: Motion,
    *,
    stability: JointStability | None = None,
    muscle_model: MuscleModel | None = None,
    exponent: float = 2.0,
) -> MuscleForceProblem:
    """Describe the paper's method: static optimization with stability rows.

    Parameters
    ----------
    motion : Motion
    stability : JointStability, optional
        The paper's q = 5 and level 0 by default, about all axes that muscles can make stable.
    muscle_model : MuscleModel, optional
        ``RigidTendon(convention="opensim")`` by default.
    exponent : float [-]
        Power of the activations.

    Returns
    -------
    MuscleForceProblem

    References
    ----------
    Akhavanfar et al. (2019), J Biomech, doi 10.1016/j.jbiomech.2019.05.007.

    Examples
    --------
    >>> stable = scso.stability_constrained_static_optimization(
    ...     motion, stability=scso.JointStability(axes=["z"]), muscle_model=scso.NoPhysiology()
    ... )
    >>> [term.name for term in stable.constraints]
    ['MomentEquilibrium', 'JointStability']
    """
    plain = static_optimization(motion, muscle_model=muscle_model, exponent=exponent)
    return replace(plain, constraints=(*plain.constraints, stability or JointStability()))
