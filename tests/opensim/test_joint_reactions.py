"""Joint reactions against closed forms and against OpenSim's own JointReaction."""

from pathlib import Path

import numpy as np
import pytest
import tiny_model
from tiny_model import Tiny, ask_opensim

from problems.benchmarks.reactions_against_opensim import beside_opensim
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.io.storage import read_storage
from scso_nlp.opensim.engine import load_motion
from scso_nlp.trajectory import MotionTrajectory

pytestmark = pytest.mark.opensim

#: Of a joint's largest load, or 1 N or N·m: OpenSim solves for the accelerations that forces were solved for.
SAME = 1e-8


def _balanced(trajectory: MotionTrajectory) -> tuple[np.ndarray, np.ndarray]:
    """Find tendon forces and controls that make the motion, the smallest, of any sign."""
    matrix = np.concatenate([trajectory.moment_arms, trajectory.actuator_generalized_forces], axis=2)
    found = (np.linalg.pinv(matrix) @ trajectory.generalized_forces[..., None])[..., 0]
    tendon_force, control = np.split(found, [len(trajectory.muscles)], axis=1)
    return tendon_force, control


def _assert_as_opensim(setup: Path, step: int) -> None:
    """Hold reactions against OpenSim's at the same forces, on either body in every frame."""
    motion = load_motion(setup, step_interval=step, joint_reactions="all")
    found = beside_opensim(setup, motion, *_balanced(motion.trajectory), step)
    assert found.largest_force > 1.0
    assert max(found.force, found.moment, found.point) <= SAME, found


def test_reactions_equal_opensims(tiny: Tiny) -> None:
    """With a coupled slider, a point actuator, a spring, a load and a wrapping muscle."""
    _assert_as_opensim(tiny.setup, 10)


def test_a_constraint_that_closes_a_loop_carries_its_part_as_in_opensim(tiny: Tiny) -> None:
    tiny_model.add_a_rocker(tiny, by_joints=False)
    still = read_storage(tiny.folder / "middle.mot")
    trajectory = load_motion(
        model=tiny.model, coordinates=still.source, final_time=0.0, joint_reactions="all"
    ).trajectory
    reactions, forces = trajectory.joint_reactions, _balanced(trajectory)
    assert reactions is not None
    assert len(trajectory.coordinates) == 1
    answer = ask_opensim(
        tiny.folder,
        kind="carried",
        model=tiny.model,
        coordinates=still.labels,
        values=still.values[:1].tolist(),
        joints=reactions.joints,
        forces=dict(zip(trajectory.muscles, forces[0][0].tolist(), strict=True)),
    )
    found = reactions.at(*forces)
    ours = np.concatenate([found.forces, found.moments], axis=2)
    np.testing.assert_allclose(ours, answer["reactions"], atol=1e-8)


def test_reactions_of_a_walking_model_equal_opensims(shared_data: Path) -> None:
    _assert_as_opensim(shared_data / "gait10dof18musc" / "setup_static_optimization.xml", 25)


def test_a_pendulum_hangs_on_its_joints(tiny: Tiny) -> None:
    """Weights and the load stand on the joints; a muscle presses bodies together along its line."""
    trajectory = load_motion(
        model=tiny.model, coordinates=tiny.still, external_loads=tiny.loads, joint_reactions="all"
    ).trajectory
    reactions, skeleton = trajectory.joint_reactions, trajectory.skeleton
    assert reactions is not None
    assert skeleton is not None
    assert reactions.joints == ("shoulder", "elbow", "sliding")
    assert reactions.parents == ("ground", "upper", "upper")
    assert reactions.children == ("upper", "lower", "slider")
    masses = np.array([tiny_model.UPPER_MASS, tiny_model.LOWER_MASS, 0.1])
    assert reactions.body_weight == pytest.approx(masses.sum() * tiny_model.GRAVITY, rel=1e-15)
    load, weights = skeleton.load_forces[0, 0], masses * tiny_model.GRAVITY
    up = np.array([0.0, 1.0, 0.0])
    forces = [weights.sum() * up - load, weights[1] * up - load, weights[2] * up]
    at = reactions.at(np.zeros((trajectory.n_frames, 3)), np.zeros((trajectory.n_frames, 0)))
    np.testing.assert_allclose(at.forces[0], forces, atol=1e-9)
    elbow, hand, center = (
        skeleton.joint_centers[0, 1],
        skeleton.load_points[0, 0],
        skeleton.body_mass_centers[0, 2],
    )
    moment = -np.cross(hand - elbow, load) + np.cross(center - elbow, weights[1] * up)
    np.testing.assert_allclose(at.moments[0, 1], moment, atol=1e-9)
    np.testing.assert_allclose(at.points[0], skeleton.joint_centers[0], atol=1e-12)

    m = trajectory.muscles.index("flexor")
    upper, lower = skeleton.path_points[0, m, 1:3]
    line = (lower - upper) / np.linalg.norm(lower - upper)
    np.testing.assert_allclose(reactions.per_tendon_force[0, 1, :3, m], line, atol=1e-12)
    about = np.cross(lower - elbow, line)
    np.testing.assert_allclose(reactions.per_tendon_force[0, 1, 3:, m], about, atol=1e-12)


def test_a_joint_written_towards_ground_carries_the_same(tiny: Tiny) -> None:
    """OpenSim gives such joints what the mobilizer of their child carries, which is another joint's."""
    joints = ("shoulder", "elbow", "sliding")
    tiny_model.turn_round(tiny, ())
    usual = load_motion(tiny.setup, step_interval=10, joint_reactions="all").trajectory
    tiny_model.turn_round(tiny, joints)
    other = load_motion(tiny.setup, step_interval=10, joint_reactions="all").trajectory
    assert usual.joint_reactions is not None
    assert other.joint_reactions is not None
    assert other.joint_reactions.joints == joints
    forces = _balanced(usual)
    one = usual.joint_reactions.at(*forces, on="child", frame="parent")
    same = other.joint_reactions.at(*forces, on="parent", frame="child")
    assert one.bodies == same.bodies
    np.testing.assert_allclose(same.columns, one.columns, atol=1e-8)


def test_chosen_joints_are_those_of_all(tiny: Tiny) -> None:
    every = load_motion(tiny.setup, step_interval=20, joint_reactions="all").trajectory.joint_reactions
    elbow = load_motion(tiny.setup, step_interval=20, joint_reactions="elbow").trajectory.joint_reactions
    assert every is not None
    assert elbow is not None
    assert elbow.joints == ("elbow",)
    np.testing.assert_array_equal(elbow.per_tendon_force, every.of_joints(["elbow"]).per_tendon_force)


def test_unknown_joints_are_named(tiny: Tiny) -> None:
    with pytest.raises(NameMismatchError, match=r"elbo.*elbow"):
        load_motion(tiny.setup, joint_reactions=("elbo",))


def test_a_loop_of_joints_is_refused(tiny: Tiny) -> None:
    tiny_model.add_a_rocker(tiny)
    with pytest.raises(DataError, match=r"the joint 'closing' closes a loop.*constraint"):
        load_motion(
            model=tiny.model, coordinates=tiny.folder / "middle.mot", final_time=0.0, joint_reactions="all"
        )
