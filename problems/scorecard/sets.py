"""The sets of PROTOCOL.md: motions, stability terms by method, how answers are measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from problems.back_lifting import problem as back_lifting
from problems.fetch import motion_cache
from problems.knee_implant import problem as knee_implant
from problems.scorecard import rules
from problems.treadmill import problem as treadmill
from problems.walking_3d import problem as walking_3d
from scso_nlp import (
    CoordinateStability,
    FallingStiffness,
    HessianStability,
    JointStability,
    MeasuredEmg,
    MuscleActivity,
    MuscleForceProblem,
    NoPhysiology,
    Solution,
    static_optimization,
)
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.emg import Emg, EmgMap, read_emg, read_emg_map
from scso_nlp.emg.activity import group_means
from scso_nlp.examples import example_folder
from scso_nlp.opensim.engine import load_motion
from scso_nlp.validation import FloatArray, IntArray, positions

#: Price of a missed row [objective per N·m/rad].
SOFT = 1.0
#: The method at whose effort the rules without stability are.
ON_LEGS, ELSEWHERE = "coordinates, q = 40", "axes, q = 5"
#: Coordinate at which a group of the leg is an agonist or antagonist; other groups do not count.
LEG = {
    "ankle_angle_r": (
        "soleus", "gastrocnemius", "medial gastrocnemius", "lateral gastrocnemius", "tibialis anterior",
    ),
    "knee_angle_r": (
        "medial hamstrings", "semimembranosus", "biceps femoris",
        "vastus lateralis", "vastus medius", "vastus medialis", "rectus femoris",
    ),
}  # fmt: skip
#: Back and abdomen act at the lowest level.
BACK = "L5_S1_Flex_Ext"
#: Muscles of the spine model that flex it, and those that extend it.
FLEXORS, EXTENSORS = ("RA", "EO", "IO"), ("ES",)
#: Factors of the moment in effort_ramp [-].
RAMP = (0.5, 1.0, 2.0, 3.0, 4.0)

Errors = Callable[[Solution], dict[str, FloatArray]]


@dataclass(frozen=True, kw_only=True)
class Part:
    """One motion of a set.

    Attributes
    ----------
    plain : MuscleForceProblem
        Static optimization.
    errors : callable
        From an answer, errors by metric and unit.
    facts : mapping of str to float
        What is printed besides.
    emg : MeasuredEmg or None
        What `errors` are distances from, at the times of the motion.
    unit : ndarray of int, shape (n_frames,), or None
        Stride or bend of each frame.
    """

    plain: MuscleForceProblem
    errors: Errors
    facts: Mapping[str, float] = dataclasses.field(default_factory=dict)
    emg: MeasuredEmg | None = None
    unit: IntArray | None = None


@dataclass(frozen=True, kw_only=True)
class Set:
    """One row group of the table.

    Attributes
    ----------
    name, unit : str
    kind : str
        What the verdict is about: "measured", "by construction", "load height" or "effort".
    parts : callable
        Reads the motions.
    methods : mapping of str to StabilityConstraint
    reference : str
    coordinates : tuple of str
        With rows.
    """

    name: str
    unit: str
    kind: str
    parts: Callable[[], list[Part]]
    methods: Mapping[str, StabilityConstraint]
    reference: str
    coordinates: tuple[str, ...]


def group_activity(activation: FloatArray, muscles: Sequence[str], emg_map: EmgMap) -> FloatArray:
    """Mean activation of every group, shape (n_frames, n_groups)."""
    return np.column_stack(
        [activation[:, positions("muscle", g.muscles, muscles)].mean(axis=1) for g in emg_map.groups]
    )


def emg_part(
    plain: MuscleForceProblem, emg: Emg, emg_map: EmgMap, at: Mapping[str, str], unit: IntArray, levels: bool
) -> Part:
    """Hold groups against EMG, agonists and antagonists apart.

    Parameters
    ----------
    plain : MuscleForceProblem
    emg, emg_map : Emg, EmgMap
    at : mapping of str to str
        Coordinate of each group that counts.
    unit : ndarray of int, shape (n_frames,)
    levels : bool
        Compare levels, instead of shapes.
    """
    motion = plain.motion.trajectory
    resolved = emg_map.resolve(motion.muscles, emg.channels)
    groups = replace(resolved, groups=tuple(g for g in resolved.groups if g.name in at), pairs=())
    channels = group_means(emg, groups)
    where = positions("coordinate", [at[g.name] for g in groups.groups], motion.coordinates)
    strength = plain.motion.muscles.max_isometric_force
    arms = np.column_stack(
        [
            motion.moment_arms[:, c][:, m] @ strength[m]
            for c, m in zip(
                where, (positions("muscle", g.muscles, motion.muscles) for g in groups.groups), strict=True
            )
        ]
    )
    moments = motion.generalized_forces[:, where]
    able = np.maximum(np.sign(arms) * moments, 0.0)
    ahead = rules.lag(motion.time, able, emg.time, channels)
    measured = np.column_stack([np.interp(motion.time - ahead, emg.time, e) for e in channels.T])
    kind = rules.kinds(arms, moments)
    compare = rules.level_errors if levels else rules.shape_errors

    def errors(solution: Solution) -> dict[str, FloatArray]:
        predicted = group_activity(solution.activation, motion.muscles, groups)
        solved = solution.is_solved[:, None]
        return {
            name: compare(predicted, measured, (kind == sign) & solved, unit)
            for name, sign in (("agonists", 1), ("antagonists", -1))
        }

    return Part(
        plain=plain,
        errors=errors,
        facts={
            "lag [s]": ahead,
            "agonist cells": int((kind == 1).sum()),
            "antagonist cells": int((kind == -1).sum()),
        },
        emg=MeasuredEmg(
            activity=MuscleActivity(
                groups=tuple(g.name for g in groups.groups),
                muscles=tuple(g.muscles for g in groups.groups),
                time=motion.time,
                values=measured,
                source=emg.source,
            ),
            compare="levels" if levels else "shapes",
        ),
        unit=unit,
    )


def _plain(problem: MuscleForceProblem) -> MuscleForceProblem:
    return replace(problem.without_stability(), observed=())


def _laws(axes: JointStability) -> dict[str, StabilityConstraint]:
    return {
        "axes, q = 5": axes,
        "axes, falling q = 5": replace(axes, q=None, stiffness=FallingStiffness(q=5.0, half_force=0.5)),
    }


def _leg(joints: Sequence[str], coordinates: Sequence[str]) -> dict[str, StabilityConstraint]:
    axes = JointStability(q=5.0, joints=joints, axes=("z",), soft=SOFT)
    along = CoordinateStability(q=5.0, coordinates=coordinates, soft=SOFT)
    whole = HessianStability(q=5.0, coordinates=coordinates, soft=SOFT)
    return {
        **_laws(axes),
        "coordinates, q = 5": along,
        ON_LEGS: replace(along, q=40.0),
        "whole Hessian, q = 5": whole,
        "whole Hessian, q = 40": replace(whole, q=40.0),
    }


def _spine() -> dict[str, StabilityConstraint]:
    return {
        **_laws(JointStability(q=5.0, soft=SOFT)),
        "coordinates, q = 5": CoordinateStability(q=5.0, soft=SOFT),
        "whole Hessian, q = 5": HessianStability(q=5.0, soft=SOFT),
    }


def _spine_task(name: str) -> MuscleForceProblem:
    motion = load_motion(
        example_folder(name) / "setup.xml", prepare_for=tuple(_spine().values()), cache=motion_cache()
    )
    return static_optimization(motion, muscle_model=NoPhysiology())


def _lifts() -> dict[str, StabilityConstraint]:
    rows, matrix = back_lifting.passive_stiffness()
    axes = JointStability(q=5.0, joints=back_lifting.JOINTS, axes=("x", "y", "z"), soft=SOFT)
    whole = HessianStability(q=5.0, coordinates=back_lifting.COORDINATES, soft=SOFT)
    return {
        **_laws(axes),
        "coordinates, q = 5": CoordinateStability(q=5.0, coordinates=back_lifting.COORDINATES, soft=SOFT),
        **{
            f"axes, q = 5, passive × {factor:g}": replace(axes, passive_stiffness=rows, passive_factor=factor)
            for factor in (1.0, 0.5, 0.25)
        },
        **{
            f"whole Hessian, q = 5, passive × {factor:g}": replace(
                whole, passive_stiffness=matrix, passive_factor=factor
            )
            for factor in (1.0, 0.25)
        },
        "whole Hessian, q = 5": whole,
    }


def _lift(trial: str) -> list[Part]:
    whole = HessianStability(coordinates=back_lifting.COORDINATES)
    problem = back_lifting.make_problem(trial, step_interval=6, prepare_for=[whole])
    motion = problem.motion.trajectory
    moment = motion.generalized_forces[:, motion.coordinates.index(BACK)]
    emg_map = read_emg_map(back_lifting.EMG_MAP)
    at = {g.name: BACK for g in emg_map.groups if g.channels}
    return [
        emg_part(
            _plain(problem),
            read_emg(back_lifting.emg_file(trial)),
            emg_map,
            at,
            rules.bends(motion.time, np.abs(moment)),
            levels=True,
        )
    ]


def _leg_groups() -> dict[str, str]:
    return {group: coordinate for coordinate, groups in LEG.items() for group in groups}


def _stride(methods: Mapping[str, StabilityConstraint]) -> list[Part]:
    problem = walking_3d.make_problem(prepare_for=tuple(methods.values()))
    return [
        emg_part(
            _plain(problem),
            read_emg(walking_3d.emg_file()),
            read_emg_map(walking_3d.EMG_MAP),
            _leg_groups(),
            np.zeros(problem.motion.n_frames, dtype=int),
            levels=False,
        )
    ]


def _strides(trial: str, methods: Mapping[str, StabilityConstraint]) -> list[Part]:
    problem = treadmill.make_problem(trial, prepare_for=tuple(methods.values()))
    unit = np.searchsorted(treadmill.strides(trial)[1:-1], problem.motion.trajectory.time, side="right")
    return [
        emg_part(
            _plain(problem),
            read_emg(treadmill.emg_file(trial)),
            read_emg_map(treadmill.EMG_MAP),
            _leg_groups(),
            unit,
            levels=False,
        )
    ]


def _implants(methods: Mapping[str, StabilityConstraint]) -> list[Part]:
    found = []
    for trial in knee_implant.TRIALS:
        problem = knee_implant.make_problem(trial, step_interval=2, prepare_for=tuple(methods.values()))
        measured = knee_implant.measured_force(trial)

        def errors(solution: Solution, measured: FloatArray = measured) -> dict[str, FloatArray]:
            apart = knee_implant.contact_force(solution) - measured
            return {"contact force": np.sqrt(np.nanmean(apart**2, keepdims=True))}

        reactions = problem.motion.trajectory.joint_reactions
        assert reactions is not None  # the problem asks for them
        found.append(
            Part(plain=_plain(problem), errors=errors, facts={"body weight [N]": reactions.body_weight})
        )
    return found


def _mean_of(solution: Solution, starts: tuple[str, ...]) -> FloatArray:
    muscles = solution.problem.motion.trajectory.muscles
    return solution.activation[:, [name.startswith(starts) for name in muscles]].mean(axis=1)


def _heights() -> list[Part]:
    return [
        Part(
            plain=_spine_task("spine-load-height"),
            errors=lambda solution: {"flexors": _mean_of(solution, FLEXORS)},
        )
    ]


def _ramp() -> list[Part]:
    problem = _spine_task("spine-load-height").frames(0, len(RAMP))
    motion = problem.motion
    same = _first_frame_everywhere(motion.trajectory, motion.n_frames)
    forces = same.generalized_forces * np.array(RAMP)[:, None]
    same = replace(same, time=motion.trajectory.time, generalized_forces=forces)
    return [
        Part(
            plain=replace(problem, motion=replace(motion, trajectory=same)),
            errors=lambda solution: {
                "flexors over extensors": _mean_of(solution, FLEXORS) / _mean_of(solution, EXTENSORS)
            },
        )
    ]


def _first_frame_everywhere(data: Any, n_frames: int) -> Any:
    """Repeat the first frame of every array with so many frames."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(data):
        value = getattr(data, field.name)
        if dataclasses.is_dataclass(value):
            changes[field.name] = _first_frame_everywhere(value, n_frames)
        elif isinstance(value, np.ndarray) and value.shape[:1] == (n_frames,) and field.name != "time":
            changes[field.name] = np.repeat(value[:1], n_frames, axis=0)
    return replace(data, **changes)


