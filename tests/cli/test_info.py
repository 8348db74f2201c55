"""``scso info`` prints tables or JSON, with exit codes to match."""

import json
from pathlib import Path

import pytest
from tiny_model import setup_text, write_tiny
from typer.testing import CliRunner

from scso_nlp.cli import app

pytestmark = pytest.mark.opensim


def test_a_model_is_told_as_tables_or_as_json(tmp_path: Path) -> None:
    model = str(write_tiny(tmp_path).model)
    done = CliRunner().invoke(app, ["info", model, "--muscles"])
    assert done.exit_code == 0
    assert done.stderr == "tiny.osim: asking OpenSim ...\n"
    assert done.stdout.splitlines()[0] == "tiny, tiny.osim"
    assert "--joints shoulder,elbow --axes z" in done.stdout
    as_json = CliRunner().invoke(app, ["info", model, "--json"])
    assert json.loads(as_json.stdout)["stable_rows"] == ["shoulder_z", "elbow_z"]


def test_files_that_do_not_fit_cost_the_exit_code(tmp_path: Path) -> None:
    tiny = write_tiny(tmp_path)
    tiny.setup.write_text(setup_text(initial_time="5", final_time="6"), encoding="utf-8")
    done = CliRunner().invoke(app, ["info", str(tiny.setup)])
    assert done.exit_code == 2
    assert "cannot be used: the time range 5 to 6 s is outside" in " ".join(done.stdout.split())
