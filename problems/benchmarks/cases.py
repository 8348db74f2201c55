"""What is measured: motions with their files, the questions about them, and random motions of any size."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from problems.benchmarks.setups import write_setups
from problems.random_hessian.problem import make_problem as random_problem
from scso_nlp import (
    CoordinateStability,
    HessianStability,
    JointStability,
    MomentEquilibrium,
    Motion,
    MuscleForceProblem,
    RigidTendon,
    static_optimization,
)

#: Static optimization; with rows about joint axes (or along coordinates); with a whole Hessian.
SO, SCSO, FULL = "SO", "SCSO", "full"
#: Powers of the activations.
ALL_POWERS = (2.0, 3.0, 10.0, math.inf)
_KNEES_AND_ANKLES = ("knee_angle_r", "knee_angle_l", "ankle_angle_r", "ankle_angle_l")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One motion.

    Attributes
    ----------
    name, about : str
    setup : callable, optional
        From the folder of the data and a folder to write to, the setup file.
    make : callable, optional
        From the folder of the data, the problem with whole Hessian, for motions that no setup describes.
    changes : mapping
        Of the setup, for all questions.
    consistent_speeds : bool
        Take speeds of coupled coordinates from the constraints, except beside OpenSim, which does not.
    joints, axes, coordinates : tuple of str
        About which and along which the joints are to be stable.
    q : float
        Stiffness gain.
    powers : mapping of str to tuple of float
        By question.
    opensim : tuple of str
        Analyses of OpenSim.
    opensim_times : (float, float), optional
        A part of the motion, where the whole takes too long [s].
    coupled, moco, figures : bool
        Whether terms that couple frames, MocoInverse and figures are measured.
    sizes : tuple of (int, int, int)
        Coordinates, muscles and frames of random motions.
    """

    name: str
    about: str
    setup: Callable[[Path, Path], Path] | None = None
    make: Callable[[], MuscleForceProblem] | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    consistent_speeds: bool = False
    joints: tuple[str, ...] = ()
    axes: tuple[str, ...] = ("x", "y", "z")
    coordinates: tuple[str, ...] = ()
    q: float = 40.0
    powers: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    opensim: tuple[str, ...] = ("StaticOptimization", "MuscleAnalysis")
    opensim_times: tuple[float, float] | None = None
    coupled: bool = False
    moco: bool = False
    figures: bool = False
    sizes: tuple[tuple[int, int, int], ...] = ()

    def quick(self) -> Case:
        """Shrink to what takes seconds: p = 2, few frames for OpenSim, no Moco, small random motions."""
        small = tuple(size for size in self.sizes if size[0] * size[1] * size[2] <= 60_000)
        return replace(
            self,
            powers={kind: powers[:1] for kind, powers in self.powers.items()},
            opensim=self.opensim[:1],
            opensim_times=None
            if self.name in ("arm26", "gait10dof18musc")
            else self.opensim_times or (1.0, 1.05),
            coupled=False,
            moco=False,
            figures=False,
            sizes=small[:2],
        )

    def problem(self, motion: Motion, kind: str, power: float = 2.0) -> MuscleForceProblem:
        """Describe one question about a motion that has what it needs."""
        plain = static_optimization(motion, exponent=power)
        if kind == SO:
            return plain
        return replace(plain, constraints=(*plain.constraints, self.stability(kind)))

    def stability(self, kind: str) -> JointStability | HessianStability:
        """Rows about joint axes, or the whole Hessian."""
        if kind == SCSO:
            return JointStability(q=self.q, joints=self.joints, axes=self.axes)
        return HessianStability(q=self.q, coordinates=self.coordinates)

    def extras(self, kind: str) -> dict[str, Any]:
        """Say what the extraction is prepared for, as keywords of `load_motion`."""
        return {} if kind == SO else {"prepare_for": [self.stability(kind)]}

    def options(self, kind: str) -> list[str]:
        """Say what `scso run` is told."""
        words = ["--coupled-speeds-from-constraints"] if self.consistent_speeds and kind != SO else []
        flags = {"step_interval": "--step-interval", "lowpass_cutoff_frequency": "--lowpass-cutoff-frequency"}
        flags |= {"initial_time": "--initial-time", "final_time": "--final-time"}
        words += [word for name, value in self.changes.items() for word in (flags[name], str(value))]
        if kind == SCSO:
            words += ["--stability", "potvin-brown", "--joints", ",".join(self.joints)]
            words += ["--axes", ",".join(self.axes), "--q", str(self.q)]
        if kind == FULL:
            words += ["--stability", "full", "--coordinates", ",".join(self.coordinates), "--q", str(self.q)]
        return words


def synthetic(n_coordinates: int, n_muscles: int, n_frames: int, kind: str) -> MuscleForceProblem:
    """Describe a random motion with a reserve per coordinate.

    Parameters
    ----------
    n_coordinates, n_muscles, n_frames : int
    kind : str
        `SCSO` is along each coordinate, `FULL` of all of them together.
    """
    made = random_problem(n_coordinates, n_muscles, n_frames, reserve=1.0)
    trajectory = made.motion.trajectory
    strength = np.broadcast_to(made.motion.muscles.max_isometric_force, (n_frames, n_muscles))
    curvature = None if kind == SO else trajectory.curvature
    trajectory = replace(trajectory, active_force_capacity=strength, curvature=curvature)
    rows = {SO: (), SCSO: (CoordinateStability(),), FULL: (HessianStability(),)}[kind]
    return replace(
        made,
        motion=replace(made.motion, trajectory=trajectory),
        muscle_model=RigidTendon(),
        constraints=(MomentEquilibrium(), *rows),
    )


