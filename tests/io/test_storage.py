"""Storage files: every variant in use, every fault in one sentence, the same numbers as OpenSim 4.6."""

import importlib.util
import json
import logging
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError
from scso_nlp.io import Storage, read_storage, write_storage
from scso_nlp.io.storage import MAX_HEADER_BYTES, with_distinct_times

HEADER = "motion\nversion=1\nnRows=2\nnColumns=3\ninDegrees=no\nendheader\n"
LABELS = "time\ta\tb\n"
ROWS = "0\t1\t2\n0.1\t3\t-4e-3\n"
VALUES = [[1.0, 2.0], [3.0, -0.004]]


def write(tmp_path: Path, content: str | bytes, name: str = "motion.sto") -> Path:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def make(labels=("a", "b"), time=(0.0, 0.1), values=VALUES, **kwargs) -> Storage:
    return Storage(name="motion", labels=labels, time=time, values=values, **kwargs)


# --- variants that are read -----------------------------------------------------------------------

VARIANTS = {
    "version 1": HEADER + LABELS + ROWS,
    "version 3 without a title": "inDegrees=no\nDataType=double\nversion=3\nOpenSimVersion=4.5\nendheader\n"
    + LABELS
    + ROWS,
    "no version line": HEADER.replace("version=1\n", "") + LABELS + ROWS,
    "SIMM header": "name motion\ndatacolumns 3\ndatarows 2\notherdata 1\nrange 0.0 0.1\nendheader\n"
    + LABELS
    + ROWS,
    "title, blank line, SIMM header": "motion\nnRows=2\nnColumns=3\n\n# SIMM Motion File Header:\n"
    "name motion\ndatacolumns 3\ndatarows 2\nrange 0.0 0.1\nendheader\n" + LABELS + ROWS,
    "blank title": HEADER.replace("motion", "", 1) + LABELS + ROWS,
    "capital Time": HEADER + LABELS.replace("time", "Time") + ROWS,
    "upper-case keys": HEADER.replace("inDegrees=no", "InDegrees = NO").replace("endheader", "EndHeader")
    + LABELS
    + ROWS,
    "trailing tabs everywhere": (HEADER + LABELS + ROWS).replace("\n", "\t\t\n"),
    "padded labels": HEADER + "      time\t   a\t b  \n" + ROWS,
    "padded numbers": HEADER + LABELS + "      0.0\t      1.0\t      2.0\n      0.1\t 3\t-0.004\n",
    "leading tab": HEADER + "\ttime\ta\tb\n\t0\t1\t2\n\t0.1\t3\t-4e-3\n",
    "two tabs between labels": HEADER + "    time\t\ta\t\tb\t\t\t\n" + ROWS.replace("\n", "\t\n"),
    "spaces between cells": HEADER + "time a b\n" + ROWS.replace("\t", "   "),
    "commas between cells": HEADER + "time,a,b\n" + ROWS.replace("\t", ","),
    "commas and spaces": HEADER + "time, a, b,\n" + ROWS.replace("\t", ", "),
    "tabs in labels, spaces in rows": HEADER + LABELS + ROWS.replace("\t", " "),
    "one row more than nRows": HEADER.replace("nRows=2", "nRows=1") + LABELS + ROWS,
    "one row less than nRows": HEADER.replace("nRows=2", "nRows=3") + LABELS + ROWS,
    "wrong nColumns": HEADER.replace("nColumns=3", "nColumns=40") + LABELS + ROWS,
    "Windows line ends": (HEADER + LABELS + ROWS).replace("\n", "\r\n"),
    "old Macintosh line ends": (HEADER + LABELS + ROWS).replace("\n", "\r"),
    "byte order mark": "\ufeff" + HEADER + LABELS + ROWS,
    "no line end at the end": HEADER + LABELS + ROWS.rstrip("\n"),
    "blank lines": HEADER + "\n\n" + LABELS + "\n" + ROWS.replace("\n", "\n\n") + "\n\n",
    "free text": HEADER.replace("endheader", "\nUnits are S.I. units (second, ...)\nx is up\n\nendheader")
    + LABELS
    + ROWS,
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_gives_the_same_columns(tmp_path, variant):
    storage = read_storage(write(tmp_path, VARIANTS[variant]))
    assert storage.labels == ("a", "b")
    assert storage.time.tolist() == [0.0, 0.1]
    assert storage.values.tolist() == VALUES
    assert storage.name == ("" if variant in ("blank title", "version 3 without a title") else "motion")
    assert storage.in_degrees is (None if "SIMM" in variant else False)


def test_header_keys_and_free_text_are_kept(tmp_path):
    text = HEADER.replace("no\nendheader", "yes\n\nUnits are S.I. units\nx = y = up\n\nendheader")
    storage = read_storage(write(tmp_path, text + LABELS + ROWS))
    assert storage.in_degrees is True
    assert storage.header["nRows"] == "2"
    assert storage.header["version"] == "1"
    assert storage.description == "\nUnits are S.I. units\n\n"  # "x = y = up" is a key
    assert storage.header["x"] == "y = up"
    with pytest.raises(TypeError):
        storage.header["nRows"] = "3"


@pytest.mark.parametrize(
    ("encoding", "text"), [("latin-1", "Rücken µV"), ("utf-8", "Rücken µV"), ("cp1252", "5–15 kg")]
)
def test_characters_beyond_ascii_in_the_header_are_read(tmp_path, encoding, text):
    content = (HEADER.replace("motion", text) + LABELS.replace("b", "bü") + ROWS).encode(encoding)
    storage = read_storage(write(tmp_path, content))
    assert storage.name == text
    assert storage.labels == ("a", "bü")


def test_repeated_and_blank_labels_keep_their_columns(tmp_path):
    text = HEADER + "time\ta\t\ta\n0\t1\t2\t3\n0.1\t4\t5\t6\n"
    storage = read_storage(write(tmp_path, text))
    assert storage.labels == ("a", "", "a")
    assert storage.values.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_labels_with_spaces_are_kept_between_tabs(tmp_path):
    storage = read_storage(write(tmp_path, HEADER + "time\tvastus lateralis\tb\n" + ROWS))
    assert storage.labels == ("vastus lateralis", "b")


def test_nan_and_infinity_are_read_in_every_spelling(tmp_path):
    rows = "0\tnan\t-NaN\n1\t1.#QNAN\t-1.#IND00\n2\tinf\t-1.#INF\n3\t-nan(ind)\tInfinity\n"
    storage = read_storage(write(tmp_path, HEADER.replace("nRows=2", "nRows=4") + LABELS + rows))
    expected = [[np.nan, np.nan], [np.nan, np.nan], [np.inf, -np.inf], [np.nan, np.inf]]
    np.testing.assert_array_equal(storage.values, expected)


def test_epoch_time_stamps_and_uneven_steps_keep_every_digit(tmp_path):
    stamps = ["1667315607.814670085907", "1667315607.815670013428", "1667315607.874"]
    text = HEADER.replace("nRows=2", "nRows=3") + LABELS + "".join(f"{stamp}\t0\t0\n" for stamp in stamps)
    storage = read_storage(write(tmp_path, text))
    assert storage.time.tolist() == [float(stamp) for stamp in stamps]
    write_storage(storage, tmp_path / "out.sto", precision=3)
    np.testing.assert_array_equal(read_storage(tmp_path / "out.sto").time, storage.time)


def test_of_rows_with_equal_time_the_last_is_kept_as_in_opensim(tmp_path, caplog):
    rows = "0\t1\t2\n0.1\t3\t4\n0.1\t5\t6\n0.2\t7\t8\n"
    storage = read_storage(write(tmp_path, HEADER.replace("nRows=2", "nRows=4") + LABELS + rows))
    assert storage.time.tolist() == [0, 0.1, 0.2]
    assert storage.values.tolist() == [[1, 2], [5, 6], [7, 8]]
    assert "1 row(s) have the time of the next row, first at t = 0.1 s" in caplog.text


@pytest.mark.parametrize(
    ("stamps", "kept_times", "kept_rows"),
    [
        ([0, 0.1, 0.2, 0.2 + 3e-13], [0, 0.1, 0.2], [0, 1, 3]),
        ([0, 3e-13, 0.1, 0.2], [0, 0.1, 0.2], [1, 2, 3]),
        ([0, 0.1, 0.1 + 1e-13, 0.1 + 2e-13, 0.2, 0.3, 0.4], [0, 0.1, 0.2, 0.3, 0.4], [0, 3, 4, 5, 6]),
        ([0, 1e-9, 2e-9, 3e-9], None, [0, 1, 2, 3]),
        ([0, 1e-9, 2e-9, 1e3], None, [0, 1, 2, 3]),
        ([0, 1, 2, 2.00001], None, [0, 1, 2, 3]),
        ([0, 1e-12], None, [0, 1]),
    ],
)
def test_times_that_differ_by_rounding_are_one_row(stamps, kept_times, kept_rows, caplog):
    storage = make(("a",), stamps, np.arange(len(stamps))[:, None])
    found = with_distinct_times(storage)
    assert found.values[:, 0].tolist() == kept_rows
    assert found.time.tolist() == (kept_times or stamps[: len(kept_rows)])
    dropped = len(stamps) - len(kept_rows)
    assert (f"{dropped} row(s) have the time of the next row" in caplog.text) == (dropped > 0)
    assert dropped or found is storage


def test_wrong_counts_in_the_header_are_logged_and_the_data_trusted(tmp_path, caplog):
    text = HEADER.replace("nRows=2", "nRows=3").replace("nColumns=3", "nColumns=40")
    storage = read_storage(write(tmp_path, text + LABELS + ROWS))
    assert storage.values.shape == (2, 2)
    assert "nRows is 3 in the header, found 2" in caplog.text
    assert "nColumns is 40 in the header, found 3" in caplog.text


# --- faults ---------------------------------------------------------------------------------------

FAULTS = {
    "empty": (b"", "is empty, expected a .sto or .mot file"),
    "white space only": (b" \n\n", "is empty, expected a .sto or .mot file"),
    "binary": (b"PK\x03\x04\x00\x00", "is not plain text (it holds zero bytes)"),
    "UTF-16": ((HEADER + LABELS + ROWS).encode("utf-16"), "is not plain text (it holds zero bytes)"),
    "no endheader": (LABELS + ROWS, "has no 'endheader' line within its first 1048576 bytes"),
    "huge header": (
        "x\n" * MAX_HEADER_BYTES + HEADER + LABELS + ROWS,
        "has no 'endheader' line within its first",
    ),
    "nothing below the header": (HEADER, "has no column labels and rows: it ends after line 6"),
    "no rows": (HEADER + LABELS, "has no rows below its column labels: it ends after line 7"),
    "no rows, no line end": (
        HEADER + LABELS.rstrip(),
        "has no rows below its column labels: it ends after line 7",
    ),
    "time is not first": (HEADER + "a\ttime\tb\n" + ROWS, "line 7: the first column is 'a', expected 'time'"),
    "last row cut off": (
        HEADER + LABELS + ROWS + "0.2\t5\n",
        "line 10: expected 3 numbers, found 2, the file seems to be cut off",
    ),
    "row too long": (HEADER + LABELS + "0\t1\t2\t9\n" + ROWS, "line 8: expected 3 numbers, found 4"),
    "short and long rows that add up": (
        HEADER + LABELS + "0\t1\n0.1\t3\t4\t5\n0.2\t0\t0\n",
        "line 8: expected 3 numbers, found 2",
    ),
    "fewer labels than numbers": (
        HEADER + "time\ta\n" + ROWS,
        "line 8: expected 2 numbers, one per label of line 7, found 3",
    ),
    "empty cell between commas": (
        HEADER + "time,a,b\n0,,1\n0.1,2,3\n",
        "line 8: expected 3 numbers, found 2",
    ),
    "decimal commas": (
        HEADER + LABELS + "0,0\t1,5\t2,5\n",
        "line 8: expected 3 numbers, one per label of line 7, found 6 (decimal commas? write decimal points)",
    ),
    "text among numbers": (
        HEADER + LABELS + ROWS + "0.2\tabc\t1\n",
        "line 10: expected a number in column 'a', found 'abc'",
    ),
    "number with a tail": (
        HEADER + LABELS + "0\t1\t2.5.1\n",
        "line 8: expected a number in column 'b', found '2.5.1'",
    ),
    "two numbers in one cell": (
        HEADER + LABELS + "0\t1-2\t3\n",
        "line 8: expected a number in column 'a', found '1-2'",
    ),
    "Python-like number": (
        HEADER + LABELS + "0\t1_0\t3\n",
        "line 8: expected a number in column 'a', found '1_0'",
    ),
    "hexadecimal number": (HEADER + LABELS + "0\t0x1p3\t3\n", "found '0x1p3'"),
    "characters beyond ASCII in a row": (HEADER + LABELS + "0\t1µ\t3\n", "found '1µ'"),
    "time goes back": (
        HEADER + LABELS + ROWS + "0.05\t5\t6\n",
        "line 10: time must increase, found 0.05 s at row 2 after 0.1 s",
    ),
    "time is NaN": (
        HEADER + LABELS + "0\t1\t2\nnan\t3\t4\n",
        "line 9: time is nan at row 1, expected a finite number",
    ),
    "unit is neither": (
        HEADER.replace("=no", "=maybe") + LABELS + ROWS,
        "has inDegrees='maybe', expected yes or no",
    ),
    "vectors in cells": (
        "DataType=Vec3\nversion=3\nendheader\ntime\ta\n0\t1,2,3\n",
        "holds elements of type Vec3, expected double",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_one_sentence_that_names_the_file(tmp_path, fault):
    content, message = FAULTS[fault]
    path = write(tmp_path, content)
    with pytest.raises(DataError) as caught:
        read_storage(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, FileFormatError) or fault.startswith("time")


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(DataError, match=r"nothing\.sto does not exist"):
        read_storage(tmp_path / "nothing.sto")
    with pytest.raises(DataError, match="cannot be read: File name too long"):
        read_storage(tmp_path / ("x" * 300))
    with pytest.raises(DataError, match=r"is not a file"):
        read_storage(tmp_path)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 10**6), junk=st.binary(max_size=20))
def test_damaged_files_are_read_or_refused_but_never_crash(tmp_path, cut, junk):
    whole = (HEADER + LABELS + ROWS).encode()
    cut %= len(whole)
    try:
        storage = read_storage(write(tmp_path, whole[:cut] + junk + whole[cut + len(junk) :]))
    except DataError:
        return  # any other exception fails the test
    assert storage.values.shape == (storage.n_frames, storage.n_columns)


# --- columns and units ----------------------------------------------------------------------------

PATHS = (
    "/jointset/walker_knee_r/knee_angle_r/value",
    "/jointset/walker_knee_r/knee_angle_r/speed",
    "pelvis_tx",
)


def test_a_coordinate_is_found_by_its_name_and_by_its_state_path():
    by_path = make(PATHS, values=[[1, 2, 3], [4, 5, 6]])
    assert by_path.column("knee_angle_r").tolist() == [1, 4]
    assert by_path.column(PATHS[1]).tolist() == [2, 5]
    assert by_path.column("walker_knee_r/knee_angle_r/value").tolist() == [1, 4]
    assert by_path.columns(["pelvis_tx", "knee_angle_r"]).tolist() == [[3, 1], [6, 4]]
    by_name = make(("knee_angle_r", "b"))
    assert by_name.column(PATHS[0]).tolist() == [1, 3]
    with pytest.raises(NameMismatchError):
        by_name.column(PATHS[1])  # a speed is not a coordinate's value
    with pytest.raises(NameMismatchError):
        by_path.column("/jointset/other_knee/knee_angle_r/value")


def test_an_exact_label_comes_before_a_state_path():
    storage = make((PATHS[0], "knee_angle_r"))
    assert storage.index("knee_angle_r") == 1
    assert storage.index(PATHS[0]) == 0


def test_an_unknown_column_names_the_closest_ones():
    with pytest.raises(NameMismatchError, match=r"no column 'knee_angel_r' \(closest: knee_angle_r"):
        make((PATHS[0], "b")).column("knee_angel_r")
    with pytest.raises(NameMismatchError, match=r"no column 'x', 'y' \(available: a, b\)"):
        make().columns(["a", "x", "y"])


def test_an_ambiguous_or_blank_column_is_refused():
    with pytest.raises(NameMismatchError, match=r"'a' is ambiguous, it may be column 1 \(a\) or 2 \(a\)"):
        make(("a", "a")).column("a")
    twice = make(("/jointset/one/q/value", "/jointset/two/q/value"))
    with pytest.raises(
        NameMismatchError, match=r"'q' is ambiguous, .*/jointset/one/q/value.*/jointset/two/q/value"
    ):
        twice.column("q")
    with pytest.raises(NameMismatchError):
        make(("", "a")).column("")


def test_inverse_dynamics_columns_are_found_with_and_without_their_suffix():
    storage = make(("knee_angle_r_moment", "pelvis_tx_force"))
    suffixes = ("_moment", "_force")
    assert storage.columns(["pelvis_tx", "knee_angle_r"], suffixes=suffixes).tolist() == [[2, 1], [-0.004, 3]]
    assert make(("knee_angle_r", "pelvis_tx")).index("pelvis_tx", suffixes=suffixes) == 1
    with pytest.raises(NameMismatchError):
        storage.column("knee_angle_r")


@pytest.mark.parametrize(
    ("name", "title", "degrees"),
    [("ik.sto", "rtosim output", False), ("ik.mot", "rtosim output", False), ("ik.sto", "Coordinates", False),
     ("ik.mot", "Coordinates", True)],
)  # fmt: skip
def test_without_indegrees_the_unit_is_what_opensim_takes(tmp_path, name, title, degrees):
    storage = read_storage(write(tmp_path, f"{title}\nendheader\n" + LABELS + ROWS, name))
    assert storage.in_degrees is None
    assert storage.assumed_in_degrees is degrees
    assert storage.is_old_mot is name.endswith(".mot")


def test_what_the_header_says_wins(tmp_path):
    path = write(tmp_path, HEADER.replace("version=1\n", "") + LABELS + ROWS, "old.mot")
    assert read_storage(path).assumed_in_degrees is False
    assert read_storage(path).is_old_mot


def test_require_finite_names_file_column_and_time(tmp_path):
    path = write(tmp_path, HEADER + LABELS + "0\t1\t2\n0.1\t3\tnan\n")
    with pytest.raises(DataError, match=r"motion\.sto: column 'b' is nan at t = 0\.1 s, .* \(1 such value"):
        read_storage(path).require_finite()
    storage = make()
    assert storage.require_finite() is storage


# --- the data class -------------------------------------------------------------------------------


def test_a_storage_is_checked_and_cannot_be_changed():
    storage = make()
    with pytest.raises(ValueError, match="read-only"):
        storage.values[0, 0] = 5
    with pytest.raises(ValueError, match="read-only"):
        storage.column("a")[0] = 5
    with pytest.raises(
        DataError, match=r"values has shape \(2, 2\), expected \(2, 3\) = \(n_frames, n_columns\)"
    ):
        make(("a", "b", "c"))
    with pytest.raises(
        DataError, match=r"Storage 'motion': time must increase, found 0\.0 s at row 1 after 0\.0 s"
    ):
        make(time=(0.0, 0.0))
    with pytest.raises(DataError, match="has no frames"):
        make(time=(), values=np.zeros((0, 2)))


# --- writing --------------------------------------------------------------------------------------


def test_the_written_header_is_that_of_opensim(tmp_path):
    # text of arm26's activation file as OpenSim 4.6 prints it
    description = "This file contains static optimization results.\n\n"
    storage = Storage(
        name="Static Optimization",
        labels=("TRIlong", "BRA"),
        time=[0.25, 0.5],
        values=[[1 / 3, 0], [1e-20, 1]],
        in_degrees=False,
        description=description,
    )
    write_storage(storage, tmp_path / "out.sto", precision=8)
    assert (tmp_path / "out.sto").read_bytes() == (
        b"Static Optimization\nversion=1\nnRows=2\nnColumns=3\ninDegrees=no\n"
        b"This file contains static optimization results.\n\nendheader\n"
        b"time\tTRIlong\tBRA\n0.25\t0.33333333\t0\n0.5\t1e-20\t1\n"
    )


def test_the_default_description_names_the_units(tmp_path):
    write_storage(make(in_degrees=True), tmp_path / "out.sto")
    lines = (tmp_path / "out.sto").read_text().split("\n")
    assert lines[4] == "inDegrees=yes"
    assert lines[5] == ""
    assert lines[6] == "Units are S.I. units (second, meters, Newtons, ...)"
    assert lines[8:10] == ["", "endheader"]


def test_an_unknown_unit_is_written_as_opensim_would_have_taken_it(tmp_path):
    old = read_storage(write(tmp_path, "motion\nendheader\n" + LABELS + ROWS, "old.mot"))
    write_storage(old, tmp_path / "new.mot")
    assert read_storage(tmp_path / "new.mot").in_degrees is True
    write_storage(make(), tmp_path / "new.sto")
    assert read_storage(tmp_path / "new.sto").in_degrees is False


def test_what_opensim_would_misread_is_not_written(tmp_path):
    target = write(tmp_path, "precious")
    for label in ("", "vastus lateralis", "a\tb", "a\nb", "\x00"):
        with pytest.raises(DataError, match="cannot be written, because OpenSim splits labels"):
            write_storage(make((label, "b")), target)
    for name in ("two\nlines", "endheader", "nRows=3", "name other", " padded", "# comment"):
        with pytest.raises(DataError, match="title"):
            write_storage(Storage(name=name, labels=("a",), time=[0], values=[[1]]), target)
    with pytest.raises(DataError, match="title and description"):
        write_storage(make(description="one\nendheader\n"), target)
    with pytest.raises(DataError, match="column 'a' is nan"):
        write_storage(make(values=[[math.nan, 1], [2, 3]]), target)
    for precision in (0, 18):
        with pytest.raises(DataError, match="expected 1 to 17 significant digits"):
            write_storage(make(), target, precision=precision)
    assert target.read_text() == "precious"


def test_nan_is_written_when_asked_for(tmp_path):
    storage = make(values=[[math.nan, 1], [math.inf, -math.inf]])
    write_storage(storage, tmp_path / "out.sto", allow_nonfinite=True)
    np.testing.assert_array_equal(read_storage(tmp_path / "out.sto").values, storage.values)


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    target = write(tmp_path, "precious")

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(DataError, match=r"motion\.sto cannot be written: No space left on device"):
        write_storage(make(), target)
    assert target.read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["motion.sto"]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(DataError, match=r"missing.out\.sto cannot be written: No such file or directory"):
        write_storage(make(), tmp_path / "missing" / "out.sto")


DOUBLES = st.floats(allow_nan=False, allow_infinity=False, width=64)
LABEL = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=12)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), in_degrees=st.booleans())
def test_writing_then_reading_gives_identical_doubles(tmp_path, data, in_degrees):
    labels = tuple(data.draw(st.lists(LABEL, min_size=0, max_size=5)))
    stamps = sorted(data.draw(st.lists(DOUBLES, min_size=1, max_size=6, unique=True)))
    values = data.draw(hnp.arrays(np.float64, (len(stamps), len(labels)), elements=DOUBLES))
    storage = make(labels, stamps, values, in_degrees=in_degrees)
    write_storage(storage, tmp_path / "out.sto")
    back = read_storage(tmp_path / "out.sto")
    assert back.labels == storage.labels
    assert back.time.tobytes() == storage.time.tobytes()  # bits, so that -0.0 is not 0.0
    assert back.values.tobytes() == storage.values.tobytes()
    assert (back.name, back.in_degrees, back.description) == (storage.name, in_degrees, storage.description)


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=DOUBLES.filter(lambda x: abs(x) < 1e300), precision=st.integers(1, 17))
def test_precision_is_the_number_of_significant_digits(tmp_path, value, precision):
    write_storage(make(("a",), [0.0], [[value]]), tmp_path / "out.sto", precision=precision)
    back = read_storage(tmp_path / "out.sto").values[0, 0]
    # half a unit of the last digit kept; subnormal numbers have an absolute spacing of 5e-324
    assert abs(back - value) <= 0.5000001 * 10.0 ** (1 - precision) * abs(value) + 5e-324


