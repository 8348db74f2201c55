"""Filter, splines and loads in the parent process against OpenSim's own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_model import Tiny, ask_opensim, write_motion

from scso_nlp.exceptions import DataError
from scso_nlp.io.storage import Storage
from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.preparation import loads_at, prepare_motion, prepare_speeds
from scso_nlp.opensim.setup_xml import MotionInput, read_analyze_setup

EVEN = np.arange(40) / 64
RNG = np.random.default_rng(5)
TIMES = {"even": EVEN, "odd": EVEN[:7], "six": 0.1 * EVEN[:6]}
TIMES["uneven"] = np.sort(0.2 + 0.02 * np.arange(41) + RNG.uniform(0, 0.008, 41))


def table(time: np.ndarray) -> Storage:
    """An angle, a place far from zero, a constant, noise, and a column that is not finite."""
    noise = RNG.normal(size=len(time))
    values = np.stack([np.sin(7 * time), 30 + 0.1 * time**3, 0 * time + 2, noise, noise], axis=1)
    values[2, 4] = np.nan
    return Storage(name="t", labels=("a", "b", "c", "d", "e"), time=time, values=values)


def motion(**settings: object) -> MotionInput:
    return MotionInput(model=Path("m.osim"), coordinates=Path("t.sto"), **settings)  # type: ignore[arg-type]


@pytest.mark.opensim
@pytest.mark.parametrize("cutoff", [None, 6.0, 100.0])
@pytest.mark.parametrize("kind", TIMES)
def test_columns_are_filtered_and_differentiated_as_by_opensim(
    kind: str, cutoff: float | None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    time = TIMES[kind]
    raw = table(time)
    found, rows = prepare_motion(motion(lowpass_cutoff_frequency=cutoff), raw)
    expected = ask_opensim(
        tmp_path, kind="prepared", time=time.tolist(), values=raw.values[:, :4].tolist(), cutoff=cutoff
    )
    np.testing.assert_array_equal(found.time, expected["time"])
    assert np.isnan(found.values[:, 4]).any()
    assert np.isnan(found.first[:, 4]).all()
    for name, tolerance in (("values", 1e-11), ("first", 1e-9), ("second", 1e-7)):
        own, theirs = getattr(found, name)[:, :4], expected[name]
        # rounding errors of a column far from zero are of its own size
        scale = np.abs(theirs).max(axis=0) + np.array([0, 30, 5, 0])
        np.testing.assert_array_less(np.abs(own - theirs).max(axis=0), tolerance * scale, err_msg=name)
    # by default all that was recorded, without what mirrors it
    for row, end in ((rows[0], time[0]), (rows[-1], time[-1])):
        assert found.time[row] <= end
        assert row == len(found.time) - 1 or found.time[row + 1] > end
    assert ("not below half the sampling frequency" in caplog.text) == (cutoff == 100.0 and kind != "six")
    assert np.abs(expected["second"][:, :2]).max() > 1


def test_rows_to_analyze_are_the_ends_and_multiples_of_the_step() -> None:
    raw = table(EVEN)
    _, rows = prepare_motion(motion(initial_time=EVEN[5] + 1e-4, final_time=EVEN[18], step_interval=4), raw)
    assert rows.tolist() == [5, 8, 12, 16, 18]
    # 20 rows mirror the start
    prepared, rows = prepare_motion(
        motion(final_time=EVEN[9], step_interval=4, lowpass_cutoff_frequency=6), raw
    )
    assert rows.tolist() == [20, 24, 28, 29]
    np.testing.assert_allclose(prepared.time[rows], EVEN[rows - 20], atol=1e-15)


def test_speeds_are_those_of_the_nearest_rows() -> None:
    prepared, rows = prepare_motion(motion(), table(EVEN))
    early = np.append(EVEN[0] - 1e-3, EVEN + 4e-7)
    values = np.arange(len(early))[:, None] * 1.0
    speeds = Storage(name="u", labels=("a_u",), time=early, values=values, source="u.sto")
    found = prepare_speeds(speeds, prepared, rows)
    np.testing.assert_array_equal(found.values, values[1:])
    np.testing.assert_allclose(found.first, 64, rtol=1e-12)
    missing = Storage(name="u", labels=("a_u",), time=early[:-1], values=values[:-1], source="u.sto")
    with pytest.raises(DataError, match=r"u\.sto has no row at t = 0\.609375 s, expected the times of"):
        prepare_speeds(missing, prepared, rows)
    prepare_speeds(missing, prepared, rows[:-1])


@pytest.mark.opensim
@pytest.mark.parametrize("n_rows", [1, 2, 3, 4, 30])
def test_loads_are_evaluated_as_by_opensim(n_rows: int, tiny: Tiny) -> None:
    """Beyond the ends, too, where a motion may begin a frame before its loads."""
    time = np.cumsum(RNG.uniform(0.01, 0.03, n_rows))
    columns = {f"hand_{kind}{axis}": RNG.normal(size=n_rows) for kind in "vp" for axis in "xyz"}
    write_motion(tiny.folder / "hand.mot", time, columns)
    ends, inside = [time[0] - 0.02, time[0], time[-1], time[-1] + 0.03], [time.mean(), time.mean() + 1e-3]
    at = np.unique([*ends, *inside])
    forces = np.stack([columns[f"hand_v{axis}"] for axis in "xyz"], axis=1)
    data = Storage(name="loads", labels=("x", "y", "z"), time=time, values=forces)
    asked = ask_opensim(tiny.folder, kind="loads", model=tiny.model, loads=tiny.loads, time=at.tolist())
    np.testing.assert_allclose(loads_at(data, at).values, asked["forces"], atol=1e-9)


@pytest.mark.opensim
def test_loads_that_do_not_apply_need_no_columns(tiny: Tiny) -> None:
    """Whatever stands beside them in the file: labels twice, and numbers that are not finite."""
    expected = load_motion(tiny.setup, processes=1).trajectory
    text = tiny.loads.read_text()
    start, end = text.index("<ExternalForce"), text.index("</objects>")
    force = text[start:end]
    off = force.replace('name="hand"', 'name="off"').replace("hand_", "no_such_column_")
    off = off.replace("<applied_to_body>", "<appliesForce>false</appliesForce><applied_to_body>")
    tiny.loads.write_text(text[:start] + off + force + text[end:])
    data = tiny.folder / "hand.mot"
    lines = data.read_text().splitlines()
    first = lines.index("endheader") + 1
    lines[first] += "\ttwice\ttwice"
    lines[first + 1 :] = [f"{line}\tnan\t1" for line in lines[first + 1 :]]
    data.write_text("\n".join(lines) + "\n")
    found = load_motion(tiny.setup, processes=1).trajectory
    assert found.other_force_labels == expected.other_force_labels
    np.testing.assert_array_equal(found.generalized_forces, expected.generalized_forces)
    tiny.loads.write_text(text[:start] + off + text[end:])
    alone = load_motion(tiny.setup, processes=1).trajectory
    unloaded = replace(read_analyze_setup(tiny.setup).motion, external_loads=None)
    without = load_motion(unloaded, processes=1).trajectory
    np.testing.assert_array_equal(alone.generalized_forces, without.generalized_forces)
    assert np.abs(without.generalized_forces - expected.generalized_forces).max() > 1
