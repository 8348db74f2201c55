"""How times are written in messages."""

import pytest

from scso_nlp.solution import Shortfall
from scso_nlp.trajectory import time_text


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
