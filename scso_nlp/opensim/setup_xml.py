"""Setup files of OpenSim's AnalyzeTool, read as OpenSim reads them.

:func:`read_analyze_setup` turns an XML file into a frozen description; no OpenSim process is needed.
Files are untrusted: no entity is expanded. Every path is checked here, before OpenSim starts.
"""

from __future__ import annotations

import logging
import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from scso_nlp.arguments import checked_as
from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.files import absolute, read_bytes
from scso_nlp.needs import HasNeeds, MotionNeeds, needs_of
from scso_nlp.opensim.worker.exchange import LOAD_DATA
from scso_nlp.text import number, shown
from scso_nlp.validation import unique_names

logger = logging.getLogger("scso_nlp")

#: Times that AnalyzeTool takes where the file names none [s].
DEFAULT_INITIAL_TIME, DEFAULT_FINAL_TIME = 0.0, 1.0
#: Output digits where the file names none.
DEFAULT_OUTPUT_PRECISION = 8
#: Elements of models and force sets whose text is one number.
SCALARS = frozenset(
    {
        "mass",
        "max_contraction_velocity",
        "max_control",
        "max_isometric_force",
        "min_control",
        "optimal_fiber_length",
        "optimal_force",
        "pennation_angle_at_optimal",
        "tendon_slack_length",
    }
)
#: Elements of documents older than OpenSim 3 and what they are called now.
OLD_NAMES = {
    "force_set_files": "actuator_set_files",
    "replace_force_set": "replace_actuator_set",
    "use_model_force_set": "use_model_actuator_set",
}


#: C++ names such as ``HuntCrossleyForce::ContactParameters``, which the standard does not allow as tags.
_COLONS = re.compile(rb"(</?\w+)::")
#: Elements nested deeper end OpenSim without a word, and Python itself; models nest about twenty deep.
DEEPEST = 200


