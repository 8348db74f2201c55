"""The engine's numbers against closed forms and against OpenSim's own tools."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import tiny_model
from defusedxml import ElementTree
from tiny_model import Tiny, ask_opensim, setup_text

from scso_nlp.io.storage import read_storage
from scso_nlp.methods import static_optimization
from scso_nlp.opensim.engine import load_motion
from scso_nlp.solver import solve_framewise
from scso_nlp.trajectory import MotionTrajectory

pytestmark = pytest.mark.opensim

#: Moment arms are read from the same model at the same pose by two ways through the same Jacobian [m].
MOMENT_ARM_TOLERANCE = 1e-12
#: OpenSim's optimizer meets its acceleration constraints to about 1e-7; its files hold 8 digits [N·m].
EQUILIBRIUM_TOLERANCE = 1e-5
MODELS = {
    "arm26": ("arm26_millard.osim", "arm26_millard_Setup_StaticOptimization.xml"),
    "gait10dof18musc": ("gait10dof18musc_simbody.osim", "setup_static_optimization.xml"),
    "walking3d": ("subject_walk_scaled.osim", "setup_static_optimization.xml"),
}


def test_static_pose_of_a_double_pendulum_has_the_moments_of_gravity_load_and_spring(tiny: Tiny) -> None:
    trajectory = load_motion(model=tiny.model, coordinates=tiny.still, external_loads=tiny.loads).trajectory
    shoulder, elbow, g = 0.3, 0.7, tiny_model.GRAVITY
    slide = tiny_model.SLIDE_PER_RADIAN * elbow

    def turned(angle: float, x: float, y: float) -> np.ndarray:
        return np.array([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)])

    joint = turned(shoulder, 0, -tiny_model.UPPER_LENGTH)
    upper = turned(shoulder, 0, -tiny_model.UPPER_CENTER)
    lower = joint + turned(shoulder + elbow, 0, -tiny_model.LOWER_CENTER)
    slider = turned(shoulder, 0.05 + slide, -0.2)
    hand = joint + turned(shoulder + elbow, 0.01, -0.2)
    load = np.array([3.0, -10.0 - trajectory.time[0]])
    weights = ((upper, tiny_model.UPPER_MASS), (lower, tiny_model.LOWER_MASS), (slider, 0.1))
    at_shoulder = sum(mass * g * point[0] for point, mass in weights)
    at_shoulder -= hand[0] * load[1] - hand[1] * load[0]
    spring = -3.0 * (shoulder - 0.1)
    at_shoulder -= spring
    arm = hand - joint
    at_elbow = tiny_model.LOWER_MASS * g * (lower - joint)[0] - (arm[0] * load[1] - arm[1] * load[0])
    # the slider's share: moving it by slide per radian lifts its weight along the upper body
    at_elbow += tiny_model.SLIDE_PER_RADIAN * 0.1 * g * np.sin(shoulder)
    assert trajectory.coordinates == ("shoulder_flexion", "elbow_flexion")
    # 1e-9: the spline through a constant has accelerations of rounding size
    np.testing.assert_allclose(trajectory.generalized_forces[0], [at_shoulder, at_elbow], atol=1e-9)
    np.testing.assert_allclose(trajectory.passive_generalized_forces[0], [spring, 0], atol=1e-12)
    skeleton = trajectory.skeleton
    assert skeleton is not None
    np.testing.assert_allclose(skeleton.load_forces[0, 0], [*load, 0], atol=1e-12)
    np.testing.assert_allclose(skeleton.load_points[0, 0], [hand[0], 1 + hand[1], 0], atol=1e-12)
    np.testing.assert_allclose(skeleton.joint_centers[0, 1], [joint[0], 1 + joint[1], 0], atol=1e-12)
    np.testing.assert_allclose(
        skeleton.body_mass_centers[0, 1:, :2], np.add([upper, lower, slider], [0, 1]), atol=1e-12
    )


def test_a_muscle_around_a_cylinder_has_the_cylinders_radius_as_moment_arm(tiny: Tiny) -> None:
    axes = (("elbow", "z"), ("shoulder", "z"))
    trajectory = load_motion(tiny.setup, stability_axes=axes).trajectory
    skeleton = trajectory.skeleton
    assert skeleton is not None
    m = trajectory.muscles.index("wrapped")
    touching = skeleton.path_point_moves[:, m].sum(axis=1) == 2
    assert touching.sum() > 20
    arms = trajectory.moment_arms[touching, 1, m]
    # the wrap solution is exact for cylinders up to OpenSim's tangent tolerance
    np.testing.assert_allclose(np.abs(arms), tiny_model.CYLINDER_RADIUS, atol=1e-9)
    np.testing.assert_allclose(skeleton.virtual_moment_arms[touching, 0, m], arms, atol=1e-9)
    np.testing.assert_allclose(skeleton.virtual_curvature[touching, 0, m], 0, atol=1e-6)
    assert (skeleton.virtual_moment_arms[:, 1, m] == 0).all(), "both ends hang on the upper body"
    assert np.isnan(skeleton.virtual_moment_arms[:, :, trajectory.muscles.index("flexor")]).all()


def test_point_actuators_and_reserves_push_by_their_optimal_force(tiny: Tiny) -> None:
    motion = load_motion(tiny.setup)
    trajectory, actuators = motion.trajectory, motion.actuators
    assert trajectory.actuators == actuators.actuators == ("elbow_reserve", "push")
    np.testing.assert_array_equal(actuators.optimal_force, [4, 5])
    np.testing.assert_array_equal(actuators.min_control, [-np.inf, -2])
    np.testing.assert_array_equal(actuators.max_control, [np.inf, 3])
    np.testing.assert_allclose(
        trajectory.actuator_generalized_forces[:, :, 0], [[0, 4]] * trajectory.n_frames
    )
    upper = trajectory.coordinate_values[:, 0]
    both = trajectory.coordinate_values.sum(axis=1)
    height = 0.2 * np.cos(both)
    elbow = 5 * height
    shoulder = 5 * (height + tiny_model.UPPER_LENGTH * np.cos(upper))
    # a difference of two inverse dynamics solutions of about 20 N·m
    np.testing.assert_allclose(
        trajectory.actuator_generalized_forces[:, :, 1], np.stack([shoulder, elbow], axis=1), atol=1e-12
    )
    assert "switched_off" not in motion.muscles.muscles
    assert trajectory.force_columns[:4] == ("flexor", "wrapped", "through_slider", "ligament_Force")


def test_moment_arms_are_the_gradient_of_length_including_the_coupled_slider(tiny: Tiny) -> None:
    trajectory = load_motion(tiny.setup, lowpass_cutoff_frequency=-1).trajectory
    rate = -np.einsum("kcm,kc->km", trajectory.moment_arms, trajectory.coordinate_speeds)
    np.testing.assert_allclose(trajectory.muscle_tendon_velocity, rate, atol=1e-12)


@pytest.mark.parametrize("case", ["tiny", *MODELS])
def test_moment_arms_equal_opensims_moment_arm_solver(
    case: str, tiny: Tiny, request: pytest.FixtureRequest
) -> None:
    if case == "tiny":
        model, setup = tiny.model, tiny.setup
    else:
        folder = request.getfixturevalue("shared_data") / case
        model, setup = (folder / name for name in MODELS[case])
    trajectory = load_motion(setup, step_interval=100 if case == "walking3d" else 20).trajectory
    frames = [0, trajectory.n_frames // 2, trajectory.n_frames - 1]
    answer = ask_opensim(
        tiny.folder,
        kind="moment arms",
        model=model,
        coordinates=trajectory.coordinates,
        muscles=trajectory.muscles,
        values=trajectory.coordinate_values[frames].tolist(),
    )
    theirs = np.array(answer["moment_arms"])
    np.testing.assert_allclose(trajectory.moment_arms[frames], theirs, rtol=0, atol=MOMENT_ARM_TOLERANCE)
    # muscles that do not cross a coordinate have none about it, where OpenSim's solver has rounding
    is_rounding = (theirs != 0) & (np.abs(theirs) < 1e-13 * np.abs(theirs).max(axis=(1, 2), keepdims=True))
    assert is_rounding.any() or case == "tiny"
    assert not trajectory.moment_arms[frames][is_rounding].any()
    assert (np.abs(trajectory.moment_arms[trajectory.moment_arms != 0]) > 1e-9).all()


def _walking_for_80_frames(source: Path, folder: Path) -> Path:
    """Cut the motion short: OpenSim assembles every row of it before it starts."""
    for name in ("subject_walk_scaled.osim", "reserves.xml", "grf_walk.xml", "grf_walk.mot"):
        shutil.copy(source / name, folder)
    lines = (source / "coordinates.sto").read_text().splitlines()
    start = lines.index("endheader") + 2
    lines = [line if not line.startswith("nRows") else "nRows=80" for line in lines[: start + 80]]
    (folder / "coordinates.sto").write_text("\n".join(lines) + "\n")
    text = (source / "setup_static_optimization.xml").read_text()
    for name, value in (("initial_time", "0.47"), ("final_time", "0.51"), ("step_interval", "5")):
        text = re.sub(f"<{name}>.*?</{name}>", f"<{name}>{value}</{name}>", text)
    (folder / "setup.xml").write_text(text)
    return folder / "setup.xml"


@pytest.mark.parametrize("case", ["tiny", *MODELS])
def test_opensims_own_static_optimization_balances_our_equations(
    case: str, tiny: Tiny, request: pytest.FixtureRequest
) -> None:
    if case == "tiny":
        setup = tiny.setup
    else:
        source = request.getfixturevalue("shared_data") / case
        folder = tiny.folder / case
        if case == "walking3d":
            folder.mkdir()
            setup = _walking_for_80_frames(source, folder)
        else:
            shutil.copytree(source, folder)
            setup = folder / MODELS[case][1]
    trajectory = load_motion(setup).trajectory
    results = tiny.folder / "results"
    ask_opensim(tiny.folder, kind="static optimization", setup=setup, results=results)
    activation, force = (
        read_storage(next(results.glob(f"*_{kind}.sto"))) for kind in ("activation", "force")
    )
    assert force.labels == trajectory.force_columns
    optimized = [name for name in force.labels if name in trajectory.muscles + trajectory.actuators]
    assert list(activation.labels) == optimized
    # OpenSim prints 8 decimals or more
    np.testing.assert_allclose(force.time, trajectory.time, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        force.columns(trajectory.muscles),
        activation.columns(trajectory.muscles) * trajectory.active_force_capacity,
        rtol=0,
        atol=1e-4,  # a capacity of up to 1e4 N times half a unit of the last printed digit
    )
    np.testing.assert_allclose(
        force.columns(trajectory.other_force_labels), trajectory.other_forces, rtol=0, atol=1e-6
    )
    produced = np.einsum("kcm,km->kc", trajectory.moment_arms, force.columns(trajectory.muscles))
    produced += np.einsum(
        "kca,ka->kc", trajectory.actuator_generalized_forces, activation.columns(trajectory.actuators)
    )
    np.testing.assert_allclose(produced, trajectory.generalized_forces, rtol=0, atol=EQUILIBRIUM_TOLERANCE)


def test_a_setup_whose_motion_contradicts_the_couplers_still_answers_as_opensim(
    shared_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Its motion file has the patellae in degrees; OpenSim then takes their speeds 57 times too high."""
    setup = _walking_for_80_frames(shared_data / "walking3d", tmp_path)
    results = tmp_path / "results"
    ask_opensim(tmp_path, kind="static optimization", setup=setup, results=results)
    theirs = read_storage(next(results.glob("*_activation.sto")))
    motion = load_motion(setup)
    (warning,) = (message for message in caplog.messages if "contradict" in message)
    assert "knee_angle_r_beta by up to" in warning
    assert "OpenSim uses them and so do we; set keep_coupled_speeds=false" in warning
    ours = solve_framewise(static_optimization(motion))
    # OpenSim's own optimizer stops up to 0.01 from the optimum of its problem
    np.testing.assert_allclose(
        np.hstack([ours.activation, ours.control]),
        theirs.columns(motion.trajectory.muscles + motion.trajectory.actuators),
        rtol=0,
        atol=0.01,
    )
    capacity = motion.trajectory.active_force_capacity
    from_constraints = load_motion(setup, keep_coupled_speeds=False).trajectory.active_force_capacity
    # the quadriceps shorten with the patella
    assert np.abs(from_constraints - capacity).max() > 0.1 * capacity.max()


