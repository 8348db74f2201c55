"""Stiffness laws: how stiff a muscle is at a given force.

A law is a choice inside a stability constraint. A new law is one class here and one test; the formulas
of short-range and fiber stiffness are in :mod:`scso_nlp.muscle_models.stiffness`.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import NameMismatchError, ProblemError
from scso_nlp.frame import Frame
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.hill_muscle import HillMuscle, repeat_over_frames
from scso_nlp.muscle_models.muscle_classes import MuscleGroup, muscle_groups
from scso_nlp.muscle_models.pennation import clamped_rigid_tendon_fiber
from scso_nlp.muscle_models.stiffness import (
    SHORT_RANGE_CONSTANT,
    fiber_stiffness,
    in_series,
    short_range_stiffness,
    stiffness_along_tendon,
    tendon_stiffness_at_force,
)
from scso_nlp.validation import FloatArray, by_name

#: A fiber is taken to be at least this long [optimal fiber lengths], where its path is too short for its
#: tendon: OpenSim's own least length of fibers without pennation.
_SHORTEST_FIBER = 0.01
#: Least and largest gain q in use for muscles of the trunk [-], as Akhavanfar et al. (2019) list them.
PUBLISHED_GAINS = (0.5, 42.0)


class StiffnessLaw(abc.ABC):
    """From a muscle's state to its stiffness along the path."""

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give data per frame that the law needs in ``frame.data``; none by default."""
        return {}

    @abc.abstractmethod
    def stiffness(self, frame: Frame, motion: Motion) -> ca.SX:
        """Stiffness of every muscle, shape (n_muscles, 1) [N/m]."""


@dataclass(frozen=True, kw_only=True)
@checked
class ProportionalStiffness(StiffnessLaw):
    r"""Stiffness :math:`k = q F / L`, with the tendon force and the length of the whole path.

    Attributes
    ----------
    q : float, sequence of float or mapping of str to float [-]
        One gain, one per muscle in the trajectory's order, or by name or pattern with ``*`` (every
        muscle must get one; later entries win).

    Raises
    ------
    ProblemError
        q negative or not finite.
    NameMismatchError
        A name that fits no muscle, or a muscle without a gain.

    References
    ----------
    Bergmark (1989), Acta Orthop Scand 60 Suppl 230; Potvin and Brown (2005), J Biomech 38:973-980.

    Examples
    --------
    >>> scso.JointStability(stiffness=scso.ProportionalStiffness(q={"*": 5.0, "biceps": 8.0})).stiffness_law.q
    {'*': 5.0, 'biceps': 8.0}
    """

    q: float | Sequence[float] | Mapping[str, float] = 5.0

    def __post_init__(self) -> None:
        values = list(self.q.values()) if isinstance(self.q, Mapping) else np.ravel(np.asarray(self.q, float))
        for value in values:
            if not (math.isfinite(value) and value >= 0):
                raise ProblemError(f"q is {value:g}, expected a finite number of at least 0")

    def gains(self, muscles: tuple[str, ...]) -> FloatArray:
        """Return the gain of each muscle, shape (n_muscles,) [-]."""
        if not isinstance(self.q, Mapping):
            q = np.asarray(self.q, dtype=float)
            if q.ndim and q.shape != (len(muscles),):
                raise ProblemError(
                    f"q has shape {q.shape}, expected a number or ({len(muscles)},) = (n_muscles,)"
                )
            return np.broadcast_to(q, (len(muscles),)).copy()
        gains = by_name("muscle", self.q, muscles)
        if np.isnan(gains).any():
            left = ", ".join(name for name, value in zip(muscles, gains, strict=True) if np.isnan(value))
            raise NameMismatchError(f"q has no entry for {left}; add them, or a first entry '*' for all")
        return gains

    def stiffness(self, frame: Frame, motion: Motion) -> ca.SX:
        """Stiffness of every muscle, affine in force."""
        gains = frame.constant("q", self.gains(motion.trajectory.muscles))
        return gains * frame.muscle.tendon_force / frame.muscle_tendon_length


@dataclass(frozen=True, kw_only=True)
@checked
class FallingStiffness(StiffnessLaw):
    r"""Stiffness whose gain falls as the muscle pulls, :math:`k = q(F)\, F / L`.

    .. math:: q(F) = \frac{q}{1 + F/F_h}, \quad F_h = \text{half\_force} \cdot F_0

    so that the gain is q in a muscle that hardly pulls and half of it at :math:`F_h`. :math:`q(F)\, F` is
    concave for tension, so rows are concave in the forces and the points that keep them are a convex set.

    Attributes
    ----------
    q : float, sequence of float or mapping of str to float [-]
        Gain without force, as for :class:`ProportionalStiffness`.
    half_force : float [maximum isometric forces]
        Force at which half the gain is left.

    Raises
    ------
    ProblemError
        q negative or not finite, a force that is not positive.
    NameMismatchError
        A name that fits no muscle, or a muscle without a gain.

    Notes
    -----
    That q falls with activation is measured; the hyperbola is the simplest curve that does, and is ours.

    References
    ----------
    Brown and McGill (2010), Comput Methods Biomech Biomed Engin 13:829-835: quick releases of the trunk.

    Examples
    --------
    >>> law = scso.FallingStiffness(q=10.0, half_force=0.25)
    >>> seen = scso.observe(solution, scso.CoordinateStability(stiffness=law))
    >>> bool((scso.equivalent_q(seen, "CoordinateStability") < 10.0).all())
    True
    """

    q: float | Sequence[float] | Mapping[str, float] = 5.0
    half_force: float = 0.5

    def __post_init__(self) -> None:
        ProportionalStiffness(q=self.q)
        if not (math.isfinite(self.half_force) and self.half_force > 0):
            raise ProblemError(f"half_force is {self.half_force:g}, expected a positive number")

    def stiffness(self, frame: Frame, motion: Motion) -> ca.SX:
        """Stiffness of every muscle, concave in force [N/m]."""
        force = frame.muscle.tendon_force
        strength = frame.constant("max_isometric_force", motion.muscles.max_isometric_force)
        share = force / (self.half_force * strength)
        return ProportionalStiffness(q=self.q).stiffness(frame, motion) / (1.0 + share)


@dataclass(frozen=True, kw_only=True)
@checked
class ShortRangeStiffness(StiffnessLaw):
    r"""Short-range stiffness of the fibers, in series with the tendon.

    .. math:: k = \left(\frac1{k_{AT}} + \frac1{k_T(F)}\right)^{-1}, \quad
              k_{AT} = \gamma \frac{F^M}{\ell_0^M} \cos^2\alpha + \frac{F^M}{\ell^M} \sin^2\alpha,
              \quad F^M = F/\cos\alpha

    Not affine in force, because the tendon stiffens with force; rows with it are nonlinear and exact.

    Attributes
    ----------
    constant : float [-]
        :math:`\gamma`.
    tendon_compliance : float [-]
        How many times as compliant tendons are as the model has them; 0 for rigid ones.

    Raises
    ------
    ProblemError
        A constant that is not a positive number, a compliance that is negative.
    DataError
        A muscle class without curves.

    Notes
    -----
    Fiber length and pennation are the muscle model's where it has fibers; otherwise those that the motion
    gives with a tendon of slack length. A muscle whose tendon has no elastic curve has the fiber's
    stiffness along the tendon.

    References
    ----------
    Cui, Perreault, Maas and Sandercock (2008), J Biomech 41:1945-1952.

    Examples
    --------
    >>> law = scso.ShortRangeStiffness()
    >>> seen = scso.observe(solution, scso.CoordinateStability(stiffness=law))
    >>> bool((scso.equivalent_q(seen, "CoordinateStability") > 5.0).all())
    True
    """

    constant: float = SHORT_RANGE_CONSTANT
    tendon_compliance: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.constant) and self.constant > 0):
            raise ProblemError(f"constant is {self.constant:g}, expected a positive number")
        if not (math.isfinite(self.tendon_compliance) and self.tendon_compliance >= 0):
            raise ProblemError(f"tendon_compliance is {self.tendon_compliance:g}, expected at least 0")

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give fiber length and pennation with a rigid tendon."""
        return _rigid_fibers(motion)

    def stiffness(self, frame: Frame, motion: Motion) -> ca.SX:
        """Stiffness of every muscle [N/m]."""
        groups = muscle_groups(motion.muscles, frame.constant)
        fiber_length, cosine = _fibers(frame, groups)
        stiffness = ca.SX(motion.muscles.n_muscles, 1)
        for group in groups:
            where = group.positions.tolist()
            stiffness[where] = short_range_stiffness(
                group.muscle,
                frame.muscle.tendon_force[where],
                fiber_length[where],
                cosine[where],
                self.constant,
                self.tendon_compliance,
            )
        return stiffness


