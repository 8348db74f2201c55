"""A file is there whole or not at all."""

import os

import pytest

from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.files import hashes, lock, read_toml, refuse_changed, sha256, write_whole


def test_the_file_appears_when_the_block_ends(tmp_path):
    path = tmp_path / "table.csv"
    with write_whole(path) as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".csv"
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_block_that_raises_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "table.csv"
    path.write_text("old")

    def write_half():
        with write_whole(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        write_half()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_the_operating_system_refuses_is_one_sentence(tmp_path):
    path = tmp_path / "nowhere" / "table.csv"
    with (
        pytest.raises(DataError, match=r"table\.csv cannot be written: No such file or directory"),
        write_whole(path) as temporary,
    ):
        temporary.write_text("new")
    (tmp_path / "folder.csv").mkdir()
    with (
        pytest.raises(DataError, match=r"folder\.csv cannot be written: "),
        write_whole(tmp_path / "folder.csv") as temporary,
    ):
        temporary.write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]


def test_the_hash_is_that_of_the_standard(tmp_path):
    path = tmp_path / "abc"
    path.write_bytes(b"abc")
    # FIPS 180-4, example of SHA-256
    assert sha256(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with pytest.raises(DataError, match=r"nothing cannot be read: No such file"):
        sha256(tmp_path / "nothing")


@pytest.mark.parametrize(
    "content", [b"a = 1\n", b"\xef\xbb\xbfa = 1\n", b"a = 1\r\n", b"\xef\xbb\xbf# \xc3\xa9\r\na = 1"]
)
def test_settings_are_read_with_and_without_byte_order_mark_and_with_any_line_ends(tmp_path, content):
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    assert read_toml(path) == {"a": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"# one\n# two\xe9\n", r"a\.toml is not text in UTF-8: its line 2 holds the byte 0xe9$"),
        ("a = 1".encode("utf-16"), r"a\.toml is not text in UTF-8: its line 1 holds the byte 0xff$"),
        (b"a = 1\na = 2\n", r"a\.toml is not TOML: .*line 2"),
        (b"a = " + b"[" * 100_000, r"a\.toml is not TOML that can be read: it is nested too deeply"),
    ],
)
def test_what_is_no_text_or_no_toml_is_told_with_its_line(tmp_path, content, message):
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=message):
        read_toml(path)


def test_files_that_are_not_what_they_were_are_refused(tmp_path):
    paths = [tmp_path / name for name in "ab"]
    for path in paths:
        path.write_text("as it was")
    before = hashes(paths)
    refuse_changed(before)
    for spoil in (lambda: paths[1].write_text("as it is"), paths[1].unlink):
        spoil()
        with pytest.raises(DataError, match="b was changed or removed while it was read; run again"):
            refuse_changed(before)


@pytest.mark.skipif(os.name != "posix", reason="locks of folders")
def test_a_folder_is_locked_until_its_descriptor_is_closed(tmp_path):
    first = lock(tmp_path)
    with pytest.raises(BlockingIOError):
        lock(tmp_path)
    os.close(first)
    os.close(lock(tmp_path))
