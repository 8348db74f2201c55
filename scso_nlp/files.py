"""Files written whole or not at all, and the hash that tells whether one is still the same."""

from __future__ import annotations

import contextlib
import hashlib
import os
import uuid
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from scso_nlp.exceptions import DataError

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
    temporary = path.with_name(f".{uuid.uuid4().hex}.{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise DataError(f"{path} cannot be written: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


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
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from None


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