def test_coupled_coordinates_can_take_their_speeds_from_the_constraints(tiny: Tiny) -> None:
    """On request a motion file with a wrong column for the slider changes nothing."""
    right = load_motion(tiny.setup, keep_coupled_speeds=False).trajectory
    text = tiny.moving.read_text().splitlines()
    start = text.index("endheader") + 2
    rows = [line.rsplit("\t", 1)[0] + f"\t{0.3 * (k % 5)}" for k, line in enumerate(text[start:])]
    tiny.moving.write_text("\n".join(text[:start] + rows) + "\n")
    wrong = load_motion(tiny.setup, keep_coupled_speeds=False).trajectory
    np.testing.assert_allclose(wrong.generalized_forces, right.generalized_forces, atol=1e-12)
    np.testing.assert_allclose(wrong.muscle_tendon_velocity, right.muscle_tendon_velocity, atol=1e-12)


def _closed_form(trajectory: MotionTrajectory, row: str, muscle: int, frame: int) -> tuple[float, float]:
    """First and second derivative of length for straight segments, the distal ends turning."""
    skeleton = trajectory.skeleton
    assert skeleton is not None
    name, letter = row.rsplit("_", 1)
    joint = skeleton.joints.index(name)
    axis = skeleton.joint_axes[frame, joint, "xyz".index(letter)]
    bodies = skeleton.path_point_bodies[frame, muscle]
    points = skeleton.path_points[frame, muscle, bodies >= 0] - skeleton.joint_centers[frame, joint]
    turns = skeleton.distal_bodies(joint)[bodies[bodies >= 0]]
    arm = curvature = 0.0
    for i in np.flatnonzero(turns[1:] != turns[:-1]):
        moving, fixed = (points[i], points[i + 1]) if turns[i] else (points[i + 1], points[i])
        segment = moving - fixed
        length = np.linalg.norm(segment)
        velocity = np.cross(axis, moving)
        slope = velocity @ segment / length
        arm -= slope
        curvature += (velocity @ velocity + segment @ np.cross(axis, velocity) - slope**2) / length
    return arm, curvature


