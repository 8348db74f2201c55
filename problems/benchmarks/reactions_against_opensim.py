"""Joint reactions beside those of OpenSim's JointReaction at the same forces, for any AnalyzeTool setups.

Usage: python -m problems.benchmarks.reactions_against_opensim [SETUP.xml ...] [--data FOLDER] [--frames N]
[--output FILE]

Static optimization finds the forces at about N frames of each setup (default 5). OpenSim's JointReaction gets
them as its forces file and the setup as it stands, and says what every joint carries on its child and its
parent, in ground and in both bodies. Each difference is relative to the largest force or moment of its joint
in the motion, or to 1 N or 1 N·m where that is less. With `--data`, setups are written for the third-party
data there that have none.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import scso_nlp as scso
from problems.benchmarks.tables import table_command, title
from scso_nlp.io.storage import Storage, read_storage, write_storage
from scso_nlp.joint_reactions import FRAMES, SIDES, required
from scso_nlp.opensim.model_names import model_names
from scso_nlp.opensim.setup_xml import read_analyze_setup
from scso_nlp.validation import FloatArray

#: Frames of each setup, about.
SOME = 5
#: Bodies that reactions act on and frames that they are seen in.
PLACES = tuple(itertools.product(SIDES, FRAMES))
#: Times of both differ by no more than what files round [s].
SAME_TIME = 1e-6
#: OpenSim cannot share a process with CasADi.
OPENSIM = Path(__file__).with_name("opensim_joint_reaction.py")


@dataclass(frozen=True)
class Comparison:
    """Largest differences of one motion, relative."""

    frames: int
    joints: int
    force: float
    moment: float
    point: float  # [m]
    where: str  # of the larger one of force and moment
    largest_force: float  # of any joint [N]
    largest_moment: float  # [N·m]

    def __str__(self) -> str:
        """Return the cells of a row."""
        sizes = f"{self.largest_force:.2g} | {self.largest_moment:.2g}"
        return (
            f"{self.frames} | {self.joints} | {sizes} | {self.force:.1e} | {self.moment:.1e} | {self.where}"
        )


def opensims_reactions(
    setup: Path, motion: scso.Motion, tendon_force: FloatArray, control: FloatArray, step: int
) -> dict[tuple[str, str], Storage]:
    """Let OpenSim's JointReaction say what joints carry at given forces.

    Parameters
    ----------
    setup : Path
    motion : Motion
        Of that setup at every `step`-th row of its motion file.
    tendon_force : ndarray, shape (n_frames, n_muscles) [N]
    control : ndarray, shape (n_frames, n_actuators) [-]
    step : int

    Returns
    -------
    dict of (str, str) to Storage
        At the frames of the motion, by body that reactions act on and frame that they are seen in.

    Raises
    ------
    RuntimeError
        OpenSim gave no answer, or one at other times.
    """
    trajectory = motion.trajectory
    labels = (*trajectory.muscles, *trajectory.actuators)
    values = np.concatenate([tendon_force, control * motion.actuators.optimal_force], axis=1)
    # OpenSim wants every actuator of the model, applied or not
    others = [name for name in model_names(read_analyze_setup(setup).motion).forces if name not in labels]
    values = np.pad(values, ((0, 0), (0, len(others))))
    forces = Storage(name="forces", labels=(*labels, *others), time=trajectory.time, values=values)
    with tempfile.TemporaryDirectory() as scratch:
        theirs = _ask_opensim(setup, Path(scratch), forces, step)
    for place, table in theirs.items():
        rows = np.abs(table.time - trajectory.time[:, None]).argmin(axis=1)
        if np.abs(table.time[rows] - trajectory.time).max() > SAME_TIME:
            raise RuntimeError(f"OpenSim answers at other times than {setup} has")
        theirs[place] = replace(table, time=trajectory.time, values=table.values[rows])
    return theirs


def beside_opensim(
    setup: Path, motion: scso.Motion, tendon_force: FloatArray, control: FloatArray, step: int
) -> Comparison:
    """Compare reactions of a motion at given forces with OpenSim's.

    Parameters
    ----------
    setup, motion, tendon_force, control, step
        As for :func:`opensims_reactions`; the motion is read with joint reactions.

    Returns
    -------
    Comparison

    Raises
    ------
    RuntimeError
        OpenSim gave no answer, or one at other times or of other joints.
    """
    trajectory, reactions = motion.trajectory, required(motion.trajectory.joint_reactions)
    sizes, apart, seen = [], [], []
    theirs = opensims_reactions(setup, motion, tendon_force, control, step)
    for (on, frame), table in theirs.items():
        ours = reactions.at(tendon_force, control, on=on, frame=frame)
        if ours.labels != table.labels:
            raise RuntimeError(f"OpenSim answers for other joints than {setup} has")
        # frames, joints, (force, moment, point), axes
        expected = table.values.reshape(len(table.time), -1, 3, 3)
        sizes.append(np.linalg.norm(expected, axis=3).max(axis=0))
        apart.append(np.abs(ours.columns.reshape(expected.shape) - expected).max(axis=(0, 3)))
        seen.append([f"{place[0]} on {place[1]} in {place[2]}" for place in _places(ours)])
    size, difference = np.concatenate(sizes), np.concatenate(apart)
    relative = difference / np.maximum(size, 1.0)
    worst = int(relative[:, :2].max(axis=1).argmax())
    return Comparison(
        frames=trajectory.n_frames,
        joints=len(reactions.joints),
        force=relative[:, 0].max(),
        moment=relative[:, 1].max(),
        point=difference[:, 2].max(),
        where=[name for names in seen for name in names][worst],
        largest_force=size[:, 0].max(),
        largest_moment=size[:, 1].max(),
    )


def _places(found: scso.JointReactions) -> list[tuple[str, str, str]]:
    return list(zip(found.joints, found.bodies, found.frames, strict=True))


def _ask_opensim(setup: Path, folder: Path, forces: Storage, step: int) -> dict[tuple[str, str], Storage]:
    """Return OpenSim's reactions by body and frame."""
    write_storage(forces, folder / "forces.sto")
    question = {"setup": str(setup), "results": str(folder), "forces": str(folder / "forces.sto")}
    question |= {"places": PLACES, "step": step}
    command = [sys.executable, "-P", str(OPENSIM), json.dumps(question)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    files = {place: list(folder.glob(f"*_{'_'.join(place)}_ReactionLoads.sto")) for place in PLACES}
    if not all(files.values()):
        raise RuntimeError((done.stdout + done.stderr).strip().splitlines()[-1])
    return {place: read_storage(file) for place, (file,) in files.items()}


def compare(setup: Path, frames: int = SOME) -> Comparison:
    """Solve about so many frames of a setup, and compare what joints carry with OpenSim.

    Raises
    ------
    RuntimeError
        OpenSim gives no answer.
    ScsoError
        There is none here.
    """
    wanted = read_analyze_setup(setup)
    every = scso.load_motion(wanted, prepare_for=(), progress=False).n_frames
    step = wanted.motion.step_interval * max(1, every // frames)
    asked = replace(wanted, motion=replace(wanted.motion, step_interval=step, joint_reactions=("all",)))
    solution = scso.solve(asked, solver="framewise", progress=False)
    return beside_opensim(setup, solution.problem.motion, solution.tendon_force, solution.control, step)


HEADS = (
    "setup",
    "frames",
    "joints",
    "largest force [N]",
    "largest moment [N·m]",
    "force",
    "moment",
    "worst",
)


def main() -> None:
    """Print the table row by row, and write it."""
    table_command(
        __doc__,
        HEADS,
        lambda setup, frames: f"| {title(setup)} | {compare(setup, frames)} |",
        frames=SOME,
        of_what="of each setup",
    )


if __name__ == "__main__":
    main()
