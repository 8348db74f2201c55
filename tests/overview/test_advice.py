"""What the doctor says, where the answer is known in closed form: a symmetric pair of muscles."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import elbow, two_antagonists

from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.overview.advice import advice_tables
from scso_nlp.overview.diagnosis import diagnosis_of, stable_terms
from scso_nlp.overview.info import ModelInfo


def sentences(found, clamped=None):
    return "\n".join(advice_tables(found, "setup.xml", clamped)[-1].notes)


@pytest.mark.parametrize(("moment", "gain"), [(30.0, 5.0), (15.0, 9.0)])
def test_the_gain_from_which_static_optimization_keeps_a_row_is_that_of_the_closed_form(moment, gain):
    """S = F (q - 1) r² / l - 30 with r² / l = 0.0125 m and F = moment / 0.05 m."""
    found = diagnosis_of(two_antagonists(moment, q=4.0))
    (row,) = found.rows
    np.testing.assert_allclose(row.q, gain, rtol=1e-6)
    np.testing.assert_allclose(row.margin, moment / 0.05 * 3 * 0.0125 - 30, rtol=1e-6)
    # one muscle at full strength, the other by the moment less: 4000 N less moment / 0.05 m
    np.testing.assert_allclose(row.highest, (4000 - moment / 0.05) * 3 * 0.0125 - 30, rtol=1e-6)
    assert not found.is_kept.any()
    assert not row.is_out_of_reach.any()
    assert row.multiplier[0] > 0
    text = sentences(found)
    assert "static optimization keeps all rows in 0 of 1 frames: stability changes the other 1" in text
    assert f"(--q {1.01 * gain:.2f})" in text
    assert "scso run setup.xml --stability potvin-brown --joints elbow --axes z" in text


def test_a_row_that_is_kept_costs_nothing():
    found = diagnosis_of(two_antagonists(30.0, q=6.0))
    assert found.is_kept.all()
    assert found.rows[0].multiplier[0] == pytest.approx(0.0, abs=1e-9)
    assert "keeps all rows in all 1 frames: stability changes nothing here" in sentences(found)


def test_a_row_out_of_reach_is_named_with_its_price():
    found = diagnosis_of(two_antagonists(15.0, q=1.2, external_work=60.0))
    # (4000 - 300) N times 0.2 times 0.0125 m is 9.25 N·m/rad
    np.testing.assert_allclose(found.rows[0].highest, 9.25 - 60.0, rtol=1e-6)
    assert found.rows[0].is_out_of_reach.all()
    text = sentences(found)
    assert "elbow_z cannot be kept in up to 1 frames" in text
    assert "--soft 1: levels may be missed" in text
    # 3700 N (q - 1) 0.0125 m are 60 N·m/rad
    assert f"at q = {1 + 60 / 46.25:.4g} and above" in text


def test_reserves_beyond_opensims_rule_and_moments_out_of_reach_are_said():
    strong = diagnosis_of(elbow([10.0, 60.0], reserve=1000.0))
    assert "reserves carry up to" in sentences(strong)
    assert "OpenSim advises at most 10 %" in sentences(strong)
    weak = diagnosis_of(elbow([10.0, 900.0]))
    assert "solves 1 of 2 frames: muscles and actuators cannot make the moments of q1" in sentences(weak)
    assert weak.rows == ()
    assert "within OpenSim's limits" in sentences(diagnosis_of(elbow([10.0])))


@pytest.mark.parametrize("reserve", [None, 1000.0], ids=["out of reach", "by reserves"])
def test_a_limit_of_a_joint_is_named_where_it_is_the_reason(reserve):
    """In the second frame 900 N·m are asked for: 10 by the motion, the rest against a limit."""
    problem = elbow([10.0, 900.0], reserve=reserve)
    found = diagnosis_of(problem)
    assert "clamps" not in sentences(found, {"q1": (-1.0, 2.0)})
    assert "springs and limits" not in sentences(found)
    said = "the model clamps q1 at t = 0.01 s to the end of its range: widen the range, or mend the motion"
    assert said in sentences(found, {"q1": (-1.0, 0.0)})
    trajectory = replace(problem.motion.trajectory, passive_generalized_forces=[[0.0], [-890.0]])
    found = diagnosis_of(replace(problem, motion=replace(problem.motion, trajectory=trajectory)))
    assert "own springs and limits push q1 at t = 0.01 s by -890 N·m, more than is needed" in sentences(found)


def test_two_frames_with_and_without_need_are_counted_apart():
    one = two_antagonists(30.0, q=4.0)
    easy = replace(one.motion, trajectory=replace(one.motion.trajectory, generalized_forces=[[60.0]]))
    assert diagnosis_of(replace(one, motion=easy)).is_kept.all()


@pytest.mark.opensim
def test_rows_to_look_at_are_those_that_muscles_can_keep(tiny_info: ModelInfo):
    assert stable_terms(tiny_info.description) == (JointStability(),)
    assert tiny_info.stable_rows == ("shoulder_z", "elbow_z")
