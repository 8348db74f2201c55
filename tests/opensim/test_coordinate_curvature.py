"""Second derivatives of path lengths, loads and passive forces, against closed forms and energies."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tiny_model
from tiny_model import Tiny, ask_opensim, write_motion

from scso_nlp import CoordinateStability, HessianStability, JointStability, NoPhysiology
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.examples import example_folder
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.methods import static_optimization
from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.setup_xml import read_analyze_setup
from scso_nlp.solution import Solution
from scso_nlp.solver import solve_framewise
from scso_nlp.stability.passive import LumbarJoint, lumbar_passive_stiffness
from scso_nlp.trajectory import CoordinateCurvature, MotionTrajectory

pytestmark = pytest.mark.opensim

SHOULDER, ELBOW = 0.3, 0.7
#: Step of second differences of lengths and energies [rad]: rounding 1e-10, truncation 1e-7 of the value.
STEP = 1e-3


def curvature_of(trajectory: MotionTrajectory) -> CoordinateCurvature:
    assert trajectory.curvature is not None
    return trajectory.curvature


def pose(tiny: Tiny, shoulder: float = SHOULDER, elbow: float = ELBOW, **changes: object) -> MotionTrajectory:
    """Load one still frame of the small case."""
    time = np.linspace(0, 0.1, 11)
    slide = tiny_model.SLIDE_PER_RADIAN * elbow
    angles = {"shoulder_flexion": shoulder, "elbow_flexion": elbow, "slide": slide}
    motion = write_motion(tiny.folder / "pose.mot", time, {k: np.array(v) for k, v in angles.items()})
    return load_motion(
        model=tiny.model, coordinates=motion, final_time=0.0, curvature_coordinates="all", **changes
    ).trajectory


def edit(tiny: Tiny, old: str, new: str) -> None:
    text = tiny.model.read_text()
    assert old in text
    tiny.model.write_text(text.replace(old, new))


def second_differences(
    folder: Path, model: Path, trajectory: MotionTrajectory, frame: int, step: float = STEP
) -> np.ndarray:
    """Differentiate OpenSim's own path lengths twice, shape (n_chosen, n_chosen, n_muscles) [m]."""
    chosen = [trajectory.coordinates.index(name) for name in curvature_of(trajectory).coordinates]
    pairs = [(i, j) for i in range(len(chosen)) for j in range(i + 1)]
    values = []
    for i, j in pairs:
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            shifted = trajectory.coordinate_values[frame].copy()
            shifted[chosen[i]] += a * step
            shifted[chosen[j]] += b * step
            values.append(shifted.tolist())
    lengths = ask_opensim(
        folder,
        kind="lengths",
        model=model,
        coordinates=trajectory.coordinates,
        muscles=trajectory.muscles,
        values=values,
    )["lengths"].reshape(len(pairs), 4, -1)
    result = np.zeros((len(chosen), len(chosen), len(trajectory.muscles)))
    for (i, j), (pp, pm, mp, mm) in zip(pairs, lengths, strict=True):
        result[i, j] = result[j, i] = (pp - pm - mp + mm) / (4 * step**2)
    return result


def test_curvature_is_the_second_difference_of_opensims_path_lengths(
    shared_data: Path, tmp_path: Path
) -> None:
    """Straight, via and moving points, knees that slide and roll on splines."""
    folder = shared_data / "gait10dof18musc"
    trajectory = load_motion(
        folder / "setup_static_optimization.xml", step_interval=30, curvature_coordinates="all"
    ).trajectory
    curvature = curvature_of(trajectory)
    assert set(curvature.coordinates) == {
        f"{x}_{s}" for x in ("hip_flexion", "knee_angle", "ankle_angle") for s in "rl"
    }
    assert not curvature.is_uncertain.any()
    frame = trajectory.n_frames // 2
    expected = second_differences(tmp_path, folder / "gait10dof18musc_simbody.osim", trajectory, frame, 1e-4)
    found = curvature.path_curvature[frame]
    # 1e-5 of the largest entry, which is about 0.07 m; the step is small for the joints' splines
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    assert curvature.asymmetry.max() < 1e-9, "moment arms without wraps are the gradient of a length"


