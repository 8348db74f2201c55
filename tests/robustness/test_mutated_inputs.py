"""Mutated inputs of every kind: each is accepted as what it says, or refused in one clear sentence.

Seeded and few by default; ``SCSO_ROBUSTNESS=25000 pytest tests/robustness/test_mutated_inputs.py -s`` tries
more and prints a table. Most inputs go through the checks that files alone allow, two in a hundred through
``scso run`` to the end.

What must become of a mutant is declared where it is made (``tests/mutations.py``), without the package:
refused, accepted with the same data but for the entries that were changed, or either; what is accepted must
in any case be finite, and what a damaged table says is read again in Python's own terms. A refusal is an
error of ``scso_nlp.exceptions``; anything else is raw, Python's warnings included. More than 10 s is a hang.

A refusal is clear if its message, file paths cut down to the file's name,

1. is one line of printable characters, one sentence, and no longer than 300 characters;
2. holds nothing internal: no name of an exception or of a Python class, no repr of an object, no word of the
   libraries behind (``INTERNAL``); what stands in quotes, or None after "found" or "is",
   is the user's own;
3. names the input: a file, or a key, option, column or argument of it;
4. says what is wrong: what was expected, found or known instead, or what is not so (``SAYS_WHAT``).
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import io
import json
import math
import os
import re
import shutil
import signal
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import random_problem
from mutations import (
    ACCEPT,
    BAD_NUMBERS,
    EITHER,
    FOLDER,
    GONE,
    GOOD_NUMBERS,
    NOT_FINITE,
    REFUSE,
    Mutant,
    XmlRules,
    of_any_file,
    of_table,
    of_toml_text,
    of_tree,
    of_xml,
    pick,
    plain_columns,
    plain_number,
    toml,
)
from solution_by_hand import solution_by_hand
from tiny_model import write_tiny
from typer.testing import CliRunner

import scso_nlp as scso
from scso_nlp.cli import app
from scso_nlp.cli.compare import read_comparison
from scso_nlp.emg import Emg, read_emg
from scso_nlp.examples import example_folder
from scso_nlp.exceptions import ScsoError
from scso_nlp.io.bundle import load_bundle, read_provenance, save_bundle
from scso_nlp.io.storage import Storage, read_storage
from scso_nlp.opensim.checks import check_input
from scso_nlp.report.page import render_report
from scso_nlp.report.results import write_solution
from scso_nlp.settings import read_settings, record
from scso_nlp.trajectory import CoordinateCurvature

#: How many inputs are tried, over all kinds, and the share of them that goes through scso run.
NUMBER = int(os.environ.get("SCSO_ROBUSTNESS", "800"))
RUN_SHARE = 0.02
#: Longer is a hang [s].
LIMIT = 10.0
#: Share of refusals that may be unclear [-].
UNCLEAR_SHARE = 0.005
LONGEST = 300

INTERNAL = re.compile(
    r"Traceback|<class|<function|<built-in| object at 0x|\b[A-Z]\w*(Error|Exception|Warning)\b|dtype|array\("
    r"|\bNone\b|NoneType|\bErrno\b|PosixPath|mappingproxy|numpy|pydantic|pickle|\bself\b|with a sequence"
    r"|codec|literal for|\bfloat\(|\bstr\b|\bdict\b|\bint\b|\btuple\b|\bargument\b|positional"
)
SAYS_WHAT = re.compile(
    r"expected|found|must|needs?\b|closest:|available:|\bnot?\b|cannot|twice|unknown|damaged|empty|outside"
    r"|contradict|differ|only|declares|invalid|[Ff]ailed"
)
#: Entries of the data that follow from others.
FOLLOWING = ("emg", "numbers", "muscle_model")
Data = dict[str, Any]


#: How messages call the settings, beside their keys.
WORDS = ("joint", "axis")


class Hang(BaseException):
    """Longer than the limit."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of input: how its originals are written, drawn at random, and read."""

    write: Callable[[Path], object]
    draw: Callable[[np.random.Generator, Path], tuple[str, Mutant]]
    read: Callable[[Path, Mutant], Data]
    #: of the columns of a table in the data, and between its cells
    prefix: str = ""
    separator: str = ""
    #: OpenSim reads it too
    to_the_end: bool = False
    #: keys that a message may name instead of the file
    keys: tuple[str, ...] = ()


# Reading -----------------------------------------------------------------------------------------------


def columns(prefix: str, storage: Storage) -> Data:
    found = {f"{prefix}{label}": storage.values[:, i] for i, label in enumerate(storage.labels)}
    return {f"{prefix}time": storage.time, **found}


def read_run(source: Path, changes: Mapping[str, Any] | None = None) -> Data:
    """All that scso run reads and checks before OpenSim starts."""
    settings, output = read_settings(source, changes)
    checked = check_input(settings.motion)
    data = {**record(settings, output), "analysis_name": settings.analysis_name}
    data |= columns("motion ", checked.table)
    data |= {"in_degrees": checked.in_degrees, "speeds_in_degrees": checked.speeds_in_degrees}
    data["unusable"] = tuple(checked.unusable)
    if checked.speeds is not None:
        data |= columns("speeds ", checked.speeds)
    if checked.loads is not None:
        data |= {"loads": checked.loads.identifiers, **columns("loads ", read_storage(checked.loads.data))}
    return data


def read_compared(folder: Path, **options: Any) -> Data:
    """All that scso compare reads, and what it makes of it."""
    given = {"emg": None, "emg_map": None, "raw_emg": False, "peak_emg": False, "emg_offset": 0.0, **options}
    comparison = read_comparison([folder / "result"], labels=None, **given)
    (result,) = comparison.results
    data: Data = {"time": result.time, "solved": result.is_solved, "name": result.name}
    data |= dict(zip(result.muscles, result.activation.T, strict=True))
    data |= {f"{row}_stability": s for row, s in zip(result.stability_rows, result.stability.T, strict=True)}
    if given["emg"] is not None:
        emg = read_emg(given["emg"])
        data = {"time": emg.time, **dict(zip(emg.channels, emg.values.T, strict=True))}
        data["emg"] = comparison.emg[:, [bool(group.channels) for group in comparison.groups]]
    data["groups"] = tuple((group.name, group.muscles, group.channels) for group in comparison.groups)
    data["numbers"] = [row.value for row in comparison.rows if not row.note]
    return data


