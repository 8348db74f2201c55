"""``scso doctor`` says what a setup holds and what to do next, with exit codes to match."""

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
