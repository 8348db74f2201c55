"""Fixtures for all tests."""

import os
from pathlib import Path

import numpy as np
import pytest

PROJECT_ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the third-party models and motions, which are not part of the package."""
    folder = (PROJECT_ROOT / os.environ.get("SCSO_SHARED_DATA", "../shared/data")).resolve()
    if not (folder / "SOURCE.md").is_file():
        pytest.skip(f"needs the third-party data, not found in {folder}; set SCSO_SHARED_DATA to its folder")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run."""
    return np.random.default_rng(20240417)
