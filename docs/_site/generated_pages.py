"""Pages that are made from what they describe: settings, commands, result files, public names, notebooks.

They are written to ``docs/generated`` before every build, so that nothing stands twice.
"""

from __future__ import annotations

import ast
import base64
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import nbformat
from sphinx.application import Sphinx
from typer import Context
from typer.main import get_command

import scso_nlp
from scso_nlp.cli import app as command_line
from scso_nlp.declared_settings import reference
from scso_nlp.report.contents import RESULT_FILES, STATUS_CODES
from scso_nlp.report.results import FIGURES

PACKAGE = Path(scso_nlp.__file__).parent
NOTEBOOKS = Path(__file__).parents[2] / "notebooks"

#: Page of the public names of each folder or file of the package; others go to the last one.
API_PAGES = {
    "motion": ("Motions", ("opensim", "overview", "motion", "trajectory", "muscles", "io")),
    "problem": ("Problems", ("problem", "methods")),
    "muscle_models": ("Muscle models and stiffness laws", ("muscle_models",)),
    "objectives": ("Objectives", ("objectives",)),
    "constraints": ("Constraints", ("constraints", "stability")),
    "solve": ("Solving", ("solver",)),
    "solution": ("Solutions", ("solution", "contributions")),
    "sensitivities": ("Sensitivities and calibration", ("sensitivities", "calibration")),
    "results": ("Files and figures", ("report", "figures")),
    "terms": ("The language of terms", ("frame", "transcription")),
    "exceptions": ("Errors", ("exceptions",)),
    "more": ("More", ()),
}
#: Modules for scripts whose names are not among the package's own.
MODULES = {
    "run": "From settings to files",
    "settings": "Settings of a run",
    "emg": "Electromyography",
    "examples": "Embedded examples",
    "studies": "Studies",
}
#: What the examples of docstrings start from.
EXAMPLES_START = """\
from dataclasses import replace

import scso_nlp as scso
from scso_nlp.examples import example_folder

motion = scso.load_motion(example_folder("elbow") / "setup.xml", curvature_coordinates="all")
problem = scso.MuscleForceProblem(
    motion=motion,
    muscle_model=scso.NoPhysiology(),
    objectives=(scso.ActivationEffort(exponent=2.0),),
    constraints=(scso.MomentEquilibrium(), scso.JointStability(axes=["z"], q=5.0)),
)
solution = scso.solve_trajectory(problem)
"""
#: Width of help texts [characters].
_WIDTH = 86


def pages() -> Iterator[tuple[str, str | bytes]]:
    """Make every page: its path below the folder, and what it holds."""
    yield "settings.md", reference()
    yield "command_line.md", _command_line()
    yield "result_files.md", _result_files()
    yield from _api()
    yield from _gallery()


def _command_line() -> str:
    group = get_command(command_line)
    parts = [
        "# Command line\n",
        "What `--help` says of every command; settings are explained [one by one](settings.md).\n",
    ]
    for name, command in group.commands.items():
        context = Context(command, info_name=f"scso {name}", terminal_width=_WIDTH, max_content_width=_WIDTH)
        parts.append(f"## scso {name}\n\n```output\n{command.get_help(context)}\n```\n")
    return "\n".join(parts)


def _result_files() -> str:
    lines = ["| file | what |", "|---|---|"]
    for file in RESULT_FILES:
        name = file.name.format(name="<name>", analysis="StaticOptimization")
        lines.append(f"| `{name}` | {file.holds} |")
    lines += [f"| `<name>_{figure}.png`, `.pdf` | figure |" for figure in FIGURES]
    lines += [
        "",
        "Numbers of the column `status` in `<name>_status.sto`:",
        "",
        "| | status | meaning |",
        "|---|---|---|",
    ]
    lines += [f"| {code} | `{status.name}` | {status.value} |" for status, code in STATUS_CODES.items()]
    return "\n".join(lines) + "\n"


def public_names() -> dict[str, list[str]]:
    """Give the names of ``__init__.pyi`` by the folder or file that they stand in."""
    found: dict[str, list[str]] = {}
    for node in ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            room = node.module.split(".")[0]
            found.setdefault(room, []).extend(alias.asname or alias.name for alias in node.names)
    return found


