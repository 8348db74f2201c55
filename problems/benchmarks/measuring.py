"""Measure one case: each stage, each question by us and by others, and what every answer is worth.

A measurement is a mapping: ``case``, ``what`` (stage or question), ``by``, ``power``, ``frames``,
``seconds``, ``cpu_seconds``, ``peak_mb``; of answers ``kept`` (frames that keep everything), the largest
that is missed (``equilibrium``, ``stability``, ``bounds``) and ``objective``, how far the worst kept frame is
above the best answer; and ``note``. What does not apply is left out.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import numpy as np

import scso_nlp as scso
from problems.benchmarks.cases import FULL, SCSO, SO, Case, synthetic
from problems.benchmarks.peers import PEERS
from problems.benchmarks.questions import Question, ask
from problems.random_hessian.lifted_stability import LiftedStability
from scso_nlp.io.storage import read_storage
from scso_nlp.validation import FloatArray, IntArray

_Result = TypeVar("_Result")
Measurement = dict[str, Any]

#: Where this package of problems can be imported from.
ROOT = Path(__file__).parents[2]
#: Who answers.
TRAJECTORY, FRAMEWISE, OPENSIM, MOCO = "trajectory-wide", "frame by frame", "OpenSim", "MocoInverse"
RUN = "scso run"
#: A frame is kept if nothing is missed by more [N·m, N, N·m/rad; bounds: -].
KEPT, KEPT_BOUNDS = 1e-4, 1e-6
#: The best answer is one that misses no row by more, if there is one: otherwise it may be below the optimum.
EXACT = 1e-8
#: What is short is measured again until this much is spent, five times at most; the median counts [s].
SHORT = 3.0
#: Frame by frame takes frames spread evenly of motions that are longer.
MOST_FRAMEWISE = 1200
#: Coordinates up to which the Hessian is tried with its Cholesky factor as unknowns too.
MOST_LIFTED = 10
#: MocoInverse: start, mesh interval [s] and points.
MOCO_START, MOCO_MESH, MOCO_POINTS = 0.81, 0.02, 6

#: OpenSim cannot share a process with CasADi.
_RUN_OPENSIM = """
import sys
import opensim
opensim.Logger.setLevelString("Off")
opensim.AnalyzeTool(sys.argv[1]).run()
"""
_RUN_MOCO = """
import json, sys
import opensim
folder, start, mesh, points = sys.argv[1], *map(float, sys.argv[2:])
opensim.Logger.setLevelString("Off")
model = opensim.ModelProcessor(f"{folder}/subject_walk_scaled.osim")
toes = opensim.StdVectorString()  # the motion has no columns for them
toes.append("mtp_r")
toes.append("mtp_l")
for change in (
    opensim.ModOpAddExternalLoads(f"{folder}/grf_walk.xml"),
    opensim.ModOpReplaceJointsWithWelds(toes),
    opensim.ModOpIgnoreTendonCompliance(),
    opensim.ModOpReplaceMusclesWithDeGrooteFregly2016(),
    opensim.ModOpIgnorePassiveFiberForcesDGF(),
    opensim.ModOpScaleActiveFiberForceCurveWidthDGF(1.5),
    opensim.ModOpReplacePathsWithFunctionBasedPaths(f"{folder}/subject_walk_scaled_FunctionBasedPathSet.xml"),
    opensim.ModOpAddReserves(1.0),
):
    model.append(change)