def read_page(folder: Path, _: Mutant) -> Data:
    comparison = read_comparison(
        [folder / "result"],
        labels=None,
        emg=None,
        emg_map=None,
        raw_emg=False,
        peak_emg=False,
        emg_offset=0.0,
    )
    assert "</html>" in render_report(comparison)
    return {"solved": comparison.results[0].is_solved, "activation": comparison.results[0].activation}


def of_data_class(data: Any, prefix: str = "") -> Data:
    """All fields, those of data classes within by name and name."""
    found: Data = {}
    for item in dataclasses.fields(data):
        value = getattr(data, item.name)
        if dataclasses.is_dataclass(value):
            found |= of_data_class(value, f"{prefix}{item.name}.")
        else:
            found[f"{prefix}{item.name}"] = value
    return found


# Kinds that scso run reads -------------------------------------------------------------------------------

SETUP = XmlRules(
    own_name="setup.xml",
    leaves={
        "initial_time": ("number", "initial_time"),
        "final_time": ("number", "final_time"),
        "activation_exponent": ("number", "exponent"),
        "lowpass_cutoff_frequency_for_coordinates": ("number", ""),
        "step_interval": ("whole", "step_interval"),
        "output_precision": ("whole", ""),
        "replace_force_set": ("flag", "replace_force_set"),
        "solve_for_equilibrium_for_auxiliary_states": ("flag", ""),
        "on": ("flag", ""),
        "use_model_force_set": ("flag", ""),
        "use_muscle_physiology": ("flag", "muscle_physiology"),
        **dict.fromkeys(("model_file", "coordinates_file", "speeds_file", "states_file"), ("path", "")),
        **dict.fromkeys(("external_loads_file", "force_set_files"), ("path", "")),
    },
    needed=frozenset({"AnalyzeTool", "model_file", "coordinates_file", "AnalysisSet", "StaticOptimization"}),
)
LOADS = XmlRules(
    own_name="external_loads.xml",
    leaves={
        "datafile": ("path", ""),
        **dict.fromkeys(("force_identifier", "point_identifier"), ("needed name", "")),
        **dict.fromkeys(("applied_to_body", "force_expressed_in_body"), ("name", "")),
    },
    needed=frozenset({"ExternalLoads", "datafile"}),
)
MODEL = XmlRules(
    own_name="elbow.osim",
    leaves={
        **dict.fromkeys(("mass", "max_isometric_force", "optimal_fiber_length"), ("physical", "")),
        "socket_parent_frame": ("name", ""),
    },
    needed=frozenset({"Model"}),
    by_opensim=frozenset({"JointSet"}),
    lenient=True,
)
ACTUATORS = XmlRules(
    own_name="reserves.xml",
    leaves={"optimal_force": ("physical", ""), "coordinate": ("name", "")},
    needed=frozenset({"ForceSet"}),
    lenient=True,
)

SETTINGS: Data = {
    "setup": "setup.xml",
    "name": "trial",
    "initial_time": 1.0,
    "final_time": 5,
    "lowpass_cutoff_frequency": -1.0,
    "step_interval": 1,
    "in_degrees": True,
    "exponent": 3.0,
    "muscle_model": "none",
    "weights": {"*": 1.0, "biceps": 2.0},
    "stability": "potvin-brown",
    "q": 5.0,
    "level": {"elbow_z": 1.0},
    "joints": ["elbow"],
    "axes": ["z"],
    "moving_paths": "exact",
    "passive": {"elbow_z": 2.0},
    "soft": 1.0,
    "solver": "framewise",
    "tolerance": 1e-9,
    "max_iterations": 300,
    "frames_per_program": 64,
    "keep_failed": False,
    "processes": 1,
    "output": "results",
}
KIND_OF = {
    **dict.fromkeys(("setup", "output"), "path"),
    "name": "text",
    **dict.fromkeys(("initial_time", "final_time", "lowpass_cutoff_frequency"), "number"),
    **dict.fromkeys(("exponent", "soft", "tolerance"), "number"),
    **dict.fromkeys(("step_interval", "max_iterations", "frames_per_program", "processes"), "count"),
    **dict.fromkeys(("in_degrees", "keep_failed"), "flag"),
    **dict.fromkeys(("joints", "axes"), "names"),
    **dict.fromkeys(("q", "level"), "number or table"),
    "passive": "table or path",
    "weights": "weights",
    "muscle_model": ("opensim-rigid", "physical-rigid", "compliant", "none"),
    "stability": ("off", "potvin-brown", "diagonal", "full"),
    "moving_paths": ("exact", "frozen"),
    "solver": ("trajectory", "framewise"),
}  # fmt: skip


