"""Answers of `scso run` beside those of OpenSim's own static optimization, for any AnalyzeTool setups.

Usage: python -m problems.benchmarks.answers_against_opensim [SETUP.xml ...] [--data FOLDER] [--frames N]
[--output FILE]

Each setup is solved by `scso run` as it stands and by OpenSim four times: as it stands, and at about N of its
frames (default 20) with convergence criteria of 1e-6, 1e-7 and 1e-8. Whether OpenSim's answer of a frame
counts in these is measured, not asked: by how far it misses OpenSim's own equations, and by how far its
objective is above the least that the same misses allow. Both are of the problem that OpenSim itself states:
its matrix comes from OpenSim's forward dynamics (:mod:`problems.benchmarks.opensim_static_optimization`),
nothing of it from here. Of the answers of a frame the one nearest to its optimum is taken. Activations are
compared as they are, each reserve and residual relative to its own peak.

Optima are exact, in closed form from the bounds that Clarabel finds to hold: those of the arrays here tell
who is right, those of OpenSim's own problem whether both are the same question, also where OpenSim does not
converge. OpenSim's answer put into our equations of equilibrium tells that once more. Where the low-pass
filter would make OpenSim resample without end, both are asked without it. With `--data`, setups are written
for the third-party data there that have none.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

import scso_nlp as scso
from problems.benchmarks.tables import table_command, title
from scso_nlp.io.storage import Storage, read_storage
from scso_nlp.opensim.setup_xml import MotionInput, read_analyze_setup
from scso_nlp.validation import FloatArray

#: Convergence criteria of OpenSim's further runs, their most iterations, and about how many frames.
CRITERIA, ITERATIONS, FRAMES = (1e-6, 1e-7, 1e-8), 1000, 20
#: An answer of these counts if its objective is at most this much above the optimum [-]: no activation and no
#: control is then further from the optimum than its root, 0.001, whatever the problem.
GAP = 1e-6
#: An objective is known to this share of it, by rounding.
ROUNDED = 1e-13
#: Controls that are never larger are those of actuators that nobody needs: this is their peak [-].
IDLE = 1e-8
#: Steps this much smaller than the typical one are too small to filter: OpenSim resamples to the smallest.
SMALL_STEP = 1e-3
#: Rounding of an answer in closed form, over its largest entry [-].
ROUNDING = 1e-9
#: Times of both differ by no more than what files round [s].
SAME_TIME = 1e-6
#: OpenSim cannot share a process with CasADi.
OPENSIM = Path(__file__).with_name("opensim_static_optimization.py")
FAILURE = re.compile(r"could not find a solution at time = ([-+.\de]+)\.\n")
FRAME = re.compile(r"^time = (\S+) Performance = \S+ Constraint violation = (\S+)$", re.MULTILINE)
#: OpenSim's answer is none where it says that accelerations miss the motion's by more [rad/s² or m/s²], or
#: where they do in its equations as rebuilt, which know them to this share of the largest.
VIOLATION = 1e-3


@dataclass(frozen=True)
class Difference:
    """How far two answers are apart in frames that count; NaN without such frames."""

    activation: float  # largest [-]
    muscle: str
    control: float  # largest, relative to the actuator's own peak [-]
    actuator: str
    peak: float  # of that actuator [N or N·m]

    def __str__(self) -> str:
        """Return its two cells."""
        muscle = f"{self.activation:.1e} ({self.muscle})" if self.muscle else "–"
        actuator = f"{self.control:.1e} ({self.actuator}, peak {self.peak:.2g})" if self.actuator else "–"
        return f"{muscle} | {actuator}"

    @property
    def sizes(self) -> str:
        """Both numbers, in one cell."""
        return ", ".join("–" if np.isnan(size) else f"{size:.1e}" for size in (self.activation, self.control))


@dataclass(frozen=True)
class Answer:
    """What OpenSim says about some frames."""

    storage: Storage  # activations and controls
    violation: FloatArray  # (n_frames,), of its own equations, as it says [rad/s² or m/s²]
    is_claimed: NDArray[np.bool_]  # (n_frames,), its log names no failure and no larger miss


@dataclass(frozen=True)
class Comparison:
    """One row of the table."""

    title: str
    frames: int
    solved: tuple[int, int]  # here and by OpenSim
    as_it_stands: Difference
    asked: int  # frames of the further runs
    claimed: tuple[int, ...]  # converged as OpenSim says, at each criterion
    counted: tuple[int, ...]  # as measured, at each criterion, and at any
    sharp: Difference  # in the frames that count
    own_problem: Difference  # of the answer here from the optimum of OpenSim's own problem, all frames asked
    from_optimum: Difference  # of the answer here from Clarabel's
    opensim_from_optimum: Difference
    missed: float  # by OpenSim's answer in our equations of equilibrium [N or N·m]
    largest_moment: float

    def __str__(self) -> str:
        """Return the row."""
        solved = f"{self.solved[0]}, {self.solved[1]}"
        claimed, counted = (", ".join(map(str, sizes)) for sizes in (self.claimed, self.counted))
        further = f"{claimed} of {self.asked} | {counted} of {self.asked} | {self.sharp}"
        ends = f"{self.from_optimum.sizes} | {self.opensim_from_optimum.sizes}"
        missed = f"{self.missed:.1e} of {self.largest_moment:.2g}"
        own = self.own_problem.sizes
        cells = f"{self.frames} | {solved} | {self.as_it_stands} | {further} | {own} | {ends} | {missed}"
        return f"| {self.title} | {cells} |"


def ask_opensim(setup: Path, folder: Path, unfiltered: bool, **options: float) -> Answer:
    """Return OpenSim's answer, with other options of StaticOptimization than the setup's where given.

    Raises
    ------
    RuntimeError
        It gave none.
    """
    folder.mkdir()
    said = _run_opensim(folder, setup, unfiltered, options)
    found = list(folder.glob("*_activation.sto"))
    if not found:
        raise RuntimeError(said.strip().splitlines()[-1])
    answer = read_storage(found[0])
    failed = np.array([float(time) for time in FAILURE.findall(said)])
    lines = np.array([[float(time), float(size)] for time, size in FRAME.findall(said)]).reshape(-1, 2)
    violation = np.full(answer.n_frames, np.inf)
    for time, size in lines:
        violation[_is_at(answer.time, time)] = size
    is_failed = _is_at(answer.time[:, None], failed).any(axis=1)
    return Answer(storage=answer, violation=violation, is_claimed=~is_failed & (violation <= VIOLATION))


def _is_at(time: FloatArray, printed: FloatArray | float) -> NDArray[np.bool_]:
    """Tell whether times are those of the log, which has 15 digits."""
    return np.isclose(time, printed, rtol=1e-14, atol=1e-7)


def ask_problem(setup: Path, folder: Path, unfiltered: bool, answer: Answer) -> dict[str, FloatArray]:
    """Return the problem that OpenSim states at the frames of an answer, columns as in its file.

    Raises
    ------
    RuntimeError
        It gave none.
    """
    folder.mkdir()
    options = {
        "times": answer.storage.time.tolist(),
        "actuators": list(answer.storage.labels),
        "problem": str(folder / "problem.npz"),
    }
    said = _run_opensim(folder, setup, unfiltered, options)
    if not (folder / "problem.npz").is_file():
        raise RuntimeError(said.strip().splitlines()[-1])
    with np.load(folder / "problem.npz") as content:
        return dict(content)


def _run_opensim(folder: Path, setup: Path, unfiltered: bool, options: Mapping[str, object]) -> str:
    """Return what OpenSim prints about a question."""
    question = {"setup": str(setup), "results": str(folder), "unfiltered": unfiltered, **options}
    command = [sys.executable, "-P", str(OPENSIM), json.dumps(question)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    return done.stdout + done.stderr


def ask_scso(setup: Path, folder: Path, unfiltered: bool) -> tuple[Storage, FloatArray, scso.Motion]:
    """Return our activations and controls, which frames are solved, and the arrays they are about.

    Raises
    ------
    RuntimeError
        There are none.
    """
    command = [sys.executable, "-m", "scso_nlp", "run", str(setup), "--no-figures", "--keep-failed"]
    command += ["--cache", str(folder / "cache"), "--output", str(folder / "ours")]
    command += ["--lowpass-cutoff-frequency", "-1"] if unfiltered else []
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = list((folder / "ours").glob("*_activation.sto"))
    if not found:
        raise RuntimeError((done.stderr.strip() or done.stdout.strip()).splitlines()[-1])
    changes = {"lowpass_cutoff_frequency": -1.0} if unfiltered else {}
    motion = scso.load_motion(setup, cache=folder / "cache", progress=False, **changes)
    answer = read_storage(found[0])
    return answer, np.isfinite(answer.values).all(axis=1), motion


def equations(motion: scso.Motion, with_physiology: bool) -> FloatArray:
    """Return what a unit of every activation and control does, shape (n_frames, n_free, n) [N or N·m]."""
    t = motion.trajectory
    force = t.active_force_capacity if with_physiology else motion.muscles.max_isometric_force[None]
    return np.concatenate([t.moment_arms * force[:, None, :], t.actuator_generalized_forces], axis=2)


def optimum(lower: FloatArray, upper: FloatArray, matrices: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the least sum of squares of every frame, shape (n_frames, n); NaN where there is none.

    Bounds have the shape (n,), matrices (n_frames, n_rows, n), what is wanted (n_frames, n_rows).
    """
    low, high, eye = np.isfinite(lower), np.isfinite(upper), np.eye(len(lower))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    found = np.full((len(matrices), len(lower)), np.nan)
    for k, (matrix, goal) in enumerate(zip(matrices, wanted, strict=True)):
        size = np.linalg.norm(matrix, axis=1)
        used = size > 0
        rows, b = matrix[used] / size[used, None], goal[used] / size[used]
        answer = clarabel.DefaultSolver(
            sp.csc_matrix(eye),
            np.zeros(len(lower)),
            sp.csc_matrix(np.vstack([rows, -eye[low], eye[high]])),
            np.concatenate([b, -lower[low], upper[high]]),
            [clarabel.ZeroConeT(len(b)), clarabel.NonnegativeConeT(int(low.sum()) + int(high.sum()))],
            settings,
        ).solve()
        at_lower, at_upper = np.zeros((2, len(lower)), dtype=bool)
        pushes = np.array(answer.z)[len(b) :] > np.array(answer.s)[len(b) :]
        at_lower[low], at_upper[high] = np.split(pushes, [low.sum()])
        found[k] = least_norm(
            rows, b, lower, upper, np.where(at_upper, upper, np.where(at_lower, lower, np.nan))
        )
    return found


