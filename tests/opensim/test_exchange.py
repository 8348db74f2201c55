"""Jobs and results survive the way to a worker and back."""

from pathlib import Path

import numpy as np

from scso_nlp.opensim.worker.exchange import (
    Job,
    Table,
    read_job,
    read_result,
    write_frames,
    write_header,
    write_job,
)


def _table(n_columns: int) -> Table:
    rng = np.random.default_rng(n_columns)
    labels = tuple(f"/joint/é{i}/value" for i in range(n_columns))
    values, first, second = rng.normal(size=(3, 4, n_columns))
    return Table(labels=labels, time=np.linspace(0, 1, 4), values=values, first=first, second=second)


def test_a_job_is_read_as_it_was_written(tmp_path: Path) -> None:
    for speeds, recorded in ((None, None), (_table(2), np.eye(4))):
        settings = {"model": "a.osim", "final_time": None, "external_loads": "x.xml"}
        unusable = {"/joint/é1/value": "nan at t = 0 s"}
        rows, inputs = np.array([1, 3]), {"a.osim": "ab" * 32}
        job = Job(
            settings=settings,
            motion=_table(3),
            recorded=recorded,
            rows=rows,
            unusable=unusable,
            speeds=speeds,
            inputs=inputs,
        )
        write_job(tmp_path, job, "<ExternalLoads/>")
        found = read_job(tmp_path)
        loads = Path(found.settings["external_loads"])
        assert loads.read_text() == "<ExternalLoads/>"
        assert {**found.settings, "external_loads": "x.xml"} == job.settings
        assert found.unusable == job.unusable
        assert found.inputs == job.inputs
        np.testing.assert_array_equal(found.rows, rows)
        assert (found.recorded is None) == (recorded is None)
        np.testing.assert_array_equal(found.recorded, recorded)
        for one, other in ((job.motion, found.motion), (job.speeds, found.speeds)):
            if one is None or other is None:
                assert one is other
                continue
            assert one.labels == other.labels
            for name in ("time", "values", "first", "second"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_the_frames_of_all_workers_are_read_in_their_order(tmp_path: Path) -> None:
    def frame(time: float, n_points: int) -> dict[str, np.ndarray]:
        return {
            "trajectory.time": np.array([time]),
            "curvature.is_uncertain": np.array([[time > 0.25]]),
            "skeleton.path_points": np.ones((1, 2, n_points, 3)),
            "skeleton.path_point_bodies": np.full((1, 2, n_points), 7, dtype=np.int16),
            "skeleton.path_point_moves": np.ones((1, 2, n_points), dtype=bool),
        }

    write_frames(tmp_path, 0, 0, [frame(0.1, 2), frame(0.2, 4)])
    write_frames(tmp_path, 0, 1, [frame(0.3, 4)])
    write_header(tmp_path, 0, {"actuators": {"max_control": [np.inf]}})
    write_header(tmp_path, 1, {"actuators": {}})  # a worker without frames
    for block in range(11):  # not in the order of their names
        write_frames(tmp_path, 2, block, [frame(0.4 + block, 3)])
    write_header(tmp_path, 2, {"actuators": {"max_control": [2.0]}})
    found = read_result(tmp_path, 3)
    assert found.headers == [{"actuators": {"max_control": [limit]}} for limit in (np.inf, 2.0)]
    times = [0.1, 0.2, 0.3, *(0.4 + block for block in range(11))]
    assert found.arrays["trajectory.time"].tolist() == times
    assert found.arrays["curvature.is_uncertain"].tolist() == [[time > 0.25] for time in times]
    bodies = found.arrays["skeleton.path_point_bodies"]
    assert bodies.dtype == np.int16
    assert bodies[0].tolist() == [[7, 7, -1, -1]] * 2
    assert (bodies[1:3] == 7).all()
    assert bodies[-1].tolist() == [[7, 7, 7, -1]] * 2
    assert found.arrays["skeleton.path_points"].shape == (14, 2, 4, 3)
    assert not any(array.flags.writeable for array in found.arrays.values())
