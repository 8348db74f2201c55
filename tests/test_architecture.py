"""Rules of the house: who may import what, what is exported, documented and tested."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import random_problem, with_joint_reactions, with_trajectory
from muscle_models import opensim_tables

import scso_nlp as scso
from scso_nlp.muscle_models.hill_muscle import HillCurves
from scso_nlp.muscle_models.muscle_classes import MUSCLE_CLASSES
from scso_nlp.transcription.describe import describe
from scso_nlp.transcription.piece import evaluate

PACKAGE = Path(scso.__file__).parent
TESTS = Path(__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))

#: Folders and files that may speak CasADi.
SYMBOLIC = ("frame", "muscle_models", "objectives", "constraints", "transcription", "solver")

#: The rooms of the house from bottom to top. A room knows those below it, never those above.
LAYERS = (
    "accessors",
    "exceptions",
    "text",
    "display",
    "files",
    "signals",
    "messages",
    "progress",
    "versions",
    "validation",
    "arguments",
    "needs",
    "joint_reactions",
    "trajectory",
    "muscles",
    "motion",
    "activity",
    "stability",
    "frame",
    "muscle_models",
    "objectives",
    "constraints",
    "problem",
    "methods",
    "transcription",
    "verdict",
    "solution",
    "solver",
    "sensitivities",
    "contributions",
    "io",
    "opensim",
    "emg",
    "calibration",
    "figures",
    "report",
    "examples",
    "declared_settings",
    "settings",
    "run",
    "overview",
    "first_settings",
    "studies",
    "cli",
    "__main__",
)

#: The one package that may import OpenSim; it runs in processes of its own.
WORKER = "scso_nlp.opensim.worker"
#: All that a worker may load of this package besides itself.
OF_USE_TO_THE_WORKER = (
    "scso_nlp",
    "scso_nlp.accessors",
    "scso_nlp.exceptions",
    "scso_nlp.files",
    "scso_nlp.opensim",
    "scso_nlp.text",
    "scso_nlp.validation",
)

#: Parts that work without CasADi, so that they can share a process with OpenSim or start fast.
WITHOUT_CASADI = (
    "scso_nlp",
    "scso_nlp.exceptions",
    "scso_nlp.text",
    "scso_nlp.files",
    "scso_nlp.signals",
    "scso_nlp.messages",
    "scso_nlp.progress",
    "scso_nlp.versions",
    "scso_nlp.validation",
    "scso_nlp.joint_reactions",
    "scso_nlp.trajectory",
    "scso_nlp.muscles",
    "scso_nlp.stability",
    "scso_nlp.stability.potvin_brown",
    "scso_nlp.stability.external_work",
    "scso_nlp.io",
    "scso_nlp.io.storage",
    "scso_nlp.io.bundle",
    "scso_nlp.emg",
    "scso_nlp.opensim.setup_xml",
    "scso_nlp.opensim.worker.exchange",
    "scso_nlp.opensim.worker.process",
    "scso_nlp.opensim.engine",
    "scso_nlp.examples",
    "scso_nlp.declared_settings",
)


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = [module_name(path) for path in FILES if path.name != "__main__.py"]


# Imports ------------------------------------------------------------------------------------------


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Top-level packages that a file imports when it runs (not for type checkers only)."""
    found: list[str] = []

    def visit(node: ast.AST) -> None:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        if isinstance(node, ast.Import):
            found.extend(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.append(node.module.split(".")[0])
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text(encoding="utf-8")))
    return tuple(found)


def room(module: str) -> str:
    """Folder or file of the package that a module stands in; empty for the package itself."""
    return ".".join(module.split(".")[1:2])


def test_only_the_symbolic_folders_import_casadi():
    found = {room(module_name(path)) for path in FILES if "casadi" in imports(path)}
    assert found <= set(SYMBOLIC)


@cache
def imported_modules(path: Path) -> frozenset[str]:
    """Modules of the package that a file imports, anywhere and for type checkers too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("scso_nlp"):
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in ALL_MODULES else node.module for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name in ALL_MODULES}
    return frozenset(found - {module_name(path)})


ALL_MODULES = frozenset(module_name(path) for path in FILES)


def arrows_up(sources: dict[str, frozenset[str]]) -> list[str]:
    """Imports from a room above one's own; the package itself, which knows all public names, is above all."""
    return [
        f"{module} -> {other}"
        for module, others in sources.items()
        for other in sorted(others)
        if module != "scso_nlp"
        and room(other) != room(module)
        and (*LAYERS, "").index(room(other)) > LAYERS.index(room(module))
    ]


