"""Time and memory of a whole motion: this package and OpenSim's StaticOptimization on the same frames.

Usage: python problems/benchmarks/against_opensim.py SETUP.xml [--joints a,b] [--q 40] [--step 10]

Prints one table. Coupled coordinates take their speeds from the constraints. Each program runs in a process
of its own, so that peak memory is its own; extraction runs in worker processes, whose largest one counts.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

OURS = "ours"
OPENSIM = "opensim"


def run_ours(setup: str, joints: list[str], q: float, step: int) -> dict[str, float]:
    """Extract, then solve static optimization with and without stability."""
    import numpy as np

    import scso_nlp as scso

    axes = tuple((joint, axis) for joint in joints for axis in "xyz")
    started = time.perf_counter()
    motion = scso.load_motion(setup, step_interval=step, keep_coupled_speeds=False, progress=False)
    plain_extraction = time.perf_counter() - started
    started = time.perf_counter()
    motion = scso.load_motion(
        setup, step_interval=step, stability_axes=axes, keep_coupled_speeds=False, progress=False
    )
    extraction = time.perf_counter() - started
    plain = scso.static_optimization(motion)
    stability = scso.JointStability(q=q, joints=joints)
    result = {
        "frames": motion.n_frames,
        "extraction": plain_extraction,
        "extraction with stability axes": extraction,
    }
    for name, problem, solve in (
        ("SO, trajectory", plain, scso.solve_trajectory),
        ("SO, frame by frame", plain, scso.solve_framewise),
        (
            "SCSO, trajectory",
            replace(plain, constraints=(*plain.constraints, stability)),
            scso.solve_trajectory,
        ),
    ):
        started = time.perf_counter()
        solution = solve(problem, on_failure="return")
        result[f"{name}: all"] = time.perf_counter() - started
        result[f"{name}: build"] = solution.report.build_seconds
        result[f"{name}: solve"] = solution.report.solve_seconds
        result[f"{name}: iterations"] = solution.report.iterations
        result[f"{name}: frames solved"] = int(np.sum(solution.is_solved))
    result["peak memory of solving [MB]"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    result["peak memory of a worker [MB]"] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    return result


def run_opensim(setup: str, step: int) -> dict[str, float]:
    """Run the AnalyzeTool on a copy of the setup file with another step interval."""
    import opensim

    source = Path(setup).resolve()
    tree = ElementTree.parse(source)  # the user's own file
    for element in tree.iter("step_interval"):
        element.text = str(step)
    for element in tree.iter("results_directory"):
        element.text = "results"
    for name in ("model_file", "force_set_files", "external_loads_file", "coordinates_file", "states_file"):
        for element in tree.iter(name):
            if element.text and element.text.strip():
                element.text = " ".join(str(source.parent / part) for part in element.text.split())
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "setup.xml"
        tree.write(copy)
        opensim.Logger.setLevelString("Off")
        started = time.perf_counter()
        opensim.AnalyzeTool(str(copy)).run()
        seconds = time.perf_counter() - started
    return {
        "OpenSim StaticOptimization: all": seconds,
        "peak memory of OpenSim [MB]": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }


def main() -> None:
    """Run both in processes of their own and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("setup")
    parser.add_argument("--joints", default="walker_knee_r,walker_knee_l,ankle_r,ankle_l")
    parser.add_argument("--q", type=float, default=40.0)
    parser.add_argument("--step", type=int, default=10)
    parser.add_argument("--no-opensim", action="store_true")
    parser.add_argument("--part", choices=(OURS, OPENSIM), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.part == OURS:
        print(json.dumps(run_ours(arguments.setup, arguments.joints.split(","), arguments.q, arguments.step)))
        return
    if arguments.part == OPENSIM:
        print(json.dumps(run_opensim(arguments.setup, arguments.step)))
        return
    figures: dict[str, float] = {}
    for part in (OURS,) if arguments.no_opensim else (OURS, OPENSIM):
        command = [sys.executable, __file__, *sys.argv[1:], "--part", part]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        figures |= json.loads(done.stdout.strip().splitlines()[-1])
    frames = figures.pop("frames")
    print(f"{arguments.setup}: {frames:.0f} frames")
    for name, value in figures.items():
        is_time = not any(word in name for word in ("MB", "iterations", "frames"))
        per_frame = f"{1e3 * value / frames:10.2f} ms/frame" if is_time else ""
        print(f"{name:40s} {value:10.2f}{' s' if is_time else '  '}{per_frame}")


if __name__ == "__main__":
    main()