@dataclass(frozen=True, kw_only=True)
@checked_as(
    actuators=str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    outside_force_set=str | Iterable[str],
    held_coordinates=str | Iterable[str],
    curvature_coordinates=str | Iterable[str],
    joint_reactions=str | Iterable[str],
    **dict.fromkeys(("model",), str | os.PathLike[str]),
    **dict.fromkeys(("coordinates", "states", "speeds", "external_loads"), str | os.PathLike[str] | None),
)
class MotionInput:
    """What OpenSim needs to know to turn a model and a motion into arrays.

    Attributes
    ----------
    model : Path
        The ``.osim`` file.
    coordinates, states : Path or None
        The motion: coordinates over time, or all states. Exactly one of them.
    speeds : Path or None
        Generalized speeds at the times of `coordinates`; without it the coordinates' spline gives them.
    external_loads : Path or None
        ``ExternalLoads`` XML file.
    actuators : tuple of Path
        Force set files that are added to the model.
    replace_force_set : bool
        Drop the model's own forces first.
    outside_force_set : tuple of str
        Muscles and actuators outside the model's ForceSet that are unknowns too, by name or path; "all" is
        all of them. The others act in their default state, as in OpenSim's static optimization.
    initial_time, final_time : float or None [s]
        Range to analyze; None or infinity is the whole motion. A range that reaches beyond the motion is cut
        to it (logged). As in OpenSim no frame is interpolated: the range starts and ends with the last frame
        at or before each time.
    lowpass_cutoff_frequency : float or None [Hz]
        Low-pass filter of the coordinates, as OpenSim's; None or a negative number is no filter.
    step_interval : int
        Take the frames whose index in the motion is a multiple of it, the first and the last.
    name : str
        Name of the analysis; result files start with it. Empty: the model file's name.
    in_degrees : bool or None
        Unit of the coordinates' angles, where the motion's header is wrong or missing. None: the header, or
        what OpenSim assumes without it (logged).
    speeds_in_degrees : bool or None
        The same for the angular speeds of `speeds`, which have a header of their own.
    held_coordinates : tuple of str
        Coordinates for which the motion needs no column: they stay at zero, with `states` at their default.
    keep_coupled_speeds : bool
        Take the speeds of coupled coordinates from the motion even where they contradict the constraints, as
        OpenSim's static optimization does (logged). False: they follow from the free coordinates.
    muscle_paths : bool
        Read the points of muscle paths, which joint stability and figures of muscles need. Static
        optimization and stability along coordinates need none; without them reading takes less time and
        about half the memory.
    stability_axes : tuple of (str, str)
        Joint and axis letter, e.g. ``("knee_r", "z")``, for which virtual rotations are computed from
        OpenSim's own paths (needed where a path wraps or moves); "all" is every joint that can move.
    curvature_coordinates : tuple of str or "all"
        Free coordinates along which second derivatives of path lengths, loads and passive forces are
        computed; "all" is every free coordinate that some muscle depends on.
    joint_reactions : tuple of str or "all"
        Joints, by name or pattern, whose reactions are computed, affine in tendon forces and controls; "all"
        is every joint, also one that cannot move. They take 48 bytes per frame, joint and muscle or actuator.
    """

    model: Path
    coordinates: Path | None = None
    states: Path | None = None
    speeds: Path | None = None
    external_loads: Path | None = None
    actuators: tuple[Path, ...] = ()
    replace_force_set: bool = False
    outside_force_set: tuple[str, ...] = ()
    initial_time: float | None = None
    final_time: float | None = None
    lowpass_cutoff_frequency: float | None = None
    step_interval: int = 1
    name: str = ""
    in_degrees: bool | None = None
    speeds_in_degrees: bool | None = None
    held_coordinates: tuple[str, ...] = ()
    keep_coupled_speeds: bool = True
    muscle_paths: bool = True
    stability_axes: tuple[tuple[str, str], ...] = ()
    curvature_coordinates: tuple[str, ...] = ()
    joint_reactions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        for name in ("model", "coordinates", "states", "speeds", "external_loads"):
            path = getattr(self, name)
            set_field(self, name, None if path is None else absolute(path))
        if isinstance(self.actuators, (str, os.PathLike)):
            set_field(self, "actuators", (self.actuators,))
        set_field(self, "actuators", tuple(absolute(path) for path in self.actuators))
        lists = ("outside_force_set", "held_coordinates", "curvature_coordinates", "joint_reactions")
        for name in lists:
            names = getattr(self, name)
            set_field(self, name, (names,) if isinstance(names, str) else tuple(names))
        set_field(self, "curvature_coordinates", unique_names("coordinate", self.curvature_coordinates))
        set_field(self, "joint_reactions", unique_names("joint", self.joint_reactions))
        axes = tuple((str(joint), str(axis)) for joint, axis in self.stability_axes)
        wrong = [axis for _, axis in axes if axis not in ("x", "y", "z")]
        if wrong:
            raise DataError(f"stability_axes names the axis {wrong[0]!r}, expected x, y or z")
        set_field(self, "stability_axes", axes)
        if axes and not self.muscle_paths:
            raise DataError("muscle_paths is False, but stability_axes need the points of muscle paths")
        if (self.coordinates is None) == (self.states is None):
            found = "both" if self.states is not None else "neither"
            raise DataError(f"the motion needs either coordinates or states, found {found}")
        if isinstance(self.step_interval, bool) or int(self.step_interval) != self.step_interval:
            raise DataError(f"step_interval is {self.step_interval}, expected a whole number")
        if self.step_interval < 1:
            raise DataError(f"step_interval is {self.step_interval}, expected 1 or more")
        for name in ("initial_time", "final_time", "lowpass_cutoff_frequency"):
            value = getattr(self, name)
            if value is not None and math.isnan(value):
                raise DataError(f"{name} is not a number")
        cutoff = self.lowpass_cutoff_frequency
        if cutoff in (0, math.inf):
            raise DataError(
                f"lowpass_cutoff_frequency is {cutoff:g} Hz, expected a positive number, or a "
                "negative one for no filter"
            )
        for name, whole in (("initial_time", -math.inf), ("final_time", math.inf)):
            if getattr(self, name) == whole:
                set_field(self, name, None)
        if (
            self.initial_time is not None
            and self.final_time is not None
            and self.initial_time > self.final_time
        ):
            raise DataError(
                f"the time range is empty: initial_time {self.initial_time:g} s is after "
                f"final_time {self.final_time:g} s"
            )
        if not self.name:
            set_field(self, "name", self.model.stem)

    @property
    def motion(self) -> Path:
        """The file that holds the motion."""
        path = self.coordinates if self.states is None else self.states
        assert path is not None
        return path

    @property
    def filter_frequency(self) -> float | None:
        """Cutoff frequency of the filter that AnalyzeTool runs [Hz]; it never filters states."""
        cutoff = self.lowpass_cutoff_frequency
        return None if self.states is not None or cutoff is None or cutoff < 0 else cutoff

    def files(self) -> tuple[Path, ...]:
        """Every input file but the data of the external loads, in a fixed order."""
        optional = (self.coordinates, self.states, self.speeds, self.external_loads)
        return (self.model, *(path for path in optional if path is not None), *self.actuators)


