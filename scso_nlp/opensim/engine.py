"""A model and a motion in, frozen arrays out: by OpenSim, or from a cache of what it said before.

OpenSim and CasADi cannot live in one process: OpenSim runs in worker processes
(:mod:`scso_nlp.opensim.crew`), and this one imports neither.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, EngineError
from scso_nlp.files import absolute, hashes, make_folder, refuse_changed, require_file
from scso_nlp.io.bundle import Provenance, load_bundle, save_bundle
from scso_nlp.io.storage import Storage
from scso_nlp.messages import STAGES
from scso_nlp.motion import Motion
from scso_nlp.needs import HasNeeds
from scso_nlp.opensim import crew
from scso_nlp.opensim.assemble import assemble
from scso_nlp.opensim.checks import CheckedInput, check_input
from scso_nlp.opensim.preparation import loads_at, prepare_motion, prepare_speeds
from scso_nlp.opensim.setup_xml import (
    AnalyzeSetup,
    MotionInput,
    named_files,
    prepared_for,
    read_analyze_setup,
    read_external_loads,
    with_changes,
)
from scso_nlp.opensim.worker.exchange import Job
from scso_nlp.progress import stages_shown
from scso_nlp.versions import version_of

logger = logging.getLogger("scso_nlp")

#: What decides what the arrays are, given input and versions: a file and a package.
PREPARATION, DESCRIPTION, WORKER = (
    Path(__file__).with_name(name) for name in ("preparation.py", "description.py", "worker")
)
#: Settings that tell the unit of a file against its header.
TOLD_UNITS = ("in_degrees", "speeds_in_degrees")


@checked
def load_motion(
    setup: str | os.PathLike[str] | AnalyzeSetup | MotionInput | None = None,
    *,
    prepare_for: Iterable[HasNeeds] | None = None,
    model: str | os.PathLike[str] | None = None,
    coordinates: str | os.PathLike[str] | None = None,
    states: str | os.PathLike[str] | None = None,
    speeds: str | os.PathLike[str] | None = None,
    external_loads: str | os.PathLike[str] | None = None,
    actuators: str | os.PathLike[str] | Iterable[str | os.PathLike[str]] | None = None,
    replace_force_set: bool | None = None,
    outside_force_set: str | Iterable[str] | None = None,
    initial_time: float | None = None,
    final_time: float | None = None,
    lowpass_cutoff_frequency: float | None = None,
    step_interval: int | None = None,
    name: str | None = None,
    in_degrees: bool | None = None,
    speeds_in_degrees: bool | None = None,
    held_coordinates: str | Iterable[str] | None = None,
    keep_coupled_speeds: bool | None = None,
    muscle_paths: bool | None = None,
    stability_axes: Iterable[tuple[str, str]] | None = None,
    curvature_coordinates: str | Iterable[str] | None = None,
    joint_reactions: str | Iterable[str] | None = None,
    processes: int | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> Motion:
    """Let OpenSim turn a model and a motion into arrays.

    Parameters
    ----------
    setup : path, AnalyzeSetup or MotionInput, optional
        An AnalyzeTool setup file, or a description. Without it `model` and `coordinates` (or `states`) must
        be given. Of all that follows up to `joint_reactions`, None is what the setup says, or
        :class:`MotionInput`'s default.
    prepare_for : terms, optional
        Stability constraints and other terms of the problem to come, which know what must be computed of a
        motion for them; ``()`` is plain static optimization. By default points of muscle paths are read, and
        nothing is computed that takes time.
    model, coordinates, states, speeds, external_loads : path, optional
        The ``.osim`` file; coordinates over time or, instead, all states; generalized speeds; the
        ``ExternalLoads`` file.
    actuators : path or several, optional
        Force set files that are added to the model.
    replace_force_set : bool, optional
        Drop the model's own forces first.
    outside_force_set : name or several, optional
        Muscles and actuators outside the model's ForceSet that are unknowns too; "all" is all of them.
    initial_time, final_time : float, optional [s]
        Range to analyze; minus infinity and infinity are the motion's own.
    lowpass_cutoff_frequency : float, optional [Hz]
        Low-pass filter of the coordinates; a negative number is no filter.
    step_interval : int, optional
        Take every so many frames.
    name : str, optional
        Of the analysis; result files start with it.
    in_degrees, speeds_in_degrees : bool, optional
        Unit of angles in the motion, and in `speeds`, where their headers are wrong or missing.
    held_coordinates : name or several, optional
        Coordinates that stay at zero because the motion has no column for them.
    keep_coupled_speeds : bool, optional
        Take speeds of coupled coordinates from the motion even where they contradict the constraints.
    muscle_paths, stability_axes, curvature_coordinates, joint_reactions : optional
        Arrays to look at without a term that needs them; what a problem needs, `prepare_for` asks for. As
        fields of :class:`MotionInput`.
    processes : int, optional
        Worker processes; by default one per core this process may use, fewer for short motions. The
        answer does not depend on it.
    cache : path, optional
        Folder of bundles by content: with the same input files, settings and versions the arrays are read
        from there, without OpenSim; else they are stored there.
    progress : bool, optional
        Show how far it is when it takes more than a second; by default in a terminal or a notebook.

    Returns
    -------
    Motion

    Raises
    ------
    DataError
        Input that cannot be used: a missing file or column, NaN, a time range beside the motion, a unit that
        is proven wrong.
    EngineError
        OpenSim refused the input, or a worker process died.

    Notes
    -----
    Coordinates, speeds and accelerations are those of OpenSim's static optimization. Where coordinates
    depend on others (couplers, closed loops), their values and accelerations follow from the constraints; so
    do their speeds with ``keep_coupled_speeds=False``. Where a model with a ConstraintSet clamps a coordinate
    to a range that the motion leaves, values are those of OpenSim's own assembly (logged); speeds stay.

    Examples
    --------
    >>> part = scso.load_motion(example_folder("elbow") / "setup.xml", final_time=2.0, prepare_for=())
    >>> part.n_frames, part.muscles.muscles
    (3, ('brachioradialis', 'biceps', 'brachialis'))
    """
    given = locals()
    changes = {
        field.name: given[field.name]
        for field in dataclasses.fields(MotionInput)
        if given[field.name] is not None
    }
    if isinstance(setup, (str, os.PathLike)):
        setup = read_analyze_setup(setup)
    motion = with_changes(setup.motion if isinstance(setup, AnalyzeSetup) else setup, changes)
    if prepare_for is not None:
        motion = prepared_for(motion, prepare_for)
        if muscle_paths is not None:
            motion = dataclasses.replace(motion, muscle_paths=muscle_paths)
    return load_with_hashes(motion, processes=processes, cache=cache, progress=progress)[0]


def load_with_hashes(
    motion: MotionInput,
    *,
    processes: int | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> tuple[Motion, dict[str, str]]:
    """Do what :func:`load_motion` does, and tell which files it has read.

    Parameters
    ----------
    motion : MotionInput
    processes, cache, progress
        As for :func:`load_motion`.

    Returns
    -------
    Motion, dict of str to str
        The SHA-256 of every input file, by path, as it was when it was read: a file that changes meanwhile is
        refused. What happens to it later does no harm.

    Raises
    ------
    DataError, EngineError
        As for :func:`load_motion`.
    """
    if processes is not None and processes < 1:
        raise DataError(f"processes is {processes}, expected 1 or more")
    inputs = hashes(input_files(motion))
    checked = check_input(motion)
    refuse_changed(inputs)
    if cache is None:
        return _extract(checked, inputs, processes, progress), inputs
    folder = absolute(cache)
    provenance = _provenance(checked, inputs)
    bundle = folder / f"{_file_name(motion.name)}-{_key(provenance)[:16]}.npz"
    if os.path.isfile(bundle):
        try:
            result = load_bundle(bundle)
            logger.info("read %s: OpenSim not needed", bundle)
            return result, inputs
        except DataError as error:
            logger.warning("the cached motion is computed again: %s", error)
    make_folder(folder)
    result = _extract(checked, inputs, processes, progress)
    try:
        save_bundle(bundle, result, provenance=provenance)
    except DataError as error:
        logger.warning("the motion is not cached: %s", error)
    return result, inputs


def _extract(
    checked: CheckedInput, inputs: Mapping[str, str], processes: int | None, progress: bool | None
) -> Motion:
    opensim_version()
    n_workers = crew.number_of_workers(checked.n_frames, processes)
    job = _job(checked, inputs)
    with stages_shown(progress):
        STAGES.info("reading %s", checked.motion.model.name)
        found = crew.extract(job, n_workers, _loads(checked, job))
    return assemble(checked.motion, found)


def _job(checked: CheckedInput, inputs: Mapping[str, str]) -> Job:
    source = checked.motion
    motion, rows = prepare_motion(source, checked.table)
    load_data = None if checked.loads is None else checked.loads.data
    read_here = {str(path) for path in (source.motion, source.speeds, source.external_loads, load_data)}
    return Job(
        inputs={path: digest for path, digest in inputs.items() if path not in read_here},
        settings=_settings(checked),
        motion=motion,
        recorded=None if source.filter_frequency is None else np.c_[checked.table.time, checked.table.values],
        rows=rows,
        unusable=checked.unusable,
        speeds=None if checked.speeds is None else prepare_speeds(checked.speeds, motion, rows),
    )


def _loads(checked: CheckedInput, job: Job) -> tuple[str, Storage] | None:
    """Return the XML of the external loads and their values at the rows to analyze."""
    if checked.loads is None or checked.load_data is None or not checked.loads.identifiers:
        return None
    return checked.loads.text, loads_at(checked.load_data, job.motion.time[job.rows])


def _settings(checked: CheckedInput) -> dict[str, Any]:
    """Return the fields of the motion input as JSON values."""
    motion = checked.motion
    settings = dataclasses.asdict(motion) | {
        "in_degrees": checked.in_degrees,
        "speeds_in_degrees": checked.speeds_in_degrees,
        "told_units": [name for name in TOLD_UNITS if getattr(motion, name) is not None],
    }
    plain: dict[str, Any] = json.loads(json.dumps(settings, default=str))
    return plain


def opensim_version() -> str:
    """Return the version of the installed OpenSim package, without importing it.

    Raises
    ------
    EngineError
        It is not installed.
    """
    if (version := version_of("opensim")) is None:
        raise EngineError(
            "OpenSim is not installed in this environment: pip install opensim (Python 3.11 to 3.13 on "
            "Linux x86-64 or Windows), or solve from a bundle"
        )
    return version


def _provenance(checked: CheckedInput, inputs: Mapping[str, str]) -> Provenance:
    return Provenance(
        package_version=version_of("scso_nlp") or "",
        opensim_version=opensim_version(),
        inputs=inputs,
        settings=_settings(checked),
    )


def input_files(motion: MotionInput) -> list[Path]:
    """List every input file, with those that the files themselves name.

    Raises
    ------
    DataError
        One that is missing.
    """
    paths = list(motion.files())
    for path in paths:
        require_file(path)
    if motion.external_loads is not None:
        paths.append(read_external_loads(motion.external_loads).data)
    for path in (motion.model, *motion.actuators):
        paths += named_files(path)
    return paths


def _key(provenance: Provenance) -> str:
    """Content address: hashes and settings but not the places of the files."""
    settings = {
        name: value
        for name, value in provenance.settings.items()
        if name not in ("model", "coordinates", "states", "speeds", "external_loads", "actuators")
    }
    content = {
        "inputs": [digest for digest in provenance.inputs.values()],
        "roles": [
            bool(provenance.settings[name])
            for name in ("coordinates", "states", "speeds", "external_loads", "actuators")
        ],
        "settings": settings,
        "opensim": provenance.opensim_version,
        "package": provenance.package_version,
        "worker": _worker_digest(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _worker_digest() -> str:
    """Hash every file that decides, in order, names included."""
    digest = hashlib.sha256()
    for path in (PREPARATION, DESCRIPTION, *sorted(WORKER.glob("*.py"))):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _file_name(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name) or "motion"
