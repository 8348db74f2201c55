"""What tells runs apart: contents of input files, settings, and versions; not where files lie."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path

from scso_nlp.declared_settings import OUTPUT, SETTINGS
from scso_nlp.files import hashes
from scso_nlp.opensim.engine import input_files
from scso_nlp.report.record import plain
from scso_nlp.settings import OutputSettings, RunSettings, record
from scso_nlp.versions import version_of

#: Output settings that decide which files there are.
DECIDING_OUTPUT = ("figures", "keep_failed")
#: Packages whose versions decide the numbers.
PACKAGES = ("scso_nlp", "opensim")


def identity(inputs: Mapping[str, str], settings: Mapping[str, object]) -> str:
    """Hash what decides the results of a run.

    Parameters
    ----------
    inputs : mapping of str to str
        SHA-256 of every input file, by path.
    settings : mapping of str to object
        All in effect, as :func:`~scso_nlp.settings.record` gives them.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    deciding = {
        name: _told(settings.get(name), is_path=setting.kind.is_path)
        for name, setting in SETTINGS.items()
        if setting.group is not OUTPUT or name in DECIDING_OUTPUT
    }
    content = {
        "inputs": [(os.path.basename(path), digest) for path, digest in inputs.items()],
        "settings": plain(deciding),
        "versions": {package: version_of(package) for package in PACKAGES},
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _told(value: object, *, is_path: bool) -> object:
    """Give a value, but of paths only that they are there: the contents of their files are hashed."""
    return bool(value) if is_path and isinstance(value, str | Path | tuple) else value


def inputs_of(settings: RunSettings, known: dict[str, str]) -> dict[str, str]:
    """Hash the input files of a run.

    Parameters
    ----------
    settings : RunSettings
    known : dict of str to str
        SHA-256 of files by path, of runs before; it grows.

    Returns
    -------
    dict of str to str
        As a run records them.

    Raises
    ------
    DataError
        A file that is missing or cannot be read.
    """
    files = [str(path) for path in input_files(settings.motion)]
    known |= hashes(path for path in dict.fromkeys(files) if path not in known)
    return {**settings.sources, **{path: known[path] for path in files}}


def planned_identity(settings: RunSettings, output: OutputSettings, known: dict[str, str]) -> str:
    """Hash what decides the results of a run, before it; arguments are those of :func:`inputs_of`."""
    return identity(inputs_of(settings, known), record(settings, output))