def test_large_files_are_read_without_a_loop_over_cells(tmp_path, rng):
    storage = make(
        tuple(f"channel_{i}" for i in range(10)), np.arange(25000) / 1000, rng.standard_normal((25000, 10))
    )
    write_storage(storage, tmp_path / "emg.sto")
    times = []
    for _ in range(3):
        start = time.perf_counter()
        back = read_storage(tmp_path / "emg.sto")
        times.append(time.perf_counter() - start)
    np.testing.assert_array_equal(back.values, storage.values)
    # 5 MB, 275,000 numbers: measured 0.1 s; the bound leaves room for a busy machine
    assert min(times) < 1.0


# --- the third-party files, and OpenSim as the other program --------------------------------------

READ_WITH_OPENSIM = """
import json, sys
import numpy as np
import opensim
opensim.Logger.setLevelString("Off")
files, target = json.load(open(sys.argv[1])), sys.argv[2]
arrays, report = {}, []
for k, file in enumerate(files):
    storage = opensim.Storage(file)
    labels = storage.getColumnLabels()
    rows = []
    for i in range(storage.getSize()):
        vector = storage.getStateVector(i)
        rows.append([vector.getTime(), *(vector.getData().get(j) for j in range(vector.getSize()))])
    arrays[f"storage_{k}"] = np.array(rows)
    entry = {
        "name": storage.getName(),
        "in_degrees": storage.isInDegrees(),
        "labels": [labels.get(i) for i in range(labels.getSize())],
    }
    try:
        table = opensim.TimeSeriesTable(file)
    except RuntimeError as error:
        entry["table_error"] = str(error)
    else:
        entry["table_labels"] = list(table.getColumnLabels())
        arrays[f"table_{k}"] = np.column_stack((table.getIndependentColumn(), table.getMatrix().to_numpy()))
    report.append(entry)
np.savez(target + ".npz", **arrays)
json.dump(report, open(target + ".json", "w"))
"""


