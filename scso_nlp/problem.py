"""The problem as data: one motion, its muscles, a muscle model, objectives and constraints."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from scso_nlp.constraints.constraint import FrameConstraint, FramePairConstraint
from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.constraints.moment_equilibrium import MomentEquilibrium
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import NameMismatchError, ProblemError
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.muscle_models.rigid_tendon import RigidTendon
from scso_nlp.muscles import ActuatorParameters, MuscleParameters
from scso_nlp.objectives.activation_effort import ActivationEffort
from scso_nlp.objectives.function_objective import FunctionObjective
from scso_nlp.objectives.objective import FrameObjective, FramePairObjective
from scso_nlp.trajectory import MotionTrajectory, time_text


@dataclass(frozen=True, kw_only=True)
class MuscleForceProblem:
    r"""Find activations and controls of every frame that cost least and keep every row.

    .. math::
        \min \sum_t \text{objectives} \quad\text{s.t. constraints},\;
        a_\min \le a \le a_\max,\; c_\min \le c \le c_\max

    Attributes
    ----------
    trajectory : MotionTrajectory
    muscles : MuscleParameters
        Same names in the same order as the trajectory's.
    actuators : ActuatorParameters
        Likewise.
    muscle_model : MuscleModel
    objectives : tuple of FrameObjective, FramePairObjective or functions of a frame
        A function becomes a :class:`FunctionObjective`.
    constraints : tuple of FrameConstraint or FramePairConstraint

    Raises
    ------
    NameMismatchError
        Muscles or actuators differ from the trajectory's.
    ProblemError
        No objective, or two terms of one name.
    """

    trajectory: MotionTrajectory
    muscles: MuscleParameters
    actuators: ActuatorParameters = field(default_factory=ActuatorParameters)
    muscle_model: MuscleModel
    objectives: tuple[FrameObjective | FramePairObjective, ...]
    constraints: tuple[FrameConstraint | FramePairConstraint, ...] = (MomentEquilibrium(),)

    def __post_init__(self) -> None:
        _same_names("muscles", self.trajectory.muscles, self.muscles.muscles)
        _same_names("actuators", self.trajectory.actuators, self.actuators.actuators)
        set_field = object.__setattr__
        set_field(self, "objectives", tuple(_as_objective(term) for term in self.objectives))
        set_field(self, "constraints", tuple(self.constraints))
        if not self.objectives:
            raise ProblemError("the problem has no objective, expected at least one, e.g. ActivationEffort()")
        for term in self.constraints:
            if not isinstance(term, FrameConstraint | FramePairConstraint):
                raise ProblemError(f"{term!r} is neither a FrameConstraint nor a FramePairConstraint")
        names = [term.name for term in (self.muscle_model, *self.objectives, *self.constraints)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ProblemError(
                f"two terms are called {', '.join(twice)}; give one of them a label of its own"
            )

    @property
    def coupled_terms(self) -> tuple[str, ...]:
        """Names of the terms that couple frames."""
        return tuple(
            term.name
            for term in (*self.objectives, *self.constraints)
            if isinstance(term, FramePairObjective | FramePairConstraint)
        )

    def frames(self, start: int | Iterable[int], stop: int | None = None) -> MuscleForceProblem:
        """Keep some frames, as :meth:`MotionTrajectory.frames`."""
        return replace(self, trajectory=self.trajectory.frames(start, stop))

    def without_coupling(self) -> MuscleForceProblem:
        """Drop the terms that couple frames, explicitly."""
        return replace(
            self,
            objectives=tuple(t for t in self.objectives if not isinstance(t, FramePairObjective)),
            constraints=tuple(t for t in self.constraints if not isinstance(t, FramePairConstraint)),
        )

    def without_stability(self) -> MuscleForceProblem:
        """Drop the stability rows: plain static optimization of the same motion."""
        return replace(
            self, constraints=tuple(t for t in self.constraints if not isinstance(t, StabilityConstraint))
        )

    def __str__(self) -> str:
        trajectory = self.trajectory
        span = f"{time_text(trajectory.time[0])} to {time_text(trajectory.time[-1])} s"
        lines = [
            f"{trajectory.name}: {trajectory.n_frames} frames from {span}, {self.muscles.n_muscles} muscles, "
            f"{len(trajectory.actuators)} actuators, {len(trajectory.coordinates)} free coordinates",
            f"  unknowns    a ({self.muscles.n_muscles}), c ({self.actuators.n_actuators}) in every frame",
            f"  forces      {self.muscle_model!r}",
        ]
        lines += [f"  minimise    {term!r}" for term in self.objectives]
        lines += [f"  subject to  {term!r}" for term in self.constraints]
        muscles = self.muscles
        if muscles.n_muscles:
            low, high = float(np.min(muscles.min_activation)), float(np.max(muscles.max_activation))
            lines.append(f"  bounds      {low:g} <= a <= {high:g}, controls as in the model")
        return "\n".join(lines)


def static_optimization(
    trajectory: MotionTrajectory,
    muscles: MuscleParameters,
    actuators: ActuatorParameters | None = None,
    *,
    muscle_model: MuscleModel | None = None,
    exponent: float = 2.0,
) -> MuscleForceProblem:
    """Describe static optimization as OpenSim defines it.

    Parameters
    ----------
    trajectory : MotionTrajectory
    muscles : MuscleParameters
    actuators : ActuatorParameters, optional
    muscle_model : MuscleModel, optional
        ``RigidTendon(convention="opensim")`` by default.
    exponent : float [-]
        Power of the activations.

    Returns
    -------
    MuscleForceProblem

    References
    ----------
    Crowninshield and Brand (1981), J Biomech 14:793-801.
    """
    return MuscleForceProblem(
        trajectory=trajectory,
        muscles=muscles,
        actuators=actuators or ActuatorParameters(),
        muscle_model=muscle_model or RigidTendon(),
        objectives=(ActivationEffort(exponent=exponent),),
        constraints=(MomentEquilibrium(),),
    )


def stability_constrained_static_optimization(
    trajectory: MotionTrajectory,
    muscles: MuscleParameters,
    actuators: ActuatorParameters | None = None,
    *,
    stability: JointStability | None = None,
    muscle_model: MuscleModel | None = None,
    exponent: float = 2.0,
) -> MuscleForceProblem:
    """Describe the paper's method: static optimization with stability rows.

    Parameters
    ----------
    trajectory : MotionTrajectory
    muscles : MuscleParameters
    actuators : ActuatorParameters, optional
    stability : JointStability, optional
        The paper's q = 5 and level 0 about all axes of all joints by default.
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
    """
    plain = static_optimization(trajectory, muscles, actuators, muscle_model=muscle_model, exponent=exponent)
    return replace(plain, constraints=(*plain.constraints, stability or JointStability()))


def _as_objective(term: object) -> FrameObjective | FramePairObjective:
    if isinstance(term, FrameObjective | FramePairObjective):
        return term
    if callable(term):
        return FunctionObjective(function=term)
    raise ProblemError(f"{term!r} is no objective, expected a FrameObjective or a function of a frame")


def _same_names(kind: str, expected: tuple[str, ...], found: tuple[str, ...]) -> None:
    if expected == found:
        return
    missing = [name for name in expected if name not in found]
    extra = [name for name in found if name not in expected]
    if missing or extra:
        raise NameMismatchError(
            f"{kind} of the trajectory and of the parameters differ: "
            f"missing {missing or 'none'}, extra {extra or 'none'}"
        )
    raise NameMismatchError(f"{kind} of the trajectory and of the parameters are in different order")