def test_virtual_rotations_equal_the_closed_form_where_no_path_wraps(shared_data: Path) -> None:
    joints = ("ground_pelvis", "hip_r", "knee_r", "ankle_r", "back")
    axes = tuple((joint, axis) for joint in joints for axis in "xyz")
    setup = shared_data / "gait10dof18musc" / "setup_static_optimization.xml"
    trajectory = load_motion(setup, final_time=0.9, step_interval=10, stability_axes=axes).trajectory
    skeleton = trajectory.skeleton
    assert skeleton is not None
    compared = 0
    for i, row in enumerate(skeleton.virtual_rows):
        for k, m in np.argwhere(np.isfinite(skeleton.virtual_moment_arms[:, i])):
            arm, curvature = _closed_form(trajectory, row, m, k)
            assert skeleton.virtual_moment_arms[k, i, m] == pytest.approx(arm, abs=1e-13)
            # a central difference with a step of 1e-4 rad: truncation 1e-9 m at most
            assert skeleton.virtual_curvature[k, i, m] == pytest.approx(curvature, abs=2e-9)
            compared += abs(arm) > 1e-3
    assert compared > 20


def test_joint_axes_are_orthonormal_where_the_joint_is_and_named_by_direction(shared_data: Path) -> None:
    setup = shared_data / "walking3d" / "setup_static_optimization.xml"
    trajectory = load_motion(setup, step_interval=300).trajectory
    skeleton = trajectory.skeleton
    assert skeleton is not None
    assert "radius_hand_r" not in skeleton.joints, "welds cannot move"
    np.testing.assert_allclose(np.linalg.norm(skeleton.joint_axes, axis=-1), 1, atol=1e-12)
    hips = [skeleton.joints.index(f"hip_{side}") for side in "rl"]
    for hip in hips:
        axes = skeleton.joint_axes[:, hip]
        # walking: no joint axis is far from the direction whose letter it carries
        assert (np.einsum("kuu->ku", axes) > 0.5).all()
    bodies = dict(zip(skeleton.bodies, range(len(skeleton.bodies)), strict=True))
    assert skeleton.body_parents[bodies["tibia_r"]] == bodies["femur_r"]
    assert skeleton.body_parents[bodies["toes_r"]] == bodies["calcn_r"]
    model = ElementTree.parse(shared_data / "walking3d" / "subject_walk_scaled.osim")
    written = sum(float(body.findtext("mass")) for body in model.iter("Body"))
    assert skeleton.body_masses.sum() == pytest.approx(written, rel=1e-12)


