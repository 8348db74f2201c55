"""One call from a setup to a solution: the answers of the steps by hand, and of the command line."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_model import write_tiny

import scso_nlp as scso
from scso_nlp.examples import example_folder
from scso_nlp.opensim.setup_xml import read_analyze_setup
from scso_nlp.run import run
from scso_nlp.settings import read_settings

SPINE = example_folder("spine-load-height") / "setup.xml"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Ten frames of a model with a wrapping muscle."""
    setup = write_tiny(tmp_path_factory.mktemp("tiny")).setup
    return replace(read_analyze_setup(setup).motion, step_interval=8)


@pytest.mark.opensim
def test_the_answer_is_that_of_the_command_line():
    """The setup says exponent and muscle model."""
    stability = scso.JointStability(q=5.0, level=2.0)
    asked = {"stability": "potvin-brown", "q": "5", "level": "2"}
    expected = run(read_settings(SPINE, asked)[0]).solution
    found = scso.solve(SPINE, stability=stability)
    assert repr(found.problem.terms) == repr(expected.problem.terms)
    assert isinstance(found.problem.muscle_model, scso.NoPhysiology)
    np.testing.assert_allclose(found.activation, expected.activation, rtol=0, atol=1e-9)
    assert found.stability.margin.min() > -1e-9


@pytest.mark.opensim
def test_the_answer_is_that_of_the_steps_by_hand(tiny):
    def reserves(frame):
        control = frame.control
        return sum(control[j] ** 2 for j in range(control.numel()))

    terms = {
        "stability": scso.HessianStability(q=20.0, coordinates=["elbow_flexion"], level=4.0, soft=2.0),
        "constraints": [scso.ActivationRate()],
        "objectives": [reserves],
    }
    found = scso.solve(tiny, **terms, exponent=3.0, weights="volume", muscle_model=scso.NoPhysiology())
    motion = scso.load_motion(tiny, prepare_for=[terms["stability"]])
    problem = scso.MuscleForceProblem(
        motion=motion,
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=3.0, weights="volume"), reserves),
        constraints=(scso.MomentEquilibrium(), terms["stability"], scso.ActivationRate()),
    )
    expected = scso.solve_trajectory(problem)
    np.testing.assert_allclose(found.activation, expected.activation, rtol=0, atol=1e-9)
    again = scso.solve(motion, **terms, exponent=3.0, weights="volume", muscle_model=scso.NoPhysiology())
    np.testing.assert_allclose(again.activation, expected.activation, rtol=0, atol=1e-9)


@pytest.mark.opensim
def test_solver_options_and_failures_are_handed_on(tiny):
    impossible = scso.JointStability(joints=["elbow"], axes=["z"], level=1e6)
    failed = scso.solve(tiny, stability=impossible, on_failure="return", solver="framewise")
    assert failed.status is scso.Status.INFEASIBLE
    assert failed.report.solver == "framewise"
    with pytest.raises(scso.SolveFailed):
        scso.solve(failed.problem.motion, stability=impossible)
    options = scso.SolverOptions(max_iterations=7)
    solved = scso.solve(failed.problem.motion, options=options, passive_elements="left_in")
    assert solved.report.options["max_iterations"] == 7
    assert solved.problem.constraints == (scso.MomentEquilibrium(passive_elements="left_in"),)


@pytest.mark.opensim
def test_wrong_names_are_refused_before_opensim_starts(tiny, monkeypatch):
    monkeypatch.setattr("scso_nlp.opensim.crew.extract", lambda *_: pytest.fail("OpenSim was started"))
    for stability, closest in (
        (scso.JointStability(joints=["elbo"]), r"elbo.*closest: elbow"),
        (scso.CoordinateStability(coordinates=["elbow_flex"]), r"elbow_flex.*closest: elbow_flexion"),
    ):
        with pytest.raises(scso.NameMismatchError, match=closest):
            scso.solve(tiny, stability=stability)


@pytest.mark.opensim
def test_a_model_with_wrapping_needs_no_further_word(shared_data):
    folder = shared_data / "gait10dof18musc"
    setup = read_analyze_setup(folder / "setup_static_optimization.xml")
    motion = replace(setup.motion, initial_time=1.0, final_time=1.1)
    stability = scso.JointStability(q=20.0, joints=["knee_r"], axes=["z"])
    with pytest.raises(scso.DataError, match=r"point that slides on a wrap surface.*prepare_for"):
        scso.solve(scso.load_motion(motion), stability=stability)
    solution = scso.solve(motion, stability=stability)
    assert solution.stability.rows == ("knee_r_z",)
    assert solution.stability.margin.min() > -1e-6
