"""The documentation keeps its word: its Python and shell lines run, its links lead somewhere.

Every page is followed from top to bottom in a folder that has the files of the embedded example
spine-load-height, as its first lines say. A line of a shell block that ends in ``# exit code N`` must end so.
Blocks that only illustrate are marked by another language than ``python`` and ``sh``; TOML blocks are read.
"""

from __future__ import annotations

import re
import shlex
import shutil
import tomllib

import matplotlib.pyplot as plt
import pytest
from conftest import PROJECT_ROOT
from typer.testing import CliRunner

import scso_nlp.opensim.engine
import scso_nlp.run
from scso_nlp.cli import app
from scso_nlp.examples import example_folder

DOCS = PROJECT_ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "generated" not in path.parts)
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
EXIT_CODE = re.compile(r"#.*\bexit code (\d+)")


def blocks(path):
    """Languages and texts of a page's fenced blocks."""
    return BLOCK.findall(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def motions(tmp_path_factory):
    """One folder of extracted motions for all pages: OpenSim starts once for each."""
    return tmp_path_factory.mktemp("motions")


@pytest.fixture
def reader(tmp_path, monkeypatch, motions):
    """A folder to follow a page in; figures, which have tests of their own, are not drawn."""
    for module in (scso_nlp.opensim.engine, scso_nlp.run):
        load = module.load_with_hashes

        def cached(motion, *, load=load, **more):
            return load(motion, **(more | {"cache": motions}))

        monkeypatch.setattr(module, "load_with_hashes", cached)
    monkeypatch.setattr("scso_nlp.figures.draw_and_save", lambda draw, folder, name: ())
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    plt.close("all")


def shell(line):
    """Run a command line of scso in this process; give its exit code and what it said."""
    words = shlex.split(line, comments=True)
    assert words[0] == "scso", f"{line!r}: only lines of scso run in the docs; mark others as text"
    done = CliRunner().invoke(app, words[1:], prog_name="scso")
    return done.exit_code, done.output


@pytest.mark.opensim
@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(DOCS)))
def test_a_page_can_be_followed_from_top_to_bottom(path, reader):
    if "--copy ." not in path.read_text(encoding="utf-8") or path.parent != DOCS:
        shutil.copytree(example_folder("spine-load-height"), reader, dirs_exist_ok=True)
        (reader / "scso.toml").unlink()
    names = {}
    for language, text in blocks(path):
        if language == "python":
            exec(compile(text, path.name, "exec"), names)
        elif language == "toml":
            _write_toml(reader, text)
        elif language == "sh":
            for line in filter(None, text.splitlines()):
                expected = EXIT_CODE.search(line)
                code, said = shell(line)
                assert code == (int(expected.group(1)) if expected else 0), f"{line}\n{said}"


def _write_toml(folder, text):
    """Read a block of TOML; one that begins with the name of a file is that file."""
    tomllib.loads(text)
    if named := re.match(r"# (\S+\.toml)\n", text):
        (folder / named.group(1)).write_text(text, encoding="utf-8")