def least_norm(
    rows: FloatArray, b: FloatArray, lower: FloatArray, upper: FloatArray, fixed: FloatArray
) -> FloatArray:
    """Give the least norm to rounding, from the unknowns (n,) that bounds hold and NaN for the others.

    With these fixed it is the shortest vector that keeps the equations, in closed form; and the optimum if
    it stays within the bounds and every bound pushes inwards. NaN otherwise.
    """
    free = np.isnan(fixed)
    x = np.where(free, 0.0, fixed)
    x[free] = np.linalg.lstsq(rows[:, free], b - rows @ x)[0]
    push = x - rows.T @ np.linalg.lstsq(rows[:, free].T, x[free])[0]
    slack = ROUNDING * np.abs(x).max()
    is_optimal = (
        (np.abs(rows @ x - b) <= slack).all()
        and ((x >= lower - slack) & (x <= upper + slack)).all()
        and (push[(fixed == lower) & (lower < upper)] >= -slack).all()
        and (push[(fixed == upper) & (lower < upper)] <= slack).all()
    )
    return x if is_optimal else np.full(x.size, np.nan)


def difference(one: FloatArray, other: FloatArray, motion: scso.Motion) -> Difference:
    """Compare two answers, shape (n_frames, n)."""
    n, apart = motion.muscles.n_muscles, np.abs(one - other)
    if not apart.size:
        return Difference(np.nan, "", np.nan, "", np.nan)
    activation, control = apart.max(axis=0)[:n], apart.max(axis=0)[n:]
    peak = np.maximum(np.abs(other).max(axis=0)[n:], IDLE)
    m, a = (int(np.argmax(sizes)) if sizes.size else None for sizes in (activation, control / peak))
    return Difference(
        activation=np.nan if m is None else activation[m],
        muscle="" if m is None else motion.muscles.muscles[m],
        control=np.nan if a is None else control[a] / peak[a],
        actuator="" if a is None else motion.actuators.actuators[a],
        peak=np.nan if a is None else peak[a] * motion.actuators.optimal_force[a],
    )


