"""Files written whole or not at all, text read from them, and the hash that tells one from another."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tomllib
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scso_nlp.exceptions import DataError, FileFormatError


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


def read_text(path: str | os.PathLike[str]) -> str:
    """Read a text file in UTF-8, with or without byte order mark.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    str
        Line ends as they are.

    Raises
    ------
    DataError
        The file cannot be read.
    FileFormatError
        Not UTF-8.
    """
    try:
        with open(path, "rb") as file:
            content = file.read().removeprefix(b"\xef\xbb\xbf")
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileFormatError(
            f"{path} is not text in UTF-8: its line {line} holds the byte {content[error.start]:#x}"
        ) from None
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from None


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
    text = read_text(path)
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
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from None
