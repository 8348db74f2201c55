"""The whole Hessian on an anatomical spine, 18 rotations and 166 muscles, against the conic solver."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conic_oracle import smallest_eigenvalue, solve_full_frame

import scso_nlp as scso
from problems.back_lifting.problem import COORDINATES, make_problem, passive_stiffness

pytestmark = [pytest.mark.opensim, pytest.mark.slow]

#: Relative to the conic optimum; and of the eigenvalue over a meaningful stiffness of 10 N·m/rad.
OBJECTIVE, EIGENVALUE = 1e-5, 1e-6 * 10.0


@pytest.fixture(scope="module")
def lift(shared_data):
    """Five frames of the 15 kg lift, without stability rows."""
    whole = scso.HessianStability(coordinates=COORDINATES)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SCSO_DATA", str(shared_data))
        problem = make_problem("stoop15kg", step_interval=100, prepare_for=[whole])
    return dataclasses.replace(problem.without_stability(), muscle_model=scso.NoPhysiology())


def test_lifting_with_passive_stiffness_has_the_optimum_of_the_conic_solver(lift):
    _, passive = passive_stiffness()
    stability = scso.HessianStability(q=5.0, passive_stiffness=passive)
    problem = dataclasses.replace(lift, constraints=(*lift.constraints, stability))
    solution = scso.solve_trajectory(problem)
    diagonal = np.diag([passive[name] for name in lift.motion.trajectory.curvature.coordinates])
    total = 0.0
    for k in range(lift.motion.trajectory.n_frames):
        x, objective, _ = solve_full_frame(problem, k, passive=diagonal)
        total += objective
        best = x[: lift.motion.muscles.n_muscles] * lift.motion.muscles.max_isometric_force
        reached = smallest_eigenvalue(problem, k, solution.tendon_force[k], passive=diagonal)
        oracle = smallest_eigenvalue(problem, k, best, passive=diagonal)
        assert reached > -EIGENVALUE
        # The eigenvalue of a turn that costs nothing may differ as the flat part of the optimum does.
        assert reached == pytest.approx(oracle, abs=max(EIGENVALUE, 1e-4 * abs(oracle)))
    assert solution.objective == pytest.approx(total, rel=OBJECTIVE)


def test_lifting_without_passive_tissue_cannot_be_stable_in_every_direction(lift):
    problem = dataclasses.replace(lift, constraints=(*lift.constraints, scso.HessianStability(q=5.0)))
    solution = scso.solve_trajectory(problem, on_failure="return")
    failed = ~solution.is_solved
    assert failed.any()
    for k in np.flatnonzero(failed):
        assert solve_full_frame(problem, int(k)) is None