@dataclass(frozen=True, kw_only=True)
@checked
class FiberStiffness(StiffnessLaw):
    r"""Slope of the fibers' force-length curves at constant activation, in series with the tendon.

    .. math:: k = \left(\frac1{k_{AT}} + \frac1{k_T(F)}\right)^{-1}, \quad
              k_{AT} = \frac{F_0}{\ell_0^M} (a f_V f_L' + f_P') \cos^2\alpha
                       + \frac{F^M}{\ell^M} \sin^2\alpha

    What OpenSim reports as muscle stiffness. It is an order of magnitude below short-range stiffness, and
    negative where fibers are longer than optimal, so it says little about posture.

    Raises
    ------
    DataError
        A muscle class without curves.

    Notes
    -----
    Fibers as for :class:`ShortRangeStiffness`; their velocity is the path's share along the fiber.

    References
    ----------
    OpenSim 4.6, ``Muscle.cpp``, calcMuscleStiffness.

    Examples
    --------
    >>> seen = scso.observe(solution, scso.CoordinateStability(stiffness=scso.FiberStiffness()))
    >>> seen.quantities["CoordinateStability.muscle_stiffness"].shape
    (7, 3)
    """

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give fiber length and pennation with a rigid tendon."""
        return _rigid_fibers(motion)

    def stiffness(self, frame: Frame, motion: Motion) -> ca.SX:
        """Stiffness of every muscle [N/m]."""
        groups = muscle_groups(motion.muscles, frame.constant)
        fiber_length, cosine = _fibers(frame, groups)
        stiffness = ca.SX(motion.muscles.n_muscles, 1)
        for group in groups:
            where = group.positions.tolist()
            muscle, force = group.muscle, frame.muscle.tendon_force[where]
            velocity = frame.muscle_tendon_velocity[where] * cosine[where]
            largest = muscle.optimal_fiber_length * muscle.max_contraction_velocity
            activation = frame.activation[where]
            multiplier = muscle.curves.force_velocity(velocity / largest, muscle.curve_parameters, activation)
            fiber = fiber_stiffness(muscle, activation, fiber_length[where], multiplier)
            along = stiffness_along_tendon(fiber, force / cosine[where], fiber_length[where], cosine[where])
            elastic = muscle.curves.HAS_ELASTIC_TENDON
            stiffness[where] = (
                in_series(along, tendon_stiffness_at_force(muscle, force)) if elastic else along
            )
        return stiffness


def _rigid_fibers(motion: Motion) -> dict[str, FloatArray]:
    """Fiber length [m] and cosine of pennation with a tendon of slack length, (n_frames, n_muscles)."""
    length = motion.trajectory.muscle_tendon_length
    data = {"rigid_fiber_length": np.zeros(length.shape), "rigid_cos_pennation": np.ones(length.shape)}
    for group in muscle_groups(motion.muscles):
        fiber, cosine = _rigid_fibers_of(group, length[:, group.positions])
        data["rigid_fiber_length"][:, group.positions] = fiber
        data["rigid_cos_pennation"][:, group.positions] = cosine
    return data


def _rigid_fibers_of(group: MuscleGroup, length: FloatArray) -> tuple[FloatArray, FloatArray]:
    muscle = _with_largest_angle(repeat_over_frames(group.muscle, len(length)))
    fiber = on_arrays(lambda x: clamped_rigid_tendon_fiber(muscle, x, 0.0).fiber_length, length)
    cosine = on_arrays(lambda x: clamped_rigid_tendon_fiber(muscle, x, 0.0).cos_pennation_angle, length)
    optimal = np.asarray(ca.DM(group.muscle.optimal_fiber_length)).ravel()
    return np.maximum(fiber, _SHORTEST_FIBER * optimal), cosine


def _with_largest_angle(muscle: HillMuscle) -> HillMuscle:
    limits = muscle.curve_parameters
    if "maximum_pennation_angle" in limits:
        return muscle
    return replace(muscle, curve_parameters={**limits, "maximum_pennation_angle": math.acos(0.1)})


def _fibers(frame: Frame, groups: Sequence[MuscleGroup]) -> tuple[ca.SX, ca.SX]:
    """Fiber length and cosine of pennation: the muscle model's, or those of a rigid tendon."""
    if frame.muscle.fiber_length is not None and frame.muscle.cos_pennation_angle is not None:
        return frame.muscle.fiber_length, frame.muscle.cos_pennation_angle
    length, cosine = (ca.SX(frame.data[name]) for name in ("rigid_fiber_length", "rigid_cos_pennation"))
    for group in groups:
        if group.is_symbolic:
            where = group.positions.tolist()
            muscle = _with_largest_angle(group.muscle)
            fiber = clamped_rigid_tendon_fiber(muscle, frame.muscle_tendon_length[where], 0.0)
            length[where] = ca.fmax(fiber.fiber_length, _SHORTEST_FIBER * muscle.optimal_fiber_length)
            cosine[where] = fiber.cos_pennation_angle
    return length, cosine
