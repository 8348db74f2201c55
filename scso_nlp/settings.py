"""Settings of a run: values that a Python user makes by hand, or that a file and the options describe.

What a setting may be is declared in :mod:`scso_nlp.declared_settings`; here it becomes objects.
"""

from __future__ import annotations

import functools
import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from scso_nlp.activity import MuscleActivity
from scso_nlp.arguments import checked
from scso_nlp.constraints.activation_dynamics import ActivationDynamics
from scso_nlp.constraints.activation_rate import ActivationRate
from scso_nlp.constraints.constraint import FrameConstraint, FramePairConstraint
from scso_nlp.constraints.emg_bounds import EmgBounds
from scso_nlp.constraints.joint_reaction_cone import JointReactionCone
from scso_nlp.constraints.joint_reaction_limit import JointReactionLimit
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.declared_settings import (
    MUSCLE_MODELS,
    SETTINGS,
    SOLVERS,
    STABILITY_METHODS,
    STIFFNESS_LAWS,
    name_of,
    of_type,
)
from scso_nlp.emg import read_activity
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError, ProblemError
from scso_nlp.files import absolute, check_name, hashes, read_text, read_toml, refuse_changed
from scso_nlp.objectives.activation_effort import ActivationEffort
from scso_nlp.objectives.emg_tracking import EmgTracking
from scso_nlp.objectives.joint_reaction_effort import JointReactionEffort
from scso_nlp.objectives.objective import FrameObjective
from scso_nlp.opensim.setup_xml import (
    DEFAULT_OUTPUT_PRECISION,
    AnalyzeSetup,
    MotionInput,
    read_analyze_setup,
    with_changes,
)
from scso_nlp.solver.ipopt import SolverOptions
from scso_nlp.stability.passive import LumbarJoint, lumbar_passive_stiffness, passive_matrix
from scso_nlp.text import number
from scso_nlp.validation import nearest, unique_names

_LOG = logging.getLogger("scso_nlp")

#: Folder of results where none is named.
RESULTS = "scso_results"
#: Either of them decides the muscle model.
_MODEL_SETTINGS = ("muscle_model", "muscle_physiology")


@dataclass(frozen=True, kw_only=True)
@checked
class EmgSettings:
    """EMG that activations are held to, if any.

    Attributes
    ----------
    file, map : Path or None
        As for :func:`scso_nlp.emg.read_activity`.
    is_raw : bool
        Make envelopes of it first.
    offset : float [s]
        Added to its times.
    tracking : float or None [-]
        Weight of :class:`~scso_nlp.EmgTracking`.
    bounds : float or None [-]
        Width on both sides of :class:`~scso_nlp.EmgBounds`.
    compare : "levels", "shapes" or None
        What :class:`~scso_nlp.MeasuredEmg` compares in a calibration.
    """

    file: Path | None = None
    map: Path | None = None
    is_raw: bool = False
    offset: float = 0.0
    tracking: float | None = None
    bounds: float | None = None
    compare: Literal["levels", "shapes"] | None = None

    def __post_init__(self) -> None:
        is_idle = self.tracking is None and self.bounds is None and self.compare is None
        is_without = self.file is None and self.map is None and not self.is_raw and not self.offset
        if is_without and is_idle:
            return
        if self.file is None or self.map is None:
            raise ProblemError("EMG takes a file and a map of its channels, expected emg and emg_map")
        if is_idle:
            raise ProblemError(
                f"{self.file} has no effect, expected emg_tracking or emg_bounds beside it, or, for scso "
                "calibrate, emg_compare"
            )
        self.activity, self.objectives, self.constraints  # noqa: B018 - reads the files, and the terms check the numbers

    @functools.cached_property
    def activity(self) -> MuscleActivity:
        """What the files hold."""
        assert self.file is not None  # seen to by __post_init__
        assert self.map is not None
        return read_activity(self.file, self.map, is_raw=self.is_raw, start_offset=self.offset)

    @property
    def objectives(self) -> tuple[FrameObjective, ...]:
        """Tracking, if it has a weight."""
        if self.tracking is None:
            return ()
        return (EmgTracking(activity=self.activity, weight=self.tracking),)

    @property
    def constraints(self) -> tuple[FrameConstraint, ...]:
        """Bounds, if they have a width."""
        if self.bounds is None:
            return ()
        return (EmgBounds(activity=self.activity, below=self.bounds, above=self.bounds),)


