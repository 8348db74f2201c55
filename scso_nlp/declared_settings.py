"""Every setting of a run, declared once.

From :data:`SETTINGS` come the options of ``scso run``, the reading of settings files with its messages, the
template of ``scso init``, the record in ``report.json`` and the reference page. A new setting is one entry
there and one line in ``tests/test_settings.py``. Nothing here imports CasADi or NumPy: help comes fast.
"""

from __future__ import annotations

import itertools
import os
import pkgutil
import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from scso_nlp.exceptions import DataError
from scso_nlp.files import absolute
from scso_nlp.text import number, shown


@dataclass(frozen=True)
class Named:
    """A class or function of the package, by module and name, that is imported only when it is asked for."""

    place: str
    arguments: Mapping[str, Any] = field(default_factory=dict)

    @property
    def thing(self) -> Any:
        """The class or function itself."""
        return pkgutil.resolve_name(f"scso_nlp.{self.place}")

    def make(self, **more: Any) -> Any:
        """Call it with its own arguments and more."""
        return self.thing(**self.arguments, **more)


MUSCLE_MODELS = {
    "opensim-rigid": Named("muscle_models.rigid_tendon:RigidTendon"),
    "physical-rigid": Named("muscle_models.rigid_tendon:RigidTendon", {"convention": "physical"}),
    "compliant": Named("muscle_models.compliant_tendon:CompliantTendon"),
    "none": Named("muscle_models.no_physiology:NoPhysiology"),
}
STABILITY_METHODS = {
    "potvin-brown": Named("constraints.joint_stability:JointStability"),
    "diagonal": Named("constraints.coordinate_stability:CoordinateStability"),
    "full": Named("constraints.hessian_stability:HessianStability"),
}
STIFFNESS_LAWS = {
    "proportional": Named("muscle_models.stiffness_law:ProportionalStiffness"),
    "falling": Named("muscle_models.stiffness_law:FallingStiffness"),
    "short-range": Named("muscle_models.stiffness_law:ShortRangeStiffness"),
    "fiber": Named("muscle_models.stiffness_law:FiberStiffness"),
}
SOLVERS = {"trajectory": Named("solver:solve_trajectory"), "framewise": Named("solver:solve_framewise")}


def name_of(thing: object, table: Mapping[str, Named]) -> str:
    """Find what the settings call an object; one of a user's own class is called after the class."""
    return next((name for name, named in table.items() if type(thing) is named.thing), type(thing).__name__)


@dataclass(frozen=True)
class Kind:
    """What a value may be."""

    type: Any  # of the value in a settings file
    expected: str  # the same at the end of a sentence
    words: str = ""  # the same in the help of the command line
    from_words: Callable[[str], Any] = str  # what a settings file would hold in place of these words
    _: KW_ONLY
    accepts: Callable[[Any], object] | None = None  # what it must be beside its type
    is_path: bool = False


def of_type(value: Any, type: Any) -> Any:
    """Return the value if it is of a type, strictly; raise ValueError otherwise."""
    from pydantic import TypeAdapter  # takes 0.1 s, and help does without

    return TypeAdapter(type).validate_python(value, strict=True)


