"""The spine examples: what the rule about axes leaves open, and what the full Hessian costs.

The reconstruction is ours, so its numbers illustrate and do not validate.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, smallest_eigenvalue, solve_full_frame

import scso_nlp as scso
from scso_nlp import CoordinateStability, HessianStability
from scso_nlp.examples import example_folder
from scso_nlp.solver.reach import reachable_stability
from scso_nlp.stability.passive import LumbarJoint, lumbar_passive_stiffness

pytestmark = pytest.mark.opensim

TURNS = {"flexion": "flexion", "abduction_right": "lateral", "twist_left": "axial"}
JOINTS = ("lumbar_pelvis", "thorax_lumbar")
COORDINATES = tuple(f"{joint}_{turn}" for joint in JOINTS for turn in TURNS)
N_TASKS = {"spine-load-height": 10, "spine-postures": 8}


@pytest.fixture(scope="module", params=sorted(N_TASKS))
def plain(request):
    """Static optimization of one example, with curvature of its six coordinates."""
    setup = example_folder(request.param) / "setup.xml"
    motion = scso.load_motion(setup, curvature_coordinates=COORDINATES)
    assert motion.n_frames == N_TASKS[request.param]
    return scso.static_optimization(motion, muscle_model=scso.NoPhysiology())


def with_rule(plain, rule):
    return dataclasses.replace(plain, constraints=(*plain.constraints, rule))


@pytest.mark.parametrize("q", [3.0, 5.0])
def test_the_rule_about_axes_holds_and_the_smallest_eigenvalue_is_negative_in_every_task(plain, q):
    solution = scso.solve_trajectory(with_rule(plain, scso.JointStability(q=q)))
    assert solution.rows["JointStability"].value.min() > -1e-5
    for k in range(plain.motion.trajectory.n_frames):
        least = smallest_eigenvalue(plain, k, solution.tendon_force[k], q)
        assert -60.0 < least < -20.0


def test_about_the_flexion_axes_single_coordinates_and_joint_axes_are_the_same_rows(plain):
    """First axes of the joints turn everything distal rigidly, as their coordinates do."""
    force = np.full(len(plain.motion.trajectory.muscles), 100.0)
    printed = scso.JointStability().stability_rows(plain.motion)
    rows = CoordinateStability(coordinates=COORDINATES).stability_rows(plain.motion)
    for i, name in enumerate(COORDINATES):
        if not name.endswith("flexion"):
            continue
        same = printed.rows.index(f"{name.removesuffix('_flexion')}_z")
        # OpenSim's moment arms differentiated once: 1e-9 of the curvature
        np.testing.assert_allclose(
            rows.curvature[:, i] @ force, printed.curvature[:, same] @ force, rtol=1e-7, atol=1e-6
        )
        np.testing.assert_allclose(
            rows.external_work[:, i], printed.external_work[:, same], rtol=1e-7, atol=1e-5
        )


@pytest.mark.parametrize("q", [3.0, 5.0])
def test_the_full_hessian_has_the_optimum_of_clarabel_in_every_task_it_can_stabilise(plain, q):
    problem = with_rule(plain, HessianStability(q=q))
    solution = scso.solve_trajectory(problem, on_failure="return")
    (reach,) = reachable_stability(problem)
    assert (reach.is_reachable == solution.is_solved).all()
    total = 0.0
    for k in range(plain.motion.trajectory.n_frames):
        oracle = solve_full_frame(problem, k, q=q)
        assert (oracle is not None) == solution.is_solved[k]
        if oracle is not None:
            total += oracle[1]
            assert smallest_eigenvalue(plain, k, solution.tendon_force[k], q) > -1e-5
    assert solution.objective == pytest.approx(total, rel=1e-5)
    per_axis = scso.solve_trajectory(with_rule(plain, scso.JointStability(q=q)))
    solved = solution.is_solved
    assert (solution.activation[solved].mean(axis=1) > 1.3 * per_axis.activation[solved].mean(axis=1)).all()


@pytest.mark.parametrize("q", [3.0, 5.0])
def test_with_published_passive_stiffness_every_task_is_stable_at_less_cost_than_the_rule_about_axes(
    plain, q
):
    """Three levels below and two above; flexion stiffness for both ways to bend."""
    low, high = (
        LumbarJoint(levels=levels, rows={f"{joint}_{turn}": way for turn, way in TURNS.items()})
        for joint, levels in zip(JOINTS, (3, 2), strict=True)
    )
    passive = lumbar_passive_stiffness(low, high)
    solution = scso.solve_trajectory(with_rule(plain, HessianStability(q=q, passive_stiffness=passive)))
    matrix = np.diag([passive[name] for name in COORDINATES])
    for k in range(plain.motion.trajectory.n_frames):
        force = solution.tendon_force[k]
        stiffness = q * force / plain.motion.trajectory.muscle_tendon_length[k]
        hessian = hessian_by_hand(plain, k, force, stiffness, passive=matrix)
        assert np.linalg.eigvalsh(hessian)[0] > -1e-5
    per_axis = scso.solve_trajectory(with_rule(plain, scso.JointStability(q=q)))
    assert solution.objective < per_axis.objective
    assert solution.objective > scso.solve_trajectory(plain).objective
