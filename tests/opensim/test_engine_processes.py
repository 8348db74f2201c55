"""Worker processes, caching and refused input."""

import dataclasses
import logging
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
import time
import zipfile
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from tiny_model import Tiny, setup_text, write_motion

from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.exceptions import DataError, EngineError, FileFormatError, NameMismatchError, ScsoError
from scso_nlp.figures.muscle_lines import plot_muscle_lines
from scso_nlp.files import lock, sha256
from scso_nlp.io.bundle import load_bundle, read_provenance
from scso_nlp.opensim import crew, engine, workers
from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.setup_xml import read_analyze_setup
from scso_nlp.opensim.worker.exchange import Result

pytestmark = pytest.mark.opensim


def assert_identical(one: object, other: object) -> None:
    """Every field the same to the last bit."""
    for item in dataclasses.fields(one):  # type: ignore[arg-type]
        a, b = getattr(one, item.name), getattr(other, item.name)
        if dataclasses.is_dataclass(a):
            assert_identical(a, b)
        elif isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, err_msg=item.name)
        else:
            assert a == b, item.name


@pytest.mark.parametrize("case", ["tiny", "walking3d"])
def test_the_number_of_processes_does_not_change_one_bit(
    case: str, tiny: Tiny, request: pytest.FixtureRequest
) -> None:
    setup, changes = tiny.setup, {"stability_axes": (("elbow", "z"), ("elbow", "x"))}
    changes |= {"curvature_coordinates": "all", "joint_reactions": "all"}
    if case == "walking3d":
        setup = request.getfixturevalue("shared_data") / case / "setup_static_optimization.xml"
        changes = {"final_time": 0.7, "stability_axes": (("hip_r", "x"),)}
        changes["curvature_coordinates"] = ("hip_flexion_r", "knee_angle_r", "ankle_angle_r")
        changes["joint_reactions"] = ("walker_knee_r",)
    alone, *others = (load_motion(setup, processes=n, **changes) for n in (1, 2, 3))
    for other in others:
        assert_identical(alone, other)


def test_the_range_of_a_filtered_motion_is_what_was_recorded(tiny: Tiny) -> None:
    trajectory = load_motion(tiny.setup, initial_time=-math.inf, final_time=math.inf).trajectory
    assert trajectory.time[0] == pytest.approx(0, abs=0.01)
    assert trajectory.time[-1] == pytest.approx(1, abs=0.01)


def test_a_second_load_from_the_cache_needs_no_opensim(tiny: Tiny, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tiny.folder / "cache"
    first = load_motion(tiny.setup, cache=cache, curvature_coordinates="all")
    (bundle,) = cache.iterdir()
    provenance = read_provenance(bundle)
    assert str(tiny.model) in provenance.inputs
    assert str(tiny.folder / "hand.mot") in provenance.inputs

    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "Popen", _forbidden)
        again = load_motion(tiny.setup, cache=cache, curvature_coordinates="all")
        assert_identical(first, again)
        tiny.model.write_text(tiny.model.read_text().replace("<mass>2.0</mass>", "<mass>2.5</mass>"))
        with pytest.raises(AssertionError, match="started a process"):
            load_motion(tiny.setup, cache=cache)
    heavier = load_motion(tiny.setup, cache=cache)
    assert len(list(cache.iterdir())) == 2
    assert np.abs(heavier.trajectory.generalized_forces - first.trajectory.generalized_forces).max() > 0.05


