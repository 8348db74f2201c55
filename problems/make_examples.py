"""Write the embedded examples: OpenSim models, motions, loads and setup files.

    python problems/make_examples.py [FOLDER]

FOLDER is `scso_nlp/examples` unless given. The output depends on nothing but this file and
`spine_reconstruction.json` beside the examples: the same bytes every time, without OpenSim. The README.md
of each example is written by hand and left alone.
"""

from __future__ import annotations

import json
import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parents[1] / "scso_nlp" / "examples"

#: Gravity [m/s²], the value the reconstruction was made with.
GRAVITY = 9.81

#: Simulation 2 puts all mass on the thorax, but a lumbar body without inertia makes OpenSim's mass matrix
#: singular. This mass [kg] sits at the lower joint's center, where its weight has no moment and no potential.
LUMBAR_PLACEHOLDER_MASS = 0.1

#: Principal moments of inertia [kg m²] about the center of mass. They only matter when something moves.
INERTIA = {"lumbar": (0.05, 0.04, 0.05), "thorax": (1.5, 0.6, 1.4), "forearm": (0.01, 0.001, 0.01)}

#: Horizontal distance [m] from the lower joint to the load in simulation 2.
LOAD_REACH = 0.30

#: Elbow example: moment arm [m] and maximum isometric force [N] of each muscle.
ELBOW_MUSCLES = {"brachioradialis": (0.10, 1450.0), "biceps": (0.05, 1200.0), "brachialis": (0.02, 1000.0)}

#: Elbow example: net moment [N·m] in each frame. 200 saturates the first muscle at exponent 2.
ELBOW_MOMENTS = (30.0, 60.0, 90.0, 120.0, 150.0, 180.0, 200.0)

#: Elbow example: mass [kg] of the forearm and its center's distance [m] from the elbow; load's distance [m].
FOREARM_MASS, FOREARM_CENTER, HAND_DISTANCE = 1.5, 0.15, 0.30


def write_examples(folder: Path, reconstruction: Mapping[str, Any]) -> None:
    """Write every example to its own folder inside `folder`.

    Parameters
    ----------
    folder : Path
        Made if it is not there; files of the same name are replaced.
    reconstruction : mapping
        What `spine_reconstruction.json` holds.
    """
    _write_spine_load_height(folder / "spine-load-height", reconstruction)
    _write_spine_postures(folder / "spine-postures", reconstruction)
    _write_elbow(folder / "elbow")


def _write_spine_load_height(folder: Path, reconstruction: Mapping[str, Any]) -> None:
    tasks = [task for task in reconstruction["tasks"] if task["mass_set"] == "sim2"]
    trunk = reconstruction["mass_sets"]["sim2"][0]
    masses = {
        "lumbar": (LUMBAR_PLACEHOLDER_MASS, (0.0, 0.0, 0.0)),
        trunk["body"]: (trunk["mass_kg"], tuple(trunk["com_m"])),
    }
    time = [float(k) for k in range(len(tasks))]
    coordinates = _spine_coordinates(reconstruction)
    folder.mkdir(parents=True, exist_ok=True)
    _write_xml(folder / "spine.osim", _spine_model("spine_load_height", reconstruction, masses))
    _write_storage(folder / "motion.mot", "motion", coordinates, time, [[0.0] * len(coordinates)] * len(time))
    _write_loads(
        folder,
        body="thorax",
        time=time,
        forces=[(0.0, -task["load_kg"] * GRAVITY, 0.0) for task in tasks],
        points=[(LOAD_REACH, task["load_H_m"], 0.0) for task in tasks],
    )
    _write_setup(folder, "spine_load_height", "spine.osim", time, loads=True)


