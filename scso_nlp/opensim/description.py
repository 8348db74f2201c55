"""What a model holds, without a motion: frozen data, by OpenSim in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from scso_nlp.files import absolute, hashes, require_file
from scso_nlp.opensim import crew
from scso_nlp.opensim.setup_xml import check_document, named_files
from scso_nlp.opensim.worker.exchange import Request
from scso_nlp.stability.rows import AXES
from scso_nlp.validation import FloatArray, read_only

#: Turns slower than this, per unit of a coordinate's speed, are rounding errors [-].
LEAST_TURN = 1e-6
#: Shorter moment arms are rounding errors [m].
LEAST_ARM = 1e-6


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """A generalized coordinate.

    Attributes
    ----------
    name, joint : str
    motion : str
        ``"rotational"``, ``"translational"`` or ``"coupled"``, which is both in one.
    default : float [rad or m]
    range : (float, float) [rad or m]
    is_clamped : bool
        The model keeps it in its range.
    state : str
        ``"free"``, or why it is not: ``"locked"``, ``"prescribed"``, ``"coupled"`` to others, ``"closes a
        loop"``.
    is_base : bool
        The model floats by it: free, of a joint that may both turn and shift against ground.
    """

    name: str
    joint: str
    motion: str
    default: float
    range: tuple[float, float]
    is_clamped: bool
    state: str
    is_base: bool

    @property
    def is_free(self) -> bool:
        """True if nothing but forces moves it."""
        return self.state == "free"

    @property
    def unit(self) -> str:
        """Unit of its values."""
        return "m" if self.motion == "translational" else "rad"


@dataclass(frozen=True, kw_only=True)
class JointAxis:
    """An axis of a joint, and what may become a stability row.

    Attributes
    ----------
    joint, axis : str
        `axis` is x, y or z, as :attr:`scso_nlp.Skeleton.joint_axes` has them.
    turned_by : mapping of str to float [-]
        Free coordinates for which this is the main axis of the joint, and the speed at which each turns the
        distal body about it, per unit of its own; the largest over the coordinates' ranges.
    follows : mapping of str to float [-]
        Other free coordinates that turn it too, beside another axis of the joint that they turn more.
    by_constraint : tuple of str
        Those of both that belong to other joints: they turn this one only through the model's constraints.
    moment_arms : mapping of str to float [m]
        Muscles that cross the joint, and their moment arms in the default pose when all that is distal of
        the joint turns rigidly.
    """

    joint: str
    axis: str
    turned_by: Mapping[str, float]
    follows: Mapping[str, float]
    by_constraint: tuple[str, ...]
    moment_arms: Mapping[str, float]

    @property
    def row(self) -> str:
        """Name of the stability row, e.g. ``"knee_r_z"``."""
        return f"{self.joint}_{self.axis}"

    @property
    def muscles(self) -> tuple[str, ...]:
        """Muscles that cross the joint and have a moment arm about the axis."""
        return tuple(muscle for muscle, arm in self.moment_arms.items() if abs(arm) > LEAST_ARM)

    @property
    def can_be_stable(self) -> bool:
        """True if a free coordinate turns the axis and a muscle pulls about it."""
        return bool(self.turned_by) and bool(self.muscles)

    @property
    def obstacle(self) -> str:
        """Why it cannot be made stable by muscles; empty if it can."""
        if not self.moment_arms:
            return "no muscle crosses the joint"
        if not self.turned_by:
            return "no free coordinate turns it"
        return "" if self.muscles else "no muscle pulls about it"


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A joint that can move.

    Attributes
    ----------
    name, kind : str
        `kind` is the class in OpenSim, e.g. ``"CustomJoint"``.
    parent, child : str
        Bodies on the side of ground and on the other, whichever way the joint is written.
    coordinates : tuple of str
    axes : tuple of JointAxis
        x, y and z.
    muscles : tuple of str
        Those that cross it: their path may touch bodies on both sides.
    """

    name: str
    kind: str
    parent: str
    child: str
    coordinates: tuple[str, ...]
    axes: tuple[JointAxis, ...]
    muscles: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Muscle:
    """A muscle; ``has_points`` is False for fitted paths, of which no crossing is known."""

    name: str
    kind: str
    max_isometric_force: float  # [N]
    has_points: bool