def test_radians_without_a_header_and_epoch_times_load_as_they_are(
    shared_data: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = shared_data / "back_lifting"
    caplog.set_level("INFO", logger="scso_nlp")
    ik = folder / "stoop15kg" / "ik.sto"
    start = 1667315995.54
    trajectory = load_motion(
        model=folder / "lumbarModel_scaled.osim",
        coordinates=ik,
        initial_time=start + 0.01,
        final_time=start + 0.5,
    ).trajectory
    assert any("inDegrees is missing, radians" in message for message in caplog.messages)
    assert trajectory.time[0] == pytest.approx(1667315995.544540, abs=1e-6)
    published = read_storage(folder / "stoop15kg" / "id.sto")
    # the published inverse dynamics is quasi-static with the load in hand: still before the lift
    for name in ("L5_S1_Flex_Ext", "L4_L5_Flex_Ext", "L3_L4_Flex_Ext"):
        ours = trajectory.generalized_forces[:, trajectory.coordinates.index(name)]
        assert np.abs(ours).max() < 60
        assert np.sign(ours.mean()) == np.sign(published.column(name)[:5].mean())


def test_setup_text_of_the_small_case_is_read_like_a_file_of_opensim(tiny: Tiny) -> None:
    (tiny.folder / "again.xml").write_text(setup_text(step_interval="7"))
    every, seventh = (load_motion(tiny.folder / name).trajectory.time for name in ("setup.xml", "again.xml"))
    assert set(seventh) < set(every)
    assert (seventh[[0, -1]] == every[[0, -1]]).all()


def _with_a_rod(tiny: Tiny) -> None:
    """Close a loop: a rod of fixed length from ground to the lower body."""
    rod = """<ConstantDistanceConstraint name="rod"><socket_body_1>/ground</socket_body_1>
      <socket_body_2>/bodyset/lower</socket_body_2><location_body_1>0.3 1.1 0</location_body_1>
      <location_body_2>0 -0.2 0</location_body_2><constant_distance>0.6</constant_distance>
      </ConstantDistanceConstraint>"""
    text = tiny.model.read_text()
    tiny.model.write_text(text.replace("<CoordinateCouplerConstraint", rod + "<CoordinateCouplerConstraint"))


def test_a_closed_loop_gives_up_one_coordinate_and_keeps_the_path_rates(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    _with_a_rod(tiny)
    caplog.set_level("INFO", logger="scso_nlp")
    # its motion file knows nothing of the rod
    trajectory = load_motion(tiny.setup, keep_coupled_speeds=False).trajectory
    assert len(trajectory.coordinates) == 1
    assert any("chosen to close loops" in message for message in caplog.messages)
    rate = -trajectory.moment_arms[:, 0] * trajectory.coordinate_speeds
    np.testing.assert_allclose(trajectory.muscle_tendon_velocity, rate, atol=1e-12)


def test_statics_of_a_closed_loop_is_the_slope_of_its_potential(tiny: Tiny) -> None:
    _with_a_rod(tiny)
    time = np.linspace(0, 0.1, 11)
    found = []
    for k in range(2):
        angles = {"shoulder_flexion": 0.3 + 0.004 * k + 0 * time, "elbow_flexion": 0.7 + 0 * time}
        motion = tiny_model.write_motion(tiny.folder / f"still_{k}.mot", time, angles)
        trajectory = load_motion(model=tiny.model, coordinates=motion, final_time=0.0).trajectory
        skeleton = trajectory.skeleton
        assert skeleton is not None
        height = skeleton.body_mass_centers[0, :, 1]
        potential = tiny_model.GRAVITY * skeleton.body_masses @ height
        shoulder = skeleton.joint_axes[0, skeleton.joints.index("elbow"), 0]  # x of the upper body
        angle = np.arctan2(shoulder[1], shoulder[0])
        potential += 0.5 * 3.0 * (angle - 0.1) ** 2
        found.append((trajectory.coordinate_values[0, 0], potential, trajectory.generalized_forces[0, 0]))
    (q1, v1, m1), (q2, v2, m2) = found
    assert abs(q2 - q1) > 1e-4
    # the mean of two slopes differs from the secant by the third derivative times step squared / 12
    assert (v2 - v1) / (q2 - q1) == pytest.approx((m1 + m2) / 2, rel=1e-4)