def fits(kind: Any, value: Any) -> bool:
    """Tell if a setting of some kind may have a value."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    is_number = is_number and value == value and (abs(value) == math.inf or abs(value) < 2**1024)
    is_table = isinstance(value, dict) and all(fits("number", number) for number in value.values())
    if isinstance(kind, tuple):
        return value in kind
    return {
        "path": isinstance(value, str) and bool(value.strip()),
        "text": isinstance(value, str),
        "number": is_number,
        "count": isinstance(value, int) and not isinstance(value, bool) and value >= 1,
        "flag": isinstance(value, bool),
        "names": isinstance(value, str)
        or (isinstance(value, list) and all(isinstance(name, str) for name in value)),
        "number or table": is_number or is_table,
        "table or path": is_table or (isinstance(value, str) and bool(value.strip())),
        "weights": is_table or value in ("volume", "pcsa"),
    }[kind]


def settings_rule(how: str, path: tuple[Any, ...], value: Any) -> tuple[str, Data | None]:
    key = path[0]
    if how == "another order":
        return (ACCEPT, {}) if len(path) == 1 else (EITHER, None)
    if how == "deleted":
        return (REFUSE if path == ("setup",) else EITHER), None
    if how in ("renamed", "new key"):
        return (REFUSE if len(path) == 1 else EITHER), None
    if how == "entry twice":
        return EITHER, None
    if len(path) > 1:
        return EITHER if fits("text" if KIND_OF[key] == "names" else "number", value) else REFUSE, None
    if not fits(KIND_OF[key], value):
        return REFUSE, None
    if KIND_OF[key] == "number" and abs(value) < math.inf:
        return EITHER, {key: float(value)}
    return EITHER, {key: value} if KIND_OF[key] in ("count", "flag") else None


def draw_option(rng: np.random.Generator, _: Path) -> tuple[str, Mutant]:
    """One option of the command line."""
    key = pick(rng, [key for key in SETTINGS if KIND_OF[key] != "flag" and key != "setup"])
    tokens = (
        *GOOD_NUMBERS, *BAD_NUMBERS, *NOT_FINITE, "", " ", ",", "a=1", "a=b", "a=", "=1",
        "elbow_z=1,elbow_z=2", "*=2", "a,b", "elbow", "volume", "nowhere/x", ".", "é", "0", "-1",
        "1" * 30, "x" * 100, "../..",
    )  # fmt: skip
    token, kind = pick(rng, tokens), KIND_OF[key]
    number = plain_number(token.strip())
    is_number = number is not None and not math.isnan(number)
    is_good = {
        "number": is_number,
        "count": re.fullmatch(r"\s*\+?0*[1-9]\d*\s*", token, re.ASCII),
        "number or table": is_number or "=" in token,
        "path": token.strip(),
    }.get(kind, token in kind if isinstance(kind, tuple) else True)
    must, changes = EITHER if is_good else REFUSE, None
    if is_good and kind in ("number", "count") and math.isfinite(number):
        changes = {key: int(token) if kind == "count" else number}
    return "options", Mutant(how="option", content={key: token}, must=must, changes=changes,
                             names=(key, key.replace("_", "-"), token.strip()))  # fmt: skip


# Files of which other kinds of file may stand in the place of one.
OTHERS: Mapping[str, bytes] = {
    "text": b"This is a letter.\nIt has two lines.\n",
    "picture": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x08\2\0\0\0",
    "json": b'{"a": 1, "program": "another"}\n',
    "zip": b"PK\x05\x06" + b"\0" * 18,
    "xml": b'<?xml version="1.0"?>\n<OpenSimDocument Version="40600"><Thing name="x" /></OpenSimDocument>\n',
    "toml": b'format = 7\nthing = "x"\n',
    "csv": b"time;x\n0;1\n1;2\n",
    "sto": b"x\nversion=1\nnRows=2\nnColumns=2\ninDegrees=no\nendheader\ntime\tx\n0\t1\n1\t2\n",
}


def drawn_from(
    file: str,
    mutate: Callable[[np.random.Generator, bytes], Mutant],
    *,
    empty: str = REFUSE,
    but: tuple[str, ...] = (),
) -> Callable[[np.random.Generator, Path], tuple[str, Mutant]]:
    """Draw mutants of a file: of its bytes and lines, or of what stands in it."""
    originals: dict[Path, bytes] = {}

    def draw(rng: np.random.Generator, folder: Path) -> tuple[str, Mutant]:
        original = originals.setdefault(folder, (folder / file).read_bytes())
        if rng.random() < 0.35:
            others = [content for name, content in OTHERS.items() if name not in but]
            return file, of_any_file(rng, original, others, empty)
        return file, mutate(rng, original)

    return draw


def write_elbow(folder: Path) -> None:
    for path in example_folder("elbow").iterdir():
        shutil.copyfile(path, folder / path.name)
    (folder / "scso.toml").write_text(toml(SETTINGS), encoding="utf-8")


def write_postures(folder: Path) -> None:
    for path in example_folder("spine-postures").iterdir():
        shutil.copyfile(path, folder / path.name)


def write_tiny_case(folder: Path) -> None:
    write_tiny(folder)
    shutil.copyfile(example_folder("elbow") / "README.md", folder / "README.md")


MATRIX = "elbow_flexion,other\n2.5,0.5\n0.5,1.5\n"


def write_passive(folder: Path) -> None:
    write_elbow(folder)
    (folder / "passive.csv").write_text(MATRIX, encoding="utf-8")
    (folder / "passive.toml").write_text(toml(PASSIVE), encoding="utf-8")


PASSIVE: Data = {
    "elbow_x": 1.5,
    "elbow_z": 2,
    "lumbar": [{"levels": 2, "axial": "elbow_y", "flexion": ["a", "b"]}],
}


def of_settings(rng: np.random.Generator, original: bytes) -> Mutant:
    if rng.random() < 0.25:
        return of_toml_text(rng, original)
    return of_tree(rng, SETTINGS, toml, settings_rule)


def passive_rule(how: str, path: tuple[Any, ...], value: Any) -> tuple[str, Data | None]:
    if how == "another order":
        return ACCEPT, {}
    if path[0] == "lumbar":
        is_good = {1: False, 2: isinstance(value, dict) and not value}.get(len(path))
        if how.startswith("value") and len(path) == 3 and path[2] == "levels":
            is_good = fits("count", value)
            return (EITHER if is_good else REFUSE), None
        if how == "renamed" and len(path) == 3:
            return REFUSE, None
        if how == "renamed" and len(path) == 1:
            return REFUSE, None
        return EITHER, None
    if how.startswith("value") or how == "one deeper":
        return EITHER if fits("number", value) and math.isfinite(value) else REFUSE, None
    return EITHER, None


def of_passive(rng: np.random.Generator, original: bytes) -> Mutant:
    if rng.random() < 0.25:
        return of_toml_text(rng, original)
    return of_tree(rng, PASSIVE, toml, passive_rule)


def of_matrix(rng: np.random.Generator, original: bytes) -> Mutant:
    """A matrix of passive stiffness."""
    lines = [line.split(",") for line in original.decode().splitlines()]
    how = pick(rng, (
        "diagonal", "not symmetric", "no number", "not finite", "negative", "row missing", "row more",
        "cell missing", "cell more", "name twice", "names missing", "name blank", "CRLF", "BOM", "CR",
        "blank lines", "padded", "semicolons", "comment",
    ))  # fmt: skip
    i, j = 1 + int(rng.integers(2)), int(rng.integers(2))
    must: str = REFUSE
    changes = None
    end = "\n"
    if how == "diagonal":
        token = pick(rng, GOOD_NUMBERS)
        lines[i][i - 1] = token
        matrix = np.array([[2.5, 0.5], [0.5, 1.5]])
        matrix[i - 1, i - 1] = plain_number(token)
        must = EITHER if np.linalg.eigvalsh(matrix).min() >= -1e-9 else REFUSE
        changes = {"passive": matrix}
    elif how == "not symmetric":
        lines[i][2 - i] = "0.75"
    elif how == "no number":
        lines[i][j] = pick(rng, BAD_NUMBERS)
    elif how == "not finite":
        lines[i][j] = pick(rng, NOT_FINITE)
    elif how == "negative":
        lines[i][i - 1] = "-3"
    elif how == "row missing":
        del lines[i]
    elif how == "row more":
        lines.append(["0", "0"])
    elif how == "cell missing":
        del lines[i][j]
    elif how == "cell more":
        lines[i].append("0")
    elif how == "name twice":
        lines[0][1] = lines[0][0]
    elif how == "names missing":
        del lines[0]
    elif how == "name blank":
        lines[0][j] = ""
    elif how == "semicolons":
        lines = [[";".join(line)] for line in lines]
    elif how == "comment":
        lines.insert(i, ["# a remark"])
    else:
        must, changes = ACCEPT, {}
        end = {"CRLF": "\r\n", "CR": "\r"}.get(how, "\n")
        if how == "padded":
            lines = [[f" {cell}  " for cell in line] for line in lines]
        if how == "blank lines":
            lines.insert(i, [""])
    content = end.join(",".join(line) for line in lines) + end
    return Mutant(how=how, content=(b"\xef\xbb\xbf" if how == "BOM" else b"") + content.encode(), must=must,
                  changes=changes)  # fmt: skip


def read_passive(kind: str) -> Callable[[Path, Mutant], Data]:
    def read(folder: Path, _: Mutant) -> Data:
        method = {"passive": str(folder / f"passive.{kind}"), "muscle_model": "none"}
        method |= {"stability": "full" if kind == "csv" else "potvin-brown"}
        settings, output = read_settings(folder / "setup.xml", method)
        return {**record(settings, output)}

    return read


# Kinds that scso compare and scso report read --------------------------------------------------------------

MAP: Data = {
    "format": 1,
    "groups": {
        "front": {"muscles": ["front_*"], "channels": ["ch1"]},
        "back": {"muscles": ["back_0"], "channels": ["ch2", "ch3"]},
    },
    "mvc": {"ch1": 0.5},
    "scale": {"ch1": 0.8},
    "delay": {"ch1": 0.04},
    "pairs": {"front over back": {"numerator": ["front"], "denominator": ["back"]}},
}


def write_results(folder: Path, n_frames: int = 12, n_pairs: int = 1) -> None:
    solution = solution_by_hand(n_frames, n_pairs=n_pairs)
    write_solution(solution, folder / "result", figures=False)
    (folder / "map.toml").write_text(toml(MAP), encoding="utf-8")
    for name, rate in (("emg", 100), ("raw", 1000)):
        t = np.arange(-0.2 * rate, 1.2 * rate + 1) / rate
        wave = 0.1 + 0.05 * np.sin(6 * t) if name == "emg" else np.sin(400 * t) * (1 + np.sin(5 * t))
        rows = [[f"{at:.4f}", *(f"{wave[k] * s:.6f}" for s in (1, 2, 3))] for k, at in enumerate(t)]
        head = ["EMG", "version=1", f"nRows={len(t)}", "nColumns=4", "inDegrees=no", "endheader"]
        table = [["time", "ch1", "ch2", "ch3"], *rows]
        text = "\n".join([*head, *("\t".join(row) for row in table)]) + "\n"
        (folder / f"{name}.sto").write_text(text, encoding="utf-8")
        (folder / f"{name}.csv").write_text(
            "\n".join(",".join(row) for row in table) + "\n", encoding="utf-8"
        )


def report_rule(how: str, path: tuple[Any, ...], value: Any) -> tuple[str, Data | None]:
    """What must become of a changed report: little of it is read, and that is checked."""
    key = path[0]
    if how in ("another order", "new key"):
        return ACCEPT, {}
    if key == "frame_status" and len(path) > 1:
        return REFUSE, None
    if path[:2] == ("problem", "muscle_names") and len(path) > 2:
        is_name = isinstance(value, str) and value.startswith(("front", "back"))
        return (EITHER if how == "deleted" or is_name else REFUSE), None
    if path in (("name",), ("program",), ("frame_status",), ("problem",), ("problem", "muscle_names")):
        return REFUSE if value != [] or path[-1] != "muscle_names" else EITHER, None
    return (EITHER, None) if key == "report_version" else (ACCEPT, {})


def of_report(rng: np.random.Generator, original: bytes) -> Mutant:
    if rng.random() < 0.1:
        nested = {"list": b"[" * 100_000, "table": b'{"a":' * 100_000, "digits": b"9" * 5000}
        how = pick(rng, nested)
        content = b'{"name": ' + nested[how] + original.lstrip(b"{")
        return Mutant(how=f"deep {how}", content=content, must=REFUSE)
    return of_tree(rng, json.loads(original), json.dumps, report_rule)


def map_rule(how: str, path: tuple[Any, ...], value: Any) -> tuple[str, Data | None]:
    """What must become of a changed map of EMG channels."""
    if how == "another order":
        return EITHER, None
    if how == "deleted":
        return (
            REFUSE if path in (("format",), ("groups",)) or path[-1] in ("muscles", "numerator") else EITHER
        ), None
    if how in ("renamed", "new key"):
        is_free = len(path) == 2 and path[0] in ("groups", "mvc", "scale", "delay", "pairs")
        return (EITHER if is_free and how == "renamed" else REFUSE), None
    if how == "entry twice":
        return REFUSE, None
    if path == ("format",):
        return (EITHER if value == 1 and not isinstance(value, bool) else REFUSE), None
    if path[0] in ("mvc", "scale", "delay") and len(path) == 2:
        is_good = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1.8e308
        return (EITHER if is_good else REFUSE), None
    if len(path) == 4:
        return (EITHER if isinstance(value, str) and value else REFUSE), None
    if len(path) == 3:
        is_names = isinstance(value, list) and all(isinstance(v, str) and v for v in value)
        return (EITHER if is_names else REFUSE), None
    return (EITHER if isinstance(value, dict) and (how.startswith("value") and not value) else REFUSE), None


def of_map(rng: np.random.Generator, original: bytes) -> Mutant:
    if rng.random() < 0.25:
        found = of_toml_text(rng, original)
        return dataclasses.replace(found, must=EITHER) if found.how == "another order" else found
    return of_tree(rng, MAP, toml, map_rule)


def with_emg(file: str, **options: Any) -> Callable[[Path, Mutant], Data]:
    return lambda folder, _: read_compared(folder, emg=folder / file, emg_map=folder / "map.toml", **options)


# Bundles -------------------------------------------------------------------------------------------------


def motion() -> scso.Motion:
    """A motion with all that one may have."""
    base = random_problem(np.random.default_rng(7), n_muscles=4, n_coordinates=2, reserve=1.0).motion
    f, n = base.trajectory.n_frames, 4
    curvature = CoordinateCurvature(
        coordinates=("q1",),
        path_curvature=np.full((f, 1, 1, n), 0.01),
        load_stiffness=np.ones((f, 1, 1)),
        passive_stiffness=np.ones((f, 1, 1)),
        asymmetry=np.zeros((f, n)),
        is_uncertain=np.zeros((f, n), dtype=bool),
    )
    return dataclasses.replace(base, trajectory=dataclasses.replace(base.trajectory, curvature=curvature))


def write_bundle(folder: Path) -> None:
    save_bundle(folder / "motion.npz", motion())


def read_bundle(folder: Path, _: Mutant) -> Data:
    read_provenance(folder / "motion.npz")
    return of_data_class(load_bundle(folder / "motion.npz"))


def of_bundle(rng: np.random.Generator, original: bytes) -> Mutant:
    """Change arrays and the header inside the archive."""
    with np.load(io.BytesIO(original)) as content:
        arrays = dict(content)
    header = json.loads(arrays["header"].tobytes())
    name = pick(rng, [name for name in arrays if name != "header"])
    how = pick(rng, (
        "array missing", "array more", "not a number", "other shape", "text array", "object array",
        "number changed", "header missing", "no JSON", "value missing", "name twice", "version",
        "other format", "compressed", "header value", "big-endian", "huge shape", "time reversed",
        "damaged array", "encrypted",
    ))  # fmt: skip
    must: str = REFUSE
    changes: Data | None = None
    array = arrays[name]
    save, pickles = np.savez, False
    if how == "array missing":
        del arrays[name]
        must = EITHER  # fields with defaults
    elif how == "array more":
        arrays["trajectory.thing"] = np.ones(3)
        must, changes = ACCEPT, {}
    elif how in ("not a number", "number changed"):
        names = [n for n, a in arrays.items() if a.dtype == float and a.size and "virtual" not in n
                 and "control" not in n]  # fmt: skip
        name = pick(rng, names)
        array = arrays[name] = arrays[name].copy()
        at = tuple(int(rng.integers(n)) for n in array.shape)
        array[at] = math.nan if how == "not a number" else 0.125
        if how == "number changed":
            key = re.sub(r"^(trajectory)\.", r"\1.", name)
            must, changes = EITHER, {key: array}
    elif how == "other shape":
        arrays[name] = array[..., None]
        must = REFUSE if array.size else EITHER
    elif how == "text array":
        arrays[name] = np.full(array.shape, "text")
        must = REFUSE if array.size else EITHER
    elif how == "object array":
        arrays[name], pickles = np.full(array.shape, None, dtype=object), True
    elif how == "header missing":
        del arrays["header"]
    elif how == "no JSON":
        arrays["header"] = arrays["header"][: int(rng.integers(len(arrays["header"])))]
    elif how == "time reversed":
        arrays["trajectory.time"] = arrays["trajectory.time"][::-1]
    elif how in ("value missing", "name twice", "version", "other format", "header value"):
        values = header["values"]
        if how == "value missing":
            table, key = pick(
                rng, ((header, "values"), (values, "trajectory"), (values["trajectory"], "muscles"))
            )
            del table[key]
        elif how == "name twice":
            values["trajectory"]["muscles"][1] = values["trajectory"]["muscles"][0]
        elif how == "version":
            header["format_version"] = pick(rng, (2, "1", None, [], 99))
        elif how == "other format":
            header["format"] = pick(rng, ("other", None, 1, []))
        else:
            part = pick(rng, ("trajectory", "muscles", "actuators"))
            key = pick(rng, (part, pick(rng, list(values[part]))))
            target = values if key == part else values[part]
            target[key] = pick(rng, (None, 3, "text", [], {}, [1], ["a", "b"], [None]))
            must = EITHER
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    elif how == "compressed":
        save, must, changes = np.savez_compressed, ACCEPT, {}
    elif how == "big-endian":
        arrays[name] = array.astype(array.dtype.newbyteorder(">"))
        must, changes = ACCEPT, {}
    buffer = io.BytesIO()
    save(buffer, allow_pickle=pickles, **arrays)
    content = buffer.getvalue()
    if how in ("huge shape", "damaged array"):
        content = _with_member(content, f"{name}.npy", lambda data: _damaged(rng, data, how))
        must = REFUSE if how == "huge shape" else EITHER
    if how == "encrypted":
        flags = content.index(b"PK\x01\x02") + 8
        content = content[:flags] + b"\1\0" + content[flags + 2 :]
    return Mutant(how=how, content=content, must=must, changes=changes)


def _with_member(archive: bytes, member: str, change: Callable[[bytes], bytes]) -> bytes:
    """Write an archive again with one member changed, checksums right."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as old, zipfile.ZipFile(buffer, "w") as new:
        for name in old.namelist():
            new.writestr(name, change(old.read(name)) if name == member else old.read(name))
    return buffer.getvalue()