def _measured(
    name: str,
    unit: str,
    parts: Callable[[], list[Part]],
    methods: Mapping[str, StabilityConstraint],
    coordinates: tuple[str, ...],
) -> Set:
    reference = ON_LEGS if ON_LEGS in methods else ELSEWHERE
    return Set(
        name=name, unit=unit, kind="measured", parts=parts, methods=methods, reference=reference,
        coordinates=coordinates,
    )  # fmt: skip


def _on_spine(name: str, kind: str, parts: Callable[[], list[Part]]) -> Set:
    return Set(
        name=name, unit="task", kind=kind, parts=parts, methods=_spine(), reference=ELSEWHERE, coordinates=()
    )


def _nothing(example: str) -> list[Part]:
    return [Part(plain=_spine_task(example), errors=lambda _: {})]


_WALK3D = _leg(walking_3d.JOINTS, treadmill.COORDINATES)
_TREADMILL = _leg(("knee_r", "ankle_r"), treadmill.COORDINATES)
_IMPLANT = _leg((knee_implant.KNEE, "ankle_l"), knee_implant.COORDINATES)

SETS = (
    _on_spine("spine_postures", "by construction", partial(_nothing, "spine-postures")),
    _on_spine("spine_load_height", "by construction", partial(_nothing, "spine-load-height")),
    _on_spine("load_height", "load height", _heights),
    _on_spine("effort_ramp", "effort", _ramp),
    _measured("lift_5kg", "bend", partial(_lift, "stoop5kg"), _lifts(), back_lifting.COORDINATES),
    _measured("lift_15kg", "bend", partial(_lift, "stoop15kg"), _lifts(), back_lifting.COORDINATES),
    _measured("walking_3d", "stride", partial(_stride, _WALK3D), _WALK3D, treadmill.COORDINATES),
    _measured("treadmill_walk", "stride", partial(_strides, "walk36", _TREADMILL), _TREADMILL,
              treadmill.COORDINATES),
    _measured("treadmill_run", "stride", partial(_strides, "run81", _TREADMILL), _TREADMILL,
              treadmill.COORDINATES),
    _measured("knee_implant", "trial", partial(_implants, _IMPLANT), _IMPLANT, knee_implant.COORDINATES),
)  # fmt: skip