def test_every_room_has_its_place_in_the_order():
    assert {room(name) for name in ALL_MODULES} - {""} == set(LAYERS)


def test_no_arrow_goes_up():
    assert arrows_up({module_name(path): imported_modules(path) for path in FILES}) == []


def test_an_arrow_up_would_be_seen():
    sources = {"scso_nlp.frame": frozenset({"scso_nlp.problem", "scso_nlp.motion"})}
    assert arrows_up(sources) == ["scso_nlp.frame -> scso_nlp.problem"]


def test_no_circle_of_files():
    """Also within a room, and through imports for type checkers."""
    graph = {module_name(path): imported_modules(path) for path in FILES}
    del graph["scso_nlp"]
    graph = {name: others & graph.keys() for name, others in graph.items()}
    while leaves := [name for name, others in graph.items() if not others]:
        graph = {name: others - set(leaves) for name, others in graph.items() if others}
    assert sorted(graph) == [], "these files stand in a circle, or above one"


def test_only_solver_sensitivities_and_the_list_of_public_names_know_the_transcription():
    knowing = {p for p in FILES if any(room(m) == "transcription" for m in imported_modules(p))}
    assert {room(module_name(p)) for p in knowing} <= {"", "transcription", "solver", "sensitivities"}


#: Modules that a process with CasADi cannot import.
WITH_OPENSIM = [module_name(path) for path in FILES if "opensim" in imports(path)]


def test_only_the_worker_imports_opensim():
    assert f"{WORKER}.model" in WITH_OPENSIM
    assert [name for name in WITH_OPENSIM if not name.startswith(f"{WORKER}.")] == []