def _api() -> Iterator[tuple[str, str]]:
    names = public_names()
    written = []
    for page, (title, rooms) in API_PAGES.items():
        chosen = [name for room in rooms for name in names.pop(room, [])]
        chosen += [] if rooms else [name for left in names.values() for name in left]
        if chosen:
            written.append(page)
            yield f"api/{page}.rst", _names_page(title, "scso_nlp", chosen)
    for module, title in MODULES.items():
        yield (
            f"api/{module}_module.rst",
            _names_page(f"{title}: scso_nlp.{module}", f"scso_nlp.{module}", names_of(f"scso_nlp.{module}")),
        )
    toctree = [f"   {page}" for page in (*written, *(f"{module}_module" for module in MODULES))]
    text = [
        "Python",
        "======\n",
        "Every public name, from its docstring. Arrays have frames first, units are SI, angles in radians.",
        "Examples start from these lines::\n",
        *(f"   {line}" for line in EXAMPLES_START.splitlines()),
        "",
        ".. toctree::\n",
        *toctree,
    ]
    yield "api/index.rst", "\n".join(text) + "\n"


def names_of(module: str) -> list[str]:
    """Public functions and classes of a module, or of the files of a folder.

    Parameters
    ----------
    module : str

    Returns
    -------
    list of str
    """
    loaded = importlib.import_module(module)
    if loaded is scso_nlp:
        return [name for names in public_names().values() for name in names]
    # what is imported on first use is listed
    found = {name: getattr(loaded, name) for name in getattr(loaded, "__all__", vars(loaded))}
    return [
        name
        for name, thing in found.items()
        if not name.startswith("_")
        and (inspect.isclass(thing) or inspect.isfunction(thing))
        and thing.__module__.startswith(loaded.__name__)
    ]


def _names_page(title: str, module: str, names: list[str]) -> str:
    loaded = importlib.import_module(module)
    lines = [title, "=" * len(title), "", f".. currentmodule:: {module}", ""]
    for name in names:
        thing = getattr(loaded, name)
        if inspect.isclass(thing):
            members = "" if issubclass(thing, BaseException) else "\n   :members:"
            lines.append(f".. autoclass:: {module}.{name}{members}\n")
        else:
            lines.append(f".. autofunction:: {module}.{name}\n")
    return "\n".join(lines)


def _gallery() -> Iterator[tuple[str, str | bytes]]:
    lines = ["# Gallery\n", "Notebooks that run as they are; each answers one question.\n"]
    toctree = []
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = nbformat.read(path, 4)
        first = notebook.cells[0].source
        title = first.splitlines()[0].removeprefix("# ")
        question = re.search(r"\*\*Question\.\*\*\s*(.*?)(?=\n\n|\Z)", first, flags=re.DOTALL)
        pictures = [
            output.data["image/png"]
            for cell in notebook.cells
            if cell.cell_type == "code"
            for output in cell.outputs
            if "image/png" in output.get("data", {})
        ]
        lines.append(f"## [{title}](notebooks/{path.name})\n")
        lines.append((question.group(1) if question else "") + "\n")
        if pictures:
            yield f"pictures/{path.stem}.png", base64.b64decode(pictures[0])
            lines.append(f"![A figure of the notebook: {title}](pictures/{path.stem}.png)\n")
        toctree.append(f"notebooks/{path.stem}")
        yield f"notebooks/{path.name}", path.read_text(encoding="utf-8")
    lines += ["```{toctree}", ":hidden:", *toctree, "```"]
    yield "gallery.md", "\n".join(lines) + "\n"


def write(app: Sphinx) -> None:
    """Write pages that have changed, and drop those that are no longer made."""
    folder = Path(app.srcdir) / "generated"
    made = set()
    for name, content in pages():
        path = folder / name
        made.add(path)
        data = content.encode() if isinstance(content, str) else content
        if not path.is_file() or path.read_bytes() != data:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
    for path in folder.rglob("*"):
        if path.is_file() and path not in made:
            path.unlink()


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the pages before sources are looked for."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