def _damaged(rng: np.random.Generator, data: bytes, how: str) -> bytes:
    if how == "huge shape":
        end = data.index(b"\n")
        shape = pick(rng, (b"(99999999999999,)", b"(-3,)", b"(3000000000, 3000000000)"))
        head = re.sub(rb"'shape': \([^)]*\)", b"'shape': " + shape, data[10:end]).rstrip()[: end - 10]
        return data[:10] + head.ljust(end - 10) + data[end:]
    at = int(rng.integers(len(data)))
    return data[:at] + rng.bytes(2) + data[at + 2 :]


# Arrays in Python ------------------------------------------------------------------------------------------

#: Fields that may hold what is not finite, and those whose numbers are tied to others.
MAY_BE_INFINITE = ("min_control", "max_control", "virtual_moment_arms", "virtual_curvature", "values")


def objects() -> tuple[Any, ...]:
    whole = motion()
    time_ = np.linspace(0.0, 1.0, 5)
    return (
        whole.trajectory,
        whole.trajectory.skeleton,
        whole.trajectory.curvature,
        whole.muscles,
        whole.actuators,
        Storage(name="x", labels=("a", "b"), time=time_, values=np.ones((5, 2))),
        Emg(channels=("a", "b"), time=time_, values=np.ones((5, 2))),
    )