@dataclass(frozen=True, kw_only=True)
@checked
class CalibrationSettings:
    """What ``scso calibrate`` finds, besides the EMG that it compares with; a run looks at none of it.

    Attributes
    ----------
    parameters : tuple of str
    bounds : mapping of str to (float, float), or None
        As for :func:`~scso_nlp.calibrate`.
    stiffness : float or None [N/m]
    arms : mapping of str to float, or None [m]
        As for :class:`~scso_nlp.MeasuredStiffness`.
    unit : str
        As for :class:`~scso_nlp.MeasuredTrial`.
    same_data : bool
    """

    parameters: tuple[str, ...] = ("q",)
    bounds: Mapping[str, Sequence[float]] | None = None
    stiffness: float | None = None
    arms: Mapping[str, float] | None = None
    unit: str = ""
    same_data: bool = False


@dataclass(frozen=True, kw_only=True)
@checked
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
    passive_elements : "taken_off" or "left_in"
        As for :class:`~scso_nlp.MomentEquilibrium`.
    activation_rate : "off", "first_order" or "constant"
        Bounds of :class:`~scso_nlp.ActivationRate`, if any.
    activation_dynamics : bool
        With :class:`~scso_nlp.ActivationDynamics`.
    joint_reaction_effort : float, mapping of str to float, or None
        Weight of :class:`~scso_nlp.JointReactionEffort` of all joints, or of some by name or pattern.
    joint_reaction_limit : float, text such as "3BW", mapping of str to these, or None [N]
        As `largest` of :class:`~scso_nlp.JointReactionLimit`.
    joint_reaction_cone : mapping of str to (x, y, z, slope), or None
        Axis and slope of a :class:`~scso_nlp.JointReactionCone` by joint or pattern.
    joint_reaction_soft : float or None [objective per N]
        Price at which these limits and cones may be missed.
    muscle_model : "opensim-rigid", "physical-rigid", "compliant" or "none"
        Force-length-velocity as OpenSim's static optimization has it, with the textbook's rigid tendon, or
        with elastic tendons; or force proportional to activation.
    short_fibers : "refuse" or "silence"
        As for :class:`~scso_nlp.RigidTendon` and :class:`~scso_nlp.CompliantTendon`.
    stability : StabilityConstraint or None
        None: plain static optimization.
    emg : EmgSettings
    calibration : CalibrationSettings
    solver : "trajectory" or "framewise"
    options : SolverOptions
    setup : Path or None
        AnalyzeTool setup file that the settings were taken from.
    sources : mapping of str to str
        SHA-256 by path of the files that the settings were read from, for the report.
    notes : tuple of str
        What those files ask for and is done otherwise, for the report.
    """

    motion: MotionInput
    analysis_name: str = "StaticOptimization"
    exponent: float = 2.0
    weights: str | Mapping[str, float] | None = None
    passive_elements: Literal["taken_off", "left_in"] = "taken_off"
    activation_rate: Literal["off", "first_order", "constant"] = "off"
    activation_dynamics: bool = False
    joint_reaction_effort: float | Mapping[str, float] | None = None
    joint_reaction_limit: float | str | Mapping[str, float | str] | None = None
    joint_reaction_cone: Mapping[str, Sequence[float]] | None = None
    joint_reaction_soft: float | None = None
    muscle_model: str = "opensim-rigid"
    short_fibers: Literal["refuse", "silence"] = "refuse"
    stability: StabilityConstraint | None = None
    emg: EmgSettings = field(default_factory=EmgSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    solver: str = "trajectory"
    options: SolverOptions = field(default_factory=SolverOptions)
    setup: Path | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, known in (("solver", SOLVERS), ("muscle_model", MUSCLE_MODELS)):
            if getattr(self, name) not in known:
                raise ProblemError(f"{name} is {getattr(self, name)!r}, expected one of {', '.join(known)}")
        if self.short_fibers != "refuse" and self.muscle_model not in ("physical-rigid", "compliant"):
            raise ProblemError(
                f"short_fibers has no effect on the muscle model {self.muscle_model!r}, expected "
                "'physical-rigid' or 'compliant'"
            )
        for part in (self.motion.name, self.analysis_name):
            check_name(part)
        if self.joint_reaction_soft is not None and not (
            self.joint_reaction_limit or self.joint_reaction_cone
        ):
            raise ProblemError("joint_reaction_soft needs joint_reaction_limit or joint_reaction_cone")
        ActivationEffort(exponent=self.exponent, weights=self.weights)
        coupled = [term.name for term in self.terms if isinstance(term, FramePairConstraint)]
        if coupled and self.solver == "framewise":
            raise ProblemError(f"{', '.join(coupled)} couples frames, expected solver 'trajectory'")

    @property
    def terms(self) -> tuple[FrameObjective | FrameConstraint | FramePairConstraint, ...]:
        """All that is asked for besides static optimization."""
        return (*self.objectives, *self.constraints)

    @property
    def objectives(self) -> tuple[FrameObjective, ...]:
        """What is asked for besides the effort of the activations."""
        terms = list(self.emg.objectives)
        weights = self.joint_reaction_effort
        if isinstance(weights, Mapping):
            terms.append(JointReactionEffort(joints=tuple(weights), weights=weights))
        elif weights is not None:
            terms.append(JointReactionEffort(weight=weights))
        return tuple(terms)

    @property
    def constraints(self) -> tuple[FrameConstraint | FramePairConstraint, ...]:
        """What is asked for besides moment equilibrium."""
        terms: list[FrameConstraint | FramePairConstraint] = []
        if self.stability is not None:
            terms.append(self.stability)
        if self.activation_rate != "off":
            terms.append(ActivationRate(bounds=self.activation_rate))
        if self.activation_dynamics:
            terms.append(ActivationDynamics())
        limit, soft = self.joint_reaction_limit, self.joint_reaction_soft
        if limit is not None:
            joints = tuple(limit) if isinstance(limit, Mapping) else None
            terms.append(JointReactionLimit(largest=limit, joints=joints, soft=soft))
        for joint, (*axis, slope) in (self.joint_reaction_cone or {}).items():
            label = f"JointReactionCone_{joint}"
            terms.append(JointReactionCone(joints=[joint], axis=axis, slope=slope, soft=soft, label=label))
        return (*terms, *self.emg.constraints)

    @property
    def muscle_physiology(self) -> bool:
        """True if force depends on fiber length and velocity."""
        return self.muscle_model != "none"


@dataclass(frozen=True, kw_only=True)
@checked
class OutputSettings:
    """Where and how results are written; nothing here changes a number.

    Attributes
    ----------
    folder : Path or None
        None: ``scso_results/<name>`` in the working folder; for settings read from a file, ``scso_results``
        and the file's name beside it.
    overwrite : bool
        Results of other inputs in that folder are replaced; otherwise the next free name is taken.
    keep_failed : bool
    figures : bool
    processes : int or None
        Worker processes of the extraction; None is one per core.
    cache : Path or None
        Folder for extracted motions, so that a second run needs no OpenSim.
    """

    folder: Path | None = None
    overwrite: bool = False
    keep_failed: bool = False
    figures: bool = True
    processes: int | None = None
    cache: Path | None = None

    def folder_for(self, name: str) -> Path:
        """Folder of the results of a motion of this name."""
        return self.folder or Path(RESULTS) / name


def record(settings: RunSettings, output: OutputSettings) -> dict[str, Any]:
    """Give the value in effect of every setting, None where it has none, for ``report.json``."""
    values: dict[str, Any] = {}
    law = settings.stability.stiffness_law if settings.stability else None
    for name, setting in SETTINGS.items():
        part, _, field = setting.place.partition(".")
        owners = {"run": settings, "output": output, "stiffness": law}
        owner = owners[part] if part in owners else getattr(settings, part)
        values[name] = getattr(owner, field, None)
    if settings.stability is None:
        return values | {"stability": "off"}
    values["stability"] = name_of(settings.stability, STABILITY_METHODS)
    values["stiffness"] = name_of(law, STIFFNESS_LAWS)
    values["q"] = getattr(law, "q", None)
    matrix = getattr(settings.stability, "passive_matrix", None)
    return values if matrix is None else values | {"passive": matrix}


@checked
def read_settings(
    path: str | os.PathLike[str], changes: Mapping[str, Any] | None = None
) -> tuple[RunSettings, OutputSettings]:
    """Read the settings of a run from a TOML file, or take an AnalyzeTool setup file with its own.

    Parameters
    ----------
    path : path
        ``.toml`` with the names of :data:`~scso_nlp.declared_settings.SETTINGS`, paths relative to its
        folder; anything else is read as an AnalyzeTool setup file.
    changes : mapping of str to object, optional
        Settings that win over the file's; None is no change. Text is read as on the command line, paths are
        relative to the working folder.

    Returns
    -------
    RunSettings, OutputSettings

    Raises
    ------
    FileFormatError
        Not TOML, or not an AnalyzeTool setup.
    NameMismatchError
        A name that is not known; the closest one is suggested.
    DataError
        A value that is not what its setting expects, a file that is missing.
    ProblemError
        Settings that contradict each other.
    """
    path = absolute(path)
    before = hashes(filter(os.path.isfile, [path]))
    output = {"folder": path.parent / RESULTS / path.stem}
    return _settings(given_settings(path, changes), str(path), before, output)


def given_settings(path: Path, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Read what a file and options say, each setting by its name, paths absolute; see :func:`read_settings`.

    Parameters
    ----------
    path : Path
    changes : mapping of str to object, optional

    Returns
    -------
    dict of str to object
    """
    changes = {name: value for name, value in (changes or {}).items() if value is not None}
    changed = check_settings(changes, "the options", Path.cwd(), as_option=True)
    if path.suffix.lower() == ".toml":
        given = check_settings(read_toml(path), str(path), path.parent)
    elif "setup" in changed:
        raise ProblemError(f"{path} is taken as a setup, but the options name another: leave one of them out")
    else:
        given = {"setup": path}
    _refuse_idle_stability(given, changed)
    return overlaid(given, changed)