inverse = opensim.MocoInverse()
inverse.setModel(model)
inverse.setKinematics(opensim.TableProcessor(f"{folder}/coordinates.sto"))
inverse.set_initial_time(start)
inverse.set_final_time(start + mesh * (points - 1))
inverse.set_mesh_interval(mesh)
inverse.set_kinematics_allow_extra_columns(True)
found = inverse.solve()
solution = found.getMocoSolution()
solution.unseal()
said = {"solved": solution.success(), "points": solution.getNumTimes()}
print(json.dumps({"seconds": solution.getSolverDuration(), **said}), flush=True)
"""


def measure(case: Case, data: Path, peers: frozenset[str] | None) -> Iterator[Measurement]:
    """Measure all of a case.

    Parameters
    ----------
    case : Case
    data : Path
        Folder of the third-party data.
    peers : set of str, optional
        Those that are asked; all by default.

    Yields
    ------
    dict
        One measurement after the other, with the case's name.
    """
    with tempfile.TemporaryDirectory() as scratch:
        if case.sizes:
            found = _random_motions(case, peers)
        elif case.make is not None:
            os.environ.setdefault("SCSO_DATA", str(data))
            found = _made_motion(case, peers)
        else:
            found = _recorded_motion(case, data, Path(scratch), peers)
        for measurement in found:
            yield {"case": case.name, **measurement}


def _recorded_motion(
    case: Case, data: Path, scratch: Path, peers: frozenset[str] | None
) -> Iterator[Measurement]:
    assert case.setup is not None
    try:
        setup = case.setup(data, scratch)
    except OSError as error:
        yield {"what": "all", "by": RUN, "note": f"no data: {error}"}
        return
    if not setup.is_file():
        yield {"what": "all", "by": RUN, "note": f"no data: {setup} is not there"}
        return
    yield from _whole_runs(case, setup, scratch)
    motion = None
    for kind in case.powers:
        motion, cost = _timed(lambda kind=kind: recorded(case, setup, kind), 1)
        what = f"extraction, {kind}"
        yield {"what": what, "by": RUN, "frames": motion.n_frames, **cost}
        for power in case.powers[kind]:
            yield from _question(case.problem(motion, kind, power), kind, peers)
        if case.coupled and kind != FULL:
            yield from _coupled(case.problem(motion, kind), kind)
    assert motion is not None
    yield from _files(case, case.problem(motion, SO), scratch)
    if case.opensim and _asked(OPENSIM, peers):
        yield from _opensim(case, setup, scratch)
    if case.moco and _asked(MOCO, peers):
        yield _moco(setup.parent, scratch)


def recorded(case: Case, setup: Path, kind: str) -> scso.Motion:
    """Extract the motion of a case's setup with what one question about it needs."""
    changes = {**case.changes, **case.extras(kind)}
    if case.consistent_speeds:
        changes["keep_coupled_speeds"] = False
    return scso.load_motion(setup, progress=False, **changes)


def _made_motion(case: Case, peers: frozenset[str] | None) -> Iterator[Measurement]:
    assert case.make is not None
    try:
        problem, cost = _timed(case.make, 1)
    except scso.DataError as error:
        yield {"what": "all", "by": RUN, "note": f"no data: {error}"}
        return
    yield {"what": "extraction, all", "by": RUN, "frames": problem.motion.n_frames, **cost}
    kept, rows, whole = problem.constraints
    for kind, powers in case.powers.items():
        for power in powers:
            effort = (scso.ActivationEffort(exponent=power),)
            terms = {SO: (kept,), SCSO: (kept, rows), FULL: (kept, whole)}[kind]
            yield from _question(replace(problem, objectives=effort, constraints=terms), kind, peers)


def _random_motions(case: Case, peers: frozenset[str] | None) -> Iterator[Measurement]:
    """Solve each in a process of its own, for its memory; others are asked in this one."""
    for kind, powers in case.powers.items():
        for size in case.sizes:
            words = "{} coordinates, {} muscles".format(*size)
            command = [sys.executable, "-m", "problems.benchmarks.measuring", *map(str, size), kind]
            done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
            found = {"what": f"{kind}, {words}, alone", "by": TRAJECTORY, "power": 2.0, "frames": size[2]}
            if done.returncode:
                yield {**found, "note": _last_line(done)}
            else:
                yield {**found, **json.loads(done.stdout.splitlines()[-1])}
            for power in powers:
                problem = synthetic(*size, kind)
                problem = replace(problem, objectives=(scso.ActivationEffort(exponent=power),))
                forms = {}
                if kind == FULL and power == 2.0 and size[0] <= MOST_LIFTED:
                    forms["Cholesky factor as unknowns"] = replace(
                        problem, constraints=(scso.MomentEquilibrium(), LiftedStability())
                    )
                yield from _question(problem, f"{kind}, {words}", peers, forms)


def _alone(n_coordinates: int, n_muscles: int, n_frames: int, kind: str) -> Measurement:
    """Solve one random motion; memory is what comes on top of a process that has solved a short one."""
    scso.solve_trajectory(synthetic(n_coordinates, n_muscles, 8, kind))
    problem = synthetic(n_coordinates, n_muscles, n_frames, kind)
    before = _peak_since_reset()
    _, cost = _timed(lambda: scso.solve_trajectory(problem, on_failure="return"), 1)
    total = _memory("VmHWM")
    return {**cost, "peak_mb": total, "solving_mb": max(total - before, 0.0)}


def _peak_since_reset() -> float:
    """Forget the peak of memory, where the system can, and give what is held now [MB]."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return _memory("VmHWM")
    return _memory("VmRSS")


def _memory(name: str) -> float:
    """Read a size of this process from Linux, or its peak from elsewhere [MB]."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return float(re.search(rf"{name}:\s+(\d+) kB", status)[1]) / 1e3  # type: ignore[index]