@pytest.mark.opensim
def test_a_worker_loads_nothing_of_the_package_but_its_own_files():
    """It would pay for the rest with every start, and CasADi cannot live beside OpenSim."""
    program = (
        f"import sys, {', '.join(WITH_OPENSIM)}\n"
        "print(*(name for name in sys.modules if name.split('.')[0] in ('scso_nlp', 'casadi')))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = done.stdout.splitlines()[-1].split()
    assert f"{WORKER}.extraction" in loaded
    others = [name for name in loaded if name != WORKER and not name.startswith(f"{WORKER}.")]
    assert sorted(others) == sorted(OF_USE_TO_THE_WORKER)


def test_parts_that_promise_it_do_without_casadi_and_opensim():
    """In a fresh interpreter, one after the other; the first that brings CasADi in is named."""
    program = (
        "import importlib, sys\n"
        f"for name in {WITHOUT_CASADI!r}:\n"
        "    importlib.import_module(name)\n"
        "    for other in ('casadi', 'opensim'):\n"
        "        assert other not in sys.modules, f'{name} imports {other}'\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_problems_and_the_package_import_nothing_from_the_tests():
    modules = {path.stem for path in TESTS.rglob("*.py")} | {"tests"}
    files = [*FILES, *(PACKAGE.parent / "problems").rglob("*.py")]
    assert [str(path) for path in files if modules & set(imports(path))] == []


def test_no_file_subclasses_or_uses_opti():
    assert [str(path) for path in FILES if re.search(r"\bOpti\b", path.read_text(encoding="utf-8"))] == []


def test_no_module_is_called_after_nothing():
    vague = {"utils", "helpers", "common", "misc"}
    assert [name for name in MODULES if vague & set(name.split("."))] == []


def test_nothing_prints():
    """Results go to files, words to the log; only the command line speaks to the user."""
    wrong = []
    for path in FILES:
        if path.relative_to(PACKAGE).parts[0] == "cli":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print":
                wrong.append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    assert wrong == []


# Public names -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", scso.__all__)
def test_every_public_name_is_there_and_documented(name):
    thing = getattr(scso, name)
    assert inspect.getdoc(thing), f"{name} has no docstring"
    home = thing.__name__ if inspect.ismodule(thing) else thing.__module__
    assert home.startswith("scso_nlp"), f"{name} is not the package's own"


def test_public_names_are_the_same_for_type_checkers():
    """The stub names each public name once, by the module that it is imported from on first use."""
    lines = (PACKAGE / "__init__.pyi").read_text(encoding="utf-8").splitlines()[2:]
    # a stub gives out only what is imported under a name of its own
    parts = [re.fullmatch(r"from \.([\w.]*) import (\w+) as \2", line).groups() for line in lines]
    assert parts == sorted(parts)
    assert [name for home, name in parts if not home] == ["studies"]
    assert sorted(name for _, name in parts) == scso.__all__
    assert all(
        getattr(scso, name) is getattr(importlib.import_module(f"scso_nlp.{home}".rstrip(".")), name)
        for home, name in parts
    )


def test_an_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"attribute '?Solve'?$"):
        scso.Solve  # noqa: B018
    assert set(scso.__all__) <= set(dir(scso))


# Terms --------------------------------------------------------------------------------------------


def _import_all() -> None:
    for name in MODULES:
        if name not in WITH_OPENSIM:
            importlib.import_module(name)


def _concrete(*bases: type) -> list[type]:
    """All concrete classes of the package below some base classes."""
    found: dict[str, type] = {}
    waiting = list(bases)
    while waiting:
        for child in waiting.pop().__subclasses__():
            waiting.append(child)
            if not inspect.isabstract(child) and child.__module__.startswith("scso_nlp."):
                found[child.__name__] = child
    return [found[name] for name in sorted(found)]


_import_all()
OBJECTIVES = _concrete(scso.FrameObjective, scso.FramePairObjective)
CONSTRAINTS = _concrete(scso.FrameConstraint, scso.FramePairConstraint)
MODELS = _concrete(scso.MuscleModel)
TERMS = OBJECTIVES + CONSTRAINTS + MODELS


def test_the_terms_are_found():
    assert {scso.ActivationEffort, scso.FunctionObjective} <= set(OBJECTIVES)
    assert {scso.MomentEquilibrium, scso.JointStability} <= set(CONSTRAINTS)
    assert {scso.NoPhysiology, scso.RigidTendon} <= set(MODELS)


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.__name__)
def test_every_term_is_a_public_name(term):
    assert term.__name__ in scso.__all__, f"add {term.__name__} to scso_nlp/__init__.pyi"


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.__name__)
def test_every_term_has_a_test_file_with_tests_that_name_it(term):
    _, folder, module = term.__module__.split(".")
    file = TESTS / folder / f"test_{module}.py"
    assert file.is_file(), f"{term.__name__} has no tests/{folder}/test_{module}.py"
    text = file.read_text(encoding="utf-8")
    tests = [node for node in ast.parse(text).body if getattr(node, "name", "").startswith("test_")]
    naming = [test for test in tests if term.__name__ in (ast.get_source_segment(text, test) or "")]
    assert naming, f"no test of tests/{folder}/test_{module}.py names {term.__name__}"


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.__name__)
def test_every_term_is_frozen_and_takes_names_only(term):
    assert dataclasses.is_dataclass(term)
    assert term.__dataclass_params__.frozen
    assert all(field.kw_only for field in dataclasses.fields(term))


@pytest.mark.parametrize("term", OBJECTIVES, ids=lambda term: term.__name__)
def test_every_objective_says_the_unit_of_its_weight_and_what_it_depends_on(term):
    first = inspect.getdoc(term).split("\n\n")[0]
    assert re.search(r"weight \[.+?\]", first, re.DOTALL)
    assert "depends on: " in first


@pytest.mark.parametrize("term", CONSTRAINTS, ids=lambda term: term.__name__)
def test_every_constraint_says_what_it_depends_on(term):
    assert re.search(r"depends on: (one frame|two frames)", inspect.getdoc(term).split("\n\n")[0])


@pytest.mark.parametrize(
    "base", [scso.FrameObjective, scso.FramePairObjective, scso.FrameConstraint, scso.FramePairConstraint]
)
def test_a_term_that_forgets_its_mathematics_cannot_be_made(base):
    with pytest.raises(TypeError, match="abstract"):
        type("Forgetful", (base,), {})()