def test_a_change_in_any_file_that_decides_makes_the_cache_old(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache, worker = tiny.folder / "cache", tiny.folder / "worker"
    shutil.copytree(engine.WORKER, worker, ignore=shutil.ignore_patterns("__pycache__"))
    preparation = Path(shutil.copy(engine.PREPARATION, tiny.folder))
    load_motion(tiny.setup, cache=cache)
    monkeypatch.setattr(engine, "WORKER", worker)
    monkeypatch.setattr(engine, "PREPARATION", preparation)
    monkeypatch.setattr(crew, "extract", _forbidden)
    load_motion(tiny.setup, cache=cache)
    files = [preparation, *sorted(worker.glob("*.py"))]
    assert {"__init__.py", "model.py", "paths.py", "elimination.py"} <= {file.name for file in files}
    for file in files:
        before = file.read_bytes()
        file.write_bytes(before + b"# changed\n")
        with pytest.raises(AssertionError, match="started a process"):
            load_motion(tiny.setup, cache=cache)
        file.write_bytes(before)
    load_motion(tiny.setup, cache=cache)


def _heavier(path: Path) -> None:
    path.write_text(path.read_text() + "\n")


def _forbidden(*_: object, **__: object) -> None:
    raise AssertionError("started a process")


def test_a_damaged_cache_is_computed_again(tiny: Tiny, caplog: pytest.LogCaptureFixture) -> None:
    cache = tiny.folder / "cache"
    first = load_motion(tiny.setup, cache=cache)
    (bundle,) = cache.iterdir()
    bundle.write_bytes(bundle.read_bytes()[:1000])
    again = load_motion(tiny.setup, cache=cache)
    assert_identical(first, again)
    assert any("computed again" in message for message in caplog.messages)


@pytest.mark.parametrize("spoil", [_heavier, Path.unlink], ids=["edited", "removed"])
@pytest.mark.parametrize("file", ["tiny.osim", "reserves.xml", "touching.obj"])
def test_a_file_that_changes_before_opensim_has_read_it_is_refused_and_nothing_is_cached(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch, file: str, spoil: Callable[[Path], object]
) -> None:
    mesh = tiny.folder / "touching.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    ground = "<socket_frame>/ground</socket_frame>"
    surface = f"<ContactMesh><filename>{mesh.name}</filename>{ground}</ContactMesh>"
    _replace(
        tiny.model,
        "<ForceSet",
        f"<ContactGeometrySet><objects>{surface}</objects></ContactGeometrySet><ForceSet",
    )
    cache, start = tiny.folder / "cache", workers._start

    def later(folder: Path, part: int) -> subprocess.Popen[str]:
        spoil(tiny.folder / file)
        monkeypatch.setattr(workers, "_start", start)
        return start(folder, part)

    monkeypatch.setattr(workers, "_start", later)
    with pytest.raises(DataError) as refused:
        load_motion(tiny.setup, cache=cache, processes=1)
    name = tiny.folder / file
    assert (
        str(refused.value) == f"{name} was changed or removed while it was read; run again, nothing was kept"
    )
    assert list(cache.iterdir()) == []


def test_a_file_that_changes_once_it_was_read_costs_nothing_and_has_the_hash_of_what_was_read(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = sha256(tiny.model), sha256(tiny.moving)
    expected = load_motion(tiny.setup)
    work = crew._Crew.work

    def edit_afterwards(self: crew._Crew) -> Result:
        tiny.moving.unlink()
        (tiny.folder / "hand.mot").unlink()
        found = work(self)
        _heavier(tiny.model)
        return found

    monkeypatch.setattr(crew._Crew, "work", edit_afterwards)
    setup = read_analyze_setup(tiny.setup)
    found, inputs = engine.load_with_hashes(setup.motion, cache=tiny.folder / "cache")
    assert_identical(found, expected)
    assert (inputs[str(tiny.model)], inputs[str(tiny.moving)]) == read
    (bundle,) = (tiny.folder / "cache").iterdir()
    assert read_provenance(bundle).inputs == inputs


def test_every_flipped_bit_of_a_cached_motion_is_harmless_or_noticed(tiny: Tiny, tmp_path: Path) -> None:
    """One bit of each byte of all names and directories, and of a sample of the numbers."""
    cache = tiny.folder / "cache"
    first = load_motion(tiny.setup, cache=cache, initial_time=0.5, final_time=0.5)
    (bundle,) = cache.iterdir()
    content = bundle.read_bytes()
    rng = np.random.default_rng(5)
    with zipfile.ZipFile(bundle) as archive:
        heads = [range(item.header_offset, item.header_offset + 200) for item in archive.infolist()]
        directory = range(archive.start_dir, len(content))
    for place in {*chain(*heads, directory), *rng.integers(len(content), size=300).tolist()}:
        flipped = bytearray(content)
        flipped[place] ^= 1 << int(rng.integers(8))
        damaged = tmp_path / "damaged.npz"
        damaged.write_bytes(flipped)
        try:
            found = load_bundle(damaged)
        except DataError:
            continue
        assert_identical(found, first)


def test_a_cache_that_is_full_costs_no_motion(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(path: Path, *_: object, **__: object) -> None:
        raise DataError(f"{path} cannot be written: No space left on device")

    monkeypatch.setattr(engine, "save_bundle", full)
    assert load_motion(tiny.setup, cache=tiny.folder / "cache").n_frames == 71
    assert "the motion is not cached: " in caplog.text


def test_nothing_of_opensims_chatter_reaches_the_terminal(
    tiny: Tiny, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, logger="scso_nlp")
    load_motion(tiny.setup, progress=False)
    out, err = capfd.readouterr()
    assert out == ""
    assert err == ""
    assert any("peak memory" in message for message in caplog.messages)


@pytest.mark.parametrize("first", ["opensim", "casadi"])
def test_it_works_beside_casadi_and_after_someone_imported_opensim(first: str, tiny: Tiny) -> None:
    """`import opensim` leaves LD_LIBRARY_PATH behind, for all children of the process."""
    script = f"""
        import os
        import {first}
        before = dict(os.environ)
        from scso_nlp import load_motion
        trajectory = load_motion({str(tiny.setup)!r}, processes=1).trajectory
        assert dict(os.environ) == before
        print(trajectory.n_frames)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=Path(__file__).parents[2],
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) == 71


def test_workers_run_the_copy_of_the_package_that_starts_them(tiny: Tiny) -> None:
    """Even if another one is installed, and whatever lies in the current folder."""
    copy = tiny.folder / "scso_nlp"
    shutil.copytree(Path(crew.__file__).parents[1], copy, ignore=shutil.ignore_patterns("__pycache__"))
    _replace(
        copy / "opensim" / "worker" / "muscles.py", "getMaxIsometricForce()", "getMaxIsometricForce() + 1"
    )
    (tiny.folder / "opensim.py").write_text("raise ImportError('a script of the user')")
    script = f"""
        from scso_nlp import load_motion
        muscles = load_motion({str(tiny.setup)!r}, processes=1).muscles
        print(muscles.max_isometric_force[0])
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tiny.folder,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == 801


def test_the_environment_of_workers_has_no_folder_with_a_foreign_casadi(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign, plain = tmp_path / "foreign", tmp_path / "plain"
    for folder in (foreign, plain):
        folder.mkdir()
    (foreign / "libcasadi.so.3.7").touch()
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{foreign}{os.pathsep}{plain}")
    assert workers.worker_environment()["LD_LIBRARY_PATH"] == str(plain)
    assert os.environ["LD_LIBRARY_PATH"] == f"{foreign}{os.pathsep}{plain}"


def _children() -> list[int]:
    found = []
    for task in Path("/proc/self/task").iterdir():
        found += [int(pid) for pid in (task / "children").read_text().split()]
    return found


#: Makes a worker take its time over every frame.
SLOW = """
import time
from scso_nlp.opensim.worker.extraction import Extraction
fast = Extraction.frame
Extraction.frame = lambda self, row: (time.sleep(0.05), fast(self, row))[1]
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds the worker in /proc")
@pytest.mark.parametrize("moment", ["start", "half-way"])
def test_a_worker_killed_from_outside_ends_the_run_with_its_name(
    moment: str, tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the same worker, but slow enough to be met half-way
    program = workers.PROGRAM.replace("sys.exit(main(", SLOW + "sys.exit(main(")
    monkeypatch.setattr(workers, "PROGRAM", program)
    assert SLOW in workers.PROGRAM
    before = set(_children())
    seen: list[int] = []

    def kill_one() -> None:
        until = time.monotonic() + 20
        while time.monotonic() < until:
            started = [pid for pid in _children() if pid not in before]
            if len(started) == 2:
                seen.extend(started)
                time.sleep(0.0 if moment == "start" else 1.6)
                os.kill(started[1], signal.SIGKILL)
                return
            time.sleep(0.01)

    killer = threading.Thread(target=kill_one)
    killer.start()
    cache = tiny.folder / "cache"
    with pytest.raises(EngineError, match=r"was ended by SIGKILL \(signal 9\)") as failure:
        load_motion(tiny.setup, processes=2, cache=cache, initial_time=0.0, final_time=1.0)
    killer.join()
    assert re.search(r"before its first frame|after \d+ of its \d+ frames", str(failure.value))
    assert not set(_children()) & set(seen), "the other worker was left behind"
    assert not list(cache.glob("*"))


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds the worker in /proc")
def test_a_worker_that_gets_no_further_is_ended_with_a_sentence(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crew, "SILENCE", 3.0)
    monkeypatch.setattr(workers, "PATIENCE", 0.5)
    before = set(_children())
    seen: list[int] = []
    start = workers._start

    def stopped(folder: Path, part: int) -> subprocess.Popen[str]:
        process = start(folder, part)
        seen.append(process.pid)
        os.kill(process.pid, signal.SIGSTOP)
        return process

    monkeypatch.setattr(workers, "_start", stopped)
    with pytest.raises(EngineError, match=r"worker 1 of 1 got no further for 3 s before its first frame"):
        load_motion(tiny.setup, processes=1)
    assert len(seen) == 1
    assert not set(_children()) - before


@pytest.mark.skipif(os.name != "posix", reason="locks of folders")
def test_folders_of_killed_programs_are_removed_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    names = {what: tmp_path / f"{workers.TEMPORARY}{what}" for what in ("killed", "running", "empty")}
    for folder in names.values():
        folder.mkdir()
    for what in ("killed", "running"):
        (names[what] / "job.json").touch()
    (tmp_path / "scso_of_mine").mkdir()
    (tmp_path / "scso_of_mine" / "job.json").touch()
    descriptor = lock(names["running"])
    assert descriptor is not None
    try:
        with pytest.raises(BlockingIOError):
            lock(names["running"])
        with workers._own_folder() as own:
            left = {path for path in tmp_path.iterdir() if path != own}
            assert left == {names["running"], tmp_path / "scso_of_mine"}
    finally:
        os.close(descriptor)
    assert not own.exists()


@pytest.mark.skipif(os.name != "posix", reason="locks of folders")
def test_a_folder_that_another_run_takes_for_an_orphan_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    taken: list[Path] = []

    def late(folder: Path, *, wait: bool = False) -> int | None:
        if not taken:
            taken.append(folder)
            folder.rmdir()
        return lock(folder, wait=wait)

    monkeypatch.setattr(workers, "lock", late)
    with workers._own_folder() as own:
        assert own.is_dir()
        assert own not in taken
        with pytest.raises(BlockingIOError):
            lock(own)
    assert list(tmp_path.iterdir()) == []


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def _no_column(tiny: Tiny) -> None:
    _replace(tiny.moving, "elbow_flexion", "elbow_angle")


def _not_a_number(tiny: Tiny) -> None:
    lines = tiny.moving.read_text().splitlines()
    cells = lines[30].split("\t")
    lines[30] = "\t".join([cells[0], "nan", *cells[2:]])
    tiny.moving.write_text("\n".join(lines) + "\n")


def _weak_model(tiny: Tiny) -> None:
    _replace(
        tiny.model,
        "<optimal_fiber_length>0.15</optimal_fiber_length>",
        "<optimal_fiber_length>0.15</optimal_fiber_length><minimum_activation>-1</minimum_activation>",
    )


def _few_frames(tiny: Tiny) -> None:
    write_motion(
        tiny.moving, np.linspace(0, 1, 4), {"shoulder_flexion": np.zeros(4), "elbow_flexion": np.zeros(4)}
    )


BAD_INPUT = {
    "a column that is not there": (
        _no_column,
        NameMismatchError,
        "moving.mot has no column for elbow_flexion, coordinates of tiny.osim",
    ),
    "not a number": (
        _not_a_number,
        DataError,
        "moving.mot: column 'shoulder_flexion' is nan at t = 0.23 s",
    ),
    "a model that OpenSim refuses": (
        _weak_model,
        EngineError,
        "OpenSim refused tiny.osim: .*minimum_activation.*in Component '/forceset/",
    ),
    "too short a motion": (_few_frames, DataError, "has 4 frames, expected at least 6"),
    "a missing model": (lambda tiny: tiny.model.unlink(), DataError, "model_file 'tiny.osim' does not exist"),
    "a missing load file": (
        lambda tiny: (tiny.folder / "hand.mot").unlink(),
        DataError,
        "datafile 'hand.mot' does not exist",
    ),
    "a load column that is not there": (
        lambda tiny: _replace(tiny.loads, "hand_v<", "hand_q<"),
        NameMismatchError,
        "the load 'hand' needs three columns that start with 'hand_q', found none",
    ),
    "a load that ends too early": (
        lambda tiny: write_motion(
            tiny.folder / "hand.mot",
            np.linspace(0, 0.5, 51),
            {f"hand_{kind}{axis}": np.zeros(51) for kind in "vp" for axis in "xyz"},
        ),
        DataError,
        "covers 0 to 0.5 s, expected the analyzed range",
    ),
    "a truncated model": (
        lambda tiny: tiny.model.write_text(tiny.model.read_text()[:900]),
        FileFormatError,
        "tiny.osim is not well-formed XML",
    ),
    "a force set that is none": (
        lambda tiny: tiny.actuators.write_text("<OpenSimDocument><Model/></OpenSimDocument>"),
        FileFormatError,
        "reserves.xml holds Model, expected ForceSet",
    ),
    "an actuator for no coordinate": (
        lambda tiny: _replace(tiny.actuators, "<coordinate>elbow_flexion", "<coordinate>wrist"),
        EngineError,
        "OpenSim refused tiny.osim: .*wrist",
    ),
    "a body for the load that is not there": (
        lambda tiny: _replace(tiny.loads, "<applied_to_body>lower", "<applied_to_body>hand"),
        EngineError,
        "OpenSim refused tiny.osim: .*'hand'",
    ),
    "an actuator that is not scalar": (
        lambda tiny: _replace(
            tiny.actuators,
            "</objects>",
            '<BodyActuator name="six"><socket_body>/bodyset/lower</socket_body></BodyActuator></objects>',
        ),
        DataError,
        "the actuator six \\(BodyActuator\\) is not a scalar actuator",
    ),
}


@pytest.mark.parametrize("what", BAD_INPUT)
def test_bad_input_is_refused_in_one_sentence(what: str, tiny: Tiny) -> None:
    spoil, kind, message = BAD_INPUT[what]
    spoil(tiny)
    with pytest.raises(kind, match=message) as failure:
        load_motion(tiny.setup, processes=1)
    assert "\n" not in str(failure.value)
    assert len(str(failure.value)) < 500


def _no_speed_limit(tiny: Tiny) -> None:
    limit = "<max_contraction_velocity>0</max_contraction_velocity>"
    _replace(tiny.model, "<max_isometric_force>", f"{limit}<max_isometric_force>")


def test_a_largest_velocity_of_zero_is_taken_where_opensim_takes_it_and_said(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    _replace(tiny.model, "Millard2012EquilibriumMuscle", "Schutte1993Muscle_Deprecated")
    limited = load_motion(tiny.setup, processes=1)
    _no_speed_limit(tiny)
    caplog.clear()
    found = load_motion(tiny.setup, processes=1)
    assert (found.muscles.max_contraction_velocity == 0).all()
    velocity, capacity = found.trajectory.muscle_tendon_velocity, found.trajectory.active_force_capacity
    assert (capacity[velocity < 0] == 0).all()
    assert (capacity >= 0).all()
    assert (capacity[velocity > 0] > 0).any()
    same = dataclasses.replace(
        found.trajectory, active_force_capacity=limited.trajectory.active_force_capacity
    )
    assert_identical(same, limited.trajectory)
    assert [text for text in caplog.messages if "max_contraction_velocity" in text] == [
        "max_contraction_velocity is 0 in 3 muscle(s), flexor, wrapped, through_slider: OpenSim gives them "
        "no active force while they shorten; set it in the model, or choose muscle_model = none"
    ]


def test_a_muscle_that_opensim_has_no_force_for_is_named(tiny: Tiny) -> None:
    _no_speed_limit(tiny)
    with pytest.raises(DataError) as failure:
        load_motion(tiny.setup, processes=1)
    assert re.fullmatch(
        r"tiny.osim: OpenSim's active force of 'flexor' \(Millard2012EquilibriumMuscle\) is nan at "
        r"t = 0\.\d+ s, expected a finite number: check its parameters in the model "
        r"\(max_contraction_velocity is 0 1/s\)",
        str(failure.value),
    )


def test_the_real_model_that_opensim_refuses_is_named_with_the_reason(shared_data: Path) -> None:
    with pytest.raises(
        EngineError,
        match=r"OpenSim refused arm26\.osim: .*Minimum activation cannot be less than 0\.01.*TRIlong",
    ):
        load_motion(shared_data / "arm26" / "arm26_Setup_StaticOptimization.xml")


def test_names_of_stability_axes_and_settings_are_checked(tiny: Tiny) -> None:
    with pytest.raises(NameMismatchError, match=r"unknown joint 'knee'.*shoulder, elbow, sliding"):
        load_motion(tiny.setup, stability_axes=(("knee", "z"),))
    with pytest.raises(DataError, match="the axis 'w', expected x, y or z"):
        load_motion(tiny.setup, stability_axes=(("elbow", "w"),))
    with pytest.raises(TypeError, match="unexpected keyword argument 'end_time'"):
        load_motion(tiny.setup, end_time=1.0)
    with pytest.raises(DataError, match="needs a setup file"):
        load_motion()
    with pytest.raises(DataError, match="processes is 0"):
        load_motion(tiny.setup, processes=0)


def test_a_light_end_segment_may_lack_its_column_but_says_so(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    _no_column(tiny)
    trajectory = load_motion(tiny.setup, held_coordinates=("elbow_flexion",)).trajectory
    assert (trajectory.coordinate_values[:, 1] == 0).all()
    _replace(tiny.model, "<mass>1.5</mass>", "<mass>0.01</mass>")
    setup = tiny.folder / "unloaded.xml"
    setup.write_text(setup_text(external_loads_file=""))
    load_motion(setup)
    assert any("held at zero, as OpenSim does" in message for message in caplog.messages)


def test_a_locked_coordinate_is_eliminated_at_its_default(tiny: Tiny) -> None:
    _replace(
        tiny.model,
        '<Coordinate name="shoulder_flexion">',
        '<Coordinate name="shoulder_flexion"><default_value>0.25</default_value><locked>true</locked>',
    )
    trajectory = load_motion(tiny.setup).trajectory
    assert trajectory.coordinates == ("elbow_flexion",)
    skeleton = trajectory.skeleton
    assert skeleton is not None
    elbow = skeleton.joint_centers[0, skeleton.joints.index("elbow")]
    np.testing.assert_allclose(elbow, [0.3 * np.sin(0.25), 1 - 0.3 * np.cos(0.25), 0], atol=1e-9)


def test_a_states_file_gives_the_same_as_its_coordinates_and_speeds(tiny: Tiny) -> None:
    """Angles of a polynomial, so that the spline's speeds are exact away from its natural ends."""
    t = np.linspace(0, 1, 201)
    shoulder, elbow = 0.2 + 0.3 * t - 0.2 * t**2, 0.5 + 0.4 * t**2
    rates = 0.3 - 0.4 * t, 0.8 * t
    motion = write_motion(tiny.folder / "m.sto", t, {"shoulder_flexion": shoulder, "elbow_flexion": elbow})
    states = write_motion(
        tiny.folder / "states.sto",
        t,
        {
            "/jointset/shoulder/shoulder_flexion/value": shoulder,
            "/jointset/shoulder/shoulder_flexion/speed": rates[0],
            "/jointset/elbow/elbow_flexion/value": elbow,
            "/jointset/elbow/elbow_flexion/speed": rates[1],
        },
    )
    speeds = write_motion(
        tiny.folder / "u.sto", t, {"shoulder_flexion_u": rates[0], "elbow_flexion_u": rates[1]}
    )
    common = {"model": tiny.model, "initial_time": 0.4, "final_time": 0.6}
    by_states = load_motion(states=states, **common).trajectory
    by_speeds = load_motion(coordinates=motion, speeds=speeds, **common).trajectory
    by_spline = load_motion(coordinates=motion, **common).trajectory
    assert_identical(by_states.skeleton, by_speeds.skeleton)
    np.testing.assert_allclose(by_states.generalized_forces, by_speeds.generalized_forces, atol=1e-12)
    # the spline is natural at its ends; what is left of that in the middle of 200 intervals
    np.testing.assert_allclose(by_states.generalized_forces, by_spline.generalized_forces, atol=1e-6)


def test_a_header_that_names_the_wrong_unit_is_reported(tiny: Tiny, caplog: pytest.LogCaptureFixture) -> None:
    """Degrees under inDegrees=no turn a joint many times; an old .mot is degrees to OpenSim in any case."""
    t = np.linspace(0, 1, 51)
    degrees = {"shoulder_flexion": 10 + 20 * t, "elbow_flexion": 5 * t}
    common = {"model": tiny.model, "initial_time": 0.4, "final_time": 0.6}
    motion = write_motion(tiny.folder / "wrong.sto", t, degrees)
    load_motion(coordinates=motion, **common)
    (message,) = (text for text in caplog.messages if "more than two turns" in text)
    assert message.startswith(f"{motion}: more than two turns in shoulder_flexion when read in radians")
    assert message.endswith("in_degrees = true reads it the other way")
    caplog.clear()
    load_motion(coordinates=motion, in_degrees=True, **common)
    assert not any("two turns" in text for text in caplog.messages)
    assert any("read in degrees, although its header says otherwise" in text for text in caplog.messages)
    caplog.clear()
    old = write_motion(tiny.folder / "old.mot", t, {name: np.deg2rad(v) for name, v in degrees.items()})
    _replace(old, "version=1\n", "")
    load_motion(coordinates=old, **common)
    assert [text for text in caplog.messages if "inDegrees=no" in text] == [
        f"{old}: radians, as its inDegrees=no says, "
        "but OpenSim reads .mot files without a version line in degrees"
    ]


def test_a_setup_of_windows_reads_the_same(tiny: Tiny) -> None:
    expected = load_motion(tiny.setup)
    (tiny.folder / "sub").mkdir()
    setup = tiny.folder / "sub" / "windows.xml"
    setup.write_text(
        setup_text(
            model_file=" ..\\tiny.osim ",
            force_set_files=" ..\\reserves.xml ",
            coordinates_file="..\\moving.mot",
            external_loads_file="..\\loads.xml",
        )
    )
    _replace(tiny.loads, "hand.mot", ".\\hand.mot")
    found = load_motion(setup)
    assert_identical(expected, found)


def test_every_failure_of_a_setup_is_an_error_of_this_package(tiny: Tiny) -> None:
    for position in range(0, len(tiny.setup.read_text()), 37):
        cut = tiny.folder / "cut.xml"
        cut.write_text(tiny.setup.read_text()[:position])
        with pytest.raises(ScsoError):
            read_analyze_setup(cut)


def test_without_muscle_paths_all_else_is_the_same(tiny: Tiny) -> None:
    whole, rest = (load_motion(tiny.setup, muscle_paths=wanted) for wanted in (True, False))
    assert whole.trajectory.skeleton.path_points.shape[2] > 0
    assert rest.trajectory.skeleton.path_points.shape[2] == 0
    paths = {
        name: getattr(rest.trajectory.skeleton, name)
        for name in ("path_points", "path_point_bodies", "path_point_moves", "joint_obstacles")
    }
    skeleton = dataclasses.replace(whole.trajectory.skeleton, **paths)
    trajectory = dataclasses.replace(whole.trajectory, skeleton=skeleton)
    assert_identical(rest, dataclasses.replace(whole, trajectory=trajectory))
    with pytest.raises(
        DataError, match="has no points of muscle paths, expected some; read the motion again"
    ):
        JointStability().notes(rest)
    with pytest.raises(DataError, match="has no points of muscle paths"):
        plot_muscle_lines(rest.trajectory.skeleton, np.zeros((rest.n_frames, 1)), [0])
    with pytest.raises(DataError, match="muscle_paths is False, but stability_axes need"):
        load_motion(tiny.setup, muscle_paths=False, stability_axes=(("elbow", "z"),))
