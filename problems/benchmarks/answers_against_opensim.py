"""Answers of `scso run` beside those of OpenSim's own static optimization, for any AnalyzeTool setups.

Usage: python -m problems.benchmarks.answers_against_opensim [SETUP.xml ...] [--data FOLDER] [--output FILE]

Each setup is solved by `scso run` as it stands and by OpenSim twice: as it stands, and at about 20 of its
frames with a convergence criterion of 1e-8. Frames count where OpenSim's log names no failure and its
equations are kept. Activations are compared as they are, each reserve and residual relative to its own peak.
The exact optimum of the same arrays, in closed form from the bounds that Clarabel finds to hold, tells who is
right; OpenSim's answer put into our equations of equilibrium tells whether they are its own. Where the
low-pass filter would make OpenSim resample without end, both are asked without it. With `--data`, setups are
written for the third-party data there that have none.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import clarabel
import numpy as np
import scipy.sparse as sp

import scso_nlp as scso
from problems.benchmarks.setups import write_setups
from scso_nlp.exceptions import ScsoError
from scso_nlp.io.storage import Storage, read_storage
from scso_nlp.opensim.engine import opensim_version
from scso_nlp.opensim.setup_xml import MotionInput, read_analyze_setup
from scso_nlp.validation import FloatArray

#: Convergence criterion and most iterations of OpenSim in its second run, and about how many frames.
TIGHT = {"criterion": 1e-8, "iterations": 500}
TIGHT_FRAMES = 20
#: Steps this much smaller than the typical one are too small to filter: OpenSim resamples to the smallest.
SMALL_STEP = 1e-3
#: Rounding of an answer in closed form, over its largest entry [-].
ROUNDING = 1e-9
#: Times of both differ by no more than what files round [s].
SAME_TIME = 1e-6
#: Only this stands between a run of OpenSim and its answer; it cannot share a process with CasADi.
OPENSIM = """
import json, sys
import opensim
question = json.loads(sys.argv[1])
opensim.Logger.setLevelString("Info")
tool = opensim.AnalyzeTool(question["setup"])
tool.setResultsDir(question["results"])
if question["unfiltered"]:
    tool.setLowpassCutoffFrequency(-1)
analyses = tool.getModel().getAnalysisSet()
for i in range(analyses.getSize()):
    analysis = opensim.StaticOptimization.safeDownCast(analyses.get(i))
    if analysis is not None and "criterion" in question:
        analysis.setConvergenceCriterion(question["criterion"])
        analysis.setMaxIterations(question["iterations"])
        analysis.setStepInterval(question["step"])
tool.run()
"""
FAILURE = re.compile(r"could not find a solution at time = ([-+.\de]+)\.\n")
FRAME = re.compile(r"^time = (\S+) Performance = \S+ Constraint violation = (\S+)$", re.MULTILINE)
#: OpenSim's answer is none where its accelerations miss the motion's by more [rad/s² or m/s²].
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
class Comparison:
    """One row of the table."""

    title: str
    frames: int
    solved: tuple[int, int]  # here and by OpenSim
    solved_tight: tuple[int, int]  # by OpenSim with the tight criterion, and how many it was asked for
    as_it_stands: Difference
    tight: Difference
    from_optimum: Difference  # of the answer here from Clarabel's
    opensim_from_optimum: Difference
    missed: float  # by OpenSim's answer in our equations of equilibrium [N or N·m]
    largest_moment: float

    def __str__(self) -> str:
        """Return the row."""
        solved = f"{self.solved[0]}, {self.solved[1]}, {self.solved_tight[0]} of {self.solved_tight[1]}"
        ends = f"{self.from_optimum.sizes} | {self.opensim_from_optimum.sizes}"
        missed = f"{self.missed:.1e} of {self.largest_moment:.2g}"
        cells = f"{self.frames} | {solved} | {self.as_it_stands} | {self.tight} | {ends} | {missed}"
        return f"| {self.title} | {cells} |"


def ask_opensim(setup: Path, folder: Path, unfiltered: bool, **options: float) -> tuple[Storage, FloatArray]:
    """Return OpenSim's activations and controls, and which of its frames converged, shape (n_frames,).

    Raises
    ------
    RuntimeError
        It gave none.
    """
    folder.mkdir()
    question = {
        "setup": str(setup),
        "results": str(folder),
        "unfiltered": unfiltered,
        **options,
    }
    command = [sys.executable, "-c", OPENSIM, json.dumps(question)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    found = list(folder.glob("*_activation.sto"))
    if not found:
        raise RuntimeError((done.stderr.strip() or done.stdout.strip()).splitlines()[-1])
    answer = read_storage(found[0])
    failed = {float(time) for time in FAILURE.findall(done.stdout)}
    violations = {float(time): float(size) for time, size in FRAME.findall(done.stdout)}
    good = np.array([time for time, size in violations.items() if size <= VIOLATION and time not in failed])
    return answer, np.array([np.isclose(good, time, rtol=0, atol=1e-7).any() for time in answer.time])


def ask_scso(setup: Path, folder: Path, unfiltered: bool) -> tuple[Storage, FloatArray, scso.Motion]:
    """Return our activations and controls, which frames are solved, and the arrays they are about.

    Raises
    ------
    RuntimeError
        There are none.
    """
    command = [sys.executable, "-m", "scso_nlp.cli", "run", str(setup), "--no-figures", "--keep-failed"]
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


def optimum(motion: scso.Motion, matrices: FloatArray) -> FloatArray:
    """Return the least sum of squares of every frame, shape (n_frames, n); NaN where there is none."""
    actuators, muscles = motion.actuators, motion.muscles
    lower = np.concatenate([muscles.min_activation, actuators.min_control])
    upper = np.concatenate([muscles.max_activation, actuators.max_control])
    low, high, eye = np.isfinite(lower), np.isfinite(upper), np.eye(len(lower))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    found = np.full((motion.n_frames, len(lower)), np.nan)
    for k, (matrix, wanted) in enumerate(zip(matrices, motion.trajectory.generalized_forces, strict=True)):
        size = np.linalg.norm(matrix, axis=1)
        used = size > 0
        rows, b = matrix[used] / size[used, None], wanted[used] / size[used]
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
    # the least number keeps actuators that nobody needs from 0 / 0
    peak = np.abs(other).max(axis=0)[n:] + np.finfo(float).tiny
    m, a = (int(np.argmax(sizes)) if sizes.size else None for sizes in (activation, control / peak))
    return Difference(
        activation=np.nan if m is None else activation[m],
        muscle="" if m is None else motion.muscles.muscles[m],
        control=np.nan if a is None else control[a] / peak[a],
        actuator="" if a is None else motion.actuators.actuators[a],
        peak=np.nan if a is None else peak[a] * motion.actuators.optimal_force[a],
    )


def is_unfilterable(motion: MotionInput) -> bool:
    """Tell whether OpenSim's filter would resample a motion without end."""
    source, cutoff = motion.coordinates, motion.lowpass_cutoff_frequency
    if source is None or cutoff is None or cutoff < 0:
        return False
    steps = np.diff(read_storage(source).time)
    return bool(steps.min() < SMALL_STEP * np.median(steps))


