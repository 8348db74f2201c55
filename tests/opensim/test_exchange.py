"""Jobs and results survive the way to a worker and back."""

import json
from pathlib import Path

import numpy as np

from scso_nlp.opensim.worker.exchange import (
    Job,
    Result,
    Table,
    joined,
    read_job,
    read_result,
    write_job,
    write_result,
)


def _table(n_columns: int) -> Table:
    rng = np.random.default_rng(n_columns)
    labels = tuple(f"/joint/é{i}/value" for i in range(n_columns))
    values, first, second = rng.normal(size=(3, 4, n_columns))
    return Table(labels=labels, time=np.linspace(0, 1, 4), values=values, first=first, second=second)


def test_a_job_is_read_as_it_was_written(tmp_path: Path) -> None:
    for speeds in (None, _table(2)):
        settings = {"model": "a.osim", "final_time": None, "external_loads": "x.xml"}
        unusable = {"/joint/é1/value": "nan at t = 0 s"}
        rows, inputs = np.array([1, 3]), {"a.osim": "ab" * 32}
        job = Job(
            settings=settings,
            motion=_table(3),
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
        for one, other in ((job.motion, found.motion), (job.speeds, found.speeds)):
            if one is None or other is None:
                assert one is other
                continue
            assert one.labels == other.labels
            for name in ("time", "values", "first", "second"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    arrays = {"trajectory.time": np.array([0.1, 0.2]), "curvature.is_uncertain": np.array([[True], [False]])}
    write_result(tmp_path, 1, Result(header={"actuators": {"max_control": [np.inf]}}, arrays=arrays))
    found = read_result(tmp_path, 1)
    assert json.dumps(found.header) == '{"actuators": {"max_control": [Infinity]}}'
    assert list(found.arrays) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)
        assert found.arrays[name].dtype == array.dtype


def test_frames_with_fewer_path_points_are_filled_up() -> None:
    def part(n_frames: int, n_points: int) -> dict[str, np.ndarray]:
        shape = (n_frames, 2, n_points)
        return {
            "skeleton.path_points": np.ones((*shape, 3)),
            "skeleton.path_point_bodies": np.full(shape, 7),
            "skeleton.path_point_moves": np.ones(shape, dtype=bool),
        }

    found = joined([part(1, 2), part(3, 4)])
    bodies = found["skeleton.path_point_bodies"]
    assert bodies[0].tolist() == [[7, 7, -1, -1]] * 2
    assert (bodies[1:] == 7).all()
    assert bodies.dtype == np.int64
    np.testing.assert_array_equal(found["skeleton.path_points"], (bodies >= 0)[..., None] * np.ones(3))
    np.testing.assert_array_equal(found["skeleton.path_point_moves"], bodies >= 0)
