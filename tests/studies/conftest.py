"""Studies of small motions in plain folders."""

import shutil
from pathlib import Path

import pytest

from scso_nlp.examples import example_folder

ELBOW = ("elbow.osim", "external_loads.xml", "loads.mot", "motion.mot", "setup.xml")


def put_elbow(folder: Path) -> Path:
    """Make a folder with a setup of the embedded elbow and all that it needs; give the setup."""
    folder.mkdir(parents=True)
    for name in ELBOW:
        shutil.copy(example_folder("elbow") / name, folder)
    return folder / "setup.xml"


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """Two people, one with two trials."""
    folder = tmp_path / "lab"
    for place in ("S1/hold", "S1/lift", "S2/hold"):
        put_elbow(folder / place)
    return folder