def distances(problem: Mapping[str, FloatArray], x: FloatArray) -> FloatArray:
    """Tell how far above the optimum of OpenSim's own problem answers are for certain, shape (n_frames,).

    Answers x (n_frames, n) that miss the equations may be below the optimum; so they are held against the
    least for the accelerations that they do give. Infinite where these miss the motion's by too much, where
    numbers are not finite, and where the optimum is not known.
    """
    found = np.full(len(x), np.inf)
    given = np.einsum("kcx,kx->kc", problem["matrices"], x)
    scale = np.maximum(np.abs(problem["accelerations"]).max(axis=1), 1.0)
    missed = np.linalg.norm(given - problem["wanted"], axis=1)
    kept = np.flatnonzero(missed <= VIOLATION * scale)
    least = optimum(problem["lower"], problem["upper"], problem["matrices"][kept], given[kept])
    gap = ((x[kept] - least) * (x[kept] + least)).sum(axis=1) - ROUNDED * (x[kept] ** 2).sum(axis=1)
    found[kept] = np.where(np.isnan(gap), np.inf, gap)
    return found


def is_unfilterable(motion: MotionInput) -> bool:
    """Tell whether OpenSim's filter would resample a motion without end."""
    source, cutoff = motion.coordinates, motion.lowpass_cutoff_frequency
    if source is None or cutoff is None or cutoff < 0:
        return False
    steps = np.diff(read_storage(source).time)
    return bool(steps.min() < SMALL_STEP * np.median(steps))


