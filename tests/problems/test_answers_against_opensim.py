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
#: Optima in closed form, of equations in accelerations and in moments.
EXACT = 1e-9


def check(found: table.Comparison) -> None:
    assert set(found.solved) == {found.frames}
    assert 5 < found.claimed[-1] == found.counted[-1] == found.asked <= 22
    assert found.counted[-1] >= max(found.counted[:-1])
    assert 0 < found.as_it_stands.activation < OPENSIM
    assert found.sharp.activation < TIGHT
    assert found.own_problem.activation < EXACT
    assert found.from_optimum.activation < EXACT
    if found.sharp.actuator:
        assert found.sharp.control < TIGHT
        assert found.own_problem.control < EXACT
        assert found.from_optimum.control < EXACT
    assert found.missed < 1e-5 * found.largest_moment
    assert str(found).count("|") == len(table.HEADS) + 1


def test_an_example_beside_opensim() -> None:
    check(table.compare(example_folder("elbow") / "setup.xml"))


def test_arm26_beside_opensim(shared_data: Path) -> None:
    check(table.compare(shared_data / "arm26" / "arm26_millard_Setup_StaticOptimization.xml"))


def test_a_gap_is_at_least_the_square_of_the_distance_from_the_optimum() -> None:
    """So an answer that counts cannot be far from the optimum, whatever it misses."""
    rng = np.random.default_rng(3)
    problem = {
        "lower": np.array([0.01] * 6 + [-np.inf] * 2),
        "upper": np.array([1.0] * 6 + [np.inf] * 2),
        "matrices": rng.normal(size=(5, 2, 8)),
    }
    x = rng.uniform(0.1, 0.9, size=(5, 8))
    goals = np.einsum("kcx,kx->kc", problem["matrices"], x)
    best = table.optimum(problem["lower"], problem["upper"], problem["matrices"], goals)
    problem |= {"wanted": goals, "accelerations": 0 * goals}
    gap = table.distances(problem, x)
    # less what the objective's rounding may hide
    np.testing.assert_allclose(gap, (x**2).sum(axis=1) - (best**2).sum(axis=1), rtol=0, atol=1e-12)
    assert (gap >= ((x - best) ** 2).sum(axis=1) - 1e-12).all()
    np.testing.assert_allclose(table.distances(problem, best), 0, atol=1e-12)
    # not a number, and misses that are too large, the second of them not against the motion's own size
    x[2, 0] = np.nan
    problem["wanted"] = goals + np.array([0, 0, 0, 0.01, 0.01])[:, None]
    problem["accelerations"] = goals * 0 + np.array([0, 0, 0, 0, 100])[:, None]
    assert np.isfinite(table.distances(problem, x)).tolist() == [True, True, False, False, True]


def test_what_opensim_says_of_itself_is_read_frame_by_frame(tmp_path: Path, monkeypatch) -> None:
    """Frames without a line, with a failure or a miss are not taken for converged, however late the time."""
    said = (
        "[warning] could not find a solution at time = 1667315607.81467.\n"
        "time = 1667315607.81467 Performance = 1 Constraint violation = 1e-09\n"
        "time = 1667315608.5 Performance = 1 Constraint violation = 0.002\n"
        "time = 1667315609.5 Performance = 1 Constraint violation = 2e-08\n"
    )
    time = np.array([1667315607.8146701, 1667315608.5, 1667315609.5, 1667315610.5])

    def run(folder: Path, *_: object) -> str:
        write_motion(folder / "x_activation.sto", time, {"a": 0 * time})
        return said

    monkeypatch.setattr(table, "_run_opensim", run)
    found = table.ask_opensim(tmp_path / "setup.xml", tmp_path / "results", False)
    np.testing.assert_array_equal(found.violation, [1e-9, 0.002, 2e-8, np.inf])
    assert found.is_claimed.tolist() == [False, False, True, False]


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
