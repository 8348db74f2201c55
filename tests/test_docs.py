"""The documentation keeps its word: its Python and shell lines run, its links lead somewhere.

Every page is followed from top to bottom in a folder that has the files of the embedded example
spine-load-height, as its first lines say. A line of a shell block that ends in ``# exit code N`` must end so.
Blocks that only illustrate are marked by another language than ``python`` and ``sh``; TOML blocks are read.
"""

from __future__ import annotations

import doctest
import importlib
import inspect
import re
import shlex
import shutil
import sys
import tomllib
from dataclasses import replace

import matplotlib.pyplot as plt
import pytest
from conftest import PROJECT_ROOT
from typer.testing import CliRunner

import scso_nlp.opensim.engine
import scso_nlp.run
from scso_nlp.cli import app
from scso_nlp.examples import example_folder
from scso_nlp.frame import Term

pytest.importorskip("sphinx", reason="needs Sphinx; pip install '.[docs]' brings it")

DOCS = PROJECT_ROOT / "docs"
sys.path.insert(0, str(DOCS / "_site"))
generated_pages, links, mathml = map(importlib.import_module, ("generated_pages", "links", "mathml"))

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


#: All that stability rows could need of a motion.
EVERYTHING = {
    "muscle_paths": True,
    "stability_axes": tuple(("all", axis) for axis in "xyz"),
    "curvature_coordinates": ("all",),
}


@pytest.fixture
def reader(tmp_path, monkeypatch, motions):
    """A folder to follow a page in; figures, which have tests of their own, are not drawn.

    Command lines find out themselves what they need of a motion: one that has everything stands for all.
    """
    for module, more in ((scso_nlp.opensim.engine, {}), (scso_nlp.run, EVERYTHING)):
        load = module.load_with_hashes

        def cached(motion, *, load=load, more=more, **options):
            return load(replace(motion, **more), **(options | {"cache": motions}))

        monkeypatch.setattr(module, "load_with_hashes", cached)
    # a motion that is there needs no worker
    monkeypatch.setattr(sys.modules["scso_nlp.cli.run"], "number_of_cores", lambda: 0)
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
    if "scso batch" in path.read_text(encoding="utf-8"):
        pytest.importorskip("distributed", reason="needs Dask; pip install '.[studies]' brings it")
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


# Docstrings ---------------------------------------------------------------------------------------


def documented():
    """Public functions and classes of the package, and of the modules that the site documents, by name."""
    for module in ("scso_nlp", *(f"scso_nlp.{name}" for name in generated_pages.MODULES)):
        names = generated_pages.names_of(module)
        yield from ((f"{module}.{name}", getattr(importlib.import_module(module), name)) for name in names)


DOCUMENTED = dict(documented())
WITH_EXAMPLES = {name: thing for name, thing in DOCUMENTED.items() if ">>>" in (inspect.getdoc(thing) or "")}


@pytest.fixture(scope="module")
def start(motions):
    """Names that the examples of docstrings start from."""
    names = {}
    exec(generated_pages.EXAMPLES_START, names)
    return names


@pytest.mark.opensim
@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_a_docstring_say_what_happens(name, start, reader):
    if name.startswith("scso_nlp.studies"):
        pytest.importorskip("distributed", reason="needs Dask; pip install '.[studies]' brings it")
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    said = []
    example = doctest.DocTestParser().get_doctest(
        inspect.getdoc(WITH_EXAMPLES[name]), dict(start), name, None, None
    )
    doctest.DocTestRunner(optionflags=flags).run(example, out=said.append)
    assert said == [], "".join(said)


def test_every_function_and_every_term_has_an_example():
    """Of the package's own names; what is returned is shown where it comes from."""
    terms = {name for name, thing in DOCUMENTED.items() if _is_term(thing)}
    functions = {name for name, thing in DOCUMENTED.items() if inspect.isfunction(thing)}
    asked = {name for name in terms | functions if name.count(".") == 1}
    assert sorted(asked - WITH_EXAMPLES.keys() - WITHOUT_EXAMPLE) == []


#: Shown in the example of `save_bundle`.
WITHOUT_EXAMPLE = {"scso_nlp.load_bundle"}


def _is_term(thing):
    kinds = Term | scso_nlp.StiffnessLaw
    return inspect.isclass(thing) and issubclass(thing, kinds) and not inspect.isabstract(thing)


# The built site -----------------------------------------------------------------------------------


def test_every_public_name_is_on_a_page_of_the_reference():
    pages = {name: text for name, text in generated_pages.pages() if name.startswith("api/")}
    text = "\n".join(pages.values())
    missing = [name for name in dir(scso_nlp) if f":: scso_nlp.{name}\n" not in text]
    assert [name for name in missing if not name.startswith("_") and name in scso_nlp.__all__] == []


def test_dead_links_and_what_is_loaded_from_outside_are_found(tmp_path):
    page = '<link rel="stylesheet" href="a.css"><a id="top" href="b.html#here"></a><img src="missing.png">'
    (tmp_path / "a.html").write_text(page + '<script src="https://example.org/x.js"></script>')
    (tmp_path / "b.html").write_text('<a href="a.html#top"></a><a href="https://example.org">outside</a>')
    (tmp_path / "a.css").write_text("@import url(//example.org/font.css);")
    assert sorted(links.faults(tmp_path)) == [
        "a.css: loads //example.org/font.css from outside",
        "a.html: dead link b.html#here",
        "a.html: dead link missing.png",
        "a.html: loads https://example.org/x.js from outside",
    ]


def test_formulas_become_mathml_or_say_that_they_cannot():
    half = mathml.mathml(r"\tfrac12\tilde\ell_T\big(x\big)", is_block=True)
    assert re.search(r"<mfrac[^>]*>\s*<mn>1</mn>\s*<mn>2</mn>\s*</mfrac>", half)
    assert "munder" not in half
    assert mathml.mathml(r"\big(x\big) y", is_block=False).count("<mrow>") == 1
    with pytest.raises(mathml.MathError):
        mathml.mathml(r"\nothing{x}", is_block=False)
