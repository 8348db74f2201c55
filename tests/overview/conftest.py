"""The small case, described once: OpenSim starts slowly."""

import pytest
from tiny_model import Tiny, write_tiny

from scso_nlp.overview.info import ModelInfo, info


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Tiny:
    """The small case in a folder of its own."""
    return write_tiny(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="session")
def tiny_info(tiny: Tiny) -> ModelInfo:
    """What its setup holds."""
    return info(tiny.setup)
