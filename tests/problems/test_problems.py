"""Every problem builds, solves and meets what its SOURCE.md says."""

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest

from problems import fetch as fetching
from scso_nlp import MuscleForceProblem, solve_framewise
from scso_nlp.emg import read_emg, read_emg_map
from scso_nlp.exceptions import NameMismatchError

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
NAMES = sorted(path.parent.name for path in PROBLEMS.glob("*/problem.py"))
#: Few frames of each: enough to see that it solves.
QUICK = {
    "back_lifting": {"step_interval": 200},
    "gait_lower_limb": {"step_interval": 40},
    "knee_implant": {"step_interval": 40},
    "treadmill": {"step_interval": 200},
    "walking_3d": {"step_interval": 400},
}
#: Activations of an interior-point answer to a tolerance of 1e-6 of the objective.
SOLVER = 1e-4


def load(name):
    return importlib.import_module(f"problems.{name}.problem")


@pytest.fixture
def local_data(shared_data, monkeypatch):
    monkeypatch.setenv(fetching.LOCAL_COPY, str(shared_data))


def group_mean(problem, solution, start):
    columns = [m for m, name in enumerate(problem.motion.trajectory.muscles) if name.startswith(start)]
    return solution.activation[:, columns].mean(axis=1)


def with_q(problem, q):
    equilibrium, stability = problem.constraints
    return dataclasses.replace(problem, constraints=(equilibrium, dataclasses.replace(stability, q=q)))


def test_the_problems_are_those_we_know_of():
    assert NAMES == [
        "back_lifting", "elbow", "gait_lower_limb", "knee_implant", "random_hessian", "spine_load_height",
        "spine_postures", "treadmill", "walking_3d",
    ]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_every_problem_says_where_it_comes_from(name):
    text = (PROBLEMS / name / "SOURCE.md").read_text(encoding="utf-8")
    assert text.startswith(f"# {name}\n")
    sets = {data.name: data for data in vars(fetching).values() if isinstance(data, fetching.DataSet)}
    used = [data for data in vars(load(name)).values() if isinstance(data, fetching.DataSet)]
    assert {data.name for data in used} <= set(sets)
    for data in used:
        assert data.commit in text
        assert data.license in text


@pytest.mark.opensim
@pytest.mark.parametrize("name", NAMES)
def test_every_problem_builds_and_its_frames_are_solved(name, request):
    if name in QUICK:  # the others are embedded
        request.getfixturevalue("local_data")
    problem = load(name).make_problem(**QUICK.get(name, {}))
    assert isinstance(problem, MuscleForceProblem)
    solution = solve_framewise(problem)
    assert solution.is_solved.all()
    assert solve_framewise(problem.without_stability()).objective <= solution.objective + SOLVER


@pytest.mark.opensim
@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
def test_the_elbow_meets_its_closed_form(exponent):
    elbow = load("elbow")
    problem = elbow.make_problem(exponent).frames([0, 1])
    solution = solve_framewise(problem)
    for k, moment in enumerate((30.0, 60.0)):
        assert solution.activation[k] == pytest.approx(elbow.closed_form(moment, exponent), abs=SOLVER)
    # the same numbers as printed in the package's own example
    assert elbow.closed_form(60.0) == pytest.approx([0.347652, 0.143856, 0.047952], abs=1e-6)


@pytest.mark.opensim
def test_spine_postures_meet_the_reconstruction():
    problem = load("spine_postures").make_problem()
    symmetric = slice(0, 4)
    for q, oblique in ((5.0, 0.0435), (3.0, 0.0981)):
        solution = solve_framewise(with_q(problem, q))
        # stated to three digits
        assert group_mean(problem, solution, "EO")[symmetric].mean() == pytest.approx(oblique, abs=6e-5)
    plain = solve_framewise(problem.without_stability())
    for start in ("RA", "EO"):
        assert group_mean(problem, plain, start) == pytest.approx(0, abs=SOLVER)


@pytest.mark.opensim
def test_spine_load_height_meets_the_reconstruction():
    problem = load("spine_load_height").make_problem()
    light = slice(0, 5)
    plain = solve_framewise(problem.without_stability())
    assert plain.activation[light] == pytest.approx(np.broadcast_to(plain.activation[0], (5, 12)), abs=SOLVER)
    solution = solve_framewise(problem)
    abdomen = np.mean([group_mean(problem, solution, start) for start in ("RA", "EO", "IO")], axis=0)[light]
    back = group_mean(problem, solution, "ES")[light]
    # stated to three digits, in per cent
    assert 100 * abdomen[[0, -1]] == pytest.approx([1.99, 3.88], abs=0.006)
    assert 100 * back[[0, -1]] == pytest.approx([12.2, 15.9], abs=0.06)
    steps = np.diff(abdomen)
    assert steps == pytest.approx(np.full(4, steps.mean()), rel=0.02)  # linear in height
    stiff = solve_framewise(with_q(problem.frames(0, 5), 13.0))
    assert stiff.activation == pytest.approx(plain.activation[light], abs=SOLVER)


@pytest.mark.opensim
@pytest.mark.parametrize("name", ["back_lifting", "treadmill", "walking_3d"])
def test_emg_maps_fit_the_models_and_the_recordings(name, local_data):
    module = load(name)
    problem = module.make_problem(**QUICK[name])
    emg = read_emg(module.emg_file())
    found = read_emg_map(module.EMG_MAP).resolve(problem.motion.trajectory.muscles, emg.channels)
    assert sum(len(group.channels) for group in found.groups) in (8, 9, 10)


def test_an_unknown_trial_is_refused_before_anything_is_fetched():
    with pytest.raises(NameMismatchError, match="unknown trial 'squat', expected one of stoop5kg, stoop15kg"):
        load("back_lifting").make_problem("squat")