def read_with_opensim(files: list[Path], folder: Path):
    """Read `files` by OpenSim in a process of its own; return one report and the arrays."""
    if importlib.util.find_spec("opensim") is None:
        pytest.skip("needs the opensim package")
    (folder / "files.json").write_text(json.dumps([str(file) for file in files]))
    command = [sys.executable, "-c", READ_WITH_OPENSIM, str(folder / "files.json"), str(folder / "read")]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "read.json").read_text()), np.load(folder / "read.npz")


@pytest.mark.opensim
def test_third_party_files_are_read_as_opensim_reads_them(shared_data, tmp_path):
    files = sorted(file for file in shared_data.rglob("*") if file.suffix in (".sto", ".mot"))
    assert len(files) >= 20
    report, arrays = read_with_opensim(files, tmp_path)
    not_tables = []
    for k, (file, theirs) in enumerate(zip(files, report, strict=True)):
        ours = read_storage(file)
        numbers = np.column_stack((ours.time, ours.values))
        assert ["time", *ours.labels] == theirs["labels"], file
        assert ours.name == theirs["name"].strip(), file
        assert ours.assumed_in_degrees == theirs["in_degrees"], file
        np.testing.assert_array_equal(numbers, arrays[f"storage_{k}"], err_msg=str(file))
        if "table_error" in theirs:
            not_tables.append(file.name)
            continue
        assert list(ours.labels) == theirs["table_labels"], file
        np.testing.assert_array_equal(numbers, arrays[f"table_{k}"], err_msg=str(file))
    # trailing tabs in the rows and doubled tabs in the labels: OpenSim's table reader refuses them
    assert set(not_tables) <= {"emgFilt.sto", "id.sto", "ik.sto", "subject01_walk_grf.mot"}