@dataclass(frozen=True, kw_only=True)
class AnalyzeSetup:
    """An AnalyzeTool setup file with a StaticOptimization analysis.

    Attributes
    ----------
    motion : MotionInput
        Model, motion, loads and time range.
    name : str
        Name of the tool; result files start with it.
    analysis_name : str
        Name of the analysis, second part of the result files' names.
    results_directory : Path or None
        Where OpenSim would write, absolute; None: not named.
    output_precision : int
        Digits of OpenSim's result files.
    activation_exponent : float
    use_muscle_physiology : bool
        Force-length-velocity in the muscle forces.
    """

    motion: MotionInput
    name: str
    analysis_name: str = "StaticOptimization"
    results_directory: Path | None = None
    output_precision: int = DEFAULT_OUTPUT_PRECISION
    activation_exponent: float = 2.0
    use_muscle_physiology: bool = True


@dataclass(frozen=True, kw_only=True)
class LoadSource:
    """External loads file, checked.

    Attributes
    ----------
    text : str
        The XML of the loads that apply, with `LOAD_DATA` beside it as the data file.
    data : Path
        The data file.
    identifiers : tuple of (str, str)
        Name of the load and start of the three column labels that it uses.
    """

    text: str
    data: Path
    identifiers: tuple[tuple[str, str], ...]


def read_analyze_setup(path: str | os.PathLike[str]) -> AnalyzeSetup:
    """Read an AnalyzeTool setup file.

    Parameters
    ----------
    path : str or path-like
        The XML file; its paths are relative to its folder, with either kind of slash.

    Returns
    -------
    AnalyzeSetup

    Raises
    ------
    FileFormatError
        Not well-formed XML, not an AnalyzeTool setup, or a value that cannot be read.
    DataError
        A file that is missing, or a setting that cannot be honored (named).

    Notes
    -----
    ``start_time`` and ``end_time`` of the analysis have no effect in OpenSim 4.6, so they have none here; a
    range that is narrower than the tool's is logged. ``use_model_force_set`` false replaces muscles by one
    actuator per coordinate, which is inverse dynamics: refused (OpenSim 4.6 itself crashes on it). What only
    matters to forward integration or to OpenSim's own optimizer is left out.
    """
    path = Path(path)
    root = read_xml(path)
    tool = root if root.tag == "AnalyzeTool" else root.find("AnalyzeTool")
    if tool is None:
        inside = ", ".join(child.tag for child in root) if root.tag == "OpenSimDocument" else root.tag
        raise FileFormatError(f"{path} holds {inside or 'nothing'}, expected an AnalyzeTool setup")
    reader = _Reader(path, tool)
    analysis = _Reader(path, _static_optimization(path, tool))
    if not analysis.flag("use_model_force_set", True):
        raise DataError(
            f"{path}: use_model_force_set is false, expected true, because it replaces the muscles by one "
            "actuator per coordinate; set it to true, or use OpenSim's InverseDynamicsTool"
        )
    name = tool.get("name", "").strip() or "AnalyzeTool"
    initial = reader.number("initial_time", DEFAULT_INITIAL_TIME)
    final = reader.number("final_time", DEFAULT_FINAL_TIME)
    start, end = analysis.number("start_time", -math.inf), analysis.number("end_time", math.inf)
    if not reader.text("initial_time") or not reader.text("final_time"):
        logger.info("%s: the range is %g to %g s, as OpenSim takes where none is named", path, initial, final)
    if start > initial or end < final:
        logger.warning(
            "%s: start_time %g and end_time %g of the analysis are ignored, as OpenSim does: "
            "the tool's range from %g to %g s counts",
            path,
            start,
            end,
            initial,
            final,
        )
    if reader.flag("solve_for_equilibrium_for_auxiliary_states", False):
        logger.debug("%s: muscle equilibrium has no influence on static optimization", path)
    model = reader.file("model_file")
    if model is None:
        raise DataError(f"{path}: model_file is empty, expected the path of an .osim file")
    coordinates, states, speeds = (
        reader.file(f"{kind}_file") for kind in ("coordinates", "states", "speeds")
    )
    if coordinates is None and states is None:
        raise DataError(f"{path}: neither coordinates_file nor states_file is given, expected one of them")
    if states is not None and (coordinates is not None or speeds is not None):
        logger.warning("%s: states_file is given, the other motion files are ignored, as OpenSim does", path)
        coordinates = speeds = None
    cutoff = reader.number("lowpass_cutoff_frequency_for_coordinates", -1.0)
    motion = MotionInput(
        model=model,
        coordinates=coordinates,
        states=states,
        speeds=speeds,
        external_loads=reader.file("external_loads_file"),
        actuators=reader.files("force_set_files"),
        replace_force_set=reader.flag("replace_force_set", False),
        initial_time=initial,
        final_time=final,
        lowpass_cutoff_frequency=None if cutoff < 0 else cutoff,
        step_interval=reader.whole_number("step_interval", 1, of=analysis),
        name=name,
    )
    results = reader.text("results_directory")
    return AnalyzeSetup(
        motion=motion,
        name=name,
        analysis_name=analysis.element.get("name", "").strip() or "StaticOptimization",
        results_directory=reader.path(results) if results else None,
        output_precision=reader.whole_number("output_precision", DEFAULT_OUTPUT_PRECISION),
        activation_exponent=analysis.number("activation_exponent", 2.0),
        use_muscle_physiology=analysis.flag("use_muscle_physiology", True),
    )