@checked
def settings_of(given: Mapping[str, Any], where: str = "the settings") -> tuple[RunSettings, OutputSettings]:
    """Make the settings of a run from the values that a settings file would hold.

    Parameters
    ----------
    given : mapping of str to object
        By the names of :data:`~scso_nlp.declared_settings.SETTINGS`; relative paths are relative to the
        working folder.
    where : str
        What a message about them begins with.

    Returns
    -------
    RunSettings, OutputSettings

    Raises
    ------
    FileFormatError, NameMismatchError, DataError, ProblemError
        As for :func:`read_settings`.

    Examples
    --------
    >>> from scso_nlp.settings import settings_of
    >>> settings, _ = settings_of({"setup": example_folder("elbow") / "setup.xml"})
    >>> settings.exponent
    2.0
    """
    given = check_settings(given, where, Path.cwd())
    _refuse_idle_stability(given, {})
    return _settings(given, where, {}, {})


def overlaid(given: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """Lay checked settings over others: they win, and what has no effect beside them is left out.

    Parameters
    ----------
    given, changed : mapping of str to object

    Returns
    -------
    dict of str to object
    """
    idle = _without_effect(changed["stability"]) if "stability" in changed else set()
    if changed.keys() & set(_MODEL_SETTINGS):
        idle |= set(_MODEL_SETTINGS)
    return {name: value for name, value in given.items() if name not in idle} | dict(changed)


def check_settings(
    given: Mapping[str, Any], where: str, folder: Path, *, as_option: bool = False
) -> dict[str, Any]:
    """Read every value as its setting says.

    Parameters
    ----------
    given : mapping of str to object
    where : str
        What a message begins with.
    folder : Path
        What relative paths are relative to.
    as_option : bool
        Text is read as on the command line.

    Returns
    -------
    dict of str to object
        Paths are absolute.

    Raises
    ------
    NameMismatchError
        A name that is not known; the closest one is suggested.
    DataError
        A value that is not what its setting expects.
    """
    for name in given:
        if name not in SETTINGS:
            raise NameMismatchError(f"{where}: unknown setting {name!r} ({nearest(name, SETTINGS)})")
    return {n: SETTINGS[n].read(v, where, folder, as_option=as_option) for n, v in given.items()}


def _settings(
    given: Mapping[str, Any], where: str, before: Mapping[str, str], output: Mapping[str, Any]
) -> tuple[RunSettings, OutputSettings]:
    """Make objects of checked settings; `before` are hashes of files that these were read from."""
    named = (given.get(name) for name in ("setup", "passive", "emg", "emg_map"))
    sources = {**before, **hashes(file for file in named if isinstance(file, Path) and os.path.isfile(file))}
    results = OutputSettings(**{**output, **_fields("output", given)})
    settings = _run_settings(given, where, sources, results)
    refuse_changed(sources)
    return settings, results


def _fields(part: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Pick what is given for a part of the run, by field."""
    places = {name: SETTINGS[name].place.partition(".") for name in given}
    return {field: given[name] for name, (owner, _, field) in places.items() if owner == part}


def _with_effect(method: str) -> set[str]:
    """Name the settings of joint stability that a method has a field for."""
    if method == "off":
        return set()
    places = {f"stability.{item.name}" for item in fields(STABILITY_METHODS[method].thing)}
    places |= {place for setting in SETTINGS.values() if (place := setting.place).startswith("stiffness.")}
    return {name for name, setting in SETTINGS.items() if setting.place in places}


def _without_effect(method: str) -> set[str]:
    """Name the settings of joint stability that a method has no field for."""
    return set().union(*map(_with_effect, STABILITY_METHODS)) - _with_effect(method)


def _refuse_idle_stability(given: Mapping[str, Any], changed: Mapping[str, Any]) -> None:
    """Raise if a stability setting would have no effect without anyone having said so."""
    method = changed.get("stability", given.get("stability", "off"))
    # a file may keep settings of the method that it, or an option, replaces
    is_chosen_anew = "stability" in changed or (method == "off" and "stability" in given)
    said = changed if is_chosen_anew else {**given, **changed}
    without_effect = _without_effect(method)
    idle = [name for name in SETTINGS if name in said and name in without_effect]
    if idle:
        fitting = " or ".join(repr(known) for known in STABILITY_METHODS if set(idle) <= _with_effect(known))
        state = "off" if method == "off" else repr(method)
        raise ProblemError(f"{', '.join(idle)} has no effect while stability is {state}, expected {fitting}")


def _run_settings(
    given: Mapping[str, Any], source: str, sources: Mapping[str, str], output: OutputSettings
) -> RunSettings:
    changes = _fields("motion", given)
    setup: AnalyzeSetup | None = None
    own: dict[str, Any] = {}
    if "setup" in given:
        setup = read_analyze_setup(given["setup"])
        own = {"analysis_name": setup.analysis_name, "exponent": setup.activation_exponent}
    elif "model" not in changes or not changes.keys() & {"coordinates", "states"}:
        raise DataError(f"{source} names no motion, expected setup, or model and coordinates")
    own |= {name: value for name, value in _fields("run", given).items() if name not in _MODEL_SETTINGS}
    own["motion"] = with_changes(setup.motion if setup else None, changes)
    own["stability"] = _stability(given)
    own["emg"] = EmgSettings(**_fields("emg", given))
    own["calibration"] = CalibrationSettings(**_fields("calibration", given))
    return RunSettings(
        **own,
        muscle_model=_muscle_model(given, setup),
        options=SolverOptions(**_fields("options", given)),
        sources=sources,
        notes=_departures(setup, given, output.folder_for(own["motion"].name)) if setup else (),
    )


def _muscle_model(given: Mapping[str, Any], setup: AnalyzeSetup | None) -> str:
    """Choose the muscle model; `muscle_physiology` is the short form for two of them."""
    physiology = given.get("muscle_physiology", setup.use_muscle_physiology if setup else True)
    model = given.get("muscle_model", "opensim-rigid" if physiology else "none")
    if "muscle_physiology" in given and physiology != (model != "none"):
        raise ProblemError(
            f"muscle_model is {model!r} and muscle_physiology is {str(physiology).lower()}, which contradict "
            "each other; leave one of them out"
        )
    return str(model)


def _departures(setup: AnalyzeSetup, given: Mapping[str, Any], folder: Path) -> tuple[str, ...]:
    """Name what a setup says about OpenSim's result files and is done otherwise here; it is logged too."""
    notes = []
    theirs, digits = setup.results_directory, setup.output_precision
    if theirs not in (None, folder.absolute()) and "output" not in given:
        notes.append(f"the setup's results_directory {theirs} is not used: OpenSim's own results there stay")
    if digits != DEFAULT_OUTPUT_PRECISION:
        notes.append(f"the setup's output_precision {digits} is not used: results have all digits")
    for note in notes:
        _LOG.info("%s: %s", given["setup"], note)
    return tuple(notes)


def _stability(given: Mapping[str, Any]) -> StabilityConstraint | None:
    """Make the stability constraint that the settings describe."""
    method = given.get("stability", "off")
    if method == "off":
        return None
    used = _with_effect(method)
    values = _fields("stability", {name: value for name, value in given.items() if name in used})
    law = values.pop("stiffness", "proportional")
    of_law = _fields("stiffness", given)
    if law != "proportional" and "q" in values:
        of_law["q"] = values.pop("q")
    idle = sorted(of_law.keys() - {item.name for item in fields(STIFFNESS_LAWS[law].thing)})
    if idle:
        raise ProblemError(f"{', '.join(idle)} has no effect on {law} stiffness, expected {_laws_with(idle)}")
    if law != "proportional":
        values["stiffness"] = STIFFNESS_LAWS[law].make(**of_law)
    passive = values.get("passive_stiffness")
    if isinstance(passive, Path) and passive.suffix.lower() == ".csv":
        del values["passive_stiffness"]
        values |= _passive_matrix(passive, method, values.get("coordinates"))
    elif isinstance(passive, Path):
        values["passive_stiffness"] = _passive_table(passive)
    constraint: StabilityConstraint = STABILITY_METHODS[method].make(**values)
    return constraint


def _laws_with(names: Iterable[str]) -> str:
    """Name the stiffness laws that have these fields."""
    known = {law: {item.name for item in fields(named.thing)} for law, named in STIFFNESS_LAWS.items()}
    return " or ".join(repr(law) for law, own in known.items() if own.issuperset(names)) or "one of them"


def _passive_table(path: Path) -> dict[str, float]:
    """Read passive stiffness by row, and published stiffness of lumbar joints, from a TOML file."""
    given = read_toml(path)
    try:
        tables = of_type(given.pop("lumbar", []), list[dict[str, int | str | list[str]]])
        stiffness = of_type(given, dict[str, float])
        published = lumbar_passive_stiffness(*(_lumbar_joint(table) for table in tables))
    except DataError as error:
        raise type(error)(f"{path}: {error}") from None
    except (ValueError, TypeError, OverflowError):
        raise DataError(
            f"{path}: expected lines of the form row = number [N.m/rad], and tables [[lumbar]] with levels "
            "= number and, by axial, flexion, extension or lateral, lists of rows"
        ) from None
    twice = sorted(stiffness.keys() & published.keys())
    if twice:
        raise DataError(f"{path}: {', '.join(twice)} stands twice, by itself and in a table [[lumbar]]")
    return stiffness | published


def _lumbar_joint(table: dict[str, Any]) -> LumbarJoint:
    levels = of_type(table.pop("levels", None), int)
    by_direction = {way: [rows] if isinstance(rows, str) else rows for way, rows in table.items()}
    every = [row for rows in by_direction.values() for row in rows]
    twice = [row for row in every if every.count(row) > 1]
    if twice:
        raise DataError(
            f"{twice[0]!r} stands twice in one table [[lumbar]], expected one direction of each row"
        )
    return LumbarJoint(levels=levels, rows={row: way for way, rows in by_direction.items() for row in rows})


def _passive_matrix(path: Path, method: str, chosen: tuple[str, ...] | None) -> dict[str, Any]:
    """Read a matrix of passive stiffness: a first line of coordinates, then one line of numbers each."""
    if method != "full":
        raise ProblemError(f"{path} couples coordinates, which only stability 'full' can use; expected .toml")
    rows = [
        [cell.strip() for cell in line.split(",")] for line in read_text(path).splitlines() if line.strip()
    ]
    names = tuple(rows[0]) if rows else ()
    try:
        matrix = [[number(cell) for cell in row] for row in rows[1:]]
    except ValueError:
        matrix = []
    if not all(names) or [len(names)] * len(names) != [len(row) for row in matrix]:
        raise FileFormatError(
            f"{path}: expected a line of coordinates, then for each of them a line of as many numbers"
        )
    chosen = names if chosen is None else chosen
    try:
        unique_names("coordinate", names)
        return {"coordinates": chosen, "passive_matrix": passive_matrix(chosen, matrix, names)}
    except DataError as error:
        raise type(error)(f"{path}: {error}") from None
