"""Force-length with an elastic tendon in quasi-static equilibrium: fibers and tendon forces are unknowns."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, ProblemError
from scso_nlp.frame import Frame, MuscleState, Rows, VariableSpec, as_number
from scso_nlp.motion import Motion
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.equilibrium import equilibrium_residual, solve_equilibrium
from scso_nlp.muscle_models.force import tendon_force
from scso_nlp.muscle_models.hill_muscle import repeat_over_frames
from scso_nlp.muscle_models.muscle_classes import DIFFERENTIABLE, MuscleGroup, muscle_groups
from scso_nlp.muscle_models.muscle_model import MuscleModel
from scso_nlp.muscle_models.pennation import fiber_length_of, fiber_width
from scso_nlp.muscle_models.rigid_tendon import rigid_fiber_data, rigid_fiber_state
from scso_nlp.muscles import MuscleParameters
from scso_nlp.validation import BoolArray, FloatArray, IntArray

_LOG = logging.getLogger("scso_nlp")

#: Activation at which the fibers of the starting point are in equilibrium [-].
_GUESS_ACTIVATION = 0.1

#: A fiber along the tendon is never shorter than this share of its optimal length [-].
_LEAST_FIBER = 0.02

#: A meaningful residual of the equilibrium, over F0 [-]; the solver leaves less than 1e-6 of it.
_RESIDUAL = 1e-2

#: Least activation at which equilibrium is looked for: Thelen's force-velocity curve has none at zero [-].
_LEAST_ACTIVATION = 1e-6


@dataclass(frozen=True, kw_only=True)
@checked
class CompliantTendon(MuscleModel):
    r"""Fiber and tendon in equilibrium in every frame, with fiber length as an unknown.

    .. math:: F_0\left(a f_L f_V + f_P + \beta\tilde v\right)\cos\alpha
              = F_0 f_T\left((\ell^{MT} - \ell^M\cos\alpha)/\ell_s^T\right)

    Unknowns are the fiber length along the tendon, :math:`\ell^M\cos\alpha`, and the tendon force: with it
    moment equilibrium and stability rows stay affine. Muscles of a class without an elastic tendon, or with
    ``ignore_tendon_compliance``, have a rigid tendon and no unknowns. ``solution.fiber_length`` and
    ``solution.tendon_strain`` tell what became of both.

    Attributes
    ----------
    fiber_velocity : "zero" or "from_path"
        ``"zero"``: static fibers. ``"from_path"``: the tendon keeps its length in time, so the fiber
        takes the whole velocity of the path.
    short_fibers : "refuse" or "silence"
        What to do in frames in which a muscle has no equilibrium at any activation, because its path is
        too short for tendon and shortest fiber, or because damping makes its fiber push. ``"silence"``
        holds the fiber at its shortest length, or where the tendon is just slack; the force of the tendon
        there does not depend on activation and is zero as a rule. The log names the muscles.

    Raises
    ------
    DataError
        A muscle class without curves, a constant without meaning, or a muscle without equilibrium.

    Notes
    -----
    Tendons are taut: a muscle is held to activations at which fiber and tendon can be in equilibrium. One
    that reaches its shortest fiber length at some activation cannot be more active. One whose damped fiber
    shortens fast (``"from_path"``) cannot be less active than it takes to keep the tendon from going slack;
    the log names these muscles. To let tendons go slack would leave the fiber's length to chance there.

    References
    ----------
    Millard et al. (2013), J Biomech Eng 135:021005; De Groote et al. (2016), Ann Biomed Eng 44:2922-2936.

    Examples
    --------
    >>> elastic = scso.solve_trajectory(scso.static_optimization(motion, muscle_model=scso.CompliantTendon()))
    >>> elastic.tendon_force.shape
    (7, 3)
    """

    fiber_velocity: Literal["zero", "from_path"] = "zero"
    short_fibers: Literal["refuse", "silence"] = "refuse"

    def __post_init__(self) -> None:
        choices = {"fiber_velocity": ("zero", "from_path"), "short_fibers": ("refuse", "silence")}
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise ProblemError(
                    f"{name} is {getattr(self, name)!r}, expected {allowed[0]!r} or {allowed[1]!r}"
                )

    def variables(self, motion: Motion) -> tuple[VariableSpec, ...]:
        """Name fiber lengths along the tendon [m] and tendon forces [N], with bounds and starting point."""
        split = _split(motion.muscles)
        if not split.elastic:
            return ()
        names, optimal = motion.muscles.muscles, motion.muscles.optimal_fiber_length
        length = motion.trajectory.muscle_tendon_length
        lower, upper, guess = (np.zeros(length.shape) for _ in range(3))
        rests = np.zeros(length.shape, dtype=bool)
        for group in split.elastic:
            where = group.positions
            rest = self._rest(group, motion)
            in_equilibrium = solve_equilibrium(
                group.muscle,
                np.full(rest.fiber.shape, _GUESS_ACTIVATION),
                length[:, where],
                self._velocity(motion)[:, where],
            ).fiber_length_along_tendon
            rests[:, where] = rest.is_at_rest
            guess[:, where] = np.where(rest.is_at_rest, rest.fiber, in_equilibrium)
            lower[:, where] = _shortest_along_tendon(group)
            upper[:, where] = _longest_along_tendon(group, length[:, where])
        # A row holds a fiber at rest, not its bounds.
        upper = np.where(rests, 2 * guess, upper)
        guess = np.clip(guess, lower * (1 + 1e-6), upper)
        lower = np.where(rests, 0.5 * guess, lower)
        force = np.zeros(length.shape)
        for group in split.elastic:
            where = group.positions
            force[:, where] = _tendon_force(group, guess[:, where], length[:, where])
        where = split.positions
        return (
            VariableSpec(
                name="fiber_length_along_tendon",
                labels=tuple(f"{names[m]}_fiber" for m in where),
                lower=lower[:, where],
                upper=upper[:, where],
                guess=guess[:, where],
                scale=optimal[where],
            ),
            VariableSpec(
                name="tendon_force",
                labels=tuple(f"{names[m]}_tendon" for m in where),
                guess=force[:, where],
                scale=motion.muscles.max_isometric_force[where],
            ),
        )

    def data(self, motion: Motion) -> Mapping[str, FloatArray]:
        """Give what is known of the fibers beforehand, each of shape (n_frames, n_muscles).

        ``velocity`` of the paths [m/s] that the fibers are to have; if some fiber has no equilibrium,
        ``is_free`` [-], 0 for it and 1 else, with ``fiber_at_rest`` [m] and ``force_at_rest`` [N]; for
        rigid tendons what :func:`rigid_fiber_data` gives.
        """
        split, velocity = _split(motion.muscles), self._velocity(motion)
        data = {"velocity": velocity}
        if split.rigid:
            data |= rigid_fiber_data(motion, split.rigid, velocity, short_fibers=self.short_fibers)
        at_rest = {
            "is_free": np.ones(velocity.shape),
            "fiber_at_rest": np.ones(velocity.shape),
            "force_at_rest": np.zeros(velocity.shape),
        }
        for group in split.elastic:
            where, rest = group.positions, self._rest(group, motion)
            self._report(rest, group, motion)
            at_rest["is_free"][:, where] = ~rest.is_at_rest
            at_rest["fiber_at_rest"][:, where] = rest.fiber
            at_rest["force_at_rest"][:, where] = np.where(rest.is_at_rest, rest.force, 0.0)
        return data if (at_rest["is_free"] == 1).all() else data | at_rest

    def notes(self, motion: Motion) -> tuple[str, ...]:
        """Say what becomes of passive fiber force, and which tendons are rigid."""
        notes = ["passive fiber force and damping are included"]
        names = motion.muscles.muscles
        rigid = [names[m] for group in _split(motion.muscles).rigid for m in group.positions]
        if rigid:
            notes.append(f"tendons without an elastic curve are rigid: {', '.join(rigid)}")
        return tuple(notes)

    def unseen(self, motion: Motion) -> tuple[str, ...]:
        """Lengths and forces of fibers at rest are numbers."""
        return DIFFERENTIABLE if "is_free" in self.data(motion) else ()

    def state(self, frame: Frame, motion: Motion) -> MuscleState:
        """Tendon force and fiber length of one frame."""
        split, n = _split(motion.muscles, frame.constant), motion.muscles.n_muscles
        force, passive, fiber_length, cosine = (ca.SX(n, 1) for _ in range(4))
        if split.rigid:
            rigid = rigid_fiber_state(frame, split.rigid)
            assert rigid.fiber_length is not None
            assert rigid.cos_pennation_angle is not None
            for group in split.rigid:
                where = group.positions.tolist()
                force[where], passive[where] = rigid.tendon_force[where], rigid.passive_force[where]
                fiber_length[where] = rigid.fiber_length[where]
                cosine[where] = rigid.cos_pennation_angle[where]
        for group in split.elastic:
            where = group.positions.tolist()
            muscle, curves = group.muscle, group.muscle.curves
            q = frame.variables["fiber_length_along_tendon"][split.unknowns_of(group)]
            fiber = fiber_length_of(q, fiber_width(muscle))
            fiber_length[where] = fiber
            cosine[where] = q / fiber
            force[where] = frame.variables["tendon_force"][split.unknowns_of(group)]
            passive[where] = (
                muscle.max_isometric_force
                * curves.passive_force_length(fiber / muscle.optimal_fiber_length, muscle.curve_parameters)
                * q
                / fiber
            )
        return MuscleState(
            tendon_force=force, passive_force=passive, fiber_length=fiber_length, cos_pennation_angle=cosine
        )

    def rows(self, frame: Frame, motion: Motion) -> Rows | None:
        """Two rows per elastic tendon over F0: fiber against tendon, tendon curve against its force."""
        split = _split(motion.muscles, frame.constant)
        if not split.elastic:
            return None
        balance, curve = (ca.SX(motion.muscles.n_muscles, 1) for _ in range(2))
        for group in split.elastic:
            where, unknowns = group.positions.tolist(), split.unknowns_of(group)
            q = frame.variables["fiber_length_along_tendon"][unknowns]
            force = frame.variables["tendon_force"][unknowns]
            length, strength = frame.muscle_tendon_length[where], group.muscle.max_isometric_force
            difference = equilibrium_residual(
                group.muscle, q, frame.activation[where], length, frame.data["velocity"][where]
            )
            tension = tendon_force(group.muscle, q, length)
            if "is_free" in frame.data:
                is_free = frame.data["is_free"][where]
                at_rest = q / frame.data["fiber_at_rest"][where] - 1
                difference = is_free * difference + (1 - is_free) * at_rest
                tension = is_free * tension + frame.data["force_at_rest"][where]
            balance[where] = difference
            curve[where] = (tension - force) / strength
        names = [motion.muscles.muscles[m] for m in split.positions]
        chosen = split.positions.tolist()
        return Rows(
            value=ca.vertcat(balance[chosen], curve[chosen]),
            lower=0.0,
            upper=0.0,
            names=[*(f"{name} fiber" for name in names), *(f"{name} tendon" for name in names)],
            unit="F0",
            scale=_RESIDUAL,
            quantities=_fibers_and_tendons(frame, motion, chosen),
        )

    def _velocity(self, motion: Motion) -> FloatArray:
        velocity = motion.trajectory.muscle_tendon_velocity
        return np.zeros(velocity.shape) if self.fiber_velocity == "zero" else velocity

    def _rest(self, group: MuscleGroup, motion: Motion) -> _Rest:
        """Find the fibers of a group that have no equilibrium at any activation; refuse them if asked to."""
        muscles, where = motion.muscles, group.positions
        length = motion.trajectory.muscle_tendon_length[:, where]
        velocity = self._velocity(motion)[:, where]
        columns = repeat_over_frames(group.muscle, len(length))
        shortest = np.broadcast_to(_shortest_along_tendon(group), length.shape)
        least, most = (
            np.broadcast_to(np.maximum(bound[where], _LEAST_ACTIVATION), length.shape)
            for bound in (muscles.min_activation, muscles.max_activation)
        )
        pull = on_arrays(
            lambda q, a, ell, v: equilibrium_residual(columns, q, a, ell, v),
            shortest,
            least,
            length,
            velocity,
        )
        tension = _tendon_force(group, shortest, length)
        is_short: BoolArray = pull >= 0.0
        is_slack = slack_at_least = np.zeros(length.shape, dtype=bool)
        if self.fiber_velocity == "from_path":
            is_slack, slack_at_least = (
                solve_equilibrium(group.muscle, a, length, velocity).is_slack & ~is_short
                for a in (most, least)
            )
        rest = _Rest(
            is_short=is_short,
            is_slack=is_slack,
            slack_at_least=slack_at_least & ~is_slack,
            fiber=np.where(is_slack, length - muscles.tendon_slack_length[where], shortest),
            force=np.where(is_short, np.maximum(tension, 0.0), 0.0),
        )
        if self.short_fibers == "refuse" and rest.is_at_rest.any():
            raise DataError(
                f"{_no_equilibrium(rest, group, motion)}; check tendon_slack_length, or choose "
                "short_fibers='silence'"
            )
        return rest

    def _report(self, rest: _Rest, group: MuscleGroup, motion: Motion) -> None:
        """Log which fibers have no equilibrium, or none at their least activation."""
        if rest.is_at_rest.any():
            _LOG.warning(
                "%s; activation does not change their force there", _no_equilibrium(rest, group, motion)
            )
        if rest.slack_at_least.any():
            _LOG.warning(
                "the tendons of %s are slack at the least activation in some frames, because damping pushes "
                "while the fiber shortens; activation is held to what keeps them taut",
                _names(rest.slack_at_least, group, motion),
            )


def _fibers_and_tendons(frame: Frame, motion: Motion, elastic: list[int]) -> dict[str, ca.SX]:
    """Fiber lengths [m], and strain of the tendons, which is zero where they are rigid [-]."""
    fiber_length, cosine = frame.muscle.fiber_length, frame.muscle.cos_pennation_angle
    assert fiber_length is not None
    slack = frame.constant("tendon_slack_length", motion.muscles.tendon_slack_length)
    strain = ca.SX(motion.muscles.n_muscles, 1)
    tendon = frame.muscle_tendon_length - fiber_length * cosine
    strain[elastic] = tendon[elastic] / slack[elastic] - 1
    return {"fiber_length": fiber_length, "tendon_strain": strain}


class _Rest(NamedTuple):
    """Fibers of a group that have no equilibrium, arrays of shape (n_frames, n_group)."""

    is_short: BoolArray  #: the fiber at its shortest pulls as much as the tendon or more
    is_slack: BoolArray  #: the fiber pushes at any activation
    slack_at_least: BoolArray  #: the fiber pushes at its least activation only
    fiber: FloatArray  #: length along the tendon at which the fiber rests then [m]
    force: FloatArray  #: force of the tendon there, zero if it is slack [N]

    @property
    def is_at_rest(self) -> BoolArray:
        """True where no activation has an equilibrium."""
        return self.is_short | self.is_slack


def _no_equilibrium(rest: _Rest, group: MuscleGroup, motion: Motion) -> str:
    frame, m = (int(i) for i in np.argwhere(rest.is_at_rest)[0])
    why = (
        "its path is too short: the fiber at its shortest pulls as much as the tendon"
        if rest.is_short[frame, m]
        else "its fiber shortens so fast that it pushes, and the tendon is slack"
    )
    return (
        f"{motion.muscles.muscles[group.positions[m]]!r} has no equilibrium at t = "
        f"{motion.trajectory.time[frame]:g} s at any activation, because {why} "
        f"(muscles: {_names(rest.is_at_rest, group, motion)})"
    )


def _names(found: BoolArray, group: MuscleGroup, motion: Motion) -> str:
    return ", ".join(motion.muscles.muscles[group.positions[i]] for i in np.flatnonzero(found.any(axis=0)))


class _Split(NamedTuple):
    """The muscles of a model by how their tendons are modelled."""

    elastic: tuple[MuscleGroup, ...]
    rigid: tuple[MuscleGroup, ...]
    positions: IntArray  #: of the muscles with elastic tendons, in the model's order

    def unknowns_of(self, group: MuscleGroup) -> list[int]:
        """Where the fibers of an elastic group stand among the unknowns."""
        return [int(i) for i in np.searchsorted(self.positions, group.positions)]


def _split(parameters: MuscleParameters, constant: Callable[[str, Any], Any] = as_number) -> _Split:
    elastic: list[MuscleGroup] = []
    rigid: list[MuscleGroup] = []
    for group in muscle_groups(parameters, constant):
        ignored = np.array(
            [
                bool(parameters.curve_parameters[m].get("ignore_tendon_compliance", 0.0))
                for m in group.positions
            ]
        )
        is_rigid = ignored | (not group.muscle.curves.HAS_ELASTIC_TENDON)
        for target, chosen in ((rigid, is_rigid), (elastic, ~is_rigid)):
            if chosen.all():
                target.append(group)
            elif chosen.any():
                target.append(_part_of(group, np.flatnonzero(chosen)))
    positions = np.sort(np.concatenate([np.zeros(0, np.int64), *(g.positions for g in elastic)]))
    return _Split(tuple(elastic), tuple(rigid), positions)


def _part_of(group: MuscleGroup, which: IntArray) -> MuscleGroup:
    """Keep some muscles of a group."""
    rows, muscle = which.tolist(), group.muscle
    names = (
        "max_isometric_force",
        "optimal_fiber_length",
        "tendon_slack_length",
        "pennation_angle_at_optimal",
        "max_contraction_velocity",
    )
    part = replace(
        muscle,
        **{name: getattr(muscle, name)[rows] for name in names},
        curve_parameters={name: value[rows] for name, value in muscle.curve_parameters.items()},
    )
    return MuscleGroup(group.positions[which], part)


def _shortest_along_tendon(group: MuscleGroup) -> FloatArray:
    """Shortest fiber along the tendon, shape (n_group,) [m]."""
    muscle = group.muscle
    shortest, width, optimal = (
        ca.DM(value).full().ravel()
        for value in (
            muscle.curves.min_fiber_length(muscle),
            fiber_width(muscle),
            muscle.optimal_fiber_length,
        )
    )
    return np.maximum(np.sqrt(np.maximum(shortest**2 - width**2, 0.0)), _LEAST_FIBER * optimal)


def _longest_along_tendon(group: MuscleGroup, length: FloatArray) -> FloatArray:
    """Longest fiber along the tendon, at which the tendon is just taut, shape (n_frames, n_group) [m]."""
    muscle = group.muscle
    stretch = muscle.curves.inverse_tendon_force_length(
        ca.DM.zeros(len(group.positions)), muscle.curve_parameters
    )
    return length - ca.DM(stretch * muscle.tendon_slack_length).full().ravel()


def _tendon_force(group: MuscleGroup, along_tendon: FloatArray, length: FloatArray) -> FloatArray:
    """Force of the tendons, shape (n_frames, n_group) [N]."""
    columns = repeat_over_frames(group.muscle, len(length))
    return on_arrays(lambda q, ell: tendon_force(columns, q, ell), along_tendon, length)