@pytest.mark.opensim
def test_opensim_reads_what_is_written(tmp_path, rng):
    numbers = rng.standard_normal((50, 4)) * 10.0 ** rng.integers(-300, 300, (50, 4))
    numbers[0] = [5e-324, 1.7976931348623157e308, -0.0, 1 / 3]
    epoch = 1667315607.814670085907 + np.cumsum(rng.uniform(0.059, 0.074, 50))
    cases = {
        "plain.sto": make(("a", "b", "c_moment", "/jointset/j/q/value"), epoch, numbers, in_degrees=False),
        "degrees.mot": make(("a", "a", "c", "d"), np.arange(50) / 3, numbers, in_degrees=True),
        "untitled.sto": Storage(
            name="", labels=tuple("abcd"), time=np.arange(50), values=numbers, description=""
        ),
        "static.sto": make(tuple("abcd"), epoch, numbers, description="Static optimization results.\n\n"),
    }
    files = [tmp_path / name for name in cases]
    for storage, file in zip(cases.values(), files, strict=True):
        write_storage(storage, file)
    report, arrays = read_with_opensim(files, tmp_path)
    for k, (storage, theirs) in enumerate(zip(cases.values(), report, strict=True)):
        ours = np.column_stack((storage.time, storage.values))
        assert theirs["name"] == storage.name
        assert theirs["labels"] == ["time", *storage.labels]
        assert theirs["in_degrees"] == bool(storage.in_degrees)
        np.testing.assert_array_equal(arrays[f"storage_{k}"], ours)
        assert theirs["table_labels"] == list(storage.labels)
        np.testing.assert_array_equal(arrays[f"table_{k}"], ours)


def test_third_party_headers_and_units_are_understood(shared_data, caplog):
    caplog.set_level(logging.INFO, logger="scso_nlp")
    elbow = read_storage(shared_data / "arm26/arm26_InverseKinematics.mot")
    assert elbow.in_degrees is None
    # the elbow flexes from about 1 to 90 degrees: the old .mot file is in degrees though it does not say so
    assert elbow.assumed_in_degrees
    assert elbow.column("r_elbow_flex")[-1] == pytest.approx(90, rel=0.01)
    assert not read_storage(shared_data / "back_lifting/stoop15kg/ik.sto").assumed_in_degrees
    walking = read_storage(shared_data / "walking3d/coordinates.sto")
    assert walking.values.shape == (1350, 31)
    assert walking.index("knee_angle_r") == walking.index("/jointset/walker_knee_r/knee_angle_r/value")
    emg = read_storage(shared_data / "back_lifting/stoop15kg/emgFilt.sto")
    assert emg.labels[0] == "rectabd_r"
    assert emg.labels[-1] == "zeroEMG"
    assert emg.column("zeroEMG").max() == 0
