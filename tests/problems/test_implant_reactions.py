"""The knee's force by OpenSim's JointReaction, and the table of it that the scorecard's page has."""

import json

import numpy as np
import pytest
from conftest import PROJECT_ROOT

from problems import fetch as fetching
from problems import implant_reactions as module
from problems.knee_implant import problem as knee_implant
from scso_nlp import solve_framewise

SCORECARD = PROJECT_ROOT / "problems" / "scorecard"


@pytest.mark.opensim
@pytest.mark.slow
def test_opensim_puts_the_same_force_on_the_knee(shared_data, monkeypatch):
    """In two frames, to what files round: forces of 1 kN, twelve digits."""
    monkeypatch.setenv(fetching.LOCAL_COPY, str(shared_data))
    problem = knee_implant.make_problem("GC5_ss1", step_interval=20).without_stability().frames(0, 2)
    solution = solve_framewise(problem)
    ours = solution.joint_reactions([knee_implant.KNEE]).resultant[:, 0]
    assert ours.max() > 300
    np.testing.assert_allclose(module.opensims_force("GC5_ss1", solution), ours, atol=1e-4)


def test_the_table_on_the_page_checks_the_errors_of_the_scorecard():
    """Method by method and trial by trial; OpenSim's are the same."""
    page = (SCORECARD / "page.md").read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(page) if line.startswith(f"| {' | '.join(module.HEADS)} |"))
    rows = [[c.strip() for c in line.split("|")[1:-1]] for line in page[start + 2 : start + 11]]
    measured = json.loads(max((SCORECARD / "measured").glob("*.json")).read_text(encoding="utf-8"))
    errors = {
        row["method"]: row["errors"].get("contact force")
        for row in measured["sets"]["knee_implant"]["rows"]
        if "reference" not in row
    }
    expected = [
        (trial, method, errors[method][i])
        for i, trial in enumerate(knee_implant.TRIALS)
        for method in module.METHODS
    ]
    assert [(row[0], row[1]) for row in rows] == [(trial, method) for trial, method, _ in expected]
    for row, (_, _, error) in zip(rows, expected, strict=True):
        assert float(row[3]) == float(row[4]) == pytest.approx(error, rel=0.01)
        assert float(row[6]) < 1e-5
