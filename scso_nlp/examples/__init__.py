"""Examples that come with the package: each a folder with model, motion, loads, setup file and README."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from scso_nlp.validation import positions


def example_names() -> tuple[str, ...]:
    """List the names of the embedded examples.

    Returns
    -------
    tuple of str
        In alphabetical order.
    """
    return tuple(sorted(folder.name for folder in _home().iterdir() if (folder / "setup.xml").is_file()))


def example_folder(name: str) -> Path:
    """Find the folder of an embedded example.

    Parameters
    ----------
    name : str
        One of :func:`example_names`.

    Returns
    -------
    Path
        Holds ``setup.xml`` and all that it refers to. It may not be writable: copy it, or write results
        elsewhere.

    Raises
    ------
    NameMismatchError
        There is no such example; the closest names are suggested.
    """
    names = example_names()
    return _home() / names[int(positions("example", (name,), names)[0])]


def _home() -> Path:
    return Path(str(files(__name__)))