def _write_spine_postures(folder: Path, reconstruction: Mapping[str, Any]) -> None:
    tasks = [task for task in reconstruction["tasks"] if task["mass_set"] == "sim1"]
    masses = {
        entry["body"]: (entry["mass_kg"], tuple(entry["com_m"]))
        for entry in reconstruction["mass_sets"]["sim1"]
    }
    time = [float(k) for k in range(len(tasks))]
    coordinates = _spine_coordinates(reconstruction)
    degrees = [
        [float(angle) for joint in task["joint_angles_deg"].values() for angle in joint.values()]
        for task in tasks
    ]
    folder.mkdir(parents=True, exist_ok=True)
    _write_xml(folder / "spine.osim", _spine_model("spine_postures", reconstruction, masses))
    _write_storage(folder / "motion.mot", "motion", coordinates, time, degrees)
    speeds = [f"{name}_u" for name in coordinates]
    _write_storage(folder / "speeds.sto", "speeds", speeds, time, [[0.0] * len(speeds)] * len(time))
    _write_setup(folder, "spine_postures", "spine.osim", time, speeds=True)


def _write_elbow(folder: Path) -> None:
    time = [float(k) for k in range(len(ELBOW_MOMENTS))]
    weight_moment = FOREARM_MASS * GRAVITY * FOREARM_CENTER
    folder.mkdir(parents=True, exist_ok=True)
    _write_xml(folder / "elbow.osim", _elbow_model())
    _write_storage(folder / "motion.mot", "motion", ["elbow_flexion"], time, [[90.0]] * len(time))
    _write_loads(
        folder,
        body="forearm",
        time=time,
        forces=[(0.0, -(moment - weight_moment) / HAND_DISTANCE, 0.0) for moment in ELBOW_MOMENTS],
        points=[(HAND_DISTANCE, 0.0, 0.0)] * len(time),
    )
    _write_setup(folder, "elbow", "elbow.osim", time, loads=True)


# --- models -----------------------------------------------------------------------------------------


def _spine_model(
    name: str, reconstruction: Mapping[str, Any], masses: Mapping[str, tuple[float, tuple[float, ...]]]
) -> ET.Element:
    """Build the spine: pelvis fixed to ground, two joints of three rotations, straight muscles."""
    shapes = {
        "pelvis": ((0.0, -0.05, 0.0), (0.07, 0.06, 0.12)),
        "lumbar": ((-0.01, 0.0925, 0.0), (0.035, 0.0925, 0.04)),
        "thorax": ((0.02, 0.20, 0.0), (0.10, 0.20, 0.14)),
    }
    document, parts = _model(
        name,
        "Made for this project. Attachment points and strengths were found by numerical search so that "
        "published signs and outcomes hold; they are neither the original table nor the authors' model. "
        "Agreement with those outcomes validates nothing.",
    )
    for body in reconstruction["bodies"]:
        mass, center = masses.get(body["name"], (0.0, (0.0, 0.0, 0.0)))
        parts["BodySet"].append(_body(body["name"], mass, center, *shapes[body["name"]]))
    parts["JointSet"].append(_joint("WeldJoint", "ground_pelvis", "/ground", "/bodyset/pelvis"))
    for joint in reconstruction["joints"]:
        joint_name = _identifier(joint["name"])
        parent, child = f"/bodyset/{joint['parent']}", f"/bodyset/{joint['child']}"
        element = _joint("CustomJoint", joint_name, parent, child, joint["location_in_parent"])
        coordinates = _child(element, "coordinates")
        angles = [f"{joint_name}_{angle}" for angle in ("flexion", "abduction_right", "twist_left")]
        for coordinate in angles:
            coordinates.append(_coordinate(coordinate, 0.0, (-math.pi / 2, math.pi / 2)))
        # Intrinsic order z, x, y. Bending forward turns y toward x, which is a negative turn about z.
        transform = ET.SubElement(element, "SpatialTransform")
        for number, (axis, slope, coordinate) in enumerate(
            zip(((0, 0, 1), (1, 0, 0), (0, 1, 0)), (-1, 1, 1), angles, strict=True), start=1
        ):
            rotation = ET.SubElement(transform, "TransformAxis", name=f"rotation{number}")
            ET.SubElement(rotation, "coordinates").text = coordinate
            ET.SubElement(rotation, "axis").text = _numbers(axis)
            function = ET.SubElement(rotation, "LinearFunction", name="function")
            ET.SubElement(function, "coefficients").text = _numbers((slope, 0))
        for number, axis in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1)), start=1):
            translation = ET.SubElement(transform, "TransformAxis", name=f"translation{number}")
            ET.SubElement(translation, "coordinates")
            ET.SubElement(translation, "axis").text = _numbers(axis)
        parts["JointSet"].append(element)
    heights = {"pelvis": 0.0, "lumbar": 0.0, "thorax": reconstruction["joints"][1]["location_in_parent"][1]}
    for muscle in reconstruction["muscles"]:
        path = [(point["body"], tuple(point["xyz_m"])) for point in muscle["path"]]
        upright = math.dist(*((x, y + heights[body], z) for body, (x, y, z) in path))
        parts["ForceSet"].append(_muscle(_identifier(muscle["name"]), muscle["F0_N"], path, upright))
    return document


