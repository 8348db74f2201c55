"""Versions of this package and of what it stands on, read without importing them."""

from __future__ import annotations

import functools
import importlib.metadata
import platform

_PACKAGES = ("scso_nlp", "casadi", "numpy", "scipy", "opensim")


def version_of(package: str) -> str | None:
    """Return the version of an installed package, or None."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def versions() -> dict[str, str]:
    """Versions by name, this package's first."""
    return dict(_versions())


@functools.cache
def _versions() -> dict[str, str]:
    packages = {name: version_of(name) or "not installed" for name in _PACKAGES}
    return {"scso_nlp": packages["scso_nlp"], "python": platform.python_version(), **packages}
