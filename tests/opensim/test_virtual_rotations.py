"""Virtual rotations about the axes of ball joints, which their own coordinates allow too."""

from pathlib import Path

import numpy as np
import pytest
from tiny_model import ask_opensim, write_motion

from scso_nlp.opensim.engine import load_motion
from scso_nlp.trajectory import MotionTrajectory

pytestmark = pytest.mark.opensim

STEP = 2e-3  # [rad]
#: Moved by the pin alone, so that a moving and a conditional point are held when a ball turns.
DRIVEN = "<socket_coordinate>/jointset/pin/swing</socket_coordinate>"


def ball(name: str, parent: str, at: str, child: str) -> str:
    turns = "".join(
        f"""<TransformAxis name="rotation{i}"><coordinates>{name}_{letter}</coordinates><axis>{axis}</axis>
        <LinearFunction name="function"><coefficients>1 0</coefficients></LinearFunction></TransformAxis>"""
        for i, (letter, axis) in enumerate((("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")), start=1)
    )
    coordinates = "".join(f'<Coordinate name="{name}_{letter}"></Coordinate>' for letter in "xyz")
    return f"""<CustomJoint name="{name}">{frames(parent, at, child)}
      <coordinates>{coordinates}</coordinates><SpatialTransform>{turns}</SpatialTransform></CustomJoint>"""


def frames(parent: str, at: str, child: str) -> str:
    return f"""<socket_parent_frame>from</socket_parent_frame><socket_child_frame>to</socket_child_frame>
      <frames><PhysicalOffsetFrame name="from"><socket_parent>{parent}</socket_parent>
      <translation>{at}</translation></PhysicalOffsetFrame>
      <PhysicalOffsetFrame name="to"><socket_parent>{child}</socket_parent></PhysicalOffsetFrame></frames>"""


def body(name: str, wraps: str = "") -> str:
    return f"""<Body name="{name}"><mass>1</mass><mass_center>0 -0.1 0</mass_center>
      <inertia>0.01 0.01 0.01 0 0 0</inertia>
      <WrapObjectSet name="wraps"><objects>{wraps}</objects></WrapObjectSet></Body>"""


def cylinder(name: str, at: str, quadrant: str = "all", turned: str = "0 0 0") -> str:
    return f"""<WrapCylinder name="{name}"><translation>{at}</translation><radius>0.03</radius>
      <length>0.4</length><quadrant>{quadrant}</quadrant>
      <xyz_body_rotation>{turned}</xyz_body_rotation></WrapCylinder>"""


def point(body: str, at: str, kind: str = "PathPoint", more: str = "") -> str:
    name = "at" + at.replace(" ", "_")
    return f"""<{kind} name="{name}">
      <socket_parent_frame>/bodyset/{body}</socket_parent_frame><location>{at}</location>{more}</{kind}>"""


def muscle(name: str, *points: str, wraps: tuple[str, ...] = ()) -> str:
    wrapped = "".join(
        f'<PathWrap name="over_{wrap}"><wrap_object>{wrap}</wrap_object><range>-1 -1</range></PathWrap>'
        for wrap in wraps
    )
    return f"""<Millard2012EquilibriumMuscle name="{name}"><path><GeometryPath name="path">
      <PathPointSet name="points"><objects>{"".join(points)}</objects></PathPointSet>
      <PathWrapSet name="wraps"><objects>{wrapped}</objects></PathWrapSet></GeometryPath></path>
      <max_isometric_force>100</max_isometric_force><optimal_fiber_length>0.2</optimal_fiber_length>
      <tendon_slack_length>0.2</tendon_slack_length></Millard2012EquilibriumMuscle>"""


def moving_point(body: str) -> str:
    """Slide along y by 0.05 m per radian of the pin."""
    axes = "".join(
        f"""<socket_{axis}_coordinate>/jointset/pin/swing</socket_{axis}_coordinate>
        <{axis}_location><LinearFunction><coefficients>{slope} {start}</coefficients></LinearFunction>
        </{axis}_location>"""
        for axis, slope, start in (("x", 0.0, 0.03), ("y", 0.05, -0.15), ("z", 0.0, 0.01))
    )
    return f"""<MovingPathPoint name="moving"><socket_parent_frame>/bodyset/{body}</socket_parent_frame>
      {axes}</MovingPathPoint>"""