_ACTIVITY = scso.MuscleActivity(groups=("a",), muscles=(("m*",),), time=[-1.0, 99.0], values=[[0.2], [0.4]])
#: How to make terms that need arguments.
EXAMPLES = {
    "EmgTracking": {"activity": _ACTIVITY},
    "EmgBounds": {"activity": _ACTIVITY},
    "FunctionObjective": {"function": lambda frame: ca.sumsqr(frame.activation)},
    "JointReactionLimit": {"largest": 2000.0},
}


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.__name__)
def test_every_term_has_finite_values_and_derivatives_inside_its_bounds(term):
    rng = np.random.default_rng(12)
    problem = _with_curvature(random_problem(rng, n_frames=3, n_muscles=6, reserve=5.0), rng)
    problem = with_joint_reactions(problem, rng)
    example = term(**EXAMPLES.get(term.__name__, {}))
    if term in MODELS:
        problem = dataclasses.replace(problem, muscle_model=example)
    elif term in OBJECTIVES:
        problem = dataclasses.replace(problem, objectives=(example,))
    else:
        problem = dataclasses.replace(problem, constraints=(example,))
    program = describe(problem)
    pieces = [piece for _, piece in program.objectives] + [
        block.piece for block in (*program.rows.blocks, *program.pair_rows.blocks, *program.matrices)
    ]
    pieces.append(program.tendon_force)
    lower, upper = (np.clip(program.layout.rows(what, 3), -1.0, 1.0) for what in ("lower", "upper"))
    x = (lower + rng.uniform(0.2, 0.8, lower.shape) * (upper - lower)) / program.layout.scale
    for piece in pieces:
        unknowns = ca.vertcat(*piece.unknowns)
        multipliers = ca.DM(rng.normal(size=piece.expression.numel()))
        function = piece.function(
            ca.densify(piece.expression),
            ca.densify(ca.jacobian(piece.expression, unknowns)),
            ca.densify(ca.hessian(ca.dot(multipliers, ca.vec(piece.expression)), unknowns)[0]),
        )
        for values in evaluate(piece, function, x, program.arrays):
            assert np.isfinite(values).all()


def _with_curvature(problem, rng):
    """The problem with random path curvature of its coordinates, for constraints that ask for it."""
    from scso_nlp.trajectory import CoordinateCurvature

    trajectory = problem.motion.trajectory
    n_frames, n, n_muscles = trajectory.moment_arms.shape
    curvature = rng.normal(0, 0.02, (n_frames, n, n, n_muscles))
    given = CoordinateCurvature(
        coordinates=trajectory.coordinates,
        path_curvature=curvature + curvature.transpose(0, 2, 1, 3),
        load_stiffness=np.zeros((n_frames, n, n)),
        passive_stiffness=np.zeros((n_frames, n, n)),
        asymmetry=np.zeros((n_frames, n_muscles)),
        is_uncertain=np.zeros((n_frames, n_muscles), dtype=bool),
    )
    return with_trajectory(problem, curvature=given)


# Docstrings ---------------------------------------------------------------------------------------


def _own(module: str) -> list[tuple[str, object]]:
    """Public functions, classes and methods that a module defines."""
    loaded = importlib.import_module(module)
    found: list[tuple[str, object]] = []
    for name, thing in vars(loaded).items():
        if name.startswith("_") or getattr(thing, "__module__", None) != module:
            continue
        if inspect.isfunction(thing):
            found.append((f"{module}.{name}", thing))
        elif inspect.isclass(thing):
            found.append((f"{module}.{name}", thing))
            found += [
                (f"{module}.{name}.{key}", method)
                for key, method in vars(thing).items()
                if inspect.isfunction(method) and not key.startswith("_")
            ]
    return found


THINGS = [
    (name, thing)
    for module in MODULES
    # Commands of the command line are documented by their options' help texts.
    if module not in WITH_OPENSIM and not module.startswith("scso_nlp.cli")
    for name, thing in _own(module)
]
FUNCTIONS = [(name, thing) for name, thing in THINGS if inspect.isfunction(thing)]
DATA = [(name, thing) for name, thing in THINGS if dataclasses.is_dataclass(thing)]


def _section(doc: str, title: str) -> list[str] | None:
    """Names listed in a numpydoc section, or None where the section is missing."""
    lines = inspect.cleandoc(doc).splitlines()
    for at in range(len(lines) - 1):
        if lines[at].strip() == title and set(lines[at + 1].strip()) == {"-"}:
            break
    else:
        return None
    names: list[str] = []
    for k in range(at + 2, len(lines)):
        line = lines[k]
        if k + 1 < len(lines) and lines[k + 1].strip() and set(lines[k + 1].strip()) == {"-"}:
            break
        if line and not line[0].isspace():
            listed = line.split(" : ")[0].strip()
            names += [name.strip().lstrip("*") for name in listed.split(",")]
    return names


