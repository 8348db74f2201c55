"""Path geometry of stability rows, against closed forms and independent finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scso_nlp.exceptions import DataError, NameMismatchError, ProblemError
from scso_nlp.stability import geometric_stability, joint_stability, potvin_brown

# Relative tolerance of the finite-difference comparisons, the promise of this module. The absolute part
# covers entries that pass near zero: round-off of a second difference is 1e-16 m / (1e-3 rad)².
RTOL, ATOL = 1e-5, 5e-9


def joint_and_axis(row):
    joint, letter = row.rsplit("_", 1)
    return joint, "xyz".index(letter)


def differences(turning, skeleton, rows):
    """Second and negative first differences of path length for all rows: (n_frames, n_rows, n_muscles)."""
    curvature, arms = [], []
    for frame in range(skeleton.path_points.shape[0]):
        bodies = skeleton.path_point_bodies[frame][None]
        curvature.append([])
        arms.append([])
        for row in rows:
            joint, axis = joint_and_axis(row)

            def length(angle, frame=frame, bodies=bodies, joint=joint, axis=axis):
                points, _, _ = turning.turned(skeleton, frame, joint, axis, angle)
                return turning.path_length(points[None], bodies)[0]

            curvature[-1].append(turning.second_difference(length))
            arms[-1].append(-turning.first_difference(length))
    return np.array(curvature), np.array(arms)


def test_two_thousand_random_paths_equal_finite_differences_about_every_axis(turning):
    skeleton = turning.random_skeleton(np.random.default_rng(11), n_muscles=2000)
    rows = potvin_brown(turning.trajectory_of(skeleton))
    curvature, arms = differences(turning, skeleton, rows.rows)
    np.testing.assert_allclose(rows.curvature, curvature, rtol=RTOL, atol=ATOL)
    np.testing.assert_allclose(rows.moment_arms, arms, rtol=RTOL, atol=ATOL)
    # The sample must hold what the comparison is for: none, one and several crossings of a joint.
    distal = np.isin(skeleton.path_point_bodies[0], (2, 3, 4, 5))
    present = skeleton.path_point_bodies[0] >= 0
    crossings = ((distal[:, 1:] != distal[:, :-1]) & present[:, 1:]).sum(axis=1)
    assert {0, 1, 2, 3, 4} == set(crossings.tolist())


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1))
def test_random_paths_in_several_frames_equal_finite_differences(turning, seed):
    skeleton = turning.random_skeleton(np.random.default_rng(seed), n_muscles=6, n_frames=2)
    rows = potvin_brown(turning.trajectory_of(skeleton), joints=("hip", "lower"), axes=("z", "x"))
    assert rows.rows == ("hip_z", "hip_x", "lower_z", "lower_x")
    curvature, arms = differences(turning, skeleton, rows.rows)
    np.testing.assert_allclose(rows.curvature, curvature, rtol=RTOL, atol=ATOL)
    np.testing.assert_allclose(rows.moment_arms, arms, rtol=RTOL, atol=ATOL)


def test_joint_stability_is_the_second_difference_of_the_potential_energy(turning):
    rng = np.random.default_rng(5)
    skeleton = turning.random_skeleton(rng, n_muscles=40)
    trajectory = turning.trajectory_of(skeleton)
    rows = potvin_brown(trajectory)
    force, q = rng.uniform(10, 900, 40), rng.uniform(0.5, 40, 40)
    rest = trajectory.muscle_tendon_length[0]
    stiffness = q * force / rest
    weights = skeleton.body_masses[:, None] * skeleton.gravity
    expected = []
    for row in rows.rows:
        joint, axis = joint_and_axis(row)

        def energy(angle, joint=joint, axis=axis):
            points, mass_centers, load_points = turning.turned(skeleton, 0, joint, axis, angle)
            stretch = turning.path_length(points[None], skeleton.path_point_bodies)[0] - rest
            muscles = (force * stretch + 0.5 * stiffness * stretch**2).sum()
            return muscles - (weights * mass_centers).sum() - (skeleton.load_forces[0] * load_points).sum()

        expected.append(turning.second_difference(energy))
    # Energies of 1e3 J times 1e-16 over (1e-3 rad)² leave 1e-6 N m/rad of round-off.
    np.testing.assert_allclose(joint_stability(rows, force[None], q)[0], expected, rtol=RTOL, atol=1e-5)


def test_a_vertical_muscle_has_the_numbers_worked_out_by_hand(one_muscle):
    # A = (.05, -.1, .02) on ground, B = (.05, .2, .02) on the trunk, 0.3 m long and vertical. Leaning to the
    # right (+x turns y toward z) shortens it by its arm .02; turning y away from x (+z) lengthens it by .05;
    # turning about the vertical does nothing at first order.
    rows = potvin_brown(one_muscle([[0.05, -0.1, 0.02], [0.05, 0.2, 0.02]]))
    np.testing.assert_allclose(rows.moment_arms[0, :, 0], [0.02, 0.0, -0.05], atol=1e-15)
    # A.B in the plane of the turn: x -.02 + .0004, y .0025 + .0004, z .0025 - .02; minus r², over 0.3.
    hand = np.array([-0.0196 - 0.0004, 0.0029, -0.0175 - 0.0025]) / 0.3
    np.testing.assert_allclose(rows.curvature[0, :, 0], hand, rtol=1e-12)
    gs = geometric_stability(rows, 6.0)[0, :, 0]
    np.testing.assert_allclose(gs, hand + 6.0 * np.array([0.0004, 0.0, 0.0025]) / 0.3, rtol=1e-12)


def test_two_symmetric_antagonists_need_the_forces_of_the_closed_form(one_muscle):
    # r = .05, A.B = 0, l = L = .2, q = 5: GS = (q - 1) r²/l = .05, so 30 N m/rad take 600 N in all.
    x, y = np.sqrt(0.02 + np.sqrt(0.0003)), np.sqrt(0.02 - np.sqrt(0.0003))
    front = potvin_brown(one_muscle([[x, 0, 0], [0, y, 0]]), axes=("z",))
    back = potvin_brown(one_muscle([[-x, 0, 0], [0, y, 0]]), axes=("z",))
    np.testing.assert_allclose(front.moment_arms, -0.05, rtol=1e-12)
    np.testing.assert_allclose(back.moment_arms, 0.05, rtol=1e-12)
    np.testing.assert_allclose(geometric_stability(front, 5.0), 0.05, rtol=1e-12)
    np.testing.assert_allclose(joint_stability(front, [[350.0]], 5) + joint_stability(back, [[250.0]], 5), 30)


def test_mirrored_muscles_share_curvature_and_swap_the_sign_of_their_arms(one_muscle):
    mirror = np.array([1.0, 1.0, -1.0])
    points = np.array([[0.04, -0.1, 0.03], [-0.02, 0.05, 0.09], [0.06, 0.2, 0.05]])
    right, left = potvin_brown(one_muscle(points)), potvin_brown(one_muscle(points * mirror))
    np.testing.assert_allclose(right.curvature, left.curvature, rtol=1e-12)
    np.testing.assert_allclose(right.moment_arms[0, :2], -left.moment_arms[0, :2], rtol=1e-12)
    np.testing.assert_allclose(right.moment_arms[0, 2], left.moment_arms[0, 2], rtol=1e-12)


def test_the_order_of_the_points_does_not_matter(one_muscle):
    points = [[0.05, -0.1, 0.02], [0.07, 0.2, 0.01]]
    up, down = potvin_brown(one_muscle(points)), potvin_brown(one_muscle(points[::-1], bodies=[1, 0]))
    np.testing.assert_array_equal(up.curvature, down.curvature)
    np.testing.assert_array_equal(up.moment_arms, down.moment_arms)


def test_via_points_change_the_full_length_but_not_the_crossing_segment(one_muscle):
    plain = potvin_brown(one_muscle([[0.05, -0.1, 0.02], [0.05, 0.2, 0.02]]))
    via = potvin_brown(one_muscle([[0.3, -0.3, 0], [0.05, -0.1, 0.02], [0.05, 0.2, 0.02]]))
    np.testing.assert_array_equal(plain.curvature, via.curvature)
    assert via.path_length[0, 0] == pytest.approx(0.3 + np.hypot(np.hypot(0.25, 0.2), 0.02))
    # q r²/L uses the full length.
    stiffness_part = geometric_stability(via, 1.0) - via.curvature
    np.testing.assert_allclose(stiffness_part, via.moment_arms**2 / via.path_length[0, 0])


def test_a_muscle_that_does_not_cross_has_zeros(one_muscle):
    for bodies in ([0, 0], [1, 1]):
        rows = potvin_brown(one_muscle([[0.05, -0.1, 0.02], [0.05, 0.2, 0.02]], bodies=bodies))
        assert not rows.curvature.any()
        assert not rows.moment_arms.any()


def test_a_muscle_along_the_axis_has_no_arm_about_it(one_muscle):
    rows = potvin_brown(one_muscle([[0, -0.1, 0], [0, 0.2, 0]]))
    np.testing.assert_array_equal(rows.moment_arms, np.zeros((1, 3, 1)))
    assert rows.curvature[0, 1, 0] == 0.0


SLIDING = {"points": [[0.05, -0.1, 0], [0.06, 0.05, 0], [0.05, 0.2, 0]], "moves": [False, True, False]}


def test_a_sliding_point_at_the_crossing_is_refused_by_name(one_muscle):
    motion = one_muscle(**SLIDING, bodies=[0, 1, 1])
    with pytest.raises(DataError, match=r"muscle_0 crosses joint 'waist' .*moving_paths='frozen'"):
        potvin_brown(motion)


def test_a_sliding_point_away_from_the_crossing_is_no_obstacle(one_muscle):
    motion = one_muscle([[0, -0.2, 0], [0.06, -0.1, 0], [0.05, 0.1, 0.0]], moves=[True, False, False])
    assert potvin_brown(motion).notes == ()


def test_frozen_paths_use_the_straight_formula_and_say_so(one_muscle):
    frozen = potvin_brown(one_muscle(**SLIDING, bodies=[0, 1, 1]), moving_paths="frozen")
    fixed = potvin_brown(one_muscle(SLIDING["points"], bodies=[0, 1, 1]))
    np.testing.assert_array_equal(frozen.curvature, fixed.curvature)
    assert len(frozen.notes) == 1
    assert "muscle_0" in frozen.notes[0]


def virtual(one_muscle, rows, arms, curvature, **path):
    shape = (1, len(rows), 1)
    return one_muscle(
        **path,
        virtual_rows=rows,
        virtual_moment_arms=np.reshape(arms, shape),
        virtual_curvature=np.reshape(curvature, shape),
    )


def test_exact_paths_take_the_virtual_derivatives_of_their_own_row(one_muscle):
    rows = ("waist_x", "waist_y", "waist_z")
    motion = virtual(one_muscle, rows, [0.01, 0.02, 0.03], [-0.4, 0.5, 0.6], **SLIDING, bodies=[0, 1, 1])
    chosen = potvin_brown(motion, axes=("z", "y"))
    np.testing.assert_array_equal(chosen.moment_arms[0, :, 0], [0.03, 0.02])
    np.testing.assert_array_equal(chosen.curvature[0, :, 0], [0.6, 0.5])
    assert chosen.notes == ()


def test_virtual_derivatives_that_are_not_a_number_are_refused(one_muscle):
    motion = virtual(one_muscle, ("waist_x",), [0.01], [np.nan], **SLIDING, bodies=[0, 1, 1])
    with pytest.raises(DataError, match=r"'waist'.*about axis x; load the motion with this constraint"):
        potvin_brown(motion, axes=("x",))


def test_virtual_derivatives_do_not_replace_an_exact_straight_path(one_muscle):
    straight = {"points": [[0.05, -0.1, 0.02], [0.05, 0.2, 0.02]]}
    motion = virtual(one_muscle, ("waist_z",), [9.0], [9.0], **straight)
    np.testing.assert_allclose(potvin_brown(motion, axes="z").moment_arms, -0.05)


@pytest.mark.parametrize("moving_paths", ["exact", "frozen"])
def test_a_path_without_points_is_never_taken_as_not_crossing(one_muscle, moving_paths):
    motion = one_muscle([[0, 0, 0], [0, 0, 0]], bodies=[-1, -1])
    motion = replace(motion, muscle_tendon_length=np.array([[0.3]]))
    with pytest.raises(DataError, match="muscle_0 has no path points"):
        potvin_brown(motion, moving_paths=moving_paths)
    path = {"points": [[0, 0, 0], [0, 0, 0]], "bodies": [-1, -1]}
    known = virtual(one_muscle, ("waist_z",), [0.04], [0.2], **path)
    known = replace(known, muscle_tendon_length=np.array([[0.3]]))
    assert potvin_brown(known, axes="z", moving_paths=moving_paths).moment_arms[0, 0, 0] == 0.04


def test_misspelt_names_are_refused_with_a_suggestion(one_muscle):
    motion = one_muscle([[0.05, -0.1, 0.02], [0.05, 0.2, 0.02]])
    with pytest.raises(NameMismatchError, match=r"unknown joint 'wast' \(closest: waist\)"):
        potvin_brown(motion, joints=("wast",))
    with pytest.raises(NameMismatchError, match=r"unknown axis 'w' \(available: x, y, z\)"):
        potvin_brown(motion, axes=("w",))
    with pytest.raises(DataError, match="found twice: x"):
        potvin_brown(motion, axes=("x", "x"))
    with pytest.raises(ProblemError, match="'exact' or 'frozen'"):
        potvin_brown(motion, moving_paths="maybe")  # type: ignore[arg-type]


def test_one_bare_name_is_one_name(one_muscle):
    assert potvin_brown(one_muscle([[0, -0.1, 0], [0, 0.2, 0]]), joints="waist", axes="z").rows == (
        "waist_z",
    )


def test_a_motion_without_skeleton_is_refused(one_muscle):
    motion = replace(one_muscle([[0, -0.1, 0], [0, 0.2, 0]]), skeleton=None)
    with pytest.raises(DataError, match="has no skeleton"):
        potvin_brown(motion)


def test_a_crossing_segment_without_length_is_refused(one_muscle):
    with pytest.raises(DataError, match="'muscle_0' crosses joint 'waist' in a segment of 0 m"):
        potvin_brown(one_muscle([[0, -0.1, 0], [0, 0.2, 0], [0, 0.2, 0]], bodies=[0, 0, 1]))


def test_an_axis_that_is_not_of_unit_length_is_refused(one_muscle):
    motion = one_muscle([[0, -0.1, 0], [0, 0.2, 0]], joint_axes=np.eye(3)[None, None] * [1.0, 1.0, 2.0])
    with pytest.raises(DataError, match="joint_axes of waist_z has length 2 at frame 0"):
        potvin_brown(motion)
