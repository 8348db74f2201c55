"""Computed beside measured knee forces, on a few frames: the table and the figure say what they should."""

import numpy as np
import pytest

from problems import fetch as fetching
from problems import implant_figures as module
from problems.knee_implant import problem as knee_implant
from scso_nlp.exceptions import NameMismatchError

pytestmark = [pytest.mark.opensim, pytest.mark.slow]


@pytest.fixture
def local_data(shared_data, monkeypatch):
    monkeypatch.setenv(fetching.LOCAL_COPY, str(shared_data))


def test_the_measured_curves_are_those_of_the_three_trials(local_data):
    forces = [knee_implant.measured_force(trial) for trial in knee_implant.TRIALS]
    assert [force.shape for force in forces] == [(101,)] * 3
    peaks = [force.max() for force in forces]
    assert len(set(peaks)) == 3
    assert 1600 < min(peaks) < max(peaks) < 1820


def test_table_and_figure_are_written(local_data, tmp_path, capsys):
    module.main([str(tmp_path), "20"])
    text = capsys.readouterr().out
    for trial in knee_implant.TRIALS:
        assert text.count(f"| {trial} |") == 4
    assert {path.name for path in tmp_path.iterdir()} == {
        "README.md", "contact_force.png", "contact_force.pdf",
    }  # fmt: skip


def test_differences_are_those_at_the_frames(local_data):
    knee = module.solve("GC5_ss1", 20)
    solution = knee.solutions["SO"]
    time = solution.problem.motion.trajectory.time
    reactions = solution.problem.motion.trajectory.joint_reactions
    assert reactions.joints == (knee_implant.KNEE,)
    assert knee.body_weight == pytest.approx(75 * 9.80665)
    forces = np.einsum("kcm,km->kc", reactions.per_tendon_force[:, 0, :3], solution.tendon_force)
    forces += np.einsum("kca,ka->kc", reactions.per_control[:, 0, :3], solution.control)
    length = np.linalg.norm(forces + reactions.constant[:, 0, :3], axis=1)
    at = np.linspace(time[0], time[-1], 101)
    apart = np.interp(at, time, length) - knee.measured
    assert knee.error("SO") == pytest.approx(np.sqrt((apart**2).mean()), rel=1e-9)
    carried = {method: knee_implant.contact_force(found).mean() for method, found in knee.solutions.items()}
    assert carried["SO, knee force as a cost"] < carried["SO"] < carried["SCSO q = 40"]


def test_an_unknown_trial_is_refused_before_anything_is_fetched():
    with pytest.raises(NameMismatchError, match="unknown trial 'GC5_ss2', expected one of GC5_ss1, GC5_ss3"):
        knee_implant.make_problem("GC5_ss2")
