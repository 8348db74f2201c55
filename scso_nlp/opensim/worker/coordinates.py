"""Coordinates of a model in multibody tree order, and what the model does with them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import opensim as osim

from scso_nlp.exceptions import EngineError
from scso_nlp.validation import BoolArray, FloatArray

#: Couplers may look at coordinates that are coupled themselves: most rounds until all have followed.
MOST_ROUNDS = 4


@dataclass(frozen=True, kw_only=True)
class Coupler:
    """A coordinate that is a function of others, times a scale."""

    target: int
    where: list[int]
    function: osim.Function
    scale: float

    def value(self, values: FloatArray) -> float:
        """Return what it asks of its coordinate, given the values of all, shape (n_u,)."""
        argument = osim.Vector.createFromMat(np.ascontiguousarray(values[self.where]))
        return float(self.scale * self.function.calcValue(argument))


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """All coordinates, in the order of the mobilities: n_u of them, as many as every list and array here."""

    items: list[osim.Coordinate]
    names: list[str]
    is_rotational: BoolArray  # coupled motions (translation and rotation in one) included
    scales_with_degrees: BoolArray  # these not: OpenSim takes them as they are
    is_locked: BoolArray
    is_prescribed: BoolArray
    is_set_by_model: BoolArray  # locked, prescribed or coupled
    ranges: FloatArray  # (n_u, 2) [rad or m], least and largest value of clamped ones, else infinite
    couplers: list[Coupler]

    def follow(self, values: FloatArray) -> None:
        """Give coupled coordinates the values that their couplers ask for, in place, shape (n_u,)."""
        for _ in range(min(len(self.couplers), MOST_ROUNDS)):
            for coupler in self.couplers:
                values[coupler.target] = coupler.value(values)

    def values(self, state: osim.State) -> list[float]:
        """Return the values of all in a state [rad or m]."""
        return [coordinate.getValue(state) for coordinate in self.items]

    def set_values(self, state: osim.State, values: FloatArray) -> None:
        """Give a state values, shape (n_u,), as they are; locked coordinates stay."""
        for coordinate, value, is_locked in zip(self.items, values.tolist(), self.is_locked, strict=True):
            # setting a locked coordinate has no effect but a warning
            if not is_locked:
                coordinate.setValue(state, value, False)


def read_coordinates(model: osim.Model, state: osim.State) -> Coordinates:
    """Find a model's coordinates; the state must be realized to velocity."""
    by_path = {}
    coordinates = model.getCoordinateSet()
    for i in range(coordinates.getSize()):
        by_path[coordinates.get(i).getAbsolutePathString()] = coordinates.get(i)
    # getCoordinatesInMultibodyTreeOrder() returns nothing usable in Python
    paths = state_variables(model)
    items = [by_path[path.removesuffix("/value")] for path in paths if path.endswith("/value")]
    if len(items) != state.getNU():
        raise EngineError(
            f"the model has {state.getNU()} mobilities but {len(items)} coordinates, expected as many"
        )
    names = [coordinate.getName() for coordinate in items]
    kinds = [int(coordinate.getMotionType()) for coordinate in items]
    return Coordinates(
        items=items,
        names=names,
        is_rotational=np.array([kind != 2 for kind in kinds]),
        scales_with_degrees=np.array([kind == 1 for kind in kinds]),
        is_locked=np.array([coordinate.getLocked(state) for coordinate in items]),
        is_prescribed=np.array([coordinate.isPrescribed(state) for coordinate in items]),
        is_set_by_model=np.array([coordinate.isConstrained(state) for coordinate in items]),
        ranges=np.array([_range(coordinate, state) for coordinate in items]).reshape(-1, 2),
        couplers=_read_couplers(model, state, names),
    )


def state_variables(model: osim.Model) -> list[str]:
    """Return the paths of all state variables, coordinates first, in tree order."""
    return list(osim.createStateVariableNamesInSystemOrder(model))


def _range(coordinate: osim.Coordinate, state: osim.State) -> tuple[float, float]:
    """Return the range to which a coordinate is clamped; what is locked or prescribed has none."""
    if not coordinate.getClamped(state) or coordinate.getLocked(state) or coordinate.isPrescribed(state):
        return -math.inf, math.inf
    return float(coordinate.getRangeMin()), float(coordinate.getRangeMax())


def _read_couplers(model: osim.Model, state: osim.State, names: list[str]) -> list[Coupler]:
    couplers = []
    for component in model.getComponentsList():
        coupler = osim.CoordinateCouplerConstraint.safeDownCast(component)
        if coupler is None or not coupler.isEnforced(state):
            continue
        independent = coupler.getIndependentCoordinateNames()
        couplers.append(
            Coupler(
                target=names.index(coupler.getDependentCoordinateName()),
                where=[names.index(independent.get(j)) for j in range(independent.getSize())],
                function=coupler.getFunction(),
                scale=osim.PropertyHelper.getValueDouble(coupler.getPropertyByName("scale_factor")),
            )
        )
    return couplers