@dataclass(frozen=True, kw_only=True)
class Actuator:
    """An actuator that is not a muscle: its force is its control times its optimal force [N or N·m]."""

    name: str
    kind: str
    optimal_force: float
    min_control: float
    max_control: float


@dataclass(frozen=True, kw_only=True)
class ModelDescription:
    """What a model and its force sets hold.

    Attributes
    ----------
    name : str
    gravity : ndarray, shape (3,) [m/s²]
    bodies : tuple of str
        The first is ground.
    body_parents : mapping of str to str
        The body that each hangs on.
    body_masses : mapping of str to float [kg]
    joints : tuple of Joint
        Those that can move.
    coordinates : tuple of Coordinate
        In the order of the multibody tree.
    muscles : tuple of Muscle
    actuators : tuple of Actuator
        Reserves, residuals, motors.
    moment_arms : ndarray, shape (n_free, n_muscles) [m]
        About the free coordinates in the default pose.
    actuator_forces : ndarray, shape (n_free, n_actuators) [N·m or N]
        Generalized force of each actuator at a control of one, in the default pose.
    constraints, other_forces : mapping of str to str
        Class in OpenSim by name.
    switched_off, outside : tuple of str
        Muscles and actuators that apply no force, and those outside the ForceSet, which are not optimized.
    """

    name: str
    gravity: FloatArray
    bodies: tuple[str, ...]
    body_parents: Mapping[str, str]
    body_masses: Mapping[str, float]
    joints: tuple[Joint, ...]
    coordinates: tuple[Coordinate, ...]
    muscles: tuple[Muscle, ...]
    actuators: tuple[Actuator, ...]
    moment_arms: FloatArray
    actuator_forces: FloatArray
    constraints: Mapping[str, str]
    other_forces: Mapping[str, str]
    switched_off: tuple[str, ...]
    outside: tuple[str, ...]

    @property
    def free(self) -> tuple[Coordinate, ...]:
        """The free coordinates."""
        return tuple(coordinate for coordinate in self.coordinates if coordinate.is_free)

    @property
    def axes(self) -> tuple[JointAxis, ...]:
        """Axes of all joints."""
        return tuple(axis for joint in self.joints for axis in joint.axes)

    @property
    def mass(self) -> float:
        """Mass of all bodies [kg]."""
        return float(sum(self.body_masses.values()))


def describe_model(
    model: str | os.PathLike[str],
    *,
    actuators: Iterable[str | os.PathLike[str]] = (),
    replace_force_set: bool = False,
    outside_force_set: Iterable[str] = (),
) -> ModelDescription:
    """Let OpenSim say what a model holds, with the force sets that a setup adds.

    Parameters
    ----------
    model : path
        The ``.osim`` file.
    actuators, replace_force_set, outside_force_set
        As for :class:`scso_nlp.opensim.setup_xml.MotionInput`.

    Returns
    -------
    ModelDescription

    Raises
    ------
    DataError, FileFormatError
        A file that is missing, or is not what it should be.
    EngineError
        OpenSim refused the model.

    Notes
    -----
    Which coordinates close loops is told from the default pose here and from the first frame of a motion
    elsewhere; they may differ.
    """
    source, added = absolute(model), [absolute(path) for path in actuators]
    for path in (source, *added):
        require_file(path)
    inputs = hashes([path for own in (source, *added) for path in (own, *named_files(own))])
    check_document(source, "Model")
    for path in added:
        check_document(path, "ForceSet")
    settings = {
        "model": str(source),
        "actuators": [str(path) for path in added],
        "replace_force_set": replace_force_set,
        "outside_force_set": list(outside_force_set),
        "external_loads": None,
        "stability_axes": [],
    }
    return _description(crew.describe(Request(settings=settings, inputs=inputs)))


