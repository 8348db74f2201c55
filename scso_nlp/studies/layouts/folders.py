"""What the recognisers of layouts look for in folders: setups, models, loads."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from scso_nlp.settings import RESULTS
from scso_nlp.studies.record import STUDY

#: Setup files are smaller [bytes]; larger ones are not looked into.
LARGEST_SETUP = 2**20


def folders(root: Path) -> Iterator[Path]:
    """Give a folder and all below it in order, without hidden ones and results."""
    for place, names, files in os.walk(root):
        names[:] = sorted(name for name in names if not name.startswith(".") and name != RESULTS)
        if STUDY in files:
            names.clear()
        else:
            yield Path(place)


def matching(folder: Path, *patterns: str) -> tuple[Path, ...]:
    """Files in a folder that one of several patterns fits, in order, without hidden ones."""
    found = {path for pattern in patterns for path in folder.glob(pattern)}
    return tuple(sorted(path for path in found if path.is_file() and not path.name.startswith(".")))


def says(path: Path, *words: bytes) -> bool:
    """Tell if a small file holds all of some words."""
    try:
        if path.stat().st_size > LARGEST_SETUP:
            return False
        content = path.read_bytes()
    except OSError:
        return False
    return all(word in content for word in words)


def nearest(folder: Path, root: Path, *patterns: str) -> tuple[Path, ...]:
    """Files that fit, in the first of a folder and those above it, up to the root, that holds any.

    Parameters
    ----------
    folder, root : Path
        The first is in the second, or the same.
    *patterns : str

    Returns
    -------
    tuple of Path
    """
    for place in (folder, *folder.parents):
        if found := matching(place, *patterns):
            return found
        if place == root:
            break
    return ()


def loads_in(folder: Path) -> tuple[Path, ...]:
    """ExternalLoads files in a folder."""
    return tuple(path for path in matching(folder, "*.xml") if says(path, b"<ExternalLoads"))


def one(what: str, found: tuple[Path, ...], where: str) -> tuple[dict[str, Path], tuple[str, ...]]:
    """Take a file if it is the only one.

    Parameters
    ----------
    what : str
        The setting that it is for.
    found : tuple of Path
    where : str
        Where it was looked for.

    Returns
    -------
    dict of str to Path, tuple of str
        The setting; or what is missing.
    """
    if len(found) == 1:
        return {what: found[0]}, ()
    if not found:
        return {}, (f"{what} ({where})",)
    names = ", ".join(path.name for path in found[:4])
    return {}, (f"{what} ({len(found)} are there: {names}; name one in scso.toml)",)