@pytest.mark.parametrize("module", [name for name in MODULES if name not in WITH_OPENSIM])
def test_every_module_class_and_function_is_documented(module):
    assert importlib.import_module(module).__doc__
    missing = [name for name, thing in _own(module) if not inspect.getdoc(thing)]
    assert missing == []


@pytest.mark.parametrize(("name", "function"), FUNCTIONS, ids=[name for name, _ in FUNCTIONS])
def test_documented_parameters_are_those_of_the_signature(name, function):
    documented = _section(function.__doc__ or "", "Parameters")
    actual = [p for p in inspect.signature(function).parameters if p not in ("self", "cls")]
    if documented is None:
        # One line is enough where names and annotations say it all: methods, small functions, and inside
        # the transcription and the worker, which no user calls.
        internal = ".transcription." in name or name.startswith(f"{WORKER}.")
        short = len(actual) <= 3 or "." in function.__qualname__ or internal
        assert short, f"{name} has no Parameters section"
    else:
        assert documented == actual


@pytest.mark.parametrize(("name", "data"), DATA, ids=[name for name, _ in DATA])
def test_documented_attributes_are_the_fields_of_the_class(name, data):
    documented = _section(data.__doc__ or "", "Attributes")
    inherited = {
        f.name
        for base in data.__mro__[1:]
        if dataclasses.is_dataclass(base)
        for f in dataclasses.fields(base)
    }
    fields = [field.name for field in dataclasses.fields(data)]
    if documented is None:
        # Small data whose field names say it all, or fields that a base class documents.
        assert len(set(fields) - inherited) <= 8, f"{name} has no Attributes section"
    else:
        own = [field for field in fields if field not in inherited or field in documented]
        assert sorted(documented) == sorted(own)


# Muscle classes -----------------------------------------------------------------------------------

CURVES = _concrete(HillCurves)
CONTRACT = sorted(HillCurves.__abstractmethods__)


@pytest.mark.parametrize("curves", CURVES, ids=lambda curves: curves.__name__)
def test_every_muscle_class_is_final_and_complete_and_among_the_muscle_classes(curves):
    missing = [name for name in HillCurves.__annotations__ if not hasattr(curves, name)]
    assert missing == []
    assert getattr(curves, "__final__", False), f"mark {curves.__name__} with @final"
    registered = MUSCLE_CLASSES.get(curves.OPENSIM_CLASS)
    assert isinstance(registered, curves), f"add {curves.__name__} to MUSCLE_CLASSES"


@pytest.mark.parametrize("curves", CURVES, ids=lambda curves: curves.__name__)
def test_every_muscle_class_has_a_table_of_opensims_values_in_the_tests(curves):
    tables = [name for name, tested in opensim_tables.CLASSES.items() if isinstance(tested, curves)]
    assert tables, f"add a table of {curves.__name__} to tests/muscle_models/opensim_tables.py"
    assert {name for name, _ in opensim_tables.CASES} >= set(tables), "a table without parameter sets"


@pytest.mark.parametrize("forgotten", CONTRACT)
def test_a_muscle_class_that_forgets_a_curve_cannot_be_made(forgotten):
    members = {name: getattr(CURVES[0], name) for name in CONTRACT if name != forgotten}
    with pytest.raises(TypeError, match=rf"abstract method '?{forgotten}\b"):
        type("Forgetful", (HillCurves,), members)()


@pytest.mark.parametrize("name", CONTRACT)
def test_the_contract_of_a_curve_stands_once(name):
    """Arguments and result are documented in the abstract class, and nowhere again."""
    contract = inspect.getdoc(getattr(HillCurves, name))
    assert _section(contract, "Parameters")
    assert _section(contract, "Returns")
    for curves in CURVES:
        own = getattr(curves, name).__doc__ or ""
        assert _section(own, "Parameters") is None, f"{curves.__name__}.{name} repeats the contract"
        assert _section(own, "Returns") is None, f"{curves.__name__}.{name} repeats the contract"