def _list(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _parts(text: str) -> list[str]:
    """Cut at commas; those between brackets part names of one."""
    return re.split(r",(?![^\[]*\])", text)


def _by_name(text: str, read: Callable[[str], Any] = number) -> dict[str, Any]:
    pairs = [part.rsplit("=", 1) for part in _parts(text)]
    return {name.strip(): read(value) for name, value in pairs}


def _table_or_text(text: str) -> dict[str, float] | str:
    return _by_name(text) if "=" in text else text


def _table_or_number(text: str) -> dict[str, float] | float:
    return _by_name(text) if "=" in text else number(text)


def _force(text: str) -> float | str:
    return text.strip() if text.strip().endswith("BW") else number(text)


def _forces(text: str) -> dict[str, float | str] | float | str:
    return _by_name(text, _force) if "=" in text else _force(text)


def _numbers(text: str) -> dict[str, list[float]]:
    return _by_name(text, lambda values: [number(value) for value in values.split()])


def _parameters(text: str) -> list[str]:
    return [part.strip() for part in _parts(text) if part.strip()]


def _whole_number(text: str) -> int:
    number(text)
    return int(text)


def _one_of(*names: str) -> Kind:
    return Kind(str, " or ".join(map(repr, names)), "|".join(names), accepts=names.__contains__)


_TABLE = 'a table { "name" = number, ... }'

FLAG = Kind(bool, "true or false")
TEXT = Kind(str, "text in quotes", "TEXT")
NUMBER = Kind(float, "a number", "NUMBER", number)
COUNT = Kind(
    int, "a whole number of at least 1, at most 2147483647", "COUNT", _whole_number,
    accepts=lambda count: 1 <= count < 2**31,  # what IPOPT can count to
)  # fmt: skip
PATH = Kind(str, "a path in quotes", "PATH", accepts=str.strip, is_path=True)
PATHS = Kind(
    list[str], "a list of paths", "PATH,...", _list,
    accepts=lambda paths: all(map(str.strip, paths)), is_path=True,
)  # fmt: skip
NAMES = Kind(list[str], "a list of names in quotes", "NAME,...", _list)
NUMBER_OR_TABLE = Kind(
    float | dict[str, float], f"a number, or {_TABLE}", "NUMBER|NAME=NUMBER,...", _table_or_number
)
TABLE = Kind(dict[str, float], _TABLE, "NAME=NUMBER,...", _by_name)
PARAMETERS = Kind(list[str], "a list of names in quotes", "q|q[NAME,...]|level[ROW],...", _parameters)
TABLE_OR_PATH = Kind(
    dict[str, float] | str, f"{_TABLE}, or a path in quotes", "PATH|NAME=NUMBER,...", _table_or_text,
    accepts=lambda value: isinstance(value, dict) or value.strip(), is_path=True,
)  # fmt: skip
FORCES = Kind(
    float | str | dict[str, float | str], f"newtons, or body weights such as '3BW', or {_TABLE} of these",
    "NEWTONS|3BW|NAME=NEWTONS,...", _forces,
)  # fmt: skip
CONES = Kind(
    dict[str, list[float]], 'a table { "name" = [x, y, z, slope], ... }', "NAME=X Y Z SLOPE,...", _numbers,
    accepts=lambda value: all(len(cone) == 4 for cone in value.values()),
)  # fmt: skip
INTERVALS = Kind(
    dict[str, list[float]], 'a table { "name" = [least, most], ... }', "NAME=LEAST MOST,...", _numbers,
    accepts=lambda value: all(len(interval) == 2 for interval in value.values()),
)  # fmt: skip
WEIGHTS = Kind(
    dict[str, float] | str, f"'volume' or 'pcsa', or {_TABLE}", "volume|pcsa|NAME=NUMBER,...", _table_or_text,
    accepts=lambda value: isinstance(value, dict) or value in ("volume", "pcsa"),
)  # fmt: skip


class Group(NamedTuple):
    """Settings that stand together: heading, and the part of a run that they are fields of."""

    heading: str
    part: str


@dataclass(frozen=True)
class Setting:
    """One setting.

    Attributes
    ----------
    name : str
        Key in settings files and in the record of ``report.json``.
    kind : Kind
        What its value may be.
    group : Group
        Where it stands in the template and on the reference page.
    help : str
        What it does; unit and default are added to it.
    example : str
        Value in the template, as TOML.
    default : str
        What holds without it: a value as on the command line, or what it depends on.
    unit : str
    place : str
        Part and field that take the value, where they are not the group's part and the name.
    option : str
        Spelling on the command line, where it is not the name.
    is_filled_in : bool
        The template does not comment it out.
    """

    name: str
    kind: Kind
    group: Group
    _: KW_ONLY
    help: str
    example: str
    default: str = ""
    unit: str = ""
    place: str = ""
    option: str = ""
    is_filled_in: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "place", self.place or f"{self.group.part}.{self.name}")

    @property
    def spelling(self) -> str:
        """Option of ``scso run``; the two sides of a switch have a slash between them."""
        word = self.name.replace("_", "-")
        return self.option or (f"--{word}/--no-{word}" if self.kind is FLAG else f"--{word}")

    @property
    def description(self) -> str:
        """Help, unit and default in one line."""
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{self.help}{unit}." + (f" [default: {self.default}]" if self.default else "")

    def read(self, value: Any, where: str, folder: Path, *, as_option: bool = False) -> Any:
        """Check a value as a file holds it, or as the command line does; paths are relative to `folder`.

        Raises
        ------
        DataError
            Not what was expected; the sentence starts with `where`.
        """
        kind, found = self.kind, value
        hint = f"{self.spelling} {kind.words}".strip() if as_option else f"e.g. {self.name} = {self.example}"
        try:
            if as_option and isinstance(value, str):
                found = kind.from_words(value)
            if kind.type == list[str] and isinstance(found, str):
                found = [found]
            read = of_type(_plain(found), kind.type)
            if kind.accepts and not kind.accepts(read):
                raise ValueError("of the right type, but not what is expected")
        except ValueError:
            raise DataError(
                f"{where}: {self.name} is {shown(found)}, expected {kind.expected} ({hint})"
            ) from None
        return _absolute(folder, read) if kind.is_path else tuple(read) if isinstance(read, list) else read