def _elbow_model() -> ET.Element:
    """Build the elbow: at 90 degrees each muscle is vertical, so its moment arm is a plain distance."""
    document, parts = _model(
        "elbow",
        "Made for this project: one joint whose optimum is known in closed form. Not an anatomical model; "
        "each muscle is a vertical line in front of the elbow.",
    )
    origin, middle = (0.0, 0.0, 0.0), HAND_DISTANCE / 2
    upper_arm = _body("upper_arm", 0.0, origin, (0.0, 0.17, 0.0), (0.03, 0.17, 0.03))
    center = (0.0, -FOREARM_CENTER, 0.0)
    forearm = _body("forearm", FOREARM_MASS, center, (0.0, -middle, 0.0), (0.025, middle, 0.025))
    parts["BodySet"].extend((upper_arm, forearm))
    parts["JointSet"].append(_joint("WeldJoint", "ground_upper_arm", "/ground", "/bodyset/upper_arm"))
    elbow = _joint("PinJoint", "elbow", "/bodyset/upper_arm", "/bodyset/forearm")
    _child(elbow, "coordinates").append(_coordinate("elbow_flexion", math.pi / 2, (0.0, 2.6)))
    parts["JointSet"].append(elbow)
    for name, (arm, force) in ELBOW_MUSCLES.items():
        path = [("upper_arm", (arm, 0.3, 0.0)), ("forearm", (0.0, -arm, 0.0))]
        parts["ForceSet"].append(_muscle(name, force, path, 0.3))
    return document


def _model(name: str, credits: str) -> tuple[ET.Element, dict[str, ET.Element]]:
    """Start a document; returns it and the `objects` element of each set."""
    document = ET.Element("OpenSimDocument", Version="40600")
    model = ET.SubElement(document, "Model", name=name)
    ET.SubElement(model, "Ground", name="ground")
    ET.SubElement(model, "credits").text = credits
    ET.SubElement(model, "length_units").text = "meters"
    ET.SubElement(model, "force_units").text = "N"
    ET.SubElement(model, "gravity").text = _numbers((0.0, -GRAVITY, 0.0))
    parts = {
        kind: ET.SubElement(ET.SubElement(model, kind, name=kind.lower()), "objects")
        for kind in ("BodySet", "JointSet", "ForceSet")
    }
    return document, parts


def _body(
    name: str, mass: float, center: Sequence[float], shape_center: Sequence[float], radii: Sequence[float]
) -> ET.Element:
    """Build a body with an ellipsoid to look at."""
    body = ET.Element("Body", name=name)
    frame = ET.SubElement(ET.SubElement(body, "components"), "PhysicalOffsetFrame", name=f"{name}_shape")
    ellipsoid = ET.SubElement(
        ET.SubElement(frame, "attached_geometry"), "Ellipsoid", name=f"{name}_ellipsoid"
    )
    ET.SubElement(ellipsoid, "socket_frame").text = ".."
    appearance = ET.SubElement(ellipsoid, "Appearance")
    ET.SubElement(appearance, "opacity").text = "0.5"
    ET.SubElement(appearance, "color").text = "0.9 0.85 0.75"
    ET.SubElement(ellipsoid, "radii").text = _numbers(radii)
    ET.SubElement(frame, "socket_parent").text = ".."
    ET.SubElement(frame, "translation").text = _numbers(shape_center)
    ET.SubElement(body, "mass").text = _number(mass)
    ET.SubElement(body, "mass_center").text = _numbers(center)
    inertia = INERTIA[name] if mass > 0 else (0.0, 0.0, 0.0)
    ET.SubElement(body, "inertia").text = _numbers((*inertia, 0.0, 0.0, 0.0))
    return body