def _whole_runs(case: Case, setup: Path, scratch: Path) -> Iterator[Measurement]:
    """Run the command as a user does, without figures: for one frame, which is start-up, and for all."""
    command = [sys.executable, "-m", "scso_nlp", "run", str(setup), "--no-figures"]
    begin = case.changes.get("initial_time", ElementTree.parse(setup).findtext(".//initial_time"))
    one = ["--initial-time", str(begin), "--final-time", str(begin)]
    for kind in case.powers:
        for what, words in ((f"start-up, {kind}", one), (f"whole run, {kind}", [])):
            if words and kind != SO:
                continue
            folder = scratch / what.replace(" ", "_")
            options = [*case.options(kind), *words, "--output", str(folder)]
            done, cost = _process([*command, *options])
            frames = _frames_of(folder)
            note = "" if done.returncode == 0 else f"exit {done.returncode}: {_last_line(done)}"
            yield {"what": what, "by": RUN, "frames": frames, **cost, "note": note}


def _frames_of(folder: Path) -> int:
    found = list(folder.glob("*_activation.sto"))
    return len(read_storage(found[0]).time) if found else 0


def _question(
    problem: scso.MuscleForceProblem,
    what: str,
    peers: frozenset[str] | None,
    forms: Mapping[str, scso.MuscleForceProblem] | None = None,
) -> Iterator[Measurement]:
    """Let everybody answer one question, and compare the answers; `forms` are other descriptions of it."""
    question = ask(problem)
    about = {"what": what, "power": question.exponent}
    answers: list[_Answer] = []
    every = np.arange(question.n_frames)
    for by, solve in ((TRAJECTORY, scso.solve_trajectory), (FRAMEWISE, scso.solve_framewise)):
        frames = spread(question.n_frames, question.n_frames if by == TRAJECTORY else MOST_FRAMEWISE)
        part = problem if frames.size == every.size else frames_of(problem, frames)
        answers.append(_ours(about, by, part, frames, solve))
    for by, form in (forms or {}).items():
        answers.append(_ours(about, by, form, every, scso.solve_trajectory))
    for peer in PEERS:
        if not (_asked(peer.name, peers) and peer.can(question)):
            continue
        row = {**about, "by": peer.name}
        if not peer.is_installed:
            answers.append(_Answer({**row, "note": 'not installed: pip install ".[benchmark]"'}))
            continue
        frames = spread(question.n_frames, peer.most_unknowns // len(question.lower))
        some = question.frames(frames)
        try:
            x, cost = _timed(lambda peer=peer, some=some: peer.solve(some))
        except Exception as error:  # a peer that breaks is one line of the table
            answers.append(
                _Answer({**row, "frames": frames.size, "note": f"{type(error).__name__}: {error}"})
            )
            continue
        answers.append(_Answer({**row, "frames": frames.size, **cost}, frames, x))
    yield from _compared(question, answers)


@dataclass(frozen=True)
class _Answer:
    """A measurement, with the answer of some frames that it is about, if there is one."""

    row: Measurement
    frames: IntArray | None = None
    x: FloatArray | None = None
    forces: FloatArray | None = None


def _ours(
    about: Measurement, by: str, problem: scso.MuscleForceProblem, frames: IntArray, solve: Callable[..., Any]
) -> _Answer:
    row = {**about, "by": by, "frames": frames.size}
    try:
        solution, cost = _timed(lambda: solve(problem, on_failure="return"))
    except (scso.ScsoError, RuntimeError) as error:
        return _Answer({**row, "note": f"{type(error).__name__}: {error}"})
    report = solution.report
    row |= {**cost, "iterations": report.iterations, "build_seconds": report.build_seconds}
    row["solve_seconds"] = report.solve_seconds
    unsolved = int((~solution.is_solved).sum())
    if unsolved:
        row["note"] = f"says of {unsolved} frames that they are not solved"
    usable = solution.is_solved[:, None]
    x = np.where(usable, np.hstack([solution.activation, solution.control]), np.nan)
    return _Answer(row, frames, x, np.where(usable, solution.tendon_force, np.nan))


def _compared(question: Question, answers: list[_Answer]) -> Iterator[Measurement]:
    """Judge all answers by the same numbers, and each objective by the best of those that keep all rows."""
    best, exact = np.full((2, question.n_frames), np.inf)
    judged = []
    for answer in answers:
        if answer.x is None or answer.frames is None:
            judged.append(None)
            continue
        some = question.frames(answer.frames)
        missed = some.missed(answer.x, answer.forces)
        rows = np.maximum(missed["equilibrium"], missed["stability"])
        kept = (rows <= KEPT) & (missed["bounds"] <= KEPT_BOUNDS)
        objective = some.objective(answer.x)
        for least, good in ((best, kept), (exact, kept & (rows <= EXACT))):
            least[answer.frames[good]] = np.minimum(least[answer.frames[good]], objective[good])
        judged.append((missed, kept, objective))
    best = np.where(np.isfinite(exact), exact, best)
    for answer, found in zip(answers, judged, strict=True):
        if found is None:
            yield answer.row
            continue
        missed, kept, objective = found
        largest = {name: float(np.nanmax(v)) for name, v in missed.items() if np.isfinite(v).any()}
        row = {**answer.row, "kept": int(kept.sum()), **largest}
        if kept.any():
            against = best[answer.frames[kept]]
            above = (objective[kept] - against) / np.where(against > 0, against, 1.0)
            row["objective"] = float(above.max())
        yield row


def _coupled(problem: scso.MuscleForceProblem, kind: str) -> Iterator[Measurement]:
    """Add terms that couple frames, and elastic tendons; only the rows are judged: no one else answers."""
    forms = {
        "ActivationRate": (problem.muscle_model, scso.ActivationRate()),
        "ActivationDynamics": (problem.muscle_model, scso.ActivationDynamics()),
        "CompliantTendon": (scso.CompliantTendon(), None),
    }
    motion = problem.motion
    strength = np.broadcast_to(
        motion.muscles.max_isometric_force, (motion.n_frames, motion.muscles.n_muscles)
    )
    question = ask(problem, capacity=strength)
    every = np.arange(question.n_frames)
    for name, (model, term) in forms.items():
        terms = problem.constraints if term is None else (*problem.constraints, term)
        changed = replace(problem, muscle_model=model, constraints=terms)
        about = {"what": f"{kind} + {name}", "power": 2.0}
        answer = _ours(about, TRAJECTORY, changed, every, scso.solve_trajectory)
        for row in _compared(question, [answer]):
            row.pop("objective", None)
            yield row


def _files(case: Case, problem: scso.MuscleForceProblem, scratch: Path) -> Iterator[Measurement]:
    solution = scso.solve_trajectory(problem, on_failure="return")
    frames = problem.motion.n_frames
    folder = scratch / "files"
    _, written = _timed(lambda: scso.write_solution(solution, folder, keep_failed=True, figures=False), 1)
    yield {"what": "writing, SO", "by": RUN, "frames": frames, **written}
    if case.figures:
        _, drawn = _timed(lambda: scso.write_solution(solution, folder, keep_failed=True), 1)
        cost = {name: drawn[name] - written[name] for name in drawn}
        yield {"what": "figures, SO", "by": RUN, "frames": frames, **cost}


def _opensim(case: Case, setup: Path, scratch: Path) -> Iterator[Measurement]:
    """Let OpenSim's tool run, and judge its static optimization beside ours on the same motion."""
    for analysis in case.opensim:
        folder = scratch / analysis
        folder.mkdir()
        changed = _opensim_setup(case, setup, folder, analysis)
        done, cost = _process([sys.executable, "-c", _RUN_OPENSIM, str(changed)], folder)
        about = {"what": f"{OPENSIM}'s {analysis}", "by": OPENSIM, "power": 2.0}
        found = next(folder.glob("results/*_activation.sto"), None) or next(
            folder.glob("results/*.sto"), None
        )
        if found is None:
            yield {**about, **cost, "note": _last_line(done) or "no results"}
            continue
        answer = read_storage(found)
        row = {**about, "frames": len(answer.time), **cost}
        if analysis != "StaticOptimization":
            del row["power"]
            yield row
            continue
        changes = dict(case.changes)
        if case.opensim_times is not None:
            changes["initial_time"], changes["final_time"] = case.opensim_times
        motion = scso.load_motion(setup, progress=False, **changes)
        t = motion.trajectory
        near = np.abs(answer.time[:, None] - t.time).argmin(axis=1)
        same = np.abs(answer.time - t.time[near]) < 1e-5
        x = answer.columns((*t.muscles, *t.actuators))[same]
        problem = scso.static_optimization(motion)
        ours = _ours(
            {"what": about["what"], "power": 2.0},
            TRAJECTORY,
            problem,
            np.arange(motion.n_frames),
            scso.solve_trajectory,
        )
        yield from _compared(ask(problem), [ours, _Answer(row, near[same], x)])


def _opensim_setup(case: Case, setup: Path, folder: Path, analysis: str) -> Path:
    """Copy a setup file with another analysis, times and step, and with paths that hold from elsewhere."""
    tree = ElementTree.parse(setup)  # the benchmark's own file
    for name in ("model_file", "force_set_files", "external_loads_file", "coordinates_file", "states_file"):
        for element in tree.iter(name):
            if element.text and element.text.strip():
                element.text = " ".join(str(setup.parent / part) for part in element.text.split())
    (tool,) = tree.iter("StaticOptimization")
    tool.tag = analysis
    tool.set("name", analysis)
    times = case.opensim_times or (case.changes.get("initial_time"), case.changes.get("final_time"))
    for element in (element for element in tree.iter() if element is not tool):
        value = {
            "results_directory": "results",
            "step_interval": case.changes.get("step_interval"),
            "initial_time": times[0],
            "start_time": times[0],
            "final_time": times[1],
            "end_time": times[1],
            "lowpass_cutoff_frequency_for_coordinates": case.changes.get("lowpass_cutoff_frequency"),
        }.get(element.tag)
        if value is not None:
            element.text = str(value)
    copy = folder / "setup.xml"
    tree.write(copy)
    return copy


def _moco(folder: Path, scratch: Path) -> Measurement:
    words = [str(folder), str(MOCO_START), str(MOCO_MESH), str(MOCO_POINTS)]
    done, cost = _process([sys.executable, "-c", _RUN_MOCO, *words], scratch)
    row: Measurement = {"what": "SO + ActivationDynamics", "by": MOCO, "power": 2.0, **cost}
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if not lines:
        return {**row, "note": _last_line(done)}
    said = json.loads(lines[0])
    word = "solved" if said["solved"] else "says that it has not solved it"
    note = f"{word}; {said['seconds']:.3g} s of it in its solver"
    return {**row, "frames": said["points"], "note": note}


def _timed(call: Callable[[], _Result], repeats: int = 5) -> tuple[_Result, Measurement]:
    """Call, up to five times where that is short; median of wall and of processor time, children included."""
    walls, processors = [], []
    for _ in range(repeats):
        started, used = time.perf_counter(), processor_seconds()
        result = call()
        walls.append(time.perf_counter() - started)
        processors.append(processor_seconds() - used)
        if sum(walls) > SHORT:
            break
    return result, {"seconds": float(np.median(walls)), "cpu_seconds": float(np.median(processors))}


def processor_seconds() -> float:
    """Processor time of this process and of its children that have ended."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


def _process(
    command: list[str], folder: Path | None = None
) -> tuple[subprocess.CompletedProcess[str], Measurement]:
    """Run a command in a folder; its wall and processor time, and the memory of its largest process."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        started = time.perf_counter()
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=err, cwd=folder)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        done = subprocess.CompletedProcess(command, process.returncode, out.read(), err.read())
    cost = {"seconds": seconds, "cpu_seconds": usage.ru_utime + usage.ru_stime}
    return done, {**cost, "peak_mb": usage.ru_maxrss / 1e3}


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
    return lines[-1] if lines else f"exit {done.returncode}"


