"""A small model that the tests write themselves, and OpenSim's own answers from a separate process.

Everything about it is known in closed form: a double pendulum in the x-y plane.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

#: The script that asks OpenSim itself; OpenSim never enters the test process.
ORACLE = Path(__file__).with_name("opensim") / "opensim_oracle.py"

#: Double pendulum in the x-y plane with a slider coupled to the elbow [kg], [m].
UPPER_MASS, LOWER_MASS, UPPER_LENGTH = 2.0, 1.5, 0.30
UPPER_CENTER, LOWER_CENTER = 0.13, 0.12
#: The slider moves along the upper body by this much per radian of elbow flexion [m/rad].
SLIDE_PER_RADIAN = 0.02
CYLINDER_RADIUS = 0.025
GRAVITY = 9.80665
#: The coordinate of each joint of the small case.
COORDINATES = {"shoulder": "shoulder_flexion", "elbow": "elbow_flexion", "sliding": "slide"}


def _body(name: str, mass: float, center: float, wraps: str = "") -> str:
    return f"""<Body name="{name}"><mass>{mass}</mass><mass_center>0 {-center} 0</mass_center>
      <inertia>0.01 0.002 0.01 0 0 0</inertia>
      <WrapObjectSet name="wraps"><objects>{wraps}</objects></WrapObjectSet></Body>"""


def _frames(parent: str, at: str, child: str) -> str:
    return f"""<socket_parent_frame>from</socket_parent_frame><socket_child_frame>to</socket_child_frame>
      <frames>
        <PhysicalOffsetFrame name="from"><socket_parent>{parent}</socket_parent>
          <translation>{at}</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame>
        <PhysicalOffsetFrame name="to"><socket_parent>{child}</socket_parent>
          <translation>0 0 0</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame>
      </frames>"""


def _joint(kind: str, name: str, coordinate: str, frames: str) -> str:
    return f"""<{kind} name="{name}">{frames}
      <coordinates><Coordinate name="{coordinate}"></Coordinate></coordinates></{kind}>
      """


def _muscle(name: str, points: list[tuple[str, str]], wrap: str = "", extra: str = "") -> str:
    path = "".join(
        f"""<PathPoint name="{name}_{i}"><socket_parent_frame>/{body}</socket_parent_frame>
        <location>{location}</location></PathPoint>"""
        for i, (body, location) in enumerate(points)
    )
    wraps = (
        f"""<PathWrapSet name="wraps"><objects><PathWrap name="{name}_wrap"><wrap_object>{wrap}</wrap_object>
        <method>hybrid</method><range>-1 -1</range></PathWrap></objects></PathWrapSet>"""
        if wrap
        else ""
    )
    return f"""<Millard2012EquilibriumMuscle name="{name}">{extra}
      <path><GeometryPath name="path">
      <PathPointSet name="points"><objects>{path}</objects></PathPointSet>{wraps}</GeometryPath></path>
      <max_isometric_force>800</max_isometric_force><optimal_fiber_length>0.15</optimal_fiber_length>
      <tendon_slack_length>0.1</tendon_slack_length>
      <pennation_angle_at_optimal>0.1</pennation_angle_at_optimal></Millard2012EquilibriumMuscle>"""


def model_text() -> str:
    """Return the model: two pins, a slider coupled to the elbow, four muscles, a spring."""
    cylinder = f"""<WrapCylinder name="epicondyle"><translation>0 {-UPPER_LENGTH} 0</translation>
      <xyz_body_rotation>0 0 0</xyz_body_rotation><radius>{CYLINDER_RADIUS}</radius><length>0.2</length>
      <quadrant>all</quadrant></WrapCylinder>"""
    to_lower = _frames("/bodyset/upper", f"0 {-UPPER_LENGTH} 0", "/bodyset/lower")
    joints = (
        _joint("PinJoint", "shoulder", "shoulder_flexion", _frames("/ground", "0 1 0", "/bodyset/upper"))
        + _joint("PinJoint", "elbow", "elbow_flexion", to_lower)
        + _joint(
            "SliderJoint", "sliding", "slide", _frames("/bodyset/upper", "0.05 -0.2 0", "/bodyset/slider")
        )
    )
    ground, upper, lower, slider = "ground", "bodyset/upper", "bodyset/lower", "bodyset/slider"
    over_three = [(ground, "0.02 1.02 0.01"), (upper, "0.03 -0.1 0.01"), (lower, "0.03 -0.06 0.01")]
    behind = [(upper, "-0.02 -0.05 0"), (lower, "-0.02 -0.08 0")]
    through = [(ground, "-0.03 1.05 0"), (slider, "0 0 0.02"), (lower, "0.02 -0.1 0")]
    above = [(ground, "0 1.05 0"), (upper, "0.02 -0.1 0")]
    muscles = (
        _muscle("flexor", over_three)
        + _muscle("wrapped", behind, "epicondyle")
        + _muscle("through_slider", through)
        + _muscle("switched_off", above, extra="<appliesForce>false</appliesForce>")
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40600"><Model name="tiny">
  <gravity>0 {-GRAVITY} 0</gravity>
  <BodySet name="bodyset"><objects>
    {_body("upper", UPPER_MASS, UPPER_CENTER, cylinder)}
    {_body("lower", LOWER_MASS, LOWER_CENTER)}
    {_body("slider", 0.1, 0.0)}
  </objects></BodySet>
  <JointSet name="jointset"><objects>
    {joints}
  </objects></JointSet>
  <ConstraintSet name="constraintset"><objects>
    <CoordinateCouplerConstraint name="coupling">
      <coupled_coordinates_function><LinearFunction><coefficients>{SLIDE_PER_RADIAN} 0</coefficients>
      </LinearFunction></coupled_coordinates_function>
      <independent_coordinate_names>elbow_flexion</independent_coordinate_names>
      <dependent_coordinate_name>slide</dependent_coordinate_name>
    </CoordinateCouplerConstraint>
  </objects></ConstraintSet>
  <ForceSet name="forceset"><objects>
    {muscles}
    <SpringGeneralizedForce name="ligament"><coordinate>shoulder_flexion</coordinate><stiffness>3</stiffness>
      <rest_length>0.1</rest_length><viscosity>0</viscosity></SpringGeneralizedForce>
  </objects></ForceSet>
</Model></OpenSimDocument>
"""