def _joint(
    kind: str, name: str, parent: str, child: str, location: Sequence[float] = (0.0, 0.0, 0.0)
) -> ET.Element:
    joint = ET.Element(kind, name=name)
    parent_frame = f"{name}_parent"
    ET.SubElement(joint, "socket_parent_frame").text = parent_frame
    ET.SubElement(joint, "socket_child_frame").text = child
    if kind != "WeldJoint":
        ET.SubElement(joint, "coordinates")
    frame = ET.SubElement(ET.SubElement(joint, "frames"), "PhysicalOffsetFrame", name=parent_frame)
    ET.SubElement(frame, "socket_parent").text = parent
    ET.SubElement(frame, "translation").text = _numbers(location)
    ET.SubElement(frame, "orientation").text = _numbers((0.0, 0.0, 0.0))
    return joint


def _coordinate(name: str, default: float, limits: tuple[float, float]) -> ET.Element:
    coordinate = ET.Element("Coordinate", name=name)
    ET.SubElement(coordinate, "default_value").text = _number(default)
    ET.SubElement(coordinate, "range").text = _numbers(limits)
    return coordinate


def _muscle(
    name: str, force: float, path: Iterable[tuple[str, Sequence[float]]], reference_length: float
) -> ET.Element:
    """Build a Millard2012EquilibriumMuscle without states and with activation down to zero.

    Fiber and tendon share the reference length 7 to 3; no result of the examples depends on it, since
    their setups leave muscle physiology out.
    """
    muscle = ET.Element("Millard2012EquilibriumMuscle", name=name)
    ET.SubElement(muscle, "min_control").text = "0"
    ET.SubElement(muscle, "max_control").text = "1"
    geometry = ET.SubElement(muscle, "GeometryPath", name="path")
    points = ET.SubElement(ET.SubElement(geometry, "PathPointSet"), "objects")
    for number, (body, location) in enumerate(path, start=1):
        point = ET.SubElement(points, "PathPoint", name=f"{name}-P{number}")
        ET.SubElement(point, "socket_parent_frame").text = f"/bodyset/{body}"
        ET.SubElement(point, "location").text = _numbers(location)
    ET.SubElement(muscle, "max_isometric_force").text = _number(force)
    ET.SubElement(muscle, "optimal_fiber_length").text = _number(round(0.7 * reference_length, 4))
    ET.SubElement(muscle, "tendon_slack_length").text = _number(round(0.3 * reference_length, 4))
    ET.SubElement(muscle, "pennation_angle_at_optimal").text = "0"
    ET.SubElement(muscle, "ignore_tendon_compliance").text = "true"
    ET.SubElement(muscle, "ignore_activation_dynamics").text = "true"
    ET.SubElement(muscle, "minimum_activation").text = "0"
    curve = ET.SubElement(muscle, "ActiveForceLengthCurve", name=f"{name}_ActiveForceLengthCurve")
    ET.SubElement(curve, "minimum_value").text = "0"
    return muscle


# --- motion, loads and setup ------------------------------------------------------------------------


def _write_storage(
    path: Path,
    title: str,
    columns: Sequence[str],
    time: Sequence[float],
    rows: Sequence[Sequence[float]],
    *,
    in_degrees: bool = True,
) -> None:
    lines = [title, "version=1", f"nRows={len(time)}", f"nColumns={len(columns) + 1}"]
    lines += [f"inDegrees={'yes' if in_degrees else 'no'}", "endheader", "\t".join(("time", *columns))]
    lines += ["\t".join(_number(v) for v in (t, *row)) for t, row in zip(time, rows, strict=True)]
    _write_text(path, "\n".join(lines) + "\n")


