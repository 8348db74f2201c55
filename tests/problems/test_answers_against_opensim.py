"""The table beside OpenSim: its numbers on small setups, and what it does where OpenSim cannot follow."""

from pathlib import Path

import numpy as np
import pytest
from tiny_model import setup_text, write_motion, write_tiny

from problems.benchmarks import answers_against_opensim as table
from problems.benchmarks.setups import write_setups
from scso_nlp.examples import example_folder
from scso_nlp.opensim.setup_xml import read_analyze_setup

pytestmark = pytest.mark.opensim

#: OpenSim's answers differ from the exact optimum of the same problem by about 1e-3, at most 1e-2 [-].
OPENSIM = 1e-2
#: With a tight criterion both are optimal.
TIGHT = 1e-4


def check(found: table.Comparison) -> None:
    assert set(found.solved) == {found.frames}
    assert 5 < found.solved_tight[0] == found.solved_tight[1] <= 22
    assert 0 < found.as_it_stands.activation < OPENSIM
    assert found.tight.activation < TIGHT
    assert found.from_optimum.activation < TIGHT
    if found.tight.actuator:
        assert found.tight.control < TIGHT
        assert found.from_optimum.control < TIGHT
    assert found.missed < 1e-5 * found.largest_moment
    assert str(found).count("|") == len(table.HEADS) + 1


def test_an_example_beside_opensim() -> None:
    check(table.compare(example_folder("elbow") / "setup.xml"))


def test_arm26_beside_opensim(shared_data: Path) -> None:
    check(table.compare(shared_data / "arm26" / "arm26_millard_Setup_StaticOptimization.xml"))


def test_the_table_is_printed_and_written(tmp_path: Path, monkeypatch, capsys) -> None:
    """A setup without an answer has a row that says why."""
    missing, output = tmp_path / "setup.xml", tmp_path / "table.md"
    tiny = write_tiny(tmp_path)
    tiny.setup.write_text(setup_text(coordinates_file="nowhere.mot"))
    monkeypatch.setattr("sys.argv", ["table", str(missing), "--output", str(output)])
    table.main()
    row = output.read_text().splitlines()[-1]
    assert row.startswith(f"| {tmp_path.name}/setup.xml | no comparison: ")
    assert "nowhere.mot" in row
    assert row in capsys.readouterr().out


@pytest.mark.parametrize(
    ("step", "cutoff", "expected"), [(3e-6, "8", True), (3e-6, "-1", False), (5e-3, "8", False)]
)
def test_without_filter_where_opensim_would_resample_without_end(
    step: float, cutoff: str, expected: bool, tmp_path: Path
) -> None:
    tiny = write_tiny(tmp_path)
    time = np.append(np.linspace(0, 1, 101), 1 + step)
    write_motion(tiny.moving, time, {"shoulder_flexion": time, "elbow_flexion": time})
    tiny.setup.write_text(setup_text(lowpass_cutoff_frequency_for_coordinates=cutoff))
    assert table.is_unfilterable(read_analyze_setup(tiny.setup).motion) == expected


def test_setups_of_data_that_have_none_can_be_read(shared_data: Path, tmp_path: Path) -> None:
    made = write_setups(shared_data, tmp_path)
    assert len({setup.parent.name for setup in made}) == len(made) >= 8
    for setup in made:
        motion = read_analyze_setup(setup).motion
        assert all(path.is_file() for path in motion.files())
