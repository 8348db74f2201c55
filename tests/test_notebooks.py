"""Every notebook runs from top to bottom, is short, and holds the outputs of its own code.

``python tests/test_notebooks.py`` runs them all and stores what they show, for the code host and the site;
``python tests/test_notebooks.py 01`` those whose names begin so.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import warnings
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="needs nbformat; pip install '.[test]' brings it")
nbclient = pytest.importorskip("nbclient", reason="needs nbclient; pip install '.[test]' brings it")

NOTEBOOKS = sorted((Path(__file__).resolve().parent.parent / "notebooks").glob("*.ipynb"))

#: Words that a notebook on third-party data writes in its first cell.
NEEDS_DATA = "third-party data"
#: Key in a notebook's metadata: the digest of the code that its outputs are of.
RAN = "code_of_outputs"
#: Largest notebook [bytes]: its pictures are part of every clone.
LARGEST = 400_000


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def digest(notebook) -> str:
    """SHA-256 of all code."""
    return hashlib.sha256("\0".join(cell.source for cell in code_cells(notebook)).encode()).hexdigest()


def shown(cell) -> list[str]:
    """What kinds of things a cell shows; neighbouring pieces of a stream are one."""
    kinds = [
        out.name if out.output_type == "stream" else "+".join(sorted(out.get("data", {"error": ""})))
        for out in cell.outputs
        if not was_progress(out)
    ]
    return [kind for i, kind in enumerate(kinds) if kind != "stdout" or kinds[i - 1 : i] != ["stdout"]]


def was_progress(out) -> bool:
    """Tell whether an output showed how far something was, while it lasted."""
    return out.get("data") == {"text/plain": ""}


def run(notebook, folder: Path) -> None:
    """Run all cells of a notebook in a folder, with this package and the kernel's own figures."""
    root = str(NOTEBOOKS[0].parent.parent)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")])),
    }
    environment.pop("MPLBACKEND", None)
    client = nbclient.NotebookClient(
        notebook, timeout=900, record_timing=False, resources={"metadata": {"path": str(folder)}}
    )
    with warnings.catch_warnings():
        # The kernel's own libraries warn about themselves; ours are checked by the other tests.
        warnings.simplefilter("ignore")
        client.execute(env=environment)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_short_and_its_outputs_are_of_its_code(path):
    notebook = nbformat.read(path, 4)
    nbformat.validate(notebook)
    assert len(notebook.cells) < 15
    assert sum(cell.source.count("**Question.**") for cell in notebook.cells) == 1
    assert notebook.cells[0].cell_type == "markdown"
    assert "**Question.**" in notebook.cells[0].source
    remedy = "run: python tests/test_notebooks.py"
    assert notebook.metadata.get(RAN) == digest(notebook), remedy
    counts = [cell.execution_count for cell in code_cells(notebook)]
    assert counts == list(range(1, len(counts) + 1)), remedy
    assert path.stat().st_size < LARGEST
    for cell in code_cells(notebook):
        assert all(
            "image/png" in kind or kind in ("stdout", "text/plain", "text/html+text/plain")
            for kind in shown(cell)
        )
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
    stored = [shown(cell) for cell in code_cells(notebook)]
    run(notebook, tmp_path)
    code = code_cells(notebook)
    assert all(cell.execution_count for cell in code)
    drawn = [out for cell in code for out in cell.outputs if "image/png" in out.get("data", {})]
    # a figure that is made without pyplot is only seen after %matplotlib inline
    words = ("plot_", ".plot.", "plt.", "_figure(")
    makes_figures = any(word in cell.source for cell in code for word in words)
    assert bool(drawn) == makes_figures
    assert [shown(cell) for cell in code] == stored, "run: python tests/test_notebooks.py"


def store(path: Path) -> None:
    """Run a notebook and keep its outputs in its file; all else stays."""
    notebook = nbformat.read(path, 4)
    metadata = dict(notebook.metadata)
    with tempfile.TemporaryDirectory() as folder:
        run(notebook, Path(folder))
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
    for cell in code_cells(notebook):
        cell.outputs = [out for out in cell.outputs if not was_progress(out)]
    notebook.metadata = {**metadata, RAN: digest(notebook)}
    nbformat.write(notebook, path)


if __name__ == "__main__":
    for path in NOTEBOOKS:
        if path.name.startswith(tuple(sys.argv[1:]) or ""):
            store(path)
