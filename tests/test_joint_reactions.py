"""Joint reactions as data: seen from other bodies and frames, by frames and joints, kept in bundles."""

import dataclasses

import numpy as np
import pytest
from helpers import random_problem, with_joint_reactions

import scso_nlp as scso


@pytest.fixture
def problem(rng):
    return with_joint_reactions(random_problem(rng, reserve=5.0), rng)


@pytest.fixture
def reactions(problem):
    return problem.motion.trajectory.joint_reactions


@pytest.fixture
def forces(rng):
    return rng.uniform(0, 900, (3, 10)), rng.normal(size=(3, 3))


def test_action_is_reaction_about_the_other_center(reactions, forces):
    child, parent = (reactions.at(*forces, on=on) for on in ("child", "parent"))
    np.testing.assert_allclose(parent.forces, -child.forces, rtol=1e-14)
    # the two balance about any point, here the origin
    balance = child.moments + np.cross(child.points, child.forces)
    balance += parent.moments + np.cross(parent.points, parent.forces)
    np.testing.assert_allclose(balance, 0.0, atol=1e-9)


@pytest.mark.parametrize("frame", ["child", "parent"])
@pytest.mark.parametrize("on", ["child", "parent"])
def test_the_frame_of_a_body_turns_and_shifts_what_is_seen(reactions, forces, on, frame):
    ground, seen = (reactions.at(*forces, on=on, frame=name) for name in ("ground", frame))
    axes, origins = (getattr(reactions, f"{frame}_{what}") for what in ("rotations", "origins"))
    for name in ("forces", "moments"):
        back = np.einsum("kjab,kjb->kja", axes, getattr(seen, name))
        np.testing.assert_allclose(back, getattr(ground, name), rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(np.einsum("kjab,kjb->kja", axes, seen.points) + origins, ground.points)
    assert seen.labels[0] == f"hip_on_hip_{on}_in_hip_{frame}_fx"
    np.testing.assert_allclose(seen.resultant, ground.resultant)


def test_frames_and_joints_are_chosen_alike(problem, reactions, forces):
    every = reactions.at(*forces)
    part = problem.motion.frames(1, 3)
    chosen = part.trajectory.joint_reactions.of_joints(["kn*"])
    found = chosen.at(*(values[1:3] for values in forces))
    assert found.joints == ("knee",)
    np.testing.assert_array_equal(found.forces, every.forces[1:3, 1:])
    np.testing.assert_array_equal(found.points, every.points[1:3, 1:])


def test_a_bundle_keeps_them(problem, reactions, tmp_path):
    scso.save_bundle(tmp_path / "m.npz", problem.motion)
    again = scso.load_bundle(tmp_path / "m.npz").trajectory.joint_reactions
    for item in dataclasses.fields(reactions):
        np.testing.assert_array_equal(getattr(again, item.name), getattr(reactions, item.name))


def test_what_does_not_fit_is_refused(problem, reactions, forces):
    with pytest.raises(scso.ProblemError, match="on is 'both', expected one of 'child', 'parent'"):
        reactions.seen("both", "ground")
    with pytest.raises(scso.NameMismatchError, match="ankle"):
        reactions.of_joints(["ankle"])
    fewer = dataclasses.replace(reactions, per_tendon_force=reactions.per_tendon_force[..., 1:])
    with pytest.raises(scso.DataError, match=r"joint_reactions has \(3, 9, 3\) \(n_frames, n_muscles"):
        dataclasses.replace(problem.motion.trajectory, joint_reactions=fewer)


def test_a_model_without_actuators_has_reactions_too(rng):
    limit = scso.JointReactionLimit(largest="9BW")
    problem = with_joint_reactions(random_problem(rng), rng)
    assert problem.motion.trajectory.joint_reactions.forces("child", "ground")["per_control"].shape == (
        3,
        6,
        0,
    )
    held = dataclasses.replace(
        problem,
        objectives=(*problem.objectives, scso.JointReactionEffort()),
        constraints=(*problem.constraints, limit),
    )
    assert scso.solve_trajectory(held).is_solved.all()


def test_a_solution_without_them_says_how_to_get_them(rng):
    solution = scso.solve_framewise(random_problem(rng))
    with pytest.raises(scso.ProblemError, match=r"read it again with joint_reactions='all'"):
        solution.joint_reactions()
