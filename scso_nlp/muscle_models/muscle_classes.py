"""Which OpenSim muscle classes are modelled, and how the muscles of a model become columns of each class."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.frame import as_number
from scso_nlp.muscle_models.degroote2016 import DeGroote2016Curves
from scso_nlp.muscle_models.hill_muscle import HillCurves, HillMuscle
from scso_nlp.muscle_models.millard2012 import Millard2012Curves
from scso_nlp.muscle_models.rigid_tendon_muscle import RigidTendonMuscleCurves
from scso_nlp.muscle_models.thelen2003 import Thelen2003Curves
from scso_nlp.muscles import MuscleParameters
from scso_nlp.validation import IntArray, nearest

#: Every modelled class by OpenSim's name. One line per class.
MUSCLE_CLASSES: Mapping[str, HillCurves] = MappingProxyType(
    {
        curves.OPENSIM_CLASS: curves
        for curves in (
            Thelen2003Curves(),
            Millard2012Curves(),
            DeGroote2016Curves(),
            RigidTendonMuscleCurves(),
        )
    }
)


class MuscleGroup(NamedTuple):
    """The muscles of one class in a model."""

    positions: IntArray  #: where they stand among the model's muscles, shape (n_group,)
    muscle: HillMuscle  #: their constants, as columns of shape (n_group,)

    @property
    def is_symbolic(self) -> bool:
        """True if some constant is a symbol, so that what was computed of it is to be written down again."""
        return any(isinstance(getattr(self.muscle, name), ca.SX) for name in DIFFERENTIABLE)


def curves_of(opensim_class: str, muscle: str = "?") -> HillCurves:
    """Find the curves of an OpenSim muscle class.

    Parameters
    ----------
    opensim_class : str
        OpenSim's class name.
    muscle : str
        Name of the muscle, for the message.

    Returns
    -------
    HillCurves

    Raises
    ------
    DataError
        The class is not modelled; the nearest one is suggested.
    """
    if opensim_class not in MUSCLE_CLASSES:
        hint = nearest(opensim_class, MUSCLE_CLASSES)
        raise DataError(f"muscle {muscle!r} is a {opensim_class}, which is not modelled ({hint})")
    return MUSCLE_CLASSES[opensim_class]


#: Constants of muscles that sensitivities may be asked for; `frame.constant` gives their columns.
DIFFERENTIABLE = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length")


def muscle_groups(
    parameters: MuscleParameters, constant: Callable[[str, Any], Any] = as_number
) -> tuple[MuscleGroup, ...]:
    """Sort the muscles of a model by class and check their constants.

    Parameters
    ----------
    parameters : MuscleParameters
        As read from the model.
    constant : callable
        Gives the columns of constants, as ``frame.constant`` does; numbers by default.

    Returns
    -------
    tuple of MuscleGroup
        One per class that occurs, in the order of first occurrence.

    Raises
    ------
    DataError
        A class that is not modelled, or a constant without a meaning, in one sentence.
    """
    members: dict[str, list[int]] = {}
    for m, (name, opensim_class) in enumerate(zip(parameters.muscles, parameters.muscle_class, strict=True)):
        curves_of(opensim_class, name)
        members.setdefault(opensim_class, []).append(m)
    return tuple(
        _group(parameters, c, np.array(where, dtype=np.int64), constant) for c, where in members.items()
    )


def _group(
    parameters: MuscleParameters, opensim_class: str, where: IntArray, constant: Callable[[str, Any], Any]
) -> MuscleGroup:
    curves = MUSCLE_CLASSES[opensim_class]
    angle, slack = parameters.pennation_angle_at_optimal, parameters.tendon_slack_length
    fastest = parameters.max_contraction_velocity
    for m in where:
        name = parameters.muscles[m]
        if not 0.0 <= angle[m] < 0.5 * np.pi:
            raise DataError(
                f"pennation_angle_at_optimal of {name!r} is {angle[m]:g} rad, "
                "must be at least 0 and less than pi/2"
            )
        if curves.HAS_ELASTIC_TENDON and not slack[m] > 0.0:
            raise DataError(f"tendon_slack_length of {name!r} is {slack[m]:g} m, must be positive")
        if not fastest[m] > 0.0:
            raise DataError(
                f"max_contraction_velocity of {name!r} is {fastest[m]:g} 1/s, must be positive for the "
                f"curves of {opensim_class}; set it in the model, or choose a muscle model that does not "
                "need it (opensim-rigid, none)"
            )
    shapes = [
        curves.check_curve_parameters(parameters.muscles[m], parameters.curve_parameters[m]) for m in where
    ]
    muscle = HillMuscle(
        curves=curves,
        **{name: constant(name, getattr(parameters, name))[where.tolist()] for name in DIFFERENTIABLE},
        pennation_angle_at_optimal=ca.DM(angle[where]),
        max_contraction_velocity=ca.DM(fastest[where]),
        curve_parameters={name: ca.DM([s[name] for s in shapes]) for name in curves.DEFAULT_CURVE_PARAMETERS},
    )
    return MuscleGroup(where, muscle)
