"""Fixtures of the engine's tests."""

from pathlib import Path

import pytest
from tiny_model import Tiny, write_tiny


@pytest.fixture
def tiny(tmp_path: Path) -> Tiny:
    """The small case in a folder of its own."""
    return write_tiny(tmp_path)