def _write_loads(
    folder: Path,
    body: str,
    time: Sequence[float],
    forces: Sequence[Sequence[float]],
    points: Sequence[Sequence[float]],
) -> None:
    """Write one force per frame, force and point both expressed in ground."""
    columns = [f"load_{kind}{axis}" for kind in "vp" for axis in "xyz"]
    rows = [[*force, *point] for force, point in zip(forces, points, strict=True)]
    _write_storage(folder / "loads.mot", "loads", columns, time, rows, in_degrees=False)
    document = ET.Element("OpenSimDocument", Version="40600")
    loads = ET.SubElement(document, "ExternalLoads", name="loads")
    force = ET.SubElement(ET.SubElement(loads, "objects"), "ExternalForce", name="held_load")
    for tag, text in {
        "applied_to_body": body,
        "force_expressed_in_body": "ground",
        "point_expressed_in_body": "ground",
        "force_identifier": "load_v",
        "point_identifier": "load_p",
    }.items():
        ET.SubElement(force, tag).text = text
    ET.SubElement(loads, "datafile").text = "loads.mot"
    _write_xml(folder / "external_loads.xml", document)


def _write_setup(
    folder: Path, name: str, model: str, time: Sequence[float], *, loads: bool = False, speeds: bool = False
) -> None:
    start, end = _number(time[0]), _number(time[-1])
    document = ET.Element("OpenSimDocument", Version="40600")
    tool = ET.SubElement(document, "AnalyzeTool", name=name)
    ET.SubElement(tool, "model_file").text = model
    ET.SubElement(tool, "replace_force_set").text = "false"
    ET.SubElement(tool, "force_set_files")
    ET.SubElement(tool, "results_directory").text = "results"
    ET.SubElement(tool, "output_precision").text = "16"
    ET.SubElement(tool, "initial_time").text = start
    ET.SubElement(tool, "final_time").text = end
    ET.SubElement(tool, "solve_for_equilibrium_for_auxiliary_states").text = "false"
    analyses = ET.SubElement(ET.SubElement(tool, "AnalysisSet", name="Analyses"), "objects")
    analysis = ET.SubElement(analyses, "StaticOptimization", name="StaticOptimization")
    for tag, text in {
        "on": "true",
        "start_time": start,
        "end_time": end,
        "step_interval": "1",
        "in_degrees": "true",
        "use_model_force_set": "true",
        "activation_exponent": "2",
        "use_muscle_physiology": "false",
        "optimizer_convergence_criterion": "0.0001",
        "optimizer_max_iterations": "100",
    }.items():
        ET.SubElement(analysis, tag).text = text
    ET.SubElement(tool, "external_loads_file").text = "external_loads.xml" if loads else None
    ET.SubElement(tool, "states_file")
    ET.SubElement(tool, "coordinates_file").text = "motion.mot"
    ET.SubElement(tool, "speeds_file").text = "speeds.sto" if speeds else None
    ET.SubElement(tool, "lowpass_cutoff_frequency_for_coordinates").text = "-1"
    _write_xml(folder / "setup.xml", document)


# --- text -------------------------------------------------------------------------------------------


def _spine_coordinates(reconstruction: Mapping[str, Any]) -> list[str]:
    angles = reconstruction["tasks"][0]["joint_angles_deg"]
    return [f"{joint}_{angle}" for joint, values in angles.items() for angle in values]


def _identifier(name: str) -> str:
    return name.replace("-", "_")


def _child(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    assert found is not None
    return found


def _number(value: float) -> str:
    """Shortest text that reads back as the same double."""
    text = repr(float(value) + 0.0)  # + 0.0 turns -0.0 into 0.0
    return text.removesuffix(".0")


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)


def _write_xml(path: Path, document: ET.Element) -> None:
    ET.indent(document, "\t")
    text = ET.tostring(document, encoding="unicode")
    _write_text(path, '<?xml version="1.0" encoding="UTF-8" ?>\n' + text + "\n")


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    reconstruction = json.loads((EXAMPLES / "spine_reconstruction.json").read_text(encoding="utf-8"))
    write_examples(Path(sys.argv[1]) if len(sys.argv) > 1 else EXAMPLES, reconstruction)