def _plain(value: Any) -> Any:
    """Turn paths, tuples and tables of any kind, of Python callers, into what a file holds; refuse NaN."""
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if value != value:
        raise ValueError("NaN is no number")
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def _absolute(folder: Path, read: Any) -> Any:
    if isinstance(read, list):
        return tuple(_absolute(folder, item) for item in read)
    return absolute(read, folder) if isinstance(read, str) else read


MOTION = Group("The motion: an AnalyzeTool setup file, or its parts by name", "motion")
PROBLEM = Group("The problem", "run")
STABILITY = Group("Joint stability", "stability")
EMG = Group("Electromyography", "emg")
CALIBRATION = Group("Calibration, for scso calibrate alone", "calibration")
SOLVER = Group("The solver", "options")
OUTPUT = Group("The output", "output")

#: Every setting by its name, in the order of the template.
SETTINGS = {setting.name: setting for setting in (
    Setting("setup", PATH, MOTION, place="run.setup", example='"setup.xml"', is_filled_in=True,
        help="AnalyzeTool setup file with a StaticOptimization; the other motion settings replace its own"),
    Setting("model", PATH, MOTION, example='"model.osim"', default="the setup's", help="OpenSim model"),
    Setting("coordinates", PATH, MOTION, option="--coordinates-file", example='"motion.mot"',
        default="the setup's", help="Coordinates over time"),
    Setting("states", PATH, MOTION, example='"states.sto"', default="the setup's",
        help="States over time, instead of coordinates"),
    Setting("speeds", PATH, MOTION, example='"speeds.sto"', default="the setup's, or derived",
        help="Generalized speeds over time"),
    Setting("external_loads", PATH, MOTION, example='"loads.xml"', default="the setup's",
        help="ExternalLoads file"),
    Setting("actuators", PATHS, MOTION, example='["reserves.xml"]', default="the setup's",
        help="Force set files added to the model"),
    Setting("replace_force_set", FLAG, MOTION, example="false", default="the setup's, or false",
        help="Drop the model's own forces before adding actuators"),
    Setting("outside_force_set", NAMES, MOTION, example='["hamstrings_r", "vasti_r"]', default="none",
        help="Muscles and actuators outside the model's ForceSet to optimize too, or all; OpenSim does not"),
    Setting("name", TEXT, MOTION, example='"walk"', default="the setup's, or the model file's",
        help="Start of every file name"),
    Setting("initial_time", NUMBER, MOTION, unit="s", example="0.0", default="the setup's, or the motion's",
        help="Start of the range"),
    Setting("final_time", NUMBER, MOTION, unit="s", example="1.0", default="the setup's, or the motion's",
        help="End of the range"),
    Setting("lowpass_cutoff_frequency", NUMBER, MOTION, unit="Hz", example="6.0",
        default="the setup's, or none", help="Low-pass filter of the coordinates, negative for none"),
    Setting("step_interval", COUNT, MOTION, example="1", default="the setup's, or 1",
        help="Take every so many frames"),
    Setting("in_degrees", FLAG, MOTION, option="--in-degrees/--in-radians", example="true",
        default="as the motion's header says", help="Angles are in degrees, where that header is wrong"),
    Setting("speeds_in_degrees", FLAG, MOTION, option="--speeds-in-degrees/--speeds-in-radians",
        example="true", default="as the header of speeds says",
        help="Angular speeds are in degrees per second, where that header is wrong"),
    Setting("held_coordinates", NAMES, MOTION, example='["mtp_angle_r"]', default="none",
        help="Coordinates that stay at zero because the motion has no column for them"),
    Setting("keep_coupled_speeds", FLAG, MOTION, example="false", default="true",
        option="--keep-coupled-speeds/--coupled-speeds-from-constraints",
        help="Take speeds of coupled coordinates from the motion, as OpenSim does, not from the constraints"),
    Setting("exponent", NUMBER, PROBLEM, example="2.0", default="the setup's, or 2",
        help="Power of the activations, any number of at least 1, or inf for min/max"),
    Setting("muscle_physiology", FLAG, PROBLEM, example="true", default="the setup's, or true",
        help="Force-length-velocity, or else force = activation x strength"),
    Setting("muscle_model", _one_of(*MUSCLE_MODELS), PROBLEM, example='"opensim-rigid"',
        default="by muscle_physiology", help="OpenSim's own capacity, the textbook's rigid tendon, elastic "
        "tendons, or strength alone; instead of muscle_physiology"),
    Setting("short_fibers", _one_of("refuse", "silence"), PROBLEM, example='"silence"', default="refuse",
        help="What becomes of paths too short for their tendon, with physical-rigid or compliant: they are "
        "refused, or the muscle rests there"),
    Setting("weights", WEIGHTS, PROBLEM, example='"volume"', default="1 for all",
        help="Weights of activations: the muscles' volumes or cross-sections, or by name or pattern"),
    Setting("passive_elements", _one_of("taken_off", "left_in"), PROBLEM, example='"taken_off"',
        default="taken_off", help="What springs, bushings, ligaments and limits of the model do: carried "
        "by themselves (taken_off), as in OpenSim, or by muscles and actuators too (left_in)"),
    Setting("activation_rate", _one_of("off", "first_order", "constant"), PROBLEM, example='"first_order"',
        default="off", help="Let activations rise and fall no faster than the model's time constants allow: "
        "as first-order dynamics does, or by constant bounds"),
    Setting("activation_dynamics", FLAG, PROBLEM, example="false", default="false",
        help="Let activations follow excitations by first-order dynamics with the model's time constants"),
    Setting("joint_reactions", NAMES, PROBLEM, place="motion.joint_reactions", example='["knee_r", "hip_r"]',
        default="none", help="Joints whose reactions are computed and written to a file, or all"),
    Setting("joint_reaction_effort", NUMBER_OR_TABLE, PROBLEM, example='{ "knee_r" = 0.1 }', default="none",
        help="Weight of the mean squared joint force in body weights besides the effort of the activations, "
        "for all joints or by name or pattern"),
    Setting("joint_reaction_limit", FORCES, PROBLEM, unit="N", example='{ "knee_r" = 2500.0 }',
        default="none", help="Largest force of joints, for all or by name or pattern, in newtons or body "
        "weights (3BW)"),
    Setting("joint_reaction_cone", CONES, PROBLEM, example='{ "shoulder" = [0.0, 0.0, -1.0, 0.5] }',
        default="none", help="Cone that the force of a joint on its parent stays in, by name or pattern: its "
        "axis in the parent, into the socket, and its slope, the largest shear over compression"),
    Setting("joint_reaction_soft", NUMBER, PROBLEM, unit="objective per N", example="0.001",
        default="they may not", help="Let limits and cones of joint reactions be missed, at this price"),
    Setting("stability", _one_of("off", *STABILITY_METHODS), STABILITY, place="run.stability",
        example='"potvin-brown"', default="off", is_filled_in=True, help="Stability about joint axes "
        "(potvin-brown), along coordinates (diagonal), or of their whole Hessian (full)"),
    Setting("q", NUMBER_OR_TABLE, STABILITY, example="5.0", default="5", is_filled_in=True,
        help="Muscle stiffness = q x force / length; for all, or by name or pattern"),
    Setting("level", NUMBER_OR_TABLE, STABILITY, unit="N.m/rad", example="0.0", default="0",
        is_filled_in=True, help="Least stability, for all or by <joint>_<axis> or coordinate"),
    Setting("joints", NAMES, STABILITY, example='["knee_r", "ankle_r"]',
        default="all that muscles can make stable", help="Joints of potvin-brown"),
    Setting("axes", NAMES, STABILITY, example='["x", "y", "z"]',
        default="those that a free coordinate turns, of joints that muscles cross",
        help="Axes of each joint of potvin-brown"),
    Setting("moving_paths", _one_of("exact", "frozen"), STABILITY, example='"exact"', default="exact",
        help="Sliding points of potvin-brown: exact (derivatives by OpenSim) or frozen to the bone"),
    Setting("stability_coordinates", NAMES, STABILITY, place="stability.coordinates", option="--coordinates",
        example='["knee_angle_r", "ankle_angle_r"]', default="all that muscles cross",
        help="Coordinates of diagonal and full"),
    Setting("stiffness", _one_of(*STIFFNESS_LAWS), STABILITY, example='"proportional"',
        default="proportional",
        help="Law of muscle stiffness: proportional (q), or falling with force from q on; short-range or "
        "fiber, with the tendon in series"),
    Setting("half_force", NUMBER, STABILITY, place="stiffness.half_force", example="0.5",
        default="0.5, where falling", unit="maximum isometric forces",
        help="Force at which falling stiffness has half its q"),
    Setting("tendon_compliance", NUMBER, STABILITY, place="stiffness.tendon_compliance", example="4.0",
        default="1, where short-range",
        help="How many times as compliant tendons are as the model has them, for short-range"),
    Setting("passive", TABLE_OR_PATH, STABILITY, place="stability.passive_stiffness", unit="N.m/rad",
        example='{ "knee_angle_r" = 5.0 }', default="none",
        help="Passive stiffness besides the model's own, by row, or a .toml or .csv file"),
    Setting("passive_factor", NUMBER, STABILITY, place="stability.passive_factor", example="0.5", default="1",
        help="How much of all passive stiffness counts, the model's own too"),
    Setting("soft", NUMBER, STABILITY, unit="objective per N.m/rad", example="1.0", default="they may not",
        help="Let levels be missed, at this price"),
    Setting("emg", PATH, EMG, place="emg.file", example='"emg.sto"', default="none",
        help="EMG envelopes over time, .sto, .mot or .csv, that activations are held to; needs emg_map, and "
        "emg_tracking or emg_bounds"),
    Setting("emg_map", PATH, EMG, place="emg.map", example='"emg_map.toml"', default="none",
        help="TOML file: groups of muscles, the EMG channels over them, their references, scales and delays"),
    Setting("raw_emg", FLAG, EMG, place="emg.is_raw", example="false", default="false",
        help="The EMG is raw: band-pass, rectify and smooth it first"),
    Setting("emg_offset", NUMBER, EMG, place="emg.offset", unit="s", example="0.0", default="0",
        help="Added to the times of the EMG"),
    Setting("emg_tracking", NUMBER, EMG, place="emg.tracking", example="10.0", default="none",
        help="Weight of squared distances of activations from EMG in the objective"),
    Setting("emg_bounds", NUMBER, EMG, place="emg.bounds", example="0.1", default="none",
        help="Keep activations at most so far from EMG"),
    Setting("emg_compare", _one_of("levels", "shapes"), EMG, place="emg.compare", example='"levels"',
        default="none", help="Let scso calibrate compare activations with EMG: levels where it is a share of "
        "the maximal contraction, else shapes"),
    Setting("calibrated", PARAMETERS, CALIBRATION, place="calibration.parameters",
        example='["q[ES*,MF*]", "q[RA*]"]', default="q",
        help="What is found: q or q[muscles], one gain for all that fit, and level or level[rows]"),
    Setting("calibration_bounds", INTERVALS, CALIBRATION, place="calibration.bounds",
        example='{ "q[RA*]" = [1.0, 20.0] }', default="0.5 to 42 for q, the published gains; none for levels",
        help="Least and largest value of what is found, by its name"),
    Setting("measured_stiffness", NUMBER, CALIBRATION, place="calibration.stiffness", unit="N/m",
        example="14500.0", default="none", help="Stiffness of a point that is to be met instead of EMG; with "
        "an arm of 1 that of a row [N.m/rad]"),
    Setting("stiffness_arms", TABLE, CALIBRATION, place="calibration.arms", unit="m",
        example='{ "L5_S1_IVDjnt_z" = 0.3 }', default="none",
        help="Distances of that point from the axes of rows, by row"),
    Setting("unit", TEXT, CALIBRATION, example='"person 1"', default="each trial by itself",
        help="Trials of one unit are left out together"),
    Setting("same_data", FLAG, CALIBRATION, example="false", default="false",
        help="Find and test on the same data, leaving nothing out"),
    Setting("solver", _one_of(*SOLVERS), SOLVER, place="run.solver", example='"trajectory"',
        default="trajectory", help="All frames together (trajectory), or one after the other (framewise)"),
    Setting("tolerance", NUMBER, SOLVER, example="1e-10", default="1e-10",
        help="IPOPT's optimality tolerance"),
    Setting("max_iterations", COUNT, SOLVER, example="500", default="500", help="Iterations per program"),
    Setting("frames_per_program", COUNT, SOLVER, example="128", default="128",
        help="Cut longer motions into programs of so many frames; the answer does not depend on it"),
    Setting("presolve", FLAG, SOLVER, example="true", default="true",
        help="Start IPOPT at the optima of the frames, where these are found one by one"),
    Setting("output", PATH, OUTPUT, place="output.folder", example='"results"',
        default="scso_results/<name of the file that is run>, beside it", help="Folder of the results"),
    Setting("overwrite", FLAG, OUTPUT, example="false", default="false: the next free name, <folder>_2",
        help="Replace results of other inputs in that folder"),
    Setting("keep_failed", FLAG, OUTPUT, example="false", default="false",
        help="Write results even so, with NaN in frames that failed"),
    Setting("figures", FLAG, OUTPUT, example="true", default="true", help="Draw figures as PNG and PDF"),
    Setting("processes", COUNT, OUTPUT, example="2", default="one per core", help="OpenSim processes"),
    Setting("cache", PATH, OUTPUT, example='"scso_cache"', default="none",
        help="Folder for what OpenSim computed, so that a second run needs no OpenSim"),
)}  # fmt: skip


