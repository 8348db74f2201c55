"""Forces of a model, sorted by what they are to the program: unknowns, loads, passive elements."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from itertools import chain, count

import opensim as osim

from scso_nlp.exceptions import DataError, NameMismatchError


@dataclass(frozen=True, kw_only=True)
class Forces:
    """Every force that applies, in the order in which OpenSim records them."""

    muscles: list[osim.Muscle] = field(default_factory=list)
    actuators: list[osim.ScalarActuator] = field(default_factory=list)
    loads: list[osim.ExternalForce] = field(default_factory=list)
    passives: list[osim.Force] = field(default_factory=list)  # springs, limits, ligaments, contact
    columns: list[str] = field(default_factory=list)  # of OpenSim's force file
    recorded: list[tuple[osim.Force, int]] = field(default_factory=list)  # the number of values each records
    record_labels: list[str] = field(default_factory=list)
    switched_off: list[str] = field(default_factory=list)  # muscles and actuators that do not apply
    outside: list[str] = field(default_factory=list)  # and those that do, but stand outside the ForceSet


def read_forces(model: osim.Model, state: osim.State, used: Collection[str]) -> Forces:
    """Sort a model's forces.

    Muscles and actuators outside the ForceSet are passive elements, as in OpenSim's static optimization: it
    does not ask how much of them is needed, they act as their state and their control of zero tell. Those
    that are to be `used` nevertheless are named, or called by their path, or all of them by "all".

    Raises
    ------
    DataError
        An actuator that is not a scalar one.
    NameMismatchError
        A name that no muscle or actuator outside the ForceSet has, or that it shares with an unknown.
    """
    forces = Forces()
    not_scalar = []
    force_set = model.getForceSet()
    own = [force_set.get(i) for i in range(force_set.getSize())]
    optimized = {force.getAbsolutePathString() for force in own}
    every = list(_every_force(model))
    chosen = _outside(every, optimized, used)
    optimized |= {force.getAbsolutePathString() for force in chosen}
    unknowns = [force.getName() for force in (*own, *chosen) if osim.Actuator.safeDownCast(force) is not None]
    for force in every:
        applies = bool(force.appliesForce(state))
        if osim.Actuator.safeDownCast(force) is None:
            if applies:
                _sort_other(force, forces, unknowns)
            continue
        if not applies:
            forces.switched_off.append(force.getName())
            continue
        if force.getAbsolutePathString() not in optimized:
            forces.outside.append(force.getAbsolutePathString())
            _sort_other(force, forces, unknowns)
            continue
        forces.columns.append(force.getName())
        muscle, scalar = osim.Muscle.safeDownCast(force), osim.ScalarActuator.safeDownCast(force)
        if scalar is None:
            not_scalar.append(f"{force.getName()} ({force.getConcreteClassName()})")
        elif muscle is not None:
            forces.muscles.append(muscle)
        else:
            forces.actuators.append(scalar)
    if not_scalar:
        raise DataError(
            f"the actuator {not_scalar[0]} is not a scalar actuator, which OpenSim's static optimization "
            "refuses too"
        )
    return forces


def _outside(every: list[osim.Force], optimized: set[str], used: Collection[str]) -> list[osim.Force]:
    """Return the muscles and actuators outside the ForceSet that are to be optimized too."""
    taken = {force.getName() for force in every if force.getAbsolutePathString() in optimized}
    outside = {
        force.getAbsolutePathString(): force
        for force in every
        if osim.Actuator.safeDownCast(force) is not None and force.getAbsolutePathString() not in optimized
    }
    chosen: list[osim.Force] = []
    for path, force in outside.items():
        if not {"all", path, force.getName()}.isdisjoint(used):
            if force.getName() in taken:
                raise NameMismatchError(
                    f"{path}, named in outside_force_set, shares its name with another muscle or actuator "
                    "that is optimized: rename one of them"
                )
            taken.add(force.getName())
            chosen.append(force)
    known = {"all", *outside, *(force.getName() for force in chosen)}
    for name in used:
        if name not in known:
            raise NameMismatchError(
                f"unknown muscle or actuator {name!r} in outside_force_set (outside the ForceSet: "
                f"{', '.join(outside) or 'none'})"
            )
    return chosen


def take_off_actuators(forces: Forces, state: osim.State) -> None:
    """Let no muscle and no actuator act in a state; actuators can be given a force by override."""
    for muscle in forces.muscles:
        muscle.setAppliesForce(state, False)
    for actuator in forces.actuators:
        actuator.overrideActuation(state, True)
        actuator.setOverrideActuation(state, 0.0)


def _sort_other(force: osim.Force, forces: Forces, unknowns: list[str]) -> None:
    load = osim.ExternalForce.safeDownCast(force)
    if load is None:
        forces.passives.append(force)
    else:
        forces.loads.append(load)
    record = force.getRecordLabels()
    labels = [record.get(i) for i in range(record.getSize())]
    labels = _distinct(labels, force.getName(), [*unknowns, *forces.record_labels])
    forces.recorded.append((force, len(labels)))
    forces.record_labels.extend(labels)
    forces.columns.extend(labels)


def _distinct(labels: list[str], owner: str, taken: list[str]) -> list[str]:
    """Return one force's labels so that none stands twice or is taken by another force.

    OpenSim repeats them within a force (contact with several shapes on one body): later ones get a number;
    and between forces (PotentialEnergy of limit forces): later ones get their owner's name.
    """
    distinct: list[str] = []
    for label in labels:
        full = f"{owner}.{label}" if label in taken else label
        choices = chain((full,), (f"{full}_{number}" for number in count(2)))
        distinct.append(next(choice for choice in choices if choice not in (*taken, *distinct)))
    return distinct


def _every_force(model: osim.Model) -> Iterator[osim.Force]:
    """Yield every force in the order in which OpenSim records them."""
    for component in model.getComponentsList():
        force = osim.Force.safeDownCast(component)
        if force is not None:
            yield force
