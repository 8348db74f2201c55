"""From channels and a map to activity of muscle groups: numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import elbow

import scso_nlp as scso
from scso_nlp import emg

TIME = np.linspace(0.0, 1.0, 11)


def channels(**series):
    return emg.Emg(channels=tuple(series), time=TIME, values=np.column_stack(list(series.values())))


def groups(**channels_of):
    return tuple(
        emg.MuscleGroup(name=name, muscles=(f"m{i + 1}",), channels=tuple(own))
        for i, (name, own) in enumerate(channels_of.items())
    )


def test_a_channel_is_over_its_reference_times_its_scale_and_groups_are_means():
    emg_map = emg.EmgMap(
        groups=groups(a=["x", "y"], b=[], c=["z"]), mvc={"x": 2.0}, scale={"x": 0.5, "z": 3.0}
    )
    found = emg.activity_of(channels(x=TIME, y=TIME / 2, z=TIME / 10), emg_map)
    assert (found.groups, found.muscles) == (("a", "c"), (("m1",), ("m3",)))
    np.testing.assert_allclose(found.values, np.column_stack([(TIME / 4 + TIME / 2) / 2, 0.3 * TIME]))


def test_a_delayed_channel_is_seen_later():
    emg_map = emg.EmgMap(groups=groups(a=["x"], b=["y"]), delay={"x": 0.1, "y": -0.25})
    found = emg.activity_of(channels(x=0.5 * TIME, y=0.8 * TIME), emg_map, start_offset=2.0)
    # both are known from 0.1 to 0.75 s
    assert found.time[0] >= 2.1
    assert found.time[-1] <= 2.75
    np.testing.assert_allclose(found.values[:, 0], 0.5 * (found.time - 2.1), atol=1e-12)
    np.testing.assert_allclose(found.values[:, 1], 0.8 * (found.time - 1.75), atol=1e-12)


def test_channels_delayed_alike_keep_their_samples():
    emg_map = emg.EmgMap(groups=groups(a=["x"]), delay={"x": 0.033})
    found = emg.activity_of(channels(x=TIME**2), emg_map)
    np.testing.assert_array_equal(found.time, TIME + 0.033)
    np.testing.assert_array_equal(found.values[:, 0], TIME**2)


def test_channels_that_have_no_time_in_common_are_refused():
    emg_map = emg.EmgMap(groups=groups(a=["x"], b=["y"]), delay={"x": 3.0})
    with pytest.raises(scso.DataError, match="have no time in common"):
        emg.activity_of(channels(x=TIME, y=TIME), emg_map)


def test_comparisons_and_terms_see_the_same_activity():
    emg_map = emg.EmgMap(groups=groups(a=["x"], b=["y"]), scale={"x": 0.5}, delay={"x": 0.2, "y": 0.2})
    measured = channels(x=TIME, y=TIME)
    motion = elbow(np.linspace(10.0, 50.0, 30)).motion
    solution = scso.solve_trajectory(elbow(np.linspace(10.0, 50.0, 30)))
    seen = emg.compare([emg.result_of(solution, "SO")], emg_map=emg_map, emg=measured, start_offset=-0.2)
    _, _, at_frames = emg.activity_of(measured, emg_map, start_offset=-0.2).of(motion)
    np.testing.assert_allclose(at_frames, seen.emg, atol=1e-12)


def test_a_motion_that_the_emg_does_not_cover_is_refused():
    found = emg.activity_of(channels(x=TIME), emg.EmgMap(groups=groups(a=["x"])), start_offset=5.0)
    with pytest.raises(scso.DataError, match=r"covers 5.0 to 6.0 s, the motion needs 0.0 to 0.02 s"):
        found.of(elbow([1.0, 2.0, 3.0]).motion)


def test_a_muscle_in_two_groups_is_refused():
    twice = scso.MuscleActivity(
        groups=("a", "b"), muscles=(("m*",), ("m2",)), time=[0.0, 1.0], values=np.zeros((2, 2))
    )
    with pytest.raises(scso.DataError, match="muscle 'm2' is in two groups, 'a' and 'b'"):
        twice.of(elbow([1.0]).motion)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": [1.0, 0.0]}, "increase"),
        ({"values": [[0.1], [np.nan]]}, "finite"),
        ({"values": [[0.1, 0.2]]}, "shape"),
        ({"muscles": ((),)}, "one list of muscles, not empty"),
    ],
)
def test_activity_that_is_none_is_refused(changes, message):
    arguments = {"groups": ("a",), "muscles": (("m1",),), "time": [0.0, 1.0], "values": [[0.1], [0.2]]}
    with pytest.raises(scso.DataError, match=message):
        scso.MuscleActivity(**{**arguments, **changes})
