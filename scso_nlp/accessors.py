"""Accessors: what upper rooms offer on the data of lower ones, e.g. figures as ``solution.plot``.

Lower rooms do not know upper ones; the package, which knows all, says where each accessor is.
"""

from __future__ import annotations

import pkgutil
from typing import Any

_PLACES: dict[str, str] = {}


def offer(name: str, place: str) -> None:
    """Say what an accessor is.

    Parameters
    ----------
    name : str
        As the attribute of the data is called.
    place : str
        Module and class, ``"package.module:Class"``, imported on first use.
    """
    _PLACES[name] = place


def accessor(name: str, data: object) -> Any:
    """Make an accessor of some data.

    Parameters
    ----------
    name : str
        As it was offered.
    data : object

    Returns
    -------
    object
        Of the class that was offered, made of `data`.
    """
    return pkgutil.resolve_name(_PLACES[name])(data)
