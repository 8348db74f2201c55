"""Bundles: what goes in comes out bit by bit, and nothing else gets in."""

import dataclasses
import io
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers import motion, muscle_parameters, skeleton

from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.io.bundle import Provenance, load_bundle, read_provenance, save_bundle
from scso_nlp.motion import Motion
from scso_nlp.muscles import ActuatorParameters

Case = Motion


@pytest.fixture
def case(rng: np.random.Generator) -> Case:
    points = rng.normal(size=(3, 2, 3))
    trajectory = motion(
        rng.normal(size=(4, 2, 3)),
        rng.normal(size=(4, 2)),
        actuator_columns=rng.normal(size=(2, 1)),
        skeleton=skeleton(points, [[0, 1], [1, 0], [0, 1]], n_frames=4),
    )
    trajectory = dataclasses.replace(
        trajectory, name="lift – 1", force_columns=(*trajectory.muscles, "other")
    )
    muscles = muscle_parameters(trajectory.muscles, [100.0, 1 / 3, 1e-300])
    muscles = dataclasses.replace(
        muscles, curve_parameters=({"Af": 0.25}, {}, {"curve.slope": 0.1 + 0.2, "Flen": 1.4})
    )
    actuators = ActuatorParameters(
        actuators=trajectory.actuators, optimal_force=[3.0], min_control=[-np.inf], max_control=[np.inf]
    )
    return Motion(trajectory=trajectory, muscles=muscles, actuators=actuators)


def assert_equal(one: object, other: object) -> None:
    assert type(one) is type(other)
    for item in dataclasses.fields(one):  # type: ignore[arg-type]
        a, b = getattr(one, item.name), getattr(other, item.name)
        if dataclasses.is_dataclass(a):
            assert_equal(a, b)
        elif isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
            assert not b.flags.writeable
        else:
            assert a == b, item.name


def test_a_bundle_gives_back_every_bit(case: Case, tmp_path: Path) -> None:
    save_bundle(tmp_path / "m.npz", case)
    assert_equal(case, load_bundle(tmp_path / "m.npz"))


def test_a_motion_without_skeleton_stays_without(case: Case, tmp_path: Path) -> None:
    trajectory = dataclasses.replace(case.trajectory, skeleton=None)
    save_bundle(tmp_path / "m.npz", dataclasses.replace(case, trajectory=trajectory))
    assert load_bundle(tmp_path / "m.npz").trajectory.skeleton is None


def test_provenance_comes_back(case: Case, tmp_path: Path) -> None:
    provenance = Provenance(
        package_version="0.1",
        opensim_version="4.6",
        inputs={"model.osim": "ab" * 32},
        settings={"step_interval": 1, "states": None, "actuators": ["a.xml"]},
    )
    save_bundle(tmp_path / "m.npz", case, provenance=provenance)
    assert read_provenance(tmp_path / "m.npz") == provenance


def test_a_field_added_later_is_filled_by_its_default(case: Case, tmp_path: Path) -> None:
    """Old bundles stay readable when a data class gains a field with a default."""
    save_bundle(tmp_path / "m.npz", case)
    header = _edit_header(
        tmp_path / "m.npz", lambda values: values["values"]["muscles"].pop("curve_parameters")
    )
    assert "curve_parameters" not in header["values"]["muscles"]
    assert load_bundle(tmp_path / "m.npz").muscles.curve_parameters == ({}, {}, {})


