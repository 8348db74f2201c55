"""Files found, read, written whole or not at all, and told apart by their hash."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tomllib
import uuid
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.text import shown

#: Input files beyond this are refused [bytes]: hours of motion or raw EMG take a tenth of it.
LARGEST_FILE = 2**31
#: Settings and maps beyond this are refused [bytes]; long ones have some hundred lines.
LARGEST_TOML = 2**24
#: Motions and analyses have shorter names [bytes]: names of files, with both of them, may have 255.
LONGEST_NAME = 100
#: As much of the end of a file's name stands in that of the temporary file beside it.
FILE_NAME = 40


def absolute(path: str | os.PathLike[str], folder: str | os.PathLike[str] = "") -> Path:
    """Give the absolute path of what a user names.

    Parameters
    ----------
    path : str or path-like
        May start with ``~`` or ``~user``.
    folder : str or path-like
        What a relative path is relative to; the working folder by default.

    Returns
    -------
    Path

    Raises
    ------
    DataError
        A user that is not known, or a zero byte.
    """
    text = os.path.expanduser(os.fspath(path))
    if "\0" in text:
        raise DataError(f"the path {text!r} holds a zero byte, which no path can")
    if text.startswith("~"):
        raise DataError(f"{text}: no user has this home folder; write ./{text} if the name starts with ~")
    return Path(os.path.abspath(os.path.join(folder, text)))


def check_name(name: str) -> None:
    """Check that files may be called after a motion or an analysis.

    Raises
    ------
    DataError
        Empty, hidden, too long, or with signs that some system does not allow.
    """
    if not name or name.startswith(".") or any(c in '/\\:*?"<>|' or not c.isprintable() for c in name):
        raise DataError(
            f"the name {name!r} cannot start a file name, expected printable characters without slashes"
        )
    if len(name.encode()) > LONGEST_NAME:
        raise DataError(
            f"the name {shown(name)} has {len(name)} letters, expected at most {LONGEST_NAME} to "
            "start a file name"
        )


@contextlib.contextmanager
def refused(path: object, how: str) -> Iterator[None]:
    """Turn what the operating system refuses into a sentence about a path.

    Parameters
    ----------
    path : object
        What the sentence begins with.
    how : str
        How it goes on, e.g. ``"cannot be written"``.

    Raises
    ------
    DataError
        The reason is the operating system's.
    """
    try:
        yield
    except OSError as error:
        raise DataError(f"{path} {how}: {error.strerror or error}") from None
    except ValueError as error:
        if "null byte" not in str(error) and "null character" not in str(error):
            raise
        raise DataError(f"the path {str(path)!r} holds a zero byte, which no path can") from None


def require_file(path: str | os.PathLike[str], largest: int = LARGEST_FILE) -> None:
    """Check that a path is a file that can be read to its end: no folder, no device, no pipe.

    Parameters
    ----------
    path : str or path-like
    largest : int [bytes]

    Raises
    ------
    DataError
        It is not there, must not be looked at, is no regular file, or is larger.
    """
    with refused(path, "cannot be read"):
        try:
            found = os.stat(path)
        except (FileNotFoundError, NotADirectoryError):
            raise DataError(f"{path} does not exist") from None
    if not stat.S_ISREG(found.st_mode):
        raise DataError(f"{path} is not a file")
    if found.st_size > largest:
        raise DataError(f"{path} has {found.st_size / 1e6:.0f} MB, expected at most {largest / 1e6:.0f} MB")


def read_bytes(path: str | os.PathLike[str], largest: int = LARGEST_FILE) -> bytes:
    """Read an input file; arguments and what is refused are those of :func:`require_file`."""
    require_file(path, largest)
    with refused(path, "cannot be read"), open(path, "rb") as file:
        return file.read()


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder and those above it; one that is there stays.

    Raises
    ------
    DataError
        It cannot be made; the reason is the operating system's.
    """
    with refused(path, "cannot be made"):
        os.makedirs(path, exist_ok=True)


try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextlib.contextmanager
def write_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a file, so that a reader finds the old one or the whole new one, never a part.

    Parameters
    ----------
    path : str or path-like
        Target; an existing file is replaced. The folder must exist.

    Yields
    ------
    Path
        Where to write: beside the target, with its ending. It takes the target's place when the block ends,
        and is removed if the block raises.

    Raises
    ------
    DataError
        The file cannot be written; the reason is the operating system's.
    """
    path = Path(path)
    temporary = path.parent / f".{uuid.uuid4().hex}.{path.name[-FILE_NAME:]}"
    try:
        with refused(path, "cannot be written"):
            yield temporary
            os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError, ValueError):
            temporary.unlink()


def read_text(path: str | os.PathLike[str], largest: int = LARGEST_FILE) -> str:
    """Read a text file in UTF-8, with or without byte order mark; line ends stay as they are.

    Raises
    ------
    DataError
        As for :func:`require_file`.
    FileFormatError
        Not UTF-8.
    """
    content = read_bytes(path, largest).removeprefix(b"\xef\xbb\xbf")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileFormatError(
            f"{path} is not text in UTF-8: its line {line} holds the byte {content[error.start]:#x}"
        ) from None


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    dict of str to object

    Raises
    ------
    DataError
        The file cannot be read.
    FileFormatError
        Not TOML.
    """
    text = read_text(path, LARGEST_TOML)
    try:
        return tomllib.loads(text)
    except ValueError as error:
        raise FileFormatError(f"{path} is not TOML: {error}") from None
    except RecursionError:
        raise FileFormatError(f"{path} is not TOML that can be read: it is nested too deeply") from None


def sha256(path: str | os.PathLike[str]) -> str:
    """Hash a file.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    str
        SHA-256 as 64 hexadecimal digits.

    Raises
    ------
    DataError
        The file cannot be read.
    """
    with refused(path, "cannot be read"), open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hashes(paths: Iterable[str | os.PathLike[str]]) -> dict[str, str]:
    """Hash files, before they are read.

    Parameters
    ----------
    paths : iterable of path

    Returns
    -------
    dict of str to str
        SHA-256 by path.

    Raises
    ------
    DataError
        A file cannot be read.
    """
    return {str(path): sha256(path) for path in paths}


def refuse_changed(before: Mapping[str, str]) -> None:
    """Raise unless files are what they were, after they were read: then the hashes are of what was read.

    Parameters
    ----------
    before : mapping of str to str
        SHA-256 by path.

    Raises
    ------
    DataError
        A file is not the same any more, or not there.
    """
    for path, digest in before.items():
        with contextlib.suppress(DataError):
            if sha256(path) == digest:
                continue
        raise DataError(f"{path} was changed or removed while it was read; run again, nothing was kept")


def lock(folder: str | os.PathLike[str], *, wait: bool = False) -> int | None:
    """Lock a folder against other locks of it, until the descriptor is closed or the process ends, somehow.

    Parameters
    ----------
    folder : path
        Exists.
    wait : bool
        Until it is free.

    Returns
    -------
    int or None
        The descriptor; None where the system knows no locks of folders.

    Raises
    ------
    BlockingIOError
        It is locked, and `wait` is false.
    OSError
        It cannot be read.
    """
    if fcntl is None:
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BaseException as error:
        os.close(descriptor)
        if isinstance(error, OSError) and not isinstance(error, BlockingIOError):
            return None
        raise
    return descriptor