ACTUATORS = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40600"><ForceSet name="reserves"><objects>
  <CoordinateActuator name="elbow_reserve"><min_control>-Inf</min_control><max_control>Inf</max_control>
    <coordinate>elbow_flexion</coordinate><optimal_force>4</optimal_force></CoordinateActuator>
  <PointActuator name="push"><min_control>-2</min_control><max_control>3</max_control><body>lower</body>
    <point>0 -0.2 0</point><point_is_global>false</point_is_global><direction>1 0 0</direction>
    <force_is_global>true</force_is_global><optimal_force>5</optimal_force></PointActuator>
</objects></ForceSet></OpenSimDocument>
"""

EXTERNAL_LOADS = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40600"><ExternalLoads name="loads"><objects>
  <ExternalForce name="hand"><applied_to_body>lower</applied_to_body>
    <force_expressed_in_body>ground</force_expressed_in_body>
    <point_expressed_in_body>lower</point_expressed_in_body>
    <force_identifier>hand_v</force_identifier><point_identifier>hand_p</point_identifier>
    <torque_identifier></torque_identifier></ExternalForce>
</objects><datafile>hand.mot</datafile></ExternalLoads></OpenSimDocument>
"""


@dataclass(frozen=True)
class Tiny:
    """Files of the small case; the motion is a pose for `still`, a swing for `moving`."""

    folder: Path
    setup: Path
    model: Path
    still: Path
    moving: Path
    actuators: Path
    loads: Path