def read_external_loads(path: Path) -> LoadSource:
    """Read an ExternalLoads file and find its data file.

    Parameters
    ----------
    path : Path
        The XML file; the data file is relative to its folder.

    Returns
    -------
    LoadSource

    Raises
    ------
    FileFormatError
        Not an ExternalLoads file.
    DataError
        No data file, or a load without identifiers.
    """
    root = read_xml(path)
    loads = root if root.tag == "ExternalLoads" else root.find("ExternalLoads")
    if loads is None:
        raise FileFormatError(f"{path} holds {root.tag}, expected ExternalLoads")
    reader = _Reader(path, loads)
    element = loads.find("datafile")
    text = reader.text("datafile")
    if element is None or not text:
        raise DataError(f"{path}: datafile is empty, expected the path of a .mot or .sto file")
    data = reader.path(text)
    if not os.path.isfile(data):
        raise DataError(
            f"{path}: datafile {shown(text)} does not exist (looked for {shown(str(data), 150)[1:-1]})"
        )
    element.text = LOAD_DATA
    identifiers, disabled = [], []
    objects = loads.find("objects")
    for load in list(objects if objects is not None else ()):
        if load.tag != "ExternalForce":
            raise DataError(
                f"{path}: {load.get('name', '')!r} is a {load.tag}, which OpenSim 4 does not read here; "
                "expected ExternalForce"
            )
        own = _Reader(path, load)
        if not own.flag("appliesForce", True) or own.flag("isDisabled", False):
            disabled.append(load)
            continue
        for kind in ("force_identifier", "point_identifier", "torque_identifier"):
            identifier = own.text(kind)
            if identifier and identifier.lower() != "unassigned":
                identifiers.append((load.get("name", ""), identifier))
    if objects is not None:
        for load in disabled:
            objects.remove(load)
    return LoadSource(
        text=ElementTree.tostring(root, encoding="unicode"), data=data, identifiers=tuple(identifiers)
    )


