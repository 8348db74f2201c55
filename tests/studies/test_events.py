"""Heel strikes in made-up ground reactions, and the rule that decides where cycles lie."""

from dataclasses import replace

import helpers
import numpy as np
import pytest

from scso_nlp.studies.events import contacts, find_events, heel_strikes

TIME = np.linspace(0.0, 4.0, 401)


def steps(starts, stance=0.6, height=700.0):
    """A force that is there for a while from each start on, rising and falling over 0.05 s."""
    edges = [np.clip(np.minimum(TIME - start, start + stance - TIME) / 0.05, 0, 1) for start in starts]
    return height * np.sum(edges, axis=0)


def walker(right=(), left=(), up=(0.0, 1.0, 0.0), mass=70.0):
    """A skeleton of two feet with these heel strikes."""
    forces = np.stack([np.outer(steps(strikes), up) if strikes else np.zeros((len(TIME), 3))
                       for strikes in (right, left)], axis=1)  # fmt: skip
    nothing = np.zeros((len(TIME), 2, 3))
    one = helpers.skeleton(np.zeros((1, 2, 3)), [[0, 1]], n_frames=len(TIME))
    return replace(
        one,
        bodies=("ground", "calcn_r", "calcn_l"),
        body_parents=[-1, 0, 0],
        body_masses=[0.0, mass / 2, mass / 2],
        body_mass_centers=np.zeros((len(TIME), 3, 3)),
        gravity=-9.81 * np.asarray(up),
        load_names=("right", "left"),
        load_bodies=[1, 2],
        load_forces=forces,
        load_points=nothing,
        load_torques=nothing,
    )


def test_a_strike_is_where_the_force_crosses_the_threshold_between_frames():
    """A ramp of 1000 N/s from 0.305 s on crosses 30 N after 0.03 s."""
    force = np.clip(1000 * (TIME - 0.305), 0, None)
    assert contacts(TIME, force, 30.0) == pytest.approx([0.335])


def test_what_stands_on_the_ground_at_first_has_no_strike():
    force = steps([-0.3, 1.0])
    assert contacts(TIME, force, 35.0) == pytest.approx([1.0 + 0.05 * 35 / 700])


def test_short_gaps_and_short_contacts_are_noise():
    force = steps([1.0, 2.5])
    force[(TIME > 1.25) & (TIME < 1.31)] = 0.0
    force[(TIME > 2.0) & (TIME < 2.06)] = 500.0
    assert contacts(TIME, force, 35.0) == pytest.approx([1.0025, 2.5025])


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)])
def test_each_foot_has_its_own_strikes_whichever_way_is_up(up):
    """5 % of the weight of 70 kg is 34.3 N, 2.45 ms after the force begins."""
    found = heel_strikes(TIME, walker(right=(0.4, 1.5, 2.6), left=(0.9, 2.0), up=up))
    late = 0.05 * (0.05 * 70 * 9.80665) / 700
    assert found["right"] == pytest.approx(np.array([0.4, 1.5, 2.6]) + late)
    assert found["left"] == pytest.approx(np.array([0.9, 2.0]) + late)


def test_a_load_that_pulls_down_is_no_contact():
    body = walker(right=(0.4, 1.5))
    assert heel_strikes(TIME, replace(body, load_forces=-body.load_forces))["right"].size == 0


def test_given_events_come_first_then_strikes_then_the_whole():
    strides, standing = walker(right=(0.4, 1.5), left=(0.9,)), walker(right=(0.4,))
    given = find_events(TIME, (1.0, 3.0, 9.0), strides)
    assert (given.rule, given.times[""].tolist()) == ("given", [1.0, 3.0])
    assert find_events(TIME, None, strides).rule == "ground reaction"
    for skeleton in (standing, None):
        whole = find_events(TIME, None, skeleton)
        assert (whole.rule, whole.times[""].tolist()) == ("whole trial", [0.0, 4.0])


def test_a_curve_is_cut_by_the_foot_of_its_side():
    events = find_events(TIME, None, walker(right=(0.4, 1.5), left=(0.9,)))
    assert events.of("left")[0] == "left"
    assert events.of("")[0] == "right"
    assert len(events.of("left")[1]) == 1