MUSCLES = {
    "straight": muscle("straight", point("upper", "0.02 -0.1 0.01"), point("lower", "0.03 -0.12 0.02")),
    "via": muscle(
        "via",
        point("upper", "0.03 -0.05 0.02"),
        point("upper", "0.04 -0.2 0.02", "ConditionalPathPoint", f"{DRIVEN}<range>-3 3</range>"),
        point("upper", "0.08 -0.25 0.02", "ConditionalPathPoint", f"{DRIVEN}<range>2 3</range>"),
        point("lower", "0.04 -0.12 -0.01"),
    ),
    "moving": muscle(
        "moving", point("base", "0.02 0.1 0.03"), moving_point("upper"), point("lower", "0.05 -0.1 0")
    ),
    "wrapped": muscle(
        "wrapped", point("upper", "-0.02 -0.1 0.01"), point("lower", "-0.03 -0.14 0.02"), wraps=("knob",)
    ),
    "untouched": muscle(
        "untouched", point("upper", "0.09 -0.1 0.01"), point("lower", "0.08 -0.14 0.02"), wraps=("knob",)
    ),
    "both": muscle(
        "both", point("upper", "-0.03 -0.1 0.02"), point("hand", "-0.02 -0.05 0.01"), wraps=("knob",)
    ),
    "far": muscle(
        "far", point("lower", "-0.02 -0.1 0.01"), point("hand", "-0.03 -0.12 0.0"), wraps=("small_knob",)
    ),
    "twice": muscle(
        "twice",
        point("upper", "-0.01 -0.1 0.05"),
        point("hand", "-0.02 -0.1 -0.05"),
        wraps=("knob", "small_knob"),
    ),
}


#: Over surfaces of every kind, one or several.
ROUND = {
    "tilted": muscle(
        "tilted", point("upper", "-0.03 -0.25 0.05"), point("lower", "0 -0.14 -0.08"), wraps=("tilt",)
    ),
    "behind": muscle(
        "behind", point("upper", "0.01 -0.1 0.03"), point("lower", "-0.02 -0.14 -0.02"), wraps=("ridge",)
    ),
    "bead": muscle(
        "bead", point("upper", "-0.02 -0.1 0.01"), point("lower", "-0.03 -0.14 0.02"), wraps=("bead",)
    ),
    "egg": muscle(
        "egg", point("upper", "-0.02 -0.1 0.01"), point("lower", "-0.03 -0.14 0.02"), wraps=("egg",)
    ),
    "listed": muscle(
        "listed",
        point("upper", "-0.03 -0.25 0.05"),
        point("lower", "0 -0.14 -0.08"),
        wraps=("tilt", "far_tilt"),
    ),
    "mixed": muscle(
        "mixed",
        point("upper", "-0.01 -0.1 0.05"),
        point("hand", "-0.02 -0.1 -0.05"),
        wraps=("small_knob", "bead"),
    ),
    "twice": MUSCLES["twice"],
    "backwards": muscle(
        "backwards",
        point("upper", "-0.02 -0.1 0.02"),
        point("hand", "-0.02 -0.1 0.06"),
        wraps=("small_knob", "tilt"),
    ),
}


