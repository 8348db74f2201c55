"""Force-length-velocity with an inextensible tendon."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.frame import Frame, MuscleState
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.force import rigid_tendon_force_parts
from scso_nlp.muscle_models.hill_muscle import repeat_over_frames
from scso_nlp.muscle_models.muscle_classes import MuscleGroup, curves_of, muscle_groups
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.muscle_models.pennation import rigid_tendon_fiber
from scso_nlp.muscles import MuscleParameters
from scso_nlp.validation import BoolArray, FloatArray

_LOG = logging.getLogger("scso_nlp")

#: What :func:`rigid_fiber_data` gives.
_FIBER_DATA = ("active_force", "passive_force", "fiber_length", "cos_pennation_angle", "fiber_velocity")


@dataclass(frozen=True, kw_only=True)
@checked
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

    Notes
    -----
    Forces are not floored at zero, so that they stay affine. Damping lets a fiber that shortens fast push a
    little while it is not active, and the force-velocity curve of DeGrooteFregly2016Muscle is negative
    beyond the maximum contraction velocity. The log names the muscles that can push, and how much.

    Raises
    ------
    DataError
        A muscle class without curves, a constant without meaning, or a fiber shorter than its bound.

    References
    ----------
    OpenSim 4.6, ``StaticOptimizationTarget.cpp``; Zajac (1989), Crit Rev Biomed Eng 17:359-411;
    Akhavanfar et al. (2019), eq. 3.

    Examples
    --------
    >>> rigid = scso.RigidTendon(convention="physical")
    >>> bool(scso.solve_trajectory(scso.static_optimization(motion, muscle_model=rigid)).is_solved.all())
    True
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

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give capacity and passive force [N], and for the physical convention what the fibers do."""
        if self.convention == "opensim":
            capacity = motion.trajectory.active_force_capacity
            _report_pushing(np.minimum(capacity, 0.0), motion.muscles)
            return {"active_force": capacity}
        return rigid_fiber_data(
            motion,
            muscle_groups(motion.muscles),
            motion.trajectory.muscle_tendon_velocity,
            passive_force=self.passive_force,
            short_fibers=self.short_fibers,
        )

    def notes(self, motion: Motion) -> tuple[str, ...]:
        """Say what becomes of passive fiber force."""
        if self.convention == "opensim":
            return ("passive fiber force and damping are left out, as in OpenSim's static optimization",)
        return (f"passive fiber force and damping are {self.passive_force.replace('_', ' ')}",)

    def state(self, frame: Frame, motion: Motion) -> MuscleState:
        """Tendon force of one frame."""
        if self.convention == "opensim":
            strength = motion.muscles.max_isometric_force
            capacity = frame.data["active_force"] * (
                frame.constant("max_isometric_force", strength) / ca.DM(strength)
            )
            nothing = ca.SX.zeros(motion.muscles.n_muscles, 1)
            return MuscleState(tendon_force=capacity * frame.activation, passive_force=nothing)
        return rigid_fiber_state(frame, muscle_groups(motion.muscles, frame.constant))

    def unseen(self, motion: Motion) -> tuple[str, ...]:
        """OpenSim's capacities are numbers; that they are proportional to F0 is all that is known."""
        return ("optimal_fiber_length", "tendon_slack_length") if self.convention == "opensim" else ()


def rigid_fiber_data(
    motion: Motion,
    groups: Sequence[MuscleGroup],
    velocity: FloatArray,
    *,
    passive_force: str = "included",
    short_fibers: str = "refuse",
) -> dict[str, FloatArray]:
    """Evaluate the fibers of muscles with a rigid tendon in all frames.

    Parameters
    ----------
    motion : Motion
    groups : sequence of MuscleGroup
        The muscles to evaluate; all others get zeros.
    velocity : ndarray, shape (n_frames, n_muscles) [m/s]
        Velocity of the paths.
    passive_force : "included" or "left_out"
        See :class:`RigidTendon`.
    short_fibers : "refuse" or "silence"
        See :class:`RigidTendon`.

    Returns
    -------
    dict of str to ndarray, shape (n_frames, n_muscles)
        ``active_force`` and ``passive_force`` [N], ``fiber_length`` [m], ``cos_pennation_angle`` [-] and
        ``fiber_velocity`` [m/s]. Where the force-velocity curve depends on activation, ``active_force`` is
        without it.

    Raises
    ------
    DataError
        A path is too short for its tendon and `short_fibers` is ``"refuse"``.
    """
    data = {name: np.zeros(velocity.shape) for name in _FIBER_DATA}
    for group in groups:
        where = group.positions
        parts = _evaluate(group, motion, velocity[:, where], short_fibers)
        for name, values in zip(_FIBER_DATA, parts, strict=True):
            data[name][:, where] = values
    if passive_force == "left_out":
        data["passive_force"][:] = 0.0
    muscles = motion.muscles
    least = np.where(
        [curves_of(c).FORCE_VELOCITY_DEPENDS_ON_ACTIVATION for c in muscles.muscle_class],
        0.0,  # its multiplier is never negative, and may vanish
        np.minimum(
            muscles.min_activation * data["active_force"], muscles.max_activation * data["active_force"]
        ),
    )
    _report_pushing(np.minimum(data["passive_force"] + least, 0.0), muscles)
    return data


