"""The table of joint reactions beside OpenSim: its numbers on recorded motions, at few frames."""

from pathlib import Path

import pytest
from tiny_model import setup_text, write_tiny

from problems.benchmarks import reactions_against_opensim as table
from problems.benchmarks.setups import write_setups

pytestmark = pytest.mark.opensim

#: Of a joint's largest force or moment.
SAME = 1e-6


@pytest.mark.parametrize(
    ("name", "joints"), [("knee_implant_agreeing_GC5_ss1", 14), ("back_lifting_stoop15kg", 17)]
)
def test_reactions_equal_opensims(shared_data: Path, tmp_path: Path, name: str, joints: int) -> None:
    """With loads and coupled coordinates, and with 166 muscles."""
    (setup,) = (path for path in write_setups(shared_data, tmp_path) if path.parent.name == name)
    found = table.compare(setup, frames=2)
    assert found.frames >= 2
    assert found.joints == joints
    assert found.largest_force > 100.0
    assert max(found.force, found.moment, found.point) <= SAME, found
    assert str(found).count("|") == len(table.HEADS) - 2


def test_the_table_is_printed_and_written(tmp_path: Path, monkeypatch, capsys) -> None:
    """A setup without an answer has a row that says why."""
    output = tmp_path / "table.md"
    for name in ("good", "bad"):
        (tmp_path / name).mkdir()
    good, bad = write_tiny(tmp_path / "good").setup, write_tiny(tmp_path / "bad").setup
    bad.write_text(setup_text(coordinates_file="nowhere.mot"))
    monkeypatch.setattr("sys.argv", ["table", str(good), str(bad), "--output", str(output)])
    table.main()
    *_, first, last = output.read_text().splitlines()
    assert first.startswith("| good/setup.xml | ")
    assert first.count("|") == len(table.HEADS) + 1
    assert last.startswith("| bad/setup.xml | no comparison: ")
    assert "nowhere.mot" in last
    assert last in capsys.readouterr().out
