"""Margins of the whole Hessian, for solutions with and without that constraint."""

import numpy as np
import pytest
from conic_oracle import hessian_by_hand, hessian_problem

import scso_nlp as scso
from scso_nlp.analysis.stability_margin import stability_margin
from scso_nlp.constraints import HessianStability
from scso_nlp.figures import plot_stability


@pytest.mark.parametrize("soft", [None, 0.01])
def test_the_whole_hessian_is_read_as_its_diagonal_and_its_smallest_eigenvalue(rng, soft):
    level = {"q1": 3.0, "q3": -2.0}
    problem = hessian_problem(rng, stability=HessianStability(level=level, soft=soft))
    solution = scso.solve_trajectory(problem)
    plain = scso.solve_trajectory(problem.without_stability())
    for run, rows_of in ((solution, None), (plain, solution)):
        margin = stability_margin(run, rows_of=rows_of)
        assert margin is not None
        assert margin.rows == ("q1", "q2", "q3", "q4", "smallest_eigenvalue")
        assert margin.level.tolist() == [3, 0, -2, 0, 0]
        assert margin.mode_coordinates == problem.trajectory.coordinates
        for k in range(problem.trajectory.n_frames):
            force = run.tendon_force[k]
            stiffness = 5.0 * force / problem.trajectory.muscle_tendon_length[k]
            hessian = hessian_by_hand(problem, k, force, stiffness)
            # the same numbers, added up in another order: rounding of terms of some 1e3 N·m/rad
            np.testing.assert_allclose(margin.stability[k, :4], np.diag(hessian), atol=1e-9)
            least = np.linalg.eigvalsh(hessian - np.diag([3.0, 0, -2.0, 0]))[0]
            assert margin.stability[k, 4] == pytest.approx(least, abs=1e-9)
            mode = margin.mode[k]
            assert mode @ (hessian - np.diag([3.0, 0, -2.0, 0])) @ mode == pytest.approx(least, abs=1e-9)
    panels = [panel.get_title(loc="left") for panel in plot_stability(solution, baseline=plain).axes]
    assert panels == ["q1, level 3", "q2", "q3, level -2", "q4", "smallest_eigenvalue"]