def rigid_fiber_state(frame: Frame, groups: Sequence[MuscleGroup]) -> MuscleState:
    """Put activations to the data of :func:`rigid_fiber_data`; zeros for muscles that had none.

    Parameters
    ----------
    frame : Frame
        With that data.
    groups : sequence of MuscleGroup
        The same groups.

    Returns
    -------
    MuscleState
    """
    data = {name: ca.SX(frame.data[name]) for name in _FIBER_DATA}
    effective = ca.SX(frame.activation)
    for group in groups:
        if group.is_symbolic:
            _write_down(data, frame, group)
    for group in groups:
        if _depends_on_activation(group):
            where = group.positions.tolist()
            effective[where] = frame.activation[where] * group.muscle.curves.force_velocity(
                data["fiber_velocity"][where] / _largest_velocity(group),
                group.muscle.curve_parameters,
                frame.activation[where],
            )
    return MuscleState(
        tendon_force=data["active_force"] * effective + data["passive_force"],
        passive_force=data["passive_force"],
        fiber_length=data["fiber_length"],
        cos_pennation_angle=data["cos_pennation_angle"],
    )


def _report_pushing(force: FloatArray, muscles: MuscleParameters) -> None:
    """Log which muscles can push, shape (n_frames, n_muscles) [N], negative where they do."""
    if force.any():
        names = [muscles.muscles[m] for m in np.flatnonzero(force.any(axis=0))]
        _LOG.warning(
            "fibers that shorten fast can push by up to %.3g N, where the model has no floor: %s",
            -force.min(),
            ", ".join(names),
        )


def _write_down(data: dict[str, ca.SX], frame: Frame, group: MuscleGroup) -> None:
    """Put expressions in the place of the numbers of a group whose constants are symbols.

    Fibers that are silent, and passive forces that are left out, stay zero.
    """
    where, muscle = group.positions.tolist(), group.muscle
    length = frame.muscle_tendon_length[where]
    velocity = frame.data["fiber_velocity"][where] / frame.data["cos_pennation_angle"][where]
    active, _ = rigid_tendon_force_parts(muscle, length, 0 if _depends_on_activation(group) else velocity)
    _, passive = rigid_tendon_force_parts(muscle, length, velocity)
    is_active, is_passive = (frame.data[name][where] != 0 for name in ("active_force", "passive_force"))
    fiber = rigid_tendon_fiber(muscle, length, velocity)
    values = (active * is_active, passive * is_passive, *fiber)
    for name, value in zip(_FIBER_DATA, values, strict=True):
        data[name][where] = value


def _depends_on_activation(group: MuscleGroup) -> bool:
    return group.muscle.curves.FORCE_VELOCITY_DEPENDS_ON_ACTIVATION


def _largest_velocity(group: MuscleGroup) -> ca.DM:
    """Velocity of the fastest fibers, shape (n_group, 1) [m/s]."""
    return group.muscle.optimal_fiber_length * group.muscle.max_contraction_velocity


def _evaluate(
    group: MuscleGroup, motion: Motion, velocity: FloatArray, short_fibers: str
) -> tuple[FloatArray, ...]:
    """Evaluate one class, (n_frames, n_group): both forces, fiber length, cosine and velocity."""
    length = motion.trajectory.muscle_tendon_length[:, group.positions]
    muscle = repeat_over_frames(group.muscle, len(length))
    fiber_length, cosine, fiber_velocity = (
        on_arrays(lambda ell, v, i=i: rigid_tendon_fiber(muscle, ell, v)[i], length, velocity)
        for i in range(3)
    )
    shortest = ca.DM(group.muscle.curves.min_fiber_length(group.muscle)).full().ravel()
    slack = motion.muscles.tendon_slack_length[group.positions]
    short = (length <= slack) | (fiber_length <= shortest)
    if short.any():
        _report_short(short, group, motion, short_fibers)
    # For a curve that depends on activation the velocity of the active part is zero: factor 1.
    active_velocity = np.zeros(velocity.shape) if _depends_on_activation(group) else velocity
    active, passive = (
        on_arrays(lambda ell, v, i=i: rigid_tendon_force_parts(muscle, ell, v)[i], length, v)
        for i, v in enumerate((active_velocity, velocity))
    )
    active, passive = (np.where(short, 0.0, part) for part in (active, passive))
    return active, passive, fiber_length, cosine, fiber_velocity


def _report_short(short: BoolArray, group: MuscleGroup, motion: Motion, short_fibers: str) -> None:
    frame, m = (int(i) for i in np.argwhere(short)[0])
    names = [motion.muscles.muscles[group.positions[i]] for i in np.flatnonzero(short.any(axis=0))]
    text = (
        f"the path of {motion.muscles.muscles[group.positions[m]]!r} is too short for a rigid tendon at "
        f"t = {motion.trajectory.time[frame]:g} s: its fiber would be at or below its shortest length "
        f"(muscles: {', '.join(names)})"
    )
    if short_fibers == "refuse":
        raise DataError(f"{text}; check tendon_slack_length, or choose short_fibers='silence'")
    _LOG.warning("%s; they give no force there", text)
