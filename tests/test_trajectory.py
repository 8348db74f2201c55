"""How times are written in messages, and what is one motion."""

from types import SimpleNamespace

import numpy as np
import pytest

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.solution import Shortfall
from scso_nlp.trajectory import require_same_motion, time_text


@pytest.mark.parametrize(
    ("time", "text"),
    [
        (0.1 + 0.2, "0.3"),
        (1 / 3, "0.333333"),
        (-5e-7, "-5e-07"),
        (812.25, "812.25"),
        # epoch seconds, as some laboratories record them
        (1667315995.25, "1667315995.250"),
    ],
)
def test_a_time_is_short_and_tells_frames_apart(time, text):
    assert time_text(time) == text


def test_a_failed_frame_of_a_motion_in_epoch_seconds_can_be_found():
    missed = Shortfall(
        frame=3, time=1667315995.61, constraint="MomentEquilibrium", row="knee", amount=2.0, unit="N·m",
        proven=False,
    )  # fmt: skip
    assert str(missed) == "MomentEquilibrium[knee] short by 2 N·m at t = 1667315995.610 s"


def motion(muscles=("a", "b"), time=(0.0, 0.1, 0.3)):
    return SimpleNamespace(muscles=muscles, time=np.array(time))


@pytest.mark.parametrize(
    ("other", "error", "message"),
    [
        ({"muscles": ("a", "c")}, NameMismatchError, r"missing muscles \['b'\], extra \['c'\]"),
        ({"muscles": ("b", "a")}, NameMismatchError, "extra none, different order"),
        ({"time": (0.0, 0.1)}, DataError, "'other' has 2 frames and 'first' has 3: expected one motion"),
        (
            {"time": (0.0, 0.1, 0.3002)},
            DataError,
            r"frame 2 of 'other' is at t = 0\.3002 s, of 'first' at 0\.3 s",
        ),
    ],
)
def test_motions_that_differ_are_told_apart_by_name(other, error, message):
    # a thousandth of the shortest step, 0.1 s, is rounding
    same = motion(time=(0.0, 0.10009, 0.3))
    require_same_motion({"first": motion(), "same": same})
    with pytest.raises(error, match=message):
        require_same_motion({"first": motion(), "same": same, "other": motion(**other)})


def test_one_motion_alone_and_one_frame_alone_are_fine():
    require_same_motion({"first": motion()})
    require_same_motion({"first": motion(time=(5.0,)), "second": motion(time=(5.0005,))})
    with pytest.raises(DataError, match="frame 0"):
        require_same_motion({"first": motion(time=(5.0,)), "second": motion(time=(5.1,))})
