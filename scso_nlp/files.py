"""Files written whole or not at all, and the hash that tells one file from another."""

from __future__ import annotations

import contextlib
import hashlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from scso_nlp.exceptions import DataError


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
