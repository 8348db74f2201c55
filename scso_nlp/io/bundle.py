"""Bundles: a motion with its muscles and actuators in one ``.npz`` file.

A bundle holds what OpenSim computed, so that a second solve needs no OpenSim. It is NumPy arrays and one
JSON header, never a pickle: reading a bundle runs no code from it. Nothing here knows the fields of the data
classes, so new fields need no change.
"""

from __future__ import annotations

import dataclasses
import json
import os
import typing
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import FileFormatError, ScsoError
from scso_nlp.files import refused, require_file, write_whole
from scso_nlp.motion import Motion
from scso_nlp.muscles import ActuatorParameters, MuscleParameters
from scso_nlp.trajectory import MotionTrajectory

#: Written into every bundle; a reader refuses other formats and later versions.
FORMAT, FORMAT_VERSION = "scso_nlp motion bundle", 1
#: Name of the JSON header among the arrays.
HEADER = "header"

_Data = TypeVar("_Data")


@dataclass(frozen=True, kw_only=True)
@checked
class Provenance:
    """Where the numbers of a bundle come from.

    Attributes
    ----------
    package_version, opensim_version : str
    inputs : mapping of str to str
        SHA-256 of every input file by its name.
    settings : mapping of str to object
        The description that was computed, JSON values only.
    """

    package_version: str = ""
    opensim_version: str = ""
    inputs: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)


@checked
def save_bundle(
    path: str | os.PathLike[str],
    motion: Motion,
    *,
    provenance: Provenance | None = None,
) -> None:
    """Write a motion to one file, whole or not at all.

    Parameters
    ----------
    path : str or path-like
        Target, usually ``.npz``; an existing file is replaced. The folder must exist.
    motion : Motion
    provenance : Provenance, optional
        Versions and input hashes.

    Raises
    ------
    DataError
        The file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "elbow.npz"
    ...     scso.save_bundle(path, motion)
    ...     scso.load_bundle(path).muscles.muscles
    ('brachioradialis', 'biceps', 'brachialis')
    """
    path = Path(path)
    arrays: dict[str, np.ndarray] = {}
    values = {
        item.name: _take_apart(item.name, getattr(motion, item.name), arrays)
        for item in dataclasses.fields(motion)
    }
    header = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "provenance": dataclasses.asdict(provenance or Provenance()),
        "values": values,
    }
    text = json.dumps(header, allow_nan=True).encode("utf-8")
    arrays[HEADER] = np.frombuffer(text, dtype=np.uint8)
    # through an open file: given a name, NumPy would add .npz to another ending
    with write_whole(path) as temporary, open(temporary, "xb") as file:
        np.savez(file, allow_pickle=False, **arrays)


@checked
def load_bundle(path: str | os.PathLike[str]) -> Motion:
    """Read a bundle.

    Returns
    -------
    Motion
        Validated again, equal to what was saved bit by bit.

    Raises
    ------
    DataError
        No such file.
    FileFormatError
        Not a bundle, damaged, or written by a later version.
    """
    path = Path(path)
    header, arrays = _read(path)
    try:
        values = header["values"]
        trajectory = _put_together(MotionTrajectory, "trajectory", values["trajectory"], arrays)
        muscles = _put_together(MuscleParameters, "muscles", values["muscles"], arrays)
        actuators = _put_together(ActuatorParameters, "actuators", values["actuators"], arrays)
        return Motion(trajectory=trajectory, muscles=muscles, actuators=actuators)
    except ScsoError as error:
        raise FileFormatError(f"{path} is damaged: {error}") from None
    except KeyError as error:
        raise FileFormatError(f"{path} is damaged: {error} is missing") from None
    except (TypeError, ValueError, AttributeError):
        raise FileFormatError(f"{path} is damaged: its header does not describe a motion") from None


@checked
def read_provenance(path: str | os.PathLike[str]) -> Provenance:
    """Read where the numbers of a bundle come from.

    Raises
    ------
    DataError
        No such file.
    FileFormatError
        Not a bundle, damaged, or written by a later version.
    """
    path = Path(path)
    header, _ = _read(path)
    try:
        return Provenance(**header["provenance"])
    except (KeyError, TypeError):
        raise FileFormatError(f"{path} is damaged: its provenance cannot be read") from None


def _take_apart(prefix: str, data: Any, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Move the arrays of a data class into `arrays`; return the rest as JSON values."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(data):
        value = getattr(data, item.name)
        name = f"{prefix}.{item.name}"
        if isinstance(value, np.ndarray):
            arrays[name] = value
        elif dataclasses.is_dataclass(value):
            values[item.name] = _take_apart(name, value, arrays)
        else:
            values[item.name] = _plain(value)
    return values


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(entry) for entry in value]
    return value


def _put_together(kind: type[_Data], prefix: str, values: dict[str, Any], arrays: dict[str, Any]) -> _Data:
    found: dict[str, Any] = {}
    hints = typing.get_type_hints(kind)
    for item in dataclasses.fields(kind):  # type: ignore[arg-type]
        name = f"{prefix}.{item.name}"
        if name in arrays:
            found[item.name] = arrays[name]
        elif item.name in values:
            value = values[item.name]
            inner = _data_class(hints[item.name])
            if inner is not None and value is not None:
                value = _put_together(inner, name, value, arrays)
            found[item.name] = tuple(value) if isinstance(value, list) else value
        elif item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING:
            raise KeyError(name)
    return kind(**found)


def _data_class(hint: Any) -> Any:
    """Return the data class that a field may hold, alone or in a union with None; else None."""
    options = typing.get_args(hint) or (hint,)
    return next((option for option in options if dataclasses.is_dataclass(option)), None)


def _owner(loaded: Any) -> Any:
    """Make what NumPy reads, a view of its own buffer, an array that owns its numbers, read-only."""
    if isinstance(loaded, np.ndarray):
        loaded = loaded.copy()
        loaded.flags.writeable = False
    return loaded


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    require_file(path)
    foreign = FileFormatError(f"{path} is not a motion bundle of this package")
    with refused(path, "cannot be read"), open(path, "rb") as file:
        if not zipfile.is_zipfile(file):
            raise foreign
        # what zip files and NumPy's arrays say when they are damaged is of many kinds
        try:
            with zipfile.ZipFile(file) as archive:
                if archive.testzip() is not None:
                    raise zipfile.BadZipFile
            file.seek(0)
            loaded = np.load(file, allow_pickle=False)
            arrays = {name: _owner(loaded[name]) for name in loaded.files}
            header = json.loads(arrays.pop(HEADER).tobytes()) if HEADER in arrays else None
        except (Exception, MemoryError):
            raise FileFormatError(f"{path} is damaged: it cannot be read as a motion bundle") from None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise foreign
    version = header.get("format_version")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise FileFormatError(
            f"{path} has bundle version {json.dumps(version)}, expected at most {FORMAT_VERSION}: update "
            "this package"
        )
    return header, arrays