def write_motion(path: Path, time: np.ndarray, columns: dict[str, np.ndarray]) -> Path:
    """Write a motion in radians."""
    rows = zip(time, *(np.broadcast_to(values, time.shape) for values in columns.values()), strict=True)
    lines = ["motion", "version=1", f"nRows={len(time)}", f"nColumns={len(columns) + 1}", "inDegrees=no"]
    lines += ["endheader", "\t".join(("time", *columns))]
    lines += ["\t".join(repr(float(value)) for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def setup_text(**settings: str) -> str:
    """Return an AnalyzeTool setup of the small case."""
    values = {
        "model_file": "tiny.osim",
        "force_set_files": "reserves.xml",
        "results_directory": "Results",
        "initial_time": "0.1",
        "final_time": "0.8",
        "external_loads_file": "loads.xml",
        "coordinates_file": "moving.mot",
        "lowpass_cutoff_frequency_for_coordinates": "8",
    } | settings
    inner = {name: values.pop(name) for name in ("on", "step_interval") if name in values}
    analysis = "".join(f"<{name}>{value}</{name}>" for name, value in inner.items())
    tool = "".join(f"<{name}>{value}</{name}>" for name, value in values.items())
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40600"><AnalyzeTool name="tiny">{tool}<AnalysisSet name="Analyses"><objects>
<StaticOptimization name="StaticOptimization">{analysis}</StaticOptimization></objects></AnalysisSet>
</AnalyzeTool></OpenSimDocument>
"""


def write_tiny(folder: Path) -> Tiny:
    """Write the small case into a folder."""
    time = np.linspace(0.0, 1.0, 101)
    elbow = 0.6 + 0.4 * np.sin(2 * np.pi * time)
    still = {"shoulder_flexion": np.array(0.3), "elbow_flexion": np.array(0.7), "slide": np.array(0.014)}
    moving = {
        "shoulder_flexion": 0.3 * np.cos(2 * np.pi * time),
        "elbow_flexion": elbow,
        "slide": SLIDE_PER_RADIAN * elbow,
    }
    load = {
        "hand_vx": 3.0 + 0 * time,
        "hand_vy": -10.0 - time,
        "hand_vz": 0 * time,
        "hand_px": 0.01 + 0 * time,
        "hand_py": -0.2 + 0 * time,
        "hand_pz": 0 * time,
    }
    (folder / "tiny.osim").write_text(model_text(), encoding="utf-8")
    (folder / "reserves.xml").write_text(ACTUATORS, encoding="utf-8")
    (folder / "loads.xml").write_text(EXTERNAL_LOADS, encoding="utf-8")
    (folder / "setup.xml").write_text(setup_text(), encoding="utf-8")
    write_motion(folder / "hand.mot", time, load)
    return Tiny(
        folder=folder,
        setup=folder / "setup.xml",
        model=folder / "tiny.osim",
        still=write_motion(folder / "still.mot", time, still),
        moving=write_motion(folder / "moving.mot", time, moving),
        actuators=folder / "reserves.xml",
        loads=folder / "loads.xml",
    )


def turn_round(tiny: Tiny, reversed_joints: Iterable[str]) -> None:
    """Write joints from their distal body to the other, and their coordinates with the other sign."""
    text, actuators = tiny.model.read_text(), tiny.actuators.read_text()
    time = np.linspace(0.0, 1.0, 101)
    elbow = 0.6 + 0.4 * np.sin(2 * np.pi * time)
    columns = {
        "shoulder_flexion": 0.3 * np.cos(2 * np.pi * time),
        "elbow_flexion": elbow,
        "slide": SLIDE_PER_RADIAN * elbow,
    }
    for joint in reversed_joints:
        usual = r"(Joint name=\"{}\">)<socket_parent_frame>from(.*?)<socket_child_frame>to<"
        other = r"\1<socket_parent_frame>to\2<socket_child_frame>from<"
        text, found = re.subn(usual.format(joint), other, text)
        assert found == 1
        columns[COORDINATES[joint]] = -columns[COORDINATES[joint]]
        if joint == "shoulder":
            text = text.replace("<rest_length>0.1<", "<rest_length>-0.1<")
        else:
            text = re.sub(r"<coefficients>(-?)", lambda sign: "<coefficients>" + "-" * (not sign[1]), text)
        if joint == "elbow":
            actuators = actuators.replace("<optimal_force>4<", "<optimal_force>-4<")
    tiny.model.write_text(text)
    tiny.actuators.write_text(actuators)
    write_motion(tiny.moving, time, columns)


def add_a_rocker(tiny: Tiny, *, by_joints: bool = True) -> None:
    """Close a loop by joints, or by a constraint: a rocker hangs on ground and on the lower body's end."""

    def reach(shoulder: float, elbow: float) -> np.ndarray:
        both = shoulder + elbow
        end = UPPER_LENGTH * np.array([np.sin(shoulder), -np.cos(shoulder)])
        return end + 0.2 * np.array([np.sin(both), -np.cos(both)]) + [-0.3, -0.1]

    length = float(np.linalg.norm(reach(0.3, 0.7)))
    angle = float(np.arctan2(*reach(0.3, 0.7)[::-1]))
    pin = """<PinJoint name="{0}"><socket_parent_frame>from</socket_parent_frame>
      <socket_child_frame>to</socket_child_frame><coordinates><Coordinate name="{0}_angle">
      <default_value>{1}</default_value></Coordinate></coordinates><frames>
      <PhysicalOffsetFrame name="from"><socket_parent>{2}</socket_parent><translation>{3}</translation>
      </PhysicalOffsetFrame><PhysicalOffsetFrame name="to"><socket_parent>{4}</socket_parent>
      <translation>{5}</translation></PhysicalOffsetFrame></frames></PinJoint>"""
    joints = pin.format("rocking", angle, "/ground", "0.3 1.1 0", "/bodyset/rocker", "0 0 0")
    end = f"{length} 0 0"
    if by_joints:
        joints += pin.format("closing", 1.0 - angle, "/bodyset/rocker", end, "/bodyset/lower", "0 -0.2 0")
    point = f"""<PointConstraint name="closing"><socket_body_1>/bodyset/rocker</socket_body_1>
      <socket_body_2>/bodyset/lower</socket_body_2><location_body_1>{end}</location_body_1>
      <location_body_2>0 -0.2 0</location_body_2></PointConstraint>"""
    body = """<Body name="rocker"><mass>0.5</mass><mass_center>0.1 0 0</mass_center>
      <inertia>0.01 0.002 0.01 0 0 0</inertia></Body>"""
    text = tiny.model.read_text()
    text = text.replace('<Body name="slider">', body + '<Body name="slider">')
    text = text.replace("<SliderJoint", joints + "<SliderJoint")
    coupler = "<CoordinateCouplerConstraint"
    tiny.model.write_text(text if by_joints else text.replace(coupler, point + coupler))
    for name, step in (("before", -1e-3), ("middle", 0.0), ("after", 1e-3)):
        elbow = 0.7 + step
        shoulder = brentq(lambda s, e=elbow: np.linalg.norm(reach(s, e)) - length, 0.2, 0.4, xtol=1e-14)
        rocking = np.arctan2(*reach(shoulder, elbow)[::-1])
        columns = {
            "shoulder_flexion": shoulder,
            "elbow_flexion": elbow,
            "slide": SLIDE_PER_RADIAN * elbow,
            "rocking_angle": rocking,
        }
        if by_joints:
            columns["closing_angle"] = shoulder + elbow - rocking
        still = {coordinate: np.array(value) for coordinate, value in columns.items()}
        write_motion(tiny.folder / f"{name}.mot", np.linspace(0, 0.1, 11), still)


def ask_opensim(folder: Path, **question: object) -> dict[str, np.ndarray]:
    """Run the oracle script in a process of its own and return its arrays."""
    environment = {key: value for key, value in os.environ.items() if key != "LD_LIBRARY_PATH"}
    output = folder / "oracle.npz"
    text = json.dumps({**question, "output": str(output)}, default=str)
    done = subprocess.run(
        [sys.executable, "-P", str(ORACLE), text],
        env=environment,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout.decode(errors="replace")[-2000:]
    if not output.is_file():
        return {}
    with np.load(output) as content:
        return dict(content)
