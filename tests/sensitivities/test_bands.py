"""First-order bands against re-solved samples, as a file and as a figure, and what is refused."""

from __future__ import annotations

import dataclasses
import os

import numpy as np
import pytest
from drawn import drawn
from helpers import elbow, random_problem, with_motion, with_trajectory

import scso_nlp as scso
from scso_nlp.exceptions import DataError
from scso_nlp.io.storage import read_storage

#: Samples; the standard deviation of a standard deviation is 1/sqrt(2 n) of it.
SAMPLES = int(os.environ.get("SCSO_SAMPLES", "200"))


def sampled(problem, strength, moments, q):
    """Activations and forces of the problem with other strengths, moments and gain."""
    muscles = dataclasses.replace(problem.motion.muscles, max_isometric_force=strength)
    problem = with_trajectory(with_motion(problem, muscles=muscles), generalized_forces=moments)
    balance, stability = problem.constraints
    constraints = (balance, dataclasses.replace(stability, q=q))
    solution = scso.solve_trajectory(dataclasses.replace(problem, constraints=constraints))
    return solution.activation, solution.tendon_force


def test_bands_are_the_spread_of_samples_solved_again():
    """Strengths 2 %, moments 0.1 N·m and q 0.1, small enough for one active set in most samples."""
    rng = np.random.default_rng(4)
    problem = random_problem(rng, n_frames=4, n_muscles=8, reserve=5.0)
    solution = scso.solve_trajectory(problem)
    muscles, trajectory = problem.motion.muscles, problem.motion.trajectory
    names = [f"max_isometric_force[{name}]" for name in muscles.muscles]
    names += [f"generalized_forces[{name}]" for name in trajectory.coordinates] + ["q"]
    deviation = np.concatenate([0.02 * muscles.max_isometric_force, np.full(3, 0.1), [0.1]])
    change = scso.sensitivity(solution, names)
    assert change.is_regular.all()
    spread = scso.bands(change, covariance=deviation**2)
    n = muscles.n_muscles
    draws = rng.normal(0, deviation, (SAMPLES, deviation.size))
    found = [
        sampled(problem, muscles.max_isometric_force + d[:n], trajectory.generalized_forces + d[n : n + 3],
                5.0 + d[-1])
        for d in draws
    ]  # fmt: skip
    for values, band in zip(map(np.array, zip(*found, strict=True)), (spread.activation, spread.tendon_force),
                            strict=True):  # fmt: skip
        # where nobody is within four deviations of a bound, first order holds
        clear = (solution.activation > 4 * spread.activation) & (
            solution.activation + 4 * spread.activation < 1
        )
        assert clear.mean() > 0.4
        ratio = values.std(axis=0)[clear] / band[clear]
        np.testing.assert_allclose(ratio, 1.0, atol=0.05 + 3 / np.sqrt(2 * SAMPLES) * (SAMPLES < 2000))


def test_ranges_add_up_and_correlations_count(rng):
    change = scso.sensitivity(scso.solve_trajectory(random_problem(rng, reserve=5.0)), ["q", "weight"])
    first, second = change.tendon_force[:, 0], change.tendon_force[:, 1]
    wide = scso.bands(change, ranges=[2.0, 3.0])
    np.testing.assert_allclose(wide.tendon_force, 2 * np.abs(first) + 3 * np.abs(second))
    tied = scso.bands(change, covariance=[[4.0, 6.0], [6.0, 9.0]])
    np.testing.assert_allclose(tied.tendon_force, np.abs(2 * first + 3 * second), atol=1e-9)
    assert "standard deviation" in tied.meaning
    assert "ranges" in wide.meaning


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "one of the two"),
        ({"covariance": [1.0], "ranges": [1.0]}, "one of the two"),
        ({"covariance": [1.0, 2.0]}, r"shape \(2,\), expected \(1, 1\)"),
        ({"covariance": [[-1.0]]}, "positive semi-definite"),
        ({"ranges": [-1.0]}, "at least 0"),
    ],
)
def test_what_is_no_spread_is_refused(given, words):
    change = scso.sensitivity(scso.solve_trajectory(elbow([60.0])), ["generalized_forces"])
    with pytest.raises(DataError, match=words):
        scso.bands(change, **given)


def test_bands_in_a_file_and_in_a_figure(rng, tmp_path):
    solution = scso.solve_trajectory(random_problem(rng, n_frames=8, reserve=5.0))
    spread = scso.bands(scso.sensitivity(solution, ["q", "generalized_forces"]), covariance=[1.0, 1.0])
    path, _ = scso.write_bands(spread, tmp_path)
    table = read_storage(path)
    low, high = (table.values[:, table.labels.index(f"m3_{end}")] for end in ("low", "high"))
    np.testing.assert_allclose(high - low, 2 * spread.activation[:, 2])
    for quantity, band in (
        ("activation", spread.activation),
        ("stability", spread.row_value["JointStability"]),
    ):
        figure = drawn(
            scso.plot_uncertainty(spread, quantity=quantity, names="m3" if band.shape[1] > 3 else "")
        )
        (area,) = figure.axes[0].collections[:1]
        height = np.ptp(area.get_paths()[0].vertices[:, 1])
        values = solution.activation[:, 2:3] if band.shape[1] > 3 else solution.stability.stability[:, :1]
        column = band[:, 2:3] if band.shape[1] > 3 else band[:, :1]
        assert height == pytest.approx(np.max(values + column) - np.min(values - column), rel=1e-6)
