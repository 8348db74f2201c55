"""What a model holds, as tables: the overview first, one row per muscle only if asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from scso_nlp.opensim.description import LEAST_ARM, Actuator, Joint, JointAxis, ModelDescription
from scso_nlp.overview.inputs import Inputs
from scso_nlp.overview.table import Table
from scso_nlp.solution.worth import LEAST_MOMENT_ARM
from scso_nlp.validation import FloatArray, shown_names

#: Smaller generalized forces of actuators are rounding errors [N·m or N].
LEAST_FORCE = 1e-6
#: Roles of actuators that are not muscles.
ROLES = ("residual", "reserve", "motor")


def model(model: ModelDescription, path: Path) -> Table:
    """Say what the model is in a few lines."""
    free, welded = model.free, len(model.bodies) - 1 - len({joint.child for joint in model.joints})
    others = Counter(each.state for each in model.coordinates if not each.is_free)
    states = "".join(f", {n} {state}" for state, n in others.items())
    gravity = np.linalg.norm(model.gravity)
    notes = [
        f"{len(model.bodies) - 1} bodies of {model.mass:.4g} kg, gravity {gravity:.4g} m/s²"
        + (f" ({welded} welded to others)" if welded else ""),
        f"{len(model.joints)} joints that can move, {len(model.coordinates)} coordinates: "
        f"{len(free)} free{states}",
    ]
    for what, kinds in (("constraints", model.constraints), ("other forces", model.other_forces)):
        if kinds:
            named = ", ".join(f"{n} {kind}" for kind, n in Counter(kinds.values()).items())
            notes.append(f"{what}: {named}")
    if model.switched_off:
        notes.append(f"switched off, left out: {shown_names(model.switched_off)}")
    if model.outside:
        notes.append(
            "outside the ForceSet, not optimized (name them in outside_force_set to use them): "
            f"{shown_names(model.outside)}"
        )
    return Table(title=f"{model.name}, {path.name}", notes=tuple(notes))


def joints(model: ModelDescription) -> Table:
    """List joints that muscles cross, the axes that free coordinates turn, and what may become a row."""
    rows: list[tuple[str, ...]] = []
    for joint in model.joints:
        turned = [axis for axis in joint.axes if axis.turned_by]
        if joint.muscles and not turned:
            nothing = _nothing_turns(model, joint)
            rows.append((joint.name, _bodies(joint), "–", "–", f"{len(joint.muscles)}", "–", nothing))
        elif joint.muscles:
            rows += [_of_axis(joint, axis) for axis in turned]
    notes = _which_rows([axis for axis in model.axes if axis.can_be_stable])
    beside = [axis for axis in model.axes if axis.follows and not axis.turned_by and axis.moment_arms]
    if beside:
        each = shown_names([f"{axis.row} ({', '.join(axis.follows)})" for axis in beside])
        notes.append(f"turned only along with another axis of the joint, no rows of their own: {each}")
    if any(axis.by_constraint for axis in model.axes):
        notes.append("* turned by a coordinate of another joint, through a constraint of the model")
    alone = [joint.name for joint in model.joints if not joint.muscles]
    if alone:
        notes.append(f"no muscle crosses {', '.join(alone)}: no rows there")
    return Table(
        title="Joints: what turns them, and which muscles cross them",
        head=("joint", "bodies", "axis", "turned by", "muscles", "pull + / −", "stability row"),
        rows=tuple(rows),
        notes=tuple(notes),
    )


def coordinates(model: ModelDescription, inputs: Inputs | None) -> Table:
    """List coordinates with their ranges, and what muscles, actuators and the motion do to them."""
    free = {each.name: i for i, each in enumerate(model.free)}
    force = np.array([muscle.max_isometric_force for muscle in model.muscles])
    rows = []
    for each in model.coordinates:
        scale, unit = (1.0, "m") if each.unit == "m" else (180 / np.pi, "°")
        least, most, default = (value * scale for value in (*each.range, each.default))
        span = f"{least:.4g} to {most:.4g} {unit}" + (", clamped" if each.is_clamped else "")
        moves = () if inputs is None else (_course(each.name, inputs, scale),)
        strength = ("–", "–")
        if each.name in free:
            i = free[each.name]
            moved = np.where(np.abs(model.moment_arms[i]) > LEAST_MOMENT_ARM, model.moment_arms[i] * force, 0)
            strength = _both_sides(moved), _each(model.actuator_forces[i])
        rows.append((each.name, each.state, span, f"{default:.4g}", *moves, *strength))
    notes = [
        "muscles: what all can do at once to either side, each at its isometric strength, in the default pose"
    ]
    if inputs is not None and inputs.outside:
        notes.append("! leaves the model's range")
    return Table(
        title="Coordinates",
        head=(
            "coordinate",
            "state",
            "range",
            "default",
            *(("in the motion",) if inputs is not None else ()),
            "muscles [N·m, N]",
            "actuators",
        ),
        rows=tuple(rows),
        notes=tuple(notes),
    )


def muscle_classes(model: ModelDescription) -> Table:
    """Count muscles by class."""
    rows = []
    for kind, n in Counter(muscle.kind for muscle in model.muscles).items():
        own = [muscle for muscle in model.muscles if muscle.kind == kind]
        weak, strong = (choose(own, key=lambda muscle: muscle.max_isometric_force) for choose in (min, max))
        rows.append((kind, f"{n}", *(f"{m.max_isometric_force:.4g} N {m.name}" for m in (weak, strong))))
    return Table(
        title=f"{len(model.muscles)} muscles" + (" (all of them with --muscles)" if model.muscles else ""),
        head=("class", "number", "weakest", "strongest"),
        rows=tuple(rows),
        notes=_on_muscles(model),
    )


def muscles(model: ModelDescription) -> Table:
    """List muscles with the axes that they pull about."""
    rows = []
    for muscle in model.muscles:
        arms = [
            f"{axis.row} {1000 * axis.moment_arms[muscle.name]:+.0f}"
            for axis in model.axes
            if axis.turned_by and abs(axis.moment_arms.get(muscle.name, 0.0)) > LEAST_ARM
        ]
        rows.append((muscle.name, muscle.kind, f"{muscle.max_isometric_force:.4g}", ", ".join(arms) or "–"))
    return Table(
        title=f"{len(model.muscles)} muscles",
        head=(
            "muscle",
            "class",
            "strength [N]",
            "moment arms about axes that can turn, in the default pose [mm]",
        ),
        rows=tuple(rows),
        notes=_on_muscles(model),
    )


def actuators(model: ModelDescription, files: Mapping[str, str]) -> tuple[Table, ...]:
    """List actuators by their role; none if there are none."""
    rows = []
    for role in ROLES:
        for i, actuator in enumerate(model.actuators):
            if role_of(model, i) == role:
                kind = actuator.kind.removesuffix("Actuator")
                rows.append((role, actuator.name, kind, _pushed(model, i), _limits(actuator)))
    origins = Counter(files.get(actuator.name, "the model") for actuator in model.actuators)
    table = Table(
        title="Reserves, residuals and motors",
        head=("role", "actuator", "kind", "at a control of one", "controls"),
        rows=tuple(rows),
        notes=tuple(f"{n} from {origin}" for origin, n in origins.items()),
    )
    return (table,) if rows else ()


def role_of(model: ModelDescription, actuator: int) -> str:
    """Tell what an actuator is to static optimization.

    Parameters
    ----------
    model : ModelDescription
    actuator : int
        Its place among the actuators.

    Returns
    -------
    str
        ``"reserve"`` where muscles act too, ``"residual"`` where only the base floats, else ``"motor"``.
    """
    pushed = np.abs(model.actuator_forces[:, actuator]) > LEAST_FORCE
    has_muscle = (np.abs(model.moment_arms) > LEAST_MOMENT_ARM).any(axis=1)
    is_base = np.array([each.is_base for each in model.free], dtype=bool)
    if (pushed & has_muscle).any():
        return "reserve"
    return "residual" if pushed.any() and is_base[pushed].all() else "motor"


def _of_axis(joint: Joint, axis: JointAxis) -> tuple[str, ...]:
    names = ", ".join(name + ("*" if name in axis.by_constraint else "") for name in axis.turned_by)
    arms = np.array([axis.moment_arms[muscle] for muscle in axis.muscles])
    sides = f"{(arms > 0).sum()} / {(arms < 0).sum()}" if arms.size else "–"
    row = axis.row if axis.can_be_stable else f"none: {axis.obstacle}"
    return joint.name, _bodies(joint), axis.axis, names, f"{len(joint.muscles)}", sides, row


def _bodies(joint: Joint) -> str:
    return f"{joint.parent} → {joint.child}"


def _nothing_turns(model: ModelDescription, joint: Joint) -> str:
    states = {each.name: each.state for each in model.coordinates}
    why = {states[name] for name in joint.coordinates} - {"free"}
    return "none: no free coordinate turns it" + (f" ({', '.join(sorted(why))})" if why else "")


def _which_rows(stable: list[JointAxis]) -> list[str]:
    if not stable:
        return ["no row can be made stable by muscles"]
    by_axes: dict[str, list[str]] = {}
    for joint in dict.fromkeys(axis.joint for axis in stable):
        letters = ",".join(axis.axis for axis in stable if axis.joint == joint)
        by_axes.setdefault(letters, []).append(joint)
    notes = [f"{len(stable)} rows can be made stable by muscles:"]
    notes += [f"  --joints {','.join(names)} --axes {letters}" for letters, names in by_axes.items()]
    one_sided = [axis.row for axis in stable if _is_one_sided(axis)]
    if one_sided:
        notes.append(
            f"muscles pull to one side only, and cannot work against others: {shown_names(one_sided)}"
        )
    return notes


def _is_one_sided(axis: JointAxis) -> bool:
    arms = [axis.moment_arms[muscle] for muscle in axis.muscles]
    return min(arms) > 0 or max(arms) < 0


def _course(coordinate: str, inputs: Inputs, scale: float) -> str:
    if coordinate not in inputs.columns:
        return "no column" if coordinate in inputs.missing else "–"
    least, most = (value * scale for value in inputs.columns[coordinate])
    return f"{least:.3g} to {most:.3g}" + (" !" if coordinate in inputs.outside else "")


def _both_sides(forces: FloatArray) -> str:
    plus, minus = forces[forces > 0].sum(), forces[forces < 0].sum()
    return f"+{_brief(plus)} / −{_brief(minus)}" if forces.any() else "–"


def _brief(force: float) -> str:
    """Write the size of a force with three digits that count, never as a power of ten up to a million."""
    return f"{abs(float(f'{force:.3g}')):g}"


def _each(forces: FloatArray) -> str:
    return " + ".join(_brief(force) for force in forces if abs(force) > LEAST_FORCE) or "–"


def _pushed(model: ModelDescription, actuator: int) -> str:
    """Name the free coordinates that an actuator pushes, with its generalized forces."""
    found = [
        f"{each.name} {force:.3g} {'N' if each.unit == 'm' else 'N·m'}"
        for each, force in zip(model.free, model.actuator_forces[:, actuator], strict=True)
        if abs(force) > LEAST_FORCE
    ]
    return ", ".join(found) or "–"


def _limits(actuator: Actuator) -> str:
    if np.isinf([actuator.min_control, actuator.max_control]).all():
        return "any"
    return f"{actuator.min_control:.3g} to {actuator.max_control:.3g}"


def _on_muscles(model: ModelDescription) -> tuple[str, ...]:
    crossing = {muscle for joint in model.joints for muscle in joint.muscles}
    idle = [muscle.name for muscle in model.muscles if muscle.has_points and muscle.name not in crossing]
    fitted = [muscle.name for muscle in model.muscles if not muscle.has_points]
    return tuple(
        _sentences(
            ("cross no joint that can move", idle),
            (
                "have fitted paths, so no crossing is known; --stability diagonal takes them",
                fitted,
            ),
        )
    )


def _sentences(*found: tuple[str, list[str]]) -> Iterable[str]:
    return (f"{shown_names(names)} {what}" for what, names in found if names)