def _asked(name: str, peers: frozenset[str] | None) -> bool:
    return peers is None or name in peers


def spread(n: int, most: int) -> IntArray:
    """Choose some of n frames, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))


def frames_of(problem: scso.MuscleForceProblem, frames: IntArray) -> scso.MuscleForceProblem:
    """Ask about some frames only."""
    return replace(problem, motion=problem.motion.frames(frames))


def facts() -> dict[str, str]:
    """Describe the machine and the versions of everything that takes part."""
    import platform

    found = {"machine": platform.machine(), "system": platform.platform(), "cores": str(os.cpu_count())}
    try:
        info = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        found["processor"] = re.search(r"model name\s*: (.*)", info)[1]  # type: ignore[index]
        memory = Path("/proc/meminfo").read_text(encoding="ascii")
        kilobytes = re.search(r"MemTotal:\s+(\d+)", memory)[1]  # type: ignore[index]
        found["memory"] = f"{float(kilobytes) / 2**20:.0f} GB"
    except (OSError, TypeError):
        pass
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    if shutil.which("git"):
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
        found["commit"] = done.stdout.strip() or "unknown"
    found["python"] = platform.python_version()
    for name in ("scso_nlp", "casadi", "numpy", "scipy", "daqp", "piqp", "clarabel", "opensim"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


if __name__ == "__main__":
    print(json.dumps(_alone(*map(int, sys.argv[1:4]), sys.argv[4])))
