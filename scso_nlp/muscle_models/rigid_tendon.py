"""Force-length-velocity with an inextensible tendon."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.hill_muscle import repeat_over_frames, rigid_tendon_force_parts
from scso_nlp.muscle_models.muscle_classes import MuscleGroup, muscle_groups
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.muscle_models.pennation import rigid_tendon_fiber
from scso_nlp.transcription.frame import Frame, MuscleState
from scso_nlp.validation import FloatArray

if TYPE_CHECKING:
    from scso_nlp.problem import MuscleForceProblem

_LOG = logging.getLogger("scso_nlp")


@dataclass(frozen=True, kw_only=True)
class RigidTendon(MuscleModel):
    r"""Tendon force :math:`F = a\,c(t) + p(t)` with a tendon that keeps its slack length.

    Fiber length and velocity follow from the motion, so capacity c and passive force p are numbers.

    Attributes
    ----------
    convention : "opensim" or "physical"
        ``"opensim"``: the capacity that OpenSim's static optimization uses, active force only, with the
        particularities of each muscle class. ``"physical"``: the cosine of the pennation angle as it
        is, passive fiber force and damping included. For Thelen2003Muscle the force-velocity curve
        depends on activation, so there the force is not affine in it; the program takes it as it is.
    passive_force : "included" or "left_out"
        Whether passive fiber force and damping act; used by ``"physical"`` only.
    short_fibers : "refuse" or "silence"
        What to do in frames in which a path is too short for its tendon; used by ``"physical"`` only.
        ``"silence"`` gives the muscle no force there and logs its name.

    Raises
    ------
    DataError
        A muscle class without curves, a constant without meaning, or a fiber shorter than its bound.

    References
    ----------
    OpenSim 4.6, ``StaticOptimizationTarget.cpp``; Zajac (1989), Crit Rev Biomed Eng 17:359-411;
    Akhavanfar et al. (2019), eq. 3.
    """

    convention: Literal["opensim", "physical"] = "opensim"
    passive_force: Literal["included", "left_out"] = "included"
    short_fibers: Literal["refuse", "silence"] = "refuse"

    def __post_init__(self) -> None:
        choices = {
            "convention": ("opensim", "physical"),
            "passive_force": ("included", "left_out"),
            "short_fibers": ("refuse", "silence"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise ProblemError(
                    f"{name} is {getattr(self, name)!r}, expected {allowed[0]!r} or {allowed[1]!r}"
                )

    def data(self, problem: MuscleForceProblem) -> Mapping[str, FloatArray]:
        """Give capacity and passive force [N], and for the physical convention fiber length [m] and cosine."""
        trajectory = problem.trajectory
        if self.convention == "opensim":
            return {"active_force": trajectory.active_force_capacity}
        shape = trajectory.muscle_tendon_length.shape
        names = ("active_force", "passive_force", "fiber_length", "cos_pennation_angle", "fiber_velocity")
        data = {name: np.zeros(shape) for name in names}
        for group in muscle_groups(problem.muscles):
            for name, values in self._of_group(group, problem).items():
                data[name][:, group.positions] = values
        if self.passive_force == "left_out":
            data["passive_force"][:] = 0.0
        _LOG.info("passive fiber force and damping are %s", self.passive_force.replace("_", " "))
        return data

    def _of_group(self, group: MuscleGroup, problem: MuscleForceProblem) -> dict[str, FloatArray]:
        """Evaluate one class for all frames; arrays of shape (n_frames, n_group)."""
        length = problem.trajectory.muscle_tendon_length[:, group.positions]
        velocity = problem.trajectory.muscle_tendon_velocity[:, group.positions]
        muscle = repeat_over_frames(group.muscle, len(length))
        fiber = [
            on_arrays(lambda ell, v, i=i: rigid_tendon_fiber(muscle, ell, v)[i], length, velocity) for i in range(3)
        ]
        force = [
            on_arrays(lambda ell, v, i=i: rigid_tendon_force_parts(muscle, ell, v)[i], length, velocity)
            for i in range(2)
        ]
        shortest = ca.DM(group.muscle.curves.min_fiber_length(group.muscle)).full().ravel()
        short = (length <= problem.muscles.tendon_slack_length[group.positions]) | (fiber[0] <= shortest)
        if short.any():
            self._report_short(short, group, problem)
        force = [np.where(short, 0.0, part) for part in force]
        if group.muscle.curves.FORCE_VELOCITY_DEPENDS_ON_ACTIVATION:
            # The curve is evaluated at the unknown activation: leave it out of the capacity.
            speed = fiber[2] / (
                problem.muscles.optimal_fiber_length * problem.muscles.max_contraction_velocity
            )[group.positions]
            full = on_arrays(
                lambda v: muscle.curves.force_velocity(v, muscle.curve_parameters, 1.0), speed
            )
            force[0] = np.where(full > 0, force[0] / np.where(full > 0, full, 1.0), 0.0)
        return dict(
            zip(
                ("active_force", "passive_force", "fiber_length", "cos_pennation_angle", "fiber_velocity"),
                (*force, *fiber),
                strict=True,
            )
        )

    def _report_short(self, short: np.ndarray, group: MuscleGroup, problem: MuscleForceProblem) -> None:
        frame, m = (int(i) for i in np.argwhere(short)[0])
        names = [problem.muscles.muscles[group.positions[i]] for i in np.flatnonzero(short.any(axis=0))]
        text = (
            f"the path of {problem.muscles.muscles[group.positions[m]]!r} is too short for a rigid tendon at "
            f"t = {problem.trajectory.time[frame]:g} s: its fiber would be at or below its shortest length "
            f"(muscles: {', '.join(names)})"
        )
        if self.short_fibers == "refuse":
            raise DataError(f"{text}; check tendon_slack_length, or choose short_fibers='silence'")
        _LOG.warning("%s; they give no force there", text)

    def state(self, frame: Frame, problem: MuscleForceProblem) -> MuscleState:
        """Tendon force of one frame."""
        activation, data = frame.activation, frame.data
        if self.convention == "opensim":
            nothing = ca.SX.zeros(problem.muscles.n_muscles, 1)
            return MuscleState(tendon_force=data["active_force"] * activation, passive_force=nothing)
        effective = ca.SX(activation)
        for group in muscle_groups(problem.muscles):
            curves = group.muscle.curves
            if curves.FORCE_VELOCITY_DEPENDS_ON_ACTIVATION:
                where = group.positions.tolist()
                largest = group.muscle.optimal_fiber_length * group.muscle.max_contraction_velocity
                speed = data["fiber_velocity"][where] / largest
                effective[where] = activation[where] * curves.force_velocity(
                    speed, group.muscle.curve_parameters, activation[where]
                )
        return MuscleState(
            tendon_force=data["active_force"] * effective + data["passive_force"],
            passive_force=data["passive_force"],
            fiber_length=data["fiber_length"],
            cos_pennation_angle=data["cos_pennation_angle"],
        )
