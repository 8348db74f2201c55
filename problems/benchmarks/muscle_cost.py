"""What a muscle costs: time per muscle and frame for value, gradient and Hessian of every class.

Run as ``python problems/benchmarks/muscle_cost.py``; prints one table. Each function is one scalar
expression, mapped over 92 muscles and 100 frames, with the constants embedded; "compiled" is the same
function as C code, where a compiler is at hand.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np

from scso_nlp.muscle_models.equilibrium import equilibrium_residual, solve_equilibrium
from scso_nlp.muscle_models.force import rigid_tendon_force, rigid_tendon_force_parts
from scso_nlp.muscle_models.hill_muscle import HillCurves, HillMuscle, pack, repeat_over_frames, unpack
from scso_nlp.muscle_models.muscle_classes import MUSCLE_CLASSES
from scso_nlp.muscle_models.stiffness import short_range_stiffness

N_MUSCLES, N_FRAMES, REPEATS = 92, 100, 5


def cost(function: ca.Function, inputs: list[ca.DM]) -> float:
    """Measure a mapped function; the best of several runs [ns per muscle and frame]."""
    mapped = function.map(N_MUSCLES * N_FRAMES)
    best = np.inf
    for _ in range(REPEATS):
        start = time.perf_counter()
        mapped(*inputs)
        best = min(best, time.perf_counter() - start)
    return best / (N_MUSCLES * N_FRAMES) * 1e9


def compiled(function: ca.Function, inputs: list[ca.DM]) -> float:
    """Measure the function as C code compiled with ``gcc -O2`` [ns per muscle and frame]; NaN without gcc."""
    if shutil.which("gcc") is None:
        return np.nan
    with tempfile.TemporaryDirectory() as folder:
        source = ca.CodeGenerator("muscle.c")
        source.add(function)
        source.generate(folder + "/")
        library = Path(folder) / "muscle.so"
        subprocess.run(
            ["gcc", "-O2", "-shared", "-fPIC", f"{folder}/muscle.c", "-o", str(library), "-lm"], check=True
        )
        return cost(ca.external(function.name(), str(library)), inputs)


def functions(names: str, constants: HillMuscle, formula: Callable[..., ca.SX]) -> tuple[ca.Function, ...]:
    """Build value, and value with gradient and Hessian by all arguments, of one muscle and frame."""
    x = ca.vertcat(*(ca.SX.sym(name) for name in names.split()))
    value = formula(constants, *ca.vertsplit(x))
    hessian, gradient = ca.hessian(value, x)
    return ca.Function("value", [x], [value]), ca.Function("all", [x], [value, gradient, ca.triu(hessian)])


def rows_of(curves: HillCurves) -> list[tuple[str, float, float, float, int]]:
    """Measure one class: name, value, with derivatives, the same compiled, instructions of the latter."""
    rng = np.random.default_rng(1)
    size = N_MUSCLES * N_FRAMES
    muscle = HillMuscle(curves=curves, pennation_angle_at_optimal=0.2)
    numbers = unpack(curves, pack(muscle))
    constants = HillMuscle(
        curves=curves,
        pennation_angle_at_optimal=0.2,
        curve_parameters={name: float(value) for name, value in numbers.curve_parameters.items()},
    )
    activation = rng.uniform(0.05, 1.0, size)
    along = rng.uniform(0.06, 0.14, size)
    length, velocity = 0.2 + along, rng.uniform(-0.5, 0.5, size)
    tendon = rng.uniform(1.0, 1.06, size) * 0.2
    cases = [
        (
            "rigid tendon F(a, l, v)",
            "a l v",
            rigid_tendon_force,
            np.stack([activation, length, velocity]),
        ),
        (
            "capacity c(l, v)",
            "l v",
            lambda m, *x: rigid_tendon_force_parts(m, *x).active,
            np.stack([length, velocity]),
        ),
    ]
    if curves.HAS_ELASTIC_TENDON:
        cases.append(
            (
                "equilibrium R(q, a)",
                "q a",
                lambda m, q, a: equilibrium_residual(m, q, a, 0.31),
                np.stack([0.31 - tendon, activation]),
            )
        )
        cases.append(
            (
                "short-range k(F)",
                "F",
                lambda m, force: short_range_stiffness(m, force, 0.1, 0.98),
                activation[None] * 1000.0,
            )
        )
    rows = []
    for name, arguments, formula, values in cases:
        value, derivatives = functions(arguments, constants, formula)
        inputs = [ca.DM(values)]
        times = (cost(value, inputs), cost(derivatives, inputs), compiled(derivatives, inputs))
        rows.append((name, *times, derivatives.n_instructions()))
    columns = repeat_over_frames(muscle, N_FRAMES)
    start = time.perf_counter()
    rigid_tendon_force(columns, ca.DM(activation), ca.DM(length), ca.DM(velocity))
    rows.append(("rigid tendon, on arrays", (time.perf_counter() - start) / size * 1e9, np.nan, np.nan, 0))
    if curves.HAS_ELASTIC_TENDON:
        shape = (N_FRAMES, N_MUSCLES)
        start = time.perf_counter()
        solve_equilibrium(muscle, activation.reshape(shape), length.reshape(shape))
        rows.append(("equilibrium solved", (time.perf_counter() - start) / size * 1e9, np.nan, np.nan, 0))
    return rows


def main() -> None:
    """Print the table."""
    print(f"CasADi {ca.__version__}, {N_MUSCLES} muscles x {N_FRAMES} frames, ns per muscle and frame")
    print(
        f"{'class':30s}{'function':28s}{'value':>8s}{'+grad+hess':>12s}{'compiled':>10s}{'instructions':>14s}"
    )
    for opensim_class, curves in MUSCLE_CLASSES.items():
        for name, value, derivatives, in_c, instructions in rows_of(curves):
            rest = f"{derivatives:12.0f}{in_c:10.0f}{instructions:14d}" if instructions else ""
            print(f"{opensim_class:30s}{name:28s}{value:8.0f}{rest}")


if __name__ == "__main__":
    main()
