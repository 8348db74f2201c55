"""Settings of a run: what a TOML file or the command line may say, checked and turned into objects.

Every setting is one entry of :data:`KEYS`: its name, what it may be and one line of help. The TOML reader,
the template of ``scso init`` and the messages about misspelled keys all come from that table.
"""

from __future__ import annotations

import difflib
import math
import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from scso_nlp.constraints.coordinate_stability import CoordinateStability
from scso_nlp.constraints.hessian_stability import HessianStability
from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError, ProblemError
from scso_nlp.muscle_models.stiffness_law import FiberStiffness, ShortRangeStiffness, StiffnessLaw
from scso_nlp.opensim.setup_xml import AnalyzeSetup, MotionInput, read_analyze_setup, with_changes
from scso_nlp.solve.ipopt import SolverOptions
from scso_nlp.stability.passive import LumbarJoint, lumbar_passive_stiffness, passive_matrix
from scso_nlp.validation import unique_names

#: Stability constraints by what the settings call them.
STABILITY_METHODS: dict[str, type[StabilityConstraint]] = {
    "potvin-brown": JointStability,
    "diagonal": CoordinateStability,
    "full": HessianStability,
}
#: Stiffness laws by what the settings call them; "proportional" is the one with `q`.
STIFFNESS_LAWS: dict[str, type[StiffnessLaw]] = {
    "short-range": ShortRangeStiffness,
    "fiber": FiberStiffness,
}
#: What the settings file may ask for in `solver`.
SOLVERS = ("trajectory", "framewise")
#: What it may ask for in `muscle_model`.
MUSCLE_MODELS = ("opensim-rigid", "physical-rigid", "compliant", "none")


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Everything that decides the numbers of a run.

    Attributes
    ----------
    motion : MotionInput
        Model, motion and loads.
    analysis_name : str
        OpenSim's name of the analysis, second part of the result files' names.
    exponent : float
        Power of the activations.
    weights : None, "volume", "pcsa" or mapping of str to float
        As for :class:`~scso_nlp.ActivationEffort`.
    muscle_model : "opensim-rigid", "physical-rigid", "compliant" or "none"
        Force-length-velocity as OpenSim's static optimization has it, with the textbook's rigid tendon, or
        with elastic tendons; or force proportional to activation.
    stability : StabilityConstraint or None
        None: plain static optimization.
    solver : "trajectory" or "framewise"
    options : SolverOptions
    sources : tuple of Path
        Files the settings were read from, for the report.
    """

    motion: MotionInput
    analysis_name: str = "StaticOptimization"
    exponent: float = 2.0
    weights: str | Mapping[str, float] | None = None
    muscle_model: str = "opensim-rigid"
    stability: StabilityConstraint | None = None
    solver: str = "trajectory"
    options: SolverOptions = field(default_factory=SolverOptions)
    sources: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise ProblemError(f"solver is {self.solver!r}, expected one of {', '.join(SOLVERS)}")
        if self.muscle_model not in MUSCLE_MODELS:
            raise ProblemError(
                f"muscle_model is {self.muscle_model!r}, expected one of {', '.join(MUSCLE_MODELS)}"
            )

    @property
    def muscle_physiology(self) -> bool:
        """True if force depends on fiber length and velocity."""
        return self.muscle_model != "none"


@dataclass(frozen=True, kw_only=True)
class OutputSettings:
    """Where and how results are written; nothing here changes a number.

    Attributes
    ----------
    folder : Path or None
        None: ``scso_results/<name>`` in the working folder.
    keep_failed : bool
    figures : bool
    processes : int or None
        Worker processes of the extraction; None is one per core.
    cache : Path or None
        Folder for extracted motions, so that a second run needs no OpenSim.
    """

    folder: Path | None = None
    keep_failed: bool = False
    figures: bool = True
    processes: int | None = None
    cache: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Key:
    """One setting.

    Attributes
    ----------
    group : str
        Heading in the template.
    read : callable
        Turns the value of the file into the setting, or raises ValueError with what was expected.
    example : str
        Value in the template, as TOML.
    help : str
        One line.
    """

    group: str
    read: Callable[[Any], Any]
    example: str
    help: str


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("text in quotes")
    return value


def _path(value: Any) -> Path:
    if not isinstance(value, (str, os.PathLike)) or not str(value).strip():
        raise ValueError("a path in quotes")
    return Path(value)


def _paths(value: Any) -> tuple[Path, ...]:
    if isinstance(value, (str, os.PathLike)):
        return (_path(value),)
    if not isinstance(value, (list, tuple)):
        raise ValueError("a list of paths")
    return tuple(_path(item) for item in value)


def _names(value: Any) -> tuple[str, ...]:
    if isinstance(value, str):
        return (value,)
    if not isinstance(value, (list, tuple)) or not all(isinstance(item, str) for item in value):
        raise ValueError("a list of names in quotes")
    return tuple(value)


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
        raise ValueError("a number")
    return float(value)


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError("a whole number of at least 1")
    return value


def _number_or_table(value: Any) -> float | dict[str, float]:
    if isinstance(value, Mapping):
        return {str(name): _number(item) for name, item in value.items()}
    try:
        return _number(value)
    except ValueError:
        raise ValueError("a number, or a table of name = number") from None


def _table_or_path(value: Any) -> Path | dict[str, float]:
    if isinstance(value, Mapping):
        return {str(name): _number(item) for name, item in value.items()}
    try:
        return _path(value)
    except ValueError:
        raise ValueError("a table of name = number, or the path of a file") from None


def _weights(value: Any) -> str | dict[str, float]:
    if isinstance(value, Mapping):
        return {str(name): _number(item) for name, item in value.items()}
    return _one_of("volume", "pcsa")(value)


def _one_of(*choices: str) -> Callable[[Any], str]:
    def read(value: Any) -> str:
        if value not in choices:
            raise ValueError(" or ".join(repr(choice) for choice in choices))
        return str(value)

    return read


_MOTION = "The motion: an AnalyzeTool setup file, or its parts by name"
_PROBLEM = "The problem"
_STABILITY = "Joint stability"
_SOLVER = "The solver"
_OUTPUT = "The output"

#: Every setting, in the order of the template.
KEYS: dict[str, Key] = {
    "setup": Key(
        group=_MOTION, read=_path, example='"setup.xml"',
        help="AnalyzeTool setup file with a StaticOptimization; all other motion settings replace its own",
    ),
    "model": Key(group=_MOTION, read=_path, example='"model.osim"', help="OpenSim model"),
    "coordinates": Key(
        group=_MOTION, read=_path, example='"motion.mot"', help="coordinates over time"
    ),
    "states": Key(group=_MOTION, read=_path, example='"states.sto"', help="instead of coordinates"),
    "speeds": Key(
        group=_MOTION, read=_path, example='"speeds.sto"', help="generalized speeds; by default derived"
    ),
    "external_loads": Key(group=_MOTION, read=_path, example='"loads.xml"', help="ExternalLoads file"),
    "actuators": Key(
        group=_MOTION, read=_paths, example='["reserves.xml"]', help="force set files added to the model"
    ),
    "replace_force_set": Key(
        group=_MOTION, read=_flag, example="false", help="drop the model's own forces before adding actuators"
    ),
    "name": Key(group=_MOTION, read=_text, example='"walk"', help="start of every file name"),
    "initial_time": Key(group=_MOTION, read=_number, example="0.0", help="start of the range [s]"),
    "final_time": Key(group=_MOTION, read=_number, example="1.0", help="end of the range [s]"),
    "lowpass_cutoff_frequency": Key(
        group=_MOTION, read=_number, example="6.0", help="low-pass filter [Hz]; negative: none"
    ),
    "step_interval": Key(group=_MOTION, read=_count, example="1", help="take every so many frames"),
    "in_degrees": Key(
        group=_MOTION, read=_flag, example="true", help="unit of angles, where the motion's header is wrong"
    ),
    "held_coordinates": Key(
        group=_MOTION, read=_names, example='["mtp_angle_r"]',
        help="coordinates that stay at zero because the motion has no column for them",
    ),
    "keep_coupled_speeds": Key(
        group=_MOTION, read=_flag, example="false",
        help="speeds of coupled coordinates: true: the motion's, as in OpenSim; false: of the constraints",
    ),
    "exponent": Key(
        group=_PROBLEM, read=_number, example="2.0",
        help="power of the activations, any number of at least 1, or inf for min/max; by default the setup's",
    ),
    "muscle_physiology": Key(
        group=_PROBLEM, read=_flag, example="true",
        help="force-length-velocity with a rigid tendon; false: force = activation x strength",
    ),
    "muscle_model": Key(
        group=_PROBLEM, read=_one_of(*MUSCLE_MODELS), example='"opensim-rigid"',
        help='"opensim-rigid" as OpenSim\'s static optimization, "physical-rigid", "compliant" tendons or '
        '"none"; instead of muscle_physiology',
    ),
    "weights": Key(
        group=_PROBLEM, read=_weights, example='"volume"',
        help='weights of activations, 1 by default: "volume", "pcsa" or e.g. { "soleus_*" = 2.0 }',
    ),
    "stability": Key(
        group=_STABILITY, read=_one_of("off", *STABILITY_METHODS), example='"potvin-brown"',
        help='"off" (default), "potvin-brown" (joint axes), "diagonal" (coordinates), "full" (Hessian)',
    ),
    "q": Key(
        group=_STABILITY, read=_number_or_table, example="5.0",
        help='muscle stiffness = q x force / length; a number or e.g. { "*" = 5.0, "soleus_*" = 9.0 }',
    ),
    "level": Key(
        group=_STABILITY, read=_number_or_table, example="0.0",
        help='least stability [N.m/rad]; a number or, by axis or coordinate, e.g. { "knee_r_z" = 10.0 }',
    ),
    "joints": Key(
        group=_STABILITY, read=_names, example='["knee_r", "ankle_r"]',
        help='of "potvin-brown": by default all joints',
    ),
    "axes": Key(
        group=_STABILITY, read=_names, example='["x", "y", "z"]',
        help='of "potvin-brown": axes of each joint, by default all',
    ),
    "moving_paths": Key(
        group=_STABILITY, read=_one_of("exact", "frozen"), example='"exact"',
        help='of "potvin-brown": sliding points "exact" (derivatives by OpenSim) or "frozen" to the bone',
    ),
    "stability_coordinates": Key(
        group=_STABILITY, read=_names, example='["knee_angle_r", "ankle_angle_r"]',
        help='of "diagonal" and "full": by default all coordinates that muscles cross',
    ),
    "stiffness": Key(
        group=_STABILITY, read=_one_of("proportional", *STIFFNESS_LAWS), example='"proportional"',
        help='muscle stiffness: "proportional" (q), "short-range" or "fiber", both with the tendon in series',
    ),
    "passive": Key(
        group=_STABILITY, read=_table_or_path, example='{ "knee_angle_r" = 5.0 }',
        help="passive stiffness [N.m/rad] besides the model's own: a table by row, or a .toml or .csv file",
    ),
    "soft": Key(
        group=_STABILITY, read=_number, example="1.0",
        help="levels may be missed at this price in the objective per N.m/rad; by default they may not",
    ),
    "solver": Key(
        group=_SOLVER, read=_one_of(*SOLVERS), example='"trajectory"',
        help='"trajectory": all frames together; "framewise": one after the other',
    ),
    "tolerance": Key(group=_SOLVER, read=_number, example="1e-8", help="IPOPT's optimality tolerance"),
    "max_iterations": Key(group=_SOLVER, read=_count, example="500", help="iterations per program"),
    "output": Key(
        group=_OUTPUT, read=_path, example='"results"', help="folder; by default scso_results/<name>"
    ),
    "keep_failed": Key(
        group=_OUTPUT, read=_flag, example="false", help="write results, with NaN in failed frames"
    ),
    "figures": Key(group=_OUTPUT, read=_flag, example="true", help="draw figures as PNG and PDF"),
    "processes": Key(
        group=_OUTPUT, read=_count, example="2", help="OpenSim processes; by default one per core"
    ),
    "cache": Key(
        group=_OUTPUT, read=_path, example='"scso_cache"',
        help="folder for what OpenSim computed, so that a second run needs no OpenSim",
    ),
}  # fmt: skip

#: Settings that are passed on to :class:`MotionInput`.
_MOTION_KEYS = frozenset(item.name for item in fields(MotionInput)) & KEYS.keys()
#: Settings that the template does not comment out.
_FILLED_IN = ("setup", "stability", "q", "level")
#: Settings by stability method, and the names of their fields there.
_ALL_METHODS = {
    "q": "q",
    "level": "level",
    "stiffness": "stiffness",
    "passive": "passive_stiffness",
    "soft": "soft",
}
_AXES_ONLY = {name: name for name in ("joints", "axes", "moving_paths")}
_COORDINATES_ONLY = {"stability_coordinates": "coordinates"}
_STABILITY_KEYS = {
    "off": {},
    "potvin-brown": _ALL_METHODS | _AXES_ONLY,
    "diagonal": _ALL_METHODS | _COORDINATES_ONLY,
    "full": _ALL_METHODS | _COORDINATES_ONLY,
}
_ANY_STABILITY_KEY = _ALL_METHODS | _AXES_ONLY | _COORDINATES_ONLY


def read_settings(
    path: str | os.PathLike[str], changes: Mapping[str, Any] | None = None
) -> tuple[RunSettings, OutputSettings]:
    """Read the settings of a run from a TOML file, or take an AnalyzeTool setup file with its own.

    Parameters
    ----------
    path : path
        ``.toml`` with the keys of :data:`KEYS`, paths relative to its folder; anything else is read as an
        AnalyzeTool setup file.
    changes : mapping of str to object, optional
        Settings that win over the file's, e.g. of the command line; paths relative to the working folder.

    Returns
    -------
    RunSettings, OutputSettings

    Raises
    ------
    FileFormatError
        Not TOML, or not an AnalyzeTool setup.
    NameMismatchError
        A key that is not known; the closest one is suggested.
    DataError
        A value that is not what its key expects, a file that is missing.
    ProblemError
        Settings that contradict each other.
    """
    path = Path(path)
    if path.suffix.lower() == ".toml":
        given = _checked(_parse(path), str(path), path.absolute().parent)
    else:
        given = {"setup": Path(os.path.abspath(path))}
    changed = _checked({k: v for k, v in (changes or {}).items() if v is not None}, "the options", Path.cwd())
    _refuse_idle_stability(given, changed)
    if changed.keys() & {"muscle_model", "muscle_physiology"}:
        given = {
            name: value for name, value in given.items() if name not in ("muscle_model", "muscle_physiology")
        }
    given |= changed
    output = OutputSettings(
        folder=given.get("output"),
        keep_failed=given.get("keep_failed", False),
        figures=given.get("figures", True),
        processes=given.get("processes"),
        cache=given.get("cache"),
    )
    return _run_settings(given, path.absolute()), output


def template() -> str:
    """Write a TOML file with every setting and its help; optional ones are commented out.

    Returns
    -------
    str
        :func:`read_settings` accepts it once the path of the setup file is filled in.
    """
    lines = [
        "# Settings of scso; `scso run` takes this file. Paths are relative to its folder.",
        "# Lines that start with # are optional settings with an example value.",
    ]
    group = ""
    for name, key in KEYS.items():
        if key.group != group:
            group = key.group
            lines += ["", f"# {group} {'-' * (76 - len(group))}"]
        sign = "" if name in _FILLED_IN else "# "
        lines += [f"# {key.help}", f"{sign}{name} = {key.example}"]
    return "\n".join(lines) + "\n"


def _parse(path: Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as file:
            return tomllib.load(file)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path} is not TOML: {error}") from None
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from None


def _checked(given: Mapping[str, Any], where: str, folder: Path) -> dict[str, Any]:
    """Read every value by its key; paths become absolute."""
    result: dict[str, Any] = {}
    for name, value in given.items():
        if name not in KEYS:
            close = difflib.get_close_matches(name, KEYS, n=1, cutoff=0.5)
            hint = f"closest: {close[0]}" if close else f"known: {', '.join(KEYS)}"
            raise NameMismatchError(f"{where}: unknown setting {name!r} ({hint})")
        try:
            read = KEYS[name].read(value)
        except ValueError as error:
            raise DataError(f"{where}: {name} is {value!r}, expected {error}") from None
        if isinstance(read, Path):
            read = _absolute(folder, read)
        elif name == "actuators":
            read = tuple(_absolute(folder, item) for item in read)
        result[name] = read
    return result


def _absolute(folder: Path, path: Path) -> Path:
    return Path(os.path.abspath(folder / path.expanduser()))


def _refuse_idle_stability(given: Mapping[str, Any], changed: Mapping[str, Any]) -> None:
    """Raise if a stability setting would have no effect without anyone having said so."""
    method = changed.get("stability", given.get("stability", "off"))
    # a file may keep settings of the method that it, or an option, replaces
    is_chosen_anew = "stability" in changed or (method == "off" and "stability" in given)
    said = changed if is_chosen_anew else {**given, **changed}
    idle = [name for name in _ANY_STABILITY_KEY if name in said and name not in _STABILITY_KEYS[method]]
    if not idle:
        return
    fitting = " or ".join(repr(m) for m, keys in _STABILITY_KEYS.items() if set(idle) <= keys.keys())
    state = "off" if method == "off" else repr(method)
    raise ProblemError(f"{', '.join(idle)} has no effect while stability is {state}, expected {fitting}")


def _run_settings(given: Mapping[str, Any], source: Path) -> RunSettings:
    changes = {name: value for name, value in given.items() if name in _MOTION_KEYS}
    setup: AnalyzeSetup | None = None
    if "setup" in given:
        setup = read_analyze_setup(given["setup"])
        motion = with_changes(setup.motion, changes)
    elif "model" in changes and changes.keys() & {"coordinates", "states"}:
        motion = MotionInput(**changes)
    else:
        raise DataError(f"{source} names no motion, expected setup, or model and coordinates")
    return RunSettings(
        motion=motion,
        analysis_name=setup.analysis_name if setup else "StaticOptimization",
        exponent=given.get("exponent", setup.activation_exponent if setup else 2.0),
        weights=given.get("weights"),
        muscle_model=_muscle_model(given, setup),
        stability=_stability(given),
        solver=given.get("solver", "trajectory"),
        sources=tuple(dict.fromkeys((source, *([given["setup"]] if setup else [])))),
        options=SolverOptions(**{k: given[k] for k in ("tolerance", "max_iterations") if k in given}),
    )


def _muscle_model(given: Mapping[str, Any], setup: AnalyzeSetup | None) -> str:
    """Choose the muscle model; `muscle_physiology` is the short form for two of them."""
    physiology, model = given.get("muscle_physiology"), given.get("muscle_model")
    if model is None:
        if physiology is None:
            physiology = setup.use_muscle_physiology if setup else True
        return "opensim-rigid" if physiology else "none"
    if physiology is not None and physiology != (model != "none"):
        raise ProblemError(
            f"muscle_model is {model!r} and muscle_physiology is {str(physiology).lower()}, which contradict "
            "each other; leave one of them out"
        )
    return str(model)


def _stability(given: Mapping[str, Any]) -> StabilityConstraint | None:
    """Make the stability constraint that the settings describe."""
    method = given.get("stability", "off")
    if method == "off":
        return None
    values = {field: given[name] for name, field in _STABILITY_KEYS[method].items() if name in given}
    law = values.pop("stiffness", "proportional")
    if law != "proportional":
        if "q" in given:
            raise ProblemError(f"q has no effect on {law} stiffness, expected 'proportional'")
        values["stiffness"] = STIFFNESS_LAWS[law]()
    passive = values.get("passive_stiffness")
    if isinstance(passive, Path) and passive.suffix.lower() == ".csv":
        del values["passive_stiffness"]
        values |= _passive_matrix(passive, method, values.get("coordinates"))
    elif isinstance(passive, Path):
        values["passive_stiffness"] = _passive_table(passive)
    return STABILITY_METHODS[method](**values)


def _passive_table(path: Path) -> dict[str, float]:
    """Read passive stiffness by row, and published stiffness of lumbar joints, from a TOML file."""
    given = _parse(path)
    joints = given.pop("lumbar", [])
    try:
        stiffness = {str(name): _number(value) for name, value in given.items()}
        published = lumbar_passive_stiffness(*(_lumbar_joint(dict(joint)) for joint in joints))
    except (ValueError, TypeError, AttributeError):
        raise DataError(
            f"{path}: expected lines of the form row = number [N.m/rad], and tables [[lumbar]] with levels "
            "= number and, by axial, flexion, extension or lateral, lists of rows"
        ) from None
    twice = sorted(stiffness.keys() & published.keys())
    if twice:
        raise DataError(f"{path}: {', '.join(twice)} stands twice, by itself and in a table [[lumbar]]")
    return stiffness | published


def _lumbar_joint(table: dict[str, Any]) -> LumbarJoint:
    levels = _count(table.pop("levels", None))
    return LumbarJoint(
        levels=levels, rows={row: direction for direction, rows in table.items() for row in _names(rows)}
    )


def _passive_matrix(path: Path, method: str, chosen: tuple[str, ...] | None) -> dict[str, Any]:
    """Read a matrix of passive stiffness: a first line of coordinates, then one line of numbers each."""
    if method != "full":
        raise ProblemError(f"{path} couples coordinates, which only stability 'full' can use; expected .toml")
    try:
        lines = path.read_text(encoding="utf-8-sig").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    rows = [[cell.strip() for cell in line.split(",")] for line in lines if line.strip()]
    names = unique_names("coordinate", rows[0] if rows else ())
    try:
        matrix = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except ValueError:
        raise FileFormatError(f"{path}: expected a line of coordinates, then lines of numbers") from None
    chosen = names if chosen is None else chosen
    return {"coordinates": chosen, "passive_matrix": passive_matrix(chosen, matrix, names)}