def test_saving_replaces_whole_files_and_leaves_nothing_behind(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "m.npz"
    save_bundle(path, case)
    before = path.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.raises(DataError, match="cannot be written: No space left"):
            save_bundle(path, case)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.npz"]


def test_a_folder_that_is_not_there_is_an_error_of_this_package(case: Case, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be written"):
        save_bundle(tmp_path / "no" / "m.npz", case)
    with pytest.raises(DataError, match=r"m\.npz does not exist"):
        load_bundle(tmp_path / "m.npz")


def test_a_file_cut_off_anywhere_is_refused(case: Case, tmp_path: Path) -> None:
    save_bundle(tmp_path / "m.npz", case)
    content = (tmp_path / "m.npz").read_bytes()
    for size in range(0, len(content), len(content) // 40):
        (tmp_path / "cut.npz").write_bytes(content[:size])
        with pytest.raises(FileFormatError):
            load_bundle(tmp_path / "cut.npz")


def test_a_changed_byte_is_refused(case: Case, tmp_path: Path) -> None:
    """Every array carries a checksum in the archive."""
    path = tmp_path / "m.npz"
    save_bundle(path, case)
    content = bytearray(path.read_bytes())
    place = content.index(case.trajectory.moment_arms.tobytes())
    content[place] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(FileFormatError, match="is damaged"):
        load_bundle(path)


def test_an_encrypted_archive_and_an_array_beyond_memory_are_refused(case: Case, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    save_bundle(path, case)
    good = path.read_bytes()
    flags = good.index(b"PK\x01\x02") + 8
    path.write_bytes(good[:flags] + b"\1\0" + good[flags + 2 :])
    with pytest.raises(FileFormatError, match="is damaged: it cannot be read as a motion bundle"):
        load_bundle(path)
    path.write_bytes(good)
    huge = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        huge, {"descr": "<f8", "fortran_order": False, "shape": (99_999_999_999_999,)}
    )
    _replace_member(path, "trajectory.time.npy", huge.getvalue())
    with pytest.raises(FileFormatError, match="is damaged: it cannot be read as a motion bundle"):
        load_bundle(path)


FOREIGN = {
    "text": b"time\tq1\n0\t1\n",
    "empty": b"",
    "a pickle": pickle.dumps({"values": [1, 2]}),
    "a zip of something else": None,
}


@pytest.mark.parametrize("what", FOREIGN)
def test_a_foreign_file_is_named_as_such(what: str, tmp_path: Path) -> None:
    path = tmp_path / "foreign.npz"
    content = FOREIGN[what]
    if content is None:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("a.txt", "hello")
    else:
        path.write_bytes(content)
    with pytest.raises(FileFormatError, match="is not a motion bundle of this package"):
        load_bundle(path)


def test_no_code_of_a_bundle_runs(case: Case, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    save_bundle(path, case)

    class Payload:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (Path.touch, (tmp_path / "ran",))  # type: ignore[return-value]

    evil = io.BytesIO()
    np.save(evil, np.array([Payload()], dtype=object), allow_pickle=True)
    _replace_member(path, "trajectory.time.npy", evil.getvalue())
    with pytest.raises(FileFormatError, match="is damaged"):
        load_bundle(path)
    assert not (tmp_path / "ran").exists()


def test_arrays_that_contradict_each_other_are_refused(case: Case, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    save_bundle(path, case)
    short = io.BytesIO()
    np.save(short, np.zeros((3, 2)))
    _replace_member(path, "trajectory.generalized_forces.npy", short.getvalue())
    with pytest.raises(FileFormatError, match=r"is damaged: generalized_forces has shape \(3, 2\)"):
        load_bundle(path)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda header: header.update(format_version=99), "bundle version 99, expected at most 1"),
        (lambda header: header.update(format="other"), "is not a motion bundle"),
        (lambda header: header.pop("values"), "is damaged: 'values' is missing"),
        (lambda header: header["values"]["muscles"].pop("muscles"), "'muscles.muscles' is missing"),
        (lambda header: header["values"].update(trajectory=3), "is damaged"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(edit, message: str, case: Case, tmp_path: Path) -> None:
    save_bundle(tmp_path / "m.npz", case)
    _edit_header(tmp_path / "m.npz", edit)
    with pytest.raises(FileFormatError, match=message):
        load_bundle(tmp_path / "m.npz")


def _edit_header(path: Path, edit) -> dict:
    with np.load(path) as content:
        header = json.loads(content["header"].tobytes())
    edit(header)
    member = io.BytesIO()
    np.save(member, np.frombuffer(json.dumps(header).encode(), dtype=np.uint8))
    _replace_member(path, "header.npy", member.getvalue())
    return header


def _replace_member(path: Path, name: str, content: bytes) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {entry: archive.read(entry) for entry in archive.namelist()}
    assert name in members
    members[name] = content
    with zipfile.ZipFile(path, "w") as archive:
        for entry, data in members.items():
            archive.writestr(entry, data)
