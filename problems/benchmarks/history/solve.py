"""Processor time and memory of an embedded example, with what commits of every age have."""

from __future__ import annotations

import time

import scso_nlp as scso
from scso_nlp.examples import example_folder


class Solve:
    """Twelve trunk muscles in ten tasks."""

    params = (2.0, 3.0, 10.0, float("inf"))
    param_names = ("power",)
    timer = time.process_time
    timeout = 120

    def setup_cache(self) -> scso.Motion:
        """Let OpenSim make the motion once."""
        return scso.load_motion(example_folder("spine-load-height") / "setup.xml", progress=False)

    def setup(self, motion: scso.Motion, power: float) -> None:
        """Describe both problems."""
        model = scso.NoPhysiology()
        self.plain = scso.static_optimization(motion, muscle_model=model, exponent=power)
        self.stable = scso.stability_constrained_static_optimization(
            motion, muscle_model=model, exponent=power
        )

    def time_static_optimization(self, motion: scso.Motion, power: float) -> None:
        """Solve without stability."""
        scso.solve_trajectory(self.plain)

    def time_stable(self, motion: scso.Motion, power: float) -> None:
        """Solve with stability."""
        scso.solve_trajectory(self.stable)

    def peakmem_stable(self, motion: scso.Motion, power: float) -> None:
        """Solve with stability."""
        scso.solve_trajectory(self.stable)
