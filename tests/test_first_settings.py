"""Settings to begin with: of a motion whose gains are known, and as a file that is read back."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest

from scso_nlp.examples import example_folder
from scso_nlp.first_settings import FirstSettings, first_settings


def found(folder: Path, **changes: object) -> FirstSettings:
    values = {
        "setup": folder / "setup.xml",
        "joints": ("knee_r", "ankle_r"),
        "rows": ("knee_r_z", "ankle_r_z"),
        "left_out": "no muscle crosses the joint: back",
        "q": 25.0,
        "soft": None,
        "least": (3.0, 22.0),
    }
    return FirstSettings(**values | changes)


@pytest.mark.opensim
def test_the_spine_keeps_all_rows_at_the_gain_of_its_paper():
    """Its six rows have an answer at q = 1.5 in every task, and at q = 1 in some have none."""
    settings = first_settings(example_folder("spine-load-height") / "setup.xml")
    assert settings.joints == ("lumbar_pelvis", "thorax_lumbar")
    assert len(settings.rows) == 6
    assert settings.left_out == ""
    assert len(settings.least) == 10
    assert max(settings.least) < 1.5
    assert (settings.q, settings.soft, settings.n_enough) == (5.0, None, 10)


def test_the_file_holds_them_with_a_setup_relative_to_it_and_reasons(tmp_path):
    text = found(tmp_path).text(tmp_path)
    values = tomllib.loads(text)
    assert values["setup"] == "setup.xml"
    assert (values["stability"], values["q"]) == ("potvin-brown", 25)
    assert values["joints"] == ["knee_r", "ankle_r"]
    assert "soft" not in values
    assert "#   Here: 2 of 2 frames looked at have an answer at q = 25; they need 3 to 22;" in text
    assert "left out where no muscle crosses the" in text
    assert tomllib.loads(found(tmp_path).text(tmp_path / "elsewhere"))["setup"] == str(tmp_path / "setup.xml")


def test_frames_that_cannot_keep_their_levels_make_them_soft_and_are_counted(tmp_path):
    settings = found(tmp_path, q=42.0, soft=1.0, least=(3.0, 50.0, math.inf, math.nan))
    assert settings.n_enough == 1
    assert tomllib.loads(settings.text(tmp_path))["soft"] == 1
    assert settings.reasons["q"].startswith(
        "1 of 4 frames looked at have an answer at q = 42; they need 3 to 50"
    )
    assert settings.reasons["soft"].startswith("2 frames cannot keep their levels")
    assert (
        "; in 1 frames muscles and actuators cannot make the moments at any gain: add reserves"
        in (settings.reasons["q"])
    )
