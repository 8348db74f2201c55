"""No term hides a constant of muscles: what changes with it has a symbol for it, or says that it has none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import random_problem, with_joint_reactions, with_motion
from test_architecture import EXAMPLES, MODELS, OBJECTIVES, TERMS, _with_curvature

import scso_nlp as scso
from scso_nlp.muscle_models.muscle_classes import DIFFERENTIABLE
from scso_nlp.transcription.by_data import mixed_by_data
from scso_nlp.transcription.describe import describe
from scso_nlp.transcription.piece import Seen

LAWS = (scso.FallingStiffness(), scso.ShortRangeStiffness(), scso.FiberStiffness())


def problem_with(term, rng):
    """A problem with one example of a term, a muscle model with fibers and a stiffness law where it fits."""
    problem = _with_curvature(random_problem(rng, n_frames=2, n_muscles=5, reserve=5.0), rng)
    problem = with_joint_reactions(problem, rng)
    if isinstance(term, tuple(MODELS)):
        return dataclasses.replace(problem, muscle_model=term)
    problem = dataclasses.replace(problem, muscle_model=scso.RigidTendon(convention="physical"))
    if isinstance(term, tuple(OBJECTIVES)):
        return dataclasses.replace(problem, objectives=(term,))
    return dataclasses.replace(problem, constraints=(term,))


EXAMPLE_TERMS = [
    *(term(**EXAMPLES.get(term.__name__, {})) for term in TERMS),
    scso.RigidTendon(convention="physical"),
    *(scso.JointStability(stiffness=law, joints=("elbow",)) for law in LAWS),
]


@pytest.mark.parametrize("name", DIFFERENTIABLE)
@pytest.mark.parametrize("term", EXAMPLE_TERMS, ids=lambda term: f"{term!r:.60}")
def test_what_changes_with_a_constant_has_a_symbol_for_it(term, name):
    rng = np.random.default_rng(5)
    problem = problem_with(term, rng)
    if name in term.unseen(problem.motion):
        return
    program = describe(problem, frozenset([name]))
    low, high = (np.clip(program.layout.rows(w, 2), -1.0, 1.0) for w in ("lower", "upper"))
    x = low + rng.uniform(0.3, 0.7, low.shape) * (high - low)
    muscles, m, h = problem.motion.muscles, 2, 1e-6

    def moved(sign):
        values = getattr(muscles, name).copy()
        values[m] *= 1 + sign * h
        changed = dataclasses.replace(muscles, **{name: values})
        other = with_motion(problem, muscles=changed)
        if isinstance(problem.muscle_model, scso.RigidTendon) and name == "max_isometric_force":
            capacity = problem.motion.trajectory.active_force_capacity.copy()
            capacity[:, m] *= 1 + sign * h
            trajectory = dataclasses.replace(problem.motion.trajectory, active_force_capacity=capacity)
            other = with_motion(other, trajectory=trajectory)
        return values_of(describe(other), x)

    keys = {key: np.array([m]) for key in program.arrays if key[1] == name}
    step = 2 * h * getattr(muscles, name)[m]
    found = zip(pieces(program), moved(-1), moved(1), strict=True)
    for piece, below, above in found:
        exact, seen = np.zeros(below.shape), Seen.by(piece, x / program.layout.scale, program.arrays)
        for slopes in mixed_by_data(piece, keys, seen)[0]:
            np.add.at(exact, (slice(None), slopes.row), slopes.values)
        slope = (above - below) / step
        size = np.abs(slope).max(initial=0.0) + 1e-7 * np.abs(above).max(initial=0.0) / step
        np.testing.assert_allclose(exact, slope, atol=1e-4 * size)


def pieces(program):
    """Every expression of a program."""
    blocks = (*program.rows.blocks, *program.pair_rows.blocks, *program.matrices)
    costs = [piece for _, piece in program.objectives]
    return [*costs, *(block.piece for block in blocks), program.tendon_force]


def values_of(program, x):
    """Their values at unknowns in their own units."""
    return [piece.values(x / program.layout.scale, program.arrays) for piece in pieces(program)]