def template(values: Mapping[str, str] | None = None, reasons: Mapping[str, str] | None = None) -> str:
    """Write a TOML file with every setting; it can be read once the path of the setup file is filled in.

    Parameters
    ----------
    values : mapping of str to str, optional
        Settings to fill in, as TOML.
    reasons : mapping of str to str, optional
        What to say of settings in this file, besides what they do.

    Returns
    -------
    str
    """
    values, reasons = values or {}, reasons or {}
    lines = [
        "# Settings of scso; `scso run` takes this file. Paths are relative to its folder.",
        "# Lines that start with # are optional settings with an example value.",
    ]
    for (heading, _), settings in itertools.groupby(SETTINGS.values(), key=lambda setting: setting.group):
        lines += ["", f"# {heading} {'-' * (76 - len(heading))}"]
        for setting in settings:
            name = setting.name
            sign = "" if setting.is_filled_in or name in values else "# "
            choice = f"  # {setting.kind.expected}" if "|" in setting.kind.words else ""
            lines += [f"# {setting.description}"]
            lines += (
                textwrap.wrap(f"{reasons[name]}.", 100, initial_indent="#   Here: ", subsequent_indent="#   ")
                if name in reasons
                else []
            )
            lines += [f"{sign}{name} = {values.get(name, setting.example)}{choice}"]
    return "\n".join(lines) + "\n"


def reference() -> str:
    """Write the reference page of the settings, in Markdown."""
    lines = [
        "# Settings\n",
        "Each is a key of a settings file, which `scso init` writes, and an option of `scso run`. Options "
        "win over the file; paths are relative to the file, those of options to the working folder.",
    ]
    for (heading, _), settings in itertools.groupby(SETTINGS.values(), key=lambda setting: setting.group):
        lines.append(f"\n## {heading}")
        for setting in settings:
            option = f"{setting.spelling.replace('/', '` or `')} {setting.kind.words}".strip()
            lines += [
                f"\n### `{setting.name}`\n\n{setting.description}\n",
                f"- In a file: {setting.kind.expected}, e.g. `{setting.name} = {setting.example}`",
                f"- Option: `{option}`",
            ]
    return "\n".join(lines) + "\n"