def compare(setup: Path, frames: int = FRAMES) -> Comparison:
    """Ask both about one setup.

    Raises
    ------
    RuntimeError
        One of them gives no answer.
    """
    wanted = read_analyze_setup(setup)
    unfiltered = is_unfilterable(wanted.motion)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        ours, is_solved, motion = ask_scso(setup, folder, unfiltered)
        loose = ask_opensim(setup, folder / "as_it_stands", unfiltered)
        options = {
            "step": wanted.motion.step_interval * -(-len(ours.time) // frames),
            "iterations": ITERATIONS,
        }
        further = [
            ask_opensim(setup, folder / f"{criterion}", unfiltered, criterion=criterion, **options)
            for criterion in CRITERIA
        ]
        problem = ask_problem(setup, folder / "problem", unfiltered, further[0])
    time, further_time = loose.storage.time, further[0].storage.time
    if time.shape != ours.time.shape or np.abs(time - ours.time).max() > SAME_TIME:
        raise RuntimeError(f"{len(ours.time)} frames here, {len(time)} in OpenSim, at other times")
    labels, moments = (
        motion.trajectory.muscles + motion.trajectory.actuators,
        motion.trajectory.generalized_forces,
    )
    x, theirs = ours.columns(labels), loose.storage.columns(labels)
    matrices = equations(motion, wanted.use_muscle_physiology)
    muscles, actuators = motion.muscles, motion.actuators
    bounds = (
        np.concatenate([muscles.min_activation, actuators.min_control]),
        np.concatenate([muscles.max_activation, actuators.max_control]),
    )
    is_square = wanted.activation_exponent == 2.0
    best = optimum(*bounds, matrices, moments) if is_square else np.full_like(x, np.nan)
    counted = is_solved & loose.is_claimed
    known = counted & np.isfinite(best).all(axis=1)
    missed = np.abs(np.einsum("kcx,kx->kc", matrices, theirs) - moments)
    # the further runs, by the problem that OpenSim states
    rows = np.abs(ours.time - further_time[:, None]).argmin(axis=1)
    columns = [further[0].storage.labels.index(label) for label in labels]
    above = np.array([distances(problem, answer.storage.values) for answer in further])
    above[np.array([answer.violation for answer in further]) > VIOLATION] = np.inf
    if not is_square:
        above[:] = np.inf
    nearest = above.argmin(axis=0)
    values = np.array([answer.storage.columns(labels) for answer in further])
    sharp = values[nearest, np.arange(len(rows))]
    is_sharp = (above <= GAP).any(axis=0)
    own = optimum(problem["lower"], problem["upper"], problem["matrices"], problem["wanted"])[:, columns]
    both = is_solved[rows] & np.isfinite(own).all(axis=1) & is_square
    return Comparison(
        title=f"{title(setup)}{', without filter' if unfiltered else ''}",
        frames=len(x),
        solved=(int(is_solved.sum()), int(loose.is_claimed.sum())),
        as_it_stands=difference(x[counted], theirs[counted], motion),
        asked=len(rows),
        claimed=tuple(int(answer.is_claimed.sum()) for answer in further),
        counted=(*(int(size) for size in (above <= GAP).sum(axis=1)), int(is_sharp.sum())),
        sharp=difference(x[rows][is_sharp & is_solved[rows]], sharp[is_sharp & is_solved[rows]], motion),
        own_problem=difference(x[rows][both], own[both], motion),
        from_optimum=difference(x[known], best[known], motion),
        opensim_from_optimum=difference(theirs[known], best[known], motion),
        missed=missed[counted].max(initial=0.0),
        largest_moment=np.abs(moments).max(),
    )


HEADS = (
    "setup",
    "frames",
    "solved here, by OpenSim",
    "activation",
    "reserve",
    "converged as it says: 1e-6, 1e-7, 1e-8",
    "as measured: 1e-6, 1e-7, 1e-8, any",
    "activation, measured",
    "reserve, measured",
    "from OpenSim's own optimum",
    "from optimum: here",
    "from optimum: OpenSim",
    "OpenSim's answer in our equations [N or N·m]",
)


def main() -> None:
    """Print the table row by row, and write it."""
    table_command(
        __doc__,
        HEADS,
        lambda setup, frames: str(compare(setup, frames)),
        frames=FRAMES,
        of_what="of the runs with tighter criteria",
    )


if __name__ == "__main__":
    main()
