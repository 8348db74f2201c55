"""Starts OpenSim in processes of its own and reads the arrays back.

OpenSim and CasADi cannot live in one process, and OpenSim never releases Python's lock: so every core gets
one worker process (:mod:`scso_nlp.opensim.worker`), the frames are split among them, and this process imports
neither. Everything that can be said about the input without OpenSim is checked here first.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import logging
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from tqdm import tqdm

from scso_nlp import exceptions
from scso_nlp.exceptions import DataError, EngineError, NameMismatchError, ScsoError
from scso_nlp.io.bundle import Provenance, load_bundle, save_bundle
from scso_nlp.io.storage import Storage, read_storage
from scso_nlp.motion import Motion
from scso_nlp.muscles import ActuatorParameters, MuscleParameters
from scso_nlp.opensim.setup_xml import (
    AnalyzeSetup,
    LoadSource,
    MotionInput,
    check_document,
    read_analyze_setup,
    read_external_loads,
    with_changes,
)
from scso_nlp.trajectory import CoordinateCurvature, MotionTrajectory, Skeleton

logger = logging.getLogger("scso_nlp")

#: The script that imports OpenSim.
WORKER = Path(__file__).with_name("worker.py")
#: A bar appears only when the extraction lasts longer [s].
PROGRESS_DELAY = 2.0
#: Fewer frames than this per worker are not worth another process.
MIN_FRAMES_PER_WORKER = 4
#: How long a worker may take to end after it was asked to [s].
PATIENCE = 5.0
#: Speeds of coupled coordinates that contradict the constraints by more are reported [rad/s or m/s].
CONTRADICTION = 0.05
#: Lines of OpenSim's log that an error message quotes.
QUOTED_LINES = 3


def load_motion(
    setup: str | os.PathLike[str] | AnalyzeSetup | MotionInput | None = None,
    *,
    processes: int | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
    **changes: Any,
) -> Motion:
    """Let OpenSim turn a model and a motion into arrays.

    Parameters
    ----------
    setup : path, AnalyzeSetup or MotionInput, optional
        An AnalyzeTool setup file, or a description. Without it `changes` must hold `model` and
        `coordinates` (or `states`).
    processes : int, optional
        Worker processes; by default one per core this process may use, fewer for short motions. The
        answer does not depend on it.
    cache : path, optional
        Folder of bundles by content: with the same input files, settings and versions the arrays are read
        from there, without OpenSim; else they are stored there.
    progress : bool, optional
        Show a progress bar when it takes more than two seconds; by default only on a terminal.
    **changes
        Fields of :class:`MotionInput` that replace those of `setup`, e.g. ``final_time=0.8``.

    Returns
    -------
    Motion

    Raises
    ------
    DataError
        Input that cannot be used: a missing file or column, NaN, a time range outside the motion.
    EngineError
        OpenSim refused the input, or a worker process died.

    Notes
    -----
    Coordinates, speeds and accelerations are those of OpenSim's static optimization. Where coordinates
    depend on others (couplers, closed loops), their values and accelerations follow from the constraints; so
    do their speeds with ``keep_coupled_speeds=False``.
    """
    if isinstance(setup, (str, os.PathLike)):
        setup = read_analyze_setup(setup)
    motion = setup.motion if isinstance(setup, AnalyzeSetup) else setup
    motion = with_changes(motion, changes)
    if processes is not None and processes < 1:
        raise DataError(f"processes is {processes}, expected 1 or more")
    checked = _check(motion)
    if cache is None:
        return _extract(checked, processes, progress)
    folder = Path(cache)
    provenance = _provenance(checked)
    bundle = folder / f"{_file_name(motion.name)}-{_key(provenance)[:16]}.npz"
    if bundle.is_file():
        try:
            result = load_bundle(bundle)
            logger.info("read %s: OpenSim not needed", bundle)
            return result
        except DataError as error:
            logger.warning("the cached motion is computed again: %s", error)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"the cache folder {folder} cannot be made: {error.strerror or error}") from None
    result = _extract(checked, processes, progress)
    save_bundle(bundle, result, provenance=provenance)
    return result


# ------------------------------------------------------------------------------------------- before OpenSim


@dataclass(frozen=True, kw_only=True)
class _Checked:
    """A motion input whose files were read and found usable."""

    motion: MotionInput
    table: Storage
    in_degrees: bool
    unusable: Mapping[str, str]
    speeds: Storage | None
    loads: LoadSource | None
    hashes: Mapping[str, str] = field(default_factory=dict)


def _check(motion: MotionInput) -> _Checked:
    for path in motion.files():
        if not path.is_file():
            raise DataError(f"{path} does not exist" if not path.exists() else f"{path} is not a file")
    check_document(motion.model, "Model")
    for path in motion.actuators:
        check_document(path, "ForceSet")
    table = read_storage(motion.motion)
    in_degrees = motion.in_degrees
    if motion.states is not None:
        if table.in_degrees and in_degrees is None:
            raise DataError(f"{motion.motion} is in degrees, but OpenSim reads states in radians")
        in_degrees = bool(in_degrees)
    elif in_degrees is None:
        in_degrees = table.assumed_in_degrees
        if table.in_degrees is None:
            unit = "degrees" if in_degrees else "radians"
            logger.info(
                "%s: inDegrees is missing, %s as OpenSim does (in_degrees overrides)", motion.motion, unit
            )
    elif table.in_degrees is not None and table.in_degrees != in_degrees:
        unit = "degrees" if in_degrees else "radians"
        logger.warning("%s: read in %s, although its header says otherwise", motion.motion, unit)
    _check_range(motion, table)
    unusable = {}
    finite = np.isfinite(table.values)
    for column in np.flatnonzero(~finite.all(axis=0)):
        row = int(np.flatnonzero(~finite[:, column])[0])
        unusable[table.labels[column]] = f"{table.values[row, column]} at t = {table.time[row]:.9g} s"
    speeds = None
    if motion.speeds is not None:
        speeds = read_storage(motion.speeds).require_finite()
    loads = None
    if motion.external_loads is not None:
        loads = read_external_loads(motion.external_loads)
        _check_loads(motion, loads, table)
    return _Checked(
        motion=motion, table=table, in_degrees=in_degrees, unusable=unusable, speeds=speeds, loads=loads
    )


def _check_range(motion: MotionInput, table: Storage) -> None:
    first, last = float(table.time[0]), float(table.time[-1])
    # OpenSim takes the frame before; half a step of slack lets rounded ends of setup files pass
    slack = 0.5 * (last - first) / max(table.n_frames - 1, 1)
    initial = first if motion.initial_time is None else motion.initial_time
    final = last if motion.final_time is None else motion.final_time
    if initial < first - slack or final > last + slack:
        raise DataError(
            f"the time range {initial:.9g} to {final:.9g} s is outside {motion.motion}, which covers "
            f"{first:.9g} to {last:.9g} s"
        )
    if table.n_frames < 6:
        raise DataError(
            f"{motion.motion} has {table.n_frames} frames, expected at least 6 for the quintic spline that "
            "gives speeds and accelerations"
        )


def _check_loads(motion: MotionInput, loads: LoadSource, table: Storage) -> None:
    data = read_storage(loads.data)
    for load, identifier in loads.identifiers:
        columns = [i for i, label in enumerate(data.labels) if label.startswith(identifier)]
        if len(columns) != 3:
            found = ", ".join(data.labels[i] for i in columns) or "none"
            raise NameMismatchError(
                f"{loads.data}: the load {load!r} needs three columns that start with {identifier!r}, "
                f"found {found}"
            )
        values = data.values[:, columns]
        if not np.isfinite(values).all():
            row, which = (int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise DataError(
                f"{loads.data}: column {data.labels[columns[which]]!r} is {values[row, which]} at "
                f"t = {data.time[row]:.9g} s, expected a finite number (load {load!r})"
            )
    first = max(float(table.time[0]), motion.initial_time if motion.initial_time is not None else -np.inf)
    last = min(float(table.time[-1]), motion.final_time if motion.final_time is not None else np.inf)
    slack = float(np.diff(table.time).max())
    if loads.identifiers and (data.time[0] > first + slack or data.time[-1] < last - slack):
        raise DataError(
            f"{loads.data} covers {data.time[0]:.9g} to {data.time[-1]:.9g} s, expected the analyzed range "
            f"{first:.9g} to {last:.9g} s"
        )


# ---------------------------------------------------------------------------------------------- provenance


def opensim_version() -> str:
    """Return the version of the installed OpenSim package, without importing it.

    Raises
    ------
    EngineError
        It is not installed.
    """
    try:
        return importlib.metadata.version("opensim")
    except importlib.metadata.PackageNotFoundError:
        raise EngineError(
            "OpenSim is not installed in this environment: pip install opensim (Python 3.11 to 3.13 on "
            "Linux x86-64 or Windows), or solve from a bundle"
        ) from None


def _provenance(checked: _Checked) -> Provenance:
    settings = dataclasses.asdict(checked.motion) | {"in_degrees": checked.in_degrees}
    return Provenance(
        package_version=_package_version(),
        opensim_version=opensim_version(),
        inputs=input_hashes(checked.motion),
        settings=json.loads(json.dumps(settings, default=str)),
    )


def input_hashes(motion: MotionInput) -> dict[str, str]:
    """Return the SHA-256 of every input file, by path.

    Parameters
    ----------
    motion : MotionInput

    Returns
    -------
    dict of str to str
        The data file of the external loads is included.
    """
    paths = list(motion.files())
    if motion.external_loads is not None:
        paths.append(read_external_loads(motion.external_loads).data)
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def _package_version() -> str:
    try:
        return importlib.metadata.version("scso_nlp")
    except importlib.metadata.PackageNotFoundError:
        return ""


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
        "worker": hashlib.sha256(WORKER.read_bytes()).hexdigest(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _file_name(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name) or "motion"


# ------------------------------------------------------------------------------------------------- workers


def _extract(checked: _Checked, processes: int | None, progress: bool | None) -> Motion:
    opensim_version()
    n_workers = _number_of_workers(checked, processes)
    with tempfile.TemporaryDirectory(prefix="scso_") as folder:
        jobs = _write_jobs(checked, Path(folder), n_workers)
        results = _Crew(jobs, progress).work()
    return _assemble(checked.motion, results)


def _number_of_workers(checked: _Checked, processes: int | None) -> int:
    time, motion = checked.table.time, checked.motion
    inside = np.ones(len(time), dtype=bool)
    if motion.initial_time is not None:
        inside &= time >= motion.initial_time
    if motion.final_time is not None:
        inside &= time <= motion.final_time
    frames = int(inside.sum()) // motion.step_interval
    if processes is not None:
        return max(min(processes, frames), 1)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(min(cores, frames // MIN_FRAMES_PER_WORKER), 1)


def _write_jobs(checked: _Checked, folder: Path, n_workers: int) -> list[Path]:
    motion = json.loads(json.dumps(dataclasses.asdict(checked.motion), default=str))
    motion["in_degrees"] = checked.in_degrees
    if checked.loads is not None:
        loads = folder / "external_loads.xml"
        loads.write_text(checked.loads.text, encoding="utf-8")
        motion["external_loads"] = str(loads)
    data: dict[str, Any] = {
        "labels": _as_bytes(checked.table.labels),
        "time": checked.table.time,
        "values": checked.table.values,
        "unusable": _as_bytes(dict(checked.unusable)),
    }
    if checked.speeds is not None:
        data |= {
            "speed_labels": _as_bytes(checked.speeds.labels),
            "speed_time": checked.speeds.time,
            "speed_values": checked.speeds.values,
        }
    np.savez(folder / "motion.npz", **data)
    jobs = []
    for part in range(n_workers):
        job = {
            "motion": motion,
            "data": str(folder / "motion.npz"),
            "part": part,
            "parts": n_workers,
            "output": str(folder / f"frames_{part}.npz"),
            "log": str(folder / f"log_{part}.txt"),
        }
        path = folder / f"job_{part}.json"
        path.write_text(json.dumps(job), encoding="utf-8")
        jobs.append(path)
    return jobs


def _as_bytes(value: object) -> np.ndarray:
    return np.frombuffer(json.dumps(value).encode("utf-8"), dtype=np.uint8)


def worker_environment() -> dict[str, str]:
    """Return this process's environment without what would make OpenSim load foreign libraries.

    ``import opensim`` puts its own folder into ``LD_LIBRARY_PATH``, and both OpenSim and CasADi carry a
    library of the same name. Folders that hold one are dropped; all else stays.

    Returns
    -------
    dict of str to str
        A copy; ``os.environ`` is not changed.
    """
    environment = dict(os.environ)
    folders = environment.pop("LD_LIBRARY_PATH", "").split(os.pathsep)
    kept = [folder for folder in folders if folder and not any(Path(folder).glob("libcasadi*"))]
    if kept:
        environment["LD_LIBRARY_PATH"] = os.pathsep.join(kept)
    environment |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"}
    return environment


class _Crew:
    """The worker processes of one extraction: started together, ended together."""

    def __init__(self, jobs: list[Path], progress: bool | None) -> None:
        self.jobs = [json.loads(job.read_text(encoding="utf-8")) for job in jobs]
        self.paths = jobs
        self.progress = sys.stderr.isatty() if progress is None else progress
        self.frames = [0] * len(jobs)
        self.shares = [0] * len(jobs)
        self.total = 0
        self.messages: queue.SimpleQueue[tuple[int, dict[str, Any] | None]] = queue.SimpleQueue()

    def work(self) -> list[dict[str, np.ndarray]]:
        """Run all workers to their end; whatever goes wrong, none is left behind."""
        crew: list[subprocess.Popen[str]] = []
        readers: list[threading.Thread] = []
        try:
            for part, path in enumerate(self.paths):
                crew.append(_start(path))
                reader = threading.Thread(target=self._listen, args=(part, crew[part].stdout), daemon=True)
                reader.start()
                readers.append(reader)
            self._wait(crew)
        finally:
            for process in crew:
                _end(process)
            for reader in readers:
                reader.join(PATIENCE)
            for process in crew:
                if process.stdout is not None:
                    process.stdout.close()
            self._pass_log_on()
        results = []
        for job in self.jobs:
            with np.load(job["output"], allow_pickle=False) as content:
                results.append({name: content[name] for name in content.files})
        return [result for result in results if result]

    def _listen(self, part: int, stream: IO[str] | None) -> None:
        assert stream is not None
        for line in stream:
            try:
                message = json.loads(line)
            except ValueError:
                logger.debug("worker %d: %s", part, line.rstrip())
                continue
            self.messages.put((part, message))
        self.messages.put((part, None))

    def _wait(self, crew: list[subprocess.Popen[str]]) -> None:
        running = set(range(len(crew)))
        finished: set[int] = set()
        with tqdm(
            desc="OpenSim", unit="frame", delay=PROGRESS_DELAY, disable=not self.progress, leave=False
        ) as bar:
            while running:
                part, message = self.messages.get()
                if message is None:
                    running.discard(part)
                    if part not in finished:
                        raise self._death(part, crew[part])
                elif "error" in message:
                    raise _refusal(message["error"], message["message"])
                elif "total" in message:
                    self.total, self.shares[part] = message["total"], message["share"]
                    bar.total = self.total
                elif "frames" in message:
                    bar.update(message["frames"] - self.frames[part])
                    self.frames[part] = message["frames"]
                elif message.get("done"):
                    finished.add(part)

    def _death(self, part: int, process: subprocess.Popen[str]) -> EngineError:
        try:
            code = process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            code = 0
        how = f"ended with code {code}"
        if code < 0:
            try:
                how = f"was ended by {signal.Signals(-code).name} (signal {-code})"
            except ValueError:
                how = f"was ended by signal {-code}"
        where = f"after {self.frames[part]} of its {self.shares[part]} frames"
        if not self.shares[part]:
            where = "before its first frame"
        last = self._last_lines(part)
        said = f"; its last message: {last}" if last else ""
        return EngineError(
            f"OpenSim worker {part + 1} of {len(self.jobs)} {how} {where}; nothing was kept{said}"
        )

    def _last_lines(self, part: int) -> str:
        lines = [line.strip() for line in self._log(part) if line.strip()]
        useful = [line for line in lines if not line.startswith(("[info]", "[warning] Couldn't find file"))]
        return " / ".join((useful or lines)[-QUOTED_LINES:])

    def _log(self, part: int) -> list[str]:
        try:
            return Path(self.jobs[part]["log"]).read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return []

    def _pass_log_on(self) -> None:
        if not logger.isEnabledFor(logging.DEBUG):
            return
        seen: set[str] = set()
        for part in range(len(self.jobs)):
            for line in self._log(part):
                if line.startswith(("[warning]", "[error]")) and line not in seen:
                    seen.add(line)
                    logger.debug("OpenSim: %s", line)


def _start(job: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-P", str(WORKER), str(job)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=worker_environment(),
        encoding="utf-8",
        errors="replace",
        cwd=job.parent,
    )


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _refusal(kind: str, message: str) -> ScsoError:
    error = getattr(exceptions, kind, EngineError)
    if not (isinstance(error, type) and issubclass(error, ScsoError)):
        error = EngineError
    return error(message)


# ------------------------------------------------------------------------------------------------- results

#: Arrays of a worker that belong to the skeleton.
_SKELETON_ARRAYS = (
    "body_mass_centers",
    "joint_centers",
    "joint_axes",
    "load_forces",
    "load_points",
    "load_torques",
    "path_points",
    "path_point_bodies",
    "path_point_moves",
)
#: Arrays of a worker that belong to the curvature along coordinates.
_CURVATURE_ARRAYS = ("path_curvature", "load_stiffness", "passive_stiffness", "asymmetry", "is_uncertain")
#: At most this many muscles are named in one message.
NAMED_MUSCLES = 8
_POINT_ARRAYS = {"path_points": 0.0, "path_point_bodies": -1, "path_point_moves": False}


def _assemble(motion: MotionInput, results: list[dict[str, np.ndarray]]) -> Motion:
    headers = [json.loads(result.pop("header").tobytes().decode("utf-8")) for result in results]
    header = headers[0]
    for level, note in header["notes"]:
        logger.log(logging.getLevelNamesMapping()[level], "%s", note)
    _report_contradictions(motion, headers)
    _report_uncertainty(motion, headers)
    for part, own in enumerate(headers):
        seconds = own["seconds"]
        logger.debug(
            "worker %d: startup %.2f s, %d frames in %.2f s, peak memory %.0f MB",
            part,
            seconds["startup"],
            len(results[part]["time"]),
            seconds["frames"],
            own["peak_memory"] / 1e6,
        )
    n_points = max(result["path_point_bodies"].shape[2] for result in results)
    # taken out one by one, so that no array is in memory more often than needed
    arrays: dict[str, Any] = {
        name: np.concatenate([_padded(name, result.pop(name), n_points) for result in results])
        for name in list(results[0])
    }
    skeleton_arrays = {name: arrays.pop(name) for name in _SKELETON_ARRAYS}
    if header["virtual_rows"]:
        for name in ("virtual_moment_arms", "virtual_curvature"):
            skeleton_arrays[name] = arrays.pop(name)
    skeleton = Skeleton(
        bodies=tuple(header["bodies"]),
        body_parents=np.array(header["body_parents"], dtype=np.int64),
        body_masses=np.array(header["body_masses"]),
        gravity=np.array(header["gravity"]),
        joints=tuple(header["joints"]),
        joint_children=np.array(header["joint_children"], dtype=np.int64),
        load_names=tuple(header["load_names"]),
        load_bodies=np.array(header["load_bodies"], dtype=np.int64),
        virtual_rows=tuple(header["virtual_rows"]),
        **skeleton_arrays,
    )
    curvature = None
    if header["curvature_coordinates"]:
        curvature = CoordinateCurvature(
            coordinates=tuple(header["curvature_coordinates"]),
            **{name: arrays.pop(name) for name in _CURVATURE_ARRAYS},
        )
    muscle_names, actuator_names = tuple(header["muscles"]), tuple(header["actuators"])
    trajectory = MotionTrajectory(
        name=motion.name,
        muscles=muscle_names,
        actuators=actuator_names,
        coordinates=tuple(header["coordinates"]),
        is_rotational=np.array(header["is_rotational"], dtype=bool),
        force_columns=tuple(header["force_columns"]),
        other_force_labels=tuple(header["other_force_labels"]),
        skeleton=skeleton,
        curvature=curvature,
        **arrays,
    )
    parameters = header["muscle_parameters"]
    muscles = MuscleParameters(
        muscles=muscle_names,
        muscle_class=tuple(parameters.pop("muscle_class")),
        curve_parameters=tuple(parameters.pop("curve_parameters")),
        **{name: np.array(values) for name, values in parameters.items()},
    )
    actuators = ActuatorParameters(
        actuators=actuator_names,
        **{name: np.array(values, dtype=float) for name, values in header["actuator_parameters"].items()},
    )
    return Motion(trajectory=trajectory, muscles=muscles, actuators=actuators)


def _report_contradictions(motion: MotionInput, headers: list[dict[str, Any]]) -> None:
    worst: dict[str, float] = {}
    for header in headers:
        for name, change in header["contradicted_speeds"].items():
            worst[name] = max(worst.get(name, 0.0), change)
    large = {name: change for name, change in worst.items() if change > CONTRADICTION}
    if large:
        named = ", ".join(f"{name} by up to {change:.3g}" for name, change in large.items())
        taken = (
            "OpenSim uses them and so do we; set keep_coupled_speeds=false to take them from the constraints"
        )
        if not motion.keep_coupled_speeds:
            taken = "as asked, they were taken from the constraints, which OpenSim does not do"
        logger.warning(
            "%s: the speeds of coupled coordinates contradict the model's constraints (%s rad/s or m/s): %s",
            motion.motion,
            named,
            taken,
        )


def _report_uncertainty(motion: MotionInput, headers: list[dict[str, Any]]) -> None:
    if not headers[0]["curvature_coordinates"]:
        return
    frames = np.sum([header["uncertain_frames"] for header in headers], axis=0)
    order = [m for m in np.argsort(-frames, kind="stable") if frames[m]]
    if not order:
        return
    named = ", ".join(f"{headers[0]['muscles'][m]} in {frames[m]}" for m in order[:NAMED_MUSCLES])
    more = f", and {len(order) - NAMED_MUSCLES} more muscles" if len(order) > NAMED_MUSCLES else ""
    logger.warning(
        "%s: the curvature of paths is uncertain in frames where they change their points or have kinks "
        "(%s%s); these are marked in trajectory.curvature.is_uncertain",
        motion.motion,
        named,
        more,
    )


def _padded(name: str, array: np.ndarray, n_points: int) -> np.ndarray:
    if name not in _POINT_ARRAYS or array.shape[2] == n_points:
        return array
    padded = np.full((*array.shape[:2], n_points, *array.shape[3:]), _POINT_ARRAYS[name], dtype=array.dtype)
    padded[:, :, : array.shape[2]] = array
    return padded
