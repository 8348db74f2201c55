"""Random activations that balance a frame: the cloud behind any one optimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import linprog

from scso_nlp.arguments import checked
from scso_nlp.exceptions import ProblemError
from scso_nlp.solution import Solution
from scso_nlp.solver.local_model import local_model
from scso_nlp.solver.threads import one_thread
from scso_nlp.transcription.describe import describe
from scso_nlp.validation import FloatArray

#: Steps for each pattern kept, per direction there is: neighbours on the walk are alike.
STEPS_PER_DIRECTION = 4
#: Steps per direction before the first pattern is kept, from which the widths of the set are learned.
WARM_UP = 50
#: The set is wide where a ball of this radius fits in [-]; otherwise there is one pattern and its rounding.
_LEAST_RADIUS = 1e-9


@checked
def random_patterns(solution: Solution, frame: int, number: int, *, seed: int = 0) -> FloatArray:
    r"""Draw activations of one frame at random, evenly from all that keep its rows and bounds.

    Parameters
    ----------
    solution : Solution
        Its controls stay as they are, so that every pattern leaves the same to reserves and other actuators.
        Rows of the problem that are not affine in the unknowns are refused.
    frame : int
    number : int
        Of patterns.
    seed : int

    Returns
    -------
    ndarray, shape (number, n_muscles) [-]

    Raises
    ------
    ProblemError
        A problem with rows that are not affine or unknowns besides activations and controls, a frame that is
        not there, not solved, or whose pattern is the only one; a number below 1, a negative seed.

    Notes
    -----
    Hit-and-run: from a point inside along a random direction to a point drawn evenly from the chord, again
    and again. Directions are drawn in coordinates in which the widths of the set, as the walk so far has
    seen them, are alike.

    References
    ----------
    Smith (1984), Oper Res 32:1296-1308.

    Examples
    --------
    >>> patterns = scso.random_patterns(solution, 1, 200)
    >>> bool((patterns**2).sum(axis=1).min() > (solution.activation[1] ** 2).sum() - 1e-9)
    True
    """
    n_frames = solution.problem.motion.n_frames
    if not 0 <= frame < n_frames:
        raise ProblemError(f"frame is {frame}, expected a number from 0 to {n_frames - 1}")
    if number < 1 or seed < 0:
        raise ProblemError(f"number is {number} and seed {seed}, expected at least 1 and at least 0")
    k = int(frame)
    if not solution.is_solved[k]:
        raise ProblemError(f"frame {k} is not solved, so that no pattern is known to balance it")
    directions, start, sides, limits = _set_of(solution, k)
    rng = np.random.default_rng(seed)
    with one_thread():
        point = _inside(sides, limits, k)
        spread = np.eye(point.size)
        warm = _walk(rng, point, spread, sides, limits, WARM_UP * point.size, 1)
        values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(warm.T)))
        spread = vectors * np.sqrt(np.maximum(values, values.max() * 1e-12))
        steps = STEPS_PER_DIRECTION * point.size
        points = _walk(rng, warm[-1], spread, sides, limits, number * steps, steps)
    motion = solution.problem.motion.muscles
    return np.clip(start + points @ directions.T, motion.min_activation, motion.max_activation)


def _set_of(solution: Solution, k: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Patterns of a frame as start + directions z with sides z <= limits."""
    problem = replace(solution.problem.frames(k, k + 1), observed=())
    model = local_model(describe(problem))
    program, n = model.program, problem.motion.muscles.n_muscles
    if model.curved_rows or model.matrices:
        raise ProblemError("random patterns need rows that are affine in the unknowns")
    known = np.concatenate([solution.activation[k], solution.control[k]])
    if program.layout.size != known.size:
        raise ProblemError(
            "random patterns are of activations, but terms of the problem have unknowns of their own: leave "
            "prices (soft) and other powers out"
        )
    matrix, least, most = (part[0] for part in model.rows(np.zeros((1, known.size)), np.array([0])))
    matrix = matrix / program.layout.scale
    given = matrix[:, n:] @ known[n:]
    matrix, least, most = matrix[:, :n], least - given, most - given
    low, high = problem.motion.muscles.min_activation, problem.motion.muscles.max_activation
    equal, is_fixed = least == most, low == high
    directions = null_space(np.vstack([matrix[equal], np.eye(n)[is_fixed]]))
    if not directions.size:
        raise ProblemError(f"frame {k} has one pattern only: muscles are not more than the rows")
    start, is_free = solution.activation[k], ~is_fixed
    above, below = np.isfinite(least) & ~equal, np.isfinite(most) & ~equal
    normals = np.vstack([-matrix[above], matrix[below], -np.eye(n)[is_free], np.eye(n)[is_free]])
    limits = np.concatenate([-least[above], most[below], -low[is_free], high[is_free]])
    sides = normals @ directions
    size = np.linalg.norm(sides, axis=1)
    kept = size > 1e-12 * np.linalg.norm(normals, axis=1)
    return directions, start, sides[kept] / size[kept, None], (limits - normals @ start)[kept] / size[kept]


def _inside(sides: FloatArray, limits: FloatArray, k: int) -> FloatArray:
    """Centre of the largest ball in the set."""
    n = sides.shape[1]
    found = linprog(
        np.append(np.zeros(n), -1.0),
        A_ub=np.column_stack([sides, np.ones(len(sides))]),
        b_ub=limits,
        bounds=[(None, None)] * n + [(0.0, None)],
        method="highs",
    )
    if not found.success or found.x[-1] < _LEAST_RADIUS:
        raise ProblemError(f"frame {k} has one pattern only, or patterns on an edge: none lie inside")
    return np.asarray(found.x[:-1])


def _walk(
    rng: np.random.Generator,
    point: FloatArray,
    spread: FloatArray,
    sides: FloatArray,
    limits: FloatArray,
    n_steps: int,
    every: int,
) -> FloatArray:
    """Hit and run for so many steps; every so many of them a point is kept, shape (n_kept, n)."""
    kept = []
    for step in range(1, n_steps + 1):
        direction = spread @ rng.standard_normal(point.size)
        rate, room = sides @ direction, limits - sides @ point
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = room / rate
        ahead, behind = reach[rate > 0].min(), reach[rate < 0].max()
        point = point + rng.uniform(behind, ahead) * direction
        if step % every == 0:
            kept.append(point)
    return np.array(kept)