def _description(found: Mapping[str, Any]) -> ModelDescription:
    bodies, base = found["bodies"], set(found["base_coordinates"])
    parents = {body: bodies[of] for body, of in zip(bodies, found["body_parents"], strict=True) if of >= 0}
    coordinates = tuple(
        Coordinate(**{**each, "range": tuple(each["range"])}, is_base=each["name"] in base)
        for each in found["coordinates"]
    )
    muscles = tuple(Muscle(**each) for each in found["muscles"])
    actuators = tuple(Actuator(**each) for each in found["actuators"])
    n_free = sum(coordinate.is_free for coordinate in coordinates)
    arms, pushed = ((n_free, len(muscles)), "n_free, n_muscles"), ((n_free, len(actuators)), "n_free, ...")
    return ModelDescription(
        name=found["name"],
        gravity=read_only("gravity", found["gravity"], (3,), "3"),
        bodies=tuple(bodies),
        body_parents=MappingProxyType(parents),
        body_masses=MappingProxyType(dict(zip(bodies, found["body_masses"], strict=True))),
        joints=tuple(_joint(found, j, coordinates, axes) for j, axes in enumerate(joint_axes(found["axes"]))),
        coordinates=coordinates,
        muscles=muscles,
        actuators=actuators,
        moment_arms=read_only("moment_arms", np.reshape(found["moment_arms"], arms[0]), *arms),
        actuator_forces=read_only(
            "actuator_forces", np.reshape(found["actuator_generalized_forces"], pushed[0]), *pushed
        ),
        constraints=MappingProxyType({each["name"]: each["kind"] for each in found["constraints"]}),
        other_forces=MappingProxyType({each["name"]: each["kind"] for each in found["other_forces"]}),
        switched_off=tuple(found["switched_off"]),
        outside=tuple(found["outside"]),
    )


def _joint(
    found: Mapping[str, Any], j: int, coordinates: tuple[Coordinate, ...], axes: tuple[JointAxis, ...]
) -> Joint:
    name, bodies = found["joints"][j], found["bodies"]
    return Joint(
        name=name,
        kind=found["joint_kinds"][j],
        parent=bodies[found["joint_parents"][j]],
        child=bodies[found["joint_children"][j]],
        coordinates=tuple(coordinate.name for coordinate in coordinates if coordinate.joint == name),
        axes=axes,
        muscles=tuple(axes[0].moment_arms),
    )


def joint_axes(found: Mapping[str, Any]) -> tuple[tuple[JointAxis, ...], ...]:
    """Make the axes of every joint of what a worker found.

    Parameters
    ----------
    found : mapping of str to object
        What :func:`scso_nlp.opensim.worker.description.joint_axes` returns.

    Returns
    -------
    tuple of tuple of JointAxis
        x, y and z of each joint.
    """
    return tuple(tuple(_axis(found, j, a) for a in range(len(AXES))) for j in range(len(found["joints"])))


def _axis(found: Mapping[str, Any], j: int, a: int) -> JointAxis:
    name, rates = found["joints"][j], np.array(found["turn_rates"][j])
    turned_by: dict[str, float] = {}
    follows: dict[str, float] = {}
    for c, coordinate in enumerate(found["free"]):
        if abs(rates[a, c]) > LEAST_TURN:
            is_main = int(np.abs(rates[:, c]).argmax()) == a
            (turned_by if is_main else follows)[coordinate] = float(rates[a, c])
    owners = dict(zip(found["free"], found["free_owners"], strict=True))
    arms = zip(found["muscles"], found["turned_moment_arms"][j][a], found["crossing"][j], strict=True)
    return JointAxis(
        joint=name,
        axis=AXES[a],
        turned_by=MappingProxyType(turned_by),
        follows=MappingProxyType(follows),
        by_constraint=tuple(own for own in (*turned_by, *follows) if owners[own] != name),
        moment_arms=MappingProxyType({muscle: arm for muscle, arm, crosses in arms if crosses}),
    )