OBJECTS = objects()


def fields_of(data: Any) -> tuple[str, ...]:
    return tuple(item.name for item in dataclasses.fields(data))


def draw_array(rng: np.random.Generator, _: Path) -> tuple[str, Mutant]:
    """One array of a data class."""
    which = int(rng.integers(len(OBJECTS)))
    base = OBJECTS[which]
    arrays = {
        item.name: getattr(base, item.name)
        for item in dataclasses.fields(base)
        if isinstance(getattr(base, item.name), np.ndarray) and getattr(base, item.name).size
    }
    field = pick(rng, arrays)
    array = arrays[field]
    is_float = array.dtype == float
    how = pick(rng, (
        "not finite", "number", "fraction", "axis more", "entry more", "entry fewer", "a number", "text",
        "nothing", "objects", "complex", "ragged", "masked", "a list", "Fortran order", "a view",
        "single precision", "dates", "a table", "reversed", "shuffled", "sparse",
    ))  # fmt: skip
    must: str = REFUSE
    changes: Data | None = None
    value: Any = array.copy()
    at = tuple(int(rng.integers(n)) for n in array.shape)
    if how == "not finite":
        value = array.astype(float)
        value[at] = pick(rng, (math.nan, math.inf, -math.inf))
        must = EITHER if field in MAY_BE_INFINITE or array.dtype == bool else REFUSE
        if field in ("min_control", "max_control") and math.isnan(value[at]):
            must = REFUSE
        if isinstance(base, Emg):
            must = REFUSE
        changes = {field: value} if is_float else None
    elif how == "number":
        value[at] = pick(rng, (0, 1, -3, 1e300, 1e-300)) if is_float else pick(rng, (0, 1))
        must, changes = EITHER, {field: value}
    elif how == "fraction":
        value = array.astype(float)
        value[at] = 0.5
        must = EITHER if is_float else REFUSE
        changes = {field: value}
    elif how == "axis more":
        value = array[None]
    elif how == "entry more":
        value = np.concatenate([array, array[-1:]])
    elif how == "entry fewer":
        value = array[:-1]
    elif how == "a number":
        value = 3.0
    elif how == "text":
        value = np.full(array.shape, "text")
    elif how == "nothing":
        value = None
    elif how == "objects":
        value = np.full(array.shape, None, dtype=object)
    elif how == "complex":
        value = array + 1j
    elif how == "ragged":
        value = [*array.tolist(), [[1.0], 2.0]]
    elif how == "masked":
        mask = np.zeros(array.shape, dtype=bool)
        mask[at] = True
        value = np.ma.array(array, mask=mask)
    elif how in ("a list", "Fortran order", "a view"):
        value = {
            "a list": array.tolist(),
            "Fortran order": np.asfortranarray(array),
            "a view": np.repeat(array, 2, axis=0)[::2],
        }[how]
        must, changes = ACCEPT, {field: array}
    elif how == "single precision":
        value = array.astype(np.float32)
        must = EITHER
    elif how == "dates":
        value = np.full(array.shape, np.datetime64("2020-01-01"))
    elif how == "a table":
        value = {"a": 1.0}
    elif how == "sparse":
        value = {1.0, 2.0}
    else:
        order = rng.permutation(len(array)) if how == "shuffled" else np.arange(len(array))[::-1]
        value = array[order]
        must = REFUSE if field == "time" and (order != np.arange(len(array))).any() else EITHER
        changes = {field: value}
    return type(base).__name__, Mutant(how=how, content=(which, field, value), must=must, changes=changes,
                                       names=("EMG", *fields_of(base)))  # fmt: skip