def named_files(path: Path) -> tuple[Path, ...]:
    """Find the data files that a model or force set names: meshes that touch, data of loads.

    Parameters
    ----------
    path : Path

    Returns
    -------
    tuple of Path
        Those that are there; none where the file is not XML, which is said elsewhere.
    """
    try:
        root = read_xml(path)
    except FileFormatError:
        return ()
    reader = _Reader(path, root)
    texts = [element.findtext("filename") for element in root.iter("ContactMesh")]
    texts += [element.text for element in root.iter("datafile")]
    files = (reader.path(text.strip()) for text in texts if text and text.strip())
    return tuple(file for file in files if os.path.isfile(file))


def read_xml(path: Path) -> Element:
    """Parse an XML file without expanding entities.

    Comments are left out first: OpenSim accepts double hyphens in them, the standard does not.

    Raises
    ------
    DataError
        No such file.
    FileFormatError
        Not well-formed, or it declares entities.
    """
    content = _COLONS.sub(rb"\1__", _without_comments(read_bytes(path)))
    try:
        root: Element = ElementTree.fromstring(content)
    except LookupError as error:
        raise FileFormatError(f"{path} cannot be read: {error}; save it in UTF-8") from None
    except DefusedXmlException:
        raise FileFormatError(f"{path} declares XML entities, which are not accepted") from None
    except (ParseError, UnicodeDecodeError, ValueError) as error:
        raise FileFormatError(f"{path} is not well-formed XML: {error}") from None
    if _is_deeper(root, DEEPEST):
        raise FileFormatError(f"{path} has elements nested more than {DEEPEST} deep, expected a few dozen")
    return root


def _without_comments(content: bytes) -> bytes:
    """Take comments out, line ends in them stay; one that does not end is left for the parser to refuse."""
    kept = []
    start = 0
    while (opening := content.find(b"<!--", start)) >= 0:
        end = content.find(b"-->", opening + 4)
        if end < 0:
            break
        kept += [content[start:opening], b"\n" * content.count(b"\n", opening, end)]
        start = end + 3
    return b"".join((*kept, content[start:]))


def _is_deeper(root: Element, levels: int) -> bool:
    """Tell if elements are nested in more levels, the root counted."""
    level = [root]
    while level and levels:
        level = [child for element in level for child in element]
        levels -= 1
    return bool(level)


def check_document(path: Path, kind: str) -> None:
    """Check that a file is an OpenSim document of some kind, before OpenSim reads it.

    OpenSim reads some files that the XML standard does not allow; these are left to OpenSim if they look
    complete. Where a number cannot be read OpenSim takes its default without a word; here it is refused.

    Parameters
    ----------
    path : Path
    kind : str
        The element it must hold, e.g. ``"Model"``.

    Raises
    ------
    DataError
        No such file.
    FileFormatError
        Cut off, not XML at all, entities, something else inside, or a number of a body, muscle or actuator
        that is none.
    """
    try:
        root = read_xml(path)
    except FileFormatError as error:
        tail = read_bytes(path)[-4096:]
        if not isinstance(error.__context__, ParseError) or f"</{kind}>".encode() not in tail:
            raise
        logger.warning("%s, left to OpenSim", error)
        return
    if root.tag != kind and root.find(kind) is None:
        inside = ", ".join(child.tag for child in root) if root.tag == "OpenSimDocument" else root.tag
        raise FileFormatError(f"{path} holds {inside or 'nothing'}, expected {kind}")
    for element in root.iter():
        if element.tag in SCALARS and (text := (element.text or "").strip()):
            _as_number(path, element.tag, text)


def _static_optimization(path: Path, tool: Element) -> Element:
    objects = tool.find("AnalysisSet/objects")
    analyses = list(objects) if objects is not None else []
    ours = [analysis for analysis in analyses if analysis.tag == "StaticOptimization"]
    active = [analysis for analysis in ours if _Reader(path, analysis).flag("on", True)]
    if len(active) > 1:
        raise DataError(f"{path}: {len(active)} StaticOptimization analyses are on, expected one")
    if not active:
        found = ", ".join(analysis.tag for analysis in analyses) or "no analysis"
        state = "StaticOptimization is switched off" if ours else f"found {found}"
        raise DataError(f"{path}: {state}, expected a StaticOptimization analysis that is on")
    others = [
        analysis.tag
        for analysis in analyses
        if analysis.tag != "StaticOptimization" and _Reader(path, analysis).flag("on", True)
    ]
    if others:
        logger.info("%s: other analyses are left out: %s", path, ", ".join(others))
    return active[0]