def write_model(folder: Path, muscles: dict[str, str] = MUSCLES) -> Path:
    surfaces = cylinder("knob", "0 -0.3 0")
    surfaces += cylinder("tilt", "0 -0.3 0", turned="0.2 0.3 0.1") + cylinder("far_tilt", "0.5 -0.3 0")
    surfaces += cylinder("ridge", "0 -0.3 0", quadrant="-x", turned="0.1 -0.2 0")
    surfaces += """<WrapSphere name="bead"><translation>0 -0.3 0</translation><radius>0.03</radius>
      </WrapSphere><WrapEllipsoid name="egg"><translation>0 -0.3 0</translation>
      <dimensions>0.03 0.05 0.04</dimensions></WrapEllipsoid>"""
    bodies = body("base") + body("upper", surfaces)
    bodies += body("lower", cylinder("small_knob", "0 -0.25 0")) + body("hand")
    pin = f"""<PinJoint name="pin">{frames("/ground", "0 1 0", "/bodyset/base")}
      <coordinates><Coordinate name="swing"></Coordinate></coordinates></PinJoint>"""
    joints = pin + ball("hip", "/bodyset/base", "0 0 0", "/bodyset/upper")
    joints += ball("knee", "/bodyset/upper", "0 -0.3 0", "/bodyset/lower")
    joints += ball("wrist", "/bodyset/lower", "0 -0.25 0", "/bodyset/hand")
    path = folder / "balls.osim"
    path.write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40600"><Model name="balls">
  <BodySet name="bodyset"><objects>{bodies}</objects></BodySet>
  <JointSet name="jointset"><objects>{joints}</objects></JointSet>
  <ForceSet name="forceset"><objects>{"".join(muscles.values())}</objects></ForceSet>
