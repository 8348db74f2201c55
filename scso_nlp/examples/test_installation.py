"""Whether an installation works, without the source tree: ``pytest --pyargs scso_nlp``.

Every embedded example is solved by this package and by OpenSim itself, each in processes of their own.
"""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scso_nlp.examples import example_names
from scso_nlp.io.storage import read_storage

#: OpenSim's own static optimization of a setup file.
OPENSIM = """
import sys, opensim
tool = opensim.AnalyzeTool(sys.argv[1])
tool.setResultsDir("by_opensim")
sys.exit(not tool.run())
"""
#: OpenSim's optimizer stops this near to the optimum [-].
TOLERANCE = 0.01
#: What rounding may take from a row [N·m/rad], or as a share of the effort [-].
ROUNDING = 1e-6


def run(folder: Path, *arguments: str) -> None:
    """Run Python in a folder, so that neither sources nor earlier files are found there."""
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.skipif(importlib.util.find_spec("opensim") is None, reason="there is no OpenSim here")
@pytest.mark.parametrize("name", example_names())
def test_an_example_is_as_opensim_has_it_and_its_joints_stay_stable(name: str, tmp_path: Path) -> None:
    """OpenSim's activations without stability rows; with them none is below its level, at no less effort."""
    run(tmp_path, "-m", "scso_nlp", "example", name, "--output", ".")
    run(tmp_path, "-m", "scso_nlp", "example", name, "--copy", "setup")
    run(tmp_path, "-c", OPENSIM, "setup/setup.xml")
    plain, stable = tmp_path / "static_optimization", tmp_path / "with_stability"
    reports = [json.loads((folder / "report.json").read_text(encoding="utf-8")) for folder in (plain, stable)]
    motion = reports[0]["name"]
    ours, theirs = (
        read_storage(folder / f"{motion}_StaticOptimization_activation.sto")
        for folder in (plain, tmp_path / "setup" / "by_opensim")
    )
    assert ours.labels == theirs.labels
    np.testing.assert_allclose(ours.values, theirs.values, atol=TOLERANCE)
    rows = read_storage(stable / f"{motion}_stability.sto")
    margins = [label for label in rows.labels if label.endswith("_margin")]
    assert rows.columns(margins).min() >= -ROUNDING
    before, after = (report["objective"]["total"] for report in reports)
    assert after >= (1 - ROUNDING) * before
    assert {path.suffix for path in stable.glob(f"{motion}_activations.*")} == {".png", ".pdf"}