def _as_number(source: Path, name: str, text: str) -> float:
    try:
        value = number(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise FileFormatError(f"{source}: {name} is {shown(text)}, expected a number")
    return value


class _Reader:
    """Values of one element's children, with OpenSim's defaults and messages that name the file."""

    def __init__(self, source: Path, element: Element) -> None:
        self.source, self.element = source, element

    def text(self, name: str) -> str:
        child = self.element.find(name)
        if child is None and name in OLD_NAMES:
            child = self.element.find(OLD_NAMES[name])
        return "" if child is None or child.text is None else child.text.strip()

    def path(self, text: str) -> Path:
        return _below(self.source.absolute().parent, text)

    def file(self, name: str) -> Path | None:
        text = self.text(name)
        # OpenSim's own word for "none"
        if not text or text.lower() == "unassigned":
            return None
        return self._existing(name, text)

    def files(self, name: str) -> tuple[Path, ...]:
        text = self.text(name)
        if not text or text.lower() == "unassigned":
            return ()
        if os.path.isfile(self.path(text)):
            return (self.path(text),)
        return tuple(self._existing(name, part) for part in text.split())

    def _existing(self, name: str, text: str) -> Path:
        path = self.path(text)
        if not os.path.isfile(path):
            raise DataError(
                f"{self.source}: {name} {shown(text)} does not exist (looked for "
                f"{shown(str(path), 150)[1:-1]})"
            )
        return path

    def flag(self, name: str, default: bool) -> bool:
        text = self.text(name).lower()
        if not text:
            return default
        if text in ("true", "1"):
            return True
        if text in ("false", "0"):
            return False
        raise FileFormatError(f"{self.source}: {name} is {shown(text)}, expected true or false")

    def number(self, name: str, default: float) -> float:
        text = self.text(name)
        return _as_number(self.source, name, text) if text else default

    def whole_number(self, name: str, default: int, of: _Reader | None = None) -> int:
        value = (of or self).number(name, default)
        if not math.isfinite(value) or value != int(value):
            raise FileFormatError(f"{self.source}: {name} is {value:g}, expected a whole number")
        return int(value)


def _below(folder: Path, text: str) -> Path:
    """Join a path as written in a setup file, with slashes of either kind, to a folder."""
    plain = text if os.name == "nt" else text.replace("\\", "/")
    return Path(os.path.normpath(folder / plain))


def prepared_for(motion: MotionInput, terms: Iterable[HasNeeds]) -> MotionInput:
    """Ask for what the terms of a problem need, besides what is asked for already, and for no other paths.

    Parameters
    ----------
    motion : MotionInput
    terms : iterable of terms

    Returns
    -------
    MotionInput
    """
    own = MotionNeeds(
        stability_axes=motion.stability_axes,
        curvature_coordinates=motion.curvature_coordinates,
        joint_reactions=motion.joint_reactions,
    )
    needs = own | needs_of(terms)
    return replace(
        motion,
        muscle_paths=needs.muscle_paths or bool(needs.stability_axes),
        stability_axes=needs.stability_axes,
        curvature_coordinates=needs.curvature_coordinates,
        joint_reactions=needs.joint_reactions,
    )


def with_changes(motion: MotionInput | None, changes: dict[str, Any]) -> MotionInput:
    """Replace fields of a motion input; a new kind of motion file replaces the other.

    Parameters
    ----------
    motion : MotionInput or None
        Without it `changes` must hold `model` and a motion.
    changes : dict
        New values by field name.

    Returns
    -------
    MotionInput

    Raises
    ------
    DataError
        No model.
    """
    if motion is None:
        if "model" not in changes:
            raise DataError("load_motion needs a setup file, or at least model and coordinates")
        return MotionInput(**changes)
    if changes.get("coordinates") is not None and "states" not in changes:
        changes = {**changes, "states": None}
    if changes.get("states") is not None and "coordinates" not in changes:
        changes = {**changes, "coordinates": None, "speeds": changes.get("speeds")}
    return replace(motion, **changes)
