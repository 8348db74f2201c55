"""Which muscles' lengths depend on which coordinates, told from the model alone."""

from __future__ import annotations

import numpy as np
import opensim as osim

from scso_nlp.opensim.worker.elimination import Elimination
from scso_nlp.opensim.worker.model import Model
from scso_nlp.opensim.worker.paths import path_bodies
from scso_nlp.validation import BoolArray

#: Joints that move bodies along straight lines and circles only.
SMOOTH_JOINTS = (
    "PinJoint",
    "SliderJoint",
    "UniversalJoint",
    "GimbalJoint",
    "PlanarJoint",
    "FreeJoint",
)
#: Points of a path that look at coordinates, and the sockets by which they do.
DRIVEN_POINTS = (
    ("MovingPathPoint", ("x_coordinate", "y_coordinate", "z_coordinate")),
    ("ConditionalPathPoint", ("coordinate",)),
)


def find_followers(model: Model, elimination: Elimination) -> list[set[int]]:
    """Return every coordinate that moves with each free one, itself included."""
    coordinates = model.coordinates
    coupled = {coupler.target for coupler in coordinates.couplers}
    loops = {k for k in elimination.gone.tolist() if k not in coupled and not coordinates.is_set_by_model[k]}
    followers = [{k} | loops for k in elimination.free.tolist()]
    for _ in coordinates.couplers:
        for coupler in coordinates.couplers:
            for moved in followers:
                if moved & set(coupler.where):
                    moved.add(coupler.target)
    return followers


def moved_bodies(model: Model, moved: set[int]) -> set[int]:
    """Return the bodies that move with any of some coordinates."""
    bodies = (model.bodies.moved_by(model.coordinates.items[k]) for k in moved)
    return set().union(*bodies)


def find_dependence(model: Model, followers: list[set[int]]) -> BoolArray:
    """Tell which muscles' lengths depend on which free coordinates, shape (n_muscles, n_free)."""
    distal = {k: moved_bodies(model, {k}) for k in set().union(*followers)}
    depends = np.zeros((len(model.paths), len(followers)), dtype=bool)
    for m, path in enumerate(model.paths):
        if path.geometry is None:
            depends[m] = True
            continue
        touched, drivers = path_bodies(path.geometry, model.bodies), _drivers(path.geometry, model)
        for c, moving in enumerate(followers):
            depends[m, c] = any(
                k in drivers or len({body in distal[k] for body in touched}) == 2 for k in moving
            )
    return depends


def is_smooth(model: Model, k: int, followers: set[int]) -> bool:
    """Tell whether a coordinate moves its joint, and nothing else, along straight lines and circles."""
    if followers != {k}:
        return False
    joint = model.coordinates.items[k].getJoint()
    custom = osim.CustomJoint.safeDownCast(joint)
    if custom is None:
        return joint.getConcreteClassName() in SMOOTH_JOINTS
    transform = custom.getSpatialTransform()
    return all(_is_linear(transform.getTransformAxis(i).getFunction()) for i in range(6))


def _is_linear(function: osim.Function) -> bool:
    multiplier = osim.MultiplierFunction.safeDownCast(function)
    inner = function if multiplier is None else multiplier.getFunction()
    return inner.getConcreteClassName() in ("LinearFunction", "Constant")


def _drivers(geometry: osim.GeometryPath, model: Model) -> set[int]:
    """Return the coordinates that moving and conditional points of a path look at."""
    found = set()
    points = geometry.getPathPointSet()
    for i in range(points.getSize()):
        for kind, sockets in DRIVEN_POINTS:
            if points.get(i).getConcreteClassName() != kind:
                continue
            point = getattr(osim, kind).safeDownCast(points.get(i))
            for socket in sockets:
                if point.getSocket(socket).isConnected():
                    name = osim.Coordinate.safeDownCast(point.getConnectee(socket)).getName()
                    found.add(model.coordinates.names.index(name))
    return found