def _file(*parts: str) -> Callable[[Path, Path], Path]:
    return lambda data, _: data.joinpath(*parts)


def _treadmill(data: Path, scratch: Path) -> Path:
    return next(setup for setup in write_setups(data, scratch) if "treadmill_walk36" in str(setup))


def _lift() -> MuscleForceProblem:
    from problems.back_lifting.problem import COORDINATES, JOINTS, make_problem, passive_stiffness

    by_row, by_coordinate = passive_stiffness()
    rows = JointStability(q=5.0, joints=JOINTS, axes=("x", "y", "z"), passive_stiffness=by_row)
    whole = HessianStability(q=5.0, coordinates=COORDINATES, passive_stiffness=by_coordinate)
    problem = make_problem("stoop15kg", step_interval=4, prepare_for=[whole])
    return replace(problem, constraints=(MomentEquilibrium(), rows, whole))


_WALKING3D: dict[str, Any] = {
    "setup": _file("walking3d", "setup_static_optimization.xml"),
    "consistent_speeds": True,
    "joints": ("walker_knee_r", "walker_knee_l", "ankle_r", "ankle_l"),
    "coordinates": _KNEES_AND_ANKLES,
}

CASES = (
    Case(
        name="arm26",
        about="arm, 6 muscles, 2 coordinates",
        setup=_file("arm26", "arm26_millard_Setup_StaticOptimization.xml"),
        powers={SO: ALL_POWERS},
        figures=True,
    ),
    Case(
        name="gait10dof18musc",
        about="walking, 18 muscles, 10 coordinates",
        setup=_file("gait10dof18musc", "setup_static_optimization.xml"),
        joints=("knee_r", "knee_l", "ankle_r", "ankle_l"),
        axes=("z",),
        coordinates=_KNEES_AND_ANKLES,
        powers={SO: ALL_POWERS, SCSO: ALL_POWERS, FULL: (2.0,)},
        figures=True,
    ),
    Case(
        name="walking3d_100hz",
        about="walking, 80 muscles, 31 coordinates, 100 frames a second",
        powers={SO: ALL_POWERS, SCSO: ALL_POWERS, FULL: (2.0, 3.0)},
        coupled=True,
        moco=True,
        figures=True,
        **_WALKING3D,
    ),
    Case(
        name="walking3d_1khz",
        about="the same, 1,000 frames a second",
        changes={"step_interval": 1},
        powers={SO: (2.0, 3.0, 10.0), SCSO: (2.0, 3.0, 10.0), FULL: (2.0,)},
        opensim=("StaticOptimization",),
        **_WALKING3D,
    ),
    Case(
        name="treadmill_walk",
        about="a minute on a treadmill, 92 muscles, 23 coordinates",
        setup=_treadmill,
        changes={
            "initial_time": 0.0,
            "final_time": 61.0,
            "step_interval": 1,
            "lowpass_cutoff_frequency": 6.0,
        },
        joints=("knee_r", "knee_l", "ankle_r", "ankle_l"),
        axes=("z",),
        coordinates=_KNEES_AND_ANKLES,
        powers={SO: (2.0,), SCSO: (2.0,)},
        opensim=("StaticOptimization",),
        opensim_times=(10.0, 12.0),
    ),
    Case(
        name="back_lifting",
        about="lifting 15 kg, 166 muscles, 18 coordinates of the lumbar spine, passive tissue",
        make=_lift,
        powers={SO: (2.0, 3.0), SCSO: (2.0, 3.0), FULL: (2.0, 3.0)},
        opensim=(),
    ),
    Case(
        name="synthetic_smallest",
        about="20 random frames: all powers and questions in seconds",
        powers={SO: ALL_POWERS, SCSO: ALL_POWERS, FULL: (2.0,)},
        sizes=((3, 12, 20),),
    ),
    Case(
        name="synthetic_frames",
        about="random motions of 4 coordinates and 24 muscles, 250 to 16,000 frames",
        powers={SO: (2.0,), SCSO: (2.0,)},
        sizes=tuple((4, 24, frames) for frames in (250, 500, 1000, 2000, 4000, 8000, 16000)),
    ),
    Case(
        name="synthetic_muscles",
        about="random motions of 100 frames, up to 300 muscles and 30 coordinates",
        powers={SO: (2.0,), SCSO: (2.0,)},
        sizes=tuple((muscles // 10, muscles, 100) for muscles in (30, 75, 150, 300)),
    ),
    Case(
        name="synthetic_hessian",
        about="random motions of 100 frames, whole Hessian",
        powers={SO: (2.0, 3.0), FULL: (2.0, 3.0)},
        sizes=((4, 24, 100), (10, 60, 100), (20, 80, 100)),
    ),
)
