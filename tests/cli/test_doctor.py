"""``scso doctor`` says what a setup holds and what to do next, with exit codes to match."""

import json

import pytest
from tiny_model import setup_text, write_tiny
from typer.testing import CliRunner

from scso_nlp.cli import app
from scso_nlp.examples import example_folder

pytestmark = pytest.mark.opensim


def doctor(*arguments):
    done = CliRunner().invoke(app, ["doctor", *arguments])
    return done, " ".join(done.stdout.split())


def test_the_gain_and_the_command_to_type_are_those_of_the_example():
    """The gain is that of an independent solver, 12.971 with 4.5 kg at 0.8 m: the fifth task."""
    settings = str(example_folder("spine-load-height") / "scso.toml")
    done, text = doctor(settings)
    assert done.exit_code == 0
    assert "from q = 13.1 on no frame would change any more (--q 13.1)" in text
    assert f"scso run {settings} --stability potvin-brown" in text


def test_files_that_do_not_fit_end_it(tmp_path):
    tiny = write_tiny(tmp_path)
    tiny.setup.write_text(setup_text(initial_time="5", final_time="6"), encoding="utf-8")
    done, text = doctor(str(tiny.setup))
    assert done.exit_code == 2
    assert "cannot be used: the time range 5 to 6 s" in text
    assert "Advice" not in text


def test_all_of_it_as_json():
    """Gains are those of an independent solver: 12.971 in the fifth task, 4.49 in the sixth."""
    done, _ = doctor(str(example_folder("spine-load-height") / "scso.toml"), "--json")
    assert done.exit_code == 0
    found = json.loads(done.stdout)
    assert found["info"]["stable_rows"] == [row["row"] for row in found["rows"]]
    assert found["time"] == list(range(10))
    assert found["is_solved_without_stability"] == found["is_solved_with_stability"] == [True] * 10
    gains = [max(row["q"][k] for row in found["rows"]) for k in (4, 5)]
    assert gains == pytest.approx([12.971, 4.49], abs=5e-3)
    kept = [all(row["is_kept"][k] for row in found["rows"]) for k in range(10)]
    assert kept[5]
    assert not kept[4]
    assert any("--q 13.1" in sentence for sentence in found["advice"])


def test_files_that_do_not_fit_are_json_too(tmp_path):
    tiny = write_tiny(tmp_path)
    tiny.setup.write_text(setup_text(initial_time="5", final_time="6"), encoding="utf-8")
    done, _ = doctor(str(tiny.setup), "--json")
    assert done.exit_code == 2
    assert "the time range 5 to 6 s" in json.loads(done.stdout)["info"]["inputs"]["problem"]