def read_array(_: Path, mutant: Mutant) -> Data:
    which, field, value = mutant.content
    return of_data_class(dataclasses.replace(OBJECTS[which], **{field: value}))


# Through scso run ------------------------------------------------------------------------------------------


def draw_run(rng: np.random.Generator, folder: Path) -> tuple[str, Mutant]:
    """A mutant of any input of a run."""
    return KINDS[pick(rng, [name for name, kind in KINDS.items() if kind.to_the_end])].draw(rng, folder)


def scso_run(folder: Path, mutant: Mutant) -> Data:
    """Run as the command line does; what it refuses is raised again."""
    options = mutant.content if isinstance(mutant.content, dict) else {}
    words = [word for key, value in options.items() for word in (_option(key), value)]
    shutil.rmtree(folder / "results", ignore_errors=True)
    found = CliRunner().invoke(app, ["run", str(folder / "scso.toml"), "--no-figures", *words])
    if isinstance(found.exception, Hang):
        raise found.exception
    if found.exit_code == 2:
        raise ScsoError(found.stderr.splitlines()[-1].removeprefix("error: "))
    assert found.exit_code in (0, 1), found.output
    data: Data = {}
    for path in sorted((folder / "results").glob("*_activation.sto")):
        data |= {"is_solved": found.exit_code == 0, **columns("", read_storage(path))}
    return data


def _option(key: str) -> str:
    return {"coordinates": "--coordinates-file"}.get(key, "--" + key.replace("_", "-"))


# All kinds -------------------------------------------------------------------------------------------------


def _xml(rules: XmlRules) -> Callable[[np.random.Generator, bytes], Mutant]:
    return lambda rng, original: of_xml(rng, original, rules)


def _table(**rules: Any) -> Callable[[np.random.Generator, bytes], Mutant]:
    return lambda rng, original: of_table(rng, original, **rules)


SPEEDS = frozenset(f"{joint}_{turn}_u" for joint in ("lumbar_pelvis", "thorax_lumbar")
                   for turn in ("flexion", "abduction_right", "twist_left"))  # fmt: skip
FORCES = frozenset(f"load_{kind}{axis}" for kind in "vp" for axis in "xyz")
CHANNELS = frozenset({"ch1", "ch2", "ch3"})

