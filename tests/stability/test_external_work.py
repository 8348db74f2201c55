"""External work against closed forms and finite differences of potential energy."""

from dataclasses import replace

import numpy as np
import pytest

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.stability import external_work, select_rows


def joint_and_axis(row):
    joint, letter = row.rsplit("_", 1)
    return joint, "xyz".index(letter)


LINE = [[0.0, -0.1, 0.0], [0.0, 0.2, 0.0]]


def test_a_weight_above_the_joint_takes_its_height_times_its_weight(one_muscle):
    # The printed case: m g C_y about both horizontal axes, nothing about the vertical.
    centers = np.array([[[0.0, 0.0, 0.0], [0.3, 0.2, -0.1]]])
    motion = one_muscle(LINE, body_masses=[0.0, 52.0], body_mass_centers=centers)
    weight = 52.0 * 9.81
    np.testing.assert_allclose(
        external_work(motion.skeleton), [[0.2 * weight, 0.0, 0.2 * weight]], atol=1e-13
    )


def test_a_hanging_weight_adds_stability(one_muscle):
    centers = np.array([[[0.0, 0.0, 0.0], [0.0, -0.5, 0.0]]])
    motion = one_muscle(LINE, body_masses=[0.0, 2.0], body_mass_centers=centers)
    assert external_work(motion.skeleton, axes="z")[0, 0] == pytest.approx(-9.81)


def test_a_pull_along_an_axis_does_nothing_about_that_axis(one_muscle):
    motion = one_muscle(
        LINE,
        load_names=("rope",),
        load_bodies=[1],
        load_forces=np.array([[[40.0, 0.0, 0.0]]]),
        load_points=np.array([[[0.5, 0.3, 0.2]]]),
        load_torques=np.zeros((1, 1, 3)),
    )
    # Pulling outward at 0.5 m straightens the joint about the other two axes: EW = -f C_x.
    np.testing.assert_allclose(external_work(motion.skeleton), [[0.0, -20.0, -20.0]], atol=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_weights_and_loads_equal_second_differences_of_their_potential_energy(turning, seed):
    skeleton = turning.random_skeleton(np.random.default_rng(seed), n_muscles=1, n_frames=3, n_loads=5)
    rows, _, _ = select_rows(skeleton, None, ("x", "y", "z"))
    weights = skeleton.body_masses[:, None] * skeleton.gravity
    expected = np.zeros((3, len(rows)))
    for frame in range(3):
        for index, row in enumerate(rows):
            joint, axis = joint_and_axis(row)

            def energy(angle, frame=frame, joint=joint, axis=axis):
                _, centers, points = turning.turned(skeleton, frame, joint, axis, angle)
                return -(weights * centers).sum() - (skeleton.load_forces[frame] * points).sum()

            expected[frame, index] = -turning.second_difference(energy)
    # Energies of 1e2 J times 1e-16 over (1e-3 rad)² leave 1e-8 N m/rad of round-off.
    np.testing.assert_allclose(external_work(skeleton), expected, rtol=1e-5, atol=1e-6)


def test_free_torques_do_constant_work_per_turn_and_so_leave_the_diagonal_alone(turning):
    # d(work)/d(angle) = T . w with w the angular velocity of a unit turn, read off the rotation matrices.
    rng = np.random.default_rng(8)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    torque = rng.normal(size=3)

    def moment(angle):
        step = 1e-5
        before, after = turning.rotation(axis, angle - step), turning.rotation(axis, angle + step)
        spin = (after - before) / (2 * step) @ turning.rotation(axis, angle).T
        return torque @ np.array([spin[2, 1], spin[0, 2], spin[1, 0]])

    assert moment(0.0) == pytest.approx(torque @ axis, rel=1e-9)
    assert turning.first_difference(moment) == pytest.approx(0.0, abs=1e-6)
    skeleton = turning.random_skeleton(rng, n_muscles=1)
    doubled = replace(skeleton, load_torques=2 * skeleton.load_torques)
    np.testing.assert_array_equal(external_work(skeleton), external_work(doubled))


def test_loads_on_the_base_side_do_nothing(turning):
    skeleton = turning.random_skeleton(np.random.default_rng(2), n_muscles=1)
    base = replace(skeleton, load_bodies=np.zeros(4, dtype=int))
    without = replace(skeleton, load_forces=np.zeros((1, 4, 3)))
    np.testing.assert_allclose(external_work(base), external_work(without), rtol=1e-12)


def test_rows_follow_the_order_asked_for(turning):
    skeleton = turning.random_skeleton(np.random.default_rng(4), n_muscles=1)
    everything = external_work(skeleton)
    chosen = external_work(skeleton, joints=("knee", "root"), axes=("z", "x"))
    np.testing.assert_array_equal(chosen, everything[:, [14, 12, 2, 0]])


def test_an_unknown_joint_is_refused(turning):
    skeleton = turning.random_skeleton(np.random.default_rng(4), n_muscles=1)
    with pytest.raises(NameMismatchError, match="closest: knee"):
        external_work(skeleton, joints=("kne",))
