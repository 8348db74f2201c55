"""``scso reach`` says what can be reached, with exit codes to match."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from scso_nlp.cli import app
from scso_nlp.examples import example_folder

SETTINGS = str(example_folder("spine-load-height") / "scso.toml")

pytestmark = pytest.mark.opensim


def reach(*arguments):
    return CliRunner().invoke(app, ["reach", *arguments])


def test_every_row_is_told_with_its_least_reach_and_the_gain_that_costs_nothing():
    """The gain is that of an independent solver, 12.971 with 4.5 kg at 0.8 m: the fifth task."""
    done = reach(SETTINGS)
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert lines[0] == "spine_load_height: 10 frames"
    assert [line.split()[0] for line in lines[2:8]] == [
        f"{joint}_{axis}" for joint in ("lumbar_pelvis", "thorax_lumbar") for axis in "xyz"
    ]
    assert lines[-1].strip() == "static optimization keeps all rows from q = 12.97 on (t = 4 s)"


def test_a_level_out_of_reach_is_named_and_costs_the_exit_code():
    done = reach(SETTINGS, "--level", "thorax_lumbar_y=400")
    assert done.exit_code == 1
    (line,) = [line for line in done.stdout.splitlines() if "out of reach" in line]
    assert line.split()[:2] == ["thorax_lumbar_y", "400"]
    assert "stronger" in line


def test_the_full_hessian_is_one_row():
    done = reach(SETTINGS, "--stability", "full")
    assert done.exit_code == 0
    assert [line.split()[:2] for line in done.stdout.splitlines()[2:3]] == [["smallest", "eigenvalue"]]


def test_terms_that_couple_frames_are_left_out_and_named():
    plain, coupled = (reach(SETTINGS, *more).stdout for more in ((), ("--activation-rate", "constant")))
    told = "  left out, because they couple frames: ActivationRate\n"
    assert told in coupled
    assert coupled.replace(told, "") == plain


def test_without_stability_there_is_nothing_to_reach():
    done = reach(str(example_folder("elbow") / "setup.xml"))
    assert done.exit_code == 2
    assert "stability is off, choose what to look at with --stability" in done.stderr