KINDS: dict[str, Kind] = {
    "setup XML": Kind(
        write=write_elbow,
        draw=drawn_from("setup.xml", _xml(SETUP), but=("sto",)),
        read=lambda folder, _: read_run(folder / "setup.xml"),
        keys=(*SETUP.leaves, *KIND_OF),
        to_the_end=True,
    ),
    "setup XML, actuators": Kind(
        write=write_tiny_case,
        draw=drawn_from("setup.xml", _xml(SETUP), but=("sto",)),
        read=lambda folder, _: read_run(folder / "setup.xml"),
        keys=(*SETUP.leaves, *KIND_OF),
    ),
    "external loads XML": Kind(
        write=write_elbow,
        draw=drawn_from("external_loads.xml", _xml(LOADS)),
        read=lambda folder, _: read_run(folder / "setup.xml"),
        to_the_end=True,
    ),
    "model": Kind(
        write=write_elbow,
        draw=drawn_from("elbow.osim", _xml(MODEL)),
        read=lambda folder, _: read_run(folder / "setup.xml"),
        to_the_end=True,
    ),
    "actuators XML": Kind(
        write=write_tiny_case,
        draw=drawn_from("reserves.xml", _xml(ACTUATORS)),
        read=lambda folder, _: read_run(folder / "setup.xml"),
    ),
    "settings TOML": Kind(
        write=write_elbow,
        draw=drawn_from("scso.toml", of_settings),
        read=lambda folder, _: read_run(folder / "scso.toml"),
        keys=(*KIND_OF, *WORDS),
        to_the_end=True,
    ),
    "options": Kind(
        write=write_elbow,
        draw=draw_option,
        read=lambda folder, mutant: read_run(folder / "scso.toml", mutant.content),
        keys=(*KIND_OF, *WORDS),
        to_the_end=True,
    ),
    "motion": Kind(
        write=write_elbow,
        draw=drawn_from(
            "motion.mot",
            _table(used=frozenset(), by_opensim=frozenset({"elbow_flexion"}), unit="in_degrees"),
        ),
        read=lambda folder, _: read_run(folder / "setup.xml"),
        prefix="motion ",
        separator="\t",
        to_the_end=True,
    ),
    "speeds": Kind(
        write=write_postures,
        draw=drawn_from("speeds.sto", _table(used=frozenset(), unit="speeds_in_degrees"), but=("sto",)),
        read=lambda folder, _: read_run(folder / "setup.xml"),
        prefix="speeds ",
        separator="\t",
    ),
    "loads": Kind(
        write=write_elbow,
        draw=drawn_from("loads.mot", _table(used=FORCES, ordered=("load_v", "load_p"))),
        read=lambda folder, _: read_run(folder / "setup.xml"),
        prefix="loads ",
        separator="\t",
        to_the_end=True,
    ),
    "passive stiffness TOML": Kind(
        write=write_passive,
        draw=drawn_from("passive.toml", of_passive, empty=EITHER, but=("toml",)),
        read=read_passive("toml"),
    ),
    "passive stiffness CSV": Kind(
        write=write_passive, draw=drawn_from("passive.csv", of_matrix), read=read_passive("csv")
    ),
    "activation file": Kind(
        write=write_results,
        draw=drawn_from(
            "result/antagonists_StaticOptimization_activation.sto",
            _table(used=frozenset({"front_0", "back_0"})),
        ),
        read=lambda folder, _: read_compared(folder),
        separator="\t",
    ),
    "stability file": Kind(
        write=write_results,
        draw=drawn_from("result/antagonists_stability.sto", _table(used=frozenset())),
        read=lambda folder, _: read_compared(folder),
        separator="\t",
    ),
    "report.json": Kind(
        write=write_results,
        draw=drawn_from("result/report.json", of_report),
        read=lambda folder, _: read_compared(folder),
    ),
    "report.json, page": Kind(
        write=lambda folder: write_results(folder, n_frames=3, n_pairs=31),
        draw=drawn_from("result/report.json", of_report),
        read=read_page,
    ),
    "EMG map": Kind(write=write_results, draw=drawn_from("map.toml", of_map), read=with_emg("emg.csv")),
    "EMG CSV": Kind(
        write=write_results,
        draw=drawn_from("emg.csv", _table(used=CHANNELS, separator=",")),
        read=with_emg("emg.csv"),
        separator=",",
    ),
    "EMG Storage, raw": Kind(
        write=write_results,
        draw=drawn_from("raw.sto", _table(used=CHANNELS)),
        read=with_emg("raw.sto", raw_emg=True),
        separator="\t",
    ),
    "bundle": Kind(write=write_bundle, draw=drawn_from("motion.npz", of_bundle, but=()), read=read_bundle),
    "arrays": Kind(write=lambda folder: None, draw=draw_array, read=read_array),
    "through scso run": Kind(write=write_elbow, draw=draw_run, read=scso_run, keys=(*KIND_OF, *WORDS)),
}


# Judging ---------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def put(folder: Path, file: str, content: Any) -> Iterator[None]:
    """Put a mutated file into the place of a good one for a while."""
    path = folder / file
    if not isinstance(content, bytes | None) or not path.exists():
        yield
        return
    original = path.read_bytes()
    try:
        path.unlink()
        if content is FOLDER:
            path.mkdir()
        elif content is not None:
            path.write_bytes(content)
        yield
    finally:
        if path.is_dir():
            path.rmdir()
        path.write_bytes(original)


@contextlib.contextmanager
def time_limit() -> Iterator[None]:
    """Raise Hang after the limit."""

    def stop(*_: object) -> None:
        raise Hang

    handler = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, handler)


def unclear(message: str, names: set[str], folder: Path) -> str:
    """Say why a message is unclear by the test stated above, or nothing."""
    text = message.replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")
    if not text.isprintable():
        return "is not one line of printable characters"
    if len(text) > LONGEST:
        return f"has {len(text)} characters"
    if re.search(r"[a-z]\. [A-Z]", text):
        return "is more than one sentence"
    if found := INTERNAL.search(re.sub(r"'[^']*'|\"[^\"]*\"|(found|is) [(\[]*None", "", text)):
        return f"holds {found.group()!r}"
    named = any(name and re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text) for name in names)
    if not named and not re.search(r"(^|[\s(])/\S", message):
        return "names no input"
    return "" if SAYS_WHAT.search(text) else "does not say what is wrong"