def test_legs_that_are_moved_at_once_are_as_each_alone(shared_data: Path) -> None:
    """Wraps, couplers, loads on both feet: knees and ankles of both legs go two by two."""
    setup = shared_data / "walking3d" / "setup_static_optimization.xml"

    def curvature(*chosen: str) -> CoordinateCurvature:
        return curvature_of(
            load_motion(setup, final_time=0.55, processes=1, curvature_coordinates=chosen).trajectory
        )

    names = "knee_angle_r", "ankle_angle_r", "knee_angle_l", "ankle_angle_l"
    together = curvature(*names)
    for place in ([0, 1], [2, 3]):
        alone, pairs = curvature(*(names[k] for k in place)), (slice(None), *np.ix_(place, place))
        np.testing.assert_array_equal(together.path_curvature[pairs], alone.path_curvature)
        np.testing.assert_allclose(together.load_stiffness[pairs], alone.load_stiffness, atol=1e-8)
        others = pairs[0], np.array(place)[:, None], np.array([k for k in range(4) if k not in place])
        assert not together.path_curvature[others].any()
        assert not together.load_stiffness[others].any()
    assert np.abs(together.load_stiffness).max() > 100


def test_curvature_follows_a_coupler_that_is_not_linear(tiny: Tiny) -> None:
    edit(tiny, "<LinearFunction><coefficients>0.02 0</coefficients>\n      </LinearFunction>",
         "<PolynomialFunction><coefficients>0.05 0.02 0</coefficients></PolynomialFunction>")  # fmt: skip
    trajectory = pose(tiny, keep_coupled_speeds=False)
    expected = second_differences(tiny.folder, tiny.model, trajectory, 0)
    found = curvature_of(trajectory).path_curvature[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    through = trajectory.muscles.index("through_slider")
    straight = pose(Tiny(**{**vars(tiny), "model": _linear(tiny)}))
    difference = found[..., through] - curvature_of(straight).path_curvature[0, ..., through]
    assert np.abs(difference).max() > 0.01, "the case would not show a coupling taken as constant"


def _linear(tiny: Tiny) -> Path:
    path = tiny.folder / "linear.osim"
    path.write_text(tiny_model.model_text())
    return path


def test_a_point_that_a_body_has_twice_changes_nothing(tiny: Tiny) -> None:
    def curvature() -> np.ndarray:
        motion = load_motion(tiny.setup, step_interval=30, curvature_coordinates="all", processes=1)
        assert motion.trajectory.curvature is not None
        return motion.trajectory.curvature.path_curvature

    expected = curvature()
    text = tiny.model.read_text()
    start = text.index('<PathPoint name="flexor_1">')
    end = text.index("</PathPoint>", start) + len("</PathPoint>")
    tiny.model.write_text(text[:end] + text[start:end].replace("flexor_1", "again") + text[end:])
    np.testing.assert_allclose(curvature(), expected, atol=1e-12)


def test_a_muscle_around_a_cylinder_has_no_curvature(tiny: Tiny) -> None:
    trajectory = load_motion(
        tiny.setup, curvature_coordinates=("elbow_flexion", "shoulder_flexion")
    ).trajectory
    curvature = curvature_of(trajectory)
    assert curvature.coordinates == ("elbow_flexion", "shoulder_flexion")
    skeleton = trajectory.skeleton
    assert skeleton is not None
    m = trajectory.muscles.index("wrapped")
    touching = skeleton.path_point_moves[:, m].sum(axis=1) == 2
    assert touching.sum() > 20
    certain = touching & ~curvature.is_uncertain[:, m]
    assert certain.sum() > 20
    # a change of the moment arm by the tangent tolerance of 1e-10 m over a step of 2e-4 rad
    np.testing.assert_allclose(curvature.path_curvature[certain][..., m], 0, atol=1e-6)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_where_a_wrap_begins_the_clear_side_is_taken_and_marked(
    side: float, tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    """The length's second derivative steps from that of a straight line to zero."""

    def at(elbow: float) -> tuple[bool, float, bool]:
        trajectory = pose(tiny, elbow=elbow)
        m, skeleton = trajectory.muscles.index("wrapped"), trajectory.skeleton
        assert skeleton is not None
        j = trajectory.coordinates.index("elbow_flexion")
        curvature = curvature_of(trajectory)
        touches = bool(skeleton.path_point_moves[0, m].any())
        return touches, float(curvature.path_curvature[0, j, j, m]), bool(curvature.is_uncertain[0, m])

    free, touching = -0.6, 0.6
    assert not at(free)[0]
    assert at(touching)[0]
    for _ in range(17):
        middle = (free + touching) / 2
        free, touching = (free, middle) if at(middle)[0] else (middle, touching)
    step = side * 5e-5
    touches, curvature, is_uncertain = at(touching + step)
    assert is_uncertain
    assert "the curvature of paths is uncertain" in caplog.text
    assert "wrapped in 1" in caplog.text
    assert touches == (side > 0)
    straight = at(touching - 0.01)[1]
    assert abs(straight) > 0.01
    # one-sided: the other side of the step lies within the stencil
    assert curvature == pytest.approx(0.0 if touches else straight, abs=2e-3)


def test_a_point_that_jumps_in_is_not_taken_for_curvature(tiny: Tiny) -> None:
    point = """<PathPoint name="flexor_1"><socket_parent_frame>/bodyset/upper</socket_parent_frame>
        <location>0.03 -0.1 0.01</location></PathPoint>"""
    conditional = """<ConditionalPathPoint name="flexor_1">
        <socket_parent_frame>/bodyset/upper</socket_parent_frame><location>0.03 -0.1 0.01</location>
        <socket_coordinate>/jointset/elbow/elbow_flexion</socket_coordinate><range>0.5 2</range>
        </ConditionalPathPoint>"""
    steady = pose(tiny, elbow=0.50003)
    edit(tiny, point, conditional)
    jumping = pose(tiny, elbow=0.50003)
    m = jumping.muscles.index("flexor")
    np.testing.assert_allclose(
        curvature_of(jumping).path_curvature[0, ..., m],
        curvature_of(steady).path_curvature[0, ..., m],
        atol=1e-5,  # one-sided differences over 1e-4 and 1e-3 rad
    )
    assert curvature_of(jumping).is_uncertain[0, m]
    assert not curvature_of(steady).is_uncertain[0, m]


def test_kinks_of_a_moving_points_spline_are_spanned_and_marked(shared_data: Path, tmp_path: Path) -> None:
    """The splines of this knee's moving points have two knots 0.2 mrad apart at a straight knee."""
    folder = shared_data / "gait10dof18musc"
    model = folder / "gait10dof18musc_simbody.osim"
    names = load_motion(folder / "setup_static_optimization.xml", final_time=0.6).trajectory.coordinates
    time = np.linspace(0, 0.1, 11)

    def at(knee: float) -> MotionTrajectory:
        columns = {name: np.array(knee if name == "knee_angle_r" else 0.0) for name in names}
        motion = write_motion(tmp_path / "pose.mot", time, columns)
        return load_motion(
            model=model, coordinates=motion, final_time=0.0, curvature_coordinates="knee_angle_r"
        ).trajectory

    kinked, bent = at(1e-4), at(-0.05)
    marked = np.flatnonzero(curvature_of(kinked).is_uncertain[0])
    assert {kinked.muscles[m] for m in marked} == {"vasti_r", "rect_fem_r"}
    assert not curvature_of(bent).is_uncertain[0].any()
    # what is left is the size of its neighborhood; a step of 1e-4 would give 0.8 m
    assert np.abs(curvature_of(kinked).path_curvature[0]).max() < 0.2


def test_the_chosen_coordinates_are_checked(tiny: Tiny) -> None:
    with pytest.raises(NameMismatchError, match=r"unknown coordinate 'knee' \(available: shoulder"):
        load_motion(tiny.setup, curvature_coordinates=("knee",))
    with pytest.raises(DataError, match="names 'slide', which the model locks, prescribes or couples"):
        load_motion(tiny.setup, curvature_coordinates=("slide",))
    with pytest.raises(DataError, match="must be unique"):
        load_motion(tiny.setup, curvature_coordinates=("elbow_flexion", "elbow_flexion"))


def test_loads_stiffen_as_the_second_derivative_of_their_potential(tiny: Tiny) -> None:
    trajectory = pose(tiny, external_loads=tiny.loads)
    s, b, g, k = SHOULDER, SHOULDER + ELBOW, tiny_model.GRAVITY, tiny_model.SLIDE_PER_RADIAN
    length, x = tiny_model.UPPER_LENGTH, 0.05 + k * ELBOW
    upper = tiny_model.UPPER_MASS * g * tiny_model.UPPER_CENTER * np.cos(s) * np.array([[1, 0], [0, 0]])
    elbow = tiny_model.LOWER_MASS * g * length * np.cos(s) * np.array([[1, 0], [0, 0]])
    lower = tiny_model.LOWER_MASS * g * tiny_model.LOWER_CENTER * np.cos(b) * np.ones((2, 2))
    slider = 0.1 * g * np.array([[-x * np.sin(s) + 0.2 * np.cos(s), k * np.cos(s)], [k * np.cos(s), 0]])
    fx, fy = 3.0, -10.0
    hand = -(fx * np.array([-length * np.sin(s), 0]) + fy * np.array([length * np.cos(s), 0]))
    turning = -(fx * (-0.01 * np.cos(b) - 0.2 * np.sin(b)) + fy * (-0.01 * np.sin(b) + 0.2 * np.cos(b)))
    load = np.diag(hand) + turning * np.ones((2, 2))
    # truncation of the central difference: 2e-9 of a few N·m
    expected = upper + elbow + lower + slider + load
    np.testing.assert_allclose(curvature_of(trajectory).load_stiffness[0], expected, atol=1e-7)


def test_weights_stiffen_as_opensims_inverse_dynamics_changes(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "gait10dof18musc"
    model = folder / "gait10dof18musc_simbody.osim"
    setup = folder / "setup_static_optimization.xml"
    without_loads = replace(read_analyze_setup(setup).motion, external_loads=None)
    trajectory = load_motion(without_loads, final_time=0.6, curvature_coordinates="all").trajectory
    curvature = curvature_of(trajectory)
    rows = [trajectory.coordinates.index(name) for name in curvature.coordinates]
    values = []
    for row in rows:
        for sign in (-1, 1):
            shifted = trajectory.coordinate_values[0].copy()
            shifted[row] += sign * STEP
            values.append(shifted.tolist())
    holding = ask_opensim(
        tmp_path, kind="weights", model=model, coordinates=trajectory.coordinates, values=values
    )["weights"]
    # what holds the model is minus what gravity does, so its change is the stiffness
    expected = (holding[1::2] - holding[::2])[:, rows] / (2 * STEP)
    # the wider step's truncation: 1e-6 / 6 of some 100 N·m
    np.testing.assert_allclose(curvature.load_stiffness[0], expected, atol=5e-5)


def test_springs_bushings_and_limits_stiffen_by_their_own_numbers(tiny: Tiny) -> None:
    more = """
    <SpringGeneralizedForce name="sliding_spring"><coordinate>slide</coordinate><stiffness>5000</stiffness>
      <rest_length>0.004</rest_length><viscosity>9</viscosity></SpringGeneralizedForce>
    <CoordinateLimitForce name="stop"><coordinate>elbow_flexion</coordinate>
      <upper_stiffness>0.5</upper_stiffness>
      <upper_limit>20</upper_limit><lower_stiffness>1</lower_stiffness><lower_limit>-90</lower_limit>
      <damping>0.1</damping><transition>2</transition></CoordinateLimitForce>
    <BushingForce name="disc"><socket_frame1>/jointset/elbow/from</socket_frame1>
      <socket_frame2>/jointset/elbow/to</socket_frame2><rotational_stiffness>1 2 7</rotational_stiffness>
      <translational_stiffness>100 100 100</translational_stiffness>
      <rotational_damping>1 1 1</rotational_damping><translational_damping>1 1 1</translational_damping>
      </BushingForce>
    """
    edit(tiny, '<SpringGeneralizedForce name="ligament">', more + '<SpringGeneralizedForce name="ligament">')
    edit(tiny, "<LinearFunction><coefficients>0.02 0</coefficients>\n      </LinearFunction>",
         "<PolynomialFunction><coefficients>0.05 0.02 0</coefficients></PolynomialFunction>")  # fmt: skip
    trajectory = pose(tiny, external_loads=tiny.loads, keep_coupled_speeds=False)
    slide, slope, bend = 0.05 * ELBOW**2 + 0.02 * ELBOW, 0.1 * ELBOW + 0.02, 0.1
    at_slider = 5000 * (slope**2 + (slide - 0.004) * bend)
    expected = np.diag([3.0, at_slider + 7.0 + 0.5 * 180 / np.pi])
    # truncation of the central difference: 2e-9 of some 100 N·m
    np.testing.assert_allclose(curvature_of(trajectory).passive_stiffness[0], expected, atol=1e-6)


def test_a_closed_loop_gives_the_change_of_its_reduced_moment_arms(tiny: Tiny) -> None:
    rod = """<ConstantDistanceConstraint name="rod"><socket_body_1>/ground</socket_body_1>
      <socket_body_2>/bodyset/lower</socket_body_2><location_body_1>0.3 1.1 0</location_body_1>
      <location_body_2>0 -0.2 0</location_body_2><constant_distance>0.6</constant_distance>
      </ConstantDistanceConstraint>"""
    edit(tiny, "<CoordinateCouplerConstraint", rod + "<CoordinateCouplerConstraint")
    one, other = (pose(tiny, shoulder=0.3 + 0.004 * k, keep_coupled_speeds=False) for k in range(2))
    dq = other.coordinate_values[0, 0] - one.coordinate_values[0, 0]
    assert abs(dq) > 1e-4
    mean = -(curvature_of(one).path_curvature + curvature_of(other).path_curvature)[0, 0, 0] / 2
    secant = (other.moment_arms - one.moment_arms)[0, 0] / dq
    # the mean of two slopes differs from the secant by a third derivative times step squared / 12
    np.testing.assert_allclose(mean, secant, rtol=0, atol=1e-4 * np.abs(secant).max())


@pytest.mark.parametrize("example", ["elbow", "spine-load-height", "spine-postures"])
def test_along_hinges_straight_paths_are_as_potvin_and_brown_have_them(example: str) -> None:
    motion = load_motion(example_folder(example) / "setup.xml", curvature_coordinates="all")
    problem = static_optimization(motion)
    skeleton = motion.trajectory.skeleton
    assert skeleton is not None
    by_axis = JointStability(joints=skeleton.joints, axes=("x", "y", "z")).stability_rows(problem.motion)
    by_coordinate = CoordinateStability().stability_rows(problem.motion)
    axis_of = {"flexion": "z", "abduction_right": "x", "twist_left": "y"}
    rows = []
    for name in by_coordinate.rows:
        joint = next(j for j in skeleton.joints if name.startswith(j))
        letter = axis_of.get(name.removeprefix(joint).strip("_"), "z")
        rows.append(by_axis.rows.index(f"{joint}_{letter}"))
    scale = np.abs(by_axis.curvature).max()
    # relative to the largest entry: the central difference's truncation is 1e-10
    np.testing.assert_allclose(by_coordinate.curvature, by_axis.curvature[:, rows], rtol=0, atol=1e-8 * scale)
    np.testing.assert_allclose(
        np.abs(by_coordinate.moment_arms), np.abs(by_axis.moment_arms[:, rows]), atol=1e-14
    )
    load = max(np.abs(by_axis.external_work).max(), 1.0)
    np.testing.assert_allclose(
        by_coordinate.external_work, by_axis.external_work[:, rows], rtol=0, atol=1e-8 * load
    )


@pytest.mark.parametrize("q", [3.0, 5.0])
def test_where_every_axis_is_stable_some_combined_turn_of_the_spine_is_not(q: float) -> None:
    """The rule per axis is necessary, not sufficient: 18 tasks of two examples."""
    lowest = []
    for example in ("spine-load-height", "spine-postures"):
        motion = load_motion(example_folder(example) / "setup.xml", curvature_coordinates="all")
        plain = static_optimization(motion, muscle_model=NoPhysiology())
        rule = CoordinateStability(q=q)
        full = HessianStability(q=q)
        solution = solve_framewise(replace(plain, constraints=(*plain.constraints, rule)))
        stiffness = solution.quantities["CoordinateStability.muscle_stiffness"]
        hessian = full.terms(plain.motion).hessian(solution.tendon_force, stiffness)
        # the solver keeps rows to 1e-8 of their scale of 10 N·m/rad
        assert np.einsum("kii->ki", hessian).min() > -1e-5
        lowest += np.linalg.eigvalsh(hessian)[:, 0].tolist()
    assert len(lowest) == 18
    assert max(lowest) < 0
    # an independent solver's number of the same reconstruction
    assert min(lowest) == pytest.approx(-56, abs=1)


def test_published_passive_stiffness_makes_the_whole_hessian_of_the_spine_affordable() -> None:
    """Muscles alone cannot keep two of the eight postures stable; with passive tissue all are cheap."""
    passive = lumbar_passive_stiffness(
        *(
            LumbarJoint(
                levels=levels,
                rows={f"{joint}_flexion": "flexion", f"{joint}_abduction_right": "lateral"}
                | {f"{joint}_twist_left": "axial"},
            )
            for joint, levels in (("lumbar_pelvis", 3), ("thorax_lumbar", 2))
        )
    )
    motion = load_motion(example_folder("spine-postures") / "setup.xml", curvature_coordinates="all")
    plain = static_optimization(motion, muscle_model=NoPhysiology())

    def solve(*terms: StabilityConstraint) -> Solution:
        problem = replace(plain, constraints=(*plain.constraints, *terms))
        return solve_framewise(problem, on_failure="return")

    alone, helped = solve(HessianStability()), solve(HessianStability(passive_stiffness=passive))
    per_axis, free = solve(CoordinateStability()), solve()
    assert alone.is_solved.sum() == 6
    assert {s.constraint for s in alone.shortfalls} == {"HessianStability"}
    assert helped.is_solved.all()
    kept = alone.is_solved
    cost = [float((run.activation[kept] ** 2).sum()) for run in (free, per_axis, alone)]
    assert cost[0] < cost[1] < cost[2]
    assert cost[2] > 5 * cost[1]
    assert free.objective <= helped.objective < per_axis.objective


def test_walking_moment_arms_around_wraps_are_hardly_a_gradient(shared_data: Path) -> None:
    """OpenSim's wrapping: dr_i/dq_j and dr_j/dq_i differ, by little; measured here, reported to the user."""
    trajectory = load_motion(
        shared_data / "walking3d" / "setup_static_optimization.xml",
        step_interval=200,
        curvature_coordinates=(
            "hip_flexion_r",
            "hip_adduction_r",
            "hip_rotation_r",
            "knee_angle_r",
            "ankle_angle_r",
        ),
    ).trajectory
    curvature = curvature_of(trajectory)
    skeleton = trajectory.skeleton
    assert skeleton is not None
    wraps = skeleton.path_point_moves.any(axis=(0, 2))
    # without wraps there is rounding only: 1e-16 m over a step of 1e-4 rad
    assert curvature.asymmetry[:, ~wraps].max() < 1e-8
    assert 1e-6 < np.median(curvature.asymmetry[curvature.asymmetry > 1e-8]) < 1e-3
    assert 1e-3 < curvature.asymmetry.max() < 1e-2