def compare(setup: Path) -> Comparison:
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
        loose, has_converged = ask_opensim(setup, folder / "as_it_stands", unfiltered)
        step = wanted.motion.step_interval * -(-len(ours.time) // TIGHT_FRAMES)
        tight, is_tight = ask_opensim(setup, folder / "tight", unfiltered, step=step, **TIGHT)
    if loose.time.shape != ours.time.shape or np.abs(loose.time - ours.time).max() > SAME_TIME:
        raise RuntimeError(f"{len(ours.time)} frames here, {len(loose.time)} in OpenSim, at other times")
    labels = motion.trajectory.muscles + motion.trajectory.actuators
    x, theirs, exacting = (answer.columns(labels) for answer in (ours, loose, tight))
    matrices, moments = equations(motion, wanted.use_muscle_physiology), motion.trajectory.generalized_forces
    best = optimum(motion, matrices) if wanted.activation_exponent == 2.0 else np.full_like(x, np.nan)
    rows = np.abs(ours.time - tight.time[:, None]).argmin(axis=1)
    counted, strict = is_solved & has_converged, is_solved[rows] & is_tight
    known = counted & np.isfinite(best).all(axis=1)
    missed = np.abs(np.einsum("kcx,kx->kc", matrices, theirs) - moments)
    return Comparison(
        title=f"{setup.parent.name}/{setup.name}{', without filter' if unfiltered else ''}",
        frames=len(x),
        solved=(int(is_solved.sum()), int(has_converged.sum())),
        solved_tight=(int(is_tight.sum()), len(is_tight)),
        as_it_stands=difference(x[counted], theirs[counted], motion),
        tight=difference(x[rows][strict], exacting[strict], motion),
        from_optimum=difference(x[known], best[known], motion),
        opensim_from_optimum=difference(theirs[known], best[known], motion),
        missed=missed[counted].max(initial=0.0),
        largest_moment=np.abs(moments).max(),
    )


HEADS = (
    "setup",
    "frames",
    "solved here, by OpenSim, tight",
    "activation",
    "reserve",
    "activation, tight",
    "reserve, tight",
    "from optimum: here",
    "from optimum: OpenSim",
    "OpenSim's answer in our equations [N or N·m]",
)


def main() -> None:
    """Print the table row by row, and write it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("setups", nargs="*", type=Path, metavar="SETUP.xml")
    parser.add_argument(
        "--data", type=Path, help="folder of the third-party data: compare those without setup"
    )
    parser.add_argument("--output", type=Path, help="write the table into this file too")
    arguments = parser.parse_args()
    lines = [f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|"]
    print(f"OpenSim {opensim_version()}\n" + "\n".join(lines), flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        made = write_setups(arguments.data.resolve(), Path(scratch)) if arguments.data else []
        for setup in [*arguments.setups, *made]:
            try:
                lines.append(str(compare(setup.resolve())))
            except (RuntimeError, ScsoError) as error:
                lines.append(f"| {setup.parent.name}/{setup.name} | no comparison: {error} |")
            print(lines[-1], flush=True)
    if arguments.output is not None:
        arguments.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
