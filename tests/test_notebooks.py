"""Every notebook runs from top to bottom, is short, and is committed without outputs."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="needs nbformat; pip install '.[test]' brings it")
nbclient = pytest.importorskip("nbclient", reason="needs nbclient; pip install '.[test]' brings it")

NOTEBOOKS = sorted((Path(__file__).resolve().parent.parent / "notebooks").glob("*.ipynb"))

#: Words that a notebook on third-party data writes in its first cell.
NEEDS_DATA = "third-party data"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_short_and_has_no_outputs(path):
    notebook = nbformat.read(path, 4)
    nbformat.validate(notebook)
    assert len(notebook.cells) < 15
    assert sum(cell.source.count("**Question.**") for cell in notebook.cells) == 1
    assert notebook.cells[0].cell_type == "markdown"
    assert "**Question.**" in notebook.cells[0].source
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None
            bodies = cell.source.split("\ndef ") if "def " in cell.source else []
            assert all(len(body.strip().split("\n\n\n")[0].splitlines()) <= 10 for body in bodies)


@pytest.mark.slow
@pytest.mark.opensim
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_top_to_bottom(path, tmp_path, request, monkeypatch):
    notebook = nbformat.read(path, 4)
    if NEEDS_DATA in notebook.cells[0].source:
        monkeypatch.setenv(
            "SCSO_DATA", os.environ.get("SCSO_DATA") or str(request.getfixturevalue("shared_data"))
        )
    # the kernel's own choice, as for a reader
    monkeypatch.delenv("MPLBACKEND", raising=False)
    root = str(path.parent.parent)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")])))
    client = nbclient.NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}})
    with warnings.catch_warnings():
        # The kernel's own libraries warn about themselves; ours are checked by the other tests.
        warnings.simplefilter("ignore")
        client.execute()
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    drawn = [out for cell in code for out in cell.outputs if "image/png" in out.get("data", {})]
    # a figure that is made without pyplot is only seen after %matplotlib inline
    makes_figures = any(word in cell.source for cell in code for word in ("plot_", "plt.", "_figure("))
    assert bool(drawn) == makes_figures