</Model></OpenSimDocument>""",
        encoding="utf-8",
    )
    return path


def by_opensim(
    folder: Path, model: Path, found: MotionTrajectory, rows: tuple[str, ...], step: float = STEP
) -> tuple[np.ndarray, np.ndarray]:
    """Moment arms and five-point derivatives of them, shape (n_frames, n_rows, n_muscles)."""
    steps = (0, -2, -1, 1, 2)
    values = []
    for pose in found.coordinate_values:
        for row in rows:
            for n in steps:
                shifted = pose.copy()
                shifted[found.coordinates.index(row)] += n * step
                values.append(shifted.tolist())
    arms = ask_opensim(
        folder,
        kind="moment arms",
        model=model,
        coordinates=found.coordinates,
        muscles=found.muscles,
        values=values,
    )["moment_arms"].reshape(found.n_frames, len(rows), len(steps), len(found.coordinates), -1)
    own = np.stack([arms[:, i, :, found.coordinates.index(row)] for i, row in enumerate(rows)], axis=1)
    slopes = (own[:, :, 1] - 8 * own[:, :, 2] + 8 * own[:, :, 3] - own[:, :, 4]) / (12 * step)
    return own[:, :, 0], -slopes


def load(folder: Path, model: Path, n_frames: int) -> MotionTrajectory:
    time = np.linspace(0, 1, n_frames)
    rng = np.random.default_rng(1)
    coordinates = ["swing", *(f"{joint}_{axis}" for joint in ("hip", "knee", "wrist") for axis in "xyz")]
    motion = write_motion(
        folder / "m.sto", time, {name: rng.uniform(-0.35, 0.35, len(time)) for name in coordinates}
    )
    axes = tuple((joint, axis) for joint in ("knee", "wrist", "hip") for axis in "zxy")
    return load_motion(model=model, coordinates=motion, stability_axes=axes, processes=1).trajectory


def test_all_kinds_of_paths_have_the_moment_arms_and_curvature_of_opensim(tmp_path: Path) -> None:
    model = write_model(tmp_path)
    found = load(tmp_path, model, n_frames=7)
    skeleton = found.skeleton
    assert skeleton is not None
    arms, curvature = by_opensim(tmp_path, model, found, skeleton.virtual_rows)
    muscles = {name: found.muscles.index(name) for name in MUSCLES}
    # paths that cannot change need none: they have the closed form of their points
    assert np.isnan(skeleton.virtual_curvature[:, :, muscles["straight"]]).all()
    others = [m for name, m in muscles.items() if name not in ("straight", "twice")]
    np.testing.assert_allclose(skeleton.virtual_moment_arms[:, :, others], arms[:, :, others], atol=1e-11)
    np.testing.assert_allclose(skeleton.virtual_curvature[:, :, others], curvature[:, :, others], atol=1e-8)
    # over two surfaces OpenSim stops iterating early: its forces do not act along the path, not even at the
    # hip, which is not crossed, and they jump by more than the stencil's steps change them
    m, rows = muscles["twice"], [row.rsplit("_", 1)[0] for row in skeleton.virtual_rows]
    crossed = [r for r, joint in enumerate(rows) if joint != "hip"]
    np.testing.assert_allclose(skeleton.virtual_moment_arms[:, crossed, m], arms[:, crossed, m], atol=1e-11)
    # every kind is there: wraps that touch and do not, moving points, joints that are crossed or not
    touches = skeleton.path_point_moves.any(axis=-1)
    assert 1 < touches[:, muscles["wrapped"]].sum() < found.n_frames
    assert touches[:, [muscles["both"], muscles["far"]]].any(axis=0).all()
    assert not touches[:, [muscles["untouched"], muscles["via"]]].any()
    assert touches[:, muscles["moving"]].all()
    assert skeleton.path_point_moves[:, muscles["twice"]].sum(axis=-1).max() == 4
    is_crossed = np.abs(curvature).max(axis=0) > 1e-3
    crossing = {
        name: {rows[r] for r in np.flatnonzero(is_crossed[:, m])}
        for name, m in muscles.items()
        if m in others
    }
    assert crossing == {
        "via": {"knee"},
        "moving": {"hip", "knee"},
        "wrapped": {"knee"},
        "untouched": {"knee"},
        "both": {"knee", "wrist"},
        "far": {"wrist"},
    }


def test_paths_over_all_kinds_of_surfaces_have_the_moment_arms_and_curvature_of_opensim(
    tmp_path: Path,
) -> None:
    model = write_model(tmp_path, ROUND)
    found = load(tmp_path, model, n_frames=12)
    skeleton = found.skeleton
    assert skeleton is not None
    crossed = [r for r, row in enumerate(skeleton.virtual_rows) if not row.startswith("hip")]
    rows = tuple(skeleton.virtual_rows[r] for r in crossed)
    arms, curvature = by_opensim(tmp_path, model, found, rows, step=1e-6)
    points, moves = skeleton.path_points, skeleton.path_point_moves
    n_contacts = {}
    for name in ROUND:
        m = found.muscles.index(name)
        # the stencil's rounding; where OpenSim is asked, its step of 1e-4 too
        tolerance = 3e-6 if name in ("bead", "egg", "mixed") else 2e-8
        own_arms, own_curvature = (
            array[:, crossed, m] for array in (skeleton.virtual_moment_arms, skeleton.virtual_curvature)
        )
        np.testing.assert_allclose(own_arms, arms[:, :, m], atol=1e-11, err_msg=name)
        np.testing.assert_allclose(own_curvature, curvature[:, :, m], atol=tolerance, err_msg=name)
        assert np.abs(own_curvature).max() > 1e-2
        n_contacts[name] = int(moves[:, m].sum(axis=-1).max())
    assert n_contacts == {name: 4 if name in ("mixed", "twice", "backwards") else 2 for name in ROUND}
    # the same path: with a second surface in its list contact points are shifted until they are tangent
    tilted, listed = (found.muscles.index(name) for name in ("tilted", "listed"))
    assert np.abs(points[:, tilted] - points[:, listed]).max() > 1e-4


def test_curvature_over_two_surfaces_is_smooth_in_time(shared_data: Path) -> None:
    # where OpenSim does another shift or round between two poses its moment arms jump: differences over steps
    # of 1e-4 and of 1e-6 have spikes of 0.03 to 0.5 m here and there
    setup = shared_data / "walking3d" / "setup_static_optimization.xml"
    found = load_motion(
        setup,
        initial_time=0.55,
        final_time=0.60,
        step_interval=1,
        keep_coupled_speeds=False,
        stability_axes=tuple(("walker_knee_r", axis) for axis in "xyz"),
    ).trajectory
    assert found.skeleton is not None
    m = found.muscles.index("gaslat_r")
    assert (found.skeleton.path_point_moves[:, m].sum(axis=-1) == 4).all()
    changes = np.abs(np.diff(found.skeleton.virtual_curvature[:, :, m], axis=0))
    assert changes.max() < 1e-4
