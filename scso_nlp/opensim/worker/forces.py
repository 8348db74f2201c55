"""Forces of a model, sorted by what they are to the program: unknowns, loads, passive elements."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import opensim as osim

from scso_nlp.exceptions import DataError


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


def read_forces(model: osim.Model, state: osim.State) -> Forces:
    """Sort a model's forces.

    Raises
    ------
    DataError
        No muscle, or an actuator that is not a scalar one.
    """
    forces = Forces()
    not_scalar = []
    for force in _every_force(model):
        applies = bool(force.appliesForce(state))
        if osim.Actuator.safeDownCast(force) is None:
            if applies:
                _sort_other(force, forces)
            continue
        if not applies:
            forces.switched_off.append(force.getName())
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
    if not forces.muscles:
        raise DataError("the model has no muscle that applies force, expected at least one")
    return forces


def take_off_actuators(model: osim.Model, state: osim.State) -> None:
    """Let no muscle and no actuator act in a state; scalar ones can be given a force by override."""
    for force in _every_force(model):
        if osim.Actuator.safeDownCast(force) is None:
            continue
        scalar = osim.ScalarActuator.safeDownCast(force)
        if scalar is None or osim.Muscle.safeDownCast(force) is not None:
            force.setAppliesForce(state, False)
        else:
            scalar.overrideActuation(state, True)
            scalar.setOverrideActuation(state, 0.0)


def _sort_other(force: osim.Force, forces: Forces) -> None:
    load = osim.ExternalForce.safeDownCast(force)
    if load is None:
        forces.passives.append(force)
    else:
        forces.loads.append(load)
    record = force.getRecordLabels()
    labels = [record.get(i) for i in range(record.getSize())]
    # OpenSim repeats labels, e.g. PotentialEnergy of limit forces: later ones get their owner's name
    labels = [f"{force.getName()}.{label}" if label in forces.record_labels else label for label in labels]
    forces.recorded.append((force, len(labels)))
    forces.record_labels.extend(labels)
    forces.columns.extend(labels)


def _every_force(model: osim.Model) -> Iterator[osim.Force]:
    """Yield every force in the order in which OpenSim records them."""
    for component in model.getComponentsList():
        force = osim.Force.safeDownCast(component)
        if force is not None:
            yield force