def not_finite(data: Data) -> str:
    """Name an entry of the data that is not finite, where it should be."""
    for name, value in data.items():
        label = name.split(" ", 1)[-1]
        if label in data.get("unusable", ()) or name.split(".")[-1] in MAY_BE_INFINITE:
            continue
        if isinstance(value, float) and math.isnan(value):
            return name
        if isinstance(value, np.ndarray) and value.dtype == float and not np.isfinite(value).all():
            return name
        if name == "numbers" and not np.isfinite(value).all():
            return name
    return ""


def difference(data: Data, reference: Data, changes: Mapping[str, Any]) -> str:
    """Name an entry of the data that is neither the original's nor what it was changed to."""
    for name, value in reference.items():
        if changes and name in FOLLOWING:
            continue
        expected = changes.get(name, value)
        if expected is GONE:
            if name in data:
                return name
        elif name not in data:
            return f"{name} (missing)"
        elif not _same(data[name], expected):
            return name
    return ""


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        return one.shape == other.shape and bool(
            np.array_equal(one, other, equal_nan=one.dtype == float and other.dtype == float)
        )
    return bool(one == other) or (one != one and other != other)


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a mutant, in the words of the table, and more of it if that is wrong."""

    word: str
    detail: str = ""


def outcome(name: str, kind: Kind, file: str, mutant: Mutant, folder: Path, reference: Data) -> Outcome:
    """Let a mutant be read, and judge what becomes of it."""
    is_run = name == "through scso run"
    must = (mutant.by_opensim or mutant.must) if is_run else mutant.must
    started = time.perf_counter()
    try:
        with put(folder, file, mutant.content), time_limit():
            data = kind.read(folder, mutant)
    except ScsoError as error:
        names = {*mutant.names, *kind.keys, *(path.name for path in folder.rglob("*")), Path(file).name}
        why = unclear(str(error), names, folder)
        if must == ACCEPT:
            return Outcome("refused in error", str(error))
        return Outcome("refused, unclear", f"{why}: {error}") if why else Outcome("refused", str(error))
    except Hang:
        return Outcome("hang")
    except Exception as error:
        return Outcome("raw", f"{type(error).__name__}: {str(error)[-600:]}")
    if time.perf_counter() - started > LIMIT:
        return Outcome("hang", "the alarm did not stop it")
    if must == REFUSE:
        return Outcome("accepted in error")
    if is_run:
        if not data.pop("is_solved", False):
            return Outcome("accepted")
        if mutant.changes == {} and must == ACCEPT:
            other = difference(data, {k: v for k, v in reference.items() if k != "is_solved"}, {})
            return Outcome("accepted in error", f"{other} differs") if other else Outcome("accepted")
        return (
            Outcome("accepted in error", f"{not_finite(data)} is not finite")
            if not_finite(data)
            else Outcome("accepted")
        )
    if bad := not_finite(data):
        return Outcome("accepted in error", f"{bad} is not finite")
    changes = mutant.changes
    if changes is not None and kind.prefix:
        changes = {key if key in ("unusable", "in_degrees", "speeds_in_degrees") else kind.prefix + key: value
                   for key, value in changes.items()}  # fmt: skip
    if changes is None and kind.separator and isinstance(mutant.content, bytes):
        found = plain_columns(mutant.content, kind.separator) or {}
        changes = {kind.prefix + label: column for label, column in found.items()}
        reference = {name: value for name, value in reference.items() if name in changes and name in data}
    if changes is not None and (other := difference(data, reference, changes)):
        return Outcome("accepted in error", f"{other} differs")
    return Outcome("accepted")


WRONG = ("raw", "hang", "accepted in error", "refused in error")
#: Numbers of mutants by kind and outcome, and seconds by kind.
FIGURES: dict[str, collections.Counter[str]] = {}
SECONDS: dict[str, float] = {}


@pytest.fixture(scope="module", autouse=True)
def figures() -> Iterator[None]:
    """Print the table at the end."""
    yield
    if NUMBER <= 1000:
        return
    words = ("accepted", "refused", "refused, unclear", *WRONG)
    print("\n\n| kind of input | tried | " + " | ".join(words) + " | time [s] |")
    print("|---|" + "---:|" * (len(words) + 2))
    total: collections.Counter[str] = collections.Counter()
    for name, counts in FIGURES.items():
        total += counts
        cells = (counts.total(), *(counts[word] for word in words), round(SECONDS[name]))
        print(f"| {name} | " + " | ".join(map(str, cells)) + " |")
    cells = (total.total(), *(total[word] for word in words), round(sum(SECONDS.values())))
    print("| **all** | " + " | ".join(map(str, cells)) + " |")


def mutant_of(name: str, seed: int, folder: Path) -> tuple[str, Mutant]:
    """Draw one mutant of a kind, the same for the same seed."""
    return KINDS[name].draw(np.random.default_rng([zlib.crc32(name.encode()), seed]), folder)


@pytest.mark.opensim
@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="needs an alarm to end what hangs")
@pytest.mark.parametrize("name", KINDS)
def test_mutants_are_read_as_what_they_say_or_refused_in_a_clear_sentence(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kind, started = KINDS[name], time.perf_counter()
    kind.write(tmp_path)
    first = Mutant(how="nothing", content=(0, "time", OBJECTS[0].time) if name == "arrays" else {})
    reference = kind.read(tmp_path, first)
    share = RUN_SHARE if name == "through scso run" else (1 - RUN_SHARE) / (len(KINDS) - 1)
    counts: collections.Counter[str] = collections.Counter()
    bad = []
    for seed in range(max(1, round(share * NUMBER))):
        file, mutant = mutant_of(name, seed, tmp_path)
        if name == "arrays":
            reference = of_data_class(OBJECTS[mutant.content[0]])
        found = outcome(name, kind, file, mutant, tmp_path, reference)
        counts[found.word] += 1
        if found.word in WRONG or "unclear" in found.word:
            bad.append(f"seed {seed}, {file}, {mutant.how}, {mutant.must}: {found.word}: {found.detail}")
    FIGURES[name], SECONDS[name] = counts, time.perf_counter() - started
    wrong = [line for line in bad if "refused, unclear" not in line]
    assert not wrong, "\n".join(wrong[:40])
    assert counts["refused, unclear"] <= UNCLEAR_SHARE * counts.total(), "\n".join(bad[:40])
